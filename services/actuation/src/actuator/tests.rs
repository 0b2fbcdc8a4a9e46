//! Each test asserts on what reaches the wheels.

use proptest::prelude::*;
use shared_types::{CommandKind, Level, Role, Rule, Sample, SolveStatus};
use vehicle::correction::Calibration;

use super::*;

const PERIOD_NS: u64 = 100_000_000;

/// When the command for a scan arrives: a third of a period after its front beam.
fn arrival(scan: u64) -> u64 {
    scan * PERIOD_NS + PERIOD_NS / 3
}

fn command(scan: u64, kind: CommandKind) -> Command {
    let mut header = Header { scan_id: scan, acquired_ns: scan * PERIOD_NS, ..Header::default() };
    header.stage_mut(Role::Controller).published_ns = arrival(scan);
    Command {
        header,
        kind: kind.wire(),
        level: Level::Converged.wire(),
        status: SolveStatus::Converged.wire(),
        verified: 1,
        velocity_mps: 0.5,
        steering_rad: 0.02,
        ..Command::default()
    }
}

fn drive(scan: u64) -> Command {
    command(scan, CommandKind::Drive)
}

fn actuator() -> Actuator {
    Actuator::new(ActuatorConfig::default(), PERIOD_NS).unwrap()
}

/// An actuator that drives, with scan `scan` as the last one answered.
fn driving(scan: u64) -> Actuator {
    let mut actuator = actuator();
    assert!(turns(&actuator.answer(&drive(scan), arrival(scan))));
    actuator
}

fn turns(actuation: &Actuation) -> bool {
    assert!(
        actuation.kind == ActuationKind::Drive.wire() || actuation.sent_velocity_mps == 0.0,
        "blocked wheels with a velocity"
    );
    actuation.kind == ActuationKind::Drive.wire()
}

#[track_caller]
fn assert_blocked(actuation: &Actuation, reason: BlockReason, answers: u32) {
    assert!(!turns(actuation), "{actuation:?}");
    assert_eq!(BlockReason::try_from(actuation.reason), Ok(reason));
    assert_eq!(actuation.answers, answers);
    assert_eq!((actuation.desired_velocity_mps, actuation.sent_velocity_mps), (0.0, 0.0));
}

#[test]
fn a_valid_command_is_corrected_and_sent_with_its_header() {
    let actuation = actuator().answer(&drive(1), arrival(1));
    assert!(turns(&actuation));
    assert_eq!((actuation.desired_velocity_mps, actuation.desired_steering_rad), (0.5, 0.02));
    assert!((actuation.sent_velocity_mps - 0.7).abs() < 1e-12);
    // 0.02 / 1.2 plus what the cubic part of the map takes away.
    assert!((actuation.sent_steering_rad - 0.0167).abs() < 2e-4, "{}", actuation.sent_steering_rad);
    assert_eq!((actuation.header.scan_id, actuation.answers, actuation.refused), (1, 1, 0));
    assert_eq!(actuation.header.stage(Role::Controller).published_ns, arrival(1));
}

#[test]
fn the_identity_calibration_sends_what_is_desired() {
    let config = ActuatorConfig { calibration: Calibration::Identity, ..ActuatorConfig::default() };
    let actuation = Actuator::new(config, PERIOD_NS).unwrap().answer(&drive(1), arrival(1));
    assert_eq!((actuation.sent_velocity_mps, actuation.sent_steering_rad), (0.5, 0.02));
}

#[test]
fn stop_and_land_block_the_wheels_with_their_reasons() {
    let mut actuator = driving(1);
    let stop = Command { reason: StopReason::Blocked.wire(), ..command(2, CommandKind::Stop) };
    let actuation = actuator.answer(&stop, arrival(2));
    assert_blocked(&actuation, BlockReason::Commanded, 1);
    assert_eq!(actuation.stop_reason, StopReason::Blocked.wire());
    assert_blocked(&actuator.answer(&command(3, CommandKind::Land), arrival(3)), BlockReason::Landed, 1);
    assert_eq!(actuator.state().refused, 0, "a stop is a valid command");
    assert!(turns(&actuator.answer(&drive(4), arrival(4))), "the reason is gone");
}

#[test]
fn blocked_wheels_keep_their_steering_angle() {
    let mut actuator = driving(1);
    let sent = actuator.answer(&drive(2), arrival(2)).sent_steering_rad;
    let blocked = actuator.answer(&command(3, CommandKind::Stop), arrival(3));
    assert_eq!((blocked.sent_steering_rad, blocked.desired_steering_rad), (sent, 0.02));
}

