//! Traces that a reader can follow, by subject.

mod adoption;
mod deaths;
mod hang;
mod messages;
mod refusal;
mod replacement;
mod start;
mod stop;

use shared_types::{ProcessState, Role};

use super::world::World;
use super::{Action, Event, ProcessExit, VisibleState};

const KILLED: ProcessExit = ProcessExit::Signal(9);

fn state(world: &World, role: Role) -> VisibleState {
    world.supervisor.process(role).unwrap().state
}

fn terminated(world: &World) -> Vec<Role> {
    let asked = |action: &Action| match action {
        Action::Terminate { role } => Some(*role),
        _ => None,
    };
    world.actions.iter().filter_map(asked).collect()
}

/// A robot that hangs may be moving: the run ends because of it, and it is not killed.
fn assert_robot_is_left_running(world: &World) {
    let [Action::RunFailed { role: Role::Robot, reason }] = &world.actions[..] else {
        panic!("{:?}", world.actions)
    };
    assert!(reason.contains("it is not killed"), "{reason}");
    assert!(world.supervisor.process(Role::Robot).is_some_and(|view| view.pid.is_some()));
}

/// Lets time pass in which all processes make progress.
fn watch(world: &mut World, steps: u32) {
    for _ in 0..steps {
        world.advance(100);
        Role::ALL.iter().for_each(|role| world.progress(*role));
        world.send(Event::Tick);
    }
}

/// A loop whose obstacle description has just been started again and has had no input yet.
fn with_a_new_reader() -> World {
    let mut world = World::driving();
    world.die(Role::Obstacles, KILLED);
    world.clean(Role::Obstacles);
    world.answer(Role::Obstacles, true);
    world.report(Role::Obstacles, ProcessState::Attached);
    world.report(Role::Obstacles, ProcessState::Connected);
    world
}
