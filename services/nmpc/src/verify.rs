//! Whether a plan may be driven: an independent check of every command before it leaves the controller.
//!
//! The plan's controls are driven through the model from the initial state, without the states of the solver. The
//! trajectory is checked against the obstacles every few centimetres. A robot that is already too near, or outside
//! a bound, may drive a plan that does not make it worse. Behind the goal nothing is checked, because the robot
//! lands there; the plan is cut.
//!
//! Assumed: the obstacles are described correctly. Obstacles out of sight are not known here; they are seen before
//! the plan gets to them, because the scanner reaches 2 m further than the horizon.

use vehicle::bounds::ROUNDING;
use vehicle::{Control, State};

use crate::rollout::{PIECES, Rollout};
use crate::sampled::Sampled;
use crate::scene::{Baseline, Scene, Violation};

/// How far behind the goal the plan is still checked [m].
const BEHIND_GOAL_M: f64 = 0.03;

/// The part of a plan that must be clear [s]: about 20 scans, and four times as long as a stop from full speed.
pub(crate) const VERIFIED_S: f64 = 2.72;

/// When the wheels may be blocked instead of the next command, in scan periods after the start of the plan: when the next
/// scan gives no plan, or after the actuator's timeout.
const BLOCKED_AFTER: [f64; 2] = [1.0, 1.5];
/// Largest step along a slide [m].
const SLIDE_STEP_M: f64 = 0.08;

/// Evidence that a plan may be driven: only [`Verdict::verified`] makes it, and the command takes its controls from it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Verified {
    first: Control,
    intervals: usize,
}

impl Verified {
    /// The control of the first interval.
    pub(crate) fn first(&self) -> Control {
        self.first
    }

    /// How many intervals may be driven, at least one.
    pub(crate) fn intervals(&self) -> usize {
        self.intervals
    }
}

/// The result of a verification.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Verdict {
    first: Control,
    /// How many intervals may be driven.
    pub(crate) intervals: usize,
    /// The first violation and its time, `None` when there is none up to the end or the goal.
    pub(crate) violation: Option<(Violation, f64)>,
}

impl Verdict {
    fn refused(violation: Violation) -> Self {
        Self { first: Control::default(), intervals: 0, violation: Some((violation, 0.0)) }
    }

    /// Whether the plan may be driven. What comes later than [`VERIFIED_S`] is planned again before the robot gets there.
    fn holds(&self) -> bool {
        self.intervals > 0 && self.violation.is_none_or(|(_, t)| t > VERIFIED_S)
    }

    /// The evidence, when the plan may be driven.
    pub(crate) fn verified(&self) -> Option<Verified> {
        let Self { first, intervals, .. } = *self;
        self.holds().then_some(Verified { first, intervals })
    }

    /// The obstacle that the plan comes too near to.
    pub(crate) fn obstacle(&self) -> Option<usize> {
        match self.violation? {
            (Violation::Ellipse(index) | Violation::Obstacle(index), _) => Some(index),
            _ => None,
        }
    }
}

/// Drives `controls` into `rollout` and returns how far they may be driven.
pub(crate) fn verify(scene: &Scene, controls: &[Control], rollout: &mut Rollout) -> Verdict {
    rollout.nodes.clear();
    rollout.samples.clear();
    let Some(&first) = controls.first().filter(|_| scene.initial.is_finite()) else {
        return Verdict::refused(Violation::NotFinite);
    };
    let bounds = scene.bounds();
    if !controls.iter().all(|control| bounds.contains(*control, ROUNDING)) {
        return Verdict::refused(Violation::Control);
    }
    rollout.drive(scene, controls);
    let baseline = scene.baseline();
    let mut behind_goal = false;
    for (index, sample) in rollout.samples.iter().enumerate() {
        behind_goal |= sample.state.x > scene.config.goal.x_m + BEHIND_GOAL_M;
        if let Some(violation) = scene.check(&baseline, sample) {
            let intervals = index.saturating_sub(1) / PIECES;
            let violation = (!behind_goal || intervals == 0).then_some((violation, sample.t));
            let slid = slide(scene, &baseline, controls, &rollout.samples[..index]);
            return Verdict { first, intervals, violation: slid.or(violation) };
        }
    }
    let violation = slide(scene, &baseline, controls, &rollout.samples);
    Verdict { first, intervals: controls.len(), violation }
}