#[test]
fn whatever_is_wrong_with_a_command_blocks_the_wheels() {
    type Spoil = fn(&mut Command);
    let wrong: [(&str, Spoil); 14] = [
        ("velocity NaN", |c| c.velocity_mps = f64::NAN),
        ("velocity infinite", |c| c.velocity_mps = f64::INFINITY),
        ("steering NaN", |c| c.steering_rad = -f64::NAN),
        ("steering infinite", |c| c.steering_rad = f64::NEG_INFINITY),
        ("not verified", |c| c.verified = 0),
        ("verified by an unknown number", |c| c.verified = 2),
        ("unknown kind", |c| c.kind = 3),
        ("unknown level", |c| c.level = 9),
        ("unknown status", |c| c.status = 77),
        ("unknown reason", |c| c.reason = u32::MAX),
        ("too fast", |c| c.velocity_mps = 1.0 + 2e-6),
        ("too slow for the model", |c| c.velocity_mps = 0.1 - 2e-6),
        ("backwards", |c| c.velocity_mps = -0.5),
        ("too much steering", |c| c.steering_rad = -0.06 - 2e-6),
    ];
    for (name, spoil) in wrong {
        let mut actuator = driving(1);
        let mut command = drive(2);
        spoil(&mut command);
        let actuation = actuator.answer(&command, arrival(2));
        assert_blocked(&actuation, BlockReason::InvalidCommand, 1);
        assert_eq!(actuation.refused, 1, "{name}");
        // Without it there was no valid command for two periods, so two in a row are needed.
        assert_blocked(&actuator.answer(&drive(3), arrival(3)), BlockReason::NoCommand, 1);
        assert!(turns(&actuator.answer(&drive(4), arrival(4))), "{name}: the reason is gone");
    }
}

#[test]
fn a_refused_command_is_told_which_rule_it_fails() {
    type Spoil = fn(&mut Command);
    let wrong: [(Rule, &str, Spoil); 12] = [
        (Rule::NotFinite, "steering_rad", |c| c.steering_rad = f64::NAN),
        (Rule::NotVerified, "verified", |c| c.verified = 0),
        (Rule::UnknownValue, "Level", |c| c.level = 9),
        (Rule::OutOfRange, "plan_start_ms", |c| {
            (c.plan_length, c.plan_start_ns) = (13, c.header.acquired_ns - 1);
        }),
        (Rule::OutOfRange, "plan_start_ms", |c| {
            (c.plan_length, c.plan_start_ns) = (13, c.header.acquired_ns + 1_000_000_001);
        }),
        (Rule::OutOfRange, "reason", |c| c.reason = StopReason::Blocked.wire()),
        (Rule::OutsideBounds, "velocity_mps", |c| c.velocity_mps = 1.5),
        (Rule::OutsideBounds, "velocity_mps", |c| c.velocity_mps = -0.31),
        (Rule::OutsideBounds, "steering_rad", |c| c.steering_rad = -0.5),
        (Rule::StillRolling, "velocity_mps", |c| c.velocity_mps = -0.3),
        (Rule::AnsweredBefore, "header.scan_id", |c| c.header.scan_id = 1),
        (Rule::FromTheFuture, "ahead_ms", |c| c.header.acquired_ns += 10 * PERIOD_NS),
    ];
    for (rule, field, spoil) in wrong {
        let mut actuator = driving(1);
        assert_eq!(actuator.refusal(), None);
        let mut command = drive(2);
        spoil(&mut command);
        actuator.answer(&command, arrival(2));
        let fault = actuator.refusal().expect("it is refused");
        assert_eq!((fault.rule(), fault.finding().0), (rule, field));
        actuator.answer(&drive(3), arrival(3));
        assert_eq!(actuator.refusal(), None, "of the last command only");
    }
    let mut actuator = driving(1);
    actuator.answer(&drive(2), arrival(9));
    assert_eq!(actuator.refusal().map(Fault::rule), Some(Rule::TooOld));
}

/// A command to drive backwards.
fn reverse(scan: u64) -> Command {
    Command { velocity_mps: -0.2, ..drive(scan) }
}

