//! The remaining odometry error of each form of the correction: a study without noise and without filter.
//!
//! A robot steers a sine of 0.06 rad and 5 s period at 1 m/s, as in the source's figure, and reports its odometry every
//! 100 ms. There are three robots with different odometry errors. Each form of the correction is applied to each, with
//! the source's df = 0.01 and dds = 0.053 1/s. The error is the distance of corrected and true position.
//!
//! The robots follow the model at once and have no other imperfection.

use vehicle::frame::to_track;
use vehicle::integrate::rk4;
use vehicle::{Control, Parameters, State};

use estimator::correction::{CorrectionMode, CorrectionState, Drift, Planar};

/// The coefficients that the source prints.
pub(crate) const LONGITUDINAL: f64 = 0.01;
/// Growth of the lateral drift [1/s].
pub(crate) const LATERAL_RATE: f64 = 0.053;
/// The steering offset with the same effect at 1 m/s [rad].
pub(crate) const OFFSET_RAD: f64 = 0.0098;

/// Time between two reports [s].
const PERIOD_S: f64 = 0.1;
/// Steps of integration per report.
const STEPS: usize = 100;

/// The cause of the odometry error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ErrorCause {
    /// The wheels are off by a constant angle that the odometry does not measure: play taken up on one side.
    Offset,
    /// The wheels follow the shaft through play of the same size: the error changes sides.
    Play,
    /// The odometry errs exactly as (7.38)-(7.40) say.
    Modelled,
}

/// How measured data are corrected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Form {
    /// The form.
    pub mode: CorrectionMode,
    /// Time after which the lateral drift restarts at zero, 0 for never [s].
    pub reset_s: f64,
}

/// Distance of corrected and true position at each report, `(t, error)` in s and m, from zero to `seconds`.
pub(crate) fn errors(robot: ErrorCause, form: Form, seconds: f64) -> Vec<[f64; 2]> {
    let parameters = Parameters::default();
    let drift = Drift {
        mode: form.mode,
        longitudinal: LONGITUDINAL,
        lateral_rate: LATERAL_RATE,
        reset_s: form.reset_s,
    };
    let (mut truth, mut believed) = (State::default(), State::default());
    let (mut wheels, mut lateral) = (0.0f64, 0.0);
    let mut reported = nalgebra::Vector2::zeros();
    let mut correction = CorrectionState::begin(Planar::default(), 1.0);
    let mut found = vec![[0.0, 0.0]];
    let step_s = PERIOD_S / STEPS as f64;
    for report in 1..=(seconds / PERIOD_S).round() as usize {
        for step in 0..STEPS {
            let time_s = ((report - 1) * STEPS + step) as f64 * step_s;
            let steering = 0.06 * (std::f64::consts::TAU * time_s / 5.0).sin();
            wheels = match robot {
                ErrorCause::Offset => steering + OFFSET_RAD,
                ErrorCause::Play => wheels.clamp(steering - OFFSET_RAD, steering + OFFSET_RAD),
                ErrorCause::Modelled => steering,
            };
            let drive = |state: &State, angle: f64| {
                rk4(&parameters, state, &Control { velocity: 1.0, steering: angle }, step_s)
            };
            let (next, next_believed) = (drive(&truth, wheels), drive(&believed, steering));
            let moved = nalgebra::Vector2::new(next_believed.x - believed.x, next_believed.y - believed.y);
            let missed = to_track(believed.yaw, LONGITUDINAL, lateral) * step_s;
            reported += moved - missed;
            if robot == ErrorCause::Modelled {
                lateral += LATERAL_RATE * step_s;
            }
            (truth, believed) = (next, next_believed);
        }
        let pose = Planar { yaw: believed.yaw, x: reported.x, y: reported.y };
        let corrected = correction.correct(&drift, pose, 1.0, PERIOD_S, None);
        found.push([report as f64 * PERIOD_S, (corrected.x - truth.x).hypot(corrected.y - truth.y)]);
    }
    found
}

/// Largest error up to a time [m].
pub(crate) fn largest(errors: &[[f64; 2]], until_s: f64) -> f64 {
    errors.iter().filter(|point| point[0] <= until_s + 1e-9).map(|point| point[1]).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn form(mode: CorrectionMode) -> Form {
        Form { mode, reset_s: 0.0 }
    }

    #[test]
    fn the_printed_form_brings_an_offset_from_64_cm_below_8_cm_for_5_s_and_the_turning_one_for_20_s() {
        let at = |mode, seconds| largest(&errors(ErrorCause::Offset, form(mode), 20.0), seconds);
        assert!((at(CorrectionMode::Off, 5.0) - 0.64).abs() < 0.03, "{}", at(CorrectionMode::Off, 5.0));
        assert!(at(CorrectionMode::Time, 5.0) < 0.08, "{}", at(CorrectionMode::Time, 5.0));
        assert!(
            at(CorrectionMode::Time, 20.0) > 1.0 && at(CorrectionMode::Yaw, 20.0) < 0.15,
            "{}",
            at(CorrectionMode::Yaw, 20.0)
        );
    }

    #[test]
    fn an_error_as_modelled_is_undone_and_one_without_a_mean_is_made_worse() {
        let at = |robot, mode| largest(&errors(robot, form(mode), 20.0), 20.0);
        // The correction takes means over 100 ms, the robot steps of 1 ms.
        assert!(
            at(ErrorCause::Modelled, CorrectionMode::Time) < 0.01
                && at(ErrorCause::Modelled, CorrectionMode::Moving) < 0.01
        );
        assert!(at(ErrorCause::Play, CorrectionMode::Time) > 2.0 * at(ErrorCause::Play, CorrectionMode::Off));
    }
}
