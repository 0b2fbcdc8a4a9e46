//! Controls that steer past the bodies on chosen sides: the start of a solve.
//!
//! The path leads from the line to a point beside each body and back, in cosines; the controls follow it by pure
//! pursuit. They need not keep the ellipses exactly: the solver does that.

use ocp::{Collocation, roll_out};
use vehicle::{Control, Parameters, State};

use super::course::{Course, From};
use super::ellipse::Ellipse;
use super::sides::{Body, Combination};
use report::ride::objective::INTERVAL_S;

/// How far before a body the path leaves the line, and how far behind it returns [m].
const RAMP_M: f64 = 2.4;
/// Distance that the path keeps in addition to that of the ellipses [m].
const SPARE_M: f64 = 0.03;
/// Distance ahead of the point that is steered to [m].
const LOOK_AHEAD_M: f64 = 0.7;
/// Maximum number of intervals of a guess, for a robot that never arrives.
const MAX_INTERVALS: usize = 1200;

/// Controls of intervals of [`INTERVAL_S`] that follow a path, and the time at which they arrive at the end [s].
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Guess {
    pub(crate) controls: Vec<Control>,
    pub(crate) duration_s: f64,
}

/// The guess for a combination of sides at `speed`; `None` when the path leaves the track.
pub(crate) fn guess(
    course: &Course,
    from: &From,
    bodies: &[Body],
    sides: &Combination,
    speed: f64,
) -> Option<Guess> {
    let knots = knots(course, from, bodies, sides, speed);
    let [low, high] = course.y_range;
    let inside = |knot: &[f64; 2]| (low - 0.1..=high + 0.1).contains(&knot[1]);
    knots[1..].iter().all(inside).then(|| follow(course, from, &knots, speed))
}

/// The points that the path leads through: the start, a point before and behind each body, points on the line.
fn knots(course: &Course, from: &From, bodies: &[Body], sides: &Combination, speed: f64) -> Vec<[f64; 2]> {
    let line = course.goal.y_m;
    let mut places: Vec<[f64; 3]> = Vec::new();
    for (body, &left) in bodies.iter().zip(sides) {
        let met: Vec<(&Ellipse, [f64; 2])> =
            body.ellipses.iter().map(|&ellipse| (ellipse, meeting(ellipse, from, speed))).collect();
        let edge = |(ellipse, [_, y]): &(&Ellipse, [f64; 2])| {
            if left { y + ellipse.b + SPARE_M } else { y - ellipse.b - SPARE_M }
        };
        let edges = met.iter().map(edge);
        let y = if left { edges.fold(line, f64::max) } else { edges.fold(line, f64::min) };
        let along = |pick: fn(f64, f64) -> f64| met.iter().map(|(_, place)| place[0]).reduce(pick);
        if let (Some(first), Some(last)) = (along(f64::min), along(f64::max)) {
            places.push([first, last, y]);
        }
    }
    places.sort_by(|one, other| one[0].total_cmp(&other[0]));
    let mut knots = vec![[from.state.x, from.state.y]];
    for [first, last, y] in places {
        let before = knots[knots.len() - 1][0];
        if first - before > 2.0 * RAMP_M {
            knots.push([before + RAMP_M, line]);
        }
        if first - before > RAMP_M {
            knots.push([first - RAMP_M, if knots.len() == 1 { from.state.y } else { line }]);
        }
        knots.extend([[first, y], [last, y]]);
    }
    let end = knots[knots.len() - 1][0] + RAMP_M;
    knots.push([end, line]);
    knots
}

/// Where the robot meets an ellipse when it drives on at `speed` [m].
fn meeting(ellipse: &Ellipse, from: &From, speed: f64) -> [f64; 2] {
    let ahead = |step: &usize| {
        let time = *step as f64 * INTERVAL_S;
        ellipse.centre_at(from.time_s + time)[0] <= from.state.x + speed * time
    };
    let step = if ellipse.moves() { (0..MAX_INTERVALS).find(ahead).unwrap_or(0) } else { 0 };
    ellipse.centre_at(from.time_s + step as f64 * INTERVAL_S)
}

/// The lateral position of the path at `x`.
fn path_at(knots: &[[f64; 2]], x: f64) -> f64 {
    let after = knots.partition_point(|knot| knot[0] <= x);
    match (after.checked_sub(1).map(|index| knots[index]), knots.get(after)) {
        (Some(before), Some(after)) => {
            let share = (x - before[0]) / (after[0] - before[0]);
            before[1] + (after[1] - before[1]) * (1.0 - (share * std::f64::consts::PI).cos()) / 2.0
        }
        (Some(last), None) => last[1],
        (None, first) => first.map_or(0.0, |first| first[1]),
    }
}

/// Drives along the path until the end of the course.
fn follow(course: &Course, from: &From, knots: &[[f64; 2]], speed: f64) -> Guess {
    let parameters: &Parameters = &course.parameters;
    let collocation = Collocation::default();
    let (mut state, mut controls) = (from.state, Vec::new());
    while state.x < course.end_x_m() && controls.len() < MAX_INTERVALS {
        let control =
            course.bounds.clamp(Control { velocity: speed, steering: pursuit(parameters, knots, &state) });
        let driven = roll_out(parameters, &collocation, &state, &[control], &[INTERVAL_S]);
        let Some(end) = driven.and_then(|driven| driven.states.last().copied()) else { break };
        state = end;
        controls.push(control);
    }
    let over = (state.x - course.end_x_m()) / speed;
    Guess { duration_s: controls.len() as f64 * INTERVAL_S - over, controls }
}

/// The steering angle of an arc to the point of the path ahead.
fn pursuit(parameters: &Parameters, knots: &[[f64; 2]], state: &State) -> f64 {
    let aim = path_at(knots, state.x + LOOK_AHEAD_M) - state.y;
    let angle = aim.atan2(LOOK_AHEAD_M) - state.yaw;
    2.0 * angle.sin() / LOOK_AHEAD_M / parameters.yaw_rate_gain()
}
