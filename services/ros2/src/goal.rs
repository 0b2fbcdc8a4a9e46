//! A goal of `/goal_pose`, as the tools of ROS 2 send it, for the drive.

use runtime::GoalOrder;

use crate::message::PoseStamped;
use crate::system::System;

/// Where the tools send it.
pub(crate) const TOPIC: &str = "/goal_pose";
/// The frame that it has to be in: the one of the track, as the tools show it.
pub(crate) const FRAME: &str = "track";

/// Sets goals of the drive, one after the other.
pub(crate) struct Goals {
    /// `None` where goals are not taken.
    system: Option<System>,
    /// The one that is set and not accepted yet, and which.
    setting: Option<(GoalOrder, String)>,
    /// The newest that waits for it to be accepted.
    next: Option<PoseStamped>,
    /// Why the newest goal was not taken.
    pub(crate) refused: Option<String>,
}

impl Goals {
    /// Goals of a system; without one they are refused.
    pub(crate) fn of(system: Option<System>) -> Self {
        Self { system, setting: None, next: None, refused: None }
    }

    /// Takes a goal; what becomes of it is seen later.
    pub(crate) fn take(&mut self, goal: PoseStamped) {
        self.next = Some(goal);
    }

    /// Follows the goal that is set, and sets the next one. Never waits.
    pub(crate) fn turn(&mut self) {
        if let Some((order, place)) = &mut self.setting {
            let Some(accepted) = order.poll() else { return };
            let place = std::mem::take(place);
            self.setting = None;
            match accepted {
                Ok(from_scan) => {
                    tracing::info!(
                        "the goal {place} from {TOPIC} is that of the drive from scan {from_scan} on"
                    );
                    self.refused = None;
                }
                Err(reason) => self.refuse(&place, &reason.to_string()),
            }
        }
        let Some(goal) = self.next.take() else { return };
        let place = place(&goal);
        let Some(system) = &self.system else {
            return self.refuse(&place, "the view was started without --control");
        };
        let ordered = pose_of(&goal).and_then(|[x_m, y_m, yaw_rad]| {
            system.set_goal([x_m, y_m], yaw_rad).map_err(|error| error.to_string())
        });
        match ordered {
            Ok(order) => self.setting = Some((order, place)),
            Err(reason) => self.refuse(&place, &reason),
        }
    }

    fn refuse(&mut self, place: &str, reason: &str) {
        let reason = format!("the goal {place} from {TOPIC} was not taken: {reason}");
        tracing::warn!("{reason}");
        self.refused = Some(reason);
    }
}

fn place(goal: &PoseStamped) -> String {
    let (place, frame) = (&goal.pose.position, &goal.header.frame_id);
    format!("x {:.2} m, y {:.2} m in `{frame}`", place.x, place.y)
}

/// Place [m, m] and direction [rad] of a goal.
///
/// # Errors
/// A frame whose place on the track is not known, and numbers that are none.
fn pose_of(goal: &PoseStamped) -> Result<[f64; 3], String> {
    let frame = &goal.header.frame_id;
    if frame != FRAME {
        return Err(format!("its frame is `{frame}`, but `{FRAME}` is needed"));
    }
    let (place, turn) = (&goal.pose.position, &goal.pose.orientation);
    let pose = [place.x, place.y, turn.yaw_rad()];
    let length = [turn.x, turn.y, turn.z, turn.w].iter().map(|part| part * part).sum::<f64>();
    let is_pose = pose.iter().all(|number| number.is_finite()) && length > 0.5;
    is_pose.then_some(pose).ok_or_else(|| "its numbers are no pose".to_owned())
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use crate::message::Quaternion;

    fn goal() -> PoseStamped {
        let mut goal = PoseStamped::default();
        goal.header.frame_id = FRAME.to_owned();
        (goal.pose.position.x, goal.pose.position.y) = (7.0, -1.25);
        goal.pose.orientation = Quaternion::of_yaw(FRAC_PI_2);
        goal
    }

    #[test]
    fn a_goal_on_the_track_is_set_with_its_direction() {
        let [x_m, y_m, yaw_rad] = pose_of(&goal()).unwrap();
        assert_eq!((x_m, y_m), (7.0, -1.25));
        assert!((yaw_rad - FRAC_PI_2).abs() < 1e-9, "{yaw_rad}");
    }

    #[test]
    fn a_goal_elsewhere_or_of_no_numbers_is_refused_and_so_are_all_without_control() {
        let mut elsewhere = goal();
        elsewhere.header.frame_id = "map".to_owned();
        assert_eq!(pose_of(&elsewhere).unwrap_err(), "its frame is `map`, but `track` is needed");
        for broken in [Quaternion::default(), Quaternion { w: f64::NAN, ..Quaternion::default() }] {
            let mut goal = goal();
            goal.pose.orientation = broken;
            assert_eq!(pose_of(&goal).unwrap_err(), "its numbers are no pose");
        }
        let mut goals = Goals::of(None);
        goals.take(goal());
        goals.turn();
        let told = "the goal x 7.00 m, y -1.25 m in `track` from /goal_pose was not taken: the view was started without --control";
        assert_eq!(goals.refused.as_deref(), Some(told));
    }
}
