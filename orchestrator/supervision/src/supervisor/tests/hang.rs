//! Processes without progress or output.

use shared_types::{Phase, ProcessState, Role};

use super::{KILLED, assert_robot_is_left_running, state};
use crate::supervisor::world::{World, policies};
use crate::supervisor::{Action, Event, ProcessExit, VisibleState};

#[test]
fn progress_without_an_output_ends_in_a_kill_and_a_failed_start() {
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
fn a_driver_without_output_ends_with_what_its_devices_do() {
    let mut world = World::driving();
    let role = Role::Estimator;
    for _ in 0..3 {
        world.die(role, KILLED);
        world.clean(role);
        world.advance(1_000);
        world.send(Event::Tick);
        world.answer(role, true);
        world.report(role, ProcessState::Connected);
        let incarnation = world.place(role).process.as_ref().unwrap().incarnation;
        let text = "connecting: base: no data yet".to_owned();
        world.send(Event::DeviceReported { role, incarnation, text });
        for _ in 0..100 {
            world.advance(100);
            Role::ALL.iter().for_each(|role| world.progress(*role));
            world.send(Event::Tick);
        }
    }
    world.die(role, KILLED);
    let (_, reason) = world.failure.unwrap();
    assert!(
        reason.ends_with("had no output within 10000 ms; its devices: connecting: base: no data yet"),
        "{reason}"
    );
}

#[test]
fn a_process_that_waits_for_inputs_is_not_blamed_for_having_no_output() {
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
fn progress_is_expected_as_soon_as_the_loop_drives() {
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
fn time_in_which_the_caller_was_stopped_is_not_silence() {
    for stall_ms in [101, 350, 5_000] {
        let mut world = World::driving();
        for pause_ms in [90, stall_ms, 100, 100] {
            assert!(world.stall(pause_ms).is_empty(), "{stall_ms}, {pause_ms}");
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
        world.die(role, ProcessExit::Code(0));
    }
    assert!(world.actions.contains(&Action::Terminate { role: Role::Robot }), "{:?}", world.actions);
    world.die(Role::Robot, ProcessExit::Code(0));
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
