//! Deaths, pauses and requested restarts.

use shared_types::{Phase, ProcessState, Role};

use super::{KILLED, state, terminated};
use crate::supervisor::world::{World, policies};
use crate::supervisor::{Action, Event, ProcessExit, Restart, VisibleState};

#[test]
fn a_process_that_dies_while_driving_is_cleaned_up_and_back_at_once() {
    let mut world = World::driving();
    world.die(Role::Controller, KILLED);
    assert_eq!(world.actions, [Action::CleanUp { role: Role::Controller }]);
    assert_eq!(state(&world, Role::Controller), VisibleState::Backoff);
    world.clean(Role::Controller);
    let (role, incarnation) = (Role::Controller, 6);
    assert_eq!(
        world.actions[1..],
        [Action::Grant { role, incarnation }, Action::Spawn { role, incarnation }]
    );
    world.answer(role, true);
    assert_eq!(state(&world, role), VisibleState::Starting);
    for reached in [ProcessState::Attached, ProcessState::Connected, ProcessState::Ready] {
        world.report(role, reached);
    }
    let view = world.supervisor.process(role).unwrap();
    assert_eq!(
        (view.state, view.restarts, view.incarnation, view.pid),
        (VisibleState::Ready, 1, 6, Some(1006))
    );
    assert_eq!(view.last_exit.as_deref(), Some("killed by signal 9 (SIGKILL)"));
    assert_eq!(world.supervisor.phase(), Phase::Driving);
    assert_eq!(world.actions.len(), 3, "the phase is not announced again");
}

#[test]
fn the_pause_runs_from_the_death_and_doubles_until_a_healthy_run() {
    let mut world = World::driving();
    let mut pauses_ms = Vec::new();
    for _ in 0..4 {
        let died_ns = world.now_ns;
        world.die(Role::Estimator, KILLED);
        world.advance(10);
        world.clean(Role::Estimator);
        world.bring_up();
        pauses_ms.push((world.now_ns - died_ns) / 1_000_000);
        if pauses_ms.len() == 3 {
            for _ in 0..30 {
                world.advance(100);
                Role::ALL.iter().for_each(|role| world.progress(*role));
            }
        }
    }
    // 10 ms of clean-up; then 200 and 400 ms of pause; then forgotten after 3 s.
    assert_eq!(pauses_ms, [10, 200, 400, 10]);
    assert_eq!(world.supervisor.process(Role::Estimator).unwrap().restarts, 4);
}

#[test]
fn three_deaths_before_the_first_output_end_the_run() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    for attempt in 1..=3 {
        world.answer(Role::Obstacles, true);
        world.report(Role::Obstacles, ProcessState::Attached);
        world.die(Role::Obstacles, ProcessExit::Code(2));
        assert_eq!(world.failure.is_some(), attempt == 3);
        world.clean(Role::Obstacles);
        world.advance(1_000);
        world.send(Event::Tick);
    }
    let reason = "died 3 times before its first output, last: exit code 2".to_owned();
    assert_eq!(world.failure, Some((Role::Obstacles, reason.clone())));
    assert_eq!(world.supervisor.failure, Some((Role::Obstacles, reason)));
    assert_eq!(state(&world, Role::Obstacles), VisibleState::Failed);
    world.bring_down(true);
    assert_eq!(state(&world, Role::Obstacles), VisibleState::Failed, "it stays visible who was the cause");
}

/// Lets a controller of a driving world be ready and die, `pause_ms` apart, until the run fails; counts the deaths.
fn deaths_until_failure(pause_ms: u64) -> u32 {
    let mut world = World::driving();
    for deaths in 1..20 {
        for _ in 0..pause_ms / 100 {
            world.advance(100);
            Role::ALL.iter().for_each(|role| world.progress(*role));
        }
        world.die(Role::Controller, KILLED);
        if world.failure.is_some() {
            let reason = "died 6 times within 60 s, last: killed by signal 9 (SIGKILL)".to_owned();
            assert_eq!(world.failure, Some((Role::Controller, reason)));
            assert_eq!(state(&world, Role::Controller), VisibleState::Failed);
            return deaths;
        }
        world.clean(Role::Controller);
        world.bring_up();
    }
    u32::MAX
}

#[test]
fn a_process_that_dies_soon_after_it_is_ready_is_given_up_after_five_restarts_in_a_minute() {
    assert_eq!(deaths_until_failure(1_000), 6);
    assert_eq!(deaths_until_failure(9_000), 6, "healthy runs between cost no pause and count all the same");
}

#[test]
fn deaths_that_are_far_apart_end_no_run() {
    assert_eq!(deaths_until_failure(13_000), u32::MAX);
    // The first of six is a minute old.
    assert_eq!(deaths_until_failure(12_000), u32::MAX);
}

#[test]
fn a_requested_restart_does_not_wait_for_the_pause_after_a_death() {
    let mut world = World::driving();
    for _ in 0..2 {
        world.die(Role::Estimator, KILLED);
        world.send(Event::RestartRequested { role: Role::Estimator });
        world.clean(Role::Estimator);
        assert!(world.place(Role::Estimator).pending.is_some(), "it is started at once");
        world.bring_up();
    }
}

