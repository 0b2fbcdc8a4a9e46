//! A bad plan never reaches the wheels, wherever it comes from; and each rung of the ladder is reached.

use std::cell::Cell;

use shared_types::{Obstacle, ScannerHealth, SolveStatus};
use vehicle::integrate::integrate;
use vehicle::{Goal, Track};

use super::*;
use crate::config::PersonMargin;
use crate::config::SideRule;
use crate::independent::Judge;
use crate::injection::{Injection, Place};

const BUDGET: Budget = Budget::Iterations(60);
const NONE: Budget = Budget::Iterations(0);

/// A scene with a plan that violates one limit, and only this.
#[derive(Clone)]
struct Case {
    name: &'static str,
    config: ControllerConfig,
    y: f64,
    items: Vec<Obstacle>,
    control: Control,
    /// Whether a solution is clamped to a plan that may be driven.
    is_clamped: bool,
}

fn obstacle(x: f64, y: f64, [a_m, b_m]: [f64; 2], [box_length_m, box_width_m]: [f64; 2]) -> Obstacle {
    let (box_x_m, box_y_m) = (x, y);
    Obstacle {
        id: 1,
        x_m: x,
        y_m: y,
        a_m,
        b_m,
        box_x_m,
        box_y_m,
        box_length_m,
        box_width_m,
        ..Obstacle::default()
    }
}

fn summary(command: &Command) -> String {
    let Command { kind, level, reason, status, iterations, velocity_mps, steering_rad, .. } = command;
    format!(
        "kind {kind} level {level} reason {reason} status {status} {iterations} {velocity_mps} {steering_rad}"
    )
}

/// The cases with the path search, then with an explicit side.
fn cases() -> Vec<Case> {
    let (straight, left) =
        (Control { velocity: 0.9, steering: 0.0 }, Control { velocity: 0.9, steering: 0.06 });
    let case = |name, y, items, control| {
        let config =
            ControllerConfig { goal: Goal { x_m: 20.0, ..Goal::default() }, ..ControllerConfig::default() };
        Case { name, config, y, items, control, is_clamped: false }
    };
    let clamped = |name, control| Case { is_clamped: true, ..case(name, 0.0, Vec::new(), control) };
    let mut wall = case("wall", 1.3, Vec::new(), Control { steering: 0.025, ..left });
    // A corner of the body gets to the wall before its centre leaves the bounds, which have no distance to walls here.
    (wall.config.theta_m, wall.config.track) =
        (0.0, Track { walls: true, y_m: [-1.9, 1.9], ..Track::default() });
    let searched = vec![
        clamped("velocity", Control { velocity: 1.5, ..straight }),
        clamped("steering", Control { steering: 0.1, velocity: 0.2 }),
        case("not finite", 0.0, Vec::new(), Control { steering: f64::NAN, ..straight }),
        case("ellipse", 0.0, vec![obstacle(2.0, 0.9, [1.2, 1.0], [0.1, 0.1])], straight),
        case("body", 0.0, vec![obstacle(2.4, 0.4, [0.8, 0.35], [0.1, 0.4])], straight),
        case("position", 1.0, Vec::new(), left),
        wall,
    ];
    let explicit =
        |case: Case| Case { config: ControllerConfig { side: SideRule::Nearest, ..case.config }, ..case };
    [searched.clone(), searched.into_iter().map(explicit).collect()].concat()
}

impl Case {
    fn judge(&self) -> Judge {
        let ControllerConfig { vehicle, track, goal, clearance_m, period_s, .. } = self.config;
        let y_range = self.config.y_range();
        Judge { vehicle, track, goal, y_range, clearance_m, period_s, ellipses: true }
    }

