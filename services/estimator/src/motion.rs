//! How the robot moves under the controls that were really sent, (7.27)-(7.31).
//!
//! An actuation is in force from its publication until the next one. So the interval between two odometry samples
//! consists of pieces: first under the older actuation, then under the newer. Each piece is integrated with the
//! model. The desired velocity and steering angle are assumed to be realised: the actuator compensates the robot's
//! imperfections. Blocked wheels slide with a constant deceleration and keep their angle.
//!
//! The speed measured at the wheels corrects the assumed one at the time of the sample, by the weight given. So the
//! estimate follows a robot that is slower than desired, or that stopped by itself.
//!
//! The model divides by the velocity; below [`SLOWEST_MPS`] its lateral part is computed as if the robot drove that
//! fast, and at standstill sideslip and yaw rate are zero. Where it fails: an unknown offset of the steering;
//! the filter corrects its effect.

use shared_types::{Actuation, ActuationKind, Role, plain_state};
use vehicle::correction::{SENT_STEERING_MAX_RAD, SENT_VELOCITY_MAX_MPS};
use vehicle::integrate::MAX_STEP_S;
use vehicle::model::{SLOWEST_MPS, derivative_at};
use vehicle::{Control, Parameters, State};

use crate::correction::Planar;

/// Number of actuations that are remembered: enough for a gap of several scans, and for a block with its recovery within
/// one scan.
pub const HISTORY: usize = 8;

/// Largest plausible speed [m/s]: no more can be sent, and the true speed is lower than the one sent.
const FASTEST_MPS: f64 = SENT_VELOCITY_MAX_MPS;

plain_state! {
    /// A control from the moment it took effect.
    pub struct ControlInForce {
        /// When it took effect [ns]
        pub from_ns: u64,
        /// 1 when the wheels turn, 0 when they are blocked
        pub drives: u64,
        /// Desired velocity [m/s]
        pub velocity_mps: f64,
        /// Desired steering angle [rad]
        pub steering_rad: f64,
    }
}

plain_state! {
    /// Speed, sideslip and yaw rate, and the controls of the recent past.
    pub struct MotionState {
        /// Speed over ground [m/s]
        pub speed_mps: f64,
        /// Sideslip, x1 of (7.27) [rad]
        pub sideslip_rad: f64,
        /// Yaw rate, x3 of (7.29) [rad/s]
        pub yaw_rate_radps: f64,
        /// How many of `controls` are used
        pub count: u64,
        /// Controls in force, the oldest first
        pub controls: [ControlInForce; HISTORY],
    }
}

/// Parameters of the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionModel {
    /// Parameters of the model.
    pub parameters: Parameters,
    /// Deceleration of blocked wheels [m/s^2].
    pub blocked_deceleration_mps2: f64,
    /// Weight of the speed measured at the wheels against the assumed one, 0 to 1.
    pub speed_weight: f64,
}

/// A time interval under one control, in which the speed is linear.
#[derive(Debug, Clone, Copy)]
struct Piece {
    duration_s: f64,
    from_mps: f64,
    to_mps: f64,
    steering_rad: f64,
}

impl MotionState {
    /// Remembers an actuation; one that is not newer, or whose content cannot be used, changes nothing.
    ///
    /// It takes effect when the actuator published it; without that stamp, at the acquisition of its scan. Blocked
    /// wheels keep the angle they have, whatever angle the actuation has.
    pub fn note(&mut self, actuation: &Actuation) {
        let (velocity, steering) = (actuation.desired_velocity_mps, actuation.desired_steering_rad);
        let plausible = velocity.abs() <= SENT_VELOCITY_MAX_MPS && steering.abs() <= SENT_STEERING_MAX_RAD;
        let Ok(kind) = ActuationKind::try_from(actuation.kind) else { return };
        if !plausible {
            return;
        }
        let published = actuation.header.stage(Role::Actuator).published_ns;
        let drives = kind == ActuationKind::Drive;
        let kept = self.controls().last().filter(|_| !drives).map(|newest| newest.steering_rad);
        let control = ControlInForce {
            from_ns: if published == 0 { actuation.header.acquired_ns } else { published },
            drives: u64::from(drives),
            velocity_mps: velocity,
            steering_rad: kept.unwrap_or(steering),
        };
        if let Some(newest) = self.controls().last() {
            let same = ControlInForce { from_ns: newest.from_ns, ..control } == *newest;
            if control.from_ns <= newest.from_ns || same {
                return;
            }
        }
        if self.count as usize >= HISTORY {
            self.controls.rotate_left(1);
            self.count = HISTORY as u64 - 1;
        }
        self.controls[self.count as usize] = control;
        self.count += 1;
    }

