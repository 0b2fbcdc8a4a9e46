//! How the robot moves under the controls that were really sent, (7.27)-(7.31).
//!
//! An actuation is in force from its publication plus the delay of the command until the next one. So the interval
//! between two odometry samples consists of pieces: first under the older actuation, then under the newer. Each piece is
//! integrated with the model. Speed and steering angle follow the desired ones with the lags of the vehicle description
//! ([`Lag`]), or at once where it has none; the actuator compensates the other imperfections. Blocked wheels slide
//! with a constant deceleration and keep their angle.
//!
//! The speed measured at the wheels corrects the assumed one at the time of the sample, by the weight given. So the
//! estimate follows a robot that is slower than desired, or that stopped by itself. The steering angle is not measured:
//! it is what the lag makes of the angles sent.
//!
//! Speeds backwards are negative. A robot whose wheels were not told to drive backwards does not: a negative speed is noise
//! at standstill or a fault then, and the estimate does not go below zero.
//!
//! The model divides by the velocity; below [`SLOWEST_MPS`] its lateral part is computed as if the robot drove that
//! fast, and at standstill sideslip and yaw rate are zero. Where it fails: an unknown offset of the steering;
//! the filter corrects its effect.

use shared_types::{Actuation, ActuationKind, Role, plain_state};
use vehicle::integrate::{MAX_STEP_S, is_stiff, stiff_step};
use vehicle::model::{SLOWEST_MPS, derivative_at, lateral_velocity};
use vehicle::{Bounds, Control, Parameters, State, slid};

use crate::correction::Planar;
use crate::learned::Learned;

mod follow;

pub(crate) use follow::curvature_per_angle;
pub use vehicle::Lag;

/// Number of actuations that are remembered: enough for a gap of several scans, and for a block with its recovery within
/// one scan. Where more are on their way to the wheels, neighbours are remembered as one.
pub const HISTORY: usize = 8;

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
        /// Speed over ground, negative backwards [m/s]
        pub speed_mps: f64,
        /// Speed that the controls alone explain, without the measured one [m/s]
        pub expected_mps: f64,
        /// Steering angle of the wheels [rad]
        pub steering_rad: f64,
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
    /// Bounds of the vehicle: the true speed is at most what may be sent.
    pub bounds: Bounds,
    /// Deceleration of blocked wheels [m/s^2].
    pub blocked_deceleration_mps2: f64,
    /// Weight of the speed measured at the wheels against the assumed one, 0 to 1.
    pub speed_weight: f64,
    /// Time from the actuator to the wheels [ns].
    pub delay_ns: u64,
    /// How the speed follows the desired one [m/s].
    pub velocity_lag: Lag,
    /// How the steering angle follows the desired one [rad].
    pub steering_lag: Lag,
    /// How it really steers.
    pub learned: Learned,
}

