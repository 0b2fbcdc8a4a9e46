//! One odometry sample in, one pose out.
//!
//! The order of a step: replace its yaw by that of the gyro, if there is one, correct the measurement, predict the estimate to the time of the sample under the controls
//! that were in force, compare, update, and predict to the time at which the command for this scan will act.
//!
//! Assumptions: stamps are of one clock; the robot starts at the pose it reports first. Time between samples is
//! measured from their stamps, so lost samples only make a prediction longer. Samples that are not newer than the
//! estimate give no pose. A sample that does not fit (its NIS is beyond 99.9 % of the chi-squared distribution) is not
//! used. The estimate restarts from the measurement
//!
//! * after several such samples in a row, because then the estimate is wrong;
//! * after a longer gap;
//! * after an outage, in which the actuator blocked the wheels by itself, if the robot can have driven there: it may not
//!   have received the block;
//! * with another sample that does not fit, if the robot can have driven there and it is not known what its wheels were
//!   told: samples were lost or came late, or there was no actuation.
//!
//! Where the model makes a pose that no robot can have, as of a description that is unstable, the pose is not published: the
//! estimate restarts from the measurement, with the alarm to stop, which stays.
//!
//! Samples of the last two kinds are no evidence against the calibration, whatever lost or delayed them.

use std::f64::consts::TAU;
use std::hint::black_box;

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use shared_types::{Actuation, Alarm, Fault, Header, MAX_LATE, Odometry, Pose, Role, Scan, Suspect, finite};
use vehicle::bounds::ANY_SENT_VELOCITY_MAX_MPS;
use vehicle::frame::wrap_angle;
use vehicle::{Invalid, SIDEWAYS_RAD};

use crate::config::SCALED_NOISE;
use crate::correction::{CorrectionState, Planar, STANDSTILL_MPS};
use crate::dead_reckoning::{DeadReckoning, OdometryStep};
use crate::ekf::{Ekf, Innovation, NotPositive};
use crate::gyro::{GyroSample, Interval, MAX_BIAS_RADPS};
use crate::increments::{self, Increments};
use crate::laser::key::is_poor;
use crate::laser::known::given;
use crate::laser::pieces::SweepMotion;
use crate::laser::surface::SurfaceMap;
use crate::laser::{LaserMode, Matcher};
use crate::learned::{Learned, SeenTurn};
use crate::motion::{MotionModel, MotionState, Moved, curvature_per_angle};
use crate::observability::motion_jacobian;
use crate::self_check::{Evidence, SelfCheckState};
use crate::{EstimatorConfig, EstimatorState, FilterSettings};

/// Positions beyond this are no measurement [m]: every track lies within 10 km of the origin, and a reported position may
/// have drifted as far again.
const FARTHEST_M: f64 = 2e4;

/// Yaw beyond this is no measurement [rad]: it may count full turns, of which a drive along a track has few.
const MAX_TURNED_RAD: f64 = 1e3;

/// Largest yaw rate that is believed [rad/s]: that of the widest bounds that may be described.
const YAW_RATE_MAX_RADPS: f64 = 100.0;

/// What is learned of the distance contradicts the odometer beyond so many of the standard deviations that are stated.
const BEYOND_STATED: f64 = 6.0;

/// Longest prediction ahead [ns]: commands for older scans are not driven.
const MAX_AHEAD_NS: u64 = 1_000_000_000;

/// 99.9 % quantiles of the chi-squared distribution with one, two and three degrees of freedom.
const GATE: [f64; 3] = [10.828, 13.816, 16.266];

/// Tolerance of the distance and the turn that a robot can have driven, in standard deviations of the measurement.
const REACH_SIGMA: f64 = 5.0;

/// How much sharper than by the geometry of its axles a robot may turn.
const SHARPER: f64 = 1.08;

/// Standard deviation of a number that is anywhere between two bounds, as share of their distance.
const UNIFORM: f64 = 0.289;

/// A sample is late when it comes this share of its interval later than usual: the actuation before it was late too, or
/// is the one for the scan before.
const LATE_SHARE: u64 = 2;

/// ... and by at least this [ns]. At fast rates stamps that jitter by 2 ms are a third of an interval off: without the samples
/// that are early by their stamps, whose intervals are short, the sum of the ways of the others would be too small.
const MIN_LATE_NS: u64 = 5_000_000;

/// Share by which the usual age of a sample follows the last one: scans that come late for seconds are usual.
const AGE_SHARE: u64 = 8;

/// The interval of Q in the settings [s].
const NOISE_INTERVAL_S: f64 = 0.1;

/// Weight of the newest sample in the mean of the NIS.
const MISFIT_WEIGHT: f64 = 0.05;

/// Smallest factor on the covariance.
const MIN_MISFIT: f64 = 0.2;

/// Estimates pose and motion from odometry and actuations.
#[derive(Debug, Clone)]
pub struct Estimator {
    settings: FilterSettings,
    state: EstimatorState,
    matcher: Matcher,
    /// Why the content of the last sample can't be used.
    refusal: Option<Fault>,
}

/// The motion by the model, and the standard deviation of its turn [rad].
#[derive(Debug, Clone, Copy)]
struct Expected {
    moved: increments::Increment,
    yaw_rad: f64,
}

