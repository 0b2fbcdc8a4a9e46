//! The emulated scanner: a Hokuyo URG-04LX, or what `[robot.scanner]` makes of it.
//!
//! The scanner sits at the robot's centre, or where `robot.scanner_x_m` and its neighbours put it.
//! Its beams are taken one after the other: each starts where the scanner is at that beam's time, and hits what is there
//! at that time, so the scan of a moving robot is skewed. The body of the robot is not seen. Outside of the track it
//! sees a hall, unless the scenario has open surroundings.
//!
//! Noise, in this order: a beam across an edge may mix both distances (`noise.mixed_pixels`), the range gets
//! normal noise of `noise.range_m` or of the share `noise.range_share` of the range, whichever is larger, and a
//! beam may be lost (`noise.dropout`). The data sheet's +-10 mm below 1 m and +-1 % above are bounds, about three
//! standard deviations of 0.003 m and 0.003; the default of 0.01 m at any range is harsher up to 3 m.
//!
//! Then come the faults of the scanner. A beam without a return, for whatever reason, reports an error code drawn from the seed.

mod faults;
mod gallery;
mod hall;

use std::ops::RangeInclusive;

use nalgebra::Vector2;
use shared_types::{MAX_BEAMS, ScanGeometry};
use vehicle::frame::{heading, to_track, wrap_angle};
use vehicle::{ScannerDescription, State};

use crate::history::History;
use crate::noise::{NoiseStream, Purpose};
use crate::scenario::{Noise, Scenario, Values};
use crate::scene::{PlacedObstacle, Scene};
use faults::{Faults, Scale};
use gallery::Gallery;
use hall::Hall;

/// A beam without a usable return, until it gets its error code.
const NO_RETURN: u32 = 0;

/// Neighbouring beams whose ranges differ by more than this lie on two sides of an edge [m].
const EDGE_M: f64 = 0.1;

/// When the beams of a scan are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sweep {
    /// Scan id, which the noise depends on.
    pub scan_id: u64,
    /// Time of the front beam [ns].
    pub front_ns: u64,
    /// How long the sweep over all beams lasts [ns].
    pub duration_ns: u64,
}

impl Sweep {
    /// Time of one of `count` beams, of which `front` looks to the front [ns]; times before the start of the run are the
    /// start.
    pub(crate) fn beam_ns(&self, beam: usize, front: usize, count: usize) -> u64 {
        let before_front =
            |beams: usize| (beams as u128 * u128::from(self.duration_ns) / count as u128) as u64;
        if beam >= front {
            self.front_ns.saturating_add(before_front(beam - front))
        } else {
            self.front_ns.saturating_sub(before_front(front - beam))
        }
    }
}

/// One beam: where it starts, where it goes, and when.
#[derive(Debug, Clone, Copy)]
struct Beam {
    origin: Vector2<f64>,
    direction: Vector2<f64>,
    time_s: f64,
}

/// The scanner with its buffers.
#[derive(Debug, Clone)]
pub struct Laser {
    seed: u64,
    noise: Noise,
    mount: Mount,
    device: ScannerDescription,
    /// Directions of its beams.
    geometry: ScanGeometry,
    hall: Option<Hall>,
    /// In place of the hall where the robot follows a course.
    gallery: Option<Gallery>,
    faults: Faults,
    beams: Vec<Beam>,
    ranges: Vec<f64>,
    /// Whether the surface that a beam hits is black.
    black: Vec<bool>,
    mixed: Vec<f64>,
}

impl Laser {
    /// The scanner of a scenario.
    pub fn new(scenario: &Scenario) -> Self {
        let device = scenario.true_scanner();
        let beams = device.beams;
        Self {
            seed: scenario.seed,
            noise: scenario.noise,
            mount: Mount::new(&scenario.robot_values()),
            device,
            geometry: device.geometry(),
            hall: if scenario.course.is_none() { Hall::of(scenario) } else { None },
            gallery: scenario.course.as_ref().and_then(|course| Gallery::of(course, device.range_m)),
            faults: Faults::new(scenario),
            beams: Vec::with_capacity(beams),
            ranges: Vec::with_capacity(beams),
            black: Vec::with_capacity(beams),
            mixed: Vec::with_capacity(beams),
        }
    }

    /// Where its beams look.
    pub fn geometry(&self) -> ScanGeometry {
        self.geometry
    }