    /// The remembered controls, the oldest first.
    pub fn controls(&self) -> &[ControlInForce] {
        &self.controls[..(self.count as usize).min(HISTORY)]
    }

    /// Begins at a measured speed, with sideslip and yaw rate settled under the control in force.
    pub fn begin(&mut self, model: &MotionModel, at_ns: u64, measured_mps: f64) {
        self.speed_mps = plausible_speed(measured_mps).unwrap_or(0.0);
        (self.sideslip_rad, self.yaw_rate_radps) = (0.0, 0.0);
        let steering = self.in_force(at_ns).map_or(0.0, |control| control.steering_rad);
        if self.speed_mps >= SLOWEST_MPS {
            let control = Control { velocity: self.speed_mps, steering };
            (self.sideslip_rad, self.yaw_rate_radps) =
                vehicle::model::steady_turn(&model.parameters, &control);
        }
    }

    /// Moves a pose from `from_ns` to `to_ns`; `measured_mps` is the speed measured at the end, where there is one.
    ///
    /// Returns the pose at the end; speed, sideslip and yaw rate are left in `self`.
    pub fn advance(
        &mut self,
        model: &MotionModel,
        pose: Planar,
        from_ns: u64,
        to_ns: u64,
        measured_mps: Option<f64>,
    ) -> Planar {
        let mut state = State {
            sideslip: self.sideslip_rad,
            yaw: pose.yaw,
            yaw_rate: self.yaw_rate_radps,
            x: pose.x,
            y: pose.y,
        };
        let measured = measured_mps.and_then(plausible_speed);
        let mut speed = self.speed_mps;
        let mut start_ns = from_ns;
        while start_ns < to_ns {
            let control = self.in_force(start_ns).copied();
            let next_ns = self.controls().iter().map(|control| control.from_ns).find(|&from| from > start_ns);
            let end_ns = next_ns.unwrap_or(to_ns).min(to_ns);
            let is_last = end_ns == to_ns;
            // A control from before this interval: the robot has its speed already.
            let continues = control.is_none_or(|control| control.from_ns < from_ns);
            let seconds = (end_ns - start_ns) as f64 * 1e-9;
            let blend = |assumed: f64| match measured {
                Some(measured) if is_last => assumed + model.speed_weight * (measured - assumed),
                _ => assumed,
            };
            match control {
                Some(ControlInForce { drives: 0, steering_rad, .. }) => {
                    let slide = seconds.min(speed / model.blocked_deceleration_mps2);
                    let end = (speed - model.blocked_deceleration_mps2 * slide).max(0.0);
                    let piece = Piece { duration_s: slide, from_mps: speed, to_mps: end, steering_rad };
                    state = integrate(&model.parameters, state, &piece);
                    // Where the slide ends within the piece, rounding may leave a speed of 1e-17.
                    speed = blend(if slide < seconds { 0.0 } else { end });
                }
                _ => {
                    let steering_rad = control.map_or(0.0, |control| control.steering_rad);
                    let desired = control.map_or(speed, |control| control.velocity_mps.max(0.0));
                    let end = blend(if continues { speed } else { desired });
                    let from_mps = if continues { speed } else { end };
                    let piece = Piece { duration_s: seconds, from_mps, to_mps: end, steering_rad };
                    state = integrate(&model.parameters, state, &piece);
                    speed = end;
                }
            }
            if speed <= 0.0 {
                (state.sideslip, state.yaw_rate) = (0.0, 0.0);
            }
            start_ns = end_ns;
        }
        self.speed_mps = speed.max(0.0);
        (self.sideslip_rad, self.yaw_rate_radps) = (state.sideslip, state.yaw_rate);
        Planar { yaw: state.yaw, x: state.x, y: state.y }
    }

    /// The control in force at a time, if one that old is remembered.
    pub(crate) fn in_force(&self, at_ns: u64) -> Option<&ControlInForce> {
        self.controls().iter().rev().find(|control| control.from_ns <= at_ns)
    }
}

