//! Processes that hang while the robot drives: the successor resumes from their state, and the goal is reached.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::time::{Duration, Instant};

use emulator::Outcome;
use rustix::process::{Pid, Signal, kill_process};
use scanloop_tests::{SHORT_CORRIDOR, TestSystem, pause};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Suspends a process in the middle of the corridor, resumes it after a time if it still lives, and reaches the goal.
fn reaches_the_goal(role: Role, stopped_for: Duration) {
    let mut system = TestSystem::new(EXECUTABLE);
    system.start(&SHORT_CORRIDOR);
    system.wait_until("it drives fast", |system| system.status().is_some_and(|status| status.scan > 20));
    let pid = system.pid(role);
    system.signal(pid, Signal::STOP);
    let since = Instant::now();
    while since.elapsed() < stopped_for {
        pause();
    }
    // The orchestrator may have killed it.
    let _ = kill_process(Pid::from_raw(pid).unwrap(), Signal::CONT);
    assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
    let report = system.report();
    assert_eq!(report.outcome, Outcome::Reached, "{}", report.reason);
    assert_eq!(report.scans.unaccounted, 0, "{:?}", report.scans);
    let process = report.processes.iter().find(|process| process.role == role.name()).unwrap();
    // One that resumes by itself may do so before it is killed.
    let must_be_killed = stopped_for > Duration::from_millis(500);
    let counts = [u32::from(must_be_killed), 1];
    assert!(counts.contains(&process.restarts), "{:?}", report.processes);
    system.assert_nothing_left();
}

#[test]
fn the_goal_is_reached_after_the_estimator_hung_for_a_second() {
    repeat_when_late(|| {
        reaches_the_goal(Role::Estimator, Duration::from_secs(1));
    });
}

#[test]
fn the_goal_is_reached_after_the_obstacles_hung_for_a_second() {
    repeat_when_late(|| {
        reaches_the_goal(Role::Obstacles, Duration::from_secs(1));
    });
}

#[test]
fn the_goal_is_reached_after_the_controller_hung_for_a_second() {
    repeat_when_late(|| {
        reaches_the_goal(Role::Controller, Duration::from_secs(1));
    });
}

#[test]
fn the_goal_is_reached_after_the_actuator_hung_for_a_second() {
    repeat_when_late(|| {
        reaches_the_goal(Role::Actuator, Duration::from_secs(1));
    });
}

#[test]
fn the_goal_is_reached_by_an_estimator_that_resumes_when_it_is_about_to_be_killed() {
    repeat_when_late(|| {
        reaches_the_goal(Role::Estimator, Duration::from_millis(300));
    });
}

#[test]
fn the_goal_is_reached_after_the_estimator_hung_for_longer_than_a_state_may_be_old() {
    repeat_when_late(|| {
        reaches_the_goal(Role::Estimator, Duration::from_secs(5));
    });
}