#[test]
fn a_robot_drives_the_other_way_only_after_blocked_wheels_have_stopped_it() {
    let mut actuator = driving(1);
    // 0.5 m/s at 5 m/s^2 and the delay: 120 ms after the first block, which the refusal is itself.
    for scan in [2, 3] {
        assert_blocked(&actuator.answer(&reverse(scan), arrival(scan)), BlockReason::InvalidCommand, 1);
        assert_eq!(actuator.refusal().map(Fault::rule), Some(Rule::StillRolling));
    }
    actuator.answer(&command(4, CommandKind::Stop), arrival(4));
    let backwards = actuator.answer(&reverse(5), arrival(5));
    assert!(turns(&backwards));
    assert!((backwards.desired_velocity_mps, backwards.sent_velocity_mps) == (-0.2, 1.4 * -0.2));
    assert!(turns(&actuator.answer(&reverse(6), arrival(6))));
    assert_blocked(&actuator.answer(&drive(7), arrival(7)), BlockReason::InvalidCommand, 1);
    // 0.2 m/s: 60 ms.
    actuator.answer(&command(8, CommandKind::Stop), arrival(8));
    assert!(turns(&actuator.answer(&drive(9), arrival(9))));
}

#[test]
fn a_vehicle_without_reverse_refuses_to_drive_backwards() {
    let bounds = vehicle::Bounds { reverse_max_mps: 0.0, ..vehicle::Bounds::default() };
    let vehicle = vehicle::Description { bounds, ..vehicle::Description::default() };
    let mut actuator =
        Actuator::new(ActuatorConfig { vehicle, ..ActuatorConfig::default() }, PERIOD_NS).unwrap();
    assert_blocked(&actuator.answer(&reverse(1), arrival(1)), BlockReason::InvalidCommand, 1);
    let fault = Fault::OutsideBounds { field: "velocity_mps", value: -0.2, lowest: 0.1, highest: 1.0 };
    assert_eq!(actuator.refusal(), Some(&fault));
}

#[test]
fn a_velocity_outside_of_its_limits_is_refused_with_those_of_its_direction() {
    for (value, lowest, highest) in
        [(0.0, 0.1, 1.0), (1.1, 0.1, 1.0), (-0.05, -0.3, -0.1), (-0.31, -0.3, -0.1)]
    {
        let mut actuator = actuator();
        let wrong = Command { velocity_mps: value, ..drive(1) };
        assert_blocked(&actuator.answer(&wrong, arrival(1)), BlockReason::InvalidCommand, 1);
        let fault = Fault::OutsideBounds { field: "velocity_mps", value, lowest, highest };
        assert_eq!(actuator.refusal(), Some(&fault));
    }
}

#[test]
fn a_silence_because_commands_were_dropped_has_that_reason() {
    let mut first = actuator();
    assert_eq!(first.tick(1_000), None);
    first.note_dropped();
    assert_blocked(&first.tick(1_001 + PERIOD_NS * 3 / 2).unwrap(), BlockReason::InvalidCommand, 0);
    let mut later = driving(3);
    later.note_dropped();
    assert_blocked(&later.tick(arrival(5)).unwrap(), BlockReason::InvalidCommand, 0);
    later.answer(&drive(6), arrival(6));
    later.answer(&drive(7), arrival(7));
    assert_blocked(&later.tick(arrival(9)).unwrap(), BlockReason::NoCommand, 0);
}

#[test]
fn a_stop_of_a_broken_controller_still_blocks() {
    let mut stop = command(2, CommandKind::Stop);
    stop.velocity_mps = f64::NAN;
    assert_blocked(&driving(1).answer(&stop, arrival(2)), BlockReason::InvalidCommand, 1);
}

#[test]
fn rounding_beyond_a_limit_is_cut_off() {
    let mut command = drive(1);
    (command.velocity_mps, command.steering_rad) = (1.0 + 0.9e-6, -0.06 - 0.9e-6);
    let actuation = actuator().answer(&command, arrival(1));
    assert!(turns(&actuation));
    assert_eq!((actuation.desired_velocity_mps, actuation.desired_steering_rad), (1.0, -0.06));
}

#[test]
fn a_scan_is_answered_once() {
    let mut actuator = driving(5);
    for repeated in [5, 4, 1, 0] {
        let actuation = actuator.answer(&drive(repeated), arrival(5) + 1);
        assert_blocked(&actuation, BlockReason::StaleCommand, 0);
        assert_eq!(actuation.header.scan_id, 5, "the header is that of the last command answered");
    }
    assert_eq!(actuator.state().refused, 4);
    let mut refused_first = driving(1);
    refused_first.answer(&Command { verified: 0, ..drive(2) }, arrival(2));
    assert_blocked(&refused_first.answer(&drive(2), arrival(2)), BlockReason::StaleCommand, 0);
}

