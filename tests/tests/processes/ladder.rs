//! Each rung of the deadline ladder is reached by real processes, and the wheels follow it.
//!
//! What is observed: the command of each scan, with the pose and the obstacles that it rests on; what the actuator
//! sent; and the true motion. All commands are judged by the code that judges the controller in its own tests.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

#[path = "../../../services/nmpc/tests/common/independent.rs"]
mod independent;

use scanloop_tests::machine::repeat_when_late;
use std::cell::{Ref, RefCell};
use std::collections::{BTreeMap, BTreeSet};

use independent::Judge;
use runtime::{Bus, Observer};
use scanloop_tests::{TestSystem, system_file};
use shared_types::{
    Actuation, ActuationKind, Command, CommandKind, Level, MAX_OBSTACLES, Obstacles, PlanNode, Pose, Role,
    Sample, SolveStatus, StopReason, Truth,
};
use vehicle::Control;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty");

/// How many scans of a rung a test waits for.
const SCANS: usize = 8;
/// Difference of the true to the desired wheels of the ideal robot [rad, m/s].
const NEAR: [f64; 2] = [0.002, 0.02];

/// What was published for each scan.
#[derive(Default)]
struct Samples {
    poses: BTreeMap<u64, Pose>,
    obstacles: BTreeMap<u64, Obstacles>,
    commands: BTreeMap<u64, Command>,
    actuations: BTreeMap<u64, Actuation>,
    truths: BTreeMap<u64, Truth>,
}

/// Records a system that runs.
struct Recorder {
    poses: Observer<Pose>,
    obstacles: Observer<Obstacles>,
    commands: Observer<Command>,
    actuations: Observer<Actuation>,
    truths: Observer<Truth>,
    samples: RefCell<Samples>,
    // Dropped last.
    _bus: Bus,
}

fn keep<S: Sample>(observer: &Observer<S>, samples: &mut BTreeMap<u64, S>, is_kept: impl Fn(&S) -> bool) {
    let keep = |sample: &S| {
        if is_kept(sample) {
            samples.insert(sample.header().scan_id, *sample);
        }
    };
    observer.poll(keep).map(|_| ()).expect("the bus can be read");
}

impl Recorder {
    fn new(system: &TestSystem) -> Self {
        let bus = Bus::open(&system.domain(), "test").unwrap();
        Self {
            poses: Observer::new(&bus).unwrap(),
            obstacles: Observer::new(&bus).unwrap(),
            commands: Observer::new(&bus).unwrap(),
            actuations: Observer::new(&bus).unwrap(),
            truths: Observer::new(&bus).unwrap(),
            samples: RefCell::default(),
            _bus: bus,
        }
    }

    /// All that was published so far.
    fn samples(&self) -> Ref<'_, Samples> {
        {
            let samples = &mut *self.samples.borrow_mut();
            keep(&self.poses, &mut samples.poses, |_| true);
            keep(&self.obstacles, &mut samples.obstacles, |_| true);
            keep(&self.commands, &mut samples.commands, |_| true);
            keep(&self.actuations, &mut samples.actuations, |actuation| actuation.answers == 1);
            keep(&self.truths, &mut samples.truths, |_| true);
        }
        self.samples.borrow()
    }
}

impl Samples {
    /// The scans whose command was of this level and moved or blocked the true wheels.
    fn reached(&self, level: Level) -> Vec<u64> {
        let commands = self.commands.values().filter(|command| command.level == level.wire());
        commands.map(|command| command.header.scan_id).filter(|scan| self.is_followed(*scan)).collect()
    }

    /// Whether the true wheels did at the end of the scan period what the command of the scan demands.
    fn is_followed(&self, scan: u64) -> bool {
        let truth = self.truths.get(&(scan + 1)).filter(|truth| truth.actuation_scan == scan);
        let (Some(truth), Some(command)) = (truth, self.commands.get(&scan)) else { return false };
        if command.kind == CommandKind::Drive.wire() {
            truth.blocked == 0
                && (truth.steering_rad - command.steering_rad).abs() < NEAR[0]
                && (truth.speed_mps - command.velocity_mps).abs() < NEAR[1]
        } else {
            truth.blocked == 1
        }
    }

