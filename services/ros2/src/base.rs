//! From an `Odometry` to a state of the base.

use driver::motion::BaseState;
use driver::ros2::{OdometryUse, Ros2Config};

use crate::message::Odometry;

/// A longer time between two messages adds nothing to the pose: the stamps have jumped, or messages are missing [s].
const MAX_STEP_S: f64 = 1.0;

/// Follows the messages of a base.
#[derive(Debug, Default)]
pub(crate) struct Base {
    /// The pose that twists are added up to, and the stamp of the newest [s].
    added: Option<([f64; 3], f64)>,
}

impl Base {
    /// The state that a message reports. With `odometry = "twist"` its pose is not used, but the twists are added up.
    pub(crate) fn state(&mut self, config: &Ros2Config, message: &Odometry) -> BaseState {
        let twist = &message.twist.twist;
        let velocity = [twist.linear.x, twist.linear.y, twist.angular.z];
        let pose = match config.odometry {
            OdometryUse::Pose => {
                let pose = &message.pose.pose;
                [pose.position.x, pose.position.y, pose.orientation.yaw_rad()]
            }
            OdometryUse::Twist => self.add(velocity, message.header.stamp.seconds()),
        };
        BaseState { pose, velocity, stalled: false }
    }

    /// Adds a twist that held since the message before.
    fn add(&mut self, [ahead, left, yaw_rate]: [f64; 3], stamp_s: f64) -> [f64; 3] {
        let ([x_m, y_m, yaw_rad], before_s) = self.added.unwrap_or(([0.0; 3], stamp_s));
        let step_s =
            Some(stamp_s - before_s).filter(|step_s| (0.0..=MAX_STEP_S).contains(step_s)).unwrap_or(0.0);
        let is_finite = [ahead, left, yaw_rate].iter().all(|number| number.is_finite());
        let step_s = if is_finite { step_s } else { 0.0 };
        let [ahead, left, yaw_rate] = if is_finite { [ahead, left, yaw_rate] } else { [0.0; 3] };
        let (sin, cos) = (yaw_rad + yaw_rate * step_s / 2.0).sin_cos();
        let pose = [
            x_m + (ahead * cos - left * sin) * step_s,
            y_m + (ahead * sin + left * cos) * step_s,
            yaw_rad + yaw_rate * step_s,
        ];
        self.added = Some((pose, stamp_s));
        pose
    }
}

/// What is wrong with the frames of a message; `None` when they are as the settings say.
pub(crate) fn wrong_frame(topic: &str, key: &str, wanted: &str, frame: &str) -> Option<String> {
    let is_right = wanted.is_empty() || wanted == frame;
    (!is_right).then(|| format!("{topic}: {key} is `{frame}`, but the settings have `{wanted}`"))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use crate::message::{Quaternion, Time};

    fn message(stamp_s: f64, ahead: f64, yaw_rate: f64) -> Odometry {
        let mut message = Odometry::default();
        message.header.stamp = Time::of_seconds(stamp_s);
        message.twist.twist.linear.x = ahead;
        message.twist.twist.angular.z = yaw_rate;
        message.pose.pose.position.x = 7.0;
        message.pose.pose.orientation = Quaternion::of_yaw(0.3);
        message
    }

    #[test]
    fn a_pose_is_taken_as_it_is() {
        let state = Base::default().state(&Ros2Config::default(), &message(5.0, 0.4, 0.1));
        assert_eq!((state.pose[0], state.velocity), (7.0, [0.4, 0.0, 0.1]));
        assert!((state.pose[2] - 0.3).abs() < 1e-12);
    }

    #[test]
    fn twists_are_added_up_along_the_arc() {
        let config = Ros2Config { odometry: OdometryUse::Twist, ..Ros2Config::default() };
        let mut base = Base::default();
        // A quarter of a circle of 1 m radius in 100 steps.
        let mut pose = [0.0; 3];
        for step in 0..=100 {
            let stamp_s = 10.0 + 0.01 * f64::from(step);
            pose = base.state(&config, &message(stamp_s, FRAC_PI_2, FRAC_PI_2)).pose;
        }
        assert!((pose[0] - 1.0).abs() < 1e-3 && (pose[1] - 1.0).abs() < 1e-3, "{pose:?}");
        assert!((pose[2] - FRAC_PI_2).abs() < 1e-6);
        // A jump of the clock, back or ahead, and what is no number, move nothing.
        for (stamp_s, ahead) in [(5.0, 1.0), (86_405.0, 1.0), (86_405.1, f64::NAN)] {
            assert_eq!(base.state(&config, &message(stamp_s, ahead, 0.0)).pose, pose);
        }
    }

    #[test]
    fn a_frame_is_compared_only_when_the_settings_name_one() {
        assert_eq!(wrong_frame("/scan", "frame_id", "", "laser"), None);
        assert_eq!(wrong_frame("/scan", "frame_id", "laser", "laser"), None);
        let wrong = wrong_frame("/scan", "frame_id", "laser", "lidar").unwrap();
        assert_eq!(wrong, "/scan: frame_id is `lidar`, but the settings have `laser`");
    }
}
