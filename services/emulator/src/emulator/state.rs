//! The whole state of the robot and its surroundings as plain bytes, from which a successor continues.
//!
//! Random numbers need no state: each scan starts its own streams. Past poses need none before the next sweep
//! begins, which is a third of a period after the last sweep was complete. From then on there is no state to hand over;
//! so there is none while scans are later than that.

use nalgebra::Vector2;
use shared_types::{Fault, Flag, MAX_BEAMS, finite, plain_state};
use vehicle::State;

use super::{Emulator, MAX_AHEAD_NS, Travellings, history_ns, node};
use crate::history::History;
use crate::odometer::Reported;

/// Largest number of obstacles that appear when the robot comes near; a scene with more has no state to hand over.
pub const APPEARING: usize = 512;

/// Marks an obstacle that has not appeared yet, in place of the time at which it did [s].
const WAITS_S: f64 = -1.0;

plain_state! {
    /// All that an [`Emulator`] of a scenario remembers.
    pub struct EmulatorState {
        /// The time reached, since the start of the run [ns]
        pub clock_ns: u64,
        /// The time that the plant has reached [ns]
        pub plant_ns: u64,
        /// When the last actuation arrived [ns]
        pub last_actuation_ns: u64,
        /// Actuations that have not arrived yet
        pub travelling: Travellings,
        /// State of the model: sideslip, yaw, yaw rate, x, y [rad, rad, rad/s, m, m]
        pub motion: [f64; 5],
        /// Speed over ground [m/s]
        pub speed_mps: f64,
        /// Steering angle of the wheels [rad]
        pub steering_rad: f64,
        /// Speed that the drive is to reach [m/s]
        pub target_speed_mps: f64,
        /// Angle of the wheels that the shaft asks for, without the offset [rad]
        pub target_steering_rad: f64,
        /// 1 while the wheels are blocked
        pub blocked: Flag,
        /// 1 when it has run into something
        pub wrecked: Flag,
        /// Lateral drift of the odometer per distance
        pub odometry_lateral: f64,
        /// Position that the odometer reports, without noise [m]
        pub odometry_m: [f64; 2],
        /// Yaw that the odometer reports, without noise; it counts full turns [rad]
        pub odometry_yaw: f64,
        /// What the bias of the gyro has walked since the start [rad/s]
        pub gyro_bias_radps: f64,
        /// Distance that the wheels have measured, before it is counted in pulses [m]
        pub wheels_m: f64,
        /// Distance counted by the encoders at the last report [m]
        pub reported_encoder_m: f64,
        /// Position and yaw reported last, noise included [m, m, rad]
        pub reported: [f64; 3],
        /// Time of that report [ns]
        pub reported_ns: u64,
        /// 1 once there was a report
        pub has_reported: u64,
        /// Smallest clearance since the start [m]
        pub min_clearance_m: f64,
        /// Way driven since the start [m]
        pub path_length_m: f64,
        /// Largest lateral offset since the start [m]
        pub max_abs_lateral_m: f64,
        /// Longest time that the wheels turned without a new actuation [ns]
        pub longest_blind_ns: u64,
        /// 1 when the body has touched something while the wheels turned
        pub collided: Flag,
        /// 1 when something has touched the standing body
        pub struck: Flag,
        /// 1 when the dead-man has blocked the wheels
        pub dead_man: Flag,
        /// How many of `appeared_s` are used
        pub appearing: u32,
        /// Actuations refused since the start
        pub refused: u64,
        /// Plant steps since the start
        pub steps: u64,
        /// Scan that the last actuation answered
        pub actuation_scan: u64,
        /// When obstacles that wait for the robot have appeared; -1 for those that still wait [s]
        pub appeared_s: [f64; APPEARING],
        /// Ranges that a stuck scanner repeats, at most 65.535 m [mm]
        pub repeated_mm: [u16; MAX_BEAMS],
        /// 1 while the scanner repeats them
        pub repeats: Flag,
        /// Unused, zero
        pub reserved: u32,
    }
}

