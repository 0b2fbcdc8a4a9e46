//! The figures of a ride.
//!
//! All of them belong to the part of the drive from the first drive command to [`BEFORE_GOAL_M`] before the goal.

use serde::{Deserialize, Serialize};
use vehicle::{Control, Goal, State};

use super::drive::{Issued, RideMoment, RideTrace};
use super::objective::{
    BEFORE_GOAL_M, CHANGE, CONTROL, CRUISE, INTERVAL_S, SPEED_MPS, STATE, TERMINAL, of_control, of_state,
};

/// A drive counts as arrived when it is this near to the end [m]: that of an optimum is computed.
const ARRIVED_M: f64 = 1e-5;
/// A blocked robot turns its wheels no more: it has no steps of steering.
const BLOCKED_MPS: f64 = 0.0;

/// How a drive was driven, from the first drive command to 1.75 m before the goal.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct RideFigures {
    /// The objective J, see `docs/ride.md`.
    pub objective: f64,
    /// Sum of the changes of the steering angle between consecutive commands [rad].
    pub steering_total_variation_rad: f64,
    /// Sum of the changes of these changes [rad].
    pub steering_second_difference_rad: f64,
    /// Largest change of the steering angle between consecutive commands [rad].
    pub steering_step_max_rad: f64,
    /// Largest lateral acceleration: speed times the rate of the course [m/s^2].
    pub lateral_acceleration_max_mps2: f64,
    /// Largest change of the lateral acceleration per time [m/s^3].
    pub lateral_jerk_max_mps3: f64,
    /// Smallest distance of the body to an obstacle or wall at the moments of the drive [m].
    pub min_clearance_m: f64,
    /// Time that it took [s].
    pub time_s: f64,
}

/// The figures of a drive, `None` when it did not come as near to the goal as [`BEFORE_GOAL_M`].
pub fn measure(drive: &RideTrace, goal: &Goal) -> Option<RideFigures> {
    let start = drive.advanced_to(drive.start_s()?)?;
    let end = end(&drive.moments, goal.x_m - BEFORE_GOAL_M, start.time_s)?;
    let inside = |moment: &&RideMoment| moment.time_s > start.time_s && moment.time_s < end.time_s;
    let inner: Vec<RideMoment> = drive.moments.iter().filter(inside).copied().collect();
    let nodes: Vec<RideMoment> = std::iter::once(start).chain(inner).chain([end]).collect();
    let acts = |issued: &&Issued| issued.time_s >= start.time_s && issued.time_s < end.time_s;
    let commands: Vec<Issued> = drive.commands.iter().filter(acts).copied().collect();
    let steps: Vec<f64> = steering_steps(&commands);
    let (acceleration, jerk) = lateral(&nodes);
    Some(RideFigures {
        objective: of_states(&nodes, goal) + of_commands(&commands, end.time_s),
        steering_total_variation_rad: steps.iter().map(|step| step.abs()).sum(),
        steering_second_difference_rad: steps.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum(),
        steering_step_max_rad: largest(steps.iter().copied()),
        lateral_acceleration_max_mps2: acceleration,
        lateral_jerk_max_mps3: jerk,
        min_clearance_m: nodes.iter().map(|moment| moment.clearance_m).fold(f64::INFINITY, f64::min),
        time_s: end.time_s - start.time_s,
    })
}

/// The moment at which the drive passes `x_m`, between the moments around it.
fn end(moments: &[RideMoment], x_m: f64, from_s: f64) -> Option<RideMoment> {
    let reached =
        moments.iter().position(|moment| moment.time_s > from_s && moment.state.x >= x_m - ARRIVED_M)?;
    let (after, before) = (moments[reached], moments[reached.checked_sub(1)?]);
    let way = after.state.x - before.state.x;
    let share = if way > 0.0 { ((x_m - before.state.x) / way).clamp(0.0, 1.0) } else { 1.0 };
    let between = |one: f64, other: f64| one + share * (other - one);
    let state = before.state.to_vector().lerp(&after.state.to_vector(), share);
    Some(RideMoment {
        time_s: between(before.time_s, after.time_s),
        state: State::from_vector(&state),
        way_rad: between(before.way_rad, after.way_rad),
        speed_mps: between(before.speed_mps, after.speed_mps),
        clearance_m: before.clearance_m.min(after.clearance_m),
    })
}

