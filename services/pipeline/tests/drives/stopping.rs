//! The speed limit: each of its terms prevents a collision with what appears at `sudden_m`.

use emulator::scenario::{Preset, ScenarioObstacle, Shape};
use emulator::{Outcome, Scenario};
use nmpc::{ControllerConfig, speed_limit};
use pipeline::{PipelineSettings, Tuning};
use vehicle::Description;

use crate::gaps::{block, gap};
use crate::{End, end, parse, seeds, shipped};

/// Two scans per second.
const PERIOD_S: f64 = 0.5;
/// How near a wall appears [m].
const SUDDEN_M: f64 = 2.0;

/// A robot that is hard to stop.
fn vehicle() -> Description {
    Description {
        blocked_deceleration_mps2: 0.5,
        command_delay_s: 0.2,
        sudden_m: SUDDEN_M,
        ..Description::default()
    }
}

/// A wall across the track that appears `SUDDEN_M` ahead of the worst robot that the description allows for.
///
/// That robot is 5 % faster than desired and brakes 20 % weaker than described. `phase` places the wall, and so chooses
/// when within a scan period it appears.
fn wall_appears(phase: u64) -> Scenario {
    let mut scenario = parse("name = \"wall\"\nstop_final_s = 2.0\n");
    let shape = Shape::Box { length_m: 0.1, width_m: 3.6, yaw_rad: 0.0 };
    let wall = ScenarioObstacle::fixed(shape, 5.0 + 0.02 * phase as f64, 0.0);
    scenario.obstacles = vec![ScenarioObstacle { appears_ahead_m: Some(SUDDEN_M), ..wall }];
    scenario.robot.velocity_factor = Some(1.4 / 1.05);
    scenario.robot.blocked_deceleration_mps2 = Some(0.8 * vehicle().blocked_deceleration_mps2);
    scenario.robot.command_delay_s = Some(vehicle().command_delay_s);
    scenario
}

fn at(scenario: Scenario, mut tuning: Tuning, period_s: f64) -> PipelineSettings {
    tuning.controller.period_s = period_s;
    PipelineSettings { scenario, tuning, period_ns: (period_s * 1e9) as u64 }
}

/// The ends of drives at all phases.
fn ends(tuning: &Tuning) -> Vec<(u64, End)> {
    seeds::each(0..=24, |phase| end(&at(wall_appears(phase), tuning.clone(), PERIOD_S)))
}

fn described() -> Tuning {
    let mut tuning = Tuning::of(vehicle());
    tuning.controller.period_s = PERIOD_S;
    tuning
}

/// Whether a robot without a limit collides that cruises at the limit of `without`.
fn collides(without: &str, change: impl Fn(&mut ControllerConfig)) {
    let mut tuning = described();
    let mut changed = tuning.controller.clone();
    change(&mut changed);
    tuning.controller.vehicle.sudden_m = 100.0;
    tuning.controller.cruise_mps = speed_limit(&changed).min(1.0);
    let is_collision = |(_, end): &(u64, End)| end.outcome == Outcome::Collision;
    assert!(ends(&tuning).iter().any(is_collision), "without {without}");
}

#[test]
fn with_all_terms_nothing_is_touched() {
    for (phase, end) in ends(&described()) {
        assert_eq!(end.outcome, Outcome::Stopped, "{phase}: {end:?}");
        assert!(end.clearance_m > 0.0, "{phase}: {end:?}");
    }
}

#[test]
fn every_term_is_needed() {
    collides("sudden_m", |config| config.vehicle.sudden_m = 100.0);
    collides("braking way", |config| config.vehicle.blocked_deceleration_mps2 = 50.0);
    // The age at the end of the sweep is a third of the period.
    collides("scan period", |config| config.period_s /= 4.0);
    collides("age of the data", |config| config.period_s *= 0.75);
    collides("command delay", |config| config.vehicle.command_delay_s = 0.0);
    collides("speed error", |config| config.stop.speed_error = 0.0);
    collides("deceleration error", |config| config.stop.deceleration_error = 0.0);
}

