//! The true motion of the robot: model (7.27)-(7.31) behind an imperfect drive.
//!
//! The steering angle follows through the map of the linkage, the play between shaft and wheels and a constant offset.
//! Velocity and steering angle follow at once, as in the model, or with a lag and a limited rate. The forces of the
//! tyres are linear, as in the model, or limited by friction. The robot has no brake: it stops by blocking its wheels,
//! which slide with a constant deceleration while the steering angle stays as it was.
//!
//! A wheel that is smaller than the one on the other side, and slippery ground, make the wheels turn more per way; the drive
//! turns them as fast as before, so the robot is slower. A smaller wheel also pulls it to its side. Slippery ground holds
//! to the side as any other.
//!
//! It drives backwards as it drives forwards, and changes its direction at rest: by the drive, or at once where that has no
//! lag.
//!
//! The model divides by the velocity. Below [`vehicle::model::SLOWEST_MPS`], 0.05 m/s, the lateral part is computed as
//! if the robot drove that fast, which keeps it stable; at standstill sideslip and yaw rate are zero. So yaw rates are
//! too large below 0.05 m/s, where a blocked robot spends 10 ms.

use nalgebra::SVector;
use vehicle::integrate::{is_stiff, runge_kutta, runge_kutta_vector, stiff_step};
use vehicle::model::lateral_velocity;
use vehicle::tyre::{GRAVITY_MPS2, derivative_with_friction};
use vehicle::{Control, Lag, Parameters, State, VehicleModel, slid};

use crate::scenario::{Robot, Scenario, Values};

/// Longest plant step [ns]. RK4 is stable up to 3.9 ms at the slowest velocity of the lateral part of the shipped robots;
/// a robot that is too stiff for it moves in closed form.
pub const STEP_NS: u64 = 1_000_000;

/// Tolerance of the limits, for numbers that went through a conversion.
const LIMIT_SLACK: f64 = 1e-9;

/// Share of the curvature of a cone, which both wheels of an axle are when one is smaller, that a robot with steered wheels
/// follows: they hold against it, and are as stiff as those that roll along the cone.
const PULL_SHARE: f64 = 0.5;

/// State of the robot and of its drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plant {
    parameters: Parameters,
    values: Values,
    /// Angle that is added to the wheels: the offset, and what a smaller wheel pulls [rad].
    offset_rad: f64,
    /// Where slippery ground begins and ends along x [m].
    slippery_m: [f64; 2],
    /// Fraction of the turning of the wheels that is lost there.
    slip_share: f64,
    pub(crate) state: State,
    pub(crate) speed: f64,
    pub(crate) steering: f64,
    /// Speed that the drive is to reach where the wheels roll without slip [m/s].
    pub(crate) target_speed: f64,
    /// Angle of the wheels that the shaft asks for, after the play and without the offset [rad].
    pub(crate) target_steering: f64,
    pub(crate) blocked: bool,
    /// Whether it has run into something.
    pub(crate) wrecked: bool,
}

impl Plant {
    /// The robot at the start pose, at standstill, with blocked wheels.
    pub fn new(scenario: &Scenario) -> Self {
        let start = scenario.start;
        let values = scenario.robot_values();
        let Robot { width_m, slip_at_m, slip_length_m, slip_share, .. } = scenario.robot;
        let parameters = values.parameters();
        let share = if parameters.model == VehicleModel::Differential { 1.0 } else { PULL_SHARE };
        let pull = parameters.steering_of(share * values.wheel_smaller / width_m);
        let offset_rad = values.steering_offset_rad + pull;
        Self {
            parameters,
            values,
            offset_rad,
            slippery_m: [slip_at_m, slip_at_m + slip_length_m],
            slip_share,
            state: State { x: start.x_m, y: start.y_m, yaw: start.yaw_rad, ..State::default() },
            speed: 0.0,
            steering: offset_rad,
            target_speed: 0.0,
            target_steering: 0.0,
            blocked: true,
            wrecked: false,
        }
    }

    /// State of the model; its yaw counts full turns.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Speed over ground, negative backwards [m/s].
    pub fn speed(&self) -> f64 {
        self.speed
    }

    /// Steering angle of the wheels [rad].
    pub fn steering(&self) -> f64 {
        self.steering
    }

    /// Whether the wheels are blocked.
    pub fn is_blocked(&self) -> bool {
        self.blocked
    }

    /// Turns the wheels with the velocity [m/s] and the steering angle [rad] sent; numbers that are not finite
    /// change nothing.
    pub fn drive(&mut self, velocity_sent: f64, steering_sent: f64) {
        if self.wrecked || !velocity_sent.is_finite() || !steering_sent.is_finite() {
            return;
        }
        self.blocked = false;
        self.target_speed = velocity_sent / self.values.velocity_factor;
        let shaft = self.values.steering_map.realised(steering_sent);
        let play = self.values.steering_backlash_rad;
        // The wheels stay where they are until the shaft has used up the play.
        self.target_steering = self.target_steering.clamp(shaft - play, shaft + play);
        if self.values.velocity_lag_s <= 0.0 {
            self.speed = self.ground_target();
        }
        if self.values.steering_lag_s <= 0.0 {
            self.steering = self.wheels_target();
        }
        self.settle();
    }