/// The measurement update in terms of (yaw, x, y), whichever of them is measured.
#[derive(Debug, Clone, Copy, Default)]
struct Update {
    innovation: Vector3<f64>,
    gain: Matrix3<f64>,
    nis: f64,
}

impl Estimator {
    /// An estimator without an estimate: the first odometry sample initialises it.
    ///
    /// # Errors
    /// [`Invalid`] when a setting is outside its range or the measured states do not determine the state.
    pub fn new(config: &EstimatorConfig) -> Result<Self, Invalid> {
        let settings = config.settings()?;
        let given = given(&config.surfaces, config.map_deviation_m, config.surface_deviation_m);
        let matcher = Matcher::new(settings.laser, config.track, &config.vehicle)
            .with_map(given)
            .with_odometer(&settings.dead_reckoning);
        Ok(Self { settings, state: EstimatorState::default(), matcher, refusal: None })
    }

    /// The pose at the time of an odometry sample, and predicted to `now_ns` plus the expected latency.
    ///
    /// `realised` is the newest actuation; without a new one, the same as before or none. Identity and stamps in the
    /// header of the pose are those of the odometry, to be completed when it is published. `None` for a sample that is
    /// not newer than the estimate, or whose content cannot be used.
    pub fn step(&mut self, odometry: &Odometry, realised: Option<&Actuation>, now_ns: u64) -> Option<Pose> {
        if let Some(actuation) = realised {
            self.note(actuation, now_ns);
        }
        let usable = usable(odometry);
        self.refusal = usable.err();
        let usable = usable.ok().filter(|_| odometry.header.acquired_ns <= latest(now_ns));
        let Some(mut reported) = usable else {
            self.state.invalid += 1;
            return None;
        };
        if !self.is_newer(odometry) {
            self.state.skipped += 1;
            return None;
        }
        let acquired_ns = odometry.header.acquired_ns;
        let speed = self.speed(odometry);
        let (from, from_mps) = (self.state.estimate, self.state.motion.speed_mps);
        let age_ns = now_ns.saturating_sub(acquired_ns);
        let update = if self.state.initialised.is_set() {
            let interval_ns = acquired_ns - self.state.acquired_ns;
            let dt = interval_ns as f64 * 1e-9;
            let (is_known, is_cut) = (self.is_known(&odometry.header, age_ns, interval_ns), self.is_cut());
            self.note_age(age_ns, interval_ns);
            let interval = self.interval(odometry, speed, dt);
            reported = self.state.gyro.replace(reported, &interval);
            // The speeds at both ends tell nothing about the way between them when the robot may have braked.
            let reverses = self.state.motion.slowest(self.state.acquired_ns) < 0.0;
            let way_m = is_cut.then(|| self.state.correction.way_m(reported, reverses));
            let measured = self.state.correction.correct(&self.settings.drift, reported, speed, dt, way_m);
            let before = self.state;
            let can_be_there = self.is_in_reach(measured, speed, dt);
            let (mut update, mut expected) = (None, None);
            let before_mps = self.state.motion.expected_mps;
            if dt <= self.settings.max_gap_s && !(is_cut && can_be_there && self.settings.gate) {
                expected = Some(self.predict(odometry, dt));
                update = Some(self.update_and_check(measured, odometry, dt, is_known.then_some(before_mps)));
                if !is_known && can_be_there && self.state.rejected > before.rejected {
                    // Undo the comparison: the misfit is explained, so it is no evidence against the calibration.
                    (self.state, update) = (before, None);
                }
            }
            let update = update.unwrap_or_else(|| {
                self.restart(measured, odometry);
                self.state.misfit = before.misfit;
                Update::default()
            });
            if self.settings.is_increments {
                let is_refused = self.state.rejected > before.rejected;
                let expected = expected.filter(|_| self.state.restarts == before.restarts);
                self.learn(measured, odometry, expected.filter(|_| is_known), from_mps, dt);
                let expected = expected.map(|expected| expected.moved);
                let from = self.state.reckoning.pose;
                let measured = if self.settings.yaw_is_measured { measured } else { self.filtered() };
                let beside_m = self.follow((!is_refused).then_some(measured), measured, expected, dt);
                self.drift(from, self.state.reckoning.pose, from_mps, dt, is_cut, beside_m);
            } else {
                self.drift(from, self.state.estimate, from_mps, dt, is_cut, 0.0);
            }
            update
        } else {
            self.state.gyro.begin(odometry.header.scan_id, reported);
            self.state.correction = CorrectionState::begin(reported, speed);
            self.state.usual_age_ns = age_ns;
            self.begin(reported, odometry);
            self.state.increments = Increments::begin(reported, self.settings.measurement_noise);
            if self.settings.is_increments {
                self.state.learned = Learned::begin(reported.yaw, self.settings.measurement_noise[0]);
                self.start(&Matrix3::zeros());
            }
            Update::default()
        };
        self.state.initialised = true.into();
        self.state.incarnation = odometry.header.incarnation;
        self.state.sequence = odometry.header.sequence;
        self.state.acquired_ns = acquired_ns;
        let pose = self.pose(odometry, &update, now_ns);
        if is_possible(&pose) { Some(pose) } else { self.refuse(reported, odometry, now_ns) }
    }