#[test]
fn after_a_wrong_number_the_second_scan_is_answered() {
    for wrong in [9, 517, 1 << 40] {
        let mut actuator = driving(4);
        let mut forged = drive(5);
        forged.header.scan_id = wrong;
        actuator.answer(&forged, arrival(5));
        assert_blocked(&actuator.answer(&drive(6), arrival(6)), BlockReason::StaleCommand, 0);
        assert_blocked(&actuator.answer(&drive(7), arrival(7)), BlockReason::NoCommand, 1);
        assert!(turns(&actuator.answer(&drive(8), arrival(8))));
        assert_blocked(&actuator.answer(&drive(7), arrival(8) + 1), BlockReason::StaleCommand, 0);
    }
}

#[test]
fn two_old_commands_in_a_row_are_no_doubt() {
    // Both were taken before the last one answered, or one at the same time; or the second has its very number.
    let late = |scan: u64, acquired_ns: u64| {
        let mut command = drive(scan);
        command.header.acquired_ns = acquired_ns;
        command
    };
    let acquired_ns = drive(5).header.acquired_ns;
    for pair in [
        [drive(2), drive(3)],
        [late(2, acquired_ns), late(3, acquired_ns)],
        [late(4, acquired_ns + 1), late(5, acquired_ns + 2)],
    ] {
        let mut actuator = driving(5);
        for command in pair {
            assert_blocked(&actuator.answer(&command, arrival(5) + 1), BlockReason::StaleCommand, 0);
        }
    }
}

#[test]
fn a_refusal_names_by_how_much() {
    let mut actuator = driving(1);
    actuator.answer(&drive(2), drive(2).header.acquired_ns + 450_000_000);
    assert_eq!(actuator.refusal().map(Fault::finding), Some(("age_ms", 450.0)));
    let mut future = drive(3);
    future.header.acquired_ns = arrival(3) + 250_000_000;
    actuator.answer(&future, arrival(3));
    assert_eq!(actuator.refusal().map(Fault::finding), Some(("ahead_ms", 250.0)));
    let plan_start_ns = drive(4).header.acquired_ns + 1_250_000_000;
    actuator.answer(&Command { plan_length: 13, plan_start_ns, ..drive(4) }, arrival(4));
    assert_eq!(actuator.refusal().map(Fault::finding), Some(("plan_start_ms", 1_250.0)));
    // At a limit of the velocity, the steering angle is what is wrong.
    for (scan, velocity_mps) in [(5, 0.1 - 0.5e-6), (6, 1.0 + 0.5e-6)] {
        actuator.answer(&Command { velocity_mps, steering_rad: -0.5, ..drive(scan) }, arrival(scan));
        let expected =
            Fault::OutsideBounds { field: "steering_rad", value: -0.5, lowest: -0.06, highest: 0.06 };
        assert_eq!(actuator.refusal(), Some(&expected));
    }
}

#[test]
fn a_command_for_an_old_scan_is_refused_at_the_limit_of_its_age() {
    let age_limit = 3 * PERIOD_NS;
    let acquired = drive(7).header.acquired_ns;
    assert!(turns(&actuator().answer(&drive(7), acquired + age_limit)));
    let actuation = actuator().answer(&drive(7), acquired + age_limit + 1);
    assert_blocked(&actuation, BlockReason::StaleCommand, 1);
}

#[test]
fn a_command_from_the_future_does_not_shut_out_the_present() {
    let mut actuator = driving(1);
    let mut future = drive(2);
    (future.header.scan_id, future.header.acquired_ns) = (u64::MAX, u64::MAX);
    assert_blocked(&actuator.answer(&future, arrival(2)), BlockReason::InvalidCommand, 0);
    assert!(turns(&actuator.answer(&drive(2), arrival(2))));
    // A period ahead is what a clock may be off.
    let mut ahead = drive(3);
    ahead.header.acquired_ns = arrival(3) + PERIOD_NS;
    assert!(turns(&actuator.clone().answer(&ahead, arrival(3))));
    ahead.header.acquired_ns += 1;
    assert_blocked(&actuator.answer(&ahead, arrival(3)), BlockReason::InvalidCommand, 0);
}