    /// Whether the drive takes a velocity [m/s] and a steering angle [rad]; false for NaN.
    pub fn may_be_sent(&self, velocity: f64, steering: f64) -> bool {
        let Values { sent_velocity_max_mps, sent_steering_max_rad, .. } = self.values;
        velocity.abs() <= sent_velocity_max_mps + LIMIT_SLACK
            && steering.abs() <= sent_steering_max_rad + LIMIT_SLACK
    }

    /// Blocks the wheels.
    pub fn block(&mut self) {
        self.blocked = true;
    }

    /// Puts the robot down to the left of where it was [m], turned by `turn_rad`; its wheels and its drive continue.
    pub fn push(&mut self, left_m: f64, turn_rad: f64) {
        self.state.x -= left_m * self.state.yaw.sin();
        self.state.y += left_m * self.state.yaw.cos();
        self.state.yaw += turn_rad;
    }

    /// Distance that the wheels turn per distance over ground, of both sides in the mean; one without slip, with equal wheels.
    /// Wheels that are blocked do not slip on top of what they slide.
    pub fn turns_per_way(&self) -> f64 {
        let [begin, end] = self.slippery_m;
        let slips = !self.blocked && (begin..end).contains(&self.state.x);
        let rolled = 1.0 - if slips { self.slip_share } else { 0.0 };
        (1.0 + self.values.wheel_smaller.abs() / 2.0) / rolled
    }

    /// Speed over ground that the drive is to reach where it is now [m/s].
    fn ground_target(&self) -> f64 {
        self.target_speed / self.turns_per_way()
    }

    /// Stops the body at once and for good: it has run into something.
    pub fn wreck(&mut self) {
        self.wrecked = true;
        self.blocked = true;
        self.speed = 0.0;
        self.settle();
    }

    /// Moves on by `duration` seconds, at most a plant step; returns the distance driven, negative backwards [m].
    pub fn step(&mut self, duration: f64) -> f64 {
        if !self.blocked && self.values.velocity_lag_s <= 0.0 {
            // Slippery ground may begin or end here.
            self.speed = self.ground_target();
            self.settle();
        }
        match self.blocked {
            true => self.slide(duration),
            false if self.follows_at_once() => self.roll(self.speed, duration),
            false => self.follow(duration),
        }
    }

    fn follows_at_once(&self) -> bool {
        self.values.velocity_lag_s <= 0.0 && self.values.steering_lag_s <= 0.0
    }

    /// Angle of the wheels that is asked for [rad].
    fn wheels_target(&self) -> f64 {
        let offset = self.offset_rad;
        // The sum with zero would lose the sign of a zero.
        if offset == 0.0 { self.target_steering } else { self.target_steering + offset }
    }

    /// Slides with blocked wheels.
    fn slide(&mut self, duration: f64) -> f64 {
        let (before, deceleration) = (self.speed, self.sliding_mps2());
        if before == 0.0 {
            return 0.0;
        }
        let (after, moving) =
            (slid(before, deceleration, duration), duration.min(before.abs() / deceleration));
        if self.follows_at_once() {
            self.speed = after;
            // The mean speed over the step gives the distance of a constant deceleration exactly: v^2 / (2 a).
            return self.roll((before + after) / 2.0, moving);
        }
        let distance = self.follow(moving);
        self.speed = after;
        self.settle();
        distance
    }

    fn sliding_mps2(&self) -> f64 {
        let Values { blocked_deceleration_mps2, tyre_friction, .. } = self.values;
        if tyre_friction > 0.0 {
            blocked_deceleration_mps2.min(tyre_friction * GRAVITY_MPS2)
        } else {
            blocked_deceleration_mps2
        }
    }

    /// Moves with a constant speed and steering angle; returns the distance [m].
    fn roll(&mut self, speed: f64, duration: f64) -> f64 {
        if speed == 0.0 {
            return 0.0;
        }
        self.state = if self.is_stiff(speed, duration) {
            self.stiff_step(speed, self.steering, duration)
        } else {
            runge_kutta(&self.state, duration, |state| {
                let friction = self.values.tyre_friction;
                derivative_with_friction(&self.parameters, friction, state, speed, self.steering)
            })
        };
        self.settle();
        speed * duration
    }