/// The part of J that belongs to the states.
fn of_states(nodes: &[RideMoment], goal: &Goal) -> f64 {
    let (Some(start), Some(end)) = (nodes.first(), nodes.last()) else { return 0.0 };
    let reference = |moment: &RideMoment| State {
        x: start.state.x + SPEED_MPS * (moment.time_s - start.time_s),
        y: goal.y_m,
        ..State::default()
    };
    let cost = |weights: &[f64; 5], moment: &RideMoment| of_state(weights, &moment.state, &reference(moment));
    let interval = |pair: &[RideMoment]| {
        (pair[1].time_s - pair[0].time_s) * (cost(&STATE, &pair[0]) + cost(&STATE, &pair[1])) / 2.0
    };
    nodes.windows(2).map(interval).sum::<f64>() + cost(&TERMINAL, end)
}

/// The part of J that belongs to the commands.
fn of_commands(commands: &[Issued], end_s: f64) -> f64 {
    let ends = commands.iter().skip(1).map(|issued| issued.time_s).chain([end_s]);
    let about = |(issued, end_s): (&Issued, f64)| {
        (end_s - issued.time_s) * of_control(&CONTROL, &issued.control, &CRUISE)
    };
    let change = |pair: &[Issued]| {
        let duration = (pair[1].time_s - pair[0].time_s).max(1e-3);
        of_control(&CHANGE, &pair[1].control, &pair[0].control) * INTERVAL_S / duration
    };
    commands.iter().zip(ends).map(about).sum::<f64>() + commands.windows(2).map(change).sum::<f64>()
}

/// Changes of the steering angle between consecutive commands that both drive [rad].
fn steering_steps(commands: &[Issued]) -> Vec<f64> {
    let drives = |control: &Control| control.velocity.abs() > BLOCKED_MPS;
    let both = |pair: &&[Issued]| drives(&pair[0].control) && drives(&pair[1].control);
    let step = |pair: &[Issued]| pair[1].control.steering - pair[0].control.steering;
    commands.windows(2).filter(both).map(step).collect()
}

