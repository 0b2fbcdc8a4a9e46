//! Settings of the estimator.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};
use vehicle::{Description, Invalid, Setting, Track, settings};

use crate::correction::{CorrectionMode, Drift};
use crate::dead_reckoning::DriftSources;
use crate::laser::LaserMode;
use crate::laser::map::MAX_SURFACES;
use crate::learned::Learned;
use crate::motion::{Lag, MotionModel};
use crate::observability::{Measured, require_observable};

/// A set of values for noise and correction that go together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseProfile {
    /// The odometer as increments whose errors grow with way and time, which a laser corrects.
    #[default]
    Increments,
    /// The report of the odometer as a measurement of the place, with noise in metres and radians, so that the gate and
    /// the consistency of the filter mean something.
    Scaled,
    /// The values printed in the source, with the printed drift.
    ///
    /// Only the ratios of its noise act, so there is no gate.
    Source,
}

/// Which Kalman filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FilterKind {
    /// The extended one, (7.20)-(7.26), with the Jacobian of the motion.
    #[default]
    Extended,
    /// The linear one, (7.9)-(7.13), with A and H of ones; B u is the motion of the model.
    Linear,
}

settings! {
    /// Settings of the estimator; the profile sets what the file does not.
    pub struct EstimatorConfig {
        /// What the odometer is taken for: `increments` whose errors grow; or measurements of the place, `scaled` with noise in
        /// metres and radians, `source` with the values that the source prints, of which only the ratios matter.
        pub profile: NoiseProfile = NoiseProfile::Increments;
        /// The Kalman filter: `extended`, (7.20)-(7.26), or `linear`, (7.9)-(7.13), to which yaw and place are independent.
        pub filter: FilterKind = FilterKind::Extended;
        /// What of the scans corrects the pose: `off`; `walls`, the surfaces that the track states; `match`, those that were seen
        /// before. `match` with profile `increments`, else `off`.
        pub laser: Option<LaserMode> = None, "`off` with the profiles `scaled` and `source`";
        /// An occupancy grid in the format of ROS `map_server`, beside the system file: `NAME.yaml` with its image. Its straight
        /// surfaces become `surfaces`.
        pub map: Option<String> = None, "a file; with profile `increments` and laser `match`";
        /// Straight surfaces that stand around, instead of those that the track states: each as x, y, x, y from end to end, with what
        /// is free to the right [m].
        pub surfaces: Vec<[f64; 4]> = Vec::new(),
            (-1e4..=1e4, "at most 2048, each 0.05 to 1000 m long; with profile `increments` and laser `match`");
        /// Standard deviation of where a map is, all of it; with `map` what that says, and a cell's [m].
        pub map_deviation_m: f64 = 0.015, 0.001..=2.0;
        /// Standard deviation of where each of its surfaces is beside that; with `map` a cell's [m].
        pub surface_deviation_m: f64 = 0.015, 0.001..=0.5;
        /// Measured components of the pose.
        pub measure: Vec<Measured> = vec![Measured::Yaw, Measured::X, Measured::Y],
            "each once; they must determine the state, (7.1)-(7.2), as `[\"x\", \"y\"]` does";
        /// Variances Q of yaw, ahead and left for 100 ms; with profile `source` of yaw, x and y [rad^2, m^2, m^2].
        pub process_noise: Option<[f64; 3]> = None, 1e-12..=1e6;
        /// Variances R of the measured yaw, x and y [rad^2, m^2, m^2].
        pub measurement_noise: Option<[f64; 3]> = None, 1e-12..=1e6;
        /// Correction of the odometry, (7.36)-(7.40): none, a lateral error that grows with time or while the robot moves,
        /// or an error that turns the travelled path.
        pub correction: Option<CorrectionMode> = None;
        /// Odometry scale error: fraction of the travelled distance that is not reported, df.
        pub odometry_longitudinal: Option<f64> = None, -0.5..=0.5;
        /// Growth of the lateral odometry error, dds [1/s].
        pub odometry_lateral_rate: Option<f64> = None, -1.0..=1.0;
        /// Time after which the lateral odometry error starts at zero again; 0 for never [s].
        pub drift_reset_s: f64 = 0.0, 0.0..=3600.0;
        /// Whether measurements that do not fit the estimate are rejected.
        pub gate: Option<bool> = None, "`false` with profile `source`";
        /// Whether the estimator detects a wrong calibration while driving; the robot then slows down and stops.
        pub self_check: bool = true;
        /// The estimate starts anew after this many rejected measurements in a row.
        // Half a second at 10 Hz: longer than a burst of outliers, shorter than a metre at top speed.
        pub recover_after: u32 = 5, 1.0..=1000.0;
        /// The estimate starts anew after this time without odometry [s].
        pub max_gap_s: f64 = 2.0, 0.1..=60.0;
        /// Weight of the speed measured at the wheels; the desired speed has the remaining weight.
        pub speed_weight: f64 = 1.0, 0.0..=1.0;
        /// Fraction of the steering lag by which the pose is predicted further than the delay of the command.
        pub lead_share: f64 = 0.5, 0.0..=1.0;
        /// Factor on the standard deviations of slip, gyro noise and gyro bias in the covariance of the pose; 0 with profile
        /// `source`.
        pub drift_scale: f64 = 1.0, 0.0..=100.0;
        /// Standard deviation of the gyro's bias at the start, in the covariance of the pose and in what the laser learns [rad/s].
        pub gyro_bias_radps: f64 = 6e-4, 0.0..=0.1;
        /// The same of the fraction of the distance that the odometry reports too little or too much.
        pub odometry_scale: f64 = 0.006, 0.0..=0.2;
        /// The same of the fraction of the turn.
        pub gyro_scale: f64 = 0.006, 0.0..=0.2;
        /// The track, whose walls the scanner sees; `run` takes it from the scenario.
        pub track: Track = Track::default();
        /// The robot as this stage knows it; `run` takes it from the table `[vehicle]`.
        pub vehicle: Description = Description::default();
    }
}

