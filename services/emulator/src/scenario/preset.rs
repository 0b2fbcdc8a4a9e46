//! The values that a preset gives to the keys of `[robot]`.

use vehicle::{Bounds, Description, Parameters, VehicleModel};

use super::robot::{OdometryModel, Preset, Robot};
use crate::noise::{NoiseStream, Purpose};
use crate::steering_map::SteeringMap;

/// Spread of a worn robot: each value is within this share of its middle.
const SPREAD: f64 = 0.2;
/// Spread of its velocity factor.
const VELOCITY_FACTOR_SPREAD: f64 = 0.05;
/// Its encoder scale error is within this of that of the preset `summit`.
const LONGITUDINAL_SPREAD: f64 = 0.01;
/// Its steering offset is within this [rad].
const OFFSET_SPREAD_RAD: f64 = 0.01;

macro_rules! values {
    ($($key:ident: $type:ty,)*) => {
        /// What the emulated robot really is: [`Robot`] with all values known.
        #[derive(Debug, Clone, Copy, PartialEq)]
        #[expect(missing_docs, reason = "the keys of `Robot` of the same names are documented")]
        pub struct Values {
            $(pub $key: $type,)*
        }

        impl Robot {
            /// The same robot with these values where it has none.
            fn filled(&self, values: &Values) -> Self {
                Self { $($key: self.$key.or(Some(values.$key)),)* ..*self }
            }

            /// The values given, and those of `rest` for all others.
            fn or(&self, rest: &Values) -> Values {
                Values { $($key: self.$key.unwrap_or(rest.$key),)* }
            }

            fn is_resolved(&self) -> bool {
                $(self.$key.is_some())&&*
            }
        }
    };
}

values! {
    model: VehicleModel,
    mass_kg: f64,
    rear_m: f64,
    front_m: f64,
    stiffness_n_per_rad: f64,
    inertia_kgm2: f64,
    yaw_lag_s: f64,
    tyre_friction: f64,
    velocity_factor: f64,
    sent_velocity_max_mps: f64,
    sent_steering_max_rad: f64,
    steering_backlash_rad: f64,
    steering_map: SteeringMap,
    steering_offset_rad: f64,
    wheel_smaller: f64,
    blocked_deceleration_mps2: f64,
    velocity_lag_s: f64,
    acceleration_max_mps2: f64,
    deceleration_max_mps2: f64,
    steering_lag_s: f64,
    steering_rate_max_radps: f64,
    command_delay_s: f64,
    command_jitter_s: f64,
    command_loss: f64,
    odometry_model: OdometryModel,
    odometry_longitudinal: f64,
    odometry_lateral_rate: f64,
    encoder_slip_m: f64,
    gyro_noise_rad: f64,
    gyro_bias_walk_radps: f64,
    gyro_bias_radps: f64,
    gyro_scale: f64,
    scan_stamp_jitter_s: f64,
    scan_missing_every: u64,
    scanner_x_m: f64,
    scanner_y_m: f64,
    scanner_yaw_rad: f64,
}

impl Values {
    /// Follows every command at once.
    ///
    /// Limits of a lag and errors of encoders are those of `summit`: they act when their lag or model is asked for.
    fn ideal(description: &Description) -> Self {
        Self {
            tyre_friction: 0.0,
            velocity_lag_s: 0.0,
            steering_lag_s: 0.0,
            command_delay_s: 0.0,
            command_jitter_s: 0.0,
            odometry_model: OdometryModel::Source,
            scan_stamp_jitter_s: 0.0,
            scan_missing_every: 0,
            ..Self::summit(description)
        }
    }

