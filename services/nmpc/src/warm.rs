//! The initial guess of the solver: the last plan shifted in time, or simple steering along the reference path.
//!
//! Both are driven through the model from the present state, so the guess has no defects. The last plan is the
//! better guess while it passes all obstacles on the same side as the reference path: within one scan little
//! changes. When a side changes, Gauss-Newton would have to cross the obstacle; then the reference path is followed.

use vehicle::{Bounds, Control};

use crate::predicted_obstacle::PredictedObstacle;
use crate::reference::Pace;
use crate::reference_path::ReferencePath;
use crate::rollout::advance_on_course;
use crate::sampled::Sampled;
use crate::scene::Scene;
use crate::side::Passing;

/// Steering correction per lateral distance to the reference path, as curvature [1/m^2].
const OFFSET_GAIN: f64 = 0.6;
/// Steering correction per difference of course to the reference path, as curvature [1/m].
const COURSE_GAIN: f64 = 1.4;

/// Distance in front of an ellipse at which a plan must lead to the side of the reference path [m].
///
/// It exceeds the margins.
const IN_FRONT_M: f64 = 0.3;

/// Fills `shifted` with `controls`, given for equal intervals, as they are `elapsed_s` later.
///
/// An interval that contains a change of the control gets the mean over its time; the last control is held.
pub fn shift(controls: &[Control], interval_s: f64, elapsed_s: f64, shifted: &mut Vec<Control>) {
    shifted.clear();
    let Some(&last) = controls.last() else { return };
    let at = |index: usize| controls.get(index).copied().unwrap_or(last);
    let intervals = (elapsed_s / interval_s).clamp(0.0, 1e3);
    let (whole, share) = (intervals as usize, intervals.fract());
    for index in 0..controls.len() {
        let (early, late) = (at(index + whole), at(index + whole + 1));
        shifted.push(Control {
            velocity: early.velocity + share * (late.velocity - early.velocity),
            steering: early.steering + share * (late.steering - early.steering),
        });
    }
}

/// Fills `controls` with steering that follows the reference path at the given pace.
pub(crate) fn follow(
    scene: &Scene,
    reference_path: &ReferencePath,
    pace: &Pace,
    intervals: usize,
    controls: &mut Vec<Control>,
) {
    controls.clear();
    let (parameters, bounds) = (scene.config.vehicle.parameters(), &scene.config.vehicle.bounds);
    let (gain, interval_s) = (parameters.yaw_rate_gain(), scene.config.interval_s());
    let mut state = scene.initial;
    for _ in 0..intervals {
        let velocity = pace.along(reference_path, state.x);
        let ahead = reference_path.speed_over(state.x, velocity * interval_s);
        let velocity = velocity.min(ahead.max(pace.slowest));
        // The correction aims at the middle of the interval, where its effect is seen.
        let middle = state.x + velocity * state.yaw.cos() * interval_s / 2.0;
        let (_, _, curvature) = reference_path.at(middle);
        let curvature = curvature + scene.config.course.curvature(middle);
        let (y, course, _) = reference_path.at(state.x);
        let wanted =
            curvature + OFFSET_GAIN * (y - state.y) + COURSE_GAIN * (course - state.yaw - state.sideslip);
        let control = bounds.clamp(Control { velocity, steering: finite(wanted / gain) });
        state = advance_on_course(scene, &state, &control, interval_s);
        controls.push(control);
    }
}

/// Clamps `controls` to the hard bounds, which a solver respects only to its accuracy.
pub(crate) fn clamp(bounds: &Bounds, controls: &mut [Control]) {
    controls.iter_mut().for_each(|control| *control = bounds.clamp(*control));
}

/// Whether a plan and the reference path have the same side of every obstacle that both pass.
pub(crate) fn agrees(scene: &Scene, reference_path: &ReferencePath, plan: &[Sampled]) -> bool {
    scene.predicted.iter().all(|obstacle| {
        let sides = side_of(obstacle, plan).zip(reference_path.side_of(obstacle));
        sides.is_none_or(|(driven, planned)| driven == planned)
    })
}

/// Whether a plan that ends in front of an obstacle ends on the side of the reference path.
///
/// A short horizon shows the solver the front of an ellipse first: its guess decides the side then, before the plan
/// passes anything.
pub(crate) fn leads(scene: &Scene, reference_path: &ReferencePath, plan: &[Sampled]) -> bool {
    let Some(end) = plan.last() else { return true };
    scene.predicted.iter().all(|obstacle| {
        let [x, y] = obstacle.centre_at(end.t);
        let is_in_front = (x - obstacle.a - IN_FRONT_M..x).contains(&end.state.x);
        let wanted = reference_path.side_of(obstacle).filter(|_| is_in_front);
        wanted.is_none_or(|side| side == Passing::of(end.state.y, y))
    })
}

/// Side on which a plan passes the obstacle; `None` when it does not reach its centre.
fn side_of(obstacle: &PredictedObstacle, plan: &[Sampled]) -> Option<Passing> {
    for pair in plan.windows(2) {
        let centres = [pair[0].t, pair[1].t].map(|t| obstacle.centre_at(t));
        let (from, to) = (pair[0].state.x - centres[0][0], pair[1].state.x - centres[1][0]);
        if from < 0.0 && to >= 0.0 {
            return Some(Passing::of(pair[1].state.y, centres[1][1]));
        }
    }
    None
}

fn finite(value: f64) -> f64 {
    if value.is_finite() { value } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ControllerConfig;
    use crate::rollout::advance;
    use vehicle::Goal;
    use vehicle::State;

    #[test]
    fn a_plan_is_shifted_in_time_and_holds_its_last_control() {
        let controls = [0.02, -0.04, 0.06].map(|steering| Control { velocity: 1.0, steering });
        let mut shifted = Vec::new();
        shift(&controls, 0.4, 0.1, &mut shifted);
        // A quarter of the interval has gone: three quarters of the first control and one of the second.
        assert!((shifted[0].steering - 0.005).abs() < 1e-12);
        assert!((shifted[2].steering - 0.06).abs() < 1e-12);
        shift(&controls, 0.4, 100.0, &mut shifted);
        assert!(shifted.iter().all(|control| control.steering == 0.06));
    }

    #[test]
    fn following_a_line_brings_the_robot_onto_it() {
        let config =
            ControllerConfig { goal: Goal { x_m: 20.0, ..Goal::default() }, ..ControllerConfig::default() };
        let scene = Scene::new(&config, &[], State { y: 0.2, ..State::default() });
        let pace = Pace { cruise: 1.0, slowest: 0.1, goal_x: 20.0, landing_time: 0.8 };
        let (mut reference_path, mut controls) = (ReferencePath::default(), Vec::new());
        reference_path.set_line(0.0, 0.0, 1.0);
        follow(&scene, &reference_path, &pace, 12, &mut controls);
        let mut state = scene.initial;
        for control in &controls {
            state = advance(&config.vehicle.parameters(), &state, control, config.interval_s());
        }
        assert!(state.y.abs() < 0.05 && state.yaw.abs() < 0.05, "{state:?}");
    }
}
