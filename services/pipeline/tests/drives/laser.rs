//! The pose is corrected by the laser: long ways, with surroundings that the stack is told of and those that it is not.

use emulator::Scenario;
use pipeline::{PipelineSettings, SimulatedLoop, Tuning};
use shared_types::{AnySample, AnyStage, Odometry, Pose, Scan, Stage, Truth};
use vehicle::Surroundings;

use crate::{parse, seeds};

/// Errors of the pose against the truth of its scan.
#[derive(Debug, Default)]
struct Errors {
    /// The first scan that counts.
    from: u64,
    truth: Truth,
    scans: f64,
    squares: f64,
    most_m: f64,
    inside: f64,
    /// What was learned until the end.
    learned: [f64; 6],
}

impl pipeline::LoopWatch for Errors {
    fn measured(&mut self, _: &Scan, _: &Odometry, truth: &Truth) {
        self.truth = *truth;
    }

    fn stepped(&mut self, _: &dyn AnyStage, output: Option<AnySample<'_>>) {
        let pose = output.and_then(|output| output.get::<Pose>());
        let Some(pose) = pose.filter(|pose| pose.header.scan_id >= self.from) else { return };
        let (x, y) = (pose.x_m - self.truth.x_m, pose.y_m - self.truth.y_m);
        let [.., xx, xy, _, _, yy] = pose.covariance;
        let squares = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy);
        self.scans += 1.0;
        self.learned = pose.learned;
        self.squares += x * x + y * y;
        self.most_m = self.most_m.max(x.hypot(y));
        self.inside += f64::from(u8::from(squares <= 9.21));
    }
}

/// Drives so far; surroundings that are not stated are told to no stage of the pose.
fn drive(text: &str, way_m: f64, is_stated: bool, change: impl Fn(&mut Tuning)) -> Errors {
    let scans = 100 * way_m as u64;
    let (errors, driven_m) = drive_scans(text, way_m, scans, is_stated, 1, change);
    assert!(driven_m >= way_m, "stopped after {driven_m} m: {errors:?}");
    errors
}

/// Drives so far or for so many scans; those from one on count.
fn drive_scans(
    text: &str,
    way_m: f64,
    scans: u64,
    is_stated: bool,
    from: u64,
    change: impl Fn(&mut Tuning),
) -> (Errors, f64) {
    let scenario: Scenario = parse(text);
    let mut settings = PipelineSettings::of(scenario);
    change(&mut settings.tuning);
    let mut simulation = SimulatedLoop::new(&settings, true).unwrap();
    if !is_stated {
        let mut tuning = settings.tuning.clone().for_scenario(&settings.scenario);
        (tuning.estimator.track.walls, tuning.estimator.track.surroundings) = (false, Surroundings::Open);
        let stage = estimator::EstimatorStage::begin(tuning.estimator, settings.period_ns).unwrap();
        simulation.replace_stage(Box::new(stage));
    }
    let mut errors = Errors { from, ..Errors::default() };
    while simulation.way_m() < way_m && simulation.next_scan() < scans {
        simulation.move_on();
        simulation.measure(&mut errors);
        simulation.settle(&mut errors);
    }
    (errors, simulation.way_m())
}

fn endless(preset: &str, seed: u64, surroundings: &str) -> String {
    format!(
        "name = \"way\"\nseed = {seed}\ntimeout_s = 4000.0\n[track]\nx_m = [0.0, 1000.0]\n\
         surroundings = \"{surroundings}\"\n[goal]\nx_m = 990.0\n[robot]\npreset = \"{preset}\"\n\
         [endless]\nspacing_m = 5.5\nwidth_m = [0.2, 0.5]\nlength_m = 0.1\nlateral_m = 0.6\n"
    )
}

#[test]
fn a_hall_that_is_stated_keeps_the_pose_to_centimetres() {
    for preset in ["summit", "worn"] {
        for (seed, errors) in
            seeds::each(1..=4, |seed| drive(&endless(preset, seed, "hall"), 100.0, true, |_| {}))
        {
            let rms_m = (errors.squares / errors.scans).sqrt();
            assert!(rms_m < 0.01 && errors.most_m < 0.05, "{preset} {seed}: {rms_m} {errors:?}");
            let enough = if preset == "worn" { 0.5 } else { 0.9 };
            assert!(errors.inside / errors.scans > enough, "{preset} {seed}: {errors:?}");
        }
    }
}

#[test]
fn surroundings_that_are_not_stated_keep_the_pose_to_a_thousandth_of_the_way() {
    for (seed, errors) in
        seeds::each(1..=4, |seed| drive(&endless("summit", seed, "hall"), 100.0, false, |_| {}))
    {
        assert!(errors.most_m < 0.15, "{seed}: {errors:?}");
        assert!(errors.inside / errors.scans > 0.9, "{seed}: {errors:?}");
    }
}

#[test]
fn without_a_laser_the_pose_is_that_of_the_odometer() {
    let off = |tuning: &mut Tuning| tuning.estimator.laser = Some(estimator::laser::LaserMode::Off);
    for (seed, errors) in seeds::each(1..=3, |seed| drive(&endless("summit", seed, "hall"), 60.0, true, off))
    {
        assert!(errors.most_m > 0.03 && errors.most_m < 0.6, "{seed}: {errors:?}");
        assert!(errors.inside / errors.scans > 0.9, "{seed}: {errors:?}");
    }
}

#[test]
fn a_worn_robot_is_known_after_twenty_metres() {
    for (seed, errors) in seeds::each(1..=4, |seed| drive(&endless("worn", seed, "hall"), 20.0, true, |_| {}))
    {
        let scenario: Scenario = parse(&endless("worn", seed, "hall"));
        let truth = scenario.robot.values(seed);
        let [_, distance, _, offset_rad, _, velocity] = errors.learned;
        // 1.4 times the desired velocity is sent.
        let factor = 1.4 / (1.0 + velocity);
        assert!((distance - truth.odometry_longitudinal).abs() < 3e-3, "{seed}: {distance}");
        assert!((offset_rad - truth.steering_offset_rad).abs() < 1e-3, "{seed}: {offset_rad}");
        assert!((factor / truth.velocity_factor - 1.0).abs() < 0.02, "{seed}: {factor}");
    }
}

#[test]
fn a_robot_that_is_lifted_finds_itself_within_two_seconds() {
    let lifted = "[robot]\npushed_s = 8.0\npushed_left_m = 0.5\n";
    for (seed, errors) in seeds::each(1..=4, |seed| {
        let text = endless("summit", seed, "hall").replace("[robot]\n", lifted);
        // 20 scans later it knows where; what watches the scanner stops it then.
        drive_scans(&text, f64::INFINITY, 130, true, 102, |_| {}).0
    }) {
        assert!(errors.scans > 10.0 && errors.most_m < 0.05, "{seed}: {errors:?}");
    }
}