    /// The robot of a description, with delays, lags and errors that no description has.
    fn summit(description: &Description) -> Self {
        let Parameters { mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2, model, yaw_lag_s } =
            description.parameters();
        // Factor and linkage are those of the SUMMIT.
        let (velocity_factor, steering_map) = match model {
            VehicleModel::CounterSteered => (1.4, SteeringMap::Nonlinear),
            _ => (1.0, SteeringMap::Identity),
        };
        Self {
            model,
            mass_kg,
            rear_m,
            front_m,
            stiffness_n_per_rad,
            inertia_kgm2,
            yaw_lag_s,
            tyre_friction: description.tyre_friction,
            velocity_factor,
            sent_velocity_max_mps: description.bounds.sent_velocity_max_mps,
            sent_steering_max_rad: description.bounds.sent_steering_max_rad,
            steering_backlash_rad: 0.0,
            steering_map,
            steering_offset_rad: 0.0,
            wheel_smaller: 0.0,
            blocked_deceleration_mps2: description.blocked_deceleration_mps2,
            velocity_lag_s: description.velocity_lag_s,
            acceleration_max_mps2: description.acceleration_max_mps2,
            deceleration_max_mps2: description.deceleration_max_mps2,
            steering_lag_s: description.steering_lag_s,
            steering_rate_max_radps: description.steering_rate_max_radps,
            command_delay_s: description.command_delay_s,
            command_jitter_s: 0.002,
            command_loss: 0.0,
            odometry_model: OdometryModel::Encoders,
            odometry_longitudinal: 0.01,
            odometry_lateral_rate: 0.0,
            encoder_slip_m: description.encoder_slip_m,
            gyro_noise_rad: description.gyro_noise_rad,
            gyro_bias_walk_radps: description.gyro_bias_walk_radps,
            gyro_bias_radps: 0.0,
            gyro_scale: 0.0,
            scan_stamp_jitter_s: 0.002,
            scan_missing_every: 500,
            scanner_x_m: description.scanner_x_m,
            scanner_y_m: description.scanner_y_m,
            scanner_yaw_rad: description.scanner_yaw_rad,
        }
    }

    /// Each value drawn from a stream of its own, so that no key changes another.
    fn worn(description: &Description, seed: u64) -> Self {
        let middle = Self::summit(description);
        let about = |key, middle: f64, spread: f64| {
            // From -1 to 1.
            let draw = 2.0 * NoiseStream::new(seed, Purpose::Wear, name_hash(key)).uniform() - 1.0;
            middle + spread * draw
        };
        let share = |key, middle: f64| about(key, middle, SPREAD * middle);
        macro_rules! drawn {
            ($($key:ident),*) => { Self { $($key: share(stringify!($key), middle.$key),)* ..middle } };
        }
        let drawn = drawn!(
            mass_kg,
            rear_m,
            front_m,
            stiffness_n_per_rad,
            inertia_kgm2,
            yaw_lag_s,
            tyre_friction,
            steering_backlash_rad,
            blocked_deceleration_mps2,
            velocity_lag_s,
            acceleration_max_mps2,
            deceleration_max_mps2,
            steering_lag_s,
            steering_rate_max_radps,
            command_delay_s,
            command_jitter_s,
            encoder_slip_m,
            gyro_noise_rad,
            gyro_bias_walk_radps,
            scan_stamp_jitter_s,
            scanner_x_m,
            scanner_y_m,
            scanner_yaw_rad
        );
        let kv_spread = VELOCITY_FACTOR_SPREAD * middle.velocity_factor;
        Self {
            velocity_factor: about("velocity_factor", middle.velocity_factor, kv_spread),
            odometry_longitudinal: about(
                "odometry_longitudinal",
                middle.odometry_longitudinal,
                LONGITUDINAL_SPREAD,
            ),
            steering_offset_rad: about("steering_offset_rad", 0.0, OFFSET_SPREAD_RAD),
            scan_missing_every: share("scan_missing_every", middle.scan_missing_every as f64).round() as u64,
            ..drawn
        }
    }

    /// Parameters of (7.27)-(7.31).
    pub fn parameters(&self) -> Parameters {
        let Self { mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2, model, yaw_lag_s, .. } =
            *self;
        Parameters { mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2, model, yaw_lag_s }
    }
}

impl Robot {
    /// The same robot with all values known: those of the file, then those of the preset.
    ///
    /// A robot that is resolved stays as it is, whatever the description and the seed.
    #[must_use]
    pub fn resolved(&self, description: &Description, seed: u64) -> Self {
        let scanner = self.scanner.or(&description.scanner).into();
        if self.is_resolved() {
            return Self { scanner, ..*self };
        }
        let Self { length_m, width_m, body_x_m, .. } = Self::default();
        let mut robot = self.filled(&self.of_preset(description, seed));
        if description.model != VehicleModel::CounterSteered {
            // A size that the file has is that of the description as well.
            let sized = |own_m: f64, summit_m: f64, described_m: f64| {
                if own_m == summit_m { described_m } else { own_m }
            };
            robot.length_m = sized(self.length_m, length_m, description.length_m);
            robot.body_x_m = sized(self.body_x_m, body_x_m, description.body_x_m);
            robot.width_m = sized(self.width_m, width_m, description.width_m);
        }
        Self { scanner, ..robot }
    }

