//! The true motion of the robot: model (7.27)-(7.31) behind an imperfect drive.
//!
//! The steering angle follows through the map of the linkage, the play between shaft and wheels and a constant offset.
//! Velocity and steering angle follow at once, as in the model, or with a lag and a limited rate. The forces of the
//! tyres are linear, as in the model, or limited by friction. The robot has no brake: it stops by blocking its wheels,
//! which slide with a constant deceleration while the steering angle stays as it was.
//!
//! The model divides by the velocity. Below [`vehicle::model::SLOWEST_MPS`], 0.05 m/s, the lateral part is computed as
//! if the robot drove that fast, which keeps it stable; at standstill sideslip and yaw rate are zero. So yaw rates are
//! too large below 0.05 m/s, where a blocked robot spends 10 ms.

use nalgebra::SVector;
use vehicle::integrate::{runge_kutta, runge_kutta_vector};
use vehicle::tyre::{GRAVITY_MPS2, derivative_with_friction};
use vehicle::{Parameters, State};

use crate::scenario::{Scenario, Values};
use crate::steering_map::SteeringMap;

/// Longest plant step [ns]. RK4 is stable up to 3.9 ms at the slowest velocity of the lateral part.
pub const STEP_NS: u64 = 1_000_000;

/// State of the robot and of its drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plant {
    parameters: Parameters,
    values: Values,
    steering_map: SteeringMap,
    pub(crate) state: State,
    pub(crate) speed: f64,
    pub(crate) steering: f64,
    /// Speed that the drive is to reach [m/s].
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
        Self {
            parameters: values.parameters(),
            values,
            steering_map: scenario.robot.steering_map,
            state: State { x: start.x_m, y: start.y_m, yaw: start.yaw_rad, ..State::default() },
            speed: 0.0,
            steering: values.steering_offset_rad,
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

    /// Speed over ground [m/s].
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
        let shaft = self.steering_map.realised(steering_sent);
        let play = self.values.steering_backlash_rad;
        // The wheels stay where they are until the shaft has used up the play.
        self.target_steering = self.target_steering.clamp(shaft - play, shaft + play);
        if self.values.velocity_lag_s <= 0.0 {
            self.speed = self.target_speed;
        }
        if self.values.steering_lag_s <= 0.0 {
            self.steering = self.wheels_target();
        }
        self.settle();
    }

    /// Blocks the wheels.
    pub fn block(&mut self) {
        self.blocked = true;
    }

    /// Stops the body at once and for good: it has run into something.
    pub fn wreck(&mut self) {
        self.wrecked = true;
        self.blocked = true;
        self.speed = 0.0;
        self.settle();
    }

    /// Moves on by `duration` seconds, at most a plant step; returns the distance driven [m].
    pub fn step(&mut self, duration: f64) -> f64 {
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
        let offset = self.values.steering_offset_rad;
        // The sum with zero would lose the sign of a zero.
        if offset == 0.0 { self.target_steering } else { self.target_steering + offset }
    }

    /// Slides with blocked wheels.
    fn slide(&mut self, duration: f64) -> f64 {
        let (before, deceleration) = (self.speed, self.sliding_mps2());
        if before <= 0.0 {
            return 0.0;
        }
        let (after, moving) =
            ((before - deceleration * duration).max(0.0), duration.min(before / deceleration));
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
        if speed <= 0.0 {
            return 0.0;
        }
        self.state = runge_kutta(&self.state, duration, |state| {
            derivative_with_friction(&self.parameters, self.values.tyre_friction, state, speed, self.steering)
        });
        self.settle();
        speed * duration
    }

    /// Moves while speed and steering angle follow what is asked for, or the wheels slide; returns the distance [m].
    ///
    /// One Runge-Kutta step over the state of the model, speed, steering angle and distance.
    fn follow(&mut self, duration: f64) -> f64 {
        let mut start = SVector::<f64, 8>::zeros();
        start.fixed_rows_mut::<5>(0).copy_from(&self.state.to_vector());
        (start[5], start[6]) = (self.speed, self.steering);
        let end = runge_kutta_vector(start, duration, |vector| self.rates(&vector));
        if start[5] > 0.0 || end[5] > 0.0 {
            self.state = State::from_vector(&end.fixed_rows::<5>(0).into_owned());
        }
        (self.speed, self.steering) = (end[5], end[6]);
        self.settle();
        end[7].max(0.0)
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
            rates[5] = -self.sliding_mps2();
            return rates;
        }
        if velocity_lag_s > 0.0 {
            let wanted = (self.target_speed - speed) / velocity_lag_s;
            rates[5] = wanted.clamp(-deceleration_max_mps2, acceleration_max_mps2);
        }
        if steering_lag_s > 0.0 {
            let wanted = (self.wheels_target() - steering) / steering_lag_s;
            rates[6] = wanted.clamp(-steering_rate_max_radps, steering_rate_max_radps);
        }
        rates
    }

    /// At standstill nothing turns.
    fn settle(&mut self) {
        if self.speed <= 0.0 {
            self.speed = 0.0;
            self.state.sideslip = 0.0;
            self.state.yaw_rate = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Robot;
    use crate::steering_map::nonlinear;
    use vehicle::Control;
    use vehicle::integrate::integrate;

    fn plant(robot: Robot) -> Plant {
        Plant::new(&Scenario { robot, ..Scenario::default() })
    }

    fn ideal() -> Robot {
        Robot { velocity_factor: Some(1.0), steering_map: SteeringMap::Identity, ..Robot::default() }
    }

    fn run(plant: &mut Plant, milliseconds: usize) -> f64 {
        (0..milliseconds).map(|_| plant.step(1e-3)).sum()
    }

    #[test]
    fn the_velocity_factor_divides_what_is_sent() {
        let mut plant = plant(Robot::default());
        plant.drive(1.4, 0.0);
        let distance = run(&mut plant, 1000);
        assert!((distance - 1.0).abs() < 1e-12 && (plant.state().x - 1.0).abs() < 1e-12);
    }

    #[test]
    fn an_ideal_robot_moves_as_the_model() {
        let mut plant = plant(ideal());
        plant.drive(0.7, 0.05);
        run(&mut plant, 2000);
        let control = Control { velocity: 0.7, steering: 0.05 };
        let model = integrate(&Parameters::default(), &State::default(), &control, 2.0);
        // Both are RK4, with 1 and 2 ms; the yaw rate's transient at 0.7 m/s costs the latter about 1e-7.
        assert!((plant.state().to_vector() - model.to_vector()).amax() < 1e-6);
    }

    #[test]
    fn blocked_wheels_slide_v_squared_over_two_a() {
        let mut plant = plant(ideal());
        plant.drive(0.9, 0.0);
        plant.block();
        let distance = run(&mut plant, 179);
        assert!(plant.speed() > 0.0);
        let rest = run(&mut plant, 10);
        // 0.81 / 10 m in 0.18 s.
        assert!((distance + rest - 0.081).abs() < 1e-12, "{}", distance + rest);
        assert_eq!((plant.speed(), plant.state().yaw_rate, plant.state().sideslip), (0.0, 0.0, 0.0));
    }

    #[test]
    fn blocked_wheels_keep_their_angle() {
        let mut plant = plant(ideal());
        plant.drive(1.0, 0.06);
        run(&mut plant, 500);
        plant.block();
        let yaw = plant.state().yaw;
        run(&mut plant, 300);
        assert_eq!(plant.steering(), 0.06);
        // 0.1 m in a turn of 3.1 m radius, and 5e-3 because the yaw rate lags up to 30 ms behind 1.6 rad/s^2.
        let turned = plant.state().yaw - yaw;
        assert!((turned - 0.1 / 3.1 - 5e-3).abs() < 2e-3, "{turned}");
    }

    #[test]
    fn play_delays_the_wheels_by_half_its_width_in_either_direction() {
        let mut plant = plant(Robot { steering_backlash_rad: Some(0.006), ..ideal() });
        let mut wheels = |sent: f64| {
            plant.drive(0.5, sent);
            plant.steering()
        };
        assert_eq!(wheels(0.005), 0.0, "the play is not used up");
        assert!((wheels(0.020) - 0.014).abs() < 1e-15, "pushed from below");
        assert!((wheels(0.010) - 0.014).abs() < 1e-15, "nothing pushes on the way back");
        assert!((wheels(0.000) - 0.006).abs() < 1e-15, "pushed from above");
        assert!((wheels(-0.02) + 0.014).abs() < 1e-15);
    }

    #[test]
    fn the_map_of_the_linkage_comes_before_the_play() {
        let mut plant = plant(Robot { steering_backlash_rad: Some(0.006), ..Robot::default() });
        plant.drive(0.5, 0.06);
        assert!((plant.steering() - (nonlinear(0.06) - 0.006)).abs() < 1e-15);
    }

    #[test]
    fn the_slowest_drive_stays_stable_and_a_wreck_stays_where_it_is() {
        let mut plant = plant(ideal());
        plant.drive(0.01, 0.12);
        run(&mut plant, 5000);
        assert!(plant.state().is_finite() && plant.state().yaw_rate.abs() < 0.05);
        plant.wreck();
        let state = *plant.state();
        plant.drive(1.0, 0.0);
        assert_eq!(run(&mut plant, 100), 0.0);
        assert_eq!(*plant.state(), state);
    }

    /// A robot with lags and nothing else.
    fn lagging() -> Robot {
        Robot {
            velocity_lag_s: Some(0.15),
            steering_lag_s: Some(0.1),
            acceleration_max_mps2: Some(100.0),
            deceleration_max_mps2: Some(100.0),
            steering_rate_max_radps: Some(100.0),
            ..ideal()
        }
    }

    #[test]
    fn velocity_and_steering_follow_with_their_time_constants() {
        let mut plant = plant(lagging());
        plant.drive(0.8, 0.05);
        assert_eq!((plant.speed(), plant.steering()), (0.0, 0.0));
        let distance = run(&mut plant, 150);
        // One time constant of the velocity, 1.5 of the steering.
        assert!((plant.speed() - 0.8 * (1.0 - (-1.0_f64).exp())).abs() < 1e-9);
        assert!((plant.steering() - 0.05 * (1.0 - (-1.5_f64).exp())).abs() < 1e-9);
        // v t - v tau (1 - exp(-t / tau)).
        assert!((distance - 0.8 * 0.15 * (-1.0_f64).exp()).abs() < 1e-9, "{distance}");
    }

    #[test]
    fn acceleration_deceleration_and_steering_rate_are_limited() {
        let limits = Robot {
            acceleration_max_mps2: Some(2.0),
            deceleration_max_mps2: Some(3.0),
            steering_rate_max_radps: Some(0.2),
            ..lagging()
        };
        let mut plant = plant(limits);
        plant.drive(1.0, 0.06);
        run(&mut plant, 100);
        assert!((plant.speed() - 0.2).abs() < 1e-12, "2 m/s^2 for 0.1 s: {}", plant.speed());
        assert!((plant.steering() - 0.02).abs() < 1e-12, "0.2 rad/s for 0.1 s: {}", plant.steering());
        run(&mut plant, 3000);
        plant.drive(0.1, 0.06);
        run(&mut plant, 100);
        assert!((plant.speed() - 0.7).abs() < 1e-6, "3 m/s^2 for 0.1 s: {}", plant.speed());
    }

    #[test]
    fn a_robot_at_standstill_turns_its_wheels_before_it_rolls() {
        let mut plant = plant(Robot { velocity_lag_s: Some(0.0), ..lagging() });
        plant.drive(0.0, 0.06);
        assert_eq!(run(&mut plant, 1000), 0.0);
        assert!((plant.steering() - 0.06).abs() < 1e-5);
        assert_eq!(*plant.state(), State::default());
    }

    #[test]
    fn blocked_wheels_keep_the_angle_that_they_had_reached() {
        let mut plant = plant(lagging());
        plant.drive(1.0, 0.06);
        run(&mut plant, 50);
        let reached = plant.steering();
        plant.block();
        run(&mut plant, 300);
        assert!(reached < 0.03);
        assert_eq!((plant.steering(), plant.speed()), (reached, 0.0));
    }

    #[test]
    fn blocked_wheels_slow_down_by_mu_g_at_most() {
        let way = |friction| {
            let mut plant = plant(Robot { tyre_friction: Some(friction), ..ideal() });
            plant.drive(0.9, 0.0);
            plant.block();
            run(&mut plant, 2000)
        };
        assert!((way(0.1) - 0.81 / (2.0 * 0.981)).abs() < 1e-12);
        assert!((way(0.8) - 0.081).abs() < 1e-12, "5 m/s^2 is less than 0.8 g");
    }

    #[test]
    fn tyres_with_little_friction_turn_less() {
        // How far the direction of motion turns in 5 s at 1 m/s.
        let turn = |friction| {
            let mut plant = plant(Robot { tyre_friction: Some(friction), ..ideal() });
            plant.drive(1.0, 0.06);
            run(&mut plant, 5000);
            plant.state().yaw + plant.state().sideslip
        };
        // 0.32 rad/s without a limit, less the transient; the forces of 0.02 g give 0.196 m/s^2 at most, over the
        // cosine of a sideslip up to 0.18 rad.
        assert!((turn(0.0) - 1.6).abs() < 0.03, "{}", turn(0.0));
        assert!((0.93..=0.998).contains(&turn(0.02)), "{}", turn(0.02));
        assert!((turn(0.8) / turn(0.0) - 1.0).abs() < 0.005);
    }

    #[test]
    fn the_offset_is_added_after_map_and_play() {
        let mut plant = plant(Robot {
            steering_offset_rad: Some(0.01),
            steering_backlash_rad: Some(0.006),
            ..Robot::default()
        });
        assert_eq!(plant.steering(), 0.01);
        plant.drive(0.5, 0.06);
        assert!((plant.steering() - (nonlinear(0.06) - 0.006 + 0.01)).abs() < 1e-15);
        plant.drive(0.5, 0.06);
        assert!((plant.steering() - (nonlinear(0.06) - 0.006 + 0.01)).abs() < 1e-15, "it does not add up");
    }
}
