//! Static transforms: where the scanner is on the robot.

use std::collections::BTreeMap;

use vehicle::Description;

use crate::message::{Quaternion, TFMessage, Transform, Vector3};

/// Places may differ by this [m].
const TOLERANCE_M: f64 = 0.01;
/// A scanner that is tilted more sees the floor, or misses what is low: at 5 degrees a ray has risen by 0.4 m after 5 m [deg].
const MAX_TILT_DEG: f64 = 5.0;
/// Longest chain of frames: more is a circle.
const MAX_FRAMES: usize = 64;

/// The frames of a robot, each in its parent.
#[derive(Debug, Default)]
pub(crate) struct Frames {
    parents: BTreeMap<String, (String, Transform)>,
}

impl Frames {
    /// Adds the transforms of a message.
    pub(crate) fn add(&mut self, message: TFMessage) {
        for stamped in message.transforms {
            self.parents.insert(stamped.child_frame_id, (stamped.header.frame_id, stamped.transform));
        }
    }

    /// Where a frame is in another one above it.
    pub(crate) fn pose(&self, frame: &str, within: &str) -> Option<Transform> {
        let mut found = Transform { rotation: Quaternion::of_yaw(0.0), ..Transform::default() };
        let mut frame = frame;
        for _ in 0..MAX_FRAMES {
            if frame == within {
                return Some(found);
            }
            let (parent, transform) = self.parents.get(frame)?;
            let moved = transform.rotation.rotate(&found.translation);
            let Vector3 { x, y, z } = &transform.translation;
            found = Transform {
                translation: Vector3 { x: moved.x + x, y: moved.y + y, z: moved.z + z },
                rotation: transform.rotation.after(&found.rotation),
            };
            frame = parent;
        }
        None
    }
}

/// Where the rays of a message point: that at angle `a` to `yaw_rad + sign * a`, seen from straight ahead of the scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rays {
    /// Where the angle zero points [rad].
    pub(crate) yaw_rad: f64,
    /// -1 for a scanner that is upside down.
    pub(crate) sign: f64,
}

/// Where `[vehicle]` has the scanner: all processes of the loop compute with this place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Mounting {
    x_m: f64,
    y_m: f64,
    yaw_rad: f64,
}

impl Mounting {
    /// That of a description.
    pub(crate) fn of(vehicle: &Description) -> Self {
        Self { x_m: vehicle.scanner_x_m, y_m: vehicle.scanner_y_m, yaw_rad: vehicle.scanner_yaw_rad }
    }

    /// Where the rays point of a scanner with this transform.
    ///
    /// # Errors
    /// A scanner that is elsewhere, or that is tilted, with its numbers.
    pub(crate) fn rays(&self, transform: &Transform) -> Result<Rays, String> {
        let up = transform.rotation.rotate(&Vector3 { z: 1.0, ..Vector3::default() }).z;
        let tilt_deg = up.abs().clamp(0.0, 1.0).acos().to_degrees();
        // NaN is no pose.
        if tilt_deg.is_nan() || tilt_deg > MAX_TILT_DEG {
            return Err(format!(
                "the scanner is tilted by {tilt_deg:.1} degrees by /tf_static, but at most {MAX_TILT_DEG} are allowed"
            ));
        }
        let Vector3 { x, y, .. } = transform.translation;
        let is_here = (x - self.x_m).abs() <= TOLERANCE_M && (y - self.y_m).abs() <= TOLERANCE_M;
        if !is_here {
            return Err(format!(
                "the scanner is at x {x:.3} m, y {y:.3} m by /tf_static, but at x {:.3} m, y {:.3} m by [vehicle]: set \
                 vehicle.scanner_x_m and scanner_y_m",
                self.x_m, self.y_m
            ));
        }
        let yaw_rad = driver::motion::wrapped(transform.rotation.yaw_rad() - self.yaw_rad);
        Ok(Rays { yaw_rad, sign: if up < 0.0 { -1.0 } else { 1.0 } })
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use crate::message::{Header, TransformStamped};

    fn link(parent: &str, child: &str, [x, y]: [f64; 2], rotation: Quaternion) -> TransformStamped {
        TransformStamped {
            header: Header { frame_id: parent.to_owned(), ..Header::default() },
            child_frame_id: child.to_owned(),
            transform: Transform { translation: Vector3 { x, y, z: 0.1 }, rotation },
        }
    }

    #[test]
    fn transforms_are_joined_from_the_scanner_up_to_the_base() {
        let mut frames = Frames::default();
        frames.add(TFMessage {
            transforms: vec![
                link("base_link", "mast", [0.2, 0.0], Quaternion::of_yaw(FRAC_PI_2)),
                link("mast", "laser", [0.1, 0.0], Quaternion::of_yaw(-FRAC_PI_2)),
                link("round", "round", [0.0; 2], Quaternion::of_yaw(0.0)),
            ],
        });
        let pose = frames.pose("laser", "base_link").unwrap();
        // The mast looks to the left, so that what is ahead of it is to the left of the robot.
        assert!((pose.translation.x - 0.2).abs() < 1e-12 && (pose.translation.y - 0.1).abs() < 1e-12);
        assert!(pose.rotation.yaw_rad().abs() < 1e-12);
        assert!(frames.pose("laser", "map").is_none() && frames.pose("round", "base_link").is_none());
        let mut mounting = Mounting { x_m: 0.2, y_m: 0.1, yaw_rad: 0.0 };
        assert_eq!(mounting.rays(&pose), Ok(Rays { yaw_rad: 0.0, sign: 1.0 }));
        mounting.x_m = 0.0;
        let elsewhere = mounting.rays(&pose).unwrap_err();
        assert!(elsewhere.contains("at x 0.200 m, y 0.100 m by /tf_static, but at x 0.000 m"), "{elsewhere}");
    }

    #[test]
    fn the_rays_of_a_scanner_follow_its_turn_also_upside_down() {
        let mounting = Mounting { x_m: 0.0, y_m: 0.0, yaw_rad: 0.5 };
        let over = Quaternion { x: 1.0, ..Quaternion::default() };
        for (rotation, sign) in [
            (Quaternion::of_yaw(2.0), 1.0),
            // First over, then to the left.
            (Quaternion::of_yaw(2.0).after(&over), -1.0),
        ] {
            let rays =
                mounting.rays(&Transform { rotation: rotation.clone(), ..Transform::default() }).unwrap();
            assert!((rays.yaw_rad - 1.5).abs() < 1e-12 && rays.sign == sign, "{rays:?}");
            // A ray to the left of the scanner's own zero, by the definition of a rotation.
            let (sin, cos) = 0.3_f64.sin_cos();
            let ray = rotation.rotate(&Vector3 { x: cos, y: sin, z: 0.0 });
            let points_rad = mounting.yaw_rad + rays.yaw_rad + rays.sign * 0.3;
            assert!(driver::motion::wrapped(ray.y.atan2(ray.x) - points_rad).abs() < 1e-12);
        }
    }

    #[test]
    fn a_tilted_scanner_is_refused_with_its_angle() {
        let mounting = Mounting { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0 };
        let tilted = |degrees: f64| {
            let (y, w) = (degrees.to_radians() / 2.0).sin_cos();
            mounting
                .rays(&Transform { rotation: Quaternion { x: 0.0, y, z: 0.0, w }, ..Transform::default() })
        };
        assert_eq!(tilted(4.0).unwrap().sign, 1.0);
        assert!(tilted(20.0).unwrap_err().contains("tilted by 20.0 degrees"));
        assert!(tilted(f64::NAN).is_err());
    }
}