#[test]
fn silence_of_one_and_a_half_periods_blocks_and_is_repeated_once_per_period() {
    let mut actuator = driving(3);
    let valid = arrival(3);
    assert_eq!(actuator.tick(valid + PERIOD_NS * 3 / 2), None);
    let block = actuator.tick(valid + PERIOD_NS * 3 / 2 + 1).unwrap();
    assert_blocked(&block, BlockReason::NoCommand, 0);
    assert_eq!(block.header.scan_id, 3);
    let told_ns = valid + PERIOD_NS * 3 / 2 + 1;
    assert_eq!(actuator.clone().tick(told_ns + PERIOD_NS - 1), None);
    assert!(actuator.clone().tick(told_ns + PERIOD_NS).is_some());
    let mut sent = 0;
    for millisecond in 151..=1150 {
        sent += u32::from(actuator.tick(valid + 1_000_000 * millisecond).is_some());
    }
    assert_eq!(sent, 9, "one second of silence after the first block");
}

#[test]
fn after_silence_the_second_valid_command_in_a_row_drives() {
    let mut actuator = driving(3);
    assert!(actuator.tick(arrival(5)).is_some());
    assert_blocked(&actuator.answer(&drive(6), arrival(6)), BlockReason::NoCommand, 1);
    assert!(turns(&actuator.answer(&drive(7), arrival(7))));

    let mut relapsing = driving(3);
    assert!(relapsing.tick(arrival(5)).is_some());
    assert_blocked(&relapsing.answer(&drive(6), arrival(6)), BlockReason::NoCommand, 1);
    assert_blocked(
        &relapsing.answer(&Command { verified: 0, ..drive(7) }, arrival(7)),
        BlockReason::InvalidCommand,
        1,
    );
    assert_blocked(&relapsing.answer(&drive(8), arrival(8)), BlockReason::NoCommand, 1);
    assert!(turns(&relapsing.answer(&drive(9), arrival(9))));
}

#[test]
fn after_silence_commands_that_come_together_count_as_one() {
    let mut actuator = driving(3);
    assert!(actuator.tick(arrival(5)).is_some());
    assert_blocked(&actuator.answer(&drive(4), arrival(6)), BlockReason::NoCommand, 1);
    assert_blocked(&actuator.answer(&drive(5), arrival(6) + 1_000_000), BlockReason::NoCommand, 1);
    assert_blocked(&actuator.answer(&drive(6), arrival(6) + PERIOD_NS / 2), BlockReason::NoCommand, 1);
    assert!(turns(&actuator.answer(&drive(7), arrival(7))));
}

#[test]
fn silence_that_no_tick_saw_counts_as_well() {
    let mut actuator = driving(3);
    assert_blocked(&actuator.answer(&drive(5), arrival(5)), BlockReason::NoCommand, 1);
    assert!(turns(&actuator.answer(&drive(6), arrival(6))));
}

/// A command whose scan was taken `late_ns` later than a regular one.
fn drive_late(scan: u64, late_ns: u64) -> Command {
    let mut command = drive(scan);
    command.header.acquired_ns += late_ns;
    command
}

#[test]
fn a_gap_between_scans_ends_with_the_next_valid_command_and_is_counted() {
    let gap_ns = 2 * PERIOD_NS;
    let mut actuator = driving(3);
    assert_blocked(&actuator.tick(arrival(5)).unwrap(), BlockReason::NoCommand, 0);
    let refused = Command { verified: 0, ..drive_late(4, gap_ns) };
    assert_blocked(&actuator.clone().answer(&refused, arrival(4) + gap_ns), BlockReason::InvalidCommand, 1);
    let actuation = actuator.answer(&drive_late(4, gap_ns), arrival(4) + gap_ns);
    assert!(turns(&actuation));
    assert_eq!(actuation.gaps, 1);
    assert!(turns(&actuator.answer(&drive_late(5, gap_ns), arrival(5) + gap_ns)));
    // The command may take half a period longer than the one before.
    let slow_ns = arrival(4) + gap_ns + PERIOD_NS / 2;
    for (late_ns, gaps) in [(0, 1), (1, 0)] {
        let actuation = driving(3).answer(&drive_late(4, gap_ns), slow_ns + late_ns);
        assert_eq!((turns(&actuation), actuation.gaps), (gaps == 1, gaps));
    }
    // In lock-step no tick sees it.
    let untold = driving(3).answer(&drive_late(4, gap_ns), arrival(4) + gap_ns);
    assert_eq!((turns(&untold), untold.gaps), (true, 1));
}