/// Where the robot got to, and how far the true response may differ from the described one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moved {
    /// The pose at the end.
    pub pose: Planar,
    /// Standard deviation of the distance, because the speed is only measured at the end [m].
    pub ahead_m: f64,
    /// Standard deviation of the yaw, because the steering angle is not measured while it changes [rad].
    pub yaw_rad: f64,
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
    /// It takes effect the delay of the model after the actuator published it; without that stamp, after the acquisition of its scan.
    /// Blocked wheels keep the angle they have, whatever angle the actuation has.
    pub fn note(&mut self, model: &MotionModel, actuation: &Actuation) {
        let (velocity, steering) = (actuation.desired_velocity_mps, actuation.desired_steering_rad);
        let plausible = model.bounds.allow_sent(velocity, steering, 0.0);
        let Ok(kind) = ActuationKind::try_from(actuation.kind) else { return };
        if !plausible {
            return;
        }
        let published = actuation.header.stage(Role::Actuator).published_ns;
        let drives = kind == ActuationKind::Drive;
        let kept = self.controls().last().filter(|_| !drives).map(|newest| newest.steering_rad);
        let sent_ns = if published == 0 { actuation.header.acquired_ns } else { published };
        let control = ControlInForce {
            from_ns: sent_ns.saturating_add(model.delay_ns),
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
            // The oldest may be in force yet where the way to the wheels is long.
            let is_in_force = self.controls[1].from_ns > actuation.header.acquired_ns;
            match self.shortest_pair().filter(|_| is_in_force) {
                Some(index) => self.join(index),
                None => self.controls.rotate_left(1),
            }
            self.count = HISTORY as u64 - 1;
        }
        self.controls[self.count as usize] = control;
        self.count += 1;
    }

    /// The first of two controls that last the shortest together, of those that both turn the wheels in one direction or both
    /// block them.
    fn shortest_pair(&self) -> Option<usize> {
        let from_ns = |index: usize| self.controls[index].from_ns;
        let lasts_ns = |index: usize| from_ns(index + 2).saturating_sub(from_ns(index));
        let alike = |index: &usize| {
            let [one, other] = [self.controls[*index], self.controls[index + 1]];
            one.drives == other.drives && one.velocity_mps * other.velocity_mps >= 0.0
        };
        (0..HISTORY - 2).filter(alike).min_by_key(|index| lasts_ns(*index))
    }

    /// Makes one of two controls that follow each other: their mean by the time that each lasts.
    fn join(&mut self, index: usize) {
        let [one, other, next] = [0, 1, 2].map(|offset| self.controls[index + offset]);
        let last_s = |since_ns: u64| next.from_ns.saturating_sub(since_ns) as f64 * 1e-9;
        // Of a forged state they may be in no order.
        let share = (last_s(other.from_ns) / last_s(one.from_ns).max(1e-9)).min(1.0);
        let mean = |one: f64, other: f64| one + share * (other - one);
        self.controls[index] = ControlInForce {
            velocity_mps: mean(one.velocity_mps, other.velocity_mps),
            steering_rad: mean(one.steering_rad, other.steering_rad),
            ..one
        };
        self.controls[index + 1..].rotate_left(1);
    }

    /// The remembered controls, the oldest first.
    pub fn controls(&self) -> &[ControlInForce] {
        &self.controls[..(self.count as usize).min(HISTORY)]
    }

    /// Whether all controls since a time are remembered: a process that was suspended may have received more.
    pub(crate) fn remembers(&self, since_ns: u64) -> bool {
        self.controls().len() < HISTORY || self.in_force(since_ns).is_some()
    }

    /// Begins at a measured speed, with sideslip and yaw rate settled under the control in force.
    pub fn begin(&mut self, model: &MotionModel, at_ns: u64, measured_mps: f64) {
        self.speed_mps = self.plausible_speed(model, at_ns, measured_mps).unwrap_or(0.0);
        (self.sideslip_rad, self.yaw_rate_radps) = (0.0, 0.0);
        let steering = self.in_force(at_ns).map_or(0.0, |control| control.steering_rad);
        (self.expected_mps, self.steering_rad) = (self.speed_mps, steering);
        if self.speed_mps.abs() >= SLOWEST_MPS {
            let control = Control { velocity: self.speed_mps, steering };
            (self.sideslip_rad, self.yaw_rate_radps) =
                vehicle::model::steady_turn(&model.parameters, &control);
        }
    }

    /// Sideslip by which the tyres slip, beyond that of wheels which roll [rad].
    pub(crate) fn slip_rad(&self, parameters: &Parameters) -> f64 {
        if self.speed_mps.abs() < SLOWEST_MPS {
            return 0.0;
        }
        self.sideslip_rad - parameters.straight_axle_m() * self.yaw_rate_radps / self.speed_mps
    }

    /// Moves a pose from `from_ns` to `to_ns`; `measured_mps` is the speed measured at the end, where there is one.
    ///
    /// Returns the pose at the end; speed, steering angle, sideslip and yaw rate are left in `self`.
    pub fn advance(
        &mut self,
        model: &MotionModel,
        pose: Planar,
        from_ns: u64,
        to_ns: u64,
        measured_mps: Option<f64>,
    ) -> Moved {
        let start = State {
            sideslip: self.sideslip_rad,
            yaw: pose.yaw,
            yaw_rate: self.yaw_rate_radps,
            x: pose.x,
            y: pose.y,
        };
        let measured =
            measured_mps.and_then(|measured_mps| self.plausible_speed(model, from_ns, measured_mps));
        let floor_mps = self.floor_mps(model, from_ns);
        (self.expected_mps, _) = self.speed_after(model, self.expected_mps, from_ns, to_ns);
        let (state, ahead_m, yaw_rad) = if model.lags() {
            self.follow(model, start, [from_ns, to_ns], measured, floor_mps)
        } else {
            (self.follow_at_once(model, start, [from_ns, to_ns], measured, floor_mps), 0.0, 0.0)
        };
        (self.sideslip_rad, self.yaw_rate_radps) = (state.sideslip, state.yaw_rate);
        Moved { pose: Planar { yaw: state.yaw, x: state.x, y: state.y }, ahead_m, yaw_rad }
    }

    /// The state of a robot without lag at the end of an interval; leaves speed and steering angle in `self`.
    fn follow_at_once(
        &mut self,
        model: &MotionModel,
        mut state: State,
        [from_ns, to_ns]: [u64; 2],
        measured: Option<f64>,
        floor_mps: f64,
    ) -> State {
        let mut speed = self.speed_mps;
        let mut start_ns = from_ns;
        while start_ns < to_ns {
            let (control, end_ns) = self.piece(start_ns, to_ns);
            let is_last = end_ns == to_ns;
            // A control from before this interval: the robot has its speed already.
            let continues = control.is_none_or(|control| control.from_ns < from_ns);
            let seconds = (end_ns - start_ns) as f64 * 1e-9;
            let blend = |assumed: f64| match measured {
                Some(measured) if is_last => assumed + model.speed_weight * (measured - assumed),
                _ => assumed,
            };
            let steering_rad = control.map_or(0.0, |control| control.steering_rad);
            match control {
                Some(ControlInForce { drives: 0, .. }) => {
                    let slide = seconds.min(speed.abs() / model.blocked_deceleration_mps2);
                    let end = slid(speed, model.blocked_deceleration_mps2, slide);
                    let piece = Piece { duration_s: slide, from_mps: speed, to_mps: end, steering_rad };
                    state = integrate(model, state, &piece);
                    // Where the slide ends within the piece, rounding may leave a speed of 1e-17.
                    speed = blend(if slide < seconds { 0.0 } else { end });
                }
                _ => {
                    let desired = control.map_or(speed, |control| control.velocity_mps);
                    let end = blend(if continues { speed } else { desired });
                    let from_mps = if continues { speed } else { end };
                    let piece = Piece { duration_s: seconds, from_mps, to_mps: end, steering_rad };
                    state = integrate(model, state, &piece);
                    speed = end;
                }
            }
            if speed == 0.0 {
                (state.sideslip, state.yaw_rate) = (0.0, 0.0);
            }
            self.steering_rad = steering_rad;
            start_ns = end_ns;
        }
        self.speed_mps = speed.max(floor_mps);
        state
    }

    /// The control in force at the beginning of an interval, and until when.
    fn piece(&self, start_ns: u64, to_ns: u64) -> (Option<ControlInForce>, u64) {
        let next_ns = self.controls().iter().map(|control| control.from_ns).find(|&from| from > start_ns);
        (self.in_force(start_ns).copied(), next_ns.unwrap_or(to_ns).min(to_ns))
    }

    /// The control in force at a time, if one that old is remembered.
    pub(crate) fn in_force(&self, at_ns: u64) -> Option<&ControlInForce> {
        self.controls().iter().rev().find(|control| control.from_ns <= at_ns)
    }

    /// The lowest speed that the robot can have had since a time: zero, or below it what it was told to drive backwards, or
    /// still did [m/s].
    pub(crate) fn slowest(&self, since_ns: u64) -> f64 {
        let in_force = self.in_force(since_ns).into_iter();
        let later = self.controls().iter().filter(|control| control.from_ns > since_ns);
        let still_mps = self.expected_mps.min(0.0);
        in_force.chain(later).fold(still_mps, |slowest, sent| slowest.min(sent.velocity_mps))
    }

    /// The lowest plausible speed since a time [m/s].
    fn floor_mps(&self, model: &MotionModel, since_ns: u64) -> f64 {
        if self.slowest(since_ns) < 0.0 { -model.bounds.sent_velocity_max_mps } else { 0.0 }
    }

    /// The measured speed if it is plausible: a robot reverses only where it was told to since a time, and at standstill reads
    /// zero with a little noise.
    pub(crate) fn plausible_speed(
        &self,
        model: &MotionModel,
        since_ns: u64,
        measured_mps: f64,
    ) -> Option<f64> {
        let [lowest_mps, largest_mps] = self.plausible_speeds(model, since_ns);
        (measured_mps > lowest_mps && measured_mps <= largest_mps)
            .then(|| measured_mps.max(self.floor_mps(model, since_ns)))
    }

    /// Lowest and largest speed that may be measured since a time [m/s].
    pub(crate) fn plausible_speeds(&self, model: &MotionModel, since_ns: u64) -> [f64; 2] {
        [self.floor_mps(model, since_ns) - 0.1, model.bounds.sent_velocity_max_mps]
    }
}