/// Largest lateral acceleration and jerk, from the change of the course between the moments.
fn lateral(nodes: &[RideMoment]) -> (f64, f64) {
    // The first and the last interval are parts of one: differences over a short time would be noise.
    let whole = nodes.get(1..nodes.len().saturating_sub(1)).unwrap_or_default();
    let course = |moment: &RideMoment| moment.way_rad + moment.state.yaw + moment.state.sideslip;
    let accelerations: Vec<(f64, f64)> = whole
        .windows(2)
        .map(|pair| {
            let duration = pair[1].time_s - pair[0].time_s;
            let speed = f64::midpoint(pair[0].speed_mps, pair[1].speed_mps);
            let middle = f64::midpoint(pair[0].time_s, pair[1].time_s);
            (middle, speed * (course(&pair[1]) - course(&pair[0])) / duration)
        })
        .collect();
    let jerk = accelerations.windows(2).map(|pair| (pair[1].1 - pair[0].1) / (pair[1].0 - pair[0].0));
    (largest(accelerations.iter().map(|(_, value)| *value)), largest(jerk))
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.map(f64::abs).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOAL: Goal =
        Goal { x_m: 11.75, y_m: 0.0, tolerance_m: 0.1, yaw_rad: None, yaw_tolerance_rad: 0.1, stay_s: 1.0 };

    /// A drive along y = `y` at 1 m/s, with these steering angles in turn.
    fn straight(y: f64, steering: &[f64]) -> RideTrace {
        let moment = |index: usize| RideMoment {
            time_s: 0.1 * index as f64,
            state: State { x: 0.1 * index as f64, y, ..State::default() },
            way_rad: 0.0,
            speed_mps: 1.0,
            clearance_m: 0.5,
        };
        let issued = |index: usize| Issued {
            time_s: 0.1 * index as f64,
            control: Control { velocity: 1.0, steering: steering[index % steering.len()] },
        };
        RideTrace { moments: (0..=101).map(moment).collect(), commands: (0..=101).map(issued).collect() }
    }

    #[test]
    fn a_straight_drive_beside_the_line_costs_its_offset() {
        let figures = measure(&straight(0.5, &[0.0]), &GOAL).unwrap();
        // 8 * 0.25 over 10 s, and as much at the end.
        assert!((figures.objective - (20.0 + 2.0)).abs() < 1e-9, "{figures:?}");
        assert!((figures.time_s - 10.0).abs() < 1e-9);
        assert_eq!((figures.min_clearance_m, figures.lateral_acceleration_max_mps2), (0.5, 0.0));
    }

    #[test]
    fn a_zigzag_of_the_steering_is_counted() {
        let figures = measure(&straight(0.0, &[0.01, -0.01]), &GOAL).unwrap();
        // 100 commands: 99 steps of 0.02 rad, 98 changes of them by 0.04 rad.
        assert!((figures.steering_total_variation_rad - 1.98).abs() < 1e-9, "{figures:?}");
        assert!((figures.steering_second_difference_rad - 3.92).abs() < 1e-9);
        assert!((figures.steering_step_max_rad - 0.02).abs() < 1e-12);
        // 10 * 1e-4 over 10 s, and 50 * 4e-4 for each step.
        assert!((figures.objective - (0.01 + 99.0 * 0.02)).abs() < 1e-9, "{}", figures.objective);
    }

    #[test]
    fn a_drive_that_is_late_costs_its_delay() {
        let mut drive = straight(0.0, &[0.0]);
        // Commands act from 0.5 s on, and the robot stands until then: it keeps 1 m/s from there.
        drive.commands.iter_mut().for_each(|issued| issued.time_s += 0.5);
        let rest = RideMoment { speed_mps: 0.0, ..drive.moments[0] };
        drive.moments.iter_mut().for_each(|moment| moment.time_s += 0.5);
        drive.moments.insert(0, rest);
        assert!(measure(&drive, &GOAL).unwrap().objective.abs() < 1e-12);
        // At rest for 1 s after the first command: 1 s behind over 10 s and at the end, and t^2 before.
        drive.moments.iter_mut().skip(1).for_each(|moment| moment.time_s += 1.0);
        drive.moments.insert(1, RideMoment { time_s: 0.5, ..rest });
        drive.moments[2].speed_mps = 0.0;
        let objective = measure(&drive, &GOAL).unwrap().objective;
        assert!((objective - (0.5 + 10.0 + 5.0)).abs() < 1e-6, "{objective}");
    }

    #[test]
    fn a_drive_begins_with_its_first_command_that_drives_wherever_that_is() {
        let mut drive = straight(0.5, &[0.0]);
        drive.moments.iter_mut().for_each(|moment| moment.state.x += 3.0);
        let expected = measure(&drive, &Goal { x_m: 14.75, ..GOAL }).unwrap();
        assert!((expected.objective - 22.0).abs() < 1e-9, "{expected:?}");
        let blocked = Control { velocity: 0.0, steering: 0.0 };
        drive.commands.insert(0, Issued { time_s: -1.0, control: blocked });
        drive.moments.insert(0, RideMoment { time_s: -1.0, speed_mps: 0.0, ..drive.moments[0] });
        assert_eq!(measure(&drive, &Goal { x_m: 14.75, ..GOAL }), Some(expected));
    }

    #[test]
    fn a_turn_has_its_centripetal_acceleration() {
        let mut drive = straight(0.0, &[0.0]);
        for (index, moment) in drive.moments.iter_mut().enumerate() {
            // The course turns by 0.3 rad/s from the moment 50 on: 0.3 m/s^2, gained within 0.1 s.
            moment.state.yaw = 0.03 * (index as f64 - 50.0).max(0.0);
        }
        let figures = measure(&drive, &GOAL).unwrap();
        assert!((figures.lateral_acceleration_max_mps2 - 0.3).abs() < 1e-9, "{figures:?}");
        assert!((figures.lateral_jerk_max_mps3 - 3.0).abs() < 1e-9);
    }

    #[test]
    fn a_drive_that_does_not_come_near_the_goal_has_no_figures() {
        let goal = Goal { x_m: 12.0, ..GOAL };
        assert_eq!(measure(&straight(0.0, &[0.0]), &goal), None);
        assert_eq!(measure(&RideTrace::default(), &GOAL), None);
    }
}