    /// The pose instead of an impossible one, which is counted: the one reported, without motion to the side, and the alarm
    /// that stops the robot for good. What the model makes of the vehicle description can't be driven by.
    fn refuse(&mut self, reported: Planar, odometry: &Odometry, now_ns: u64) -> Option<Pose> {
        self.state.invalid += 1;
        self.state.rejected += 1;
        self.restart(reported, odometry);
        (self.state.motion.sideslip_rad, self.state.motion.yaw_rate_radps) = (0.0, 0.0);
        let check = &mut self.state.self_check;
        (check.suspect, check.alarm) = (Suspect::Vehicle.wire(), Alarm::Stop.wire());
        let pose = self.pose(odometry, &Update::default(), now_ns);
        let pose = Pose {
            predicted_sideslip_rad: pose.sideslip_rad,
            predicted_yaw_rad: pose.yaw_rad,
            predicted_yaw_rate_radps: pose.yaw_rate_radps,
            predicted_x_m: pose.x_m,
            predicted_y_m: pose.y_m,
            predicted_speed_mps: pose.speed_mps,
            ..pose
        };
        is_possible(&pose).then_some(pose)
    }

    /// Makes the next step faster: does it on the sample that is expected `period_ns` after `last`, and puts the state
    /// back. What follows gives the same bits as without.
    pub fn rehearse(&mut self, last: &Odometry, period_ns: u64, now_ns: u64) {
        let before = self.state;
        let expected = Odometry {
            header: last.header.next(period_ns),
            x_m: last.x_m + last.dx_m,
            y_m: last.y_m + last.dy_m,
            yaw_rad: last.yaw_rad + last.dyaw_rad,
            ..*last
        };
        black_box(self.step(&expected, None, now_ns));
        self.state = before;
    }

    /// Remembers an actuation for later steps; several may be noted between two steps, in order.
    ///
    /// One that is stamped more than a second ahead of `now_ns` is ignored: it would exclude all that follow.
    pub fn note(&mut self, actuation: &Actuation, now_ns: u64) {
        let published_ns = actuation.header.stage(Role::Actuator).published_ns;
        let sent_ns = published_ns.max(actuation.header.acquired_ns);
        if sent_ns <= latest(now_ns) {
            self.state.actuated_ns = self.state.actuated_ns.max(sent_ns);
            if actuation.answers == 0 && !actuation.drives() {
                self.state.own_block_ns =
                    self.state.own_block_ns.max(sent_ns.saturating_add(self.settings.motion.delay_ns));
            }
            self.state.motion.note(&self.settings.motion, actuation);
        }
    }

    /// Remembers a sample of the gyro for the step of its scan.
    pub fn note_gyro(&mut self, sample: GyroSample) {
        self.state.gyro.note(sample);
    }

    /// Turns of the odometry that the gyro has not replaced, by [`crate::gyro::GyroFault::ALL`].
    pub fn kept_turns(&self) -> [u64; 4] {
        self.state.gyro.kept
    }

    /// Why the content of the last odometry sample can't be used.
    pub fn refusal(&self) -> Option<&Fault> {
        self.refusal.as_ref()
    }

    /// What a restarted estimator resumes from.
    pub fn state(&self) -> EstimatorState {
        self.state
    }

    /// Continues from the state of another estimator.
    ///
    /// # Errors
    /// [`Fault`] when the state is not usable; the estimator is unchanged then.
    pub fn resume(&mut self, state: &EstimatorState) -> Result<(), Fault> {
        state.check()?;
        self.state = *state;
        Ok(())
    }

    /// Whether a sample is newer than the estimate.
    pub fn is_newer(&self, odometry: &Odometry) -> bool {
        let header = &odometry.header;
        let same_producer = header.incarnation == self.state.incarnation && header.sequence != 0;
        // One far below shows that the last number was wrong: its reader has dropped what is only late.
        let is_late =
            header.sequence <= self.state.sequence && self.state.sequence - header.sequence <= MAX_LATE;
        !self.state.initialised.is_set()
            || (header.acquired_ns > self.state.acquired_ns && !(same_producer && is_late))
    }

    /// Whether samples between the last one used and this one are missing.
    fn follows_gap(&self, header: &Header) -> bool {
        header.incarnation == self.state.incarnation
            && header.sequence > self.state.sequence.saturating_add(1)
    }

    /// Whether it is known what the wheels were told since the last sample: no sample is missing or late, and there was an
    /// actuation, which the robot received.
    fn is_known(&self, header: &Header, age_ns: u64, interval_ns: u64) -> bool {
        let late_ns = (interval_ns / LATE_SHARE).max(MIN_LATE_NS);
        let is_late = age_ns > self.state.usual_age_ns.saturating_add(late_ns);
        let motion = &self.state.motion;
        let was_told = self.state.actuated_ns >= self.state.acquired_ns || motion.controls().is_empty();
        let was_told = was_told && motion.remembers(self.state.acquired_ns);
        was_told && !self.is_cut() && !is_late && !self.follows_gap(header)
    }

    /// Whether the actuator blocked the wheels by itself since the last sample: it had no commands because no data came. So
    /// the robot may not have received the block either, and followed the command before until its own watchdog acted.
    fn is_cut(&self) -> bool {
        self.state.own_block_ns > self.state.acquired_ns
    }

