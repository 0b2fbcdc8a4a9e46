//! The watch over the calibration, in whole drives: what it finds, how soon, and that it is silent otherwise.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use emulator::{Outcome, Scenario};
use pipeline::{PipelineSettings, drive};
use shared_types::{Alarm, StopReason, Suspect};

fn shipped(name: &str) -> Scenario {
    Scenario::parse(Scenario::shipped(name).unwrap(), name).unwrap()
}

/// What was seen of the watch in one drive.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Seen {
    outcome: Outcome,
    scans: u64,
    /// Time of the first alarm [s] and the suspect then.
    first: Option<(f64, Suspect)>,
    /// Time at which the watch asked to stop [s].
    stop_s: Option<f64>,
    /// Speed at that time [m/s].
    speed_at_stop: f64,
    /// Distance of estimate and truth when the wheels stood [m].
    error_at_end: f64,
    /// Whether the controller gave the watch as its reason.
    stopped_by_it: bool,
}

fn watch(settings: &PipelineSettings) -> Seen {
    let mut seen = Seen {
        outcome: Outcome::Failed,
        scans: 0,
        first: None,
        stop_s: None,
        speed_at_stop: 0.0,
        error_at_end: 0.0,
        stopped_by_it: false,
    };
    let drive = drive(settings, |step| {
        seen.scans += 1;
        let (Some(pose), Some(command)) = (step.pose, step.command) else { return };
        let time_s = step.truth.time_s;
        if pose.alarm != Alarm::None.wire() && seen.first.is_none() {
            seen.first = Some((time_s, Suspect::try_from(pose.suspect).unwrap()));
        }
        if pose.alarm == Alarm::Stop.wire() && seen.stop_s.is_none() {
            seen.stop_s = Some(time_s);
            seen.speed_at_stop = step.truth.speed_mps;
        }
        seen.error_at_end = (pose.x_m - step.truth.x_m).hypot(pose.y_m - step.truth.y_m);
        seen.stopped_by_it |= command.reason == StopReason::SelfCheck.wire();
    })
    .unwrap();
    seen.outcome = drive.outcome;
    eprintln!("{seen:?}");
    seen
}

#[test]
fn a_velocity_factor_off_by_ten_percent_slows_stops_and_is_named() {
    for factor in [1.4 * 1.1, 1.4 * 0.9] {
        for name in ["corridor", "noisy"] {
            let mut scenario = shipped(name);
            scenario.robot.velocity_factor = Some(factor);
            let seen = watch(&PipelineSettings::of(scenario));
            let (first_s, suspect) = seen.first.unwrap();
            assert_eq!((seen.outcome, suspect), (Outcome::Stopped, Suspect::VelocityFactor));
            // Two seconds of a window, two of patience.
            assert!(first_s < 3.0 && seen.stop_s.unwrap() < 5.5 && seen.stopped_by_it, "{seen:?}");
            assert!(seen.speed_at_stop < 0.4, "it had slowed down: {seen:?}");
        }
    }
}

#[test]
fn a_drift_gradient_of_twice_the_calibrated_one_slows_stops_and_is_named() {
    for (rate, sign) in [(0.053, 1.0), (0.053, -1.0), (0.03, 1.0)] {
        let mut scenario = shipped("free");
        scenario.robot.odometry_lateral_rate = Some(2.0 * rate * sign);
        (scenario.noise.odometry_m, scenario.noise.odometry_rad) = (0.005, 0.003);
        let mut settings = PipelineSettings::of(scenario);
        settings.tuning.estimator.odometry_lateral_rate = Some(rate * sign);
        let seen = watch(&settings);
        assert_eq!(seen.outcome, Outcome::Stopped);
        assert_eq!(seen.first.unwrap().1, Suspect::OdometryLateral);
        assert!(seen.stopped_by_it, "{seen:?}");
    }
}

#[test]
fn a_sudden_jump_of_the_heading_slows_at_once_stops_and_is_named() {
    for jump in [0.1, -0.1, 0.5, 3.0] {
        let mut scenario = shipped("corridor");
        (scenario.robot.odometry_jump_rad, scenario.robot.odometry_jump_s) = (jump, 4.0);
        let seen = watch(&PipelineSettings::of(scenario));
        let (first_s, suspect) = seen.first.unwrap();
        assert_eq!((seen.outcome, suspect), (Outcome::Stopped, Suspect::Heading));
        assert!((4.0..4.5).contains(&first_s) && seen.stop_s.unwrap() < 4.8, "{seen:?}");
    }
}

#[test]
fn a_robot_that_is_as_calibrated_raises_no_alarm() {
    for mut scenario in Scenario::names().map(shipped).filter(|scenario| scenario.system.is_none()) {
        let name = scenario.name.clone();
        scenario.timeout_s = scenario.timeout_s.min(60.0);
        let seen = watch(&PipelineSettings::of(scenario));
        assert_eq!(seen.first, None, "{name}");
    }
    // As much noise as R expects, for 300 s.
    let mut scenario = shipped("endless");
    scenario.timeout_s = 300.0;
    (scenario.noise.odometry_m, scenario.noise.odometry_rad) = (0.02, 0.01);
    assert_eq!(watch(&PipelineSettings::of(scenario)).first, None);
}

#[test]
#[ignore = "three hours of driving: half a minute and more"]
fn ten_kilometres_with_full_noise_raise_no_alarm() {
    let mut scenario = shipped("endless");
    (scenario.noise.odometry_m, scenario.noise.odometry_rad) = (0.02, 0.01);
    let seen = watch(&PipelineSettings::of(scenario));
    assert_eq!(seen.first, None);
    assert_eq!(seen.outcome, Outcome::Reached);
}
