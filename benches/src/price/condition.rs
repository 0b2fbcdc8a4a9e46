//! The conditions under which the courses are driven: one thing at a time differs from the chosen robot and system.
//!
//! A condition is a list of overrides, as `--set` takes them. So it goes through the same checks as a run, and a
//! condition that a run would refuse is refused here with the same message.

use console::exit::Failure;
use plan::{Choice, Plan};
use serde::Serialize;

use super::PriceArguments;
use super::course;

/// Delays added between actuator and wheels [ms].
const LATENCIES_MS: [f64; 6] = [0.0, 10.0, 20.0, 50.0, 100.0, 150.0];
/// Scan rates [Hz].
const RATES_HZ: [f64; 4] = [5.0, 10.0, 20.0, 50.0];
/// Standard deviations of the white noise of the reported position [m].
const POSE_SIGMAS_M: [f64; 4] = [0.0, 0.01, 0.02, 0.04];
/// Radii of bends [m].
const RADII_M: [f64; 3] = [9.0, 6.0, 4.5];
/// Smallest variance that the estimator accepts [m^2].
const VARIANCE_MIN_M2: f64 = 1e-12;

/// What differs in a group of conditions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Varied {
    /// The delay between actuator and wheels.
    Latency,
    /// The scan rate.
    Rate,
    /// The noise of the reported position.
    PoseSigma,
    /// The radius of the bend that the course has.
    Bend,
}

/// One condition.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Condition {
    pub(super) varied: Varied,
    pub(super) latency_ms: f64,
    pub(super) rate_hz: f64,
    pub(super) pose_sigma_m: f64,
    /// Of a course that is no line.
    pub(super) radius_m: Option<f64>,
    /// `KEY=VALUE`, in the order in which they act.
    pub(super) overrides: Vec<String>,
}

/// The chosen robot and system, without any change.
///
/// # Errors
/// One message with file, key, value and allowed range; exit code 2.
pub(super) fn base(arguments: &PriceArguments) -> anyhow::Result<Plan> {
    let plan = read(arguments, &[])?;
    // The track may be too short for the course.
    let course = course::gap(&plan.scenario, plan.scenario.robot.width_m, plan.scenario.seed);
    course.validate().map_err(|invalid| Failure::bad_input(format!("course of `price`: {invalid}")))?;
    Ok(plan)
}

/// Scenario and system with further overrides; the course is still empty.
///
/// # Errors
/// As [`base`].
pub(super) fn read(arguments: &PriceArguments, overrides: &[String]) -> anyhow::Result<Plan> {
    let preset = std::iter::once(format!("robot.preset={}", arguments.robot.name()));
    let own = preset.chain(arguments.choice.overrides.iter().cloned());
    let overrides = own.chain(overrides.iter().cloned()).collect();
    Plan::read(Some("free"), &Choice { overrides, ..arguments.choice.clone() })
}

/// All conditions around a base, grouped by what varies.
pub(super) fn all(base: &Plan) -> Vec<Condition> {
    let latencies = LATENCIES_MS.iter().map(|latency_ms| of_latency(base, *latency_ms));
    let rates = RATES_HZ.iter().map(|rate_hz| of_rate(base, *rate_hz));
    let sigmas = POSE_SIGMAS_M.iter().map(|sigma_m| of_pose_sigma(base, *sigma_m));
    let bends = RADII_M.iter().map(|radius_m| of_bend(base, *radius_m));
    latencies.chain(rates).chain(sigmas).chain(bends).collect()
}

fn unchanged(base: &Plan, varied: Varied) -> Condition {
    let (rate_hz, pose_sigma_m) = (base.system.rate_hz, base.scenario.noise.odometry_m);
    Condition { varied, latency_ms: 0.0, rate_hz, pose_sigma_m, radius_m: None, overrides: Vec::new() }
}

/// The delay is added to the true robot and to its description: the stack knows its latency.
fn of_latency(base: &Plan, latency_ms: f64) -> Condition {
    let unchanged = unchanged(base, Varied::Latency);
    if latency_ms == 0.0 {
        return unchanged;
    }
    let added_s = latency_ms * 1e-3;
    let described_s = base.system.vehicle.command_delay_s + added_s;
    let true_s = base.scenario.robot_values().command_delay_s + added_s;
    let overrides =
        vec![format!("vehicle.command_delay_s={described_s:?}"), format!("robot.command_delay_s={true_s:?}")];
    Condition { latency_ms, overrides, ..unchanged }
}

