//! What a changed setting is meant to change in the outputs of its role.
//!
//! A swap to the same program with another setting compares both processes as any swap does. What the setting is there to
//! change is no disagreement: a controller with another cruising velocity wants another velocity. So each key widens the
//! bounds of the quantities that follow from it, and of no other. Whether the process wants to drive at all is compared with
//! every key.

use vehicle::bounds::STEERING_MAX_RAD;

/// How much further than [`agreement`](super::agreement) allows two processes may differ.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Meant {
    /// Velocity, desired or sent [m/s].
    pub velocity_mps: f64,
    /// Steering angle, desired or sent [rad].
    pub steering_rad: f64,
    /// Estimated or reported position [m].
    pub position_m: f64,
    /// Estimated or reported yaw [rad].
    pub yaw_rad: f64,
    /// True position [m].
    pub true_position_m: f64,
    /// True yaw [rad].
    pub true_yaw_rad: f64,
    /// Place of a body [m].
    pub body_m: f64,
    /// Share of the beams with another range.
    pub beam_share: f64,
}

/// A key that changes, and by how much: the difference of its numbers, 0 if it has none.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyChange {
    /// The key with its tables, as `scanloop set` takes it.
    pub key: String,
    /// Its new number minus the old one, without a sign; the largest of several.
    pub by: f64,
}

/// From the largest velocity to the smallest: a plan may pass an obstacle before which the other one slows down [m/s].
const PLAN_VELOCITY_MPS: f64 = 0.9;
/// From the largest angle to one side to that to the other: two plans may pass a body on different sides [rad].
const PLAN_STEERING_RAD: f64 = 2.0 * STEERING_MAX_RAD;
/// The largest desired angle: another calibration sends so much more or less for the same command [rad].
const SENT_STEERING_RAD: f64 = STEERING_MAX_RAD;
/// A filter with other gains, over the scans of a swap; a fifth of the obstacle distance that is kept in reserve [m].
const ESTIMATE_M: f64 = 0.2;
/// At the end of the horizon of 2.5 m this is [`ESTIMATE_M`] again [rad].
const ESTIMATE_RAD: f64 = 0.08;
/// Two robots that drive for two seconds of a swap, one of them a third faster [m].
const ROBOT_M: f64 = 1.0;
/// The same while one of them turns a third sharper [rad].
const ROBOT_RAD: f64 = 0.2;
/// Bodies of a detector that joins or parts what stands together: the diagonal of a large one [m].
const BODIES_M: f64 = 1.0;
/// Noise is within this many standard deviations.
const SIGMAS: f64 = 6.0;

/// What follows from a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Effect {
    /// Another speed, by as much as the key changes at least, and a path that fits it.
    Speed,
    /// Another path, at another speed.
    Path,
    /// Other values sent for the same command.
    Sent,
    /// Another estimate.
    Estimate,
    /// Other bodies.
    Bodies,
    /// Another motion of the true robot, and what it measures there.
    Motion,
    /// Another reported position, by noise of that size.
    Position,
    /// Another reported yaw, by noise of that size.
    Yaw,
    /// Other ranges.
    Ranges,
}

/// The effect of the keys that begin so; the first that fits counts. All other keys change no output that is compared: how a
/// problem is solved, covariances, timeouts.
const EFFECTS: &[(&str, Effect)] = &[
    ("controller.cruise_mps", Effect::Speed),
    ("controller.careful_mps", Effect::Speed),
    ("controller.stop.approach_mps", Effect::Speed),
    ("controller.vehicle.careful_mps", Effect::Speed),
    ("controller.vehicle.bounds.velocity", Effect::Speed),
    ("controller.landing_time_s", Effect::Path),
    ("controller.side", Effect::Path),
    ("controller.theta_m", Effect::Path),
    ("controller.ellipse_margin_m", Effect::Path),
    ("controller.smoothing_s", Effect::Path),
    ("controller.clearance_m", Effect::Path),
    ("controller.margin.", Effect::Path),
    ("controller.horizon_s", Effect::Path),
    ("controller.intervals", Effect::Path),
    ("controller.max_ellipses", Effect::Path),
    ("controller.weights.", Effect::Path),
    ("controller.guide.", Effect::Path),
    ("controller.stop.", Effect::Path),
    ("controller.vehicle.", Effect::Path),
    ("actuator.calibration", Effect::Sent),
    ("actuator.vehicle.bounds", Effect::Sent),
    ("estimator.measure", Effect::Estimate),
    ("estimator.process_noise", Effect::Estimate),
    ("estimator.correction", Effect::Estimate),
    ("estimator.odometry_", Effect::Estimate),
    ("estimator.drift_reset_s", Effect::Estimate),
    ("estimator.gate", Effect::Estimate),
    ("estimator.speed_weight", Effect::Estimate),
    ("estimator.vehicle.", Effect::Estimate),
    ("obstacles.", Effect::Bodies),
    ("robot.", Effect::Motion),
    ("noise.odometry_m", Effect::Position),
    ("noise.odometry_rad", Effect::Yaw),
    ("noise.", Effect::Ranges),
    ("scanner.", Effect::Ranges),
];

