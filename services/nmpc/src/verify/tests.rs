//! Each check refuses a plan that violates only this; blocked wheels slide to rest.

use super::*;
use crate::predicted_obstacle::PredictedObstacle;
use nalgebra::Vector2;
use vehicle::State;
use vehicle::geometry::Rectangle;
use vehicle::{Goal, Track};

struct Fixture {
    config: ControllerConfig,
    predicted: Vec<PredictedObstacle>,
}

impl Fixture {
    fn new(predicted: Vec<PredictedObstacle>) -> Self {
        Self { config: ControllerConfig::default(), predicted }
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
    PredictedObstacle { id: 1, centre: [x, y], velocity: [0.0, 0.0], a, b, body, in_plane: None }
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
fn a_robot_at_rest_does_not_start_beside_a_body_that_is_too_near_but_a_moving_one_may_leave_it() {
    // Half of the body and half of the box are 0.2 m wide.
    let beside = |gap_m: f64| Fixture::new(vec![obstacle(0.0, -0.4 - gap_m, 0.05, 0.05)]);
    let near = beside(0.035);
    let verdict_at = |fixture: &Fixture, speed: f64| {
        let scene = fixture.scene();
        verdict(&scene.keeping(scene.margin, speed), &straight(0.5))
    };
    assert_eq!(verdict_at(&near, 0.0).violation, Some((Violation::Obstacle(0), 0.0)));
    assert!(verdict_at(&near, 0.1).holds());
    assert!(verdict_at(&beside(0.045), 0.0).holds());
}

#[test]
fn a_plan_is_refused_that_ends_where_no_turn_back_keeps_the_bounds() {
    // A turn back from half a radian needs 0.36 m at full lock, and the bound is at 1.5 m.
    let fixture = Fixture::new(Vec::new());
    let crawls = |y: f64, yaw: f64, steering: f64| {
        let scene = fixture.from(State { y, yaw, ..State::default() });
        verdict(&scene, &[Control { velocity: 0.1, steering }; 6])
    };
    let outwards = crawls(1.1, 0.4, 0.06);
    assert_eq!(outwards.violation.unwrap().0, Violation::Outside);
    assert!(!outwards.holds());
    assert!(crawls(1.1, 0.4, -0.06).holds(), "it turns back");
    assert_eq!(crawls(-1.1, -0.4, -0.06).violation.unwrap().0, Violation::Outside);
    // Too late already: what does not make it worse is driven.
    assert!(crawls(1.4, 0.5, -0.06).holds());
    assert!(!crawls(1.4, 0.5, 0.0).holds());
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
    let mut beside = obstacle(2.6, 0.0, 1.0, 0.8);
    // The ellipse of a body that is wholly behind the goal would not count.
    beside.body.centre = [1.6, 1.5].into();
    let mut fixture = Fixture::new(vec![beside]);
    fixture.config.goal = Goal { x_m: 1.3, ..Goal::default() };
    let verdict = verdict(&fixture.scene(), &straight(1.0));
    assert!(verdict.holds());
    // The ellipse begins at 1.6 m, in the fourth interval of 0.4533 m.
    assert_eq!(verdict.intervals, 3);
    // The sample that enters it, at 1.612 m, is behind the goal when that is more than 0.03 m before.
    for (goal_x_m, is_cut) in [(1.6, false), (1.57, true)] {
        fixture.config.goal.x_m = goal_x_m;
        let verdict = verify(&fixture.scene(), &straight(1.0), &mut Rollout::default());
        assert_eq!(verdict.violation.is_none(), is_cut, "{goal_x_m}");
    }
}

#[test]
fn a_plan_is_cut_before_the_interval_that_ends_outside_of_a_limit() {
    // 0.5 m/s: 1.561 m after 62 samples of 50 ms, 1.587 m after 63, with which the seventh interval ends; 0.05 m are
    // allowed beyond the end of the track.
    let mut fixture = Fixture::new(Vec::new());
    fixture.config.track.x_m = [-1.0, 1.524];
    let controls = [Control { velocity: 0.5, steering: 0.0 }; 12];
    let verdict = verdict(&fixture.scene(), &controls);
    assert_eq!((verdict.holds(), verdict.intervals), (true, 6), "{verdict:?}");
    // The first interval can't be driven when its last sample is outside.
    fixture.config.track.x_m[1] = 0.165;
    assert!(!super::verify(&fixture.scene(), &controls, &mut Rollout::default()).holds());
}

#[test]
fn walls_are_kept_clear_by_the_corners_of_the_body() {
    let mut fixture = Fixture::new(Vec::new());
    fixture.config.track = Track { y_m: [-1.9, 1.9], walls: true, ..Track::default() };
    let initial = State { y: 1.0, yaw: 0.3, ..State::default() };
    assert!(!verdict(&fixture.from(initial), &straight(1.0)).holds());
}

#[test]
fn each_control_is_within_the_bounds_and_the_speed_limit() {
    let fixture = Fixture::new(Vec::new());
    let mut controls = straight(0.5);
    controls[5].steering = 0.07;
    assert_eq!(verdict(&fixture.scene(), &controls).violation, Some((Violation::Control, 0.0)));
    let limited = Scene { limit_mps: 0.6, ..fixture.scene() };
    assert!(verdict(&limited, &straight(0.6)).holds());
    assert_eq!(verdict(&limited, &straight(0.62)).violation, Some((Violation::Control, 0.0)));
}

#[test]
fn a_state_that_is_no_number_is_refused() {
    let fixture = Fixture::new(Vec::new());
    let spinning = fixture.from(State { yaw_rate: f64::INFINITY, ..State::default() });
    assert_eq!(verdict(&spinning, &straight(1.0)).violation.unwrap().0, Violation::NotFinite);
}

#[test]
fn the_track_ends_along_its_direction_too() {
    let mut fixture = Fixture::new(Vec::new());
    fixture.config.track.x_m = [-1.0, 2.5];
    assert_eq!(verdict(&fixture.scene(), &straight(1.0)).violation.unwrap().0, Violation::Outside);
    assert!(verdict(&fixture.scene(), &straight(0.9)).holds());
}

#[test]
fn the_ellipse_of_a_moving_body_is_where_it_will_be() {
    // It passes with 0.3 m between the bodies, and with the centre of the robot inside of its ellipse.
    let mut oncoming = obstacle(5.0, 0.7, 1.2, 0.8);
    assert!(verdict(&Fixture::new(vec![oncoming]).scene(), &straight(1.0)).holds());
    oncoming.velocity = [-1.0, 0.0];
    let fixture = Fixture::new(vec![oncoming]);
    assert_eq!(verdict(&fixture.scene(), &straight(1.0)).violation.unwrap().0, Violation::Ellipse(0));
}

#[test]
fn the_body_keeps_its_clearance_to_a_wall() {
    let mut fixture = Fixture::new(Vec::new());
    fixture.config.track = Track { y_m: [-1.9, 1.9], walls: true, ..Track::default() };
    fixture.config.theta_m = 0.0;
    // From 0.15 m to 0.06 m with the front corner, and to 0.04 m: 0.05 m are kept.
    let towards = |yaw| fixture.from(State { y: 1.55, yaw, ..State::default() });
    assert!(verdict(&towards(0.03), &straight(1.0)).holds());
    assert_eq!(verdict(&towards(0.036), &straight(1.0)).violation.unwrap().0, Violation::Wall);
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

/// Controls that drive one interval at 1 m/s with a steering angle, then creep straight.
fn creeping(steering: f64) -> [Control; 12] {
    let mut controls = [Control { velocity: 0.1, steering: 0.0 }; 12];
    controls[0] = Control { velocity: 1.0, steering };
    controls
}

/// Brakes with which a robot at 1.05 m/s slides 0.69 m: 1 m/s^2 with a fifth less, the worst case of 1 m/s.
fn weakly_braking(predicted: Vec<PredictedObstacle>) -> Fixture {
    let mut fixture = Fixture::new(predicted);
    fixture.config.vehicle.blocked_deceleration_mps2 = 1.0;
    fixture
}

#[test]
fn the_wheels_may_be_blocked_after_one_period_or_by_the_actuator_or_by_the_dead_man() {
    // From 0.10, 0.15 and 0.20 m, the ends of the plan's samples, the robot slides to 0.79, 0.84 and 0.89 m, and
    // 0.05 m are kept. Half of the body is 0.28 m long, half of the box 0.05 m.
    let slid = |front_m: f64| {
        let fixture = weakly_braking(vec![obstacle(0.28 + front_m + 0.05, 0.0, 0.05, 0.05)]);
        let (_, t) = verdict(&fixture.scene(), &creeping(0.0)).violation.filter(|(_, t)| *t <= VERIFIED_S)?;
        Some((t * 20.0).round() / 20.0)
    };
    assert_eq!([0.82, 0.86, 0.91, 0.96].map(slid), [Some(0.1), Some(0.15), Some(0.2), None]);
}

#[test]
fn a_slide_is_judged_up_to_the_goal_and_not_behind_it() {
    let slid = |goal_x_m: f64| {
        let mut fixture = weakly_braking(vec![obstacle(0.28 + 0.82 + 0.05, 0.0, 0.05, 0.05)]);
        fixture.config.goal.x_m = goal_x_m;
        !verdict(&fixture.scene(), &creeping(0.0)).holds()
    };
    // The first slide begins at 0.1 m, and 0.03 m behind the goal still count.
    assert_eq!([5.0, 0.08, 0.06, -1.0].map(slid), [true, true, false, false]);
}

#[test]
fn along_a_slide_a_body_is_met_where_both_are_at_the_time() {
    // From 1.05 m/s with 0.4 m/s^2 the robot is 0.47 m ahead after 0.5 s and 1.3 m after 2 s, 0.28 m long to each side. The
    // body crosses 0.6 m ahead, at 1.6 m/s.
    let meets = |crosses_s: f64| {
        let mut crossing = obstacle(0.6, -1.6 * crosses_s, 0.05, 0.05);
        crossing.velocity = [0.0, 1.6];
        let mut fixture = weakly_braking(vec![crossing]);
        fixture.config.vehicle.blocked_deceleration_mps2 = 0.5;
        let (scene, control) = (fixture.scene(), Control { velocity: 1.0, steering: 0.0 });
        let start = Sampled { t: 0.0, speed: 1.0, state: State::default() };
        slide_from(&scene, &scene.baseline(), &control, &start).is_some()
    };
    assert_eq!([0.6, 2.0].map(meets), [true, false]);
}

#[test]
fn blocked_wheels_keep_their_angle() {
    // Straight on the robot passes the box with 0.1 m.
    let beside = weakly_braking(vec![obstacle(1.2, 0.5, 0.05, 0.05)]);
    assert!(verdict(&beside.scene(), &creeping(0.0)).holds());
    let (violation, t) = verdict(&beside.scene(), &creeping(0.06)).violation.unwrap();
    assert!(violation == Violation::Obstacle(0) && t < 0.3, "{t}");
}

#[test]
fn a_body_is_where_it_will_be_when_blocked_wheels_slide_there() {
    // It crosses the line after 1.25 s, 0.3 m in front of the plan, where the slide is by then.
    let mut crossing = obstacle(1.35, -2.0, 0.05, 0.05);
    crossing.velocity = [0.0, 1.6];
    let mut fixture = weakly_braking(vec![crossing]);
    assert!(verdict(&fixture.scene(), &creeping(0.0)).holds());
    fixture.config.vehicle.blocked_deceleration_mps2 = 0.5;
    assert_eq!(verdict(&fixture.scene(), &creeping(0.0)).violation.unwrap().0, Violation::Obstacle(0));
}

#[test]
fn a_slide_into_a_body_refuses_a_plan_that_comes_too_near_to_it_only_later() {
    let fixture = weakly_braking(vec![obstacle(0.28 + 0.91 + 0.05, 0.0, 0.05, 0.05)]);
    let mut stops = creeping(0.0);
    assert!(verdict(&fixture.scene(), &stops).violation.is_some_and(|(_, t)| t < 0.3));
    stops[0].velocity = 0.1;
    stops[11].velocity = 1.0;
    let later = verdict(&fixture.scene(), &stops);
    assert!(later.holds() && later.violation.is_some_and(|(_, t)| t > VERIFIED_S), "{later:?}");
}

#[test]
fn a_robot_that_holds_a_control_brakes_to_its_speed_and_drives_on_for_a_ninth_of_an_interval() {
    let fixture = Fixture::new(Vec::new());
    let piece_s = fixture.config.interval_s() / 9.0;
    let deceleration = fixture.config.vehicle.deceleration_max_mps2;
    let last = Sampled { t: 3.0, speed: 1.0, state: State { x: 2.0, ..State::default() } };
    let at = |velocity: f64| hold(&fixture.scene(), &Control { velocity, steering: 0.0 }, &last);
    for (velocity, speed) in [(0.1, 1.0 - deceleration * piece_s), (0.99, 0.99)] {
        let held = at(velocity);
        assert!((held.t - 3.0 - piece_s).abs() < 1e-12 && (held.speed - speed).abs() < 1e-12, "{held:?}");
        assert!((held.state.x - 2.0 - velocity * piece_s).abs() < 1e-9, "{held:?}");
    }
}

/// At 1 Hz a command is held for longer than an interval of its plan.
#[test]
fn a_command_that_is_held_for_longer_than_its_interval_is_verified_for_as_long() {
    let mut fixture = Fixture::new(vec![obstacle(0.28 + 1.2 + 0.05, 0.0, 0.05, 0.05)]);
    assert!(verdict(&fixture.scene(), &creeping(0.0)).holds());
    fixture.config.period_s = 1.0;
    assert_eq!(verdict(&fixture.scene(), &creeping(0.0)).violation.unwrap().0, Violation::Obstacle(0));
    assert!(!verdict(&fixture.scene(), &creeping(0.0)[..1]).holds(), "the rest of a plan may be short");
    // The slide begins so late that a plan would be accepted for it.
    fixture.config.period_s = 2.0;
    fixture.predicted[0].body.centre.x = 0.28 + 3.5 + 0.05;
    fixture.predicted[0].centre[0] = fixture.predicted[0].body.centre.x;
    assert!(!verdict(&fixture.scene(), &creeping(0.0)).holds());
}

/// At 1 Hz the robot drives on at 1 m/s for a second at least, with its front at 0.98 m after 0.7 s.
#[test]
fn what_crosses_while_a_command_is_held_is_met_before_any_slide() {
    let meets = |crosses_s: f64, period_s: f64| {
        let mut crossing = obstacle(1.05, -4.0 * crosses_s, 0.05, 0.05);
        crossing.velocity = [0.0, 4.0];
        let mut fixture = Fixture::new(vec![crossing]);
        fixture.config.period_s = period_s;
        !verdict(&fixture.scene(), &creeping(0.0)).holds()
    };
    assert_eq!(
        [(0.7, 1.0), (-1.0, 1.0), (0.7, 0.1)].map(|(s, period_s)| meets(s, period_s)),
        [true, false, false]
    );
}

#[test]
fn between_two_samples_a_contact_is_found_by_place_angle_and_time() {
    let small = |x: f64, y: f64, velocity_y: f64| {
        let body = Rectangle { centre: Vector2::new(x, y), yaw: 0.0, length: 0.01, width: 0.01 };
        let velocity = [0.0, velocity_y];
        Fixture::new(vec![PredictedObstacle {
            id: 1,
            centre: [x, y],
            velocity,
            a: 0.01,
            b: 0.01,
            body,
            in_plane: None,
        }])
    };
    let found = |fixture: &Fixture, to: State| {
        let scene = fixture.scene();
        let scene = scene.keeping(scene.margin.none(), 0.0);
        let [from, to] =
            [(0.0, State::default()), (0.1, to)].map(|(t, state)| Sampled { t, speed: 0.0, state });
        touched_between(&scene, &scene.baseline(), &from, &to)
    };
    let touched = Some(Violation::Obstacle(0));
    let still = State::default();
    // The body is 0.56 by 0.4 m: it is met on the way, at neither end.
    assert_eq!(found(&small(1.0, 0.0, 0.0), State { x: 2.0, ..still }), touched);
    assert_eq!(found(&small(0.0, 1.0, 0.0), State { y: 2.0, ..still }), touched);
    // A corner is 0.344 m away, front and sides are nearer.
    assert_eq!(found(&small(0.0, 0.33, 0.0), State { yaw: std::f64::consts::FRAC_PI_2, ..still }), touched);
    // It passes through the robot in a tenth of a second.
    assert_eq!(found(&small(0.0, -1.0, 20.0), still), touched);
    assert_eq!(found(&small(0.0, -1.0, 2.0), still), None);
    assert_eq!(found(&small(1.0, 1.0, 0.0), State { x: 2.0, ..still }), None);
}
