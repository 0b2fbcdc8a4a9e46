//! What the stack believes about the robot: the table `[vehicle]` of the system file.

use key_table::settings;

use crate::bounds::ANY_VELOCITY_MAX_MPS;
use crate::geometry::Rectangle;
use crate::{Bounds, Parameters, ScannerDescription, Surroundings, VehicleModel};

/// A scanner sees 120 degrees to each side; turned further, it would not see 60 degrees to each side ahead [rad].
pub const SCANNER_YAW_MAX_RAD: f64 = 1.04;

/// So many commands may be on their way from the actuator to the wheels.
pub const MAX_ON_THE_WAY: usize = 64;

settings! {
    /// The vehicle description; every stage reads the robot's properties here. The defaults describe the SUMMIT.
    #[derive(Copy)]
    pub struct Description {
        /// How the vehicle turns: `counter_steered` axles as the SUMMIT's, a `bicycle` as a car, `rear_steered` as a forklift, or a
        /// `differential` drive. What is said of the steering angle of the last holds for a wheel `front_m` + `rear_m` before its
        /// axle that would lead it on the same path.
        pub model: VehicleModel = VehicleModel::CounterSteered;
        /// Length of the body [m].
        pub length_m: f64 = 0.56, 0.1..=6.0;
        /// Width of the body [m].
        pub width_m: f64 = 0.40, 0.1..=3.0;
        /// How far the middle of the body is ahead of the reference point, whose pose and path are those of the robot: its centre of
        /// mass, or the middle of the axle of a differential drive [m].
        pub body_x_m: f64 = 0.0, -3.0..=3.0;
        /// Mass m [kg].
        pub mass_kg: f64 = 14.695, 1e-3..=1e6;
        /// Distance of the rear axle from the centre of mass, lh [m].
        pub rear_m: f64 = 0.1924, 1e-3..=1e6;
        /// Distance of the front axle from the centre of mass, lv [m].
        pub front_m: f64 = 0.1776, 1e-3..=1e6;
        /// Lateral tyre stiffness of one axle, c [N/rad].
        pub stiffness_n_per_rad: f64 = 250.0, 1e-3..=1e6;
        /// Moment of inertia about the vertical axis, J [kg m^2].
        pub inertia_kgm2: f64 = 0.5024, 1e-3..=1e6;
        /// Time constant with which the yaw rate of a differential drive follows its command [s].
        pub yaw_lag_s: f64 = 0.1, 1e-3..=2.0;
        /// Friction coefficient of the tyres, mu.
        pub tyre_friction: f64 = 0.8, 0.05..=5.0;
        /// Bounds of controls and states, (7.41)-(7.44).
        pub bounds: Bounds = Bounds::default();
        /// Deceleration while the wheels are blocked [m/s^2].
        pub blocked_deceleration_mps2: f64 = 5.0, 0.1..=50.0;
        /// Mean time from the actuator to the wheels [s].
        pub command_delay_s: f64 = 0.02, 0.0..=0.5;
        /// Time constant with which the velocity follows the desired one [s].
        pub velocity_lag_s: f64 = 0.15, 0.0..=2.0;
        /// Largest acceleration of the drive [m/s^2].
        pub acceleration_max_mps2: f64 = 2.0, 0.05..=100.0;
        /// Largest deceleration of the drive with turning wheels [m/s^2].
        pub deceleration_max_mps2: f64 = 3.0, 0.05..=100.0;
        /// Time constant with which the steering angle follows the desired one [s].
        pub steering_lag_s: f64 = 0.1, 0.0..=2.0;
        /// Largest rate of the steering angle [rad/s].
        pub steering_rate_max_radps: f64 = 0.5, 0.01..=100.0;
        /// Slip of the wheel encoders: standard deviation of the measured distance after one metre [m].
        pub encoder_slip_m: f64 = 0.005, 0.0..=1.0;
        /// White noise of the gyro: standard deviation of the integrated yaw after one second [rad].
        pub gyro_noise_rad: f64 = 2e-4, 0.0..=1.0;
        /// Random walk of the gyro's bias: standard deviation after one second [rad/s].
        pub gyro_bias_walk_radps: f64 = 2e-5, 0.0..=1.0;
        /// Position of the scanner ahead of the robot's centre [m].
        pub scanner_x_m: f64 = 0.0, -2.0..=2.0;
        /// Position of the scanner to the left of the robot's centre [m].
        pub scanner_y_m: f64 = 0.0, -2.0..=2.0;
        /// Direction of the scanner's front beam, counter-clockwise from straight ahead; it has to see 60 degrees to each
        /// side ahead [rad].
        pub scanner_yaw_rad: f64 = 0.0, -SCANNER_YAW_MAX_RAD..=SCANNER_YAW_MAX_RAD;
        /// What the scanner measures.
        pub scanner: ScannerDescription = ScannerDescription::default();
        /// How near in front of the body something may appear that was not seen before [m].
        pub sudden_m: f64 = 1.2, 0.1..=100.0;
        /// What the scanner sees where the track is empty; without the key `track.surroundings` of the scenario holds.
        pub surroundings: Surroundings = Surroundings::Hall;
        /// Largest velocity in open surroundings, where a blind scanner is not detected, and with a degraded one [m/s].
        pub careful_mps: f64 = 0.3, 0.05..=ANY_VELOCITY_MAX_MPS;
    }
}

impl Description {
    /// A robot that follows every command at once, as the source assumes; the rest as described here.
    #[must_use]
    pub fn without_lag(self) -> Self {
        Self { command_delay_s: 0.0, velocity_lag_s: 0.0, steering_lag_s: 0.0, ..self }
    }

    /// Parameters of (7.27)-(7.31).
    pub fn parameters(&self) -> Parameters {
        let Self { mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2, model, yaw_lag_s, .. } =
            *self;
        Parameters { mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2, model, yaw_lag_s }
    }

    /// That of the vehicle turned round, within these bounds.
    #[must_use]
    pub fn mirrored(self, bounds: Bounds) -> Self {
        let Parameters { rear_m, front_m, model, .. } = self.parameters().mirrored();
        Self { bounds, rear_m, front_m, model, body_x_m: -self.body_x_m, ..self }
    }

    /// The body with the reference point at a pose (x, y, yaw).
    pub fn body(&self, pose: [f64; 3]) -> Rectangle {
        Rectangle::of_robot(pose, self.body_x_m, self.length_m, self.width_m)
    }

    /// How far the front of the body is ahead of the reference point [m].
    pub fn nose_m(&self) -> f64 {
        self.length_m / 2.0 + self.body_x_m
    }

    /// How far the front or the rear of the body is from the reference point, whichever is further [m].
    pub fn reach_m(&self) -> f64 {
        self.length_m / 2.0 + self.body_x_m.abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rear_of_a_vehicle_is_the_front_of_the_one_turned_round() {
        let car = Description { model: VehicleModel::Bicycle, body_x_m: 0.2, ..Description::default() };
        let turned = car.mirrored(car.bounds);
        assert_eq!((turned.model, turned.front_m), (VehicleModel::RearSteered, car.rear_m));
        assert!((car.nose_m() - 0.48).abs() < 1e-12 && (turned.nose_m() - 0.08).abs() < 1e-12);
        assert_eq!((turned.reach_m(), turned.mirrored(car.bounds)), (car.reach_m(), car));
    }

    #[test]
    fn the_default_description_has_the_parameters_of_the_source() {
        assert_eq!(Description::default().parameters(), Parameters::default());
        assert_eq!(Description::default().require_ranges(), Ok(()));
    }
}