    /// Follows the time that samples usually take to come: the mean, to which one sample that is very late adds little.
    ///
    /// Not the shortest time: with stamps that jitter, most samples come later than that, and the ways of those that do not
    /// would be missing in a sum in which the errors of the stamps cancel.
    fn note_age(&mut self, age_ns: u64, interval_ns: u64) {
        let usual_ns = self.state.usual_age_ns;
        let limit_ns = interval_ns / LATE_SHARE;
        self.state.usual_age_ns = if age_ns > usual_ns {
            usual_ns + (age_ns - usual_ns).min(limit_ns) / AGE_SHARE
        } else {
            usual_ns - (usual_ns - age_ns) / AGE_SHARE
        };
    }

    /// What is known of the time since the last sample, for the gyro.
    fn interval(&self, odometry: &Odometry, speed: f64, dt_s: f64) -> Interval {
        let motion = &self.state.motion;
        let blocks = |at_ns| motion.in_force(at_ns).is_none_or(|control| control.drives == 0);
        let is_blocked = blocks(self.state.acquired_ns) && blocks(odometry.header.acquired_ns);
        Interval {
            scan_id: odometry.header.scan_id,
            dt_s,
            limit_radps: self.fastest(speed) * self.sharpest() + MAX_BIAS_RADPS,
            is_blocked: is_blocked && speed.abs().max(motion.speed_mps.abs()) <= STANDSTILL_MPS,
        }
    }

    /// The measured speed, or without a plausible one the estimated speed [m/s].
    fn speed(&self, odometry: &Odometry) -> f64 {
        let motion = &self.state.motion;
        motion
            .plausible_speed(&self.settings.motion, self.state.acquired_ns, odometry.speed_mps)
            .unwrap_or(motion.speed_mps)
    }

    /// The largest of the last speed, the measured one, and those sent, in either direction [m/s].
    fn fastest(&self, speed: f64) -> f64 {
        let motion = &self.state.motion;
        let driven = motion.speed_mps.abs().max(speed.abs());
        motion.controls().iter().fold(driven, |most, sent| most.max(sent.velocity_mps.abs()))
    }

    /// Largest turn of the robot per distance [rad/m].
    fn sharpest(&self) -> f64 {
        let MotionModel { parameters, bounds, .. } = &self.settings.motion;
        bounds.sent_steering_max_rad * SHARPER * parameters.yaw_rate_gain()
    }

    /// Whether the robot can have driven from the estimate to a place within `dt`: forwards unless it was told otherwise, and
    /// at most at the largest of its last speed, its measured speed and the speeds sent.
    fn is_in_reach(&self, place: Planar, speed: f64, dt: f64) -> bool {
        let (way_m, [yaw, x, y]) = (self.fastest(speed) * dt, self.state.estimate);
        let (dx, dy) = (place.x - x, place.y - y);
        let ahead_m = dx * yaw.cos() + dy * yaw.sin();
        let [yaw_margin, x_margin, y_margin] =
            self.settings.measurement_noise.map(|variance| REACH_SIGMA * variance.sqrt());
        let margin_m = x_margin.max(y_margin);
        let behind_m = if self.state.motion.slowest(self.state.acquired_ns) < 0.0 { way_m } else { 0.0 };
        ahead_m >= -behind_m - margin_m
            && dx.hypot(dy) <= way_m + margin_m
            && wrap_angle(place.yaw - yaw).abs() <= way_m * self.sharpest() + yaw_margin
    }

    fn begin(&mut self, measured: Planar, odometry: &Odometry) {
        self.state.estimate = [measured.yaw, measured.x, measured.y];
        let covariance = Matrix3::from_diagonal(&Vector3::from(self.settings.measurement_noise));
        self.state.covariance.copy_from_slice(covariance.as_slice());
        (self.state.rejected_in_a_row, self.state.misfit) = (0, 1.0);
        self.state.motion.begin(&self.settings.motion, odometry.header.acquired_ns, odometry.speed_mps);
    }

    fn restart(&mut self, measured: Planar, odometry: &Odometry) {
        self.begin(measured, odometry);
        self.state.learned.correct(1.0);
        self.state.restarts += 1;
    }

    /// Adds the drift of the odometry since the estimate before, [`crate::dead_reckoning`].
    ///
    /// Encoders do not count what locked wheels slide. In an outage it is not known how the robot braked, so it may have
    /// slid for all that it has lost of its speed.
    fn drift(
        &mut self,
        [yaw, x, y]: [f64; 3],
        [to_yaw, to_x, to_y]: [f64; 3],
        from_mps: f64,
        seconds: f64,
        is_cut: bool,
        beside_m: f64,
    ) {
        let (dx_m, dy_m, to_mps) = (to_x - x, to_y - y, self.state.motion.speed_mps);
        let lost = (from_mps * from_mps - to_mps * to_mps).max(0.0);
        let slid_m = UNIFORM * lost / (2.0 * self.settings.motion.blocked_deceleration_mps2);
        let step = OdometryStep {
            seconds: self.state.increments.turning_s(seconds),
            distance_m: if is_cut {
                dx_m.hypot(dy_m)
            } else {
                f64::midpoint(from_mps, to_mps).abs() * seconds
            },
            slid_m: if is_cut && self.settings.noise_turns { slid_m } else { 0.0 },
            beside_m,
            turn_rad: wrap_angle(to_yaw - yaw),
            dx_m,
            dy_m,
            yaw_rad: yaw + wrap_angle(to_yaw - yaw) / 2.0,
        };
        self.state.reckoning.grow(&self.settings.dead_reckoning, &step);
    }