#[test]
fn a_silence_that_the_scanner_does_not_explain_is_no_gap() {
    let gap_ns = 2 * PERIOD_NS;
    // The scan was there in time, or one between was not answered.
    for command in [drive(4), drive_late(4, PERIOD_NS), drive_late(5, PERIOD_NS)] {
        let mut actuator = driving(3);
        let actuation = actuator.answer(&command, arrival(4) + gap_ns);
        assert_blocked(&actuation, BlockReason::NoCommand, 1);
        assert_eq!(actuation.gaps, 0);
    }
    // Two periods more are allowed before a command is stale.
    let on_time = driving(3).answer(&drive_late(4, PERIOD_NS / 2), arrival(4) + PERIOD_NS / 2);
    assert_eq!((turns(&on_time), on_time.gaps), (true, 0), "a timeout of one and a half periods");
}

#[test]
fn refused_commands_do_not_break_the_silence() {
    let mut actuator = driving(3);
    for scan in 4..8 {
        let refused = Command { verified: 0, ..drive(scan) };
        assert_blocked(&actuator.answer(&refused, arrival(scan)), BlockReason::InvalidCommand, 1);
        assert_eq!(actuator.tick(arrival(scan) + PERIOD_NS / 2), None, "the robot has just been told");
    }
    assert_blocked(&actuator.answer(&drive(8), arrival(8)), BlockReason::NoCommand, 1);
}

#[test]
fn before_the_first_command_the_robot_is_told_to_wait() {
    let mut actuator = actuator();
    assert!(!actuator.is_awake());
    assert_eq!(actuator.tick(1_000), None);
    assert!(actuator.is_awake());
    assert_blocked(&actuator.tick(1_001 + PERIOD_NS * 3 / 2).unwrap(), BlockReason::Start, 0);
    assert!(turns(&actuator.answer(&drive(4), arrival(4))), "the start is no silence");
}

#[test]
fn an_explicit_stop_holds_against_all_commands_until_it_is_released() {
    let mut actuator = driving(1);
    assert_blocked(&actuator.stop(arrival(1) + 1, false), BlockReason::StopRequested, 0);
    for scan in 2..20 {
        assert_blocked(&actuator.answer(&drive(scan), arrival(scan)), BlockReason::StopRequested, 1);
    }
    assert_blocked(&actuator.tick(arrival(22)).unwrap(), BlockReason::StopRequested, 0);
    actuator.release();
    assert_blocked(&actuator.answer(&drive(23), arrival(23)), BlockReason::NoCommand, 1);
    assert!(turns(&actuator.answer(&drive(24), arrival(24))));
}

#[test]
fn a_stop_holds_across_a_restart() {
    let mut actuator = driving(1);
    actuator.stop(arrival(1) + 1, false);
    let mut restarted = self::actuator();
    assert_eq!(restarted.resume(&actuator.state()), Ok(()));
    assert_blocked(&restarted.answer(&drive(2), arrival(2)), BlockReason::StopRequested, 1);
    restarted.release();
    assert!(turns(&restarted.answer(&drive(3), arrival(3))));
    let broken = ActuatorState { sent_steering_rad: f64::NAN, ..actuator.state() };
    assert!(restarted.resume(&broken).is_err());
}

#[test]
fn what_is_sent_passes_the_check_of_its_sample() {
    let mut actuator = driving(1);
    let mut sent = vec![actuator.answer(&drive(2), arrival(2)), actuator.stop(arrival(2), false)];
    sent.extend(actuator.tick(arrival(9)));
    for mut actuation in sent {
        actuation.header.layout = Actuation::LAYOUT;
        assert_eq!(actuation.check(), Ok(()));
    }
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>(),
        -2.0..2.0f64,
        -0.07..0.07f64,
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(1.0),
        Just(0.1),
        Just(0.06),
    ]
}

#[derive(Debug, Clone)]
enum Event {
    Command { skip: u64, kind: u32, verified: u32, velocity: f64, steering: f64, age_ns: i64 },
    Tick,
    Stop,
    Release,
}

