//! Outputs that readers drop.

use shared_types::{ProcessState, Role};

use super::{KILLED, state, watch, with_a_new_reader};
use crate::supervisor::world::{World, policies};
use crate::supervisor::{Action, Event, VisibleState};

fn killed(world: &World) -> Vec<Role> {
    let kill = |action: &Action| match action {
        Action::Kill { role } => Some(*role),
        _ => None,
    };
    world.actions.iter().filter_map(kill).collect()
}

#[test]
fn a_process_whose_outputs_are_dropped_is_ended_for_them_and_its_reader_is_not() {
    let mut world = with_a_new_reader();
    world.refuse(Role::Estimator, Role::Obstacles);
    watch(&mut world, 99);
    assert_eq!(killed(&world), []);
    watch(&mut world, 1);
    assert_eq!(killed(&world), [Role::Estimator]);
    world.die(Role::Estimator, KILLED);
    let view = world.supervisor.process(Role::Estimator).unwrap();
    assert_eq!(view.state, VisibleState::Backoff);
}

#[test]
fn a_process_whose_inputs_all_come_too_late_is_not_ended_for_its_silence() {
    let mut world = with_a_new_reader();
    for _ in 0..5 {
        watch(&mut world, 90);
        world.inputs_late(Role::Obstacles);
    }
    assert_eq!(killed(&world), []);
    watch(&mut world, 101);
    assert_eq!(killed(&world), [Role::Obstacles], "they come in time now");
}

#[test]
fn a_reader_that_had_a_valid_input_after_all_ends_the_blame() {
    let mut world = with_a_new_reader();
    world.refuse(Role::Estimator, Role::Obstacles);
    watch(&mut world, 50);
    world.report(Role::Obstacles, ProcessState::Ready);
    watch(&mut world, 200);
    assert_eq!(killed(&world), []);
}

#[test]
fn in_lockstep_a_dropped_output_ends_the_run_with_its_writer() {
    let mut world = World::new(policies(), true);
    world.send(Event::Start);
    world.bring_up();
    world.refuse(Role::Controller, Role::Actuator);
    let reason = "its output was dropped by actuator: not finite".to_owned();
    assert_eq!(world.failure, Some((Role::Controller, reason)));
    world.refuse(Role::Estimator, Role::Obstacles);
    world.bring_down(true);
    assert_eq!(state(&world, Role::Controller), VisibleState::Failed);
    assert_eq!(state(&world, Role::Actuator), VisibleState::Stopped);
}