    /// Time update (7.22), (7.23) from the last sample to this one. The process f of (7.14)-(7.19) is the motion of the robot.
    fn predict(&mut self, odometry: &Odometry, dt: f64) -> Expected {
        let mut filter = self.filter();
        let before = Planar { yaw: filter.state[0], x: filter.state[1], y: filter.state[2] };
        let (from_ns, to_ns) = (self.state.acquired_ns, odometry.header.acquired_ns);
        let model = self.model();
        let Moved { pose: after, ahead_m, yaw_rad } =
            self.state.motion.advance(&model, before, from_ns, to_ns, Some(odometry.speed_mps));
        let by_state = if self.settings.is_linear {
            Matrix3::identity()
        } else {
            motion_jacobian(after.x - before.x, after.y - before.y)
        };
        let by_noise = if self.settings.noise_turns {
            // Noise ahead and to the left of the robot, in the middle of its turn.
            let (sin, cos) = ((before.yaw + after.yaw) / 2.0).sin_cos();
            Matrix3::new(1.0, 0.0, 0.0, 0.0, cos, -sin, 0.0, sin, cos)
        } else {
            Matrix3::identity()
        };
        let mut noise = Vector3::from(self.settings.process_noise) * (dt / NOISE_INTERVAL_S);
        if self.settings.noise_turns {
            noise += Vector3::new(yaw_rad * yaw_rad, ahead_m * ahead_m, 0.0);
        }
        let odometer = &self.settings.dead_reckoning;
        if self.settings.is_increments && is_poor(odometer) {
            // The innovation compares with what it reports.
            let way_m = (after.x - before.x).hypot(after.y - before.y);
            noise += Vector3::new(odometer.yaw_rad.powi(2) * dt, odometer.slip_m.powi(2) * way_m, 0.0);
        }
        if self.settings.is_increments {
            // Odometers do not see tyres slip to the side, and the innovation compares with one.
            let slip = self.state.motion.slip_rad(&model.parameters);
            noise[2] += (slip * (after.x - before.x).hypot(after.y - before.y)).powi(2);
        }
        let predicted = Vector3::new(wrap_angle(after.yaw), after.x, after.y);
        filter.predict(predicted, &by_state, &by_noise, &Matrix3::from_diagonal(&noise));
        self.keep(&filter);
        let moved = increments::Increment::between(before, after);
        self.state
            .learned
            .predict(moved.turn_rad, curvature_per_angle(&self.settings.motion) * moved.ahead_m);
        Expected { moved, yaw_rad }
    }

    /// The model with what is learned of the robot.
    fn model(&self) -> MotionModel {
        MotionModel { learned: self.state.learned, ..self.settings.motion }
    }

    /// Learns from a report how the robot steers and drives, where it is known what its wheels were told.
    fn learn(
        &mut self,
        reported: Planar,
        odometry: &Odometry,
        expected: Option<Expected>,
        from_mps: f64,
        dt: f64,
    ) {
        let noise = (-self.state.increments.product[0]).max(0.0);
        let Some(Expected { moved, yaw_rad }) = expected else {
            return self.state.learned.restart(reported.yaw, noise);
        };
        let [rate, share, turn] = self.state.reckoning.unreported;
        let speed_mps = self.speed(odometry);
        let way_m = f64::midpoint(from_mps, speed_mps) * dt;
        let learned = &mut self.state.learned;
        learned.walk(way_m);
        learned.turned(&SeenTurn {
            yaw_rad: reported.yaw,
            expected_rad: moved.turn_rad * (1.0 - turn) - rate * dt,
            by_offset: curvature_per_angle(&self.settings.motion) * way_m,
            spread: self.settings.process_noise[0] * dt / NOISE_INTERVAL_S + yaw_rad * yaw_rad,
            noise,
        });
        let in_force = self.state.motion.in_force(odometry.header.acquired_ns);
        if let Some(control) = in_force.filter(|control| control.drives == 1) {
            let seen_mps = speed_mps * (1.0 + self.settings.drift.longitudinal + share);
            learned.driven(seen_mps, control.velocity_mps, self.state.motion.expected_mps);
        }
    }

    /// Dead reckoning begins where the odometer says, which has errors of this covariance.
    fn start(&mut self, covariance: &Matrix3<f64>) {
        let Increments { pose, .. } = self.state.increments;
        self.state.reckoning = DeadReckoning::begin(pose, covariance, &self.settings.dead_reckoning);
    }

    /// The noise of the odometer is known now. If it has some, the first report was a poor one, and so is all that was seen from
    /// there: dead reckoning begins anew. What is less than that is where all of it may be.
    fn begin_known(&mut self, last: &Increments) {
        let Increments { pose: [yaw, ..], .. } = self.state.increments;
        // The scans of a poor odometer have shown a better pose than its reports.
        if self.state.increments.is_clean() || self.matcher.has_keys() {
            self.state.reckoning.misplace(&self.state.increments.first(yaw));
        } else {
            self.start(&last.covariance(yaw));
            self.state.laser.map = SurfaceMap::default();
        }
    }

    /// The pose by the filter.
    fn filtered(&self) -> Planar {
        let [yaw, x, y] = self.state.estimate;
        Planar { yaw, x, y }
    }

