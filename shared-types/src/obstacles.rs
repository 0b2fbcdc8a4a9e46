//! The described obstacles.

use crate::describe::layout;
use crate::fault::finite;
use crate::sample::sample;
use crate::{Fault, Header, ScannerHealth};

/// How many ellipses a description can hold.
pub const MAX_OBSTACLES: usize = 16;

layout! {
    /// One ellipse that the robot's centre stays outside of, (7.34), and the box of the body inside it.
    ///
    /// Several ellipses may cover one body; they then share `body` and its box.
    pub struct Obstacle(136) {
        /// Identity of the ellipse, kept while it is tracked; never 0
        pub id: u32,
        /// Identity of the body that the ellipse belongs to
        pub body: u32,
        /// Centre of the ellipse along the track, (7.32) [m]
        pub x_m: f64,
        /// Centre of the ellipse across the track, (7.33) [m]
        pub y_m: f64,
        /// Semi-axis along the track, a of (7.34) [m]
        pub a_m: f64,
        /// Semi-axis across the track, b of (7.35) [m]
        pub b_m: f64,
        /// Velocity along the track [m/s]
        pub velocity_x_mps: f64,
        /// Velocity across the track [m/s]
        pub velocity_y_mps: f64,
        /// Covariance of the velocity: xx, xy, yy [m^2/s^2]
        pub velocity_covariance: [f64; 3],
        /// Centre of the body's box along the track [m]
        pub box_x_m: f64,
        /// Centre of the body's box across the track [m]
        pub box_y_m: f64,
        /// Full length of the body's box along its own axis [m]
        pub box_length_m: f64,
        /// Full width of the body's box [m]
        pub box_width_m: f64,
        /// Direction of the box's length axis [rad]
        pub box_yaw_rad: f64,
        /// Time since the body was last seen; zero when this scan shows it [s]
        pub unseen_s: f64,
        /// Scans that showed the body since it was first seen
        pub sightings: u64,
    }
}

sample! {
    /// All obstacles known at one scan: seen now, or remembered.
    pub struct Obstacles(2544, Obstacles, 0x6cf0_390d, "scanloop.Obstacles.v3", check) {
        /// Identity and stamps
        pub header: Header,
        /// How many of `items` are used
        pub count: u32,
        /// Number of ellipses for which `items` had no room
        pub overflow: u32,
        /// What the scanner can be relied on for
        pub scanner: ScannerHealth,
        /// The ellipses, nearest ahead first; unused ones are zero
        pub items: [Obstacle; MAX_OBSTACLES],
    }
}

impl Obstacles {
    /// The used ellipses.
    pub fn list(&self) -> &[Obstacle] {
        &self.items[..(self.count as usize).min(MAX_OBSTACLES)]
    }
}

fn check(obstacles: &Obstacles) -> Result<(), Fault> {
    obstacles.header.check::<Obstacles>()?;
    obstacles.scanner.check()?;
    if obstacles.count as usize > MAX_OBSTACLES {
        return Err(Fault::OutOfRange { field: "count", value: f64::from(obstacles.count) });
    }
    for item in obstacles.list() {
        finite("ellipse", &[item.x_m, item.y_m, item.a_m, item.b_m])?;
        finite("velocity", &[item.velocity_x_mps, item.velocity_y_mps])?;
        finite("velocity_covariance", &item.velocity_covariance)?;
        let size = [item.box_x_m, item.box_y_m, item.box_length_m, item.box_width_m, item.box_yaw_rad];
        finite("box", &size)?;
        for (field, value) in [("a_m", item.a_m), ("b_m", item.b_m)] {
            if !(0.01..=100.0).contains(&value) {
                return Err(Fault::OutOfRange { field, value });
            }
        }
        for (field, value) in [("box_length_m", item.box_length_m), ("box_width_m", item.box_width_m)] {
            if !(0.0..=100.0).contains(&value) {
                return Err(Fault::OutOfRange { field, value });
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sample;

    #[test]
    fn an_ellipse_with_nan_or_no_size_is_refused() {
        let mut obstacles = Obstacles { count: 1, ..Obstacles::default() };
        obstacles.header.layout = Obstacles::LAYOUT;
        assert_eq!(obstacles.check(), Err(Fault::OutOfRange { field: "a_m", value: 0.0 }));
        (obstacles.items[0].a_m, obstacles.items[0].b_m) = (1.2, 0.8);
        assert_eq!(obstacles.check(), Ok(()));
        obstacles.items[0].x_m = f64::NAN;
        assert_eq!(obstacles.check(), Err(Fault::NotFinite { field: "ellipse" }));
    }
}