fn any_event() -> impl Strategy<Value = Event> {
    let command = (0..3u64, 0..4u32, 0..3u32, any_number(), any_number(), -200_000_000..500_000_000i64)
        .prop_map(|(skip, kind, verified, velocity, steering, age_ns)| Event::Command {
            skip,
            kind,
            verified,
            velocity,
            steering,
            age_ns,
        });
    let good = (0.1..1.0f64, -0.06..0.06f64).prop_map(|(velocity, steering)| Event::Command {
        skip: 1,
        kind: 1,
        verified: 1,
        velocity,
        steering,
        age_ns: 40_000_000,
    });
    prop_oneof![4 => command, 6 => good, 2 => Just(Event::Tick), 1 => Just(Event::Stop), 1 => Just(Event::Release)]
}

proptest! {
    #[test]
    fn no_history_of_commands_makes_the_wheels_turn_for_a_bad_one(
        events in proptest::collection::vec((any_event(), 0..180_000_000u64), 1..60),
        identity: bool,
    ) {
        let calibration = if identity { Calibration::Identity } else { Calibration::Default };
        let mut actuator = Actuator::new(ActuatorConfig { calibration, ..ActuatorConfig::default() }, PERIOD_NS).unwrap();
        let (mut now, mut scan, mut answered, mut stopped) = (1_000_000_000, 1, 0, false);
        let mut rolling = 0.0;
        for (event, pause) in events {
            now += pause;
            let mut admissible = false;
            let actuation = match event {
                Event::Tick => actuator.tick(now),
                Event::Stop => { stopped = true; Some(actuator.stop(now, false)) }
                Event::Release => { stopped = false; actuator.release(); None }
                Event::Command { skip, kind, verified, velocity, steering, age_ns } => {
                    scan += skip;
                    let mut command = drive(scan);
                    command.header.acquired_ns = now.saturating_add_signed(-age_ns);
                    (command.kind, command.verified) = (kind, verified);
                    (command.velocity_mps, command.steering_rad) = (velocity, steering);
                    admissible = kind == CommandKind::Drive.wire() && verified == 1 && scan > answered
                        && velocity.is_finite() && steering.is_finite()
                        && {
                            let (bounds, control) = (ActuatorConfig::default().vehicle.bounds, Control { velocity, steering });
                            bounds.contains(control, 1e-6)
                                || bounds.mirrored().unwrap().contains(control.mirrored(), 1e-6)
                        }
                        && age_ns <= 3 * PERIOD_NS as i64 && age_ns >= -(PERIOD_NS as i64);
                    let actuation = actuator.answer(&command, now);
                    if actuation.answers == 1 {
                        prop_assert!(scan > answered, "scan {scan} is answered twice");
                        prop_assert_eq!(actuation.header.scan_id, scan);
                        answered = scan;
                    }
                    Some(actuation)
                }
            };
            if let Some(actuation) = actuation {
                let (sent_velocity, sent_steering) = (actuation.sent_velocity_mps, actuation.sent_steering_rad);
                prop_assert!(vehicle::Bounds::default().allow_sent(sent_velocity, sent_steering, 0.0));
                if turns(&actuation) {
                    prop_assert!(admissible && !stopped, "{actuation:?}");
                    prop_assert!(sent_velocity * rolling >= 0.0, "{sent_velocity} after {rolling}");
                    prop_assert_eq!(actuation.reason, BlockReason::None.wire());
                } else {
                    prop_assert!(actuation.reason != BlockReason::None.wire());
                    prop_assert_eq!(sent_velocity, 0.0);
                }
                rolling = sent_velocity;
            }
        }
    }

    #[test]
    fn wheels_never_turn_for_longer_than_the_time_out_after_the_last_valid_command(
        gaps in proptest::collection::vec(20_000_000..400_000_000u64, 1..30),
    ) {
        let mut actuator = actuator();
        let (mut now, mut scan) = (arrival(1), 1);
        for gap in gaps {
            // The clock ticks each millisecond; a command arrives at the end of the gap.
            let mut turning = turns(&actuator.answer(&drive_at(scan, now), now));
            for millisecond in 1..gap / 1_000_000 {
                if actuator.tick(now + millisecond * 1_000_000).is_some() {
                    turning = false;
                }
                prop_assert!(!turning || millisecond <= 151, "{millisecond} ms");
            }
            now += gap;
            scan += 1;
        }
    }
}

fn drive_at(scan: u64, now_ns: u64) -> Command {
    let mut command = drive(scan);
    command.header.acquired_ns = now_ns - PERIOD_NS / 3;
    command
}

/// A command that states that a person asked for it.
fn by_hand(scan: u64) -> Command {
    Command { level: Level::Person.wire(), ..drive(scan) }
}