    /// What the controller reads for scan 1 or 2.
    fn inputs(&self, scan: u64) -> (Pose, Obstacles) {
        let x = 0.1 * scan as f64;
        let [x_m, y_m] = [x, self.y];
        let mut pose = Pose { x_m, y_m, predicted_x_m: x, predicted_y_m: self.y, ..Pose::default() };
        (pose.header.scan_id, pose.header.acquired_ns) = (scan, scan * 100_000_000);
        pose.predicted_ns = pose.header.acquired_ns + 33_000_000;
        let mut obstacles = Obstacles { scanner: ScannerHealth::healthy(5.0), ..Obstacles::default() };
        (obstacles.header.scan_id, obstacles.count) = (scan, self.items.len() as u32);
        obstacles.items[..self.items.len()].copy_from_slice(&self.items);
        (pose, obstacles)
    }

    fn step(&self, controller: &mut Controller, scan: u64, budget: &Budget) -> Command {
        let (pose, obstacles) = self.inputs(scan);
        let command = controller.step(&pose, &obstacles, budget);
        assert_eq!(
            self.judge().objection(&command, &pose, &obstacles),
            None,
            "{}: {}",
            self.name,
            summary(&command)
        );
        command
    }

    /// A controller after its first scan, which has a plan.
    fn driving(&self) -> Controller {
        let mut controller = Controller::new(self.config.clone()).unwrap();
        let command = self.step(&mut controller, 1, &BUDGET);
        assert_eq!(command.kind, CommandKind::Drive.wire(), "{}: {}", self.name, summary(&command));
        controller
    }

    /// The bad plan; a solution has states that fit it, or its own, which do not.
    fn injection(&self, places: &[Place], fits: bool) -> Injection {
        let controls = vec![self.control; self.config.intervals];
        let (pose, _) = self.inputs(2);
        let mut states = vec![State { x: pose.predicted_x_m, y: pose.predicted_y_m, ..State::default() }];
        let (parameters, interval_s) = (self.config.vehicle.parameters(), self.config.interval_s());
        for control in &controls {
            states.push(integrate(&parameters, &states[states.len() - 1], control, interval_s));
        }
        let states = if fits { states } else { Vec::new() };
        Injection { places: places.to_vec(), controls, states, ..Injection::default() }
    }
}

/// The second command of a controller with a bad plan at some places.
fn injected(case: &Case, places: &[Place], fits: bool, budget: &Budget) -> Command {
    let mut controller = case.driving();
    controller.planner.injection = case.injection(places, fits);
    let command = case.step(&mut controller, 2, budget);
    let Injection { reached, .. } = &controller.planner.injection;
    let expected = if case.is_clamped { &places[..1] } else { places };
    for place in expected {
        assert!(reached.contains(place), "{}: {place:?} of {reached:?}", case.name);
    }
    command
}

#[test]
fn the_injected_plans_are_bad() {
    for case in cases() {
        let (pose, obstacles) = case.inputs(2);
        let controls = vec![case.control; case.config.intervals];
        let objection = case.judge().against(&controls, case.config.interval_s(), &pose, &obstacles);
        assert!(objection.is_some(), "{}", case.name);
        eprintln!("{}: {}", case.name, objection.unwrap());
    }
}

#[test]
fn a_bad_solution_never_reaches_the_wheels() {
    let solutions = [Place::SolutionFromPlan, Place::SolutionFromReference];
    for case in cases() {
        for fits in [true, false] {
            let command = injected(&case, &solutions[..1], fits, &BUDGET);
            assert_eq!(command.verified, 1, "{}: the other solution is good", case.name);
            let command = injected(&case, &solutions, fits, &BUDGET);
            assert!(case.is_clamped || command.level != Level::Converged.wire(), "{}", case.name);
        }
    }
}

#[test]
fn bad_steering_and_a_bad_rest_never_reach_the_wheels() {
    for case in cases().into_iter().map(|case| Case { is_clamped: false, ..case }) {
        let command = injected(&case, &[Place::Steering], true, &NONE);
        assert_eq!(command.level, Level::LastPlan.wire(), "{}", case.name);
        let command = injected(&case, &[Place::Steering, Place::Rest], true, &NONE);
        assert_eq!((command.kind, command.verified), (CommandKind::Stop.wire(), 0), "{}", case.name);
        assert_eq!((command.velocity_mps, command.level), (0.0, Level::Stop.wire()), "{}", case.name);
    }
}

