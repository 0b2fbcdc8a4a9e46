//! Single decisions of the controller, seen from outside: inputs that mean nothing, landing, stops, resuming.

#[path = "common/independent.rs"]
mod independent;

use independent::Judge;
use nmpc::{Budget, Controller, ControllerConfig, ControllerState};
use proptest::prelude::*;
use shared_types::{
    Alarm, Command, CommandKind, Level, MAX_OBSTACLES, Obstacle, Obstacles, Pose, ScannerHealth,
    ScannerState, SolveStatus, StopReason,
};
use vehicle::Goal;

const BUDGET: Budget = Budget::Iterations(60);

fn controller() -> Controller {
    Controller::new(ControllerConfig::default()).expect("the defaults are allowed")
}

fn judge() -> Judge {
    let config = ControllerConfig::default();
    let (y_range, ControllerConfig { vehicle, track, goal, clearance_m, period_s, .. }) =
        (config.y_range(), config);
    Judge { vehicle, track, goal, y_range, clearance_m, period_s, ellipses: false }
}

/// A robot at (x, y) that faces along the track, at scan `scan`.
fn pose(scan: u64, x: f64, y: f64) -> Pose {
    let mut pose = Pose { x_m: x, y_m: y, predicted_x_m: x, predicted_y_m: y, ..Pose::default() };
    pose.header.scan_id = scan;
    pose.header.acquired_ns = scan * 100_000_000;
    pose.predicted_ns = pose.header.acquired_ns + 33_000_000;
    pose
}

fn obstacles(scan: u64, items: &[Obstacle]) -> Obstacles {
    let mut obstacles =
        Obstacles { count: items.len() as u32, scanner: ScannerHealth::healthy(5.0), ..Obstacles::default() };
    obstacles.header.scan_id = scan;
    obstacles.items[..items.len()].copy_from_slice(items);
    obstacles
}

fn obstacle(x: f64, y: f64, width: f64) -> Obstacle {
    let b = width + 0.4;
    Obstacle {
        id: 1,
        x_m: x,
        y_m: y,
        a_m: 1.2_f64.max(1.15 * b),
        b_m: b,
        box_x_m: x,
        box_y_m: y,
        box_length_m: 0.1,
        box_width_m: width,
        ..Obstacle::default()
    }
}

fn is_stop(command: &Command, reason: StopReason) -> bool {
    command.kind == CommandKind::Stop.wire() && command.reason == reason.wire() && command.verified == 0
}

#[test]
fn a_free_way_is_driven_with_a_converged_and_verified_plan() {
    let command = controller().step(&pose(1, 0.0, 0.0), &obstacles(1, &[]), &BUDGET);
    assert_eq!(command.kind, CommandKind::Drive.wire());
    assert_eq!((command.level, command.verified), (Level::Converged.wire(), 1));
    assert_eq!(command.status, SolveStatus::Converged.wire());
    assert!(command.velocity_mps > 0.8 && command.steering_rad.abs() < 1e-3);
    assert_eq!((command.plan_length, command.header.scan_id), (13, 1));
    assert_eq!(command.plan_start_ns, 133_000_000);
}