impl Meant {
    /// What the changes of one role are meant to change.
    pub fn of(changes: &[KeyChange]) -> Self {
        let mut meant = Self::default();
        for KeyChange { key, by } in changes {
            let effect = EFFECTS.iter().find(|(begin, _)| key.starts_with(begin));
            let Some((_, effect)) = effect else { continue };
            meant = meant.max(Self::of_effect(*effect, *by));
        }
        meant
    }

    fn of_effect(effect: Effect, by: f64) -> Self {
        let none = Self::default();
        match effect {
            Effect::Speed => {
                Self { velocity_mps: by.max(PLAN_VELOCITY_MPS), steering_rad: PLAN_STEERING_RAD, ..none }
            }
            Effect::Path => Self { velocity_mps: PLAN_VELOCITY_MPS, steering_rad: PLAN_STEERING_RAD, ..none },
            Effect::Sent => Self { velocity_mps: PLAN_VELOCITY_MPS, steering_rad: SENT_STEERING_RAD, ..none },
            Effect::Estimate => Self { position_m: ESTIMATE_M, yaw_rad: ESTIMATE_RAD, ..none },
            Effect::Bodies => Self { body_m: BODIES_M, ..none },
            Effect::Motion => Self {
                position_m: ROBOT_M,
                yaw_rad: ROBOT_RAD,
                true_position_m: ROBOT_M,
                true_yaw_rad: ROBOT_RAD,
                beam_share: 1.0,
                ..none
            },
            Effect::Position => Self { position_m: SIGMAS * by, ..none },
            Effect::Yaw => Self { yaw_rad: SIGMAS * by, ..none },
            Effect::Ranges => Self { beam_share: 1.0, ..none },
        }
    }

    /// The larger one of each.
    fn max(self, other: Self) -> Self {
        Self {
            velocity_mps: self.velocity_mps.max(other.velocity_mps),
            steering_rad: self.steering_rad.max(other.steering_rad),
            position_m: self.position_m.max(other.position_m),
            yaw_rad: self.yaw_rad.max(other.yaw_rad),
            true_position_m: self.true_position_m.max(other.true_position_m),
            true_yaw_rad: self.true_yaw_rad.max(other.true_yaw_rad),
            body_m: self.body_m.max(other.body_m),
            beam_share: self.beam_share.max(other.beam_share),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(key: &str, by: f64) -> Meant {
        Meant::of(&[KeyChange { key: key.to_owned(), by }])
    }

    #[test]
    fn a_speed_widens_the_bound_of_the_velocity_as_a_path_does_and_by_its_change() {
        assert_eq!(of("controller.cruise_mps", 0.2).velocity_mps, 0.9);
        assert_eq!(of("controller.cruise_mps", 1.2).velocity_mps, 1.2);
        assert_eq!(of("controller.cruise_mps", 0.2).position_m, 0.0);
    }

    #[test]
    fn how_a_problem_is_solved_changes_no_output() {
        for key in
            ["controller.solver.max_iterations", "controller.budget_ms", "actuator.recovery", "player.port"]
        {
            assert_eq!(of(key, 5.0), Meant::default(), "{key}");
        }
    }

    #[test]
    fn each_effect_widens_what_follows_from_it() {
        let none = Meant::default();
        let path = Meant { velocity_mps: 0.9, steering_rad: 0.12, ..none };
        let motion = Meant {
            position_m: 1.0,
            yaw_rad: 0.2,
            true_position_m: 1.0,
            true_yaw_rad: 0.2,
            beam_share: 1.0,
            ..none
        };
        for (key, expected) in [
            ("controller.cruise_mps", path),
            ("controller.weights.goal", path),
            ("actuator.calibration", Meant { steering_rad: 0.06, ..path }),
            ("estimator.gate", Meant { position_m: 0.2, yaw_rad: 0.08, ..none }),
            ("obstacles.moving_mps", Meant { body_m: 1.0, ..none }),
            ("robot.deceleration_mps2", motion),
            ("noise.odometry_m", Meant { position_m: 3.0, ..none }),
            ("noise.odometry_rad", Meant { yaw_rad: 3.0, ..none }),
            ("noise.range_m", Meant { beam_share: 1.0, ..none }),
        ] {
            assert_eq!(of(key, 0.5), expected, "{key}");
        }
    }

    #[test]
    fn several_keys_have_the_larger_allowance_of_each() {
        let changes = [("noise.odometry_m", 0.01), ("noise.range_m", 0.5)]
            .map(|(key, by)| KeyChange { key: key.to_owned(), by });
        assert_eq!(Meant::of(&changes), Meant { position_m: 0.06, beam_share: 1.0, ..Meant::default() });
    }
}
