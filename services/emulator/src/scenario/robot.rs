//! What is wrong with the emulated robot and with what it measures.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};
use vehicle::bounds::{ANY_SENT_STEERING_MAX_RAD, ANY_SENT_VELOCITY_MAX_MPS};
use vehicle::{SCANNER_YAW_MAX_RAD, ScannerDescription, Setting, VehicleModel, settings};

use crate::steering_map::SteeringMap;

/// When the lateral error of the odometry grows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DriftGrowth {
    /// While the robot moves.
    #[default]
    Moving,
    /// With time, also at standstill: (7.38) as printed.
    Time,
}

/// A set of values for the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// The model as printed: it follows every command at once.
    #[default]
    Ideal,
    /// A believable robot, with delays, lags, slipping tyres, wheel encoders and a gyro.
    Summit,
    /// Each value drawn once from the seed, around what the vehicle description states.
    Worn,
}

impl Preset {
    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ideal => "ideal",
            Self::Summit => "summit",
            Self::Worn => "worn",
        }
    }
}

/// What the odometry is measured with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OdometryModel {
    /// The true speed and heading, with the errors of (7.36)-(7.40).
    #[default]
    Source,
    /// Wheel encoders and a gyro, whose errors accumulate.
    Encoders,
}

impl Setting for DriftGrowth {}
impl Setting for Preset {}
impl Setting for OdometryModel {}