#[test]
fn inputs_without_meaning_stop_the_robot() {
    type Spoil = fn(&mut Pose, &mut Obstacles);
    let spoiled: [(&str, Spoil); 18] = [
        ("position", |pose, _| pose.predicted_y_m = f64::NAN),
        ("outside", |pose, _| pose.predicted_y_m = 4.0),
        ("sideslip", |pose, _| pose.predicted_sideslip_rad = 1.5),
        ("yaw", |pose, _| pose.predicted_yaw_rad = 11.0),
        ("yaw rate", |pose, _| pose.predicted_yaw_rate_radps = -11.0),
        ("endless speed", |pose, _| pose.predicted_speed_mps = f64::INFINITY),
        ("speed", |pose, _| pose.predicted_speed_mps = -11.0),
        ("old pose", |pose, _| pose.predicted_ns += 1_000_000_000),
        ("pose from the past", |pose, _| pose.predicted_ns = 0),
        ("covariance", |pose, _| pose.local_covariance[4] = f64::NAN),
        ("other scan", |_, obstacles| obstacles.header.scan_id = 2),
        ("ellipse", |_, obstacles| obstacles.items[0].b_m = f64::NAN),
        ("large ellipse", |_, obstacles| obstacles.items[0].a_m = 101.0),
        ("box", |_, obstacles| obstacles.items[0].box_width_m = -0.1),
        ("place of the box", |_, obstacles| obstacles.items[0].box_yaw_rad = f64::INFINITY),
        ("covariance of a velocity", |_, obstacles| obstacles.items[0].velocity_covariance[1] = f64::NAN),
        ("predicted far from the pose", |pose, _| pose.x_m += 1.0),
        ("ellipse away from its body", |_, obstacles| obstacles.items[0].box_x_m -= 3.0),
    ];
    let sound = (pose(1, 0.0, 0.0), obstacles(1, &[obstacle(5.0, 0.0, 0.4)]));
    assert_eq!(controller().step(&sound.0, &sound.1, &BUDGET).kind, CommandKind::Drive.wire());
    for (name, spoil) in spoiled {
        let (mut pose, mut obstacles) = sound;
        spoil(&mut pose, &mut obstacles);
        let command = controller().step(&pose, &obstacles, &BUDGET);
        assert!(is_stop(&command, StopReason::BadInput), "{name}: {}", command.reason);
    }
}

#[test]
fn a_description_that_covers_the_robot_is_the_reason_of_the_stop() {
    let covered = obstacles(1, &[obstacle(5.0, 0.0, 0.4), obstacle(0.0, 0.0, 0.4)]);
    let command = controller().step(&pose(1, 0.0, 0.0), &covered, &BUDGET);
    assert!(is_stop(&command, StopReason::Covered), "{}", command.reason);
}

#[test]
fn the_speed_is_limited_by_what_the_scanner_can_be_relied_on_for_and_by_alarms() {
    let step = |alarm: Alarm, state: ScannerState, seen_ahead_m: f64| {
        let pose = Pose { alarm: alarm.wire(), ..pose(1, 0.0, 0.0) };
        let mut obstacles = obstacles(1, &[]);
        obstacles.scanner = ScannerHealth { state: state.wire(), ..ScannerHealth::healthy(seen_ahead_m) };
        controller().step(&pose, &obstacles, &BUDGET)
    };
    let config = ControllerConfig::default();
    let driven = [
        (Alarm::None, ScannerState::Healthy, 5.0, config.cruise_mps),
        (Alarm::None, ScannerState::Degraded, 5.0, config.vehicle.careful_mps),
        (Alarm::Slow, ScannerState::Healthy, 5.0, config.careful_mps),
    ];
    for (alarm, state, seen_m, limit_mps) in driven {
        let velocity_mps = step(alarm, state, seen_m).velocity_mps;
        assert!((0.9 * limit_mps..=limit_mps + 1e-9).contains(&velocity_mps), "{state:?}: {velocity_mps}");
    }
    // Rolling 0.153 s at 1.05 v, then braking with 4 m/s^2, takes 0.17 m of the 0.5 m: half of the body and 0.05 m are left.
    let velocity_mps = step(Alarm::None, ScannerState::Healthy, 0.5).velocity_mps;
    assert!((0.5..0.75).contains(&velocity_mps), "{velocity_mps}");
    for state in [ScannerState::Blind, ScannerState::Stuck, ScannerState::Contradictory] {
        assert!(is_stop(&step(Alarm::None, state, 5.0), StopReason::Scanner), "{state:?}");
    }
    assert!(is_stop(&step(Alarm::None, ScannerState::Healthy, 0.34), StopReason::Scanner));
    assert!(is_stop(&step(Alarm::Stop, ScannerState::Healthy, 5.0), StopReason::SelfCheck));
}