fn of_rate(base: &Plan, rate_hz: f64) -> Condition {
    let unchanged = unchanged(base, Varied::Rate);
    if rate_hz == base.system.rate_hz {
        return unchanged;
    }
    let overrides =
        vec![format!("rate_hz={rate_hz:?}"), format!("controller.period_s={:?}", rate_hz.recip())];
    Condition { rate_hz, overrides, ..unchanged }
}

/// The estimator is told the noise that the robot has.
fn of_pose_sigma(base: &Plan, pose_sigma_m: f64) -> Condition {
    let variance_m2 = pose_sigma_m.powi(2).max(VARIANCE_MIN_M2);
    // A plan has been checked, so its estimator has settings.
    let yaw_rad2 =
        base.system.estimator.settings().map_or(variance_m2, |settings| settings.measurement_noise[0]);
    let overrides = vec![
        format!("noise.odometry_m={pose_sigma_m:?}"),
        format!("estimator.measurement_noise=[{yaw_rad2:?}, {variance_m2:?}, {variance_m2:?}]"),
    ];
    Condition { pose_sigma_m, overrides, ..unchanged(base, Varied::PoseSigma) }
}

/// Both courses stand in the bend.
fn of_bend(base: &Plan, radius_m: f64) -> Condition {
    let overrides = vec![course::bend(radius_m)];
    Condition { radius_m: Some(radius_m), overrides, ..unchanged(base, Varied::Bend) }
}

#[cfg(test)]
mod tests {
    use emulator::scenario::Values;

    use super::*;

    #[test]
    fn one_thing_differs_and_every_condition_can_be_read() {
        let arguments = PriceArguments::default();
        let base = base(&arguments).unwrap();
        let conditions = all(&base);
        assert_eq!(conditions.len(), 17);
        assert_eq!(conditions.iter().filter(|condition| condition.overrides.is_empty()).count(), 2);
        for condition in conditions {
            let plan = read(&arguments, &condition.overrides).unwrap();
            let added_s = plan.system.vehicle.command_delay_s - base.system.vehicle.command_delay_s;
            assert!((added_s - condition.latency_ms * 1e-3).abs() < 1e-12);
            let [truth, unchanged] = [&plan, &base].map(|plan| plan.scenario.robot_values());
            let added_s = truth.command_delay_s - unchanged.command_delay_s;
            assert!((added_s - condition.latency_ms * 1e-3).abs() < 1e-12);
            assert_eq!(Values { command_delay_s: unchanged.command_delay_s, ..truth }, unchanged);
            assert_eq!(plan.system.rate_hz, condition.rate_hz);
            assert!((plan.system.controller.period_s - condition.rate_hz.recip()).abs() < 1e-12);
            assert_eq!(plan.scenario.noise.odometry_m, condition.pose_sigma_m);
            let told = plan.system.estimator.settings().unwrap().measurement_noise;
            if condition.varied == Varied::PoseSigma {
                assert!((told[1].sqrt() - condition.pose_sigma_m).abs() < 2e-6);
            }
            assert_eq!(told[0], base.system.estimator.settings().unwrap().measurement_noise[0]);
        }
    }

    #[test]
    fn a_track_that_ends_before_the_goal_is_refused() {
        let choice = Choice { overrides: vec!["track.x_m=[0.0, 12.0]".to_owned()], ..Choice::default() };
        let error = base(&PriceArguments { choice, ..PriceArguments::default() }).unwrap_err().to_string();
        assert_eq!(error, "course of `price`: goal.x_m = 16 is not allowed: 0 to 12, the bounds track.x_m");
    }

    #[test]
    fn what_a_user_sets_holds_under_every_condition() {
        let set = vec!["robot.width_m=0.6".to_owned(), "rate_hz=20".to_owned()];
        let choice = Choice { overrides: set, ..Choice::default() };
        let arguments = PriceArguments { choice, ..PriceArguments::default() };
        let base = base(&arguments).unwrap();
        for condition in all(&base) {
            let plan = read(&arguments, &condition.overrides).unwrap();
            assert_eq!((plan.scenario.robot.width_m, plan.system.vehicle.width_m), (0.6, 0.6));
            assert!(condition.rate_hz == 20.0 || condition.varied == Varied::Rate);
        }
    }
}