    /// Time between two scans [s].
    fn period_s(&self) -> f64 {
        let mut poses = self.poses.values().map(|pose| (pose.header.scan_id, pose.header.acquired_ns));
        let (first, last) = (poses.next().unwrap(), poses.next_back().unwrap());
        (last.1 - first.1) as f64 * 1e-9 / (last.0 - first.0) as f64
    }

    /// Panics where a command could do harm, where the actuator sent another, or where the robot touched something.
    fn assert_safe(&self) {
        let period_s = self.period_s();
        for (scan, command) in &self.commands {
            if let (Some(pose), Some(obstacles)) = (self.poses.get(scan), self.obstacles.get(scan)) {
                assert_eq!(judge(period_s).objection(command, pose, obstacles), None, "scan {scan}");
            }
            let Some(actuation) = self.actuations.get(scan) else { continue };
            if actuation.kind == ActuationKind::Drive.wire() {
                assert_eq!((command.kind, command.verified), (CommandKind::Drive.wire(), 1), "scan {scan}");
                let sent = (actuation.desired_velocity_mps, actuation.desired_steering_rad);
                assert_eq!(sent, (command.velocity_mps, command.steering_rad), "scan {scan}");
            }
        }
        for (scan, truth) in &self.truths {
            assert_eq!((truth.collided, truth.refused), (0, 0), "scan {scan}");
            assert!(truth.min_clearance_m > 0.0, "scan {scan}");
            let block = |actuation: &&Actuation| actuation.kind != ActuationKind::Drive.wire();
            if self.actuations.get(&truth.actuation_scan).filter(block).is_some() {
                assert_eq!(truth.blocked, 1, "scan {scan}: the wheels turn although they were blocked");
            }
        }
        assert!(self.commands.len() > 5, "{} commands were recorded", self.commands.len());
    }
}

/// A judge of a command whose plan was made for this scan period.
fn judge(period_s: f64) -> Judge {
    let config = nmpc::ControllerConfig::default();
    let (y_range, nmpc::ControllerConfig { vehicle, track, goal, clearance_m, .. }) =
        (config.y_range(), config);
    Judge { vehicle, track, goal, y_range, clearance_m, period_s, ellipses: false }
}

/// Drives with these arguments until a condition holds; all commands of the drive are judged.
fn drive(arguments: &[&str], what: &str, condition: impl Fn(&Samples) -> bool) -> Samples {
    let mut system = TestSystem::new(EXECUTABLE);
    drive_in(&mut system, arguments, what, condition)
}

/// [`drive`] of a system in whose folder there are files.
fn drive_in(
    system: &mut TestSystem,
    arguments: &[&str],
    what: &str,
    condition: impl Fn(&Samples) -> bool,
) -> Samples {
    let ideal = ["--set", "robot.preset=ideal", "--set", "stop_final_s=60"];
    system.start(&[arguments, &ideal].concat());
    let recorder = Recorder::new(system);
    system.wait_until(what, |_| condition(&recorder.samples()));
    let samples = recorder.samples.take();
    drop(recorder);
    assert!(system.run(&["stop"]).status.success(), "{}", system.stderr());
    system.wait();
    system.assert_nothing_left();
    samples.assert_safe();
    samples
}