#[test]
fn a_plan_above_the_speed_limit_never_reaches_the_wheels() {
    let case = cases().swap_remove(0);
    let (pose, mut obstacles) = case.inputs(2);
    obstacles.scanner = ScannerHealth::healthy(0.5);
    for (places, budget) in [(&Place::ALL[..], BUDGET), (&Place::ALL[2..3], NONE), (&Place::ALL[2..], NONE)] {
        let mut controller = case.driving();
        controller.planner.injection = Injection {
            controls: vec![Control { velocity: 0.9, steering: 0.0 }; 12],
            ..case.injection(places, true)
        };
        let command = controller.step(&pose, &obstacles, &budget);
        assert_eq!(case.judge().objection(&command, &pose, &obstacles), None, "{}", summary(&command));
        assert!(command.speed_limit_mps < 0.8 && command.velocity_mps <= command.speed_limit_mps);
    }
}

#[test]
fn bad_plans_everywhere_stop_the_robot() {
    for case in cases().iter().filter(|case| !case.is_clamped) {
        for fits in [true, false] {
            let command = injected(case, &Place::ALL, fits, &BUDGET);
            assert_eq!((command.kind, command.verified), (CommandKind::Stop.wire(), 0), "{}", case.name);
        }
    }
}

#[test]
fn a_solution_whose_states_do_not_fit_its_controls_counts_as_not_converged() {
    let case = cases().swap_remove(0);
    let slower = Case { control: Control { velocity: 0.5, steering: 0.01 }, is_clamped: true, ..case };
    let command = injected(&slower, &[Place::SolutionFromPlan], false, &BUDGET);
    // The controls are good, so they are driven; the plan has the states of the roll-out.
    assert_eq!((command.velocity_mps, command.steering_rad), (0.5, 0.01));
    assert_eq!(command.level, Level::BestIterate.wire());
    assert!(command.largest_violation > 0.1, "{}", command.largest_violation);
    let command = injected(&slower, &[Place::SolutionFromPlan], true, &BUDGET);
    assert_eq!(command.level, Level::Converged.wire());
}

/// A free scene with nothing injected, and the second command with this budget.
fn second(budget: &Budget) -> Command {
    let case = cases().swap_remove(0);
    case.step(&mut case.driving(), 2, budget)
}

#[test]
fn the_first_rung_is_a_plan_that_converged() {
    let command = second(&BUDGET);
    assert_eq!((command.level, command.status), (Level::Converged.wire(), SolveStatus::Converged.wire()));
}

#[test]
fn the_second_rung_is_the_best_verified_plan_when_time_is_over() {
    // Two iterations may begin; from the rest of the start they are too few.
    let (calls, case) = (Cell::new(0), cases().swap_remove(4));
    let clock = || {
        calls.set(calls.get() + 1);
        calls.get()
    };
    let mut controller = Controller::new(case.config.clone()).unwrap();
    let command = case.step(&mut controller, 1, &Budget::Deadline { deadline_ns: 3, now_ns: &clock });
    assert_eq!((command.kind, command.level), (CommandKind::Drive.wire(), Level::BestIterate.wire()));
    assert_eq!(command.status, SolveStatus::OutOfTime.wire());
    // No iteration at all: steering along the reference path is verified.
    let command = second(&Budget::Deadline { deadline_ns: 0, now_ns: &|| 1 });
    assert_eq!((command.level, command.iterations), (Level::BestIterate.wire(), 0));
}