    /// All values; those that are not given come from the preset, around the default description.
    pub fn values(&self, seed: u64) -> Values {
        self.or(&self.of_preset(&Description::default(), seed))
    }

    fn of_preset(&self, description: &Description, seed: u64) -> Values {
        // The SUMMIT stays what it is, whatever a description states of it; of another vehicle only that is known.
        let is_summit = description.model == VehicleModel::CounterSteered;
        let known = if is_summit { Description::default() } else { *description };
        let values = match self.preset {
            Preset::Ideal => Values::ideal(&known),
            Preset::Summit => Values::summit(&known),
            Preset::Worn => Values::worn(description, seed),
        };
        // What a robot may be sent is a limit that is set, not a property that may be described wrongly.
        let Bounds { sent_velocity_max_mps, sent_steering_max_rad, .. } = description.bounds;
        Values { sent_velocity_max_mps, sent_steering_max_rad, ..values }
    }

    /// Keys in which a resolved robot differs from its description, with the true and the believed value.
    pub fn differences(&self, description: &Description) -> Vec<(&'static str, f64, f64)> {
        macro_rules! pairs {
            ($($key:ident),*) => {
                [
                    ("length_m", Some(self.length_m), description.length_m),
                    ("width_m", Some(self.width_m), description.width_m),
                    ("body_x_m", Some(self.body_x_m), description.body_x_m),
                    $((stringify!($key), self.$key, description.$key),)*
                ]
            };
        }
        let pairs = pairs!(
            mass_kg,
            rear_m,
            front_m,
            stiffness_n_per_rad,
            inertia_kgm2,
            yaw_lag_s,
            tyre_friction,
            blocked_deceleration_mps2,
            command_delay_s,
            velocity_lag_s,
            acceleration_max_mps2,
            deceleration_max_mps2,
            steering_lag_s,
            steering_rate_max_radps,
            encoder_slip_m,
            gyro_noise_rad,
            gyro_bias_walk_radps,
            scanner_x_m,
            scanner_y_m,
            scanner_yaw_rad
        );
        let [scanner, described] = [self.scanner.or(&description.scanner), description.scanner];
        macro_rules! of_scanner {
            ($($key:ident),*) => {
                [$((concat!("scanner.", stringify!($key)), Some(scanner.$key as f64), described.$key as f64),)*]
            };
        }
        let of_scanner = of_scanner!(beams, increment_rad, range_m, min_range_m, sweep_share);
        let [truth, believed] = [scanner, described].map(|scanner| scanner.geometry().first_rad);
        let pairs = pairs.into_iter().chain(of_scanner).chain([("scanner.first_rad", Some(truth), believed)]);
        let known = pairs.filter_map(|(key, truth, believed)| Some((key, truth?, believed)));
        // Tyres without friction in the file are linear: they do not slip at all.
        let is_linear = |key: &str, truth: f64| key == "tyre_friction" && truth == 0.0;
        known.filter(|(key, truth, believed)| truth != believed && !is_linear(key, *truth)).collect()
    }
}

