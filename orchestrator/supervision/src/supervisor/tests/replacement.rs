//! Processes that a swap has put into a role.

use shared_types::Role;

use super::{KILLED, state, terminated};
use crate::supervisor::world::{World, policies};
use crate::supervisor::{Action, Event, VisibleState};

#[test]
fn another_program_in_the_role_starts_without_its_deaths() {
    let mut world = World::driving();
    for _ in 0..5 {
        world.die(Role::Controller, KILLED);
        world.clean(Role::Controller);
        world.bring_up();
    }
    // The world does not simulate swaps.
    let World { mut supervisor, now_ns, .. } = world;
    let (role, incarnation) = (Role::Controller, supervisor.next_incarnation());
    supervisor.handle(now_ns, Event::Replaced { role, pid: 7, incarnation, is_restart: false });
    supervisor.handle(now_ns, Event::Exited { role, incarnation, exit: KILLED });
    assert_eq!(supervisor.failure, None);
}

/// Another process fills the controller's role, as after a swap.
fn replace(world: &mut World) -> u32 {
    let incarnation = world.supervisor.next_incarnation();
    world.send(Event::Replaced { role: Role::Controller, pid: 77, incarnation, is_restart: false });
    incarnation
}

#[test]
fn a_process_that_was_replaced_is_forgotten_with_its_deaths() {
    for lockstep in [false, true] {
        let mut world = World::new(policies(), lockstep);
        world.send(Event::Start);
        world.bring_up();
        let (role, old) = (Role::Controller, world.incarnation(Role::Controller));
        assert_eq!(replace(&mut world), 6, "one number per process, also when the session starts it");
        world.send(Event::Exited { role, incarnation: old, exit: KILLED });
        let view = world.supervisor.process(role).unwrap();
        assert_eq!(
            (view.state, view.incarnation, view.pid, view.restarts),
            (VisibleState::Ready, 6, Some(77), 0)
        );
        assert_eq!((view.last_exit, world.failure), (None, None));
    }
}

#[test]
fn a_replacement_by_the_same_program_counts_as_a_restart() {
    let mut world = World::driving();
    let (role, incarnation) = (Role::Controller, world.supervisor.next_incarnation());
    world.send(Event::Replaced { role, pid: 77, incarnation, is_restart: true });
    let view = world.supervisor.process(role).unwrap();
    assert_eq!((view.state, view.pid, view.restarts), (VisibleState::Ready, Some(77), 1));
}

#[test]
fn a_replacement_is_watched_and_started_again_under_a_later_number() {
    let mut world = World::driving();
    let (role, incarnation) = (Role::Controller, replace(&mut world));
    for _ in 0..3 {
        assert!(world.actions.is_empty());
        world.advance(100);
        Role::ALL.iter().filter(|other| **other != role).for_each(|other| world.progress(*other));
        world.send(Event::Tick);
    }
    assert_eq!(world.actions, [Action::Kill { role }]);
    let actions = world.supervisor.handle(world.now_ns, Event::Exited { role, incarnation, exit: KILLED });
    assert!(actions.contains(&Action::CleanUp { role }), "{actions:?}");
    let actions = world.supervisor.handle(world.now_ns, Event::CleanedUp { role });
    assert!(actions.contains(&Action::Spawn { role, incarnation: incarnation + 1 }), "{actions:?}");
}

#[test]
fn a_role_whose_process_died_is_filled_by_its_replacement_only() {
    let mut world = World::driving();
    world.die(Role::Controller, KILLED);
    replace(&mut world);
    world.clean(Role::Controller);
    assert_eq!(world.place(Role::Controller).pending, None, "the clean-up starts no process");
    assert_eq!(state(&world, Role::Controller), VisibleState::Ready);
}

#[test]
fn a_replacement_that_comes_after_the_stop_is_ended_with_its_wave() {
    let mut world = World::driving();
    world.send(Event::StopRequested);
    let before = terminated(&world).len();
    let incarnation = world.supervisor.next_incarnation();
    let replaced = Event::Replaced { role: Role::Controller, pid: 77, incarnation, is_restart: false };
    let actions = world.supervisor.handle(world.now_ns, replaced);
    assert_eq!(before, 3);
    assert!(actions.contains(&Action::Terminate { role: Role::Controller }), "{actions:?}");
    let stale = Event::Replaced { role: Role::Controller, pid: 78, incarnation, is_restart: false };
    world.supervisor.handle(world.now_ns, stale);
    assert_eq!(world.supervisor.process(Role::Controller).unwrap().pid, Some(77));
}