    /// Ranges of one sweep past what stands around the robot, one for each beam [mm, or an error code below 20].
    pub fn measure(&mut self, sweep: &Sweep, history: &History, scene: &Scene, ranges_mm: &mut [u32]) {
        self.cast(sweep, history, scene);
        let mut stream = NoiseStream::new(self.seed, Purpose::Laser, sweep.scan_id);
        self.mix_edges(&mut stream);
        let scale = self.faults.scale_at(sweep.front_ns);
        for (reading, range) in ranges_mm.iter_mut().zip(&self.mixed) {
            *reading = reading_of(*range, &self.device, (&self.noise, scale), &mut stream);
        }
        self.faults.absorb(sweep.front_ns, &self.ranges, &self.black, ranges_mm);
        self.faults.disturb(sweep, ranges_mm);
        faults::draw_codes(self.seed, sweep.scan_id, ranges_mm);
        self.faults.hold(sweep.front_ns, ranges_mm);
    }

    /// The ranges that a stuck scanner repeats.
    pub(crate) fn repeated(&self) -> Option<&[u32; MAX_BEAMS]> {
        self.faults.held.as_ref()
    }

    /// Continues with the ranges that another scanner repeats.
    pub(crate) fn repeat(&mut self, ranges_mm: Option<[u32; MAX_BEAMS]>) {
        self.faults.held = ranges_mm;
    }

    /// True ranges of one sweep [m], infinite where a beam hits nothing within reach.
    pub fn cast(&mut self, sweep: &Sweep, history: &History, scene: &Scene) -> &[f64] {
        let motion = self.aim(sweep, history);
        self.ranges.clear();
        self.ranges.resize(self.device.beams, f64::INFINITY);
        self.black.clear();
        self.black.resize(self.device.beams, false);
        if let Some(walls) = scene.walls() {
            for (range, beam) in self.ranges.iter_mut().zip(&self.beams) {
                *range = wall_range(beam, walls);
            }
        } else if let Some(hall) = &self.hall {
            for (range, beam) in self.ranges.iter_mut().zip(&self.beams) {
                *range = hall.range(beam.origin, beam.direction);
            }
        } else if let Some(gallery) = &self.gallery {
            for (range, beam) in self.ranges.iter_mut().zip(&self.beams) {
                *range = gallery.range(beam.origin, beam.direction);
            }
        }
        let half_sweep_s = sweep.duration_ns as f64 * 0.5e-9;
        for near in scene.near(motion.origin, self.device.range_m + motion.travel) {
            for window in visible(near, &motion, half_sweep_s, (self.geometry, self.device.range_m)) {
                self.cast_at(near, window);
            }
        }
        &self.ranges
    }

    /// Computes where all beams start and go, and how far the robot moves meanwhile.
    fn aim(&mut self, sweep: &Sweep, history: &History) -> Motion {
        let front = history.at(sweep.front_ns).state;
        let mount = self.mount.turned(self.faults.yaw_at(sweep.front_ns));
        let (origin, yaw) = mount.pose(&front);
        let mut motion = Motion { origin, yaw, travel: 0.0, turn: 0.0, time_s: sweep.front_ns as f64 * 1e-9 };
        let mut walk = history.walk();
        self.beams.clear();
        let (front, count) = (self.device.front_beam(), self.device.beams);
        for index in 0..count {
            let time_ns = sweep.beam_ns(index, front, count);
            let state = walk(time_ns).state;
            let (origin, yaw) = mount.pose(&state);
            motion.travel = motion.travel.max((origin - motion.origin).norm());
            motion.turn = motion.turn.max((yaw - motion.yaw).abs());
            self.beams.push(Beam {
                origin,
                direction: heading(yaw + self.geometry.yaw_rad(index)),
                time_s: time_ns as f64 * 1e-9,
            });
        }
        motion
    }

    /// Shortens the ranges of the beams in `window` that hit an obstacle.
    fn cast_at(&mut self, near: &PlacedObstacle, window: RangeInclusive<usize>) {
        let fixed = if near.is_permanent() { near.solid(0.0) } else { None };
        for index in window {
            let beam = &self.beams[index];
            if let Some(solid) = fixed.or_else(|| near.solid(beam.time_s))
                && let Some(range) = solid.ray(beam.origin, beam.direction)
                && range < self.ranges[index]
            {
                (self.ranges[index], self.black[index]) = (range, near.is_black());
            }
        }
    }

