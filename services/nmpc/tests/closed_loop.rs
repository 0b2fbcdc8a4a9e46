//! The controller in a closed loop with the model, on courses where the right outcome is known.

mod common;

use common::{Body, Noise, Outcome, body, print, print_head, run};
use nmpc::ControllerConfig;
use shared_types::{CommandKind, StopReason};
use vehicle::State;
use vehicle::{Goal, Track};

fn config(goal_x: f64) -> ControllerConfig {
    ControllerConfig { goal: Goal { x_m: goal_x, ..Goal::default() }, ..ControllerConfig::default() }
}

fn noise() -> Noise {
    Noise { position_m: 0.01, yaw_rad: 0.005, obstacle_m: 0.01, seed: 7 }
}

/// Runs a course without and with noise.
fn both(name: &str, config: &ControllerConfig, bodies: &[Body]) -> [Outcome; 2] {
    print_head();
    [("", Noise::default()), (" noisy", noise())].map(|(suffix, noise)| {
        let outcome = run(config, State::default(), bodies, noise);
        print(&format!("{name}{suffix}"), config, &outcome);
        outcome
    })
}

fn assert_reached(name: &str, config: &ControllerConfig, bodies: &[Body]) {
    for outcome in both(name, config, bodies) {
        assert!(outcome.reached(config), "{name}: {:?}", outcome.stopped);
        assert!(outcome.min_clearance >= 0.05, "{name}: {} m", outcome.min_clearance);
        assert!(outcome.largest_y < 1.55, "{name}: {} m", outcome.largest_y);
        assert_eq!(outcome.stops, 0, "{name}: stopped on the way");
    }
}

/// Stopped by the rule, standing, with distance left.
fn assert_stopped(name: &str, config: &ControllerConfig, bodies: &[Body]) {
    for outcome in both(name, config, bodies) {
        assert_eq!(outcome.stopped, Some(StopReason::Blocked), "{name}");
        assert!(outcome.min_clearance >= 0.05, "{name}: {} m", outcome.min_clearance);
        assert_eq!(outcome.stops, 1, "{name}: stop and go");
        assert_eq!(outcome.commands.last().map(|command| command.kind), Some(CommandKind::Stop.wire()));
    }
}

#[test]
fn a_free_track_is_driven_to_the_goal() {
    assert_reached("free", &config(10.0), &[]);
}

#[test]
fn the_corridor_is_driven_past_its_obstacle() {
    assert_reached("corridor", &config(10.0), &[body(5.0, 0.0, 0.1, 0.4)]);
}

#[test]
fn the_largest_obstacle_at_the_nearest_place_is_passed() {
    for y in [0.0, 0.3, -0.6] {
        assert_reached("near, wide", &config(10.0), &[body(3.8, y, 0.1, 0.5)]);
    }
}

#[test]
fn two_obstacles_beside_each_other_are_passed_through_or_around() {
    assert_reached("two, gap", &config(12.0), &[body(5.0, 1.0, 0.2, 0.3), body(5.2, -1.0, 0.2, 0.3)]);
    assert_reached("two, around", &config(12.0), &[body(5.0, 0.1, 0.2, 0.3), body(5.0, -0.4, 0.2, 0.2)]);
    assert_reached("two, in a row", &config(14.0), &[body(5.0, 0.1, 0.1, 0.4), body(8.0, -0.2, 0.1, 0.4)]);
}

#[test]
fn a_slalom_is_driven() {
    let bodies = [body(5.0, 0.25, 0.1, 0.4), body(10.5, -0.25, 0.1, 0.4), body(16.0, 0.25, 0.1, 0.4)];
    assert_reached("slalom", &config(21.0), &bodies);
    let wide = [body(4.0, 0.5, 0.3, 0.5), body(9.5, -0.5, 0.3, 0.5), body(15.0, 0.5, 0.3, 0.5)];
    assert_reached("slalom, wide", &config(20.0), &wide);
}

#[test]
fn a_symmetric_trap_is_left_on_one_side_that_is_held() {
    let config = config(10.0);
    for outcome in both("symmetric", &config, &[body(5.0, 0.0, 0.1, 0.5)]) {
        assert!(outcome.reached(&config));
        let mut sides: Vec<i32> =
            outcome.commands.iter().map(|command| command.side).filter(|side| *side != 0).collect();
        sides.dedup();
        assert_eq!(sides.len(), 1, "the side changed: {sides:?}");
    }
}

#[test]
fn a_closed_track_is_stopped_before() {
    assert_stopped("blocked, wide", &config(12.0), &[body(6.0, 0.0, 0.1, 1.4)]);
    assert_stopped("blocked, two", &config(12.0), &[body(6.0, 0.7, 0.1, 0.5), body(6.0, -0.7, 0.1, 0.5)]);
}

#[test]
fn an_obstacle_that_appears_too_near_is_stopped_before() {
    let sudden = Body { appears_ahead_m: 1.2, ..body(6.0, 0.0, 0.2, 0.4) };
    assert_stopped("sudden", &config(12.0), &[sudden]);
}

#[test]
fn walls_are_not_touched() {
    let track = Track { y_m: [-1.9, 1.9], walls: true, ..Track::default() };
    let config = ControllerConfig { track, ..config(12.0) };
    assert_reached("walls", &config, &[body(5.0, 0.2, 0.1, 0.5)]);
}

#[test]
fn a_crossing_body_is_not_touched() {
    for (speed, start) in [(0.3, -1.8), (0.5, -3.0), (0.8, -4.5), (-0.4, 2.5)] {
        let config = config(12.0);
        let crossing = Body { velocity: [0.0, speed], ..body(6.0, start, 0.3, 0.3) };
        for outcome in both(&format!("crossing {speed}"), &config, &[crossing]) {
            assert!(!outcome.contact && outcome.min_clearance > 0.05);
            assert!(outcome.reached(&config), "{:?}", outcome.stopped);
        }
    }
}

#[test]
fn after_a_blocking_body_has_gone_the_robot_drives_on() {
    let config = config(12.0);
    let gate = Body { disappears_s: 8.0, ..body(6.0, 0.0, 0.1, 1.4) };
    for outcome in both("gate", &config, &[gate]) {
        assert!(outcome.reached(&config));
        assert_eq!(outcome.stops, 1);
    }
}
