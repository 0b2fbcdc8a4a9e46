//! What the actuator remembers from command to command, as plain bytes for a checkpoint.

use shared_types::{Fault, Flag, Header, finite, plain_state};
use vehicle::Bounds;

plain_state! {
    /// What the actuator remembers from command to command.
    pub struct ActuatorState {
        /// Header of the last command answered
        pub header: Header,
        /// Arrival of the last valid command [ns]
        pub valid_ns: u64,
        /// When something was last sent to the robot; before that, the first reading of the clock [ns]
        pub told_ns: u64,
        /// Commands refused since the start
        pub refused: u64,
        /// Gaps between scans since the start
        pub gaps: u64,
        /// The last scan refused as answered before although it was taken after the last one answered; else 0
        pub doubted: u64,
        /// Last steering angle desired while driving; blocked wheels keep it [rad]
        pub steering_rad: f64,
        /// Last steering angle sent while driving [rad]
        pub sent_steering_rad: f64,
        /// Angle that the wheels would have without play [rad]
        pub shaft_rad: f64,
        /// Angle that the wheels have, by what was sent [rad]
        pub wheels_rad: f64,
        /// Velocity desired while driving last [m/s]
        pub velocity_mps: f64,
        /// Until when the robot may roll with it: it drives, or slides with blocked wheels [ns]
        pub rolls_until_ns: u64,
        /// Valid commands in a row
        pub streak: u32,
        /// 1 after silence, until enough valid commands came in a row
        pub silenced: Flag,
        /// 1 after an explicit stop, until it is released
        pub stopped: Flag,
        /// 1 once a valid command came
        pub commanded: Flag,
        /// 1 once the clock was read
        pub awake: Flag,
        /// 1 while a command of the controller turns the wheels, 2 while one of a person does; else 0
        pub turning: u32,
        /// Who drives, `DrivenBy`
        pub driven_by: u32,
        /// 1 while the stop is an emergency stop from outside
        pub emergency: Flag,
        /// When the person who drives gave a control last [ns]; 0 before the first
        pub given_ns: u64,
    }
}

impl ActuatorState {
    /// Passes when the wheels may be held at the angles of the state.
    ///
    /// # Errors
    /// [`Fault`] when a held steering angle is not finite or beyond what may be sent.
    pub fn check(&self, bounds: &Bounds) -> Result<(), Fault> {
        for (field, value) in [
            ("steering_rad", self.steering_rad),
            ("sent_steering_rad", self.sent_steering_rad),
            ("shaft_rad", self.shaft_rad),
            ("wheels_rad", self.wheels_rad),
        ] {
            finite(field, &[value])?;
            if value.abs() > bounds.sent_steering_max_rad {
                return Err(Fault::OutOfRange { field, value });
            }
        }
        finite("velocity_mps", &[self.velocity_mps])
    }
}
