//! By how much a stop was decided: the number, and its limit.

use shared_types::{Obstacles, Pose, StopReason};

use super::Controller;
use crate::braking::Stopping;
use crate::gear;
use crate::landing::from_rest;
use crate::margin::MarginModel;
use crate::scene::REST_MPS;
use crate::start::{self, OVERLAP_M};

/// The number that a stop was decided by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StopNumber {
    /// What it is, so that number and unit may follow.
    pub what: &'static str,
    /// The number, in `unit`.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// How the limit is said.
    pub allowed: &'static str,
    /// The limit, in the same unit.
    pub limit: f64,
    /// The ellipse that it is about, 0 where it is none.
    pub id: u32,
}

impl Controller {
    /// The number behind the stop that was decided last, for these inputs and this scan period [s]; `None` for a reason without
    /// one, and where the inputs contradict each other.
    pub fn stop_number(
        &self,
        reason: StopReason,
        pose: &Pose,
        obstacles: &Obstacles,
        period_s: f64,
    ) -> Option<StopNumber> {
        let config = &self.config;
        let is_reverse = self.legs.is_reverse();
        let pose = &if is_reverse { gear::turned(pose) } else { *pose };
        let slowest_mps = config.vehicle.bounds.velocity_min_mps;
        let number =
            |what, value, unit, allowed, limit| Some(StopNumber { what, value, unit, allowed, limit, id: 0 });
        let along = start::place(config, pose, &self.state);
        let speeds = || {
            let stopping = Stopping::new(config, period_s, MarginModel::of(config, pose).age_s());
            start::speeds(config, pose, &obstacles.scanner, &stopping, is_reverse)
        };
        match reason {
            StopReason::Landed | StopReason::GoalPassed | StopReason::Reversal => {
                let [ahead, left] =
                    from_rest(&config.goal, &along, pose.predicted_speed_mps.abs(), &config.vehicle);
                let what = if reason == StopReason::Reversal {
                    "distance from the turning point at rest"
                } else {
                    "distance from the goal at rest"
                };
                number(what, ahead.hypot(left), "m", "at most", config.goal.tolerance_m)
            }
            StopReason::Covered => {
                let (id, value) = start::deepest(config, &self.predicted, along)?;
                let what = "depth of the body in its box";
                Some(StopNumber { what, value, unit: "m", allowed: "at most", limit: OVERLAP_M, id })
            }
            StopReason::BadInput => {
                let (speed, most) = (start::speed(pose), start::fastest(config));
                (speed > most).then(|| number("speed of the pose", speed, "m/s", "at most", most)).flatten()
            }
            StopReason::StateLost => number("speed", pose.speed_mps.abs(), "m/s", "at rest below", REST_MPS),
            StopReason::NoSafeSpeed => {
                number("fastest speed to stop in time", speeds()[0], "m/s", "at least", slowest_mps)
            }
            StopReason::Scanner => {
                number("fastest speed for what is seen", speeds()[1], "m/s", "at least", slowest_mps)
            }
            _ => None,
        }
    }
}