/// What a person asked for at this time.
fn given(number: u64, given_ns: u64) -> GivenControl {
    GivenControl { number, given_ns, velocity_mps: 0.4, steering_rad: 0.0 }
}

#[test]
fn a_pause_blocks_at_once_and_until_another_drives_also_after_a_restart() {
    let mut actuator = driving(1);
    actuator.obey(DrivenBy::Nobody.wire(), &GivenControl::default());
    let block = actuator.tick(arrival(1) + PERIOD_NS / 10).unwrap();
    assert_blocked(&block, BlockReason::Paused, 0);
    assert_eq!((block.driven_by, actuator.tick(arrival(1) + PERIOD_NS / 5)), (1, None), "it is told once");
    for scan in 2..10 {
        assert_blocked(&actuator.answer(&drive(scan), arrival(scan)), BlockReason::Paused, 1);
        assert_eq!(actuator.tick(arrival(scan) + PERIOD_NS / 2), None);
    }
    // Whatever else is wrong with a command: who asks why the wheels are blocked is told of the pause.
    for wrong in [command(10, CommandKind::Stop), Command { velocity_mps: f64::NAN, ..drive(10) }] {
        assert_blocked(&actuator.clone().answer(&wrong, arrival(10)), BlockReason::Paused, 1);
    }
    let mut restarted = self::actuator();
    assert_eq!(restarted.resume(&actuator.state()), Ok(()));
    assert_blocked(&restarted.answer(&drive(10), arrival(10)), BlockReason::Paused, 1);
    restarted.obey(DrivenBy::Controller.wire(), &GivenControl::default());
    assert!(turns(&restarted.answer(&drive(11), arrival(11))));
    // A number that says nothing blocks as well.
    restarted.obey(77, &given(1, arrival(12)));
    assert_blocked(&restarted.answer(&by_hand(12), arrival(12)), BlockReason::Paused, 1);
}

#[test]
fn only_who_drives_turns_the_wheels() {
    let mut actuator = driving(1);
    assert_blocked(&actuator.answer(&by_hand(2), arrival(2)), BlockReason::Paused, 1);
    actuator.obey(DrivenBy::Person.wire(), &given(1, arrival(3)));
    assert_blocked(&actuator.answer(&drive(3), arrival(3)), BlockReason::Paused, 1);
    let turned = actuator.answer(&by_hand(4), arrival(4));
    assert!(turns(&turned) && turned.driven_by == DrivenBy::Person.wire(), "{turned:?}");
    // A controller that does not know of the person turns nothing.
    actuator.obey(DrivenBy::Person.wire(), &given(2, arrival(5)));
    assert_blocked(&actuator.answer(&drive(5), arrival(5)), BlockReason::Paused, 1);
}

#[test]
fn a_person_who_is_silent_for_a_period_and_a_half_drives_no_more() {
    let mut actuator = driving(1);
    actuator.obey(DrivenBy::Person.wire(), &given(1, arrival(2)));
    assert!(turns(&actuator.answer(&by_hand(2), arrival(2))));
    assert!(turns(&actuator.answer(&by_hand(3), arrival(3))), "one period ago");
    assert_eq!(actuator.tick(arrival(2) + PERIOD_NS * 3 / 2), None);
    assert_blocked(&actuator.tick(arrival(2) + PERIOD_NS * 3 / 2 + 1).unwrap(), BlockReason::Released, 0);
    assert_blocked(&actuator.answer(&by_hand(4), arrival(4)), BlockReason::Released, 1);
    // Whatever was given before another drove counts no more, and neither does nothing.
    actuator.obey(DrivenBy::Person.wire(), &GivenControl::default());
    assert_blocked(&actuator.answer(&by_hand(5), arrival(5)), BlockReason::Released, 1);
    actuator.obey(DrivenBy::Person.wire(), &given(3, arrival(6)));
    assert!(turns(&actuator.answer(&by_hand(6), arrival(6))));
}

#[test]
fn an_emergency_stop_has_its_own_reason_until_another_stop_or_its_release() {
    let mut actuator = driving(1);
    assert_blocked(&actuator.stop(arrival(1) + 1, true), BlockReason::EmergencyStop, 0);
    assert_blocked(&actuator.answer(&drive(2), arrival(2)), BlockReason::EmergencyStop, 1);
    assert_blocked(&actuator.stop(arrival(2) + 1, false), BlockReason::StopRequested, 0);
    actuator.release();
    assert!(turns(&actuator.answer(&drive(3), arrival(3))));
}