    /// The pose follows the increments of the odometer, or those of the model where the report is not usable.
    ///
    /// Without a model, after a restart, it follows the report. Returns how far to the left the odometer did not see the robot
    /// slip, by the model [m].
    fn follow(
        &mut self,
        reported: Option<Planar>,
        measured: Planar,
        expected: Option<increments::Increment>,
        dt: f64,
    ) -> f64 {
        let increments = &mut self.state.increments;
        let last = *increments;
        let spread = self.settings.process_noise.map(|variance| variance * dt / NOISE_INTERVAL_S);
        let mut moved = match expected {
            Some(expected) => increments.follow(reported, &expected, spread),
            None => increments.restart(measured),
        };
        if !last.is_known() && (reported.is_some() || expected.is_none()) {
            // Most odometers have no noise: their reports are right from the first one on.
            moved = increments.since(last.reported);
        }
        increments.turn_radps = if dt > 0.0 { moved.turn_rad / dt } else { 0.0 };
        let turning_s = self.state.increments.turning_s(dt);
        let slip_m = self.state.motion.slip_rad(&self.settings.motion.parameters) * moved.ahead_m;
        let unseen_m = if expected.is_some() { self.state.increments.unseen_m(slip_m) } else { 0.0 };
        self.state.reckoning.advance(moved.turn_rad, moved.ahead_m, moved.left_m + unseen_m, turning_s);
        if self.state.increments.is_known() && self.settings.laser != LaserMode::Off {
            self.state.reckoning.shake(&self.state.increments.covariance(self.state.reckoning.pose[0]));
        }
        if self.state.increments.is_known() && !last.is_known() {
            self.begin_known(&last);
        }
        expected.map_or(0.0, |expected| expected.left_m - moved.left_m)
    }

    /// Whether scans correct its pose.
    pub fn sees(&self) -> bool {
        self.settings.laser != LaserMode::Off
    }

    /// How often each of [`crate::laser::EVENTS`] was.
    pub fn laser_events(&self) -> [u64; 6] {
        self.state.laser.events()
    }

    /// Corrects the pose by a scan of its time.
    ///
    /// A scan of another time is counted: the one before when the next pose was computed already.
    pub fn see(&mut self, scan: &Scan) {
        if self.settings.laser == LaserMode::Off {
            return;
        }
        if scan.header.acquired_ns != self.state.acquired_ns {
            self.state.laser.late += 1;
            return;
        }
        let motion = SweepMotion {
            speed_mps: self.state.motion.speed_mps,
            yaw_rate_radps: self.state.increments.turn_radps,
        };
        let EstimatorState { laser, reckoning, .. } = &mut self.state;
        self.matcher.see(scan, &motion, laser, reckoning);
        let [_, stated, _] = self.settings.dead_reckoning.unknown;
        // Ranges that are all too short seem to be an odometer that counts too much.
        let is_beyond = stated > 0.0 && reckoning.unreported[1].abs() > BEYOND_STATED * stated;
        laser.search.again += u64::from(is_beyond && laser.search.again == 0);
        if laser.search.again > 0 && self.settings.self_check {
            let check = &mut self.state.self_check;
            (check.suspect, check.alarm) = (Suspect::Position.wire(), Alarm::Stop.wire());
        }
    }

    /// Measurement update, followed by the check of the calibration; `before_mps` is the speed expected at the sample before, where
    /// it is known what the wheels were told since.
    fn update_and_check(
        &mut self,
        measured: Planar,
        odometry: &Odometry,
        dt_s: f64,
        before_mps: Option<f64>,
    ) -> Update {
        let is_known = before_mps.is_some();
        let (expected, refused, restarts) = (self.filter(), self.state.rejected, self.state.restarts);
        let apart = Vector3::new(self.state.learned.apart_rad, 0.0, 0.0);
        let update = self.update(measured, odometry);
        if self.state.rejected == refused {
            self.state.learned.correct(update.gain[(0, 0)]);
        }
        if self.settings.self_check {
            let acquired_ns = odometry.header.acquired_ns;
            if !is_known {
                // Nothing shows what the speed should be.
                self.state.motion.expected_mps = self.speed(odometry);
            }
            let plausible_mps = self.state.motion.plausible_speeds(&self.settings.motion, acquired_ns);
            // The longest interval of a piece is some times the shortest.
            let most_mps = 10.0 * plausible_mps[1];
            let speed_mps = odometry.speed_mps.clamp(-most_mps, most_mps);
            let in_force = self.state.motion.in_force(acquired_ns);
            let expected_mps = self.state.motion.expected_mps;
            let odometer = &self.settings.dead_reckoning;
            self.state.self_check.observe(&Evidence {
                acquired_ns,
                dt_s,
                speed_mps: if speed_mps.is_finite() { speed_mps } else { self.speed(odometry) },
                plausible_mps,
                desired_mps: in_force
                    .filter(|control| control.drives == 1 && is_known)
                    .map(|control| control.velocity_mps),
                expected_mps: [before_mps.unwrap_or(expected_mps), expected_mps],
                way_m: (self.settings.is_increments && is_known).then(|| self.way_m(measured)),
                slip_m: if is_poor(odometer) { odometer.slip_m } else { 0.0 },
                innovation: (self.settings.gate && is_known)
                    .then(|| self.normalised(&expected, &(update.innovation + apart))),
                refused: self.state.rejected > refused,
                restarted: self.state.restarts > restarts,
            });
        }
        update
    }