#[test]
fn a_new_obstacle_is_passed_on_the_cheaper_side_and_both_costs_are_published() {
    for (y, cheaper) in [(0.25, -1), (-0.25, 1)] {
        let mut controller = controller();
        controller.step(&pose(1, 0.0, 0.0), &obstacles(1, &[]), &BUDGET);
        let command = controller.step(&pose(2, 0.1, 0.0), &obstacles(2, &[obstacle(4.0, y, 0.2)]), &BUDGET);
        let sides = command.sides;
        assert_eq!((sides.id, command.side), (1, cheaper), "{sides:?}");
        let (low, high) = if cheaper == 1 {
            (sides.left_objective, sides.right_objective)
        } else {
            (sides.right_objective, sides.left_objective)
        };
        assert!(0.0 < low && low < high, "{sides:?}");
        assert!((command.objective - low).abs() < 1e-9, "{} {sides:?}", command.objective);
        // The side is held and not compared again.
        let next = controller.step(&pose(3, 0.2, 0.0), &obstacles(3, &[obstacle(4.0, y, 0.2)]), &BUDGET);
        assert_eq!((next.sides.id, next.side), (0, cheaper));
    }
}

#[test]
fn the_side_that_is_published_is_that_of_the_plan_where_the_solver_overrules_the_search() {
    let mut compared = 0;
    // Turned to the left and beside the line: what the search takes for shorter often costs more.
    for (x, step) in [4.0, 4.5, 5.0, 5.5].into_iter().flat_map(|x| (0..12).map(move |step| (x, step))) {
        let y = f64::from(step) * 0.02 - 0.11;
        let mut controller = controller();
        controller.step(&pose(1, 0.0, 0.0), &obstacles(1, &[]), &BUDGET);
        let turned = Pose { yaw_rad: 0.3, predicted_yaw_rad: 0.3, ..pose(2, 0.1, -1.5 * y) };
        let command = controller.step(&turned, &obstacles(2, &[obstacle(x, y, 0.2)]), &BUDGET);
        let sides = command.sides;
        if sides.left_objective.min(sides.right_objective) <= 0.0 {
            continue; // Not compared, or only one of them can be driven.
        }
        compared += 1;
        let driven = if (command.objective - sides.left_objective).abs() < 1e-9 { 1 } else { -1 };
        assert_eq!(command.side, driven, "x {x}, y {y}: {sides:?}");
    }
    assert!(compared > 40, "{compared} compared");
}

#[test]
fn a_robot_that_can_not_stop_in_time_at_any_speed_does_not_drive() {
    let mut config = ControllerConfig::default();
    config.vehicle.sudden_m = 0.1;
    config.vehicle.blocked_deceleration_mps2 = 0.1;
    let command = Controller::new(config).unwrap().step(&pose(1, 0.0, 0.0), &obstacles(1, &[]), &BUDGET);
    assert!(is_stop(&command, StopReason::NoSafeSpeed), "{}", command.reason);
}

#[test]
fn a_landing_is_kept_and_a_passed_goal_is_no_landing() {
    let mut landing = controller();
    let near = Pose { predicted_speed_mps: 0.2, ..pose(1, 9.99, 0.02) };
    let command = landing.step(&near, &obstacles(1, &[]), &BUDGET);
    assert_eq!(command.kind, CommandKind::Land.wire());
    let command = landing.step(&pose(2, 9.8, 0.0), &obstacles(2, &[]), &BUDGET);
    assert_eq!((command.kind, command.reason), (CommandKind::Land.wire(), StopReason::Landed.wire()));

    let mut passing = controller();
    let command = passing.step(&pose(1, 10.0, 0.3), &obstacles(1, &[]), &BUDGET);
    assert!(is_stop(&command, StopReason::GoalPassed));
    let command = passing.step(&pose(2, 9.98, 0.3), &obstacles(2, &[]), &BUDGET);
    assert!(is_stop(&command, StopReason::GoalPassed), "noise does not start the robot again");
}

#[test]
fn a_stop_in_front_of_a_blocked_path_is_held_although_the_body_vanishes_for_a_scan() {
    let mut controller = controller();
    let closed = [obstacle(2.0, 0.0, 1.6)];
    assert!(is_stop(
        &controller.step(&pose(1, 0.0, 0.0), &obstacles(1, &closed), &BUDGET),
        StopReason::Blocked
    ));
    let stops = (2..30)
        .take_while(|&scan| {
            is_stop(
                &controller.step(&pose(scan, 0.0, 0.0), &obstacles(scan, &[]), &BUDGET),
                StopReason::Blocked,
            )
        })
        .count();
    // Five scans held in all, the first of them above; the fifth clear scan drives.
    assert_eq!(stops, 4);
}