impl Setting for NoiseProfile {}
impl Setting for FilterKind {}
impl Setting for CorrectionMode {}
impl Setting for Measured {}

/// All settings with the profile's values filled in, checked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilterSettings {
    /// Whether the yaw is measured; x and y always are, because nothing else determines the state.
    pub yaw_is_measured: bool,
    /// Whether the odometer is taken as increments.
    pub is_increments: bool,
    /// Whether A is the identity instead of the Jacobian of the motion.
    pub is_linear: bool,
    /// What of the scans corrects the pose.
    pub laser: LaserMode,
    /// Variances Q per 100 ms.
    pub process_noise: [f64; 3],
    /// Whether Q is along and across the heading instead of along the axes of the track.
    pub noise_turns: bool,
    /// Variances R.
    pub measurement_noise: [f64; 3],
    /// Correction of measured data.
    pub drift: Drift,
    /// What makes the odometry drift without being noticed.
    pub dead_reckoning: DriftSources,
    /// Whether measurements that do not fit are refused.
    pub gate: bool,
    /// Whether a wrong calibration is noticed.
    pub self_check: bool,
    /// Refusals in a row after which the estimate begins anew.
    pub recover_after: u64,
    /// Time without odometry after which the estimate begins anew [s].
    pub max_gap_s: f64,
    /// Time after which a command acts, counted from its computation [ns].
    pub lead_ns: u64,
    /// What the motion is computed with.
    pub motion: MotionModel,
}

/// Q and R as printed, for (yaw, x, y); only their ratios act.
const SOURCE_NOISE: ([f64; 3], [f64; 3]) = ([0.1, 0.1, 100.0], [1.0, 1.0, 10.0]);

/// Q for 100 ms: 2 mrad, 4 mm ahead, 2 mm to the left; R: 10 mrad and 20 mm.
///
/// R is the noise of the odometry that the robot is expected to have; Q makes the steady gains about 0.18, which
/// leaves 30 % of the noise, and follows a bend of the way that the model does not know within half a second.
pub(crate) const SCALED_NOISE: ([f64; 3], [f64; 3]) = ([4e-6, 1.6e-5, 4e-6], [1e-4, 4e-4, 4e-4]);

/// Length of a surface [m].
const SURFACE_M: RangeInclusive<f64> = 0.05..=1e3;

/// Random walk of the fraction of the distance that is not reported: standard deviation after one metre.
const SCALE_WALK: f64 = 1e-4;

