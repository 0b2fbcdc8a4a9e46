//! The motion that the robot reports.

use crate::fault::finite;
use crate::sample::sample;
use crate::{Fault, Header};

sample! {
    /// Reported pose at the time of the front beam, and the increments since the sample before.
    pub struct Odometry(352, Odometry, 0xd12d_7830, "scanloop.Odometry.v2", check) {
        /// Identity and stamps; same scan id as the scan published with it
        pub header: Header,
        /// Reported position along the track [m]
        pub x_m: f64,
        /// Reported lateral position, left positive [m]
        pub y_m: f64,
        /// Reported yaw, in (-pi, pi] [rad]
        pub yaw_rad: f64,
        /// Reported x minus the x reported before; zero in the first sample [m]
        pub dx_m: f64,
        /// Reported y minus the y reported before; zero in the first sample [m]
        pub dy_m: f64,
        /// Reported yaw minus the yaw reported before; zero in the first sample [rad]
        pub dyaw_rad: f64,
        /// Time since the sample before; zero in the first sample [s]
        pub dt_s: f64,
        /// Speed over ground measured at the wheels, negative backwards [m/s]
        pub speed_mps: f64,
    }
}

fn check(odometry: &Odometry) -> Result<(), Fault> {
    odometry.header.check::<Odometry>()?;
    let Odometry { x_m, y_m, yaw_rad, dx_m, dy_m, dyaw_rad, dt_s, speed_mps, .. } = *odometry;
    finite("odometry", &[x_m, y_m, yaw_rad, dx_m, dy_m, dyaw_rad, dt_s, speed_mps])?;
    if dt_s < 0.0 {
        return Err(Fault::OutOfRange { field: "dt_s", value: dt_s });
    }
    Ok(())
}
