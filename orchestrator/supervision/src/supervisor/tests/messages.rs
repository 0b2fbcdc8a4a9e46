//! What the supervisor tells, and with which numbers.

use shared_types::Role;

use super::{KILLED, state, watch, with_a_new_reader};
use crate::supervisor::world::{World, policies};
use crate::supervisor::{Event, ProcessExit, Severity, Supervisor, VisibleState};

fn said(world: &World, severity: Severity, text: &str) -> bool {
    world.log.iter().any(|(found, line)| *found == severity && line == text)
}

#[track_caller]
fn assert_said(world: &World, severity: Severity, text: &str) {
    assert!(said(world, severity, text), "{:#?}", world.log);
}

#[test]
fn a_start_a_failed_one_and_a_death_are_told_with_their_pauses() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    world.answer(Role::Obstacles, false);
    let text = "obstacles could not be started: command `obstacles` was not found; again in 100 ms";
    assert_said(&world, Severity::Warn, text);
    world.bring_up();
    assert_said(&world, Severity::Info, "controller is ready, incarnation 2");
    world.die(Role::Controller, KILLED);
    let text = "controller died: killed by signal 9 (SIGKILL); restarted in 0 ms";
    assert_said(&world, Severity::Warn, text);
}

#[test]
fn a_process_that_hung_and_one_without_a_valid_output_are_told_by_that() {
    let mut world = World::driving();
    for _ in 0..30 {
        world.advance(100);
        let others = Role::ALL.iter().filter(|role| **role != Role::Controller);
        others.for_each(|role| world.progress(*role));
        world.send(Event::Tick);
    }
    world.die(Role::Controller, KILLED);
    let limit_ms = policies()[Role::Controller.index()].hang_after_ms;
    let text = format!("controller died: made no progress for {limit_ms} ms; restarted in 0 ms");
    assert_said(&world, Severity::Warn, &text);

    let mut world = with_a_new_reader();
    world.refuse(Role::Estimator, Role::Obstacles);
    watch(&mut world, 100);
    assert_said(&world, Severity::Warn, "estimator had no valid output within 10000 ms and is killed");
    world.die(Role::Estimator, KILLED);
    let begin = "estimator died: had no valid output within 10000 ms: ";
    assert!(world.log.iter().any(|(_, line)| line.starts_with(begin)), "{:#?}", world.log);
}

#[test]
fn a_process_that_is_not_connected_yet_is_not_taken_for_one_that_hangs() {
    let mut world = World::driving();
    world.die(Role::Controller, KILLED);
    world.clean(Role::Controller);
    world.answer(Role::Controller, true);
    world.actions.clear();
    for _ in 0..50 {
        world.advance(100);
        let others = Role::ALL.iter().filter(|role| **role != Role::Controller);
        others.for_each(|role| world.progress(*role));
        world.send(Event::Tick);
    }
    assert_eq!(world.actions, []);
    assert_eq!(state(&world, Role::Controller), VisibleState::Starting);
}

#[test]
fn states_have_names_and_numbers_of_processes_go_on() {
    use VisibleState::{Backoff, Failed, Hung, Ready, Shadow, Standby, Starting, Stopped};
    let all = [Starting, Ready, Standby, Shadow, Hung, Backoff, Failed, Stopped];
    let names = all.map(|state| format!("{state:8}|"));
    let expected = [
        "starting|",
        "ready   |",
        "standby |",
        "shadow  |",
        "hung    |",
        "backoff |",
        "failed  |",
        "stopped |",
    ];
    assert_eq!(names, expected);
    let mut supervisor = Supervisor::new(policies());
    assert_eq!(supervisor.last_incarnation(), 0);
    supervisor.handle(0, Event::Start);
    assert_eq!((supervisor.last_incarnation(), supervisor.next_incarnation()), (5, 6));
    assert_eq!(supervisor.last_incarnation(), 6);
    assert_eq!(ProcessExit::Code(0).to_string(), "exit code 0");
}