/// Number of a key's stream: 64-bit FNV-1a of its name, so that a new key leaves the draws of the others as they are.
fn name_hash(name: &str) -> u64 {
    name.bytes()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(preset: Preset) -> Robot {
        Robot { preset, ..Robot::default() }
    }

    fn resolved(preset: Preset, seed: u64) -> Values {
        of(preset).resolved(&Description::default(), seed).values(0)
    }

    #[test]
    fn an_ideal_robot_follows_at_once_and_a_summit_has_the_lags_of_its_description() {
        let ideal = resolved(Preset::Ideal, 1);
        let zeros = [ideal.velocity_lag_s, ideal.steering_lag_s, ideal.command_delay_s, ideal.tyre_friction];
        assert_eq!(zeros, [0.0; 4]);
        assert_eq!((ideal.odometry_model, ideal.velocity_factor), (OdometryModel::Source, 1.4));
        let summit = resolved(Preset::Summit, 1);
        let lags =
            [summit.velocity_lag_s, summit.steering_lag_s, summit.command_delay_s, summit.command_jitter_s];
        assert_eq!(lags, [0.15, 0.1, 0.02, 0.002]);
        assert_eq!((summit.odometry_model, summit.scan_missing_every), (OdometryModel::Encoders, 500));
        assert_eq!(
            of(Preset::Summit).resolved(&Description::default(), 1).differences(&Description::default()),
            []
        );
    }

    #[test]
    fn a_key_of_the_file_wins_and_a_resolved_robot_stays_as_it_is() {
        for preset in [Preset::Ideal, Preset::Summit, Preset::Worn] {
            let robot = Robot { mass_kg: Some(20.0), velocity_lag_s: Some(0.0), ..of(preset) };
            let once = robot.resolved(&Description::default(), 5);
            assert_eq!((once.mass_kg, once.velocity_lag_s), (Some(20.0), Some(0.0)));
            let other = Description { stiffness_n_per_rad: 100.0, ..Description::default() };
            assert_eq!(once.resolved(&other, 6), once);
        }
    }

    #[test]
    fn a_worn_robot_is_within_its_limits_once_per_seed_and_fills_them() {
        let description = Description { mass_kg: 20.0, steering_lag_s: 0.3, ..Description::default() };
        let middle = Values::summit(&description);
        let mut extremes = [[f64::INFINITY, f64::NEG_INFINITY]; 5];
        for seed in 0..500 {
            let worn = of(Preset::Worn).resolved(&description, seed).values(0);
            assert_eq!(worn, of(Preset::Worn).resolved(&description, seed).values(0));
            let shares = [
                (worn.mass_kg / 20.0 - 1.0) / 0.2,
                (worn.steering_lag_s / 0.3 - 1.0) / 0.2,
                (worn.velocity_factor / 1.4 - 1.0) / 0.05,
                (worn.odometry_longitudinal - 0.01) / 0.01,
                worn.steering_offset_rad / 0.01,
            ];
            for (extreme, share) in extremes.iter_mut().zip(shares) {
                *extreme = [extreme[0].min(share), extreme[1].max(share)];
            }
            assert!((400..=600).contains(&worn.scan_missing_every));
            let others = [
                worn.tyre_friction / middle.tyre_friction,
                worn.command_jitter_s / middle.command_jitter_s,
                worn.encoder_slip_m / middle.encoder_slip_m,
                worn.blocked_deceleration_mps2 / middle.blocked_deceleration_mps2,
                worn.inertia_kgm2 / middle.inertia_kgm2,
            ];
            assert!(others.iter().all(|ratio| (0.8..=1.2).contains(ratio)), "{others:?}");
        }
        // 500 uniform draws reach within 5 % of both ends of their range but for one in 10^10 cases.
        for [low, high] in extremes {
            assert!(
                (-1.0 - 1e-9..-0.95).contains(&low) && (0.95..1.0 + 1e-9).contains(&high),
                "{low} {high}"
            );
        }
    }

    #[test]
    fn no_key_of_a_worn_robot_depends_on_another() {
        let description = Description::default();
        let worn = of(Preset::Worn).resolved(&description, 7);
        let given = Robot { mass_kg: Some(3.0), ..of(Preset::Worn) };
        let expected = Robot { mass_kg: Some(3.0), ..worn };
        assert_eq!(given.resolved(&description, 7), expected);
        let shares = [worn.mass_kg.unwrap() / 14.695, worn.inertia_kgm2.unwrap() / 0.5024];
        assert!((shares[0] - shares[1]).abs() > 1e-6, "two keys have two draws");
        assert_ne!(of(Preset::Worn).resolved(&description, 8), worn);
    }

    #[test]
    fn differences_name_key_truth_and_belief() {
        let description = Description { width_m: 0.5, mass_kg: 20.0, ..Description::default() };
        let robot = of(Preset::Summit).resolved(&description, 1);
        assert_eq!(robot.differences(&description), [("width_m", 0.4, 0.5), ("mass_kg", 14.695, 20.0)]);
    }
}