    /// Moves while speed and steering angle follow what is asked for, or the wheels slide; returns the distance [m].
    ///
    /// One Runge-Kutta step over the state of the model, speed, steering angle and distance. Where that is stiff, speed and
    /// steering angle follow in closed form, and the state moves with their means.
    fn follow(&mut self, duration: f64) -> f64 {
        if self.is_stiff(self.speed, duration) {
            return self.follow_stiff(duration);
        }
        let mut start = SVector::<f64, 8>::zeros();
        start.fixed_rows_mut::<5>(0).copy_from(&self.state.to_vector());
        (start[5], start[6]) = (self.speed, self.steering);
        let end = runge_kutta_vector(start, duration, |vector| self.rates(&vector));
        if start[5] != 0.0 || end[5] != 0.0 {
            self.state = State::from_vector(&end.fixed_rows::<5>(0).into_owned()).bounded();
        }
        (self.speed, self.steering) = (end[5], end[6]);
        self.settle();
        end[7]
    }

    fn follow_stiff(&mut self, duration: f64) -> f64 {
        let (from_mps, from_rad) = (self.speed, self.steering);
        if self.blocked {
            self.speed = slid(from_mps, self.sliding_mps2(), duration);
        } else {
            self.speed = self.velocity_lag().after(from_mps, self.ground_target(), duration);
            self.steering = self.steering_lag().after(from_rad, self.wheels_target(), duration);
        }
        let mean_mps = f64::midpoint(from_mps, self.speed);
        if mean_mps != 0.0 {
            self.state = self.stiff_step(mean_mps, f64::midpoint(from_rad, self.steering), duration);
        }
        self.settle();
        mean_mps * duration
    }

    /// Whether a step of so many seconds is too long for an explicit method.
    fn is_stiff(&self, speed: f64, duration: f64) -> bool {
        let Values { velocity_lag_s, steering_lag_s, .. } = self.values;
        let is_short = |lag_s: f64| lag_s > 0.0 && duration > lag_s;
        let control = Control { velocity: lateral_velocity(speed), steering: self.steering };
        is_short(velocity_lag_s)
            || is_short(steering_lag_s)
            || is_stiff(&self.parameters, &self.state, &control, duration)
    }

    fn stiff_step(&self, speed: f64, steering: f64, duration: f64) -> State {
        let control = Control { velocity: lateral_velocity(speed), steering };
        stiff_step(&self.parameters, self.values.tyre_friction, &self.state, &control, speed, duration)
    }

    fn velocity_lag(&self) -> Lag {
        let Values { velocity_lag_s, acceleration_max_mps2, deceleration_max_mps2, .. } = self.values;
        Lag {
            time_constant_s: velocity_lag_s,
            rise_per_s: acceleration_max_mps2,
            fall_per_s: deceleration_max_mps2,
        }
    }

    fn steering_lag(&self) -> Lag {
        let Values { steering_lag_s, steering_rate_max_radps, .. } = self.values;
        Lag {
            time_constant_s: steering_lag_s,
            rise_per_s: steering_rate_max_radps,
            fall_per_s: steering_rate_max_radps,
        }
    }

    /// Rates of change of [`Self::follow`].
    fn rates(&self, vector: &SVector<f64, 8>) -> SVector<f64, 8> {
        let Values { velocity_lag_s, acceleration_max_mps2, deceleration_max_mps2, .. } = self.values;
        let Values { steering_lag_s, steering_rate_max_radps, tyre_friction, .. } = self.values;
        let (state, speed, steering) =
            (State::from_vector(&vector.fixed_rows::<5>(0).into_owned()), vector[5], vector[6]);
        let motion = derivative_with_friction(&self.parameters, tyre_friction, &state, speed, steering);
        let mut rates = SVector::<f64, 8>::zeros();
        rates.fixed_rows_mut::<5>(0).copy_from(&motion);
        rates[7] = speed;
        if self.blocked {
            rates[5] = (-self.sliding_mps2()).copysign(-self.speed);
            return rates;
        }
        if velocity_lag_s > 0.0 {
            let wanted = (self.ground_target() - speed) / velocity_lag_s;
            let is_backwards = speed < 0.0 || speed == 0.0 && self.target_speed < 0.0;
            rates[5] = if is_backwards {
                wanted.clamp(-acceleration_max_mps2, deceleration_max_mps2)
            } else {
                wanted.clamp(-deceleration_max_mps2, acceleration_max_mps2)
            };
        }
        if steering_lag_s > 0.0 {
            let wanted = (self.wheels_target() - steering) / steering_lag_s;
            rates[6] = wanted.clamp(-steering_rate_max_radps, steering_rate_max_radps);
        }
        rates
    }

    /// At standstill nothing turns.
    fn settle(&mut self) {
        if self.speed == 0.0 {
            self.speed = 0.0;
            self.state.sideslip = 0.0;
            self.state.yaw_rate = 0.0;
        }
    }
}

#[cfg(test)]
mod tests;
