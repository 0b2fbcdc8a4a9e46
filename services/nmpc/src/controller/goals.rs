//! To which goal the robot drives, when it has arrived, and what a goal changes that is given while it drives.

use shared_types::{GivenGoal, StopReason};
use vehicle::{Goal, State};

use super::Controller;
use crate::config::SideRule;
use crate::landing::{Approach, approach};
use crate::state::Arrival;

impl Controller {
    /// Which goal the robot drives to, or stands at.
    pub(super) fn goal_index(&self) -> usize {
        usize::try_from(self.state.goal).map_or(0, |index| index.min(self.goals.len() - 1))
    }

    /// Puts the given goal in its place from its scan on. A robot that stood at the one before drives again.
    pub(super) fn heed_goal(&mut self, scan_id: u64) {
        let given = self.state.given;
        if given.from_scan <= self.given_from || scan_id < given.from_scan {
            return;
        }
        self.given_from = given.from_scan;
        let index = usize::try_from(given.index).unwrap_or(usize::MAX);
        let Some(goal) = self.goals.get_mut(index) else { return };
        let replaced = std::mem::replace(goal, goal_of(&given));
        let arrival = self.state.arrival();
        // A successor that finds the goal in its settings has nothing to leave.
        if index == self.goal_index()
            && replaced != self.goals[index]
            && matches!(arrival, Arrival::Landed | Arrival::Passed)
        {
            (self.state.arrival, self.state.rested_ns) = (Arrival::OnTheWay.wire(), 0);
        }
    }

    /// Stays at a goal as long as it demands, then drives to the next one; at the last one for good.
    pub(super) fn leave(&mut self, now_ns: u64, rests: bool) -> Result<(), StopReason> {
        if self.goal_index() + 1 == self.goals.len() {
            return Err(StopReason::Landed);
        }
        let state = &mut self.state;
        if state.rested_ns == 0 && rests {
            state.rested_ns = now_ns;
        }
        let stay_ns = (self.config.goal.stay_s * 1e9) as u64;
        if state.rested_ns == 0 || now_ns.saturating_sub(state.rested_ns) < stay_ns {
            return Err(StopReason::Landed);
        }
        (state.arrival, state.rested_ns) = (Arrival::OnTheWay.wire(), 0);
        self.drive_to(self.goal_index() + 1);
        Ok(())
    }

    /// After the state was lost: the first goal that is not behind the robot.
    pub(super) fn find_goal(&mut self, along_m: f64) {
        let is_ahead = |goal: &Goal| along_m <= goal.x_m + goal.tolerance_m;
        self.drive_to(self.goals.iter().position(is_ahead).unwrap_or(self.goals.len() - 1));
    }

    fn drive_to(&mut self, index: usize) {
        self.state.goal = index as u64;
        self.config.goal = self.legs.goal(self.goals[index], &self.state.back);
    }

    /// Lands, or stops behind the goal; a goal that was passed stays passed until the robot is well before it.
    pub(super) fn arrive(&mut self, initial: &State, speed: f64, period_s: f64) -> Result<(), StopReason> {
        let goal = self.config.goal;
        let is_leg_end =
            self.state.back.overshoots() || self.legs.ends_before(&self.goals[self.goal_index()]);
        match approach(&goal, initial, speed, period_s, &self.config.vehicle) {
            Approach::Land | Approach::Passed if is_leg_end => Err(StopReason::Reversal),
            Approach::Land => Err(StopReason::Landed),
            Approach::Passed if self.comes_back() => Ok(()),
            Approach::Passed => Err(StopReason::GoalPassed),
            Approach::Ahead
                if self.state.arrival() == Arrival::Passed
                    && goal.x_m - initial.x < 2.0 * goal.tolerance_m =>
            {
                Err(StopReason::GoalPassed)
            }
            Approach::Ahead => Ok(()),
        }
    }

    /// Whether the robot drives on to behind the goal that it passed under way, to come back to it. Where a body has moved, it could not
    /// drive back over what it does not see.
    fn comes_back(&mut self) -> bool {
        let goal = self.goals[self.goal_index()];
        let comes_back = self.config.side == SideRule::Search
            && self.state.arrival() == Arrival::OnTheWay
            && self.state.velocity_mps > 0.0
            && !self.state.movers.move_about()
            && self.legs.can_come_back(&goal, self.config.back_out_m)
            && self.state.back.overshoot(&goal);
        if comes_back {
            self.config.goal = self.legs.goal(goal, &self.state.back);
        }
        comes_back
    }
}

/// A given goal as one of the settings.
fn goal_of(given: &GivenGoal) -> Goal {
    let GivenGoal { x_m, y_m, tolerance_m, yaw_rad, yaw_tolerance_rad, stay_s, .. } = *given;
    let yaw_rad = (given.has_yaw == 1).then_some(yaw_rad);
    Goal { x_m, y_m, tolerance_m, yaw_rad, yaw_tolerance_rad, stay_s }
}