#[test]
fn the_third_rung_is_the_rest_of_the_last_plan() {
    for case in cases() {
        let mut controller = case.driving();
        let last = controller.state();
        controller.planner.injection = case.injection(&[Place::Steering], true);
        let command = case.step(&mut controller, 2, &NONE);
        assert_eq!((command.level, command.verified), (Level::LastPlan.wire(), 1), "{}", case.name);
        // The interval that has begun is not counted, and what is not clear after 2.72 s, 6 intervals, is left out.
        assert!(
            (7..last.plan_length).contains(&command.plan_length),
            "{}: {}",
            case.name,
            command.plan_length
        );
        let [old, next] = [0, 1].map(|node| last.plan[node].steering_rad);
        let share = 0.1 / case.config.interval_s();
        // It may use the whole steering angle.
        let most = case.config.vehicle.bounds.steering_max_rad;
        let shifted = (old + share * (next - old)).clamp(-most, most);
        assert!((command.steering_rad - shifted).abs() < 1e-9, "{}: {}", case.name, command.steering_rad);
    }
}

#[test]
fn the_last_rung_is_a_stop_also_after_a_stop() {
    let case = cases().swap_remove(4);
    let mut controller = case.driving();
    controller.planner.injection = case.injection(&Place::ALL, true);
    for scan in 2..4 {
        let command = case.step(&mut controller, scan, &BUDGET);
        assert_eq!((command.kind, command.level), (CommandKind::Stop.wire(), Level::Stop.wire()));
        assert_eq!((command.reason, command.plan_length), (StopReason::Unverified.wire(), 0));
    }
    controller.planner.injection = Injection::default();
    let command = case.step(&mut controller, 4, &BUDGET);
    assert_eq!(command.kind, CommandKind::Drive.wire(), "a good plan is driven again");
}

/// A pose on the line with nothing in the way, in a scan every 0.1 s.
fn seen(scan_id: u64, x_m: f64, speed_mps: f64) -> (Pose, Obstacles) {
    let header = shared_types::Header { scan_id, acquired_ns: scan_id * 100_000_000, ..Default::default() };
    let scanner = ScannerHealth::default();
    let pose = Pose {
        header,
        x_m,
        speed_mps,
        predicted_x_m: x_m,
        predicted_speed_mps: speed_mps,
        predicted_ns: header.acquired_ns,
        ..Pose::default()
    };
    (pose, Obstacles { header, scanner, ..Obstacles::default() })
}

#[test]
fn a_given_goal_counts_from_its_scan_on_also_for_a_successor() {
    let given = GivenGoal { from_scan: 5, x_m: 3.0, tolerance_m: 0.1, ..GivenGoal::default() };
    let lands = |controller: &mut Controller, scan_id| {
        let (pose, obstacles) = seen(scan_id, 2.999, 0.1);
        controller.step(&pose, &obstacles, &BUDGET).kind == CommandKind::Land.wire()
    };
    let mut controller = Controller::new(ControllerConfig::default()).unwrap();
    controller.give(&given);
    assert!(!lands(&mut controller, 4), "at 10 m is the goal still");
    let mut successor = Controller::new(ControllerConfig::default()).unwrap();
    successor.resume(&controller.state());
    assert!(lands(&mut controller, 5) && lands(&mut successor, 5));
    // Once more the same, or an older one, is no other.
    controller.give(&GivenGoal { x_m: 8.0, ..given });
    controller.give(&GivenGoal { from_scan: 4, x_m: 8.0, ..given });
    assert!(lands(&mut controller, 6));
    // A newer one lets a robot that has landed drive again; one that no drive has changes nothing.
    controller.give(&GivenGoal { from_scan: 7, x_m: 8.0, ..given });
    assert!(!lands(&mut controller, 7));
    controller.give(&GivenGoal { from_scan: 8, index: 9, ..given });
    assert!(!lands(&mut controller, 8));
}

/// The same by a scanner that works.
fn seen_well(scan_id: u64, x_m: f64, speed_mps: f64) -> (Pose, Obstacles) {
    let (pose, mut obstacles) = seen(scan_id, x_m, speed_mps);
    obstacles.scanner = ScannerHealth { seen_ahead_m: 5.0, ..ScannerHealth::default() };
    (pose, obstacles)
}