#[test]
fn without_a_budget_the_reference_path_is_driven_verified() {
    let command = controller().step(
        &pose(1, 0.0, 0.0),
        &obstacles(1, &[obstacle(5.0, 0.1, 0.4)]),
        &Budget::Iterations(0),
    );
    assert_eq!((command.kind, command.verified), (CommandKind::Drive.wire(), 1));
    assert_eq!(command.level, Level::BestIterate.wire());
}

#[test]
fn a_resumed_controller_gives_the_same_bits() {
    let mut first = controller();
    let mut second = controller();
    let x = |scan: u64| 0.1 * (scan - 1) as f64;
    for scan in 1..20 {
        let (pose, obstacles) = (pose(scan, x(scan), 0.0), obstacles(scan, &[obstacle(5.0, 0.0, 0.4)]));
        let command = first.step(&pose, &obstacles, &BUDGET);
        if scan > 1 {
            assert_eq!(second.step(&pose, &obstacles, &BUDGET), command, "scan {scan}");
        }
        second = controller();
        second.resume(&first.state());
    }
}

#[test]
fn a_checkpoint_of_invalid_numbers_does_no_harm() {
    let mut state =
        ControllerState { plan_length: 900, plan_interval_s: f64::NAN, ..ControllerState::default() };
    (state.velocity_mps, state.steering_rad) = (f64::NAN, f64::INFINITY);
    state.plan[0].velocity_mps = f64::NAN;
    let mut controller = controller();
    controller.resume(&state);
    let command = controller.step(&pose(1, 0.0, 0.0), &obstacles(1, &[]), &BUDGET);
    assert_eq!((command.kind, command.verified), (CommandKind::Drive.wire(), 1));
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        60 => -3.0..3.0f64,
        1 => prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(-1e300), Just(1e-300), Just(1e9)],
    ]
}

/// After a gap, scans of an irregular scanner may be 5 ms apart; the next one may come after the whole period.
#[test]
fn scans_in_quick_succession_do_not_raise_the_speed_limit() {
    let limit_mps = |apart_ns: u64| {
        let mut controller = controller();
        controller.step(&pose(1, 0.0, 0.0), &obstacles(1, &[]), &BUDGET);
        let mut second = pose(2, 0.0, 0.0);
        second.header.acquired_ns = 100_000_000 + apart_ns;
        second.predicted_ns = second.header.acquired_ns + 33_000_000;
        controller.step(&second, &obstacles(2, &[]), &BUDGET).speed_limit_mps
    };
    assert_eq!(limit_mps(5_000_000), limit_mps(100_000_000));
    assert!(limit_mps(150_000_000) < limit_mps(100_000_000));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn no_input_makes_it_panic_or_drive_a_plan_that_is_not_safe(
        numbers in proptest::collection::vec(any_number(), 24), lead in 0u64..3_000_000_000,
    ) {
        let mut pose = pose(1, numbers[0], numbers[1] * 0.5);
        pose.predicted_ns = pose.header.acquired_ns + lead / 10;
        pose.predicted_yaw_rad = numbers[2] * 0.3;
        pose.predicted_yaw_rate_radps = numbers[3] * 0.1;
        pose.predicted_sideslip_rad = numbers[4] * 0.05;
        pose.predicted_speed_mps = numbers[5].abs() * 0.3;
        let items: Vec<Obstacle> = numbers[6..].chunks(6).enumerate().map(|(index, n)| Obstacle {
            id: index as u32 + 1,
            velocity_x_mps: n[2] * 0.3,
            velocity_y_mps: n[3] * 0.3,
            box_length_m: n[4].abs(),
            box_yaw_rad: n[5],
            ..obstacle(n[0] * 2.0 + 4.0, n[1], n[5].abs() * 0.2)
        }).collect();
        let mut controller = controller();
        for scan in 1..4 {
            (pose.header.scan_id, pose.predicted_ns) = (scan, pose.predicted_ns + 100_000_000);
            pose.header.acquired_ns += 100_000_000;
            let command = controller.step(&pose, &obstacles(scan, &items), &Budget::Iterations(20));
            let objection = judge().objection(&command, &pose, &obstacles(scan, &items));
            prop_assert_eq!(objection, None);
            prop_assert!(command.kkt_residual.is_finite() && command.objective.is_finite());
        }
    }
}

