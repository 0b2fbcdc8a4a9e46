//! Collects calibration runs from the emulated robot.
//!
//! The robot drives open loop on an endless empty floor. The recorded measurements are those that a person could make
//! with a tape measure, chalk and a stopwatch, with their errors, and the odometry of the robot. Its true parameters
//! are never used.

use std::f64::consts::TAU;

use emulator::Emulator;
use emulator::noise::{NoiseStream, Purpose};
use emulator::scenario::{Scenario, Start, Surroundings, Track};
use nalgebra::Vector2;
use shared_types::{Actuation, ActuationKind, Odometry, Scan, Truth};
use vehicle::frame::to_robot;
use vehicle::{Bounds, Description};

use crate::drift::STANDSTILL_MPS;
use crate::record::{ApproachSide, CircleRun, SineRow, StraightRun};
use crate::velocity::TAPE_ERROR_M;

/// Standard deviation of a time between two passages by stopwatch [s]: two hands of 35 ms.
const STOPWATCH_S: f64 = 0.05;

/// Standard deviation of each coordinate of a chalk mark [m].
const MARK_M: f64 = 0.003;

/// Standard deviation of the direction in which the robot is put down for a sine run [rad].
const PLACE_RAD: f64 = 0.002;

/// Time between two actuations [ns]: well within the dead-man of the robot.
const PERIOD_NS: u64 = 100_000_000;

/// Distance between the two fixed points of a robot that is sent about 1 m/s, and of the first one from the start at least [m].
const DISTANCE_M: f64 = 6.0;
const START_M: f64 = 1.0;

/// Velocities sent in straight runs [m/s], of a robot that may be sent 2 m/s; each is driven twice.
const STRAIGHT_MPS: [f64; 8] = [0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2];

/// Velocity sent in circle runs of the same robot [m/s]: slow, so that the turn is nearly kinematic.
const CIRCLE_MPS: f64 = 0.6;

/// Largest angle sent in circle runs, as a share of the largest desired one, and the number of steps to either side.
const CIRCLE: f64 = 85.0 / 60.0;
const CIRCLE_STEPS: i32 = 20;

/// The angle is approached from this much further out, as such a share, which takes up play of up to a third of it.
const OVERSHOOT: f64 = 34.0 / 60.0;

/// Longest arc of a circle run [m], and its largest turn: less than half a circle [rad].
const ARC_M: f64 = 4.0;
const ARC_RAD: f64 = 2.5;

/// Sine runs: velocity sent by the same robot [m/s], largest acceleration to the side [m/s^2], period of each run [s], duration
/// [s], time between marks [s]. Steering that is late shows the more the shorter the period, and play does not.
const SINE_MPS: f64 = 1.0;
const SINE_MPS2: f64 = 1.0;
const SINE_PERIODS_S: [f64; 4] = [5.0, 3.0, 5.0, 8.0];
const SINE_S: f64 = 60.0;
const SINE_MARK_S: f64 = 1.0;

/// A robot that has not moved after so many samples does not.
const MAX_RESTED: u64 = 20;

/// Longest duration of a run [s]; a robot that hardly moves reaches it.
const TIMEOUT_S: f64 = 600.0;

/// How fast a vehicle is sent, where the SUMMIT is sent 1 m/s [m/s]: no faster than half of what it may be sent, as that.
fn pace_mps(vehicle: &Description) -> f64 {
    let Bounds { velocity_max_mps, sent_velocity_max_mps, .. } = vehicle.bounds;
    velocity_max_mps.min(sent_velocity_max_mps / 2.0)
}

/// Straight runs of a vehicle with a flying start, timed between two fixed points.
pub fn straight_runs(robot: &Scenario, vehicle: &Description, seed: u64) -> Vec<StraightRun> {
    let mut hand = NoiseStream::new(seed, Purpose::Course, 1001);
    // The points are measured once and stay where they are.
    let pace_mps = pace_mps(vehicle);
    let between_m = DISTANCE_M * pace_mps.max(1.0);
    let distance_m = round(between_m + TAPE_ERROR_M * hand.normal(), 1e-3);
    let mut runs = Vec::new();
    for sent_velocity_mps in
        STRAIGHT_MPS.into_iter().map(|sent| sent * pace_mps).flat_map(|sent| [sent, sent])
    {
        let mut drive = Drive::new(robot, seed);
        drive.send(sent_velocity_mps, 0.0);
        // Twice the way that it needs for its speed.
        let start_m = START_M.max(sent_velocity_mps * sent_velocity_mps / vehicle.acceleration_max_mps2);
        let Some(first) = drive.until(|place| place.x >= start_m) else { continue };
        let Some(second) = drive.until(|place| place.x >= start_m + between_m) else { continue };
        let time_s = round(second - first + STOPWATCH_S * hand.normal(), 0.01);
        runs.push(StraightRun { sent_velocity_mps, distance_m, time_s, place: "--drive".to_owned() });
    }
    runs
}