settings! {
    /// Body and imperfections of the emulated robot; the preset sets what the file does not.
    #[derive(Copy)]
    pub struct Robot {
        /// Set of values for the keys below: `ideal` follows every command at once, `summit` is a believable robot, and
        /// `worn` draws each value once from the seed, around what the vehicle description states: it is not calibrated, and may miss
        /// goals that are more than 10 m away.
        pub preset: Preset = Preset::Ideal;
        /// Whether the robot publishes its true state. Without it a run is judged by the estimate, as with a real robot.
        pub publish_truth: bool = true;
        /// Length of the body [m].
        pub length_m: f64 = 0.56, (0.05..=6.0, "0.1 to 6 unless `vehicle.length_m` is set");
        /// Width of the body [m].
        pub width_m: f64 = 0.40, (0.05..=5.0, "0.1 to 3 unless `vehicle.width_m` is set");
        /// How far the middle of the body is ahead of the reference point [m].
        pub body_x_m: f64 = 0.0, -3.0..=3.0;
        /// How it turns; without the key as `vehicle.model` says. With another model than `counter_steered` all presets are around
        /// the vehicle description, with a velocity factor of 1 and the steering map `identity`.
        pub model: Option<VehicleModel> = None;
        /// Mass m [kg].
        pub mass_kg: Option<f64> = None, 1e-3..=1e6;
        /// Distance of the rear axle from the centre of mass, lh [m].
        pub rear_m: Option<f64> = None, 1e-3..=1e6;
        /// Distance of the front axle from the centre of mass, lv [m].
        pub front_m: Option<f64> = None, 1e-3..=1e6;
        /// Lateral tyre stiffness of one axle, c [N/rad].
        pub stiffness_n_per_rad: Option<f64> = None, 1e-3..=1e6;
        /// Moment of inertia about the vertical axis, J [kg m^2].
        pub inertia_kgm2: Option<f64> = None, 1e-3..=1e6;
        /// Time constant with which the yaw rate of a differential drive follows its command [s].
        pub yaw_lag_s: Option<f64> = None, 1e-3..=2.0;
        /// Friction coefficient of the tyres, mu; 0 for forces without a limit.
        pub tyre_friction: Option<f64> = None, 0.0..=5.0;
        /// Velocity sent divided by the true velocity, kv.
        pub velocity_factor: Option<f64> = None, 0.1..=10.0;
        /// Largest velocity that the robot takes in either direction; without the key that of `vehicle.bounds` [m/s].
        pub sent_velocity_max_mps: Option<f64> = None, 0.02..=ANY_SENT_VELOCITY_MAX_MPS;
        /// Largest steering angle that the robot takes to either side; without the key that of `vehicle.bounds` [rad].
        pub sent_steering_max_rad: Option<f64> = None, 0.001..=ANY_SENT_STEERING_MAX_RAD;
        /// Half the play between steering shaft and wheels, nu [rad].
        pub steering_backlash_rad: Option<f64> = None, 0.0..=0.1;
        /// True steering angle of the shaft as a function of the angle sent: a fixed curve, or the same angle.
        pub steering_map: Option<SteeringMap> = None;
        /// Constant angle that is added to the wheels after map and play [rad].
        pub steering_offset_rad: Option<f64> = None, -0.1..=0.1;
        /// Fraction by which the radius of the left wheels is smaller; negative for the right ones. The robot pulls to that
        /// side, and its wheels turn more per way by half the fraction, which encoders count.
        pub wheel_smaller: Option<f64> = None, -0.1..=0.1;
        /// Fraction of the turning of the wheels that is lost as slip on slippery ground: encoders count it, the body does not
        /// move by it.
        pub slip_share: f64 = 0.0, 0.0..=0.9;
        /// Where slippery ground begins, along x [m].
        pub slip_at_m: f64 = 0.0, -1e4..=1e4;
        /// Length of the slippery ground along x; it is as wide as the track [m].
        pub slip_length_m: f64 = 0.0, 0.0..=1e4;
        /// Deceleration while the wheels are blocked, at most what the friction of the tyres allows [m/s^2].
        pub blocked_deceleration_mps2: Option<f64> = None, 0.1..=50.0;
        /// Time constant with which the velocity follows; 0 for at once, without a limit of the acceleration [s].
        pub velocity_lag_s: Option<f64> = None, 0.0..=2.0;
        /// Largest acceleration of the drive, if it has a lag [m/s^2].
        pub acceleration_max_mps2: Option<f64> = None, 0.05..=100.0;
        /// Largest deceleration of the drive with turning wheels, if it has a lag [m/s^2].
        pub deceleration_max_mps2: Option<f64> = None, 0.05..=100.0;
        /// Time constant with which the steering angle follows; 0 for at once, without a limit of the rate [s].
        pub steering_lag_s: Option<f64> = None, 0.0..=2.0;
        /// Largest rate of the steering angle, if it has a lag [rad/s].
        pub steering_rate_max_radps: Option<f64> = None, 0.01..=100.0;
        /// Shortest time from the actuator to the wheels [s].
        pub command_delay_s: Option<f64> = None, 0.0..=0.5;
        /// Mean of the random time on top of it, which is distributed exponentially [s].
        pub command_jitter_s: Option<f64> = None, 0.0..=0.5;
        /// Probability that an actuation never reaches the robot.
        pub command_loss: Option<f64> = None, 0.0..=1.0;
        /// What the odometry is measured with: `source` knows the true speed and heading, `encoders` are wheel encoders
        /// and a gyro, whose error accumulates.
        pub odometry_model: Option<OdometryModel> = None;
        /// Odometry scale error: fraction of the travelled distance that is not reported, df.
        pub odometry_longitudinal: Option<f64> = None, -0.5..=0.5;
        /// Growth of the lateral odometry error, dds of (7.38) [1/s].
        pub odometry_lateral_rate: Option<f64> = None, -1.0..=1.0;
        /// When the lateral odometry error grows: while the robot moves, or with time, also at standstill.
        pub odometry_drift: DriftGrowth = DriftGrowth::Moving;
        /// Error of the reported yaw from `odometry_jump_s` on [rad].
        pub odometry_jump_rad: f64 = 0.0, -PI..=PI;
        /// Time at which the reported yaw jumps [s].
        pub odometry_jump_s: f64 = 0.0, 0.0..=1e6;
        /// Time at which somebody pushes the robot aside, or lifts it and puts it down, whether it stands or drives; 0 for
        /// never [s].
        pub pushed_s: f64 = 0.0, 0.0..=1e6;
        /// How far it is pushed to its left; no encoder counts that [m].
        pub pushed_left_m: f64 = 0.0, -10.0..=10.0;
        /// How far it is turned meanwhile; a gyro measures that [rad].
        pub pushed_yaw_rad: f64 = 0.0, -PI..=PI;
        /// Slip of the wheel encoders: standard deviation of the measured distance after one metre [m].
        pub encoder_slip_m: Option<f64> = None, 0.0..=1.0;
        /// White noise of the gyro: standard deviation of the integrated yaw after one second [rad].
        pub gyro_noise_rad: Option<f64> = None, 0.0..=1.0;
        /// Random walk of the gyro's bias: standard deviation after one second [rad/s].
        pub gyro_bias_walk_radps: Option<f64> = None, 0.0..=1.0;
        /// Turn-on bias of the gyro: what it measures at rest from the start on [rad/s].
        pub gyro_bias_radps: Option<f64> = None, -0.1..=0.1;
        /// Scale error of the gyro: fraction by which a measured turn is larger than the true one.
        pub gyro_scale: Option<f64> = None, -0.1..=0.1;
        /// Standard deviation of the error of a scan's time stamp [s].
        pub scan_stamp_jitter_s: Option<f64> = None, 0.0..=1.0;
        /// One scan in this many is missing, at random: it is published without ranges; 0 for none.
        pub scan_missing_every: Option<u64> = None, 0.0..=1e9;
        /// Position of the scanner ahead of the robot's centre [m].
        pub scanner_x_m: Option<f64> = None, -2.0..=2.0;
        /// Position of the scanner to the left of the robot's centre [m].
        pub scanner_y_m: Option<f64> = None, -2.0..=2.0;
        /// Direction of the scanner's front beam, counter-clockwise from straight ahead [rad].
        pub scanner_yaw_rad: Option<f64> = None, -SCANNER_YAW_MAX_RAD..=SCANNER_YAW_MAX_RAD;
        /// What the scanner really measures: what `[vehicle.scanner]` states, but for the keys given here.
        pub scanner: RobotScanner = RobotScanner::default();
    }
}