/// The first contact of a robot that blocks its wheels instead of following the plan's next command.
///
/// The wheels keep their angle, so it slides along the arc that it drives then. The block acts one scan period after the
/// start of the plan, or when the actuator's timeout has passed.
fn slide(
    scene: &Scene,
    baseline: &Baseline,
    controls: &[Control],
    samples: &[Sampled],
) -> Option<(Violation, f64)> {
    let deceleration = scene.config.vehicle.blocked_deceleration_mps2;
    let interval_s = scene.config.interval_s();
    for periods in BLOCKED_AFTER {
        let after_s = periods * scene.config.period_s;
        let start = samples.iter().find(|sample| sample.t >= after_s).or(samples.last())?;
        if start.state.x > scene.config.goal.x_m + BEHIND_GOAL_M {
            continue;
        }
        let control = controls[((start.t / interval_s) as usize).min(controls.len() - 1)];
        let curvature = scene.curvature(&control);
        let length = start.speed * start.speed / (2.0 * deceleration);
        let steps = (length / SLIDE_STEP_M).ceil().max(1.0);
        for step in 1..=steps as usize {
            let way = length * step as f64 / steps;
            let left = (start.speed * start.speed - 2.0 * deceleration * way).max(0.0).sqrt();
            let t = start.t + (start.speed - left) / deceleration;
            let state = along_arc(&start.state, curvature, way);
            if let Some(violation) = scene.touched(baseline, scene.margin.base(), t, &state) {
                return Some((violation, start.t));
            }
        }
    }
    None
}