    /// Way ahead since the report before, and what noise of both may add to it [m].
    fn way_m(&self, measured: Planar) -> [f64; 2] {
        let Increments { reported: [yaw, x, y], product: [_, ahead, _], .. } = self.state.increments;
        let moved = increments::Increment::between(Planar { yaw, x, y }, measured);
        [moved.ahead_m, REACH_SIGMA * (-2.0 * ahead).max(0.0).sqrt()]
    }

    /// Innovation ahead, to the left and in yaw, in standard deviations of what was expected.
    fn normalised(&self, expected: &Ekf<3>, innovation: &Vector3<f64>) -> [f64; 3] {
        let (sin, cos) = expected.state[0].sin_cos();
        let noise = Matrix3::from_diagonal(&Vector3::from(self.settings.measurement_noise));
        let spread = expected.covariance + noise;
        let [yaw, ahead, left] = [[1.0, 0.0, 0.0], [0.0, cos, sin], [0.0, -sin, cos]].map(|direction| {
            let direction = Vector3::from(direction);
            direction.dot(innovation) / direction.dot(&(spread * direction)).sqrt()
        });
        [ahead, left, yaw]
    }

    /// Measurement update (7.24)-(7.26), unless the gate refuses the measurement.
    fn update(&mut self, measured: Planar, odometry: &Odometry) -> Update {
        let update = if self.settings.yaw_is_measured {
            self.update_with([0, 1, 2], measured)
        } else {
            self.update_with([1, 2], measured)
        };
        let finite = self.state.estimate.iter().chain(&self.state.covariance).all(|value| value.is_finite());
        match update {
            Ok((update, true)) if finite => {
                self.state.rejected_in_a_row = 0;
                update
            }
            Ok((update, false)) if finite => {
                self.state.rejected += 1;
                self.state.rejected_in_a_row += 1;
                if self.state.rejected_in_a_row >= self.settings.recover_after {
                    self.restart(measured, odometry);
                }
                update
            }
            _ => {
                self.restart(measured, odometry);
                Update::default()
            }
        }
    }

    /// The update with M of (yaw, x, y), and whether the measurement was used. The measurement h of (7.14)-(7.19) selects
    /// these states.
    fn update_with<const M: usize>(
        &mut self,
        indices: [usize; M],
        measured: Planar,
    ) -> Result<(Update, bool), NotPositive> {
        let mut filter = self.filter();
        let mut by_state = SMatrix::<f64, M, 3>::zeros();
        for (row, &index) in indices.iter().enumerate() {
            by_state[(row, index)] = 1.0;
        }
        let all = Vector3::new(measured.yaw, measured.x, measured.y);
        let noise = by_state * Vector3::from(self.settings.measurement_noise);
        let innovation: Innovation<3, M> = filter.compare(
            &(by_state * all),
            &(by_state * filter.state),
            &by_state,
            &SMatrix::<f64, M, M>::identity(),
            &SMatrix::<f64, M, M>::from_diagonal(&noise),
            |measured, expected| {
                let difference: SVector<f64, M> = measured - expected;
                SVector::from_fn(|row, _| {
                    if indices[row] == 0 { wrap_angle(difference[row]) } else { difference[row] }
                })
            },
        )?;
        let fits = !self.settings.gate || innovation.nis <= GATE[M - 1];
        if fits {
            filter.update(&innovation);
            filter.state[0] = wrap_angle(filter.state[0]);
            self.keep(&filter);
        }
        self.state.misfit += MISFIT_WEIGHT * (innovation.nis / M as f64 - self.state.misfit);
        let update = Update {
            innovation: by_state.transpose() * innovation.value,
            gain: innovation.gain * by_state,
            nis: innovation.nis,
        };
        Ok((update, fits))
    }

    fn pose(&self, odometry: &Odometry, update: &Update, now_ns: u64) -> Pose {
        let is_increments = self.settings.is_increments;
        let [yaw, x, y] = match (is_increments, self.state.increments.is_known()) {
            (true, true) => self.state.reckoning.pose,
            // As long as the odometer may be one with noise, it is filtered.
            (true, false) => self.state.increments.pose,
            (false, _) => self.state.estimate,
        };
        let motion: MotionState = self.state.motion;
        let acquired_ns = self.state.acquired_ns;
        let age_ns = now_ns.saturating_sub(acquired_ns).saturating_add(self.settings.lead_ns);
        let predicted_ns = acquired_ns.saturating_add(age_ns.min(MAX_AHEAD_NS));
        let mut ahead = motion;
        let predicted =
            ahead.advance(&self.model(), Planar { yaw, x, y }, acquired_ns, predicted_ns, None).pose;
        let local_covariance = self.local_covariance();
        let mut covariance = if is_increments {
            let noise = self.state.increments.covariance(yaw);
            noise.data.0.as_flattened().try_into().unwrap_or_default()
        } else if self.settings.noise_turns {
            local_covariance
        } else {
            self.state.covariance
        };
        let drift = self.state.reckoning.of_pose();
        covariance.iter_mut().zip(drift.as_slice()).for_each(|(sum, drift)| *sum += drift);
        let SelfCheckState { suspect, alarm, .. } = self.state.self_check;
        let is_sought = alarm == Alarm::None.wire() && self.state.laser.search.is_on();
        let mut gain = [0.0; 9];
        // Row by row, where the matrix is stored column by column.
        gain.copy_from_slice(update.gain.transpose().as_slice());
        Pose {
            header: odometry.header.answer(),
            yaw_rad: yaw,
            x_m: x,
            y_m: y,
            covariance,
            local_covariance,
            speed_mps: motion.speed_mps,
            sideslip_rad: motion.sideslip_rad,
            yaw_rate_radps: motion.yaw_rate_radps,
            predicted_ns,
            predicted_sideslip_rad: ahead.sideslip_rad,
            predicted_yaw_rad: wrap_angle(predicted.yaw),
            predicted_yaw_rate_radps: ahead.yaw_rate_radps,
            predicted_x_m: predicted.x,
            predicted_y_m: predicted.y,
            predicted_speed_mps: ahead.speed_mps,
            innovation: [update.innovation[0], update.innovation[1], update.innovation[2]],
            gain,
            nis: update.nis,
            rejected: self.state.rejected,
            learned: self.learned(),
            learned_deviation: self.learned_deviation(),
            suspect: if is_sought { Suspect::Position.wire() } else { suspect },
            alarm: if is_sought { Alarm::Slow.wire() } else { alarm },
        }
    }