settings! {
    /// The true scanner.
    #[derive(Copy)]
    pub struct RobotScanner {
        /// Number of beams of a sweep.
        pub beams: Option<usize> = None, "as `vehicle.scanner.beams`";
        /// Angle from one beam to the next [rad].
        pub increment_rad: Option<f64> = None, "as `vehicle.scanner.increment_rad`";
        /// Angle of the first beam from the scanner's front, counter-clockwise [rad].
        pub first_rad: Option<f64> = None, "as `vehicle.scanner.first_rad`";
        /// Largest distance that is measured [m].
        pub range_m: Option<f64> = None, "as `vehicle.scanner.range_m`";
        /// Smallest distance that is measured [m].
        pub min_range_m: Option<f64> = None, "as `vehicle.scanner.min_range_m`";
        /// Share of the scan period that the sweep over all beams takes.
        pub sweep_share: Option<f64> = None, "as `vehicle.scanner.sweep_share`";
    }
}

impl RobotScanner {
    /// What is given, and the rest as described.
    #[must_use]
    pub fn or(&self, described: &ScannerDescription) -> ScannerDescription {
        ScannerDescription {
            beams: self.beams.unwrap_or(described.beams),
            increment_rad: self.increment_rad.unwrap_or(described.increment_rad),
            first_rad: self.first_rad.or(described.first_rad),
            range_m: self.range_m.unwrap_or(described.range_m),
            min_range_m: self.min_range_m.unwrap_or(described.min_range_m),
            sweep_share: self.sweep_share.unwrap_or(described.sweep_share),
        }
    }
}

impl From<ScannerDescription> for RobotScanner {
    fn from(scanner: ScannerDescription) -> Self {
        Self {
            beams: Some(scanner.beams),
            increment_rad: Some(scanner.increment_rad),
            first_rad: scanner.first_rad,
            range_m: Some(scanner.range_m),
            min_range_m: Some(scanner.min_range_m),
            sweep_share: Some(scanner.sweep_share),
        }
    }
}

settings! {
    /// Noise of scanner and odometer; standard deviations unless stated otherwise.
    #[derive(Copy)]
    pub struct Noise {
        /// Noise of a range at any distance [m].
        pub range_m: f64 = 0.01, 0.0..=1.0;
        /// Noise of a range as a fraction of the range; the larger of `range_m` and this acts.
        pub range_share: f64 = 0.0, 0.0..=0.5;
        /// Probability that a beam gives no return.
        pub dropout: f64 = 0.0, 0.0..=1.0;
        /// Probability that a beam across an edge mixes both distances.
        pub mixed_pixels: f64 = 0.0, 0.0..=1.0;
        /// White noise of the reported x and y; it does not accumulate [m].
        pub odometry_m: f64 = 0.0, 0.0..=10.0;
        /// White noise of the reported yaw; it does not accumulate [rad].
        pub odometry_rad: f64 = 0.0, 0.0..=1.0;
    }
}