#[test]
fn a_run_that_fails_waits_for_the_robot_only_while_it_may_drive() {
    // While it drives, the robot is given time to rest.
    let mut policies_once = policies();
    policies_once[Role::Controller.index()].restart = Restart::Never;
    let mut world = World::new(policies_once.clone(), false);
    world.send(Event::Start);
    world.bring_up();
    world.die(Role::Controller, KILLED);
    assert!(world.failure.is_some());
    assert_eq!(world.supervisor.phase(), Phase::Driving);
    // Without a robot, before the drive, and in lock-step it ends at once.
    let mut world = World::driving();
    world.die(Role::Robot, KILLED);
    assert_eq!(world.supervisor.phase(), Phase::Stopping);
    let mut world = World::new(policies_once.clone(), false);
    world.send(Event::Start);
    Role::ALL.iter().for_each(|role| world.answer(*role, true));
    world.die(Role::Controller, KILLED);
    assert_eq!(world.supervisor.phase(), Phase::Stopping);
    let mut world = World::new(policies_once, true);
    world.send(Event::Start);
    world.bring_up();
    world.die(Role::Controller, KILLED);
    assert_eq!(world.supervisor.phase(), Phase::Stopping);
}

#[test]
fn the_death_of_the_robot_ends_the_run_whatever_its_policy() {
    let mut policies = policies();
    policies[Role::Robot.index()].restart = Restart::Always;
    let mut world = World::new(policies, false);
    world.send(Event::Start);
    world.bring_up();
    world.die(Role::Robot, ProcessExit::Signal(11));
    assert_eq!(world.failure, Some((Role::Robot, "killed by signal 11 (SIGSEGV)".to_owned())));
    world.bring_down(true);
}

#[test]
fn a_process_that_leaves_by_itself_ends_the_run_unless_it_is_always_restarted() {
    let mut world = World::driving();
    world.die(Role::Controller, ProcessExit::Code(0));
    assert_eq!(world.failure, Some((Role::Controller, "ended by itself with exit code 0".to_owned())));
    let mut policies = policies();
    policies[Role::Controller.index()].restart = Restart::Always;
    let mut world = World::new(policies, false);
    world.send(Event::Start);
    world.bring_up();
    world.die(Role::Controller, ProcessExit::Code(0));
    assert_eq!(world.failure, None);
}

#[test]
fn any_death_in_lock_step_ends_the_run() {
    let mut world = World::new(policies(), true);
    world.send(Event::Start);
    world.bring_up();
    world.send(Event::RestartRequested { role: Role::Controller });
    assert!(terminated(&world).is_empty(), "a restart would be a death");
    world.die(Role::Estimator, KILLED);
    assert_eq!(world.failure.as_ref().map(|(role, _)| *role), Some(Role::Estimator));
}

#[test]
fn a_healthy_run_forgets_earlier_failed_starts() {
    let mut world = World::driving();
    let fail_start = |world: &mut World| {
        world.clean(Role::Obstacles);
        world.advance(1_000);
        world.send(Event::Tick);
        world.answer(Role::Obstacles, false);
    };
    world.die(Role::Obstacles, KILLED);
    fail_start(&mut world);
    fail_start(&mut world);
    world.bring_up();
    world.advance(3_000);
    world.die(Role::Obstacles, KILLED);
    fail_start(&mut world);
    fail_start(&mut world);
    assert_eq!(world.failure, None);
    fail_start(&mut world);
    assert!(world.failure.is_some());
}

#[test]
fn a_requested_restart_is_no_death_and_has_no_pause() {
    let mut world = World::driving();
    world.send(Event::RestartRequested { role: Role::Robot });
    world.send(Event::RestartRequested { role: Role::Controller });
    world.send(Event::RestartRequested { role: Role::Controller });
    assert_eq!(world.actions, [Action::Terminate { role: Role::Controller }], "the robot is not restarted");
    world.die(Role::Controller, ProcessExit::Code(0));
    world.clean(Role::Controller);
    assert_eq!(world.place(Role::Controller).pending, Some(6));
    assert_eq!(world.failure, None);
}

#[test]
fn a_requested_restart_ends_a_pause() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    world.answer(Role::Controller, false);
    assert_eq!(state(&world, Role::Controller), VisibleState::Backoff);
    world.send(Event::RestartRequested { role: Role::Controller });
    assert_eq!(world.place(Role::Controller).spawns, 2);
}

#[test]
fn an_event_of_a_dead_incarnation_changes_nothing() {
    let mut world = World::driving();
    let old = world.incarnation(Role::Controller);
    world.die(Role::Controller, KILLED);
    world.clean(Role::Controller);
    world.answer(Role::Controller, true);
    let before = format!("{:?}", world.supervisor);
    let (role, incarnation, exit) = (Role::Controller, old, KILLED);
    world.send(Event::StateReported { role, incarnation, state: ProcessState::Ready });
    world.send(Event::Progress { role, incarnation });
    world.send(Event::Exited { role, incarnation, exit });
    world.send(Event::Spawned { role, incarnation, pid: 1 });
    world.send(Event::CleanedUp { role });
    assert_eq!(format!("{:?}", world.supervisor), before);
}
