//! The start of all processes.

use shared_types::{Phase, ProcessState, Role};

use super::{KILLED, state};
use crate::supervisor::world::{World, policies};
use crate::supervisor::{Action, Event, ProcessExit, Supervisor, VisibleState};

#[test]
fn all_processes_are_started_at_once_with_authority_and_the_robot_last() {
    let actions = Supervisor::new(policies()).handle(0, Event::Start);
    let order = [Role::Actuator, Role::Controller, Role::Obstacles, Role::Estimator, Role::Robot];
    let mut expected = vec![Action::Announce(Phase::Starting)];
    for (role, incarnation) in order.into_iter().zip(1..) {
        expected.push(Action::Grant { role, incarnation });
        expected.push(Action::Spawn { role, incarnation });
    }
    assert_eq!(actions, expected);
}

#[test]
fn phases_follow_the_slowest_process() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    for role in Role::ALL {
        world.answer(*role, true);
    }
    for role in &Role::ALL[1..] {
        world.report(*role, ProcessState::Attached);
    }
    assert_eq!(world.supervisor.phase(), Phase::Starting);
    world.report(Role::Robot, ProcessState::Attached);
    assert_eq!(world.supervisor.phase(), Phase::Connecting);
    for role in &Role::ALL[1..] {
        world.report(*role, ProcessState::Connected);
    }
    assert_eq!(world.supervisor.phase(), Phase::Connecting);
    world.report(Role::Robot, ProcessState::Connected);
    assert_eq!(world.supervisor.phase(), Phase::Driving);
    assert_eq!(state(&world, Role::Robot), VisibleState::Starting, "it has published nothing yet");
    world.report(Role::Robot, ProcessState::Ready);
    assert_eq!(state(&world, Role::Robot), VisibleState::Ready);
}

#[test]
fn a_command_that_cannot_be_started_ends_the_run_with_its_name() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    for _ in 0..3 {
        world.answer(Role::Controller, false);
        world.advance(1_000);
        world.send(Event::Tick);
    }
    let (role, reason) = world.failure.clone().unwrap();
    assert_eq!(role, Role::Controller);
    assert_eq!(reason, "could not be started 3 times, last: command `controller` was not found");
    assert_eq!(world.place(Role::Controller).spawns, 3);
}

#[test]
fn a_process_that_does_not_attach_in_time_is_killed_and_counted() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    world.answer(Role::Actuator, true);
    world.advance(9_999);
    world.send(Event::Tick);
    assert!(!world.place(Role::Actuator).process.as_ref().unwrap().killed);
    world.advance(1);
    world.send(Event::Tick);
    assert!(world.place(Role::Actuator).process.as_ref().unwrap().killed);
    world.die(Role::Actuator, KILLED);
    assert_eq!(state(&world, Role::Actuator), VisibleState::Backoff);
}

#[test]
fn time_in_which_the_caller_was_stopped_does_not_count_as_time_to_start_or_to_end() {
    let mut world = World::new(policies(), true);
    world.send(Event::Start);
    Role::ALL.iter().for_each(|role| world.answer(*role, true));
    assert_eq!((world.stall(20_000), world.stall(100)), (vec![], vec![]));
    Role::ALL.iter().for_each(|role| world.report(*role, ProcessState::Attached));
    assert_eq!(world.stall(20_000), [], "to connect");
    Role::ALL.iter().for_each(|role| world.report(*role, ProcessState::Connected));
    assert_eq!(world.stall(20_000), [], "to the first output");
    world.send(Event::StopRequested);
    assert_eq!(world.stall(20_000), [], "to end");
    world.advance(1_000);
    world.send(Event::Tick);
    assert!(world.place(Role::Controller).process.as_ref().unwrap().killed);
}

#[test]
fn an_attached_process_waits_for_the_others_without_a_limit() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    world.answer(Role::Actuator, true);
    world.report(Role::Actuator, ProcessState::Attached);
    world.advance(100_000);
    world.send(Event::Tick);
    assert!(!world.place(Role::Actuator).process.as_ref().unwrap().killed);
    // Nor does one that needs no input.
    world.answer(Role::Robot, true);
    world.report(Role::Robot, ProcessState::Attached);
    world.advance(100_000);
    world.send(Event::Tick);
    assert!(!world.place(Role::Robot).process.as_ref().unwrap().killed);
}

#[test]
fn a_process_that_has_connected_before_the_others_attached_has_no_limit_any_more() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    Role::ALL.iter().for_each(|role| world.answer(*role, true));
    world.report(Role::Actuator, ProcessState::Attached);
    world.report(Role::Actuator, ProcessState::Connected);
    Role::ALL.iter().for_each(|role| world.report(*role, ProcessState::Attached));
    assert_eq!(world.supervisor.phase(), Phase::Connecting);
    Role::ALL[1..].iter().for_each(|role| world.report(*role, ProcessState::Connected));
    world.advance(10_000);
    world.send(Event::Tick);
    let killed = |role: Role| world.place(role).process.as_ref().unwrap().killed;
    assert!(killed(Role::Robot) && !killed(Role::Actuator));
}

#[test]
fn a_process_that_does_not_connect_in_time_is_killed() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    world.advance(10_000);
    Role::ALL.iter().for_each(|role| world.answer(*role, true));
    Role::ALL.iter().for_each(|role| world.report(*role, ProcessState::Attached));
    Role::ALL[1..].iter().for_each(|role| world.report(*role, ProcessState::Connected));
    world.actions.clear();
    world.advance(9_999);
    world.send(Event::Tick);
    assert!(world.actions.is_empty(), "no process is hung before the loop drives");
    world.advance(1);
    world.send(Event::Tick);
    assert_eq!(world.actions, [Action::Kill { role: Role::Robot }]);
    world.die(Role::Robot, KILLED);
    assert_eq!(world.failure, Some((Role::Robot, "did not start within 10000 ms".to_owned())));
}

#[test]
fn a_process_that_is_ending_does_not_count_as_attached() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    Role::ALL.iter().for_each(|role| world.answer(*role, true));
    Role::ALL[2..].iter().for_each(|role| world.report(*role, ProcessState::Attached));
    world.report(Role::Estimator, ProcessState::Attached);
    world.send(Event::RestartRequested { role: Role::Estimator });
    world.report(Role::Robot, ProcessState::Ending);
    world.report(Role::Robot, ProcessState::Attached);
    assert_eq!(world.supervisor.phase(), Phase::Starting, "the estimator is being restarted");
    world.die(Role::Estimator, ProcessExit::Code(0));
    world.clean(Role::Estimator);
    world.answer(Role::Estimator, true);
    world.report(Role::Estimator, ProcessState::Ending);
    assert_eq!(world.supervisor.phase(), Phase::Starting, "the estimator says that it ends");
    world.report(Role::Estimator, ProcessState::Attached);
    assert_eq!(world.supervisor.phase(), Phase::Connecting);
}
