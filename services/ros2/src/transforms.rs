//! Static transforms: where the scanner is on the robot.

use std::collections::BTreeMap;

use vehicle::Description;

use crate::message::{Quaternion, TFMessage, Transform, Vector3};

/// Poses may differ by this [m, rad].
const TOLERANCE: f64 = 0.01;
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

/// Where the settings have the scanner: on the robot, its angle zero against the front beam, and the sign of its angles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Mounting {
    x_m: f64,
    y_m: f64,
    yaw_rad: f64,
    sign: f64,
}

impl Mounting {
    /// That of a description, with the settings `scan_yaw_rad` and `scan_sign`.
    pub(crate) fn of(vehicle: &Description, scan_yaw_rad: f64, scan_sign: f64) -> Self {
        Self {
            x_m: vehicle.scanner_x_m,
            y_m: vehicle.scanner_y_m,
            yaw_rad: vehicle.scanner_yaw_rad + scan_yaw_rad,
            sign: scan_sign,
        }
    }

    /// What differs from a transform; `None` when nothing does.
    pub(crate) fn difference(&self, transform: &Transform) -> Option<String> {
        let up = transform.rotation.rotate(&Vector3 { z: 1.0, ..Vector3::default() }).z;
        let Vector3 { x, y, .. } = transform.translation;
        let yaw_rad = transform.rotation.yaw_rad();
        let turned = driver::motion::wrapped(yaw_rad - self.yaw_rad).abs();
        let sign = if up < 0.0 { -1.0 } else { 1.0 };
        let differs = (x - self.x_m).abs() > TOLERANCE || (y - self.y_m).abs() > TOLERANCE;
        (differs || turned > TOLERANCE || sign != self.sign).then(|| {
            format!(
                "the scanner is at x {x:.3} m, y {y:.3} m, yaw {yaw_rad:.3} rad, sign {sign} by /tf_static, but at x {:.3} m, \
                 y {:.3} m, yaw {:.3} rad, sign {} by vehicle.scanner_x_m, scanner_y_m, scanner_yaw_rad + \
                 ros2.scan_yaw_rad, ros2.scan_sign",
                self.x_m, self.y_m, self.yaw_rad, self.sign
            )
        })
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
        let mut mounting = Mounting { x_m: 0.2, y_m: 0.1, yaw_rad: 0.0, sign: 1.0 };
        assert_eq!(mounting.difference(&pose), None);
        mounting.x_m = 0.0;
        assert!(mounting.difference(&pose).unwrap().contains("at x 0.200 m, y 0.100 m"));
    }

    #[test]
    fn a_scanner_upside_down_needs_the_other_sign() {
        let rotation = Quaternion { x: 1.0, ..Quaternion::default() };
        let over = Transform { translation: Vector3::default(), rotation };
        let mounting = |sign| Mounting { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0, sign };
        assert!(mounting(1.0).difference(&over).is_some());
        assert_eq!(mounting(-1.0).difference(&over), None);
    }
}
