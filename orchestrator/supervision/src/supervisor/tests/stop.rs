//! The end of a run.

use shared_types::{Phase, Role};

use super::{KILLED, state, terminated};
use crate::supervisor::world::{World, policies};
use crate::supervisor::{Action, Event, ProcessExit, ProcessPolicy, Supervisor, VisibleState};

#[test]
fn a_run_that_fails_while_it_drives_waits_until_the_robot_rests_but_not_for_ever() {
    let fail = |world: &mut World| {
        world.die(Role::Estimator, KILLED);
        world.die(Role::Controller, ProcessExit::Code(0));
        assert_eq!(world.failure.as_ref().map(|(role, _)| *role), Some(Role::Controller));
        world.clean(Role::Estimator);
        world.send(Event::RestartRequested { role: Role::Obstacles });
    };
    let mut world = World::driving();
    fail(&mut world);
    assert!(world.supervisor.phase() == Phase::Driving && terminated(&world).is_empty());
    world.die(Role::Obstacles, KILLED);
    assert_eq!(world.place(Role::Obstacles).spawns, 1, "no process is started any more");
    world.send(Event::StopRequested);
    assert_eq!(terminated(&world), [Role::Actuator]);
    world.bring_down(true);
    assert_eq!(state(&world, Role::Controller), VisibleState::Failed);

    let mut world = World::driving();
    fail(&mut world);
    for _ in 0..30 {
        world.advance(100);
        Role::ALL.iter().for_each(|role| world.progress(*role));
        world.send(Event::Tick);
    }
    assert_eq!(world.supervisor.phase(), Phase::Stopping, "who asked for nothing is not waited for");
    world.bring_down(true);
}

#[test]
fn no_process_is_killed_for_a_late_start_while_the_run_ends() {
    let slow = |policy: ProcessPolicy| ProcessPolicy { start_timeout_ms: 100, ..policy };
    let mut world = World::new(policies().into_iter().map(slow).collect(), false);
    world.send(Event::Start);
    world.answer(Role::Controller, true);
    world.answer(Role::Actuator, true);
    world.send(Event::StopRequested);
    world.answer(Role::Robot, true);
    world.actions.clear();
    world.advance(500);
    world.send(Event::Tick);
    assert!(world.actions.is_empty(), "{:?}", world.actions);
}

#[test]
fn the_run_is_stopped_in_three_waves() {
    let mut world = World::driving();
    world.send(Event::StopRequested);
    assert_eq!(world.actions[0], Action::Announce(Phase::Stopping));
    let first = [Role::Controller, Role::Obstacles, Role::Estimator];
    assert_eq!(terminated(&world), first);
    world.die(Role::Controller, ProcessExit::Signal(15));
    world.die(Role::Obstacles, ProcessExit::Signal(15));
    assert_eq!(terminated(&world).len(), 3, "the estimator is still there");
    world.die(Role::Estimator, ProcessExit::Signal(15));
    assert_eq!(terminated(&world)[3..], [Role::Actuator]);
    world.die(Role::Actuator, ProcessExit::Code(0));
    assert_eq!(terminated(&world)[4..], [Role::Robot]);
    assert!(!world.supervisor.is_finished());
    world.die(Role::Robot, ProcessExit::Code(0));
    assert_eq!(world.actions.last(), Some(&Action::AllStopped));
    assert!(world.supervisor.is_finished());
    assert!(world.supervisor.processes().all(|view| view.state == VisibleState::Stopped));
}

#[test]
fn a_process_that_ignores_the_request_is_killed_after_the_grace_and_again_later() {
    let mut world = World::driving();
    world.send(Event::StopRequested);
    world.actions.clear();
    for _ in 0..2 {
        world.advance(1_000);
        world.send(Event::Tick);
    }
    let kills: Vec<Action> =
        [Role::Controller, Role::Obstacles, Role::Estimator].map(|role| Action::Kill { role }).into();
    assert_eq!(world.actions, [kills.clone(), kills].concat());
}

#[test]
fn a_run_that_is_stopped_before_its_start_is_over_at_once() {
    let mut supervisor = Supervisor::new(policies());
    let actions = supervisor.handle(0, Event::StopRequested);
    assert_eq!(actions, [Action::Announce(Phase::Stopping), Action::AllStopped]);
    assert!(supervisor.handle(1, Event::Start).is_empty());
}

#[test]
fn a_process_that_appears_after_the_stop_is_ended_in_its_wave() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    world.send(Event::StopRequested);
    world.answer(Role::Robot, true);
    assert!(terminated(&world).is_empty(), "others may still appear");
    world.bring_down(true);
    assert_eq!(terminated(&world).last(), Some(&Role::Robot));
}