#[test]
fn without_the_state_of_the_one_before_it_stops_until_the_robot_rests() {
    let mut controller = controller();
    controller.start_in_stop();
    let moving = |scan, speed| Pose { speed_mps: speed, predicted_speed_mps: speed, ..pose(scan, 0.0, 0.0) };
    for (scan, speed) in [(1, 0.9), (2, f64::NAN), (3, 0.4)] {
        let command = controller.step(&moving(scan, speed), &obstacles(scan, &[]), &BUDGET);
        assert!(is_stop(&command, StopReason::StateLost), "{command:?}");
    }
    // A controller that takes over from this one has to wait as well.
    let mut next = self::controller();
    next.resume(&controller.state());
    let command = next.step(&moving(4, 0.1), &obstacles(4, &[]), &BUDGET);
    assert!(is_stop(&command, StopReason::StateLost));
    let command = next.step(&moving(5, 0.0), &obstacles(5, &[]), &BUDGET);
    assert_eq!(command.kind, CommandKind::Drive.wire());
    let command = next.step(&moving(6, 0.1), &obstacles(6, &[]), &BUDGET);
    assert_eq!(command.kind, CommandKind::Drive.wire(), "it rested once");
}

/// Goals at 4 m, where the robot stands for a second, and at 10 m.
fn two_goals() -> Controller {
    let goal = |x_m: f64| Goal { x_m, ..Goal::default() };
    let (goal, next_goals) = (goal(4.0), vec![goal(10.0)]);
    Controller::new(ControllerConfig { goal, next_goals, ..ControllerConfig::default() })
        .expect("two goals are allowed")
}

/// A robot at rest.
fn rests(scan: u64, x: f64) -> Pose {
    Pose { speed_mps: 0.0, predicted_speed_mps: 0.0, ..pose(scan, x, 0.0) }
}

#[test]
fn at_a_goal_the_robot_stands_as_long_as_it_should_then_drives_to_the_next_one() {
    let mut controller = two_goals();
    let sliding = Pose { speed_mps: 0.2, predicted_speed_mps: 0.2, ..pose(1, 3.99, 0.0) };
    assert_eq!(controller.step(&sliding, &obstacles(1, &[]), &BUDGET).kind, CommandKind::Land.wire());
    // Ten scans of 0.1 s from the first one at rest; one that takes over counts on.
    for scan in 2..12 {
        let mut next = two_goals();
        next.resume(&controller.state());
        controller = next;
        let command = controller.step(&rests(scan, 4.0), &obstacles(scan, &[]), &BUDGET);
        assert_eq!(command.reason, StopReason::Landed.wire(), "scan {scan}");
    }
    let command = controller.step(&rests(12, 4.0), &obstacles(12, &[]), &BUDGET);
    assert_eq!(command.kind, CommandKind::Drive.wire());
    let command = controller.step(&pose(13, 4.3, 0.0), &obstacles(13, &[]), &BUDGET);
    assert_eq!(command.kind, CommandKind::Drive.wire(), "the first goal is not passed, it was reached");
    let near = Pose { predicted_speed_mps: 0.2, ..pose(14, 9.99, 0.0) };
    controller.step(&near, &obstacles(14, &[]), &BUDGET);
    for scan in 15..60 {
        let command = controller.step(&rests(scan, 9.99), &obstacles(scan, &[]), &BUDGET);
        assert_eq!(command.kind, CommandKind::Land.wire(), "at the last goal for good");
    }
}

