//! Proposes plans. Replace this file by your own idea: `controller.rs` sends the first plan that passes `verify.rs`.
//!
//! The idea here is pure pursuit. The robot follows one of 25 lines along the track. For each line a plan steers to the
//! point of the line that is 1.2 m ahead, again and again over 4 m. Lines near the goal's line come first, and lines near
//! that of the last scan, so that the robot keeps the chosen side.

use shared_types::PLAN_NODES;
use vehicle::{Control, State};

use crate::settings::Settings;

/// Most intervals of a plan: a command carries one node more.
pub(crate) const INTERVALS: usize = PLAN_NODES - 1;
/// Length of an interval [m].
const INTERVAL_M: f64 = 0.17;
/// How far ahead the pursued point lies [m].
const AHEAD_M: f64 = 1.2;
/// Lines to each side of the goal's line, and the distance between two [m].
const LINES_TO_A_SIDE: i32 = 12;
const LINES: usize = 2 * LINES_TO_A_SIDE as usize + 1;
const BETWEEN_LINES_M: f64 = 0.15;

/// Controls, each for one interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Plan {
    controls: [Control; INTERVALS],
    count: usize,
    /// Duration of one interval [s].
    pub(crate) interval_s: f64,
}

impl Plan {
    /// The controls of the intervals that are used; at least one.
    pub(crate) fn controls(&self) -> &[Control] {
        &self.controls[..self.count]
    }
}

/// Plans at this velocity from this state, the preferred one first. `last_line_m` is the line of the scan before.
pub(crate) fn plans(
    settings: &Settings,
    start: State,
    velocity_mps: f64,
    last_line_m: f64,
) -> impl Iterator<Item = (f64, Plan)> {
    let goal_m = settings.goal.y_m;
    let mut lines: [f64; LINES] =
        std::array::from_fn(|index| goal_m + BETWEEN_LINES_M * (index as i32 - LINES_TO_A_SIDE) as f64);
    let cost = |line: &f64| (line - goal_m).abs() + 0.5 * (line - last_line_m).abs();
    lines.sort_unstable_by(|one, other| cost(one).total_cmp(&cost(other)));
    lines.into_iter().map(move |line| (line, pursue(settings, start, velocity_mps, line)))
}

/// The plan that holds a control over this way [m].
pub(crate) fn hold(control: Control, way_m: f64) -> Plan {
    let count = ((way_m / INTERVAL_M).ceil() as usize).clamp(1, INTERVALS);
    Plan { controls: [control; INTERVALS], count, interval_s: INTERVAL_M / control.velocity }
}

/// The plan that leads to a line, up to the goal.
fn pursue(settings: &Settings, start: State, velocity_mps: f64, line_m: f64) -> Plan {
    let interval_s = INTERVAL_M / velocity_mps;
    let mut plan = Plan { controls: [Control::default(); INTERVALS], count: 0, interval_s };
    let turn_per_rad = settings.vehicle.parameters().yaw_rate_gain() * INTERVAL_M;
    let (mut x, mut y, mut yaw) = (start.x, start.y, start.yaw);
    while plan.count == 0 || (plan.count < INTERVALS && x < settings.goal.x_m) {
        let lateral = line_m - y - AHEAD_M * yaw.sin();
        let curvature = 2.0 * lateral / (AHEAD_M * AHEAD_M);
        let steering = curvature / settings.vehicle.parameters().yaw_rate_gain();
        let control = settings.vehicle.bounds.clamp(Control { velocity: velocity_mps, steering });
        plan.controls[plan.count] = control;
        plan.count += 1;
        // The middle of the arc has the direction of its chord.
        let turn = turn_per_rad * control.steering;
        x += INTERVAL_M * (yaw + turn / 2.0).cos();
        y += INTERVAL_M * (yaw + turn / 2.0).sin();
        yaw += turn;
    }
    plan
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::example;

    #[test]
    fn the_first_plan_follows_the_line_of_the_goal_and_ends_there() {
        let settings = example();
        let (line, plan) = plans(&settings, State::default(), 1.0, 0.0).next().unwrap();
        assert!(line.abs() < 1e-12);
        assert!(plan.controls().iter().all(|control| control.steering == 0.0 && control.velocity == 1.0));
        let near = State { x: 9.7, ..State::default() };
        let (_, plan) = plans(&settings, near, 0.5, 0.0).next().unwrap();
        assert_eq!(plan.controls().len(), 2, "0.3 m are two intervals");
    }

    #[test]
    fn a_plan_steers_to_its_side_and_within_the_bounds() {
        let settings = example();
        for (line, plan) in plans(&settings, State::default(), 1.0, 0.0) {
            let first = plan.controls()[0].steering;
            assert!(first * line >= 0.0, "{line} {first}");
            assert!(plan.controls().iter().all(|control| settings.vehicle.bounds.contains(*control, 0.0)));
        }
    }

    #[test]
    fn the_side_of_the_last_scan_comes_first() {
        let settings = example();
        let lines: Vec<f64> = plans(&settings, State::default(), 1.0, -0.9).map(|(line, _)| line).collect();
        let place = |wanted: f64| lines.iter().position(|line| (line - wanted).abs() < 1e-9);
        assert!(place(-0.9) < place(0.9));
        assert_eq!(lines.len(), LINES);
    }
}