impl EstimatorConfig {
    /// The settings with the values of the profile filled in.
    ///
    /// # Errors
    /// [`Invalid`] with the key, the value and what is allowed; for `measure` also the rank, (7.1)-(7.2).
    pub fn settings(&self) -> Result<FilterSettings, Invalid> {
        let source = self.profile == NoiseProfile::Source;
        let (process_noise, measurement_noise) = if source { SOURCE_NOISE } else { SCALED_NOISE };
        let drift = Drift {
            mode: self.correction.unwrap_or(if source {
                CorrectionMode::Time
            } else {
                CorrectionMode::Moving
            }),
            longitudinal: self.odometry_longitudinal.unwrap_or(0.01),
            lateral_rate: self.odometry_lateral_rate.unwrap_or(if source { 0.053 } else { 0.0 }),
            reset_s: self.drift_reset_s,
        };
        let is_increments = self.profile == NoiseProfile::Increments;
        let settings = FilterSettings {
            yaw_is_measured: self.measure.contains(&Measured::Yaw),
            is_increments,
            is_linear: self.filter == FilterKind::Linear,
            laser: self.laser.unwrap_or(if is_increments { LaserMode::Match } else { LaserMode::Off }),
            process_noise: self.process_noise.unwrap_or(process_noise),
            noise_turns: !source,
            measurement_noise: self.measurement_noise.unwrap_or(measurement_noise),
            drift,
            dead_reckoning: match self.profile {
                NoiseProfile::Source => DriftSources::default(),
                NoiseProfile::Scaled => self.dead_reckoning(),
                NoiseProfile::Increments => DriftSources {
                    scale: SCALE_WALK,
                    unknown: [self.gyro_bias_radps, self.odometry_scale, self.gyro_scale]
                        .map(|unknown| self.drift_scale * unknown),
                    ..self.dead_reckoning()
                },
            },
            gate: self.gate.unwrap_or(!source),
            self_check: self.self_check,
            recover_after: u64::from(self.recover_after),
            max_gap_s: self.max_gap_s,
            lead_ns: nanoseconds(
                self.vehicle.command_delay_s + self.lead_share * self.vehicle.steering_lag_s,
            ),
            motion: self.motion(),
        };

        require_observable(&self.measure)?;
        if settings.is_linear && !Measured::ALL.iter().all(|state| self.measure.contains(state)) {
            return Err(Invalid::new(
                "filter",
                "linear",
                "extended where not all of yaw, x and y are measured",
            ));
        }
        self.require_ranges()?;
        if settings.gate && source {
            return Err(Invalid::new(
                "gate",
                true,
                "false with the noise of profile \"source\", which has no unit",
            ));
        }
        self.require_surfaces(settings.laser)?;
        if settings.laser != LaserMode::Off && !is_increments {
            return Err(Invalid::new("laser", settings.laser.name(), "off without profile \"increments\""));
        }
        Ok(settings)
    }

    /// Passes when the surfaces of a map can be used.
    fn require_surfaces(&self, laser: LaserMode) -> Result<(), Invalid> {
        if let Some(map) = &self.map {
            return Err(Invalid::new("map", map, "a file that is read when a run starts"));
        }
        let count = self.surfaces.len();
        if count > MAX_SURFACES {
            let surfaces = format!("{count} surfaces");
            return Err(Invalid::new("surfaces", surfaces, format!("at most {MAX_SURFACES}")));
        }
        let length_m = |[x, y, to_x, to_y]: &[f64; 4]| (to_x - x).hypot(to_y - y);
        let wrong = self.surfaces.iter().position(|surface| !SURFACE_M.contains(&length_m(surface)));
        if let Some(index) = wrong {
            let length = format!("{} m long", length_m(&self.surfaces[index]));
            return Err(Invalid::new(&format!("surfaces[{index}]"), length, "0.05 to 1000 m long"));
        }
        if count > 0 && laser != LaserMode::Match {
            return Err(Invalid::new("laser", laser.name(), "match with a map or surfaces"));
        }
        Ok(())
    }

    fn dead_reckoning(&self) -> DriftSources {
        let vehicle = &self.vehicle;
        DriftSources {
            slip_m: self.drift_scale * vehicle.encoder_slip_m,
            yaw_rad: self.drift_scale * vehicle.gyro_noise_rad,
            bias_radps: self.drift_scale * vehicle.gyro_bias_walk_radps,
            ..DriftSources::default()
        }
    }

