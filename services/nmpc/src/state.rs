//! State of the controller that its successor continues from.

use shared_types::{GivenControl, GivenGoal, PLAN_NODES, PlanNode, Pose, plain_state};

use crate::memory::Memory;
use crate::movers::Movers;
use crate::side::Sides;
use crate::sights::{Behind, Sights};
use crate::smoothing::SmoothedEllipses;
use crate::way_back::WayBack;

/// How far the robot has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub(crate) enum Arrival {
    /// On its way to the goal.
    OnTheWay = 0,
    /// At the goal, for good.
    Landed = 1,
    /// Behind the goal, which cannot be reached forwards.
    Passed = 2,
    /// The state was lost while driving: the robot has to rest before anything else.
    StateLost = 3,
    /// At the end of a leg of the course, or of the way out of a dead end, where it changes its direction of travel.
    LegDriven = 4,
}

impl Arrival {
    /// The number in a checkpoint.
    pub(crate) fn wire(self) -> u32 {
        self as u32
    }
}

impl ControllerState {
    /// How far the robot has come; an unknown number counts as on the way.
    pub(crate) fn arrival(&self) -> Arrival {
        let others = [Arrival::Landed, Arrival::Passed, Arrival::StateLost, Arrival::LegDriven];
        others.into_iter().find(|arrival| arrival.wire() == self.arrival).unwrap_or(Arrival::OnTheWay)
    }
}

impl ControllerState {
    /// What is known of the ground behind the robot, for a plan from `pose` on.
    pub(crate) fn behind(&self, pose: &Pose, seen_for_ns: u64) -> Behind<'_> {
        let now_ns = pose.header.acquired_ns;
        let since_ns = now_ns.saturating_sub(seen_for_ns);
        Behind { sights: &self.sights, movers: &self.movers, now_ns, start_ns: pose.predicted_ns, since_ns }
    }

    /// Where on the course the last plan began [m]; `None` before the first plan.
    pub(crate) fn along(&self) -> Option<f64> {
        Some(self.plan[0].x_m).filter(|along| self.plan_start_ns != 0 && along.is_finite())
    }
}

plain_state! {
    /// The state of a controller after a scan: the last verified plan, the sides held, and latched decisions.
    pub struct ControllerState {
        /// 0 on the way, 1 when the robot has landed, 2 when it has passed the goal, 3 when it has to rest before all else,
        /// 4 at the end of a leg
        pub arrival: u32,
        /// Scans since the path was found blocked, from 1; 0 when it is not
        pub blocked_scans: u32,
        /// Scans in a row with a clear path
        pub clear_scans: u32,
        /// How many nodes of `plan` are used; 0 without a plan
        pub plan_length: u32,
        /// How many goals were reached before the one that the robot drives to, or stands at
        pub goal: u64,
        /// Since when the robot has stood at its goal [ns]; 0 on its way
        pub rested_ns: u64,
        /// Time of the first node of the plan [ns]
        pub plan_start_ns: u64,
        /// Time between two nodes of the plan [s]
        pub plan_interval_s: f64,
        /// When the plan of the last scan started [ns]; 0 before the first scan
        pub started_ns: u64,
        /// When the front beam of the last scan was taken [ns]; 0 before the first scan
        pub acquired_ns: u64,
        /// Velocity of the last command [m/s]
        pub velocity_mps: f64,
        /// Steering angle of the last command [rad]
        pub steering_rad: f64,
        /// Sides on which obstacles are passed
        pub sides: Sides,
        /// Ellipses of the last scan
        pub ellipses: SmoothedEllipses,
        /// The goal that was given last while driving
        pub given: GivenGoal,
        /// Who drives, `DrivenBy`
        pub driven_by: u32,
        /// Which leg of the course it drives, from 0
        pub leg: u32,
        /// What a person who drives asked for last
        pub person: GivenControl,
        /// The way out of a dead end
        pub back: WayBack,
        /// The last verified plan, on the course
        pub plan: [PlanNode; PLAN_NODES],
        /// Where the robot was
        pub sights: Sights,
        /// What stands there
        pub memory: Memory,
        /// What moved there
        pub movers: Movers,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::{Checkpoint, Role};

    #[test]
    fn the_state_survives_a_checkpoint() {
        let mut state = ControllerState { blocked_scans: 3, plan_start_ns: 7, ..ControllerState::default() };
        state.plan[4].y_m = 0.5;
        let checkpoint = Checkpoint::of(Role::Controller, &state);
        assert_eq!(checkpoint.state::<ControllerState>(), Ok(state));
    }

    #[test]
    fn an_arrival_is_restored_and_an_unknown_number_is_on_the_way() {
        for number in 0..=4 {
            let arrival = ControllerState { arrival: number, ..ControllerState::default() }.arrival();
            assert_eq!(arrival.wire(), number);
        }
        let state = ControllerState { arrival: 5, ..ControllerState::default() };
        assert_eq!(state.arrival(), Arrival::OnTheWay);
    }
}