/// Steady circle runs of a vehicle to both sides, each angle approached from below and from above.
pub fn circle_runs(robot: &Scenario, vehicle: &Description, seed: u64) -> Vec<CircleRun> {
    let mut hand = NoiseStream::new(seed, Purpose::Course, 1002);
    let Bounds { steering_max_rad, sent_steering_max_rad, .. } = vehicle.bounds;
    let circle_rad = (CIRCLE * steering_max_rad).min(sent_steering_max_rad);
    let overshoot_rad = OVERSHOOT * steering_max_rad;
    let (circle_mps, parameters) = (CIRCLE_MPS * pace_mps(vehicle).min(1.0), vehicle.parameters());
    let mut runs = Vec::new();
    for step in -CIRCLE_STEPS..=CIRCLE_STEPS {
        let sent = circle_rad * f64::from(step) / f64::from(CIRCLE_STEPS);
        let arc_m = ARC_M.min(ARC_RAD / parameters.curvature_of(sent).abs());
        for side in [ApproachSide::Below, ApproachSide::Above] {
            let beyond = if side == ApproachSide::Below { -overshoot_rad } else { overshoot_rad };
            let mut drive = Drive::new(robot, seed);
            drive.send(circle_mps, sent + beyond);
            drive.pass(0.3);
            drive.send(circle_mps, sent);
            drive.pass(0.5);
            let Some(places) = drive.follow(arc_m) else { continue };
            let mut chalk = |place: Vector2<f64>| place + Vector2::new(hand.normal(), hand.normal()) * MARK_M;
            let [start, middle, end] =
                [places[0], places[places.len() / 2], places[places.len() - 1]].map(&mut chalk);
            let chord = end - start;
            let offset = to_robot(chord.y.atan2(chord.x), middle.x - start.x, middle.y - start.y);
            runs.push(CircleRun {
                sent_steering_rad: round(sent, 1e-6),
                approached_from: Some(side),
                chord_m: round(chord.norm(), 1e-4),
                // The arc of a left turn lies to the right of its chord.
                height_m: round(-offset.y, 1e-4),
                place: "--drive".to_owned(),
            });
        }
    }
    runs
}

/// Sine runs of a vehicle with a chalk mark every second.
pub fn sine_runs(robot: &Scenario, vehicle: &Description, seed: u64) -> Vec<SineRow> {
    let mut hand = NoiseStream::new(seed, Purpose::Course, 1003);
    let sine_mps = SINE_MPS * pace_mps(vehicle).min(1.0);
    let sideways_rad = vehicle.parameters().steering_of(SINE_MPS2 / (sine_mps * sine_mps));
    // Half as fast as the steering can follow.
    let shortest_s = SINE_PERIODS_S.into_iter().fold(f64::INFINITY, f64::min);
    let slow_rad = vehicle.steering_rate_max_radps / 2.0 * shortest_s / TAU;
    let sine_rad = vehicle.bounds.steering_max_rad.min(sideways_rad).min(slow_rad);
    let mut rows = Vec::new();
    for (run, period_s) in (1_u32..).zip(SINE_PERIODS_S) {
        // The robot starts at its origin; in the frame of the tape measure it is a little shifted and turned.
        let (sin, cos) = (PLACE_RAD * hand.normal()).sin_cos();
        let shift = Vector2::new(hand.normal(), hand.normal()) * MARK_M;
        let mut drive = Drive::new(robot, seed.wrapping_mul(16).wrapping_add(u64::from(run)));
        let samples = (SINE_S * 1e9) as u64 / PERIOD_NS;
        // The run begins when the robot moves.
        let mut rested = 0;
        for sample in 0..=samples {
            let time_s = sample as f64 * PERIOD_NS as f64 * 1e-9;
            let phase = TAU * time_s / period_s;
            let sent = round(sine_rad * phase.sin(), 1e-6);
            let mut place = drive.place();
            drive.send(sine_mps, sent);
            let mut odometry = drive.odometry(sample + rested);
            while sample == 0 && odometry.speed_mps < STANDSTILL_MPS && rested < MAX_RESTED {
                rested += 1;
                place = drive.place();
                odometry = drive.odometry(rested);
            }
            let marked = sample % ((SINE_MARK_S * 1e9) as u64 / PERIOD_NS) == 0;
            let mut chalk = |value: f64, shift: f64| round(value + shift + MARK_M * hand.normal(), 1e-3);
            let measured = marked.then(|| {
                let turned = Vector2::new(cos * place.x - sin * place.y, sin * place.x + cos * place.y);
                [chalk(turned.x, shift.x), chalk(turned.y, shift.y)]
            });
            rows.push(SineRow {
                run,
                time_s: round(time_s, 1e-3),
                sent_steering_rad: Some(sent),
                reported_x_m: odometry.x_m,
                reported_y_m: odometry.y_m,
                reported_yaw_rad: odometry.yaw_rad,
                speed_mps: odometry.speed_mps,
                measured_x_m: measured.map(|place| place[0]),
                measured_y_m: measured.map(|place| place[1]),
                place: "--drive".to_owned(),
            });
        }
    }
    rows
}