    /// What the motion is computed with.
    fn motion(&self) -> MotionModel {
        let vehicle = &self.vehicle;
        MotionModel {
            parameters: vehicle.parameters(),
            bounds: vehicle.bounds,
            blocked_deceleration_mps2: vehicle.blocked_deceleration_mps2,
            speed_weight: self.speed_weight,
            delay_ns: nanoseconds(vehicle.command_delay_s),
            velocity_lag: Lag {
                time_constant_s: vehicle.velocity_lag_s,
                rise_per_s: vehicle.acceleration_max_mps2,
                fall_per_s: vehicle.deceleration_max_mps2,
            },
            steering_lag: Lag {
                time_constant_s: vehicle.steering_lag_s,
                rise_per_s: vehicle.steering_rate_max_radps,
                fall_per_s: vehicle.steering_rate_max_radps,
            },
            learned: Learned::default(),
        }
    }

    /// The same with every key set: those that are not come from the profile.
    ///
    /// # Errors
    /// [`Invalid`] as [`Self::settings`].
    pub fn complete(&self) -> Result<Self, Invalid> {
        let FilterSettings { process_noise, measurement_noise, drift, gate, laser, .. } = self.settings()?;
        Ok(Self {
            laser: Some(laser),
            process_noise: Some(process_noise),
            measurement_noise: Some(measurement_noise),
            correction: Some(drift.mode),
            odometry_longitudinal: Some(drift.longitudinal),
            odometry_lateral_rate: Some(drift.lateral_rate),
            gate: Some(gate),
            ..self.clone()
        })
    }

    /// Passes when all settings are within their ranges and determine the state.
    ///
    /// # Errors
    /// [`Invalid`] as [`Self::settings`].
    pub fn validate(&self) -> Result<(), Invalid> {
        self.settings().map(|_| ())
    }
}

fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_fill_what_is_not_set() {
        let scaled = EstimatorConfig::default().settings().unwrap();
        assert!(scaled.gate && scaled.drift.lateral_rate == 0.0 && scaled.drift.longitudinal == 0.01);
        let source = EstimatorConfig { profile: NoiseProfile::Source, ..EstimatorConfig::default() }
            .settings()
            .unwrap();
        assert!(
            !source.gate && source.drift.lateral_rate == 0.053 && source.drift.mode == CorrectionMode::Time
        );
        assert_eq!(source.process_noise, [0.1, 0.1, 100.0]);
        let mixed = EstimatorConfig { odometry_lateral_rate: Some(-0.02), ..EstimatorConfig::default() };
        assert_eq!(mixed.settings().unwrap().drift.lateral_rate, -0.02);
    }

    #[test]
    fn settings_outside_their_ranges_are_refused_by_name() {
        let key = |config: EstimatorConfig| config.validate().unwrap_err().key;
        assert_eq!(
            key(EstimatorConfig { measure: vec![Measured::Yaw], ..EstimatorConfig::default() }),
            "measure"
        );
        assert_eq!(
            key(EstimatorConfig { process_noise: Some([1e-6, 0.0, 1e-6]), ..EstimatorConfig::default() }),
            "process_noise"
        );
        assert_eq!(
            key(EstimatorConfig { measurement_noise: Some([f64::NAN; 3]), ..EstimatorConfig::default() }),
            "measurement_noise"
        );
        let vehicle = Description { command_delay_s: f64::NAN, ..Description::default() };
        assert_eq!(key(EstimatorConfig { vehicle, ..EstimatorConfig::default() }), "vehicle.command_delay_s");
        assert_eq!(key(EstimatorConfig { speed_weight: 1.1, ..EstimatorConfig::default() }), "speed_weight");
        let gated =
            EstimatorConfig { profile: NoiseProfile::Source, gate: Some(true), ..EstimatorConfig::default() };
        assert_eq!(key(gated), "gate");
    }

    #[test]
    fn settings_are_read_from_their_file() {
        let read = |text: &str| toml::from_str::<EstimatorConfig>(text);
        assert_eq!(read(""), Ok(EstimatorConfig::default()));
        let text = "profile = \"source\"\nmeasure = [\"x\", \"y\"]\ncorrection = \"yaw\"\n\
            measurement_noise = [1e-4, 1e-4, 1e-4]";
        let config = read(text).unwrap();
        assert_eq!((config.profile, config.correction), (NoiseProfile::Source, Some(CorrectionMode::Yaw)));
        assert!(!config.settings().unwrap().yaw_is_measured);
        assert_eq!(toml::from_str(&toml::to_string(&config).unwrap()), Ok(config));
        assert!(read("measure = [\"speed\"]").is_err() && read("noise = 1").is_err());
    }
}
