//! Runs that continue under another orchestrator.

use shared_types::{Phase, ProcessState, Role};

use super::{assert_robot_is_left_running, state, terminated};
use crate::supervisor::world::{Found, World, policies};
use crate::supervisor::{Action, Event, ProcessExit, Supervisor, VisibleState};

#[test]
fn an_adopted_run_continues_where_it_was() {
    let mut world = World::adopted(policies(), false, Phase::Driving, |role| match role {
        Role::Obstacles => Found::Gone,
        _ => Found::Alive,
    });
    assert_eq!(world.actions, [Action::CleanUp { role: Role::Obstacles }], "no other process is touched");
    assert_eq!(state(&world, Role::Controller), VisibleState::Starting, "it has not been heard yet");
    for role in Role::ALL {
        world.report(*role, ProcessState::Ready);
    }
    let view = world.supervisor.process(Role::Controller).unwrap();
    assert_eq!((view.state, view.restarts, view.pid), (VisibleState::Ready, 2, Some(1013)));
    world.clean(Role::Obstacles);
    assert_eq!(world.place(Role::Obstacles).pending, Some(100), "numbers continue");
    world.die(Role::Controller, ProcessExit::Unknown);
    world.clean(Role::Controller);
    assert_eq!(world.place(Role::Controller).pending, Some(101));
    world.bring_up();
    world.bring_down(true);
}

#[test]
fn an_adopted_process_that_hangs_is_found_although_it_never_reported() {
    let mut world = World::adopted(policies(), false, Phase::Driving, |_| Found::Alive);
    for _ in 0..3 {
        world.advance(100);
        Role::ALL[1..].iter().for_each(|role| world.progress(*role));
        world.send(Event::Tick);
    }
    assert_robot_is_left_running(&world);
}

#[test]
fn an_adopted_start_is_brought_to_its_end() {
    let mut world = World::adopted(policies(), false, Phase::Starting, |role| match role {
        Role::Robot => Found::NeverStarted,
        _ => Found::Alive,
    });
    assert_eq!(world.place(Role::Robot).pending, Some(100));
    world.bring_up();
    assert_eq!(world.phases, [Phase::Starting, Phase::Connecting, Phase::Driving]);
}

#[test]
fn a_robot_that_ended_without_an_orchestrator_ends_the_adopted_run() {
    let mut world = World::adopted(policies(), false, Phase::Driving, |role| match role {
        Role::Robot => Found::Gone,
        _ => Found::Alive,
    });
    assert_eq!(world.failure, Some((Role::Robot, "ended while no orchestrator watched".to_owned())));
    world.bring_down(true);
}

#[test]
fn a_run_that_was_ending_is_ended_by_the_orchestrator_that_adopts_it() {
    let mut world = World::adopted(policies(), false, Phase::Stopping, |role| match role {
        Role::Robot | Role::Actuator => Found::Alive,
        _ => Found::Gone,
    });
    assert_eq!(terminated(&world), [Role::Actuator]);
    world.bring_down(true);
}

#[test]
fn what_is_adopted_twice_or_after_the_end_changes_nothing() {
    let adopted =
        |pid| Event::Adopted { role: Role::Controller, pid: Some(pid), incarnation: 7, restarts: 0 };
    let pid = |supervisor: &Supervisor| supervisor.process(Role::Controller).unwrap().pid;
    let mut supervisor = Supervisor::new(policies());
    supervisor.handle(0, adopted(11));
    supervisor.handle(0, adopted(12));
    assert_eq!(pid(&supervisor), Some(11));
    // A role that was left out starts anew; what is found of it later is another process.
    let mut supervisor = Supervisor::new(policies());
    supervisor.handle(0, Event::Resume { phase: Phase::Starting, last_incarnation: 9 });
    supervisor.handle(0, adopted(11));
    assert_ne!(pid(&supervisor), Some(11));
    let mut supervisor = Supervisor::new(policies());
    supervisor.handle(0, Event::StopRequested);
    supervisor.handle(0, adopted(11));
    assert_eq!(pid(&supervisor), None);
    let actions = supervisor.handle(0, Event::Resume { phase: Phase::Driving, last_incarnation: 9 });
    assert_eq!((actions, supervisor.phase()), (Vec::new(), Phase::Stopping));
}
