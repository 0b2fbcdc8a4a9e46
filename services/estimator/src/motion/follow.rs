//! The motion of a robot whose speed and steering angle lag behind the desired ones.

use vehicle::integrate::MAX_STEP_S;
use vehicle::{State, VehicleModel, slid};

use super::{ControlInForce, MotionModel, MotionState};

/// Step per speed [s^2/m]: the lateral motion settles at 35 1/s times 1 m/s over the speed, so a step is a third of that.
const STEP_PER_SPEED: f64 = 0.01;

/// Longest step [s]: the lags are a straight line in it to 1e-4 of a step of the target.
const MAX_LAG_STEP_S: f64 = 0.005;

/// Standard deviation of a number that is anywhere between two bounds, as share of their distance.
const UNIFORM: f64 = 0.289;

/// Speed and steering angle of the wheels.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Wheels {
    speed: f64,
    steering: f64,
}

impl Wheels {
    /// The wheels some seconds later under one control; without a control they stay as they are.
    fn after(self, model: &MotionModel, control: Option<&ControlInForce>, seconds: f64) -> Self {
        let speed = speed_after(model, control, self.speed, seconds);
        let steering = match control {
            Some(control) if control.drives == 1 => {
                model.steering_lag.after(self.steering, control.steering_rad, seconds)
            }
            _ => self.steering,
        };
        Self { speed, steering }
    }
}

fn speed_after(model: &MotionModel, control: Option<&ControlInForce>, speed: f64, seconds: f64) -> f64 {
    match control {
        Some(control) if control.drives == 1 => {
            model.velocity_lag.after(speed, control.velocity_mps, seconds)
        }
        Some(_) => slid(speed, model.blocked_deceleration_mps2, seconds),
        None => speed,
    }
}

impl MotionState {
    /// The speed at the end of an interval by the controls alone, and the distance until then.
    pub(super) fn speed_after(
        &self,
        model: &MotionModel,
        speed: f64,
        from_ns: u64,
        to_ns: u64,
    ) -> (f64, f64) {
        let (mut speed, mut distance_m, mut start_ns) = (speed, 0.0, from_ns);
        while start_ns < to_ns {
            let (control, end_ns) = self.piece(start_ns, to_ns);
            let (before, seconds) = (speed, (end_ns - start_ns) as f64 * 1e-9);
            speed = speed_after(model, control.as_ref(), before, seconds);
            distance_m += f64::midpoint(before, speed) * seconds;
            start_ns = end_ns;
        }
        (speed, distance_m)
    }

    /// The state at the end of an interval, and the standard deviations of the distance and the yaw because of what is
    /// not measured; leaves speed and steering angle in `self`.
    ///
    /// Wheel encoders measure the mean speed of the interval, other sensors that at its end: what lies between the two is
    /// as assumed. A difference beyond is taken to have grown evenly over the interval. The distance may differ by
    /// anything up to the difference times the interval, and the yaw by the angle between wheels and target.
    pub(super) fn follow(
        &mut self,
        model: &MotionModel,
        mut state: State,
        [from_ns, to_ns]: [u64; 2],
        measured: Option<f64>,
        floor_mps: f64,
    ) -> (State, f64, f64) {
        let seconds = to_ns.saturating_sub(from_ns) as f64 * 1e-9;
        if seconds <= 0.0 {
            return (state, 0.0, 0.0);
        }
        let (end_mps, distance_m) = self.speed_after(model, self.speed_mps, from_ns, to_ns);
        let mean_mps = distance_m / seconds;
        let assumed = |measured: f64| measured.clamp(mean_mps.min(end_mps), mean_mps.max(end_mps));
        let growth =
            measured.map_or(0.0, |measured| model.speed_weight * (measured - assumed(measured)) / seconds);
        let mut wheels = Wheels { speed: self.speed_mps, steering: self.steering_rad };
        let (mut start_ns, mut turned) = (from_ns, 0.0);
        while start_ns < to_ns {
            let (control, end_ns) = self.piece(start_ns, to_ns);
            let control = control.as_ref();
            let duration = (end_ns - start_ns) as f64 * 1e-9;
            let offset = |at_s: f64| growth * ((start_ns - from_ns) as f64 * 1e-9 + at_s);
            let steps = steps(
                (wheels.speed + offset(0.0)).max(floor_mps).abs(),
                (wheels.after(model, control, duration).speed + offset(duration)).max(floor_mps).abs(),
                duration,
            );
            let step_s = duration / steps;
            for step in 0..steps as usize {
                let next = wheels.after(model, control, step_s);
                let speed = (wheels.speed + next.speed) / 2.0 + offset((step as f64 + 0.5) * step_s);
                let speed = speed.max(floor_mps);
                let steering = (wheels.steering + next.steering) / 2.0;
                if speed != 0.0 {
                    state = super::step(model, &state, speed, steering, step_s);
                    turned += speed.abs()
                        * step_s
                        * control.map_or(0.0, |control| (control.steering_rad - steering).abs());
                } else {
                    (state.sideslip, state.yaw_rate) = (0.0, 0.0);
                }
                wheels = next;
            }
            start_ns = end_ns;
        }
        self.speed_mps = (wheels.speed + growth * seconds).max(floor_mps);
        self.steering_rad = wheels.steering;
        if self.speed_mps == 0.0 {
            (state.sideslip, state.yaw_rate) = (0.0, 0.0);
        }
        let ahead_m = UNIFORM * growth.abs() * seconds * seconds;
        (state, ahead_m, UNIFORM * curvature_per_angle(model) * turned)
    }
}

/// Number of equal steps for a piece between two speeds in either direction; one where the robot stands throughout.
fn steps(from_mps: f64, to_mps: f64, duration: f64) -> f64 {
    if from_mps == 0.0 && to_mps == 0.0 {
        return 1.0;
    }
    let longest = (STEP_PER_SPEED * from_mps.min(to_mps)).clamp(MAX_STEP_S, MAX_LAG_STEP_S);
    (duration / longest).ceil()
}

/// Curvature of the path per steering angle for small angles [1/m].
pub(crate) fn curvature_per_angle(model: &MotionModel) -> f64 {
    let parameters = &model.parameters;
    if parameters.model != VehicleModel::CounterSteered {
        return parameters.yaw_rate_gain();
    }
    (parameters.rear_m + parameters.front_m) / (parameters.rear_m.powi(2) + parameters.front_m.powi(2))
}
