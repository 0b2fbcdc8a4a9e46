//! Stages that rehearse before some of their scans, and are cut short in some, give the bits of those that never do.
#![expect(clippy::unwrap_used, reason = "a test may panic")]

use actuation::{Actuator, ActuatorState};
use bytemuck::bytes_of;
use emulator::{Emulator, Scenario};
use estimator::{Estimator, EstimatorState};
use nmpc::{Budget, Controller, ControllerState, Rehearsal};
use obstacles::{ObstacleDetector, ObstaclesState};
use pipeline::PipelineSettings;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use shared_types::{
    Actuation, Command, Header, Obstacles, Odometry, Pose, Role, Sample, Scan, StageStamps, Truth,
};

/// Scans of a drive: beyond the obstacles, and where there is a goal, up to it.
const SCANS: u64 = 150;
/// Iterations that a step may use.
const ITERATIONS: u32 = 40;

/// The stages of one loop.
struct Stages {
    estimator: Estimator,
    detector: ObstacleDetector,
    controller: Controller,
    actuator: Actuator,
    rehearsal: Rehearsal,
    odometry: Odometry,
    period_ns: u64,
}

/// What the stages publish for one scan, and what they save.
#[derive(Default)]
struct Outputs {
    pose: Pose,
    obstacles: Obstacles,
    command: Command,
    actuation: Actuation,
    states: (EstimatorState, ObstaclesState, ControllerState, ActuatorState),
}

impl Stages {
    fn new(settings: &PipelineSettings) -> Self {
        let tuning = settings.tuning.clone().for_scenario(&settings.scenario);
        Self {
            estimator: Estimator::new(&tuning.estimator).unwrap(),
            detector: ObstacleDetector::new(tuning.obstacles).unwrap(),
            controller: Controller::new(tuning.controller).unwrap(),
            actuator: Actuator::new(tuning.actuator, settings.period_ns).unwrap(),
            rehearsal: Rehearsal::new(settings.period_ns),
            odometry: Odometry::default(),
            period_ns: settings.period_ns,
        }
    }

    fn step(&mut self, odometry: &Odometry, scan: &Scan, now_ns: u64) -> Outputs {
        let mut pose = self.estimator.step(odometry, None, now_ns).unwrap();
        complete(Role::Estimator, &mut pose, now_ns);
        let mut obstacles = self.detector.step(scan, &pose);
        complete(Role::Obstacles, &mut obstacles, now_ns);
        let mut command = self.controller.step(&pose, &obstacles, &Budget::Iterations(ITERATIONS));
        complete(Role::Controller, &mut command, now_ns);
        let mut actuation = self.actuator.answer(&command, now_ns);
        complete(Role::Actuator, &mut actuation, now_ns);
        self.estimator.note(&actuation, now_ns);
        self.rehearsal.keep(&pose, &obstacles);
        self.odometry = *odometry;
        let states =
            (self.estimator.state(), self.detector.state(), self.controller.state(), self.actuator.state());
        Outputs { pose, obstacles, command, actuation, states }
    }

    /// Rehearses in some of the stages, each up to three times, and in the controller with any number of iterations.
    fn rehearse(&mut self, scan: &Scan, outputs: &Outputs, due_ns: u64, random: &mut Pcg64Mcg) {
        for _ in 0..random.random_range(0..4) {
            self.estimator.rehearse(&self.odometry, self.period_ns, due_ns);
        }
        for _ in 0..random.random_range(0..4) {
            self.detector.rehearse(scan, &outputs.pose, self.period_ns);
        }
        for _ in 0..random.random_range(0..4) {
            let budget = Budget::Iterations(random.random_range(0..ITERATIONS));
            self.rehearsal.run(&mut self.controller, &budget);
        }
        for _ in 0..random.random_range(0..4) {
            self.actuator.rehearse(&outputs.command, self.period_ns, due_ns);
        }
    }
}

impl Outputs {
    fn bytes(&self) -> Vec<u8> {
        let (estimator, obstacles, controller, actuator) = &self.states;
        [
            bytes_of(&self.pose),
            bytes_of(&self.obstacles),
            bytes_of(&self.command),
            bytes_of(&self.actuation),
            bytes_of(estimator),
            bytes_of(obstacles),
            bytes_of(controller),
            bytes_of(actuator),
        ]
        .concat()
    }
}

/// Completes a header as the bus does.
fn complete<S: Sample>(role: Role, sample: &mut S, now_ns: u64) {
    let header = sample.header_mut();
    (header.layout, header.incarnation, header.sequence) = (S::LAYOUT, 1, header.scan_id);
    *header.stage_mut(role) = StageStamps { published_ns: now_ns, ..StageStamps::default() };
}

/// Drives a scenario with stages that never rehearse, and gives the same inputs to stages that do.
fn compare(name: &str, keys: &str, seed: u64) {
    let text = format!("{}\n{keys}", Scenario::shipped(name).unwrap());
    let settings = PipelineSettings::of(Scenario { seed, ..Scenario::parse(&text, "test").unwrap() });
    let mut emulator = Emulator::new(&settings.scenario, settings.period_ns);
    let (mut plain, mut rehearsed) = (Stages::new(&settings), Stages::new(&settings));
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let (mut scan, mut odometry, mut truth) = (Scan::default(), Odometry::default(), Truth::default());
    for scan_id in 1..=SCANS {
        let now_ns = emulator.scan_ready_ns(scan_id);
        emulator.advance_to(now_ns);
        emulator.measure(scan_id, &mut scan, &mut odometry, &mut truth);
        let acquired_ns = emulator.stamp_ns(scan_id);
        for header in [&mut scan.header, &mut odometry.header] {
            *header = Header { scan_id, acquired_ns, ..Header::default() };
        }
        complete(Role::Robot, &mut scan, now_ns);
        complete(Role::Robot, &mut odometry, now_ns);
        let outputs = plain.step(&odometry, &scan, now_ns);
        let others = rehearsed.step(&odometry, &scan, now_ns);
        assert!(outputs.bytes() == others.bytes(), "{name}, {keys:?}, seed {seed}: scan {scan_id} differs");
        rehearsed.rehearse(&scan, &others, now_ns + settings.period_ns, &mut random);
        emulator.actuate(&outputs.actuation);
    }
}

#[test]
fn rehearsals_change_no_bit_of_a_drive() {
    for name in ["corridor", "slalom", "crossing", "noisy", "walls", "sudden", "blocked", "two-obstacles"] {
        for seed in [1, 2] {
            compare(name, "", seed);
        }
    }
}

#[test]
fn rehearsals_change_no_bit_where_the_scanner_fails() {
    for keys in [
        "missing_every = 3",
        "period_s = [0.005, 0.255]\nstamp_jitter_s = 0.02",
        "dead_rad = [[-0.3, 0.3]]\nfrom_s = 1.0\nmissing_every = 2",
        "stuck_s = 3.0\nto_s = 4.0",
    ] {
        for name in ["slalom", "crossing"] {
            compare(name, &format!("[scanner]\n{keys}"), 3);
        }
    }
}