/// Settings that make the solver slow, or give it time, as arguments.
fn settings<const N: usize>(settings: [&'static str; N]) -> Vec<&'static str> {
    settings.into_iter().flat_map(|setting| ["--set", setting]).collect()
}

/// Whether this many commands of a level turned the wheels to a side.
fn turn(samples: &Samples, level: Level, is_counted: impl Fn(&Command) -> bool) -> bool {
    let commands = samples.reached(level).into_iter().map(|scan| &samples.commands[&scan]);
    commands.filter(|command| command.steering_rad.abs() > 0.01 && is_counted(command)).count() >= SCANS
}

#[test]
fn the_first_rung_turns_the_wheels_by_plans_that_converged() {
    repeat_when_late(|| {
        let enough = settings(["controller.budget_ms=1000", "controller.budget_share=1"]);
        let converged = |command: &Command| command.status == SolveStatus::Converged.wire();
        drive(&[&["corridor"], &enough[..]].concat(), "converged plans turn the wheels", |samples| {
            turn(samples, Level::Converged, converged)
        });
    });
}

#[test]
fn the_second_rung_turns_the_wheels_by_plans_of_too_few_iterations() {
    repeat_when_late(|| {
        let few = settings([
            "controller.budget_ms=1000",
            "controller.budget_share=1",
            "controller.solver.max_iterations=1",
            "controller.solver.tolerance=1e-10",
        ]);
        let ended = |command: &Command| command.status == SolveStatus::MaxIterations.wire();
        drive(
            &[&["corridor"], &few[..]].concat(),
            "plans that did not converge turn the wheels",
            |samples| turn(samples, Level::BestIterate, ended),
        );
    });
}

/// A box to pass, and a barrier far enough behind it that the robot drives straight again when its plans reach there. In
/// the turn, how much of the last plan stays clear depends on how far a search came in 0.1 ms: on the machine.
const BARRIER: &str = r#"
name = "barrier"
[[obstacle]]
shape = "box"
x_m = 5.0
y_m = 0.3
length_m = 0.1
width_m = 0.4
[[obstacle]]
shape = "box"
x_m = 9.5
y_m = 0.0
length_m = 0.1
width_m = 3.5
"#;

/// The path search takes all the time, so that no solution begins. Past the box, steering along the path is the best
/// verified plan. When the barrier is in sight, no path is clear: the rest of the last plan is driven, then nothing is
/// left but a stop.
#[test]
fn without_time_the_wheels_follow_the_best_verified_plan_then_the_rest_of_the_last_one_then_are_blocked() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        std::fs::write(system.folder().join("barrier.toml"), BARRIER).unwrap();
        let slow = settings([
            "controller.budget_ms=0.1",
            "controller.guide.step_m=0.2",
            "controller.intervals=24",
            "rate_hz=5",
        ]);
        let arguments = [&["barrier.toml"], &slow[..]].concat();
        let samples =
            drive_in(&mut system, &arguments, "the robot rests in front of the barrier", |samples| {
                let rests = |scan: &u64| samples.truths[&(scan + 1)].speed_mps <= 0.0;
                samples.reached(Level::Stop).iter().any(rests)
            });
        let [best, rest, stop] =
            [Level::BestIterate, Level::LastPlan, Level::Stop].map(|level| samples.reached(level));
        assert!(best.len() >= SCANS && rest.len() >= 2, "{best:?} {rest:?} {stop:?}");
        assert!(best[0] < rest[0] && rest[rest.len() - 1] < stop[0], "{best:?} {rest:?} {stop:?}");
        for scan in &rest {
            let expected_rad = shifted_rad(&samples.commands[&(scan - 1)], &samples.commands[scan]);
            let truth = samples.truths[&(scan + 1)];
            assert!(
                (truth.steering_rad - expected_rad).abs() < NEAR[0],
                "scan {scan}: {expected_rad} {truth:?}"
            );
        }
        let reason = samples.commands[&stop[0]].reason;
        assert!(
            [StopReason::Blocked, StopReason::Unverified].map(StopReason::wire).contains(&reason),
            "{reason}"
        );
    });
}

/// The steering angle of the plan of a command at the start of a later one.
fn shifted_rad(last: &Command, later: &Command) -> f64 {
    let nodes = &last.plan[..last.plan_length as usize - 1];
    let control = |node: &PlanNode| Control { velocity: node.velocity_mps, steering: node.steering_rad };
    let controls: Vec<Control> = nodes.iter().map(control).collect();
    let mut shifted = Vec::new();
    let elapsed_s = (later.plan_start_ns - last.plan_start_ns) as f64 * 1e-9;
    nmpc::shift(&controls, last.plan_interval_s, elapsed_s, &mut shifted);
    shifted[0].steering
}

