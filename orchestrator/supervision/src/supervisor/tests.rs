//! Traces that a reader can follow.

use shared_types::{Phase, ProcessState, Role};

use super::world::{Found, World, policies};
use super::{Action, Event, Exit, ProcessPolicy, Restart, Supervisor, VisibleState};

const KILLED: Exit = Exit::Signal(9);

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
        world.die(Role::Obstacles, Exit::Code(2));
        assert_eq!(world.failure.is_some(), attempt == 3);
        world.clean(Role::Obstacles);
        world.advance(1_000);
        world.send(Event::Tick);
    }
    let reason = "died 3 times before its first output, last: exit code 2".to_owned();
    assert_eq!(world.failure, Some((Role::Obstacles, reason.clone())));
    assert_eq!(world.supervisor.failure(), Some((Role::Obstacles, reason.as_str())));
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
fn who_becomes_ready_and_soon_dies_is_given_up_after_five_restarts_in_a_minute() {
    assert_eq!(deaths_until_failure(1_000), 6);
    assert_eq!(deaths_until_failure(9_000), 6, "healthy runs between cost no pause and count all the same");
}

#[test]
fn a_run_that_fails_while_it_drives_waits_until_the_robot_rests_but_not_for_ever() {
    let fail = |world: &mut World| {
        world.die(Role::Estimator, KILLED);
        world.die(Role::Controller, Exit::Code(0));
        assert_eq!(world.failure.as_ref().map(|(role, _)| *role), Some(Role::Controller));
        world.clean(Role::Estimator);
        world.send(Event::RestartRequested { role: Role::Obstacles });
    };
    let mut world = World::driving();
    fail(&mut world);
    assert!(world.supervisor.phase() == Phase::Driving && terminated(&world).is_empty());
    world.die(Role::Obstacles, KILLED);
    assert_eq!(world.place(Role::Obstacles).spawns, 1, "nobody is started any more");
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
fn deaths_that_are_far_apart_end_no_run() {
    assert_eq!(deaths_until_failure(13_000), u32::MAX);
}

#[test]
fn another_program_in_the_role_starts_without_its_deaths() {
    let mut world = World::driving();
    for _ in 0..5 {
        world.die(Role::Controller, KILLED);
        world.clean(Role::Controller);
        world.bring_up();
    }
    // The world knows nothing of exchanges.
    let World { mut supervisor, now_ns, .. } = world;
    let (role, incarnation) = (Role::Controller, supervisor.next_incarnation());
    supervisor.handle(now_ns, Event::Replaced { role, pid: 7, incarnation, is_restart: false });
    supervisor.handle(now_ns, Event::Exited { role, incarnation, exit: KILLED });
    assert_eq!(supervisor.failure(), None);
}

#[test]
fn who_goes_round_without_an_output_is_killed_and_counted_as_a_failed_start() {
    let mut world = World::driving();
    let role = Role::Controller;
    for attempt in 1..=3 {
        world.die(role, KILLED);
        if attempt == 1 {
            // It had been ready, so this one was no failed start.
            assert_eq!(world.failure, None);
        }
        world.clean(role);
        world.advance(1_000);
        world.send(Event::Tick);
        world.answer(role, true);
        world.report(role, ProcessState::Attached);
        world.report(role, ProcessState::Connected);
        for _ in 0..99 {
            world.advance(100);
            Role::ALL.iter().for_each(|role| world.progress(*role));
            world.send(Event::Tick);
        }
        assert!(!world.place(role).process.as_ref().unwrap().killed);
        assert_eq!(state(&world, role), VisibleState::Starting);
        world.advance(100);
        world.send(Event::Tick);
        assert!(world.place(role).process.as_ref().unwrap().killed);
    }
    world.die(role, KILLED);
    let reason = "died 3 times before its first output, last: had no output within 10000 ms".to_owned();
    assert_eq!(world.failure, Some((role, reason)));
}

#[test]
fn who_waits_for_others_is_not_blamed_for_having_no_output() {
    let mut world = World::driving();
    for role in [Role::Estimator, Role::Controller] {
        world.die(role, KILLED);
        world.clean(role);
        world.answer(role, true);
        world.report(role, ProcessState::Attached);
        world.report(role, ProcessState::Connected);
    }
    world.actions.clear();
    for _ in 0..100 {
        world.advance(100);
        Role::ALL.iter().for_each(|role| world.progress(*role));
        world.send(Event::Tick);
    }
    assert_eq!(world.actions, [Action::Kill { role: Role::Estimator }], "the controller has no pose");
}

#[test]
fn an_adopted_run_goes_on_where_it_was() {
    let mut world = World::adopted(policies(), false, Phase::Driving, |role| match role {
        Role::Obstacles => Found::Gone,
        _ => Found::Alive,
    });
    assert_eq!(world.actions, [Action::CleanUp { role: Role::Obstacles }], "nobody else is touched");
    assert_eq!(state(&world, Role::Controller), VisibleState::Starting, "it has not been heard yet");
    for role in Role::ALL {
        world.report(*role, ProcessState::Ready);
    }
    let view = world.supervisor.process(Role::Controller).unwrap();
    assert_eq!((view.state, view.restarts, view.pid), (VisibleState::Ready, 2, Some(1013)));
    world.clean(Role::Obstacles);
    assert_eq!(world.place(Role::Obstacles).pending, Some(100), "numbers go on");
    world.die(Role::Controller, Exit::Unknown);
    world.clean(Role::Controller);
    assert_eq!(world.place(Role::Controller).pending, Some(101));
    world.bring_up();
    world.bring_down(true);
}

#[test]
fn an_adopted_process_that_hangs_is_found_although_it_was_never_heard() {
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
fn a_robot_that_ended_while_nobody_watched_ends_the_adopted_run() {
    let mut world = World::adopted(policies(), false, Phase::Driving, |role| match role {
        Role::Robot => Found::Gone,
        _ => Found::Alive,
    });
    assert_eq!(world.failure, Some((Role::Robot, "ended while no orchestrator watched".to_owned())));
    world.bring_down(true);
}

#[test]
fn a_run_that_was_ending_is_ended_by_the_one_who_adopts_it() {
    let mut world = World::adopted(policies(), false, Phase::Stopping, |role| match role {
        Role::Robot | Role::Actuator => Found::Alive,
        _ => Found::Gone,
    });
    assert_eq!(terminated(&world), [Role::Actuator]);
    world.bring_down(true);
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
fn the_death_of_the_robot_ends_the_run_whatever_its_policy() {
    let mut policies = policies();
    policies[Role::Robot.index()].restart = Restart::Always;
    let mut world = World::new(policies, false);
    world.send(Event::Start);
    world.bring_up();
    world.die(Role::Robot, Exit::Signal(11));
    assert_eq!(world.failure, Some((Role::Robot, "killed by signal 11 (SIGSEGV)".to_owned())));
    world.bring_down(true);
}

#[test]
fn a_process_that_leaves_by_itself_ends_the_run_unless_it_is_always_restarted() {
    let mut world = World::driving();
    world.die(Role::Controller, Exit::Code(0));
    assert_eq!(world.failure, Some((Role::Controller, "ended by itself with exit code 0".to_owned())));
    let mut policies = policies();
    policies[Role::Controller.index()].restart = Restart::Always;
    let mut world = World::new(policies, false);
    world.send(Event::Start);
    world.bring_up();
    world.die(Role::Controller, Exit::Code(0));
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
fn a_process_without_progress_is_killed_and_comes_back() {
    let mut world = World::driving();
    let others = || Role::ALL.iter().filter(|role| **role != Role::Controller);
    for _ in 0..3 {
        world.advance(100);
        others().for_each(|role| world.progress(*role));
        assert!(world.actions.is_empty());
        world.send(Event::Tick);
    }
    assert_eq!(world.actions, [Action::Kill { role: Role::Controller }]);
    assert_eq!(state(&world, Role::Controller), VisibleState::Hung);
    world.die(Role::Controller, KILLED);
    world.clean(Role::Controller);
    assert_eq!(world.place(Role::Controller).pending, Some(6));
    assert_eq!(world.failure, None);
}

#[test]
fn a_process_that_gets_no_processor_is_not_hung_but_not_for_ever() {
    let mut world = World::driving();
    let (role, incarnation) = (Role::Controller, world.incarnation(Role::Controller));
    let mut waited_ms = 0;
    while world.actions.is_empty() {
        world.advance(10);
        waited_ms += 10;
        Role::ALL.iter().filter(|other| **other != role).for_each(|other| world.progress(*other));
        let suspects: Vec<_> = world.supervisor.suspects(world.now_ns).collect();
        match waited_ms {
            ..150 => assert_eq!(suspects, []),
            150..300 => assert_eq!(suspects, [(role, incarnation, false)]),
            _ => assert_eq!(suspects.len(), 1),
        }
        if suspects.iter().any(|(.., is_over)| *is_over) {
            world.send(Event::Starved { role, incarnation });
        }
        world.send(Event::Tick);
    }
    assert_eq!((world.actions.as_slice(), waited_ms), (&[Action::Kill { role }][..], 3_000));
}

#[test]
fn a_deadline_is_named_for_each_thing_that_is_due() {
    let mut world = World::new(policies(), false);
    assert_eq!(world.supervisor.next_deadline(), None);
    world.send(Event::Start);
    world.answer(Role::Robot, true);
    let start_ns = world.now_ns;
    assert_eq!(world.supervisor.next_deadline(), Some(start_ns + 10_000_000_000), "start time-out");
    let mut world = World::driving();
    let now_ns = world.now_ns;
    assert_eq!(world.supervisor.next_deadline(), Some(now_ns + 50_000_000), "a look for who hangs");
    world.send(Event::StopRequested);
    assert_eq!(world.supervisor.next_deadline(), Some(now_ns + 1_000_000_000), "kill");
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
fn who_is_attached_waits_for_the_others_without_a_limit() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    world.answer(Role::Actuator, true);
    world.report(Role::Actuator, ProcessState::Attached);
    world.advance(100_000);
    world.send(Event::Tick);
    assert!(!world.place(Role::Actuator).process.as_ref().unwrap().killed);
}

#[test]
fn who_does_not_connect_in_time_is_killed() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    world.advance(10_000);
    Role::ALL.iter().for_each(|role| world.answer(*role, true));
    Role::ALL.iter().for_each(|role| world.report(*role, ProcessState::Attached));
    Role::ALL[1..].iter().for_each(|role| world.report(*role, ProcessState::Connected));
    world.actions.clear();
    world.advance(9_999);
    world.send(Event::Tick);
    assert!(world.actions.is_empty(), "nobody is hung before the loop drives");
    world.advance(1);
    world.send(Event::Tick);
    assert_eq!(world.actions, [Action::Kill { role: Role::Robot }]);
    world.die(Role::Robot, KILLED);
    assert_eq!(world.failure, Some((Role::Robot, "did not start within 10000 ms".to_owned())));
}

#[test]
fn progress_is_expected_from_the_beginning_of_driving_on() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    Role::ALL.iter().for_each(|role| world.answer(*role, true));
    Role::ALL.iter().for_each(|role| world.report(*role, ProcessState::Attached));
    Role::ALL[1..].iter().for_each(|role| world.report(*role, ProcessState::Connected));
    world.advance(200);
    world.send(Event::Tick);
    world.advance(200);
    world.report(Role::Robot, ProcessState::Connected);
    assert_eq!(world.supervisor.phase(), Phase::Driving);
    for _ in 0..6 {
        assert!(!world.actions.iter().any(|action| matches!(action, Action::Kill { .. })));
        assert_eq!(world.supervisor.next_deadline(), Some(world.now_ns + 50_000_000));
        world.advance(50);
        world.send(Event::Tick);
    }
    assert_eq!(world.actions.iter().filter(|action| matches!(action, Action::Kill { .. })).count(), 4);
    assert_eq!(world.failure.as_ref().map(|(role, _)| *role), Some(Role::Robot));
}

#[test]
fn who_is_about_to_end_does_not_count_as_attached() {
    let mut world = World::new(policies(), false);
    world.send(Event::Start);
    Role::ALL.iter().for_each(|role| world.answer(*role, true));
    Role::ALL[2..].iter().for_each(|role| world.report(*role, ProcessState::Attached));
    world.report(Role::Estimator, ProcessState::Attached);
    world.send(Event::RestartRequested { role: Role::Estimator });
    world.report(Role::Robot, ProcessState::Ending);
    world.report(Role::Robot, ProcessState::Attached);
    assert_eq!(world.supervisor.phase(), Phase::Starting, "the estimator is being restarted");
    world.die(Role::Estimator, Exit::Code(0));
    world.clean(Role::Estimator);
    world.answer(Role::Estimator, true);
    world.report(Role::Estimator, ProcessState::Ending);
    assert_eq!(world.supervisor.phase(), Phase::Starting, "the estimator says that it ends");
    world.report(Role::Estimator, ProcessState::Attached);
    assert_eq!(world.supervisor.phase(), Phase::Connecting);
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
fn nobody_is_killed_for_a_late_start_while_the_run_ends() {
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
fn time_in_which_the_supervisor_was_stopped_itself_is_nobodys_silence() {
    for stall_ms in [101, 350, 5_000] {
        let mut world = World::driving();
        for pause_ms in [90, stall_ms, 100, 100] {
            world.advance(pause_ms);
            world.send(Event::Tick);
            assert!(world.actions.is_empty(), "{stall_ms}, {pause_ms}");
        }
        world.advance(10);
        world.send(Event::Tick);
        assert_eq!(world.actions.len(), 5, "300 ms were watched");
    }
}

#[test]
fn a_hang_is_seen_by_a_caller_that_ticks_only_when_a_deadline_comes() {
    let mut world = World::driving();
    for _ in 0..20 {
        world.advance(100);
        Role::ALL.iter().for_each(|role| world.progress(*role));
    }
    for _ in 0..3 {
        world.advance(100);
        Role::ALL[1..].iter().for_each(|role| world.progress(*role));
    }
    assert_eq!(world.supervisor.next_deadline(), Some(world.now_ns));
    world.send(Event::Tick);
    assert_robot_is_left_running(&world);
}

/// A robot that hangs may be moving: the run ends because of it, and it is not killed.
fn assert_robot_is_left_running(world: &World) {
    let [Action::RunFailed { role: Role::Robot, reason }] = &world.actions[..] else {
        panic!("{:?}", world.actions)
    };
    assert!(reason.contains("it is not killed"), "{reason}");
    assert!(world.supervisor.process(Role::Robot).is_some_and(|view| view.pid.is_some()));
}

#[test]
fn a_robot_that_hangs_is_asked_to_end_with_the_others() {
    let mut world = World::driving();
    for _ in 0..4 {
        world.advance(100);
        Role::ALL[1..].iter().for_each(|role| world.progress(*role));
        world.send(Event::Tick);
    }
    assert_robot_is_left_running(&world);
    world.actions.clear();
    world.send(Event::StopRequested);
    for role in [Role::Controller, Role::Obstacles, Role::Estimator, Role::Actuator] {
        world.die(role, Exit::Code(0));
    }
    assert!(world.actions.contains(&Action::Terminate { role: Role::Robot }), "{:?}", world.actions);
    world.die(Role::Robot, Exit::Code(0));
    assert!(world.supervisor.is_finished());
}

#[test]
fn a_hang_is_seen_by_a_caller_that_is_always_a_little_late() {
    let mut world = World::driving();
    let driving_ns = world.now_ns;
    while world.actions.is_empty() {
        world.now_ns = world.supervisor.next_deadline().unwrap();
        world.advance(1);
        world.send(Event::Tick);
    }
    assert_eq!((world.actions.len(), world.now_ns - driving_ns), (5, 301_000_000));
}

#[test]
fn in_lock_step_a_hang_is_seen_after_seconds() {
    let mut world = World::new(policies(), true);
    world.send(Event::Start);
    world.bring_up();
    world.actions.clear();
    let mut waited_ms = 0;
    while world.actions.is_empty() {
        world.advance(100);
        waited_ms += 100;
        world.send(Event::Tick);
    }
    assert_eq!(waited_ms, 5_000);
}

#[test]
fn the_run_is_stopped_in_three_waves() {
    let mut world = World::driving();
    world.send(Event::StopRequested);
    assert_eq!(world.actions[0], Action::Announce(Phase::Stopping));
    let first = [Role::Controller, Role::Obstacles, Role::Estimator];
    assert_eq!(terminated(&world), first);
    world.die(Role::Controller, Exit::Signal(15));
    world.die(Role::Obstacles, Exit::Signal(15));
    assert_eq!(terminated(&world).len(), 3, "the estimator is still there");
    world.die(Role::Estimator, Exit::Signal(15));
    assert_eq!(terminated(&world)[3..], [Role::Actuator]);
    world.die(Role::Actuator, Exit::Code(0));
    assert_eq!(terminated(&world)[4..], [Role::Robot]);
    assert!(!world.supervisor.is_finished());
    world.die(Role::Robot, Exit::Code(0));
    assert_eq!(world.actions.last(), Some(&Action::AllStopped));
    assert!(world.supervisor.is_finished());
    assert!(world.supervisor.processes().all(|view| view.state == VisibleState::Stopped));
}

#[test]
fn who_ignores_the_request_is_killed_after_the_grace_and_again_later() {
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
fn a_requested_restart_is_no_death_and_has_no_pause() {
    let mut world = World::driving();
    world.send(Event::RestartRequested { role: Role::Robot });
    world.send(Event::RestartRequested { role: Role::Controller });
    world.send(Event::RestartRequested { role: Role::Controller });
    assert_eq!(world.actions, [Action::Terminate { role: Role::Controller }], "the robot is not restarted");
    world.die(Role::Controller, Exit::Code(0));
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
fn news_of_a_dead_incarnation_changes_nothing() {
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
        assert_eq!(replace(&mut world), 6, "one number per process, whoever starts it");
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
fn a_role_whose_process_died_is_filled_by_its_replacement_and_nobody_else() {
    let mut world = World::driving();
    world.die(Role::Controller, KILLED);
    replace(&mut world);
    world.clean(Role::Controller);
    assert_eq!(world.place(Role::Controller).pending, None, "the clean-up starts nobody");
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