#[test]
fn without_the_state_of_the_one_before_the_goal_is_the_first_that_is_not_behind() {
    for (x, lands) in [(2.0, false), (4.05, true), (4.2, false), (10.0, true)] {
        let mut controller = two_goals();
        controller.start_in_stop();
        let command = controller.step(&rests(1, x), &obstacles(1, &[]), &BUDGET);
        let kind = if lands { CommandKind::Land } else { CommandKind::Drive };
        assert_eq!(command.kind, kind.wire(), "{x} m: reason {}", command.reason);
    }
}

/// The command of one step, which is a stop or a drive that the judge has no objection to.
fn judged(controller: &mut Controller, pose: &Pose, obstacles: &Obstacles) -> Command {
    let command = controller.step(pose, obstacles, &BUDGET);
    assert_eq!(judge().objection(&command, pose, obstacles), None);
    command
}

#[test]
fn sixteen_ellipses_in_one_place_are_passed_or_stopped_for() {
    let heap = |y: f64, spread: f64| -> Vec<Obstacle> {
        let one = |index: usize| {
            let turn = index as f64;
            let item = obstacle(3.0 + spread * turn.cos(), y + spread * turn.sin(), 0.4);
            Obstacle { id: index as u32 + 1, box_yaw_rad: turn, ..item }
        };
        (0..MAX_OBSTACLES).map(one).collect()
    };
    let kinds = [(0.9, 0.05), (0.0, 0.3), (0.0, 0.0), (-0.6, 0.2)].map(|(y, spread)| {
        let (mut controller, heap) = (controller(), heap(y, spread));
        (1..6)
            .map(|scan| {
                judged(&mut controller, &pose(scan, 0.05 * scan as f64, 0.0), &obstacles(scan, &heap))
            })
            .map(|command| command.kind)
            .collect::<Vec<_>>()
    });
    assert!(
        kinds[0].iter().all(|kind| *kind == CommandKind::Drive.wire()),
        "the free side is passed: {kinds:?}"
    );
}

#[test]
fn ellipses_that_close_the_track_together_stop_the_robot() {
    let heap: Vec<Obstacle> = (0..MAX_OBSTACLES)
        .map(|index| Obstacle { id: index as u32 + 1, ..obstacle(1.2, 0.2 * index as f64 - 1.5, 0.3) })
        .collect();
    let command = judged(&mut controller(), &pose(1, 0.0, 0.0), &obstacles(1, &heap));
    assert!(is_stop(&command, StopReason::Blocked));
}

#[test]
fn a_goal_behind_the_robot_stops_it_whatever_comes_before_it() {
    for (x, y, yaw) in [(10.2, 0.0, 0.0), (12.0, 1.0, 0.5), (10.6, 0.2, -0.4)] {
        let behind = Pose { predicted_yaw_rad: yaw, ..pose(1, x, y) };
        let command = judged(&mut controller(), &behind, &obstacles(1, &[]));
        assert!(is_stop(&command, StopReason::GoalPassed), "{x} {y} {yaw}: {}", command.reason);
    }
}

#[test]
fn a_sight_that_is_not_a_number_shows_nothing() {
    let mut blind = obstacles(1, &[]);
    blind.scanner.seen_ahead_m = f64::NAN;
    assert!(is_stop(&judged(&mut controller(), &pose(1, 0.0, 0.0), &blind), StopReason::Scanner));
}

/// A checkpoint with a plan past an obstacle that is driven along.
fn driving_state() -> ControllerState {
    let mut controller = controller();
    judged(&mut controller, &pose(1, 0.0, 0.0), &obstacles(1, &[obstacle(3.0, 0.1, 0.4)]));
    controller.state()
}