/// The wall of `blocked` is known long before: the robot approaches it only as fast as it can stop.
#[test]
fn a_dead_end_is_never_touched_with_smooth_tyres_and_at_low_rates() {
    for preset in [Preset::Ideal, Preset::Summit] {
        for (deceleration, rate_hz) in
            [(0.1, 10.0), (0.3, 10.0), (0.1, 2.0), (0.3, 2.0), (0.3, 1.0), (5.0, 2.0), (5.0, 0.5), (0.1, 0.5)]
        {
            for (seed, end) in seeds::each(1..=4, |seed| {
                let mut scenario = shipped("blocked");
                (scenario.robot.preset, scenario.seed) = (preset, seed);
                scenario.robot.blocked_deceleration_mps2 = Some(deceleration);
                let vehicle =
                    Description { blocked_deceleration_mps2: deceleration, ..Description::default() };
                end(&at(scenario, Tuning::of(vehicle), 1.0 / rate_hz))
            }) {
                let is_right = end.outcome == Outcome::Stopped && end.is_untouched();
                assert!(is_right, "{preset:?}, {deceleration} m/s^2, {rate_hz} Hz, seed {seed}: {end:?}");
            }
        }
    }
}

/// Wheels are blocked at once whatever the lag of the drive, so the speed limit has no term for it.
#[test]
fn the_lag_of_the_drive_does_not_lengthen_a_stop() {
    let stopped = |lag_s: f64| {
        let mut scenario = shipped("sudden");
        scenario.robot.preset = Preset::Summit;
        scenario.robot.velocity_lag_s = Some(lag_s);
        let vehicle = Description { velocity_lag_s: lag_s, ..Description::default() };
        let end = end(&at(scenario, Tuning::of(vehicle), 0.1));
        assert_eq!(end.outcome, Outcome::Stopped, "{end:?}");
        end.clearance_m
    };
    for lag_s in [0.0, 0.15, 1.0, 2.0] {
        // At 1 m/s: up to 0.1 m to the next scan, 0.06 m to the stop, and 0.1 m of sliding.
        let clearance_m = stopped(lag_s);
        assert!((0.92..1.10).contains(&clearance_m), "{lag_s} s: {clearance_m} m");
    }
}

/// The prediction contains the lag. Without it the estimate contradicts the odometry while the speed changes, which is
/// too short for the self-check.
#[test]
fn a_lag_of_the_drive_touches_nothing_described_or_left_out() {
    let ends = |described: bool| {
        seeds::each(1..=8, |seed| {
            let mut scenario = shipped("corridor");
            scenario.seed = seed;
            scenario.robot.velocity_lag_s = Some(1.0);
            let description = Description::default();
            let lag_s = if described { 1.0 } else { description.velocity_lag_s };
            end(&at(scenario, Tuning::of(Description { velocity_lag_s: lag_s, ..description }), 0.1))
        })
    };
    for (seed, end) in ends(true) {
        assert!(end.outcome == Outcome::Reached && end.clearance_m > 0.15, "seed {seed}: {end:?}");
    }
    for (seed, end) in ends(false) {
        assert!(end.clearance_m > 0.1, "seed {seed}: {end:?}");
    }
}

/// Width of the gap in front of a wall [m].
const GAP_M: f64 = 0.8;

/// A robot with smooth tyres drives through a gap when a wall appears behind it: it slides with blocked wheels.
fn slides(deceleration: f64, wall_x_m: f64) -> PipelineSettings {
    let vehicle =
        Description { blocked_deceleration_mps2: deceleration, sudden_m: 4.0, ..Description::default() };
    let mut scenario = gap(Preset::Ideal, GAP_M, 0.5, 1);
    let wall = Shape::Box { length_m: 0.1, width_m: 3.6, yaw_rad: 0.0 };
    let wall = ScenarioObstacle::fixed(wall, wall_x_m, 0.0);
    scenario.obstacles = vec![block(0.5, [-1.6, 0.5 - GAP_M / 2.0]), block(0.5, [0.5 + GAP_M / 2.0, 2.0])];
    scenario.obstacles.push(ScenarioObstacle { appears_ahead_m: Some(3.4), ..wall });
    scenario.robot.blocked_deceleration_mps2 = Some(deceleration);
    scenario.stop_final_s = 4.0;
    PipelineSettings { scenario, tuning: Tuning::of(vehicle), period_ns: 100_000_000 }
}

/// The wall appears in every phase of the turn into the gap. The wheels keep their angle, so the robot slides along an
/// arc.
#[test]
fn a_slide_with_blocked_wheels_ends_clear_of_the_edges_of_a_gap() {
    for deceleration in [0.15, 0.2] {
        let ends = seeds::each(0..=15, |step| end(&slides(deceleration, 8.5 + 0.1 * step as f64)));
        for (step, end) in ends {
            assert!(end.is_untouched() && end.clearance_m > 0.03, "{deceleration} m/s^2, {step}: {end:?}");
        }
    }
}
