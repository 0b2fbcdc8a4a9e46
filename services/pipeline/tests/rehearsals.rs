//! Stages that rehearse before some of their scans, and are cut short in some, give the bits of those that never do.
#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::cell::Cell;

use actuation::ActuatorStage;
use bytemuck::bytes_of;
use emulator::{Emulator, Scenario};
use estimator::EstimatorStage;
use nmpc::ControllerStage;
use obstacles::DetectorStage;
use pipeline::PipelineSettings;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use shared_types::{
    Actuation, AnySample, Command, Header, Obstacles, Odometry, Pose, Role, Sample, Scan, Stage, StageStamps,
    Stopwatch, Truth,
};

/// Scans of a drive: beyond the obstacles, and where there is a goal, up to it.
const SCANS: u64 = 150;
/// Readings of its clock that a rehearsal of the controller may use.
const READINGS: u64 = 40;

/// The stages of one loop.
struct Stages {
    estimator: EstimatorStage,
    detector: DetectorStage,
    controller: ControllerStage,
    actuator: ActuatorStage,
}

/// What the stages publish for one scan, and what they save.
struct Outputs {
    pose: Pose,
    obstacles: Obstacles,
    command: Command,
    actuation: Actuation,
    states: Vec<u8>,
}

/// What a stage answers to samples of one scan, completed as the bus does.
fn answer<T: Stage>(stage: &mut T, samples: &[AnySample<'_>], now_ns: u64) -> T::Output {
    samples.iter().for_each(|sample| stage.take(*sample, now_ns));
    let mut output = stage.output(samples[0].header().scan_id, &Stopwatch::standing()).unwrap();
    samples.iter().for_each(|sample| stage.keep(*sample));
    complete(T::ROLE, &mut output, now_ns);
    output
}

fn state_of<T: Stage>(stage: &T) -> Vec<u8> {
    bytes_of(&stage.state().unwrap()).to_vec()
}

impl Stages {
    fn new(settings: &PipelineSettings) -> Self {
        let tuning = settings.tuning.clone().for_scenario(&settings.scenario);
        let period_ns = settings.period_ns;
        Self {
            estimator: EstimatorStage::begin(tuning.estimator, period_ns).unwrap(),
            detector: DetectorStage::begin(tuning.obstacles, period_ns).unwrap(),
            controller: ControllerStage::begin(tuning.controller, period_ns).unwrap(),
            actuator: ActuatorStage::begin(tuning.actuator, period_ns).unwrap(),
        }
    }

    fn step(&mut self, odometry: &Odometry, scan: &Scan, now_ns: u64) -> Outputs {
        let pose = answer(&mut self.estimator, &[AnySample::of(odometry)], now_ns);
        let obstacles = answer(&mut self.detector, &[AnySample::of(scan), AnySample::of(&pose)], now_ns);
        let command =
            answer(&mut self.controller, &[AnySample::of(&pose), AnySample::of(&obstacles)], now_ns);
        let actuation = answer(&mut self.actuator, &[AnySample::of(&command)], now_ns);
        self.estimator.take(AnySample::of(&actuation), now_ns);
        let states = [
            state_of(&self.estimator),
            state_of(&self.detector),
            state_of(&self.controller),
            state_of(&self.actuator),
        ];
        Outputs { pose, obstacles, command, actuation, states: states.concat() }
    }

    /// Rehearses in some of the stages, each up to three times, and in the controller for any time.
    fn rehearse(&mut self, due_ns: u64, random: &mut Pcg64Mcg) {
        for _ in 0..random.random_range(0..4) {
            self.estimator.rehearse(due_ns, &|| 0);
        }
        for _ in 0..random.random_range(0..4) {
            self.detector.rehearse(due_ns, &|| 0);
        }
        for _ in 0..random.random_range(0..4) {
            let left = Cell::new(random.random_range(0..READINGS));
            let now_ns = || match left.get().checked_sub(1) {
                None => due_ns,
                Some(fewer) => {
                    left.set(fewer);
                    due_ns - 1
                }
            };
            self.controller.rehearse(due_ns, &now_ns);
        }
        for _ in 0..random.random_range(0..4) {
            self.actuator.rehearse(due_ns, &|| 0);
        }
    }
}

impl Outputs {
    fn bytes(&self) -> Vec<u8> {
        [
            bytes_of(&self.pose),
            bytes_of(&self.obstacles),
            bytes_of(&self.command),
            bytes_of(&self.actuation),
            &self.states,
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
        rehearsed.rehearse(now_ns + settings.period_ns, &mut random);
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