#[test]
fn the_last_rung_blocks_the_wheels_in_front_of_a_box_that_appears_too_near_to_steer_around() {
    repeat_when_late(|| {
        drive(&["sudden"], "the robot rests", |samples| {
            let rests = |scan: &u64| samples.truths[&(scan + 1)].speed_mps <= 0.0;
            samples.reached(Level::Converged).len() >= SCANS && samples.reached(Level::Stop).iter().any(rests)
        });
    });
}

/// Drives with a faulty program in a role until a condition holds.
fn drive_with(role: Role, fault: &str, what: &str, condition: impl Fn(&Samples) -> bool) -> Samples {
    let mut system = TestSystem::new(EXECUTABLE);
    let file = system_file(10, &[role], FAULTY, &[fault]);
    std::fs::write(system.folder().join("system.toml"), file).unwrap();
    drive_in(&mut system, &["free", "--system", "system.toml"], what, condition)
}

/// Whether the robot has driven and rests.
fn rests(samples: &Samples) -> bool {
    let drove = samples.truths.values().any(|truth| truth.speed_mps > 0.5);
    let last = samples.truths.values().next_back();
    drove && last.is_some_and(|truth| truth.blocked == 1 && truth.speed_mps <= 0.0)
}

#[test]
fn obstacles_that_are_not_numbers_block_the_wheels() {
    repeat_when_late(|| {
        let samples = drive_with(Role::Obstacles, "nan", "it rests", rests);
        assert!(
            samples.actuations.values().all(|actuation| actuation.header.scan_id < 15),
            "it answered one"
        );
    });
}

#[test]
fn a_body_at_the_place_of_the_robot_blocks_the_wheels() {
    repeat_when_late(|| {
        let samples = drive_with(Role::Obstacles, "inside", "it rests", rests);
        let reasons = samples.reached(Level::Stop).into_iter().map(|scan| samples.commands[&scan].reason);
        assert!(reasons.into_iter().all(|reason| reason == StopReason::Covered.wire()));
    });
}

#[test]
fn a_heap_of_sixteen_ellipses_is_passed_at_a_distance() {
    repeat_when_late(|| {
        let samples = drive_with(Role::Obstacles, "heap", "it is past the heap", |samples| {
            samples.truths.values().any(|truth| truth.x_m > 7.5)
        });
        let heaps =
            samples.obstacles.values().filter(|obstacles| obstacles.list().len() == MAX_OBSTACLES).count();
        assert!(heaps > SCANS, "{heaps}");
        let beside = samples.truths.values().filter(|truth| (truth.x_m - 6.0).abs() < 0.5);
        for truth in beside {
            // The heap reaches from 0.0 to 0.8 m; half of the body is 0.2 m wide.
            assert!(truth.y_m < -0.25, "{truth:?}");
        }
    });
}

#[test]
fn a_controller_resumes_from_a_state_that_is_no_number_and_drives_on() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let once =
            "test -e ended || { touch ended; exec \"$0\" controller bad-state; }; exec \"$1\" service nmpc";
        let command = ["sh", "-c", once, FAULTY, EXECUTABLE];
        let mut file = system_file(10, &[Role::Controller], FAULTY, &[]);
        file = file
            .replace(&format!("command = {:?}", [FAULTY, "controller"]), &format!("command = {command:?}"));
        std::fs::write(system.folder().join("system.toml"), file.replace("never", "on-failure")).unwrap();
        let samples =
            drive_in(&mut system, &["free", "--system", "system.toml"], "it drives on", |samples| {
                let reached = samples.reached(Level::Converged);
                reached.iter().filter(|scan| **scan > 30).count() >= SCANS
            });
        let writers: BTreeSet<u32> =
            samples.commands.values().map(|command| command.header.incarnation).collect();
        assert_eq!(writers.len(), 2, "{writers:?}");
    });
}