/// One open-loop drive from the origin on an endless empty floor.
struct Drive {
    emulator: Emulator,
    sent: (f64, f64),
    sent_ns: u64,
    scan: Box<Scan>,
}

impl Drive {
    fn new(robot: &Scenario, seed: u64) -> Self {
        let floor = Scenario {
            seed,
            track: Track {
                x_m: [-1e4, 1e4],
                y_m: [-1e3, 1e3],
                walls: false,
                surroundings: Surroundings::Open,
            },
            start: Start::default(),
            obstacles: Vec::new(),
            endless: None,
            ..robot.clone()
        };
        let emulator = Emulator::new(&floor, PERIOD_NS);
        Self { emulator, sent: (0.0, 0.0), sent_ns: 0, scan: Box::default() }
    }

    fn send(&mut self, velocity: f64, steering: f64) {
        (self.sent, self.sent_ns) = ((velocity, steering), self.emulator.now_ns());
        self.emulator.actuate(&Actuation {
            kind: ActuationKind::Drive.wire(),
            sent_velocity_mps: velocity,
            sent_steering_rad: steering,
            ..Actuation::default()
        });
    }

    fn place(&self) -> Vector2<f64> {
        let state = self.emulator.plant().state();
        Vector2::new(state.x, state.y)
    }

    /// One millisecond; the actuation is repeated before the robot's dead-man blocks the wheels.
    fn tick(&mut self) {
        if self.emulator.now_ns() >= self.sent_ns + PERIOD_NS {
            self.send(self.sent.0, self.sent.1);
        }
        self.emulator.advance_to(self.emulator.now_ns() + 1_000_000);
    }

    fn pass(&mut self, seconds: f64) {
        (0..(seconds * 1e3) as u64).for_each(|_| self.tick());
    }

    /// Time at which a place is reached, between two milliseconds the later one [s].
    fn until(&mut self, reached: impl Fn(Vector2<f64>) -> bool) -> Option<f64> {
        let end_ns = self.emulator.now_ns() + (TIMEOUT_S * 1e9) as u64;
        while !reached(self.place()) {
            if self.emulator.now_ns() > end_ns {
                return None;
            }
            self.tick();
        }
        Some(self.emulator.now_ns() as f64 * 1e-9)
    }

    /// Places, a millisecond apart, until this distance is driven [m].
    fn follow(&mut self, length: f64) -> Option<Vec<Vector2<f64>>> {
        let (mut places, mut driven) = (vec![self.place()], 0.0);
        while driven < length {
            if places.len() as f64 > TIMEOUT_S * 1e3 {
                return None;
            }
            self.tick();
            let place = self.place();
            driven += (place - places[places.len() - 1]).norm();
            places.push(place);
        }
        Some(places)
    }

    /// The odometry sample `scan_id` periods after the start; lets one period pass.
    fn odometry(&mut self, scan_id: u64) -> Odometry {
        let (mut odometry, mut truth) = (Odometry::default(), Truth::default());
        self.emulator.advance_to(self.emulator.scan_ready_ns(scan_id));
        self.emulator.measure(scan_id, &mut self.scan, &mut odometry, &mut truth);
        self.emulator.advance_to(self.emulator.acquired_ns(scan_id + 1));
        odometry
    }
}

/// A value as a person writes it down.
fn round(value: f64, unit: f64) -> f64 {
    let per_unit = (1.0 / unit).round();
    (value * per_unit).round() / per_unit
}

#[cfg(test)]
mod tests;