    /// Copies the true ranges, with mixed ones at edges.
    fn mix_edges(&mut self, stream: &mut NoiseStream) {
        self.mixed.clear();
        self.mixed.extend_from_slice(&self.ranges);
        if self.noise.mixed_pixels <= 0.0 {
            return;
        }
        let reach_m = self.device.range_m;
        for index in 1..self.ranges.len() {
            let (before, after) = (self.ranges[index - 1], self.ranges[index]);
            let is_edge = before <= reach_m && after <= reach_m && (before - after).abs() > EDGE_M;
            // The beam's spot covers both surfaces: the distance comes out somewhere between them.
            if is_edge && stream.chance(self.noise.mixed_pixels) {
                self.mixed[index] = stream.between(before.min(after), before.max(after));
            }
        }
    }
}

/// Where the scanner is on the robot.
#[derive(Debug, Clone, Copy)]
struct Mount {
    forward_m: f64,
    left_m: f64,
    yaw_rad: f64,
}

impl Mount {
    fn new(robot: &Values) -> Self {
        let Values { scanner_x_m, scanner_y_m, scanner_yaw_rad, .. } = *robot;
        Self { forward_m: scanner_x_m, left_m: scanner_y_m, yaw_rad: scanner_yaw_rad }
    }

    /// The same place, turned counter-clockwise.
    fn turned(self, yaw_rad: f64) -> Self {
        Self { yaw_rad: self.yaw_rad + yaw_rad, ..self }
    }

    /// Position and yaw of the scanner on a robot.
    fn pose(&self, robot: &State) -> (Vector2<f64>, f64) {
        let centre = Vector2::new(robot.x, robot.y);
        if self.forward_m == 0.0 && self.left_m == 0.0 {
            return (centre, robot.yaw + self.yaw_rad);
        }
        (centre + to_track(robot.yaw, self.forward_m, self.left_m), robot.yaw + self.yaw_rad)
    }
}

/// Pose at the front beam and the largest deviation from it during the sweep.
#[derive(Debug, Clone, Copy)]
struct Motion {
    origin: Vector2<f64>,
    yaw: f64,
    travel: f64,
    turn: f64,
    time_s: f64,
}

/// The beams that may hit an obstacle at some time of the sweep, as up to two windows.
fn visible(
    near: &PlacedObstacle,
    motion: &Motion,
    half_sweep_s: f64,
    (geometry, reach_m): (ScanGeometry, f64),
) -> impl Iterator<Item = RangeInclusive<usize>> {
    let reach = near.reach() + motion.travel + near.speed() * half_sweep_s;
    let offset = near.centre(motion.time_s) - motion.origin;
    let distance = offset.norm();
    let (middle, half) = if distance <= reach {
        (0.0, std::f64::consts::PI)
    } else {
        let bearing = wrap_angle(offset.y.atan2(offset.x) - motion.yaw);
        (bearing, (reach / distance).asin() + motion.turn + geometry.increment_rad)
    };
    let in_range = distance - reach <= reach_m;
    let last = geometry.count - 1;
    // An obstacle behind the robot may reach into the field of view from both ends.
    [-1.0, 0.0, 1.0].into_iter().filter_map(move |turns: f64| {
        let centre = middle + turns * std::f64::consts::TAU;
        let low = ((centre - half) / geometry.increment_rad + geometry.front()).floor();
        let high = ((centre + half) / geometry.increment_rad + geometry.front()).ceil();
        let is_seen = in_range && high >= 0.0 && low <= last as f64;
        is_seen.then(|| low.max(0.0) as usize..=(high as usize).min(last))
    })
}

fn wall_range(beam: &Beam, [low, high]: [f64; 2]) -> f64 {
    if beam.direction.y.abs() < 1e-12 {
        // Along the walls.
        return f64::INFINITY;
    }
    let wall = if beam.direction.y > 0.0 { high } else { low };
    // Behind a wall the range is zero: an error code.
    ((wall - beam.origin.y) / beam.direction.y).max(0.0)
}

/// Reading of a range, with what `scale` makes of the measured one [mm].
fn reading_of(
    range: f64,
    device: &ScannerDescription,
    (noise, scale): (&Noise, Scale),
    stream: &mut NoiseStream,
) -> u32 {
    if range > device.range_m {
        return NO_RETURN;
    }
    let deviation = noise.range_m.max(noise.range_share * range);
    let measured = if deviation > 0.0 { range + deviation * stream.normal() } else { range };
    if noise.dropout > 0.0 && stream.chance(noise.dropout) {
        return NO_RETURN;
    }
    let millimetres = (scale.applied(measured) * 1000.0).round();
    let is_range = (device.min_range_m * 1000.0..=device.range_m * 1000.0).contains(&millimetres);
    if is_range { millimetres as u32 } else { NO_RETURN }
}

#[cfg(test)]
mod tests;