/// A person who asks for this at the scan of `pose`.
fn by_person(controller: &mut Controller, pose: &Pose, [velocity_mps, steering_rad]: [f64; 2]) {
    let given_ns = pose.header.acquired_ns.max(1);
    let person = GivenControl { number: pose.header.scan_id, given_ns, velocity_mps, steering_rad };
    controller.obey(DrivenBy::Person.wire(), person);
}

#[test]
fn a_person_drives_within_the_bounds_and_is_told_apart() {
    let mut controller = Controller::new(ControllerConfig::default()).unwrap();
    let bounds = controller.config.vehicle.bounds;
    for (scan_id, asked, driven) in [
        (1, [0.4, 0.05], Some([0.4, 0.05])),
        (2, [50.0, -3.0], Some([f64::NAN, -bounds.steering_max_rad])),
        (3, [0.0, 0.05], None),
        (4, [-0.5, 0.0], None),
        (5, [f64::NAN, 0.0], None),
        (6, [0.4, f64::NAN], None),
    ] {
        let (pose, obstacles) = seen_well(scan_id, 1.0, 0.4);
        by_person(&mut controller, &pose, asked);
        let command = controller.step(&pose, &obstacles, &BUDGET);
        let Some([velocity, steering]) = driven else {
            assert_eq!(command.reason, StopReason::Released.wire(), "{asked:?}");
            continue;
        };
        assert_eq!((command.kind, command.level), (CommandKind::Drive.wire(), Level::Person.wire()));
        assert_eq!((command.verified, command.plan_length), (1, 2), "{asked:?}");
        assert!(command.velocity_mps <= command.speed_limit_mps, "never faster than the controller");
        assert!(velocity.is_nan() || command.velocity_mps == velocity, "{}", command.velocity_mps);
        assert_eq!(command.steering_rad, steering);
    }
}

#[test]
fn a_person_who_was_silent_for_a_period_and_a_half_asks_for_nothing() {
    let mut controller = Controller::new(ControllerConfig::default()).unwrap();
    let (pose, obstacles) = seen_well(30, 1.0, 0.4);
    by_person(&mut controller, &pose, [0.4, 0.0]);
    assert_eq!(controller.step(&pose, &obstacles, &BUDGET).kind, CommandKind::Drive.wire());
    let mut successor = controller.clone();
    let (pose, obstacles) = seen_well(31, 1.0, 0.4);
    assert_eq!(controller.step(&pose, &obstacles, &BUDGET).kind, CommandKind::Drive.wire());
    let (pose, obstacles) = seen_well(32, 1.0, 0.4);
    assert_eq!(successor.step(&pose, &obstacles, &BUDGET).reason, StopReason::Released.wire());
}

#[test]
fn a_person_gets_slower_before_an_obstacle_and_stands_where_no_speed_is_verified() {
    let mut controller = Controller::new(ControllerConfig::default()).unwrap();
    let mut faster = f64::INFINITY;
    for (scan_id, gap_m) in [(1, 3.0), (2, 0.25), (3, 0.02)] {
        let (pose, mut obstacles) = seen_well(scan_id, 1.0, 0.4);
        let front_m = pose.predicted_x_m + controller.config.vehicle.length_m / 2.0;
        obstacles.count = 1;
        obstacles.items[0] = obstacle(front_m + gap_m + 0.2, 0.0, [0.55, 0.55], [0.4, 0.4]);
        by_person(&mut controller, &pose, [0.8, 0.0]);
        let command = controller.step(&pose, &obstacles, &BUDGET);
        if gap_m > 0.1 {
            assert_eq!(command.kind, CommandKind::Drive.wire(), "{gap_m} m: {}", command.reason);
            assert!(command.velocity_mps <= faster && command.velocity_mps > 0.0);
            faster = command.velocity_mps;
        } else {
            assert_eq!(command.reason, StopReason::Blocked.wire(), "{gap_m} m");
            assert_eq!(command.blocking.id, obstacles.items[0].id);
        }
    }
    assert!(faster < 0.8, "{faster}");
}

