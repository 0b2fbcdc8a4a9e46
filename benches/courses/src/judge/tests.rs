use super::*;
use emulator::scenario::{Goal, Robot, Shape, Start};
use shared_types::ActuationKind;
use vehicle::bounds::STEERING_MAX_RAD;

const PERIOD_NS: u64 = 100_000_000;

fn boxed(x_m: f64, y_m: f64, width_m: f64) -> ScenarioObstacle {
    ScenarioObstacle::fixed(Shape::Box { length_m: 0.1, width_m, yaw_rad: 0.0 }, x_m, y_m)
}

fn course(obstacles: Vec<ScenarioObstacle>, preset: Preset) -> Scenario {
    let robot = Robot { preset, ..Robot::default() };
    let goal = Goal { x_m: 12.0, ..Goal::default() };
    Scenario { obstacles, robot, goal: goal.into(), timeout_s: 60.0, ..Scenario::default() }
}

/// Two boxes that leave a gap in the middle.
fn gap(gap_m: f64) -> Vec<ScenarioObstacle> {
    let width_m = 3.0 - gap_m / 2.0;
    let y_m = gap_m / 2.0 + width_m / 2.0;
    vec![boxed(6.0, y_m, width_m), boxed(6.0, -y_m, width_m)]
}

fn drive(velocity: f64, scan_id: u64) -> Actuation {
    let header = shared_types::Header { scan_id, ..Default::default() };
    let kind = ActuationKind::Drive.wire();
    Actuation { header, kind, answers: 1, sent_velocity_mps: 1.4 * velocity, ..Actuation::default() }
}

/// Drives straight on with this speed for some scans, then blocks; ends at a contact.
fn judged(scenario: &Scenario, velocity: f64, scans: u64) -> Judgement {
    let mut judge = Judge::new(scenario, STEERING_MAX_RAD, PERIOD_NS);
    let mut emulator = emulator::Emulator::new(scenario, PERIOD_NS);
    let mut referee = emulator::Referee::new(scenario);
    for scan_id in 1.. {
        let (mut scan, mut odometry, mut truth) = Default::default();
        emulator.advance_to(emulator.scan_ready_ns(scan_id));
        emulator.measure(scan_id, &mut scan, &mut odometry, &mut truth);
        let mut sent = drive(velocity, scan_id);
        if scan_id > scans {
            sent.kind = ActuationKind::Block.wire();
        }
        judge.observe(&truth, None, Some(&sent));
        if let Some(outcome) = referee.observe(&truth, Some(&sent)) {
            return judge.judge(outcome, referee.reason());
        }
        emulator.actuate(&sent);
    }
    unreachable!("every drive ends")
}

#[test]
fn the_margin_is_a_tenth_for_the_ideal_robot_and_a_quarter_of_a_metre_for_others() {
    // Body 0.4 m: 0.6 m of gap leave 0.1 m on both sides, 0.9 m leave 0.25 m.
    for (gap_m, preset, expected) in [
        (0.62, Preset::Ideal, true),
        (0.58, Preset::Ideal, false),
        (0.62, Preset::Summit, false),
        (0.92, Preset::Summit, true),
        (0.88, Preset::Summit, false),
    ] {
        let scenario = course(gap(gap_m), preset);
        assert_eq!(
            Judge::passable(&scenario, &Limits::of(&scenario, STEERING_MAX_RAD)),
            expected,
            "{gap_m} m, {preset:?}"
        );
    }
}

#[test]
fn the_turning_radius_is_that_of_the_true_robot() {
    let radius_m =
        |robot: Robot| Limits::of(&Scenario { robot, ..Scenario::default() }, STEERING_MAX_RAD).radius_m;
    // 1.04 (0.1924 + 0.1776) / 2 / 0.06.
    assert!((radius_m(Robot::default()) - 3.2067).abs() < 1e-4);
    let longer = Robot { rear_m: Some(0.2309), front_m: Some(0.2131), ..Robot::default() };
    assert!((radius_m(longer) / radius_m(Robot::default()) - 1.2).abs() < 1e-3);
    // An offset of 0.01 rad leaves 0.05 rad to one side.
    let offset = Robot { steering_offset_rad: Some(0.01), ..Robot::default() };
    assert!((radius_m(offset) / radius_m(Robot::default()) - 1.2).abs() < 1e-9);
}

#[test]
fn a_stop_is_right_where_the_course_is_closed_and_wrong_where_it_is_not() {
    for (gap_m, expected) in [(1.2, Verdict::StoppedWrongly), (0.5, Verdict::StoppedRightly)] {
        let judgement = judged(&course(gap(gap_m), Preset::Summit), 0.5, 40);
        assert_eq!((judgement.verdict, judgement.passable), (expected, gap_m > 1.0));
    }
}