/// The state after `way` metres along an arc.
fn along_arc(state: &State, curvature: f64, way: f64) -> State {
    let course = state.yaw + state.sideslip;
    let middle = course + curvature * way / 2.0;
    State {
        yaw: state.yaw + curvature * way,
        x: state.x + way * middle.cos(),
        y: state.y + way * middle.sin(),
        ..*state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::predicted_obstacle::PredictedObstacle;
    use nalgebra::Vector2;
    use vehicle::State;
    use vehicle::geometry::Rectangle;
    use vehicle::{Goal, Track};

    struct Fixture {
        config: Config,
        predicted: Vec<PredictedObstacle>,
    }

    impl Fixture {
        fn new(predicted: Vec<PredictedObstacle>) -> Self {
            Self { config: Config::default(), predicted }
        }

        fn scene(&self) -> Scene<'_> {
            self.from(State::default())
        }

        fn from(&self, initial: State) -> Scene<'_> {
            Scene::new(&self.config, &self.predicted, initial)
        }
    }

    /// A box 0.4 m wide with an ellipse as small as the box, to see the body's own check.
    fn obstacle(x: f64, y: f64, a: f64, b: f64) -> PredictedObstacle {
        let body = Rectangle { centre: Vector2::new(x, y), yaw: 0.0, length: 0.1, width: 0.4 };
        PredictedObstacle { id: 1, centre: [x, y], velocity: [0.0, 0.0], a, b, body }
    }

    fn straight(velocity: f64) -> [Control; 6] {
        [Control { velocity, steering: 0.0 }; 6]
    }

    fn verdict(scene: &Scene, controls: &[Control]) -> Verdict {
        verify(scene, controls, &mut Rollout::default())
    }

    #[test]
    fn a_free_plan_holds_and_nan_or_a_hard_bound_does_not() {
        let fixture = Fixture::new(Vec::new());
        assert!(verdict(&fixture.scene(), &straight(1.0)).holds());
        assert_eq!(verdict(&fixture.scene(), &straight(1.01)).violation, Some((Violation::Control, 0.0)));
        assert_eq!(verdict(&fixture.scene(), &straight(f64::NAN)).violation, Some((Violation::Control, 0.0)));
        assert!(!verdict(&fixture.scene(), &[]).holds());
        let lost = fixture.from(State { y: f64::NAN, ..State::default() });
        assert_eq!(verdict(&lost, &straight(1.0)).violation, Some((Violation::NotFinite, 0.0)));
    }

    #[test]
    fn the_body_keeps_its_distance_although_the_centre_is_outside_of_the_ellipse() {
        // Half the body, half the box, 0.05 + 0.015 + 0.015 m and no growth at the start; 0.01 m after 2 s.
        let near = Fixture::new(vec![obstacle(2.0, 0.48, 0.05, 0.05)]);
        assert_eq!(verdict(&near.scene(), &straight(1.0)).violation.unwrap().0, Violation::Obstacle(0));
        let far = Fixture::new(vec![obstacle(2.0, 0.51, 0.05, 0.05)]);
        assert!(verdict(&far.scene(), &straight(1.0)).holds());
    }

    #[test]
    fn an_ellipse_is_not_entered_but_may_be_left() {
        let ahead = Fixture::new(vec![obstacle(2.5, 0.0, 1.2, 0.8)]);
        let (violation, t) = verdict(&ahead.scene(), &straight(1.0)).violation.unwrap();
        assert_eq!(violation, Violation::Ellipse(0));
        assert!((1.25..1.45).contains(&t), "{t}");
        let beside = Fixture::new(vec![obstacle(-0.2, 0.78, 1.2, 0.8)]);
        assert!(verdict(&beside.scene(), &straight(1.0)).holds());
    }

    #[test]
    fn a_moving_body_is_where_it_will_be() {
        let mut crossing = obstacle(1.0, -2.0, 0.5, 0.4);
        crossing.velocity = [0.0, 2.0];
        let fixture = Fixture::new(vec![crossing]);
        assert!(!verdict(&fixture.scene(), &straight(1.0)).holds());
        assert!(verdict(&fixture.scene(), &straight(0.1)).holds());
    }

    #[test]
    fn a_robot_outside_of_its_bounds_may_come_back_but_not_go_further() {
        let fixture = Fixture::new(Vec::new());
        let outside = State { y: 1.7, yaw: -0.1, ..State::default() };
        assert!(verdict(&fixture.from(outside), &straight(0.5)).holds());
        let further = State { yaw: 0.1, ..outside };
        assert_eq!(verdict(&fixture.from(further), &straight(0.5)).violation.unwrap().0, Violation::Outside);
    }

    #[test]
    fn behind_the_goal_the_plan_is_cut_and_not_refused() {
        let mut fixture = Fixture::new(vec![obstacle(2.6, 0.0, 1.0, 0.8)]);
        fixture.config.goal = Goal { x_m: 1.3, ..Goal::default() };
        let verdict = verdict(&fixture.scene(), &straight(1.0));
        assert!(verdict.holds());
        // The ellipse begins at 1.6 m, in the fourth interval of 0.4533 m.
        assert_eq!(verdict.intervals, 3);
    }

    #[test]
    fn walls_are_kept_clear_by_the_corners_of_the_body() {
        let mut fixture = Fixture::new(Vec::new());
        fixture.config.track = Track { y_m: [-1.9, 1.9], walls: true, ..Track::default() };
        let initial = State { y: 1.0, yaw: 0.3, ..State::default() };
        assert!(!verdict(&fixture.from(initial), &straight(1.0)).holds());
    }

    #[test]
    fn a_plan_from_which_blocked_wheels_slide_into_a_body_does_not_hold() {
        // The plan ends 0.27 m further on, 0.18 m before the box; from 0.7 m/s the slide takes 0.05 or 0.49 m.
        let mut fixture = Fixture::new(vec![obstacle(0.78, 0.0, 0.05, 0.05)]);
        let fast = |fixture: &Fixture| {
            let scene = fixture.scene();
            verdict(&scene.keeping(scene.margin, 1.0), &straight(0.1))
        };
        assert!(fast(&fixture).holds());
        fixture.config.vehicle.blocked_deceleration_mps2 = 0.5;
        assert_eq!(fast(&fixture).violation.unwrap().0, Violation::Obstacle(0));
        assert!(verdict(&fixture.scene(), &straight(0.1)).holds(), "a slow robot slides less");
    }
}
