//! Physical parameters of the robot.

use key_table::settings;

use crate::VehicleModel;

settings! {
    /// Parameters of (7.27)-(7.31).
    ///
    /// Source note: the text prints the unit of the inertia as Nm; it is kg m^2.
    #[derive(Copy)]
    pub struct Parameters {
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
        /// How the vehicle turns.
        pub model: VehicleModel = VehicleModel::CounterSteered;
        /// Time constant with which the yaw rate of a differential drive follows its command [s].
        pub yaw_lag_s: f64 = 0.1, 1e-3..=2.0;
    }
}

impl Parameters {
    /// Those of the robot turned round: front is rear.
    #[must_use]
    pub fn mirrored(self) -> Self {
        Self { rear_m: self.front_m, front_m: self.rear_m, model: self.model.mirrored(), ..self }
    }

    /// Lateral tyre stiffness in (7.27) and (7.29) at a velocity [N/rad]: negative backwards, where a slip angle is the
    /// opposite motion of the tyre to the side.
    pub fn stiffness_at(&self, velocity: f64) -> f64 {
        self.stiffness_n_per_rad.copysign(velocity)
    }

    /// Steady yaw rate per velocity and steering angle for small angles: x3 = gain * u1 * u2 [1/m].
    pub fn yaw_rate_gain(&self) -> f64 {
        let (sum, difference) = (self.rear_m + self.front_m, self.rear_m - self.front_m);
        if self.model != VehicleModel::CounterSteered {
            return 1.0 / sum;
        }
        // Steady state of (7.29) with the sideslip of (7.27) eliminated in the limit u1 -> 0.
        let square = self.rear_m.powi(2) + self.front_m.powi(2);
        sum / (square - difference * difference / 2.0)
    }

    /// Curvature of the path of slow turning wheels at a steering angle [1/m]; the angle of the SUMMIT's wheels is the true one,
    /// any other that of the model.
    pub fn curvature_of(&self, steering: f64) -> f64 {
        match self.model {
            VehicleModel::CounterSteered => 2.0 * steering.tan() / (self.front_m + self.rear_m),
            _ => steering * self.yaw_rate_gain(),
        }
    }

    /// The steering angle of a path with this curvature [rad]: the inverse of [`Self::curvature_of`].
    pub fn steering_of(&self, curvature: f64) -> f64 {
        match self.model {
            VehicleModel::CounterSteered => ((self.front_m + self.rear_m) * curvature / 2.0).atan(),
            _ => curvature / self.yaw_rate_gain(),
        }
    }

    /// How far the reference point is ahead of an axle that does not steer, and rolls without slip at low speed [m]; zero
    /// without one, and where it is the reference point.
    pub fn straight_axle_m(&self) -> f64 {
        match self.model {
            VehicleModel::Bicycle => self.rear_m,
            VehicleModel::RearSteered => -self.front_m,
            VehicleModel::CounterSteered | VehicleModel::Differential => 0.0,
        }
    }

    /// Velocity above which the robot turns round by itself, without steering: none for one whose centre of mass is not
    /// behind the middle of its axles [m/s].
    pub fn critical_mps(&self) -> Option<f64> {
        let (sum, behind) = (self.rear_m + self.front_m, self.front_m - self.rear_m);
        // The determinant of (7.27) and (7.29) in sideslip and yaw rate is zero there.
        (behind > 0.0 && self.model.shares().is_some())
            .then(|| sum * (self.stiffness_n_per_rad / (self.mass_kg * behind)).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quasi_steady_gain_is_the_one_of_the_geometry() {
        assert!((Parameters::default().yaw_rate_gain() - 5.405).abs() < 1e-3);
    }

    #[test]
    fn only_a_robot_with_a_long_front_has_a_critical_velocity() {
        assert_eq!(Parameters::default().critical_mps(), None);
        let long = Parameters { front_m: 0.3, rear_m: 0.2, mass_kg: 25.0, ..Parameters::default() };
        // 0.5 m, and 250 / (25 * 0.1) = 100.
        assert!((long.critical_mps().unwrap() - 5.0).abs() < 1e-12);
    }
}
