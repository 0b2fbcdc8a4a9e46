//! What scenario and system ask for together is kept, or refused with what was asked and what is possible.

use emulator::Outcome;
use scanloop_tests::TestSystem;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// `free` with one `--set` for each of `keys`.
fn set<'a>(keys: &[&'a str]) -> Vec<&'a str> {
    ["free"].into_iter().chain(keys.iter().flat_map(|key| ["--set", *key])).collect()
}

/// `run` and `check` refuse the keys with a message that has these words.
fn refused(keys: &[&str], words: &[&str]) {
    let system = TestSystem::new(EXECUTABLE);
    for command in [&["run", "--lockstep"][..], &["check"]] {
        let output = system.run(&[command, &set(keys)].concat());
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{command:?} {keys:?}: {message}");
        for word in words {
            assert!(message.contains(word), "{command:?} {keys:?}: `{word}` is missing in: {message}");
        }
    }
    system.assert_nothing_left();
}

#[test]
fn a_velocity_that_may_not_be_sent_is_refused_and_the_largest_one_is_driven() {
    let fast = ["vehicle.bounds.velocity_max_mps=2", "controller.cruise_mps=2"];
    refused(&fast, &["controller.cruise_mps = 2 is not allowed: at most 1.428,", "1.4 times"]);
    refused(&fast[..1], &["vehicle.bounds.velocity_max_mps = 2 is not allowed: at most 1.428,"]);
    refused(
        &["actuator.calibration={ custom = { velocity_factor = 2.5, steering = \"identity\" } }"],
        &["0.8,"],
    );
    let system = TestSystem::new(EXECUTABLE);
    let largest =
        ["vehicle.bounds.velocity_max_mps=1.428", "controller.cruise_mps=1.428", "robot.preset=summit"];
    let report = system.lockstep(&set(&largest));
    assert_eq!(report.outcome, Outcome::Reached, "{}", report.reason);
    // 10 m at 1.428 m/s take 7 s, and the robot speeds up and slows down.
    assert!(report.duration_s < 10.0, "{} s", report.duration_s);
}

#[test]
fn a_bend_that_the_robot_cannot_follow_is_refused() {
    let corner = "{ x_m = 8.0, y_m = 3.0, yaw_rad = 1.5708 }";
    let course =
        format!("course={{ waypoints = [{{ yaw_rad = 0.0 }}, {{ x_m = 5.0, yaw_rad = 0.0 }}, {corner}] }}");
    let goal = ["goal.x_m=8.0", "goal.y_m=3.0"];
    refused(
        &[&course, goal[0], goal[1]],
        &["course.waypoints[1] = a bend with a radius of 2.999 m is not allowed: at least 3.267 m"],
    );
}

#[test]
fn a_goal_to_which_no_way_forwards_leads_is_refused_and_the_nearest_one_is_reached() {
    refused(&["start.x_m=8", "goal.x_m=2"], &["goal.x_m = 2 is not allowed: above start.x_m = 8"]);
    refused(
        &["start.x_m=8", "goal.x_m=8", "goal.y_m=0.5"],
        &["goal.x_m = 8 is not allowed: above start.x_m = 8"],
    );
    refused(
        &["goal.x_m=1.8", "goal.y_m=-0.8"],
        &["goal.x_m = 1.8 is not allowed: at least 2.1", "goal.y_m = -0.8"],
    );
    refused(&["track.walls=true", "goal.y_m=1.3"], &["goal.y_m = 1.3 is not allowed: -1.1 to 1.1"]);
    let system = TestSystem::new(EXECUTABLE);
    let report = system.lockstep(&set(&["goal.x_m=2.2", "goal.y_m=-0.8"]));
    assert_eq!(report.outcome, Outcome::Reached, "{}", report.reason);
}

#[test]
fn a_heading_from_which_the_robot_leaves_the_track_is_refused_and_the_largest_one_is_driven() {
    let aside = ["start.x_m=2", "start.y_m=1.0"];
    refused(
        &[&aside[..], &["start.yaw_rad=0.9"]].concat(),
        &["start.yaw_rad = 0.9 is not allowed: at most 0.59"],
    );
    refused(&[&aside[..], &["start.yaw_rad=3.1"]].concat(), &["start.yaw_rad = 3.1 is not allowed"]);
    let system = TestSystem::new(EXECUTABLE);
    for heading in ["start.yaw_rad=0.5", "start.yaw_rad=-1.2"] {
        let report = system.lockstep(&set(&[&aside[..], &[heading]].concat()));
        assert_eq!(report.outcome, Outcome::Reached, "{heading}: {}", report.reason);
    }
}

#[test]
fn the_robot_lands_at_every_rate_that_is_not_refused() {
    refused(&["rate_hz=1"], &["rate_hz = 1 is not allowed: at least 2.206,", "0.453 s"]);
    refused(&["rate_hz=0.5"], &["rate_hz = 0.5 is not allowed: at least 2.206,"]);
    let system = TestSystem::new(EXECUTABLE);
    let long = ["controller.horizon_s=10", "controller.intervals=10"];
    for keys in [
        &["rate_hz=2.206"][..],
        &["rate_hz=2.206", "robot.preset=summit", "seed=3"],
        &["rate_hz=3", "robot.preset=summit"],
        &["rate_hz=50"],
        // A play of the steering that turns the robot for a long period, and stamps that jitter by a third of a short one.
        &["rate_hz=5", "robot.preset=worn", "seed=2"],
        &["rate_hz=150", "robot.preset=summit"],
        &["rate_hz=200", "robot.preset=worn"],
        &[&long[..], &["rate_hz=1"]].concat(),
        &[&long[..], &["rate_hz=1", "robot.preset=summit"]].concat(),
    ] {
        let report = system.lockstep(&set(keys));
        assert_eq!(report.outcome, Outcome::Reached, "{keys:?}: {}", report.reason);
    }
}

#[test]
fn a_tolerance_finer_than_the_way_of_a_period_is_refused_with_the_smallest_one() {
    refused(
        &["rate_hz=2.5", "goal.tolerance_m=0.02"],
        &["goal.tolerance_m = 0.02 is not allowed: at least 0.04,"],
    );
}

#[test]
fn a_timeout_that_is_over_before_the_goal_is_a_warning() {
    let system = TestSystem::new(EXECUTABLE);
    let output = system.run(&[&["check"], &set(&["timeout_s=5"])[..]].concat());
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{message}");
    assert!(
        message.contains("timeout_s = 5 is over before the goal: 9.9 m at 1 m/s take 9.9 s"),
        "{message}"
    );
}