#[test]
fn a_stop_is_right_when_something_appears_too_near_and_wrong_when_it_appears_far_away() {
    // To pass a box of 0.4 m with 0.25 m to spare the corner of the body must move 0.65 m aside; at a radius of 3.2 m that
    // takes sqrt(2 * 3.2 * 0.65 - 0.65^2) = 1.9 m from the centre, 1.65 m from the front.
    for (ahead_m, expected) in [(1.2, Verdict::StoppedRightly), (3.0, Verdict::StoppedWrongly)] {
        let sudden = ScenarioObstacle { appears_ahead_m: Some(ahead_m), ..boxed(6.0, 0.0, 0.4) };
        let scenario = course(vec![sudden], Preset::Summit);
        let way_m = 6.0 - 0.05 - 0.28 - ahead_m;
        // Half a metre per second: it has appeared, and there is a scan or two left to react.
        let judgement = judged(&scenario, 0.5, (way_m / 0.05) as u64 + 8);
        assert_eq!(judgement.verdict, expected, "{ahead_m} m");
        assert!(judgement.passable);
    }
}

#[test]
fn a_black_obstacle_counts_from_where_the_scanner_can_see_it() {
    for (black, expected) in [(true, Verdict::StoppedRightly), (false, Verdict::StoppedWrongly)] {
        let scenario = course(vec![ScenarioObstacle { black, ..boxed(6.0, 0.0, 0.4) }], Preset::Summit);
        // The default range for black surfaces is 1.5 m: it is seen at x = 4.17 m, and the robot stands at 5 m.
        assert_eq!(judged(&scenario, 0.5, 100).verdict, expected);
    }
}

#[test]
fn a_contact_with_what_stands_is_never_excused() {
    let judgement = judged(&course(vec![boxed(3.0, 0.0, 0.4)], Preset::Summit), 0.5, 1000);
    assert_eq!((judgement.verdict, judgement.cause.as_str()), (Verdict::Collision, "contact-fixed"));
}

#[test]
fn a_contact_with_a_crossing_body_is_excused_only_if_braking_does_not_help() {
    // It crosses 4 m ahead and is visible from the start: a robot that brakes stays where it is.
    let crossing = ScenarioObstacle { velocity_y_mps: -0.5, ..boxed(4.0, 3.75, 0.3) };
    let scenario = course(vec![crossing], Preset::Summit);
    let judgement = judged(&scenario, 0.5, 1000);
    assert_eq!((judgement.verdict, judgement.cause.as_str()), (Verdict::Collision, "contact-moving"));
    // It comes along the line of the robot: it touches the robot that stands, too.
    let head_on = ScenarioObstacle { velocity_x_mps: -0.5, ..boxed(5.0, 0.0, 0.3) };
    let judgement = judged(&course(vec![head_on], Preset::Summit), 0.3, 1000);
    assert_eq!(judgement.verdict, Verdict::CollisionExcused);
    // It strikes the robot that stands in its way, but would not have struck one that stands 4 m before it.
    let start = Start { x_m: 0.0, ..Start::default() };
    let slow = ScenarioObstacle { velocity_y_mps: -0.1, ..boxed(4.0, 1.5, 0.3) };
    let scenario = Scenario { start, ..course(vec![slow], Preset::Summit) };
    let judgement = judged(&scenario, 0.5, 80);
    assert_eq!((judgement.verdict, judgement.cause.as_str()), (Verdict::StoppedWrongly, "struck-moving"));
}

#[test]
fn the_goal_is_missed_by_the_estimate_or_by_the_truth_only() {
    let scenario = course(Vec::new(), Preset::Summit);
    let mut judge = Judge::new(&scenario, STEERING_MAX_RAD, PERIOD_NS);
    for (x_m, missed, cause) in
        [(11.95, false, "missed-by-truth-only"), (11.85, true, "missed-landed-elsewhere")]
    {
        judge.observe(&Truth::default(), Some(&Pose { x_m, ..Pose::default() }), None);
        let judgement = judge.judge(Outcome::Missed, "landed");
        assert_eq!((judgement.missed_by_estimate, judgement.cause.as_str()), (missed, cause));
    }
    let reason = "the goal was passed, it is 0.3 m away";
    let passed = judge.judge(Outcome::Missed, reason);
    assert!(passed.missed_by_estimate && passed.cause == "missed-goal-passed");
    // A box across the track 0.4 m before the goal can't be driven around.
    let hidden =
        Judge::new(&course(vec![boxed(11.5, 0.0, 2.0)], Preset::Summit), STEERING_MAX_RAD, PERIOD_NS);
    assert_eq!(hidden.judge(Outcome::Missed, reason).verdict, Verdict::StoppedRightly);
}