#[test]
fn a_person_who_may_pass_closer_keeps_the_clearance_and_is_no_faster() {
    let nearest_m = |person_margin: PersonMargin| {
        let mut controller =
            Controller::new(ControllerConfig { person_margin, ..Default::default() }).unwrap();
        let clearance_m = controller.config.clearance_m;
        // The gaps to a body ahead, from afar to the contact, at which a robot at rest still drives towards it.
        let driven =
            (1..=60).map(|step| 0.6 - 0.01 * f64::from(step)).enumerate().filter(|(index, gap_m)| {
                let (pose, mut obstacles) = seen_well(1 + *index as u64, 1.0, 0.0);
                let front_m = pose.predicted_x_m + controller.config.vehicle.length_m / 2.0;
                obstacles.count = 1;
                obstacles.items[0] = obstacle(front_m + gap_m + 0.2, 0.0, [0.55, 0.55], [0.4, 0.4]);
                by_person(&mut controller, &pose, [0.8, 0.0]);
                let command = controller.step(&pose, &obstacles, &BUDGET);
                assert!(command.velocity_mps <= command.speed_limit_mps, "never faster");
                command.kind == CommandKind::Drive.wire()
            });
        let nearest_m = driven.map(|(_, gap_m)| gap_m).fold(f64::INFINITY, f64::min);
        assert!(nearest_m > clearance_m, "{nearest_m} m");
        nearest_m
    };
    let [whole_m, close_m] = [PersonMargin::Whole, PersonMargin::Close].map(nearest_m);
    assert!(close_m < whole_m - 0.03, "{close_m} and {whole_m} m");
}

#[test]
fn a_paused_drive_is_planned_and_not_driven_and_continues() {
    let mut controller = Controller::new(ControllerConfig::default()).unwrap();
    controller.obey(DrivenBy::Nobody.wire(), GivenControl::default());
    let (pose, obstacles) = seen_well(1, 1.0, 0.0);
    let command = controller.step(&pose, &obstacles, &BUDGET);
    assert_eq!((command.kind, command.reason), (CommandKind::Stop.wire(), StopReason::Paused.wire()));
    assert_eq!((command.velocity_mps, controller.state().plan_length), (0.0, 0));
    controller.obey(DrivenBy::Controller.wire(), GivenControl::default());
    let (pose, obstacles) = seen_well(2, 1.0, 0.0);
    let command = controller.step(&pose, &obstacles, &BUDGET);
    assert_eq!((command.kind, command.level), (CommandKind::Drive.wire(), Level::Converged.wire()));
}

#[test]
fn a_goal_that_was_set_before_a_rehearsal_counts_after_it() {
    let mut controller = Controller::new(ControllerConfig::default()).unwrap();
    controller.state.arrival = Arrival::Landed.wire();
    let at = |scan_id: u64| {
        let mut pose = Pose { x_m: 10.0, predicted_x_m: 10.0, ..Pose::default() };
        (pose.header.scan_id, pose.header.acquired_ns) = (scan_id, scan_id * 100_000_000);
        pose.predicted_ns = pose.header.acquired_ns + 33_000_000;
        let mut obstacles = Obstacles { scanner: ScannerHealth::healthy(5.0), ..Obstacles::default() };
        obstacles.header.scan_id = scan_id;
        (pose, obstacles)
    };
    let (pose, obstacles) = at(4);
    assert_eq!(controller.step(&pose, &obstacles, &BUDGET).reason, StopReason::Landed.wire());
    controller.give(&GivenGoal { from_scan: 5, x_m: 15.0, tolerance_m: 0.1, ..GivenGoal::default() });
    crate::rehearsal::rehearse(&mut controller, (&pose, &obstacles), 100_000_000, &BUDGET);
    let (pose, obstacles) = at(5);
    assert_eq!(controller.step(&pose, &obstacles, &BUDGET).kind, CommandKind::Drive.wire());
}