impl MotionModel {
    /// Whether speed or steering angle take time to follow.
    pub(crate) fn lags(&self) -> bool {
        !(self.velocity_lag.is_none() && self.steering_lag.is_none())
    }
}

/// The state after a piece, in steps of at most [`MAX_STEP_S`], each with the speed of its middle.
fn integrate(model: &MotionModel, state: State, piece: &Piece) -> State {
    if piece.duration_s <= 0.0 || (piece.from_mps == 0.0 && piece.to_mps == 0.0) {
        return state;
    }
    let steps = (piece.duration_s / MAX_STEP_S).ceil();
    let step_s = piece.duration_s / steps;
    (0..steps as usize).fold(state, |state, index| {
        let share = (index as f64 + 0.5) / steps;
        let speed = piece.from_mps + share * (piece.to_mps - piece.from_mps);
        step(model, &state, speed, piece.steering_rad, step_s)
    })
}

/// One step of the classical Runge-Kutta method on the model; where that is stiff, the closed form.
fn step(model: &MotionModel, state: &State, speed: f64, steering: f64, step_s: f64) -> State {
    let (parameters, steering) = (&model.parameters, model.learned.acting(steering));
    let lateral_control = Control { velocity: lateral_velocity(speed), steering };
    if is_stiff(parameters, state, &lateral_control, step_s) {
        return stiff_step(parameters, 0.0, state, &lateral_control, speed, step_s);
    }
    let slope = |vector| derivative_at(parameters, &State::from_vector(&vector), speed, steering);
    let start = state.to_vector();
    let first = slope(start);
    let second = slope(start + first * (step_s / 2.0));
    let third = slope(start + second * (step_s / 2.0));
    let fourth = slope(start + third * step_s);
    State::from_vector(&(start + (first + (second + third) * 2.0 + fourth) * (step_s / 6.0))).bounded()
}

#[cfg(test)]
mod tests;