impl Emulator {
    /// All that another emulator of the same scenario needs to continue after the scan `last_scan`.
    ///
    /// `None` when the next sweep may have begun, or when too many obstacles wait for the robot.
    pub fn state(&self, last_scan: u64) -> Option<EmulatorState> {
        let Self { plant, reckoning, .. } = self;
        let next_sweep_ns = self.schedule.complete_ns(last_scan + 1).saturating_sub(self.sweep_ns());
        let appearing = self.scene.appearances().count();
        if self.state.clock_ns > next_sweep_ns || appearing > APPEARING {
            return None;
        }
        let mut appeared_s = [WAITS_S; APPEARING];
        for (slot, appears_s) in appeared_s.iter_mut().zip(self.scene.appearances()) {
            *slot = appears_s.unwrap_or(WAITS_S);
        }
        let State { sideslip, yaw, yaw_rate, x, y } = *plant.state();
        let last = self.odometer.last;
        Some(EmulatorState {
            motion: [sideslip, yaw, yaw_rate, x, y],
            speed_mps: plant.speed(),
            steering_rad: plant.steering(),
            target_speed_mps: plant.target_speed,
            target_steering_rad: plant.target_steering,
            blocked: plant.is_blocked().into(),
            wrecked: plant.wrecked.into(),
            odometry_lateral: reckoning.lateral,
            odometry_m: reckoning.reported().into(),
            odometry_yaw: reckoning.yaw,
            gyro_bias_radps: reckoning.bias,
            wheels_m: reckoning.wheels_m,
            reported_encoder_m: last.map_or(0.0, |last| last.encoder_m),
            reported: last.map_or([0.0; 3], |last| [last.x, last.y, last.yaw]),
            reported_ns: last.map_or(0, |last| last.time_ns),
            has_reported: u64::from(last.is_some()),
            appearing: appearing as u32,
            appeared_s,
            repeated_mm: self.laser.repeated().map_or([0; MAX_BEAMS], |ranges| {
                ranges.map(|range| u16::try_from(range).unwrap_or(u16::MAX))
            }),
            repeats: self.laser.repeated().is_some().into(),
            ..self.state
        })
    }

    /// Continues from the state of another emulator of the same scenario.
    ///
    /// # Errors
    /// [`Fault`] when a number is impossible, or the state is of another scene; the emulator is unchanged then.
    pub fn resume(&mut self, state: &EmulatorState) -> Result<(), Fault> {
        state.check()?;
        if state.appearing as usize != self.scene.appearances().count() {
            return Err(Fault::OutOfRange { field: "appearing", value: f64::from(state.appearing) });
        }
        let [sideslip, yaw, yaw_rate, x, y] = state.motion;
        self.state = *state;
        let plant = &mut self.plant;
        plant.state = State { sideslip, yaw, yaw_rate, x, y };
        // Where the course comes by again, the lateral position is the same at each of its places here.
        self.along_m = self.scenario.course.as_ref().map_or(self.along_m, |course| course.find(&plant.state));
        (plant.speed, plant.steering) = (state.speed_mps, state.steering_rad);
        (plant.target_speed, plant.target_steering) = (state.target_speed_mps, state.target_steering_rad);
        (plant.blocked, plant.wrecked) = (state.blocked.is_set(), state.wrecked.is_set());
        self.reckoning.lateral = state.odometry_lateral;
        self.reckoning.reported = Vector2::from(state.odometry_m);
        self.reckoning.yaw = state.odometry_yaw;
        self.reckoning.bias = state.gyro_bias_radps;
        self.reckoning.wheels_m = state.wheels_m;
        let [x, y, yaw] = state.reported;
        let last = Reported { time_ns: state.reported_ns, x, y, yaw, encoder_m: state.reported_encoder_m };
        self.odometer.last = (state.has_reported == 1).then_some(last);
        let appeared = state.appeared_s.iter().map(|appeared_s| (*appeared_s >= 0.0).then_some(*appeared_s));
        self.scene.set_appearances(appeared);
        self.laser.repeat(state.repeats.is_set().then(|| state.repeated_mm.map(u32::from)));
        let keep_ns = history_ns(&self.scenario, self.period_ns);
        self.history = History::new(node(state.plant_ns, &self.plant, &self.reckoning), keep_ns);
        Ok(())
    }
}

impl EmulatorState {
    /// Passes when all numbers are finite and times in order.
    fn check(&self) -> Result<(), Fault> {
        let numbers = [
            ("motion", &self.motion[..]),
            ("speed_mps", &[self.speed_mps]),
            ("steering_rad", &[self.steering_rad]),
            ("target_speed_mps", &[self.target_speed_mps]),
            ("target_steering_rad", &[self.target_steering_rad]),
            ("odometry_yaw", &[self.odometry_yaw]),
            ("gyro_bias_radps", &[self.gyro_bias_radps]),
            ("wheels_m", &[self.wheels_m]),
            ("reported_encoder_m", &[self.reported_encoder_m]),
            ("odometry_lateral", &[self.odometry_lateral]),
            ("odometry_m", &self.odometry_m),
            ("reported", &self.reported),
            ("min_clearance_m", &[self.min_clearance_m]),
            ("path_length_m", &[self.path_length_m]),
            ("max_abs_lateral_m", &[self.max_abs_lateral_m]),
            ("appeared_s", &self.appeared_s),
        ];
        numbers.into_iter().try_for_each(|(field, values)| finite(field, values))?;
        self.travelling.check()?;
        // The plant is never further behind than a step.
        if self.plant_ns > self.clock_ns || self.clock_ns - self.plant_ns > MAX_AHEAD_NS {
            return Err(Fault::OutOfRange { field: "plant_ns", value: self.plant_ns as f64 });
        }
        if self.last_actuation_ns > self.clock_ns {
            return Err(Fault::OutOfRange {
                field: "last_actuation_ns",
                value: self.last_actuation_ns as f64,
            });
        }
        Ok(())
    }
}