    /// What is learned of the robot, by [`shared_types::LEARNED`]; without increments nothing.
    fn learned(&self) -> [f64; 6] {
        let EstimatorState { reckoning, learned, .. } = &self.state;
        let [rate, share, turn] = reckoning.unreported;
        let [offset_rad, turned] = learned.steering;
        let distance = self.settings.drift.longitudinal + share;
        let all = [rate, distance, turn, offset_rad, turned, learned.velocity];
        if self.settings.is_increments { all } else { [0.0; 6] }
    }

    /// The standard deviations of that.
    fn learned_deviation(&self) -> [f64; 6] {
        let EstimatorState { reckoning, learned, .. } = &self.state;
        let [rate, share, turn] = reckoning.deviations();
        let [offset_rad, turned, velocity] = learned.deviations();
        if self.settings.is_increments { [rate, share, turn, offset_rad, turned, velocity] } else { [0.0; 6] }
    }

    /// Covariance of the filter, scaled by how large its innovations really are (the variance of unit weight).
    ///
    /// The noise of profile `source` has no unit: its covariance is expressed in units in which the measurement has the noise
    /// of the scaled profile.
    fn local_covariance(&self) -> [f64; 9] {
        if self.settings.noise_turns {
            let factor = if self.settings.gate { self.state.misfit.max(MIN_MISFIT) } else { 1.0 };
            return self.state.covariance.map(|entry| entry * factor);
        }
        let unit = |index: usize| (SCALED_NOISE.1[index] / self.settings.measurement_noise[index]).sqrt();
        std::array::from_fn(|index| self.state.covariance[index] * unit(index / 3) * unit(index % 3))
    }

    fn filter(&self) -> Ekf<3> {
        Ekf {
            state: Vector3::from(self.state.estimate),
            covariance: Matrix3::from_column_slice(&self.state.covariance),
        }
    }

    fn keep(&mut self, filter: &Ekf<3>) {
        self.state.estimate.copy_from_slice(filter.state.as_slice());
        self.state.covariance.copy_from_slice(filter.covariance.as_slice());
    }
}

/// Latest plausible stamp [ns].
fn latest(now_ns: u64) -> u64 {
    now_ns.saturating_add(1_000_000_000)
}

/// The reported pose, if it is plausible.
fn usable(odometry: &Odometry) -> Result<Planar, Fault> {
    let Odometry { x_m, y_m, yaw_rad, .. } = *odometry;
    for (field, value, limit) in
        [("x_m", x_m, FARTHEST_M), ("y_m", y_m, FARTHEST_M), ("yaw_rad", yaw_rad, MAX_TURNED_RAD)]
    {
        finite(field, &[value])?;
        if value.abs() > limit {
            return Err(Fault::OutOfRange { field, value });
        }
    }
    Ok(Planar { yaw: wrap_angle(yaw_rad), x: x_m, y: y_m })
}

/// Whether a robot can have a pose: all numbers are finite, it does not slide sideways, and it turns no faster than any
/// vehicle that may be described.
fn is_possible(pose: &Pose) -> bool {
    let places = [pose.x_m, pose.y_m, pose.predicted_x_m, pose.predicted_y_m];
    let numbers =
        pose.covariance.iter().chain(&pose.local_covariance).chain(&pose.innovation).chain(&pose.gain);
    let within = |values: &[f64], limit: f64| values.iter().all(|value| value.abs() <= limit);
    within(&places, FARTHEST_M)
        && within(&[pose.yaw_rad, pose.predicted_yaw_rad], TAU)
        && within(&[pose.speed_mps, pose.predicted_speed_mps], ANY_SENT_VELOCITY_MAX_MPS)
        && [pose.sideslip_rad, pose.predicted_sideslip_rad].iter().all(|angle| angle.abs() < SIDEWAYS_RAD)
        && within(&[pose.yaw_rate_radps, pose.predicted_yaw_rate_radps], YAW_RATE_MAX_RADPS)
        && numbers.chain([&pose.nis]).all(|value| value.is_finite())
}

#[cfg(test)]
mod tests;
