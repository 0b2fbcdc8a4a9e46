// Made by `scanloop types --rust --layout FILE`: do not edit, make it again.

shared_types::plain_state! {
    /// What an inertial sensor measures between two scans.
    pub struct Imu {
        /// Identity and stamps of the sample that this one answers
        pub header: shared_types::Header,
        /// Mean yaw rate since the sample before [rad/s]
        pub yaw_rate_radps: f64,
        /// Time since the sample before; zero in the first sample [s]
        pub dt_s: f64,
        /// When the process that published it worked on it
        pub stage: shared_types::StageStamps,
    }
}