/// The measured speed if it is plausible: the robot does not reverse, and at standstill reads zero with a little noise.
pub(crate) fn plausible_speed(measured_mps: f64) -> Option<f64> {
    (measured_mps.is_finite() && measured_mps > -0.1 && measured_mps <= FASTEST_MPS)
        .then(|| measured_mps.max(0.0))
}

/// The state after a piece, by RK4 in steps of at most [`MAX_STEP_S`], each with the speed of its middle.
fn integrate(parameters: &Parameters, state: State, piece: &Piece) -> State {
    if piece.duration_s <= 0.0 || (piece.from_mps <= 0.0 && piece.to_mps <= 0.0) {
        return state;
    }
    let steps = (piece.duration_s / MAX_STEP_S).ceil();
    let step_s = piece.duration_s / steps;
    (0..steps as usize).fold(state, |state, step| {
        let share = (step as f64 + 0.5) / steps;
        let speed = piece.from_mps + share * (piece.to_mps - piece.from_mps);
        runge_kutta(parameters, &state, speed, piece.steering_rad, step_s)
    })
}

fn runge_kutta(parameters: &Parameters, state: &State, speed: f64, steering: f64, step_s: f64) -> State {
    let slope = |vector| derivative_at(parameters, &State::from_vector(&vector), speed, steering);
    let start = state.to_vector();
    let first = slope(start);
    let second = slope(start + first * (step_s / 2.0));
    let third = slope(start + second * (step_s / 2.0));
    let fourth = slope(start + third * step_s);
    State::from_vector(&(start + (first + (second + third) * 2.0 + fourth) * (step_s / 6.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::Header;
    use vehicle::integrate;

    const MS: u64 = 1_000_000;

    fn model(speed_weight: f64) -> MotionModel {
        MotionModel { parameters: Parameters::default(), blocked_deceleration_mps2: 5.0, speed_weight }
    }

    fn actuation(from_ns: u64, kind: ActuationKind, velocity: f64, steering: f64) -> Actuation {
        let mut header = Header::default();
        header.stage_mut(Role::Actuator).published_ns = from_ns;
        Actuation {
            header,
            kind: kind.wire(),
            desired_velocity_mps: velocity,
            desired_steering_rad: steering,
            ..Actuation::default()
        }
    }

    fn drive(from_ns: u64, velocity: f64, steering: f64) -> Actuation {
        actuation(from_ns, ActuationKind::Drive, velocity, steering)
    }

    #[test]
    fn an_interval_is_split_where_the_newer_actuation_took_effect() {
        let mut motion = MotionState::default();
        motion.note(&drive(10 * MS, 0.5, 0.0));
        motion.note(&drive(133 * MS, 0.8, 0.0));
        motion.begin(&model(0.0), 100 * MS, 0.5);
        let end = motion.advance(&model(0.0), Planar::default(), 100 * MS, 200 * MS, None);
        // 33 ms at 0.5 m/s and 67 ms at 0.8 m/s.
        assert!((end.x - (0.033 * 0.5 + 0.067 * 0.8)).abs() < 1e-12, "{end:?}");
        assert_eq!(motion.speed_mps, 0.8);
    }

    #[test]
    fn a_turn_is_that_of_the_model() {
        let mut motion = MotionState::default();
        motion.note(&drive(0, 0.6, 0.05));
        motion.speed_mps = 0.6;
        let mut pose = Planar { yaw: 0.3, x: 1.0, y: -0.5 };
        for step in 0..20 {
            pose = motion.advance(&model(1.0), pose, step * 100 * MS, (step + 1) * 100 * MS, Some(0.6));
        }
        let start = State { yaw: 0.3, x: 1.0, y: -0.5, ..State::default() };
        let control = Control { velocity: 0.6, steering: 0.05 };
        let exact = integrate::integrate(&Parameters::default(), &start, &control, 2.0);
        // The same method with the same steps.
        assert!((pose.yaw - exact.yaw).abs() < 1e-9 && (pose.x - exact.x).abs() < 1e-9);
        assert!((pose.y - exact.y).abs() < 1e-9 && (motion.sideslip_rad - exact.sideslip).abs() < 1e-9);
    }

    #[test]
    fn blocked_wheels_slide_to_a_stop_and_keep_their_angle() {
        let mut motion = MotionState::default();
        motion.note(&drive(0, 1.0, 0.06));
        motion.begin(&model(0.0), 0, 1.0);
        motion.note(&actuation(50 * MS, ActuationKind::Block, 0.0, 0.0));
        let end = motion.advance(&model(0.0), Planar::default(), 0, 1_000 * MS, None);
        // 50 ms at 1 m/s and 1 / (2 * 5) m of sliding, on a circle of 3.1 m radius; the yaw rate of 0.32 rad/s lags
        // behind the falling speed by about 15 ms.
        let yaw = 0.15 / 3.1 + 0.32 * 0.015;
        assert!((end.yaw - yaw).abs() < 1.5e-3 && (end.x - 0.15).abs() < 2e-4, "{end:?}");
        assert_eq!((motion.speed_mps, motion.sideslip_rad, motion.yaw_rate_radps), (0.0, 0.0, 0.0));
    }

    #[test]
    fn the_measured_speed_replaces_the_assumed_one_by_its_weight() {
        for (weight, expected) in [(0.0, 1.0), (0.5, 0.85), (1.0, 0.7)] {
            let mut motion = MotionState::default();
            motion.note(&drive(0, 1.0, 0.0));
            motion.begin(&model(weight), 0, 0.0);
            // The control begins within the first interval, so the speed is constant after it took effect.
            motion.note(&drive(1, 1.0, 0.01));
            motion.advance(&model(weight), Planar::default(), 0, 100 * MS, Some(0.7));
            assert!((motion.speed_mps - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn a_robot_that_stopped_by_itself_is_followed() {
        let mut motion = MotionState::default();
        motion.note(&drive(0, 1.0, 0.0));
        motion.begin(&model(1.0), 100 * MS, 1.0);
        let end = motion.advance(&model(1.0), Planar::default(), 100 * MS, 200 * MS, Some(0.0));
        assert!(
            (end.x - 0.05).abs() < 1e-12 && motion.speed_mps == 0.0,
            "the mean of 1 and 0 m/s over 100 ms"
        );
        let later = motion.advance(&model(1.0), end, 200 * MS, 300 * MS, Some(0.0));
        assert_eq!(later, end);
    }

    #[test]
    fn a_speed_that_cannot_be_is_not_believed() {
        for wild in [f64::NAN, f64::INFINITY, 1e9, -3.0] {
            let mut motion = MotionState::default();
            motion.note(&drive(0, 0.5, 0.0));
            motion.begin(&model(1.0), 0, 0.5);
            motion.advance(&model(1.0), Planar::default(), 0, 100 * MS, Some(wild));
            assert_eq!(motion.speed_mps, 0.5);
        }
    }

    #[test]
    fn actuations_that_are_old_repeated_or_broken_change_nothing() {
        let mut motion = MotionState::default();
        motion.note(&drive(50, 0.5, 0.01));
        let once = motion;
        motion.note(&drive(50, 0.9, 0.0));
        motion.note(&drive(40, 0.9, 0.0));
        motion.note(&drive(60, 0.5, 0.01));
        motion.note(&drive(70, f64::NAN, 0.0));
        motion.note(&drive(70, 0.5, 1.0));
        motion.note(&Actuation { kind: 7, ..drive(70, 0.5, 0.0) });
        assert_eq!(motion, once);
    }

    #[test]
    fn the_oldest_of_many_actuations_is_forgotten() {
        let mut motion = MotionState::default();
        for index in 1..=20_u32 {
            motion.note(&drive(u64::from(index) * MS, 0.02 * f64::from(index), 0.0));
        }
        assert_eq!(motion.controls().len(), HISTORY);
        assert_eq!(
            (motion.controls()[0].from_ns, motion.controls()[HISTORY - 1].from_ns),
            (13 * MS, 20 * MS)
        );
    }

    #[test]
    fn crawling_stays_finite_and_turns_slowly() {
        let mut motion = MotionState::default();
        motion.note(&drive(0, 0.001, 0.06));
        let end = motion.advance(&model(0.0), Planar::default(), 0, 2_000 * MS, None);
        assert!(end.yaw.abs() < 0.05 && (end.x - 0.002).abs() < 1e-3, "{end:?}");
    }
}