/// What a controller that resumes from a checkpoint commands in the next scans.
fn resumed(state: &ControllerState, budget: &Budget) -> Result<(), String> {
    let mut controller = controller();
    controller.resume(state);
    for scan in 2..5 {
        let x = 0.1 * (scan - 1) as f64;
        let (pose, obstacles) = (pose(scan, x, 0.0), obstacles(scan, &[obstacle(3.0, 0.1, 0.4)]));
        let command = controller.step(&pose, &obstacles, budget);
        if let Some(objection) = judge().objection(&command, &pose, &obstacles) {
            return Err(format!("scan {scan}: {objection}"));
        }
        if !(command.objective.is_finite() && command.slack.is_finite()) {
            return Err(format!("scan {scan}: the report has numbers that are not finite"));
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]
    #[test]
    fn a_checkpoint_of_any_bytes_does_no_harm(
        bytes in proptest::collection::vec(any::<u8>(), size_of::<ControllerState>()),
        plan_length in 0u32..26, sound_interval: bool, iterations in 0u32..60,
    ) {
        let mut state: ControllerState = bytemuck::pod_read_unaligned(&bytes);
        (state.arrival, state.blocked_scans, state.plan_length) = (0, 0, plan_length);
        if sound_interval {
            (state.plan_start_ns, state.plan_interval_s) = (133_000_000, ControllerConfig::default().interval_s());
        }
        prop_assert_eq!(resumed(&state, &Budget::Iterations(iterations)), Ok(()));
    }

    /// Most of it is sound, so that the plan, the sides and the ellipses are used.
    #[test]
    fn a_checkpoint_with_some_numbers_of_nonsense_does_no_harm(
        spoiled in proptest::collection::vec((0..size_of::<ControllerState>() / 8, nonsense()), 1..12),
        iterations in 0u32..60,
    ) {
        let mut bytes = bytemuck::bytes_of(&driving_state()).to_vec();
        for (word, number) in spoiled {
            bytes[8 * word..8 * word + 8].copy_from_slice(&number.to_bits().to_le_bytes());
        }
        let state: ControllerState = bytemuck::pod_read_unaligned(&bytes);
        prop_assert_eq!(resumed(&state, &Budget::Iterations(iterations)), Ok(()));
    }
}

/// Numbers that mean nothing, and some that nearly mean something.
fn nonsense() -> impl Strategy<Value = f64> {
    prop_oneof![
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::NEG_INFINITY),
        Just(0.0),
        Just(f64::MIN_POSITIVE),
        -2.0..2.0f64,
        any::<f64>(),
        any::<u64>().prop_map(f64::from_bits),
    ]
}

#[test]
fn each_field_of_a_checkpoint_may_be_nonsense() {
    let sound = driving_state();
    for word in 0..size_of::<ControllerState>() / 8 {
        for number in [f64::NAN, f64::INFINITY, -1e300, 1.0] {
            let mut bytes = bytemuck::bytes_of(&sound).to_vec();
            bytes[8 * word..8 * word + 8].copy_from_slice(&number.to_bits().to_le_bytes());
            let state = bytemuck::pod_read_unaligned(&bytes);
            assert_eq!(resumed(&state, &Budget::Iterations(5)), Ok(()), "{number} in the numbers {word}");
        }
    }
}

/// A body that comes has touched the robot with a corner: a plan that gets away from it may not go 6 mm deeper first, although
/// its samples do not show that.
#[test]
fn a_robot_that_is_touched_is_driven_no_deeper_into_the_body() {
    let mut pose = pose(1, 2.280_261_608_077_940_8, 0.468_060_160_974_951_84);
    pose.predicted_yaw_rad = 0.250_014_076_975_935_2;
    pose.predicted_speed_mps = 0.767_178_470_954_080_9;
    pose.predicted_ns = pose.header.acquired_ns + 44_678_693;
    let touching = Obstacle {
        velocity_x_mps: -0.699_391_249_331_756_3,
        box_length_m: 2.218_357_978_082_780_3,
        box_yaw_rad: -0.952_256_008_434_086_8,
        ..obstacle(2.735_532_182_880_224, -0.730_076_852_194_941_3, 0.190_451_201_686_817_37)
    };
    let others =
        [(4.0, -0.215_552_468_482_506), (6.323_471_314_924_134, 0.0)].map(|(x_m, velocity_y_mps)| Obstacle {
            velocity_y_mps,
            box_length_m: 0.0,
            ..obstacle(x_m, 0.0, 0.0)
        });
    let all = obstacles(1, &[touching, others[0], others[1]]);
    let command = controller().step(&pose, &all, &Budget::Iterations(20));
    assert_eq!(judge().objection(&command, &pose, &all), None);
}
