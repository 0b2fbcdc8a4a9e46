//! Where points are relative to the way that the robot follows: along it and to the left of it.
//!
//! On the line of the track these are x and y. On a course, a point is looked for around the robot's place, from 8 m
//! behind to 12 m ahead, because a course may cross itself. The nearest of points every 0.25 m along the course tells
//! where, the course itself how far exactly.
//!
//! Where it fails: of two parts of the course within that range, a point belongs to the nearer one.

use nalgebra::Vector2;
use vehicle::frame::{to_robot, to_track};
use vehicle::geometry::Rectangle;
use vehicle::{Course, State, Surroundings};

use crate::ObstaclesConfig;
use crate::evidence::REACH_M;
use crate::points::{Beams, Place, Point};

/// Points are looked for so far behind and ahead of the robot, along the course [m].
const RANGE_M: [f64; 2] = [8.0, 12.0];
/// Distance between the points by which a place is found [m].
const STEP_M: f64 = 0.25;
/// Every so many of them are compared first, then those around the nearest.
const STRIDE: usize = 4;
/// The end walls of a hall stand so far before and behind a course [m].
const ENDS_M: f64 = 2.0 + Surroundings::HALL_M;
/// A robot farther outside of the way than what is described is looked for on the whole course [m].
const ASTRAY_M: f64 = 1.0;
/// A body beside the track may seem to reach so far across its line [m].
const BESIDE_NOISE_M: f64 = 0.05;
/// A bend bulges into a straight side between two points of it with this distance by less than that [m].
const SIDE_M: f64 = 0.5;
/// Distance from point to point of a beam that is compared with the hall [m].
const MARCH_M: f64 = 0.6;

/// The way, and where the robot is on it.
#[derive(Debug, Clone)]
pub(crate) struct Way {
    course: Course,
    /// Points every `step` metres from [`ENDS_M`] before the course to as far behind it; none on a line.
    samples: Vec<Vector2<f64>>,
    step: f64,
    /// Place of the robot, not finite before the first pose [m].
    along_m: f64,
    beside_y: [f64; 2],
    /// Where returns of walls must come, from the robot [m].
    reach: f64,
    /// What is farther from the course is not described [m].
    described: f64,
    /// Walls that are in view when nothing is on the track, across the way [m].
    wall_y: [f64; 2],
    /// The samples around the robot that tell whether a point is in the hall.
    hall: Vec<Vector2<f64>>,
    /// Coordinates of the returns of a scan by beam.
    returns: Vec<Vector2<f64>>,
}

impl Way {
    pub(crate) fn new(config: &ObstaclesConfig) -> Self {
        let course = config.course.clone();
        let [low, high] = config.wall_y_m;
        let steps = ((course.length_m() + 2.0 * ENDS_M) / STEP_M).ceil();
        let step = (course.length_m() + 2.0 * ENDS_M) / steps;
        let sample = |index: u32| course.at(f64::from(index) * step - ENDS_M).point;
        let is_line = course.is_line();
        let samples: Vec<_> = if is_line { Vec::new() } else { (0..=steps as u32).map(sample).collect() };
        Self {
            hall: Vec::with_capacity(samples.len()),
            returns: if is_line { Vec::new() } else { vec![Vector2::zeros(); config.vehicle.scanner.beams] },
            samples,
            reach: Beams::new(&config.vehicle.scanner, 1).reach(REACH_M),
            step,
            along_m: if is_line { 0.0 } else { f64::NEG_INFINITY },
            beside_y: config.beside_y_m(),
            described: high.max(-low) + config.beside_m.max(config.watch_m),
            wall_y: config.view_y_m().unwrap_or([f64::NEG_INFINITY, f64::INFINITY]),
            course,
        }
    }

    /// Place of the robot along the course, zero on a line and not finite before the first pose [m].
    pub(crate) fn along_m(&self) -> f64 {
        self.along_m
    }

    /// Continues at a place.
    pub(crate) fn resume(&mut self, along_m: f64) {
        self.along_m = along_m;
    }

    /// Finds the robot, near where it was before.
    pub(crate) fn follow(&mut self, [x, y, yaw]: [f64; 3]) {
        if self.course.is_line() {
            return;
        }
        let pose = State { x, y, yaw, ..State::default() };
        let is_astray = |place: &State| place.y.abs() > self.described + ASTRAY_M;
        let near = Some(self.along_m).filter(|along| along.is_finite());
        let near = near.map(|along| self.course.on_course(&pose, along)).filter(|place| !is_astray(place));
        let place = near.unwrap_or_else(|| self.course.on_course(&pose, self.course.find(&pose)));
        self.along_m = place.x;
        let reach = self.wall() + self.reach + self.step;
        self.hall.clear();
        if reach.is_finite() {
            let at = Vector2::new(x, y);
            let around = |sample: &&Vector2<f64>| (*sample - at).norm_squared() < reach * reach;
            self.hall.extend(self.samples.iter().filter(around));
        }
    }

    /// Finds the returns of a scan.
    pub(crate) fn place(&mut self, points: &[Point]) {
        if self.course.is_line() {
            return;
        }
        let far = self.described + self.step;
        // Most returns are of what is around: they are spared the search, and those beside them most of it.
        let (mut distance, mut before) = (0.0, Vector2::zeros());
        for point in points {
            distance -= (point.at - before).norm();
            before = point.at;
            let mut along = 0.0;
            if distance <= far {
                (along, distance) = self.nearest_sample(point.at);
            }
            let is_far = distance > far;
            self.returns[point.beam] =
                if is_far { Vector2::new(along, f64::INFINITY) } else { self.near(along, point.at) };
        }
    }

    /// Along the way and to the left of it, of a return of the scan last placed; infinitely far where it is not described.
    pub(crate) fn of(&self, point: &Point) -> Vector2<f64> {
        if self.course.is_line() { point.at } else { self.returns[point.beam] }
    }

    /// Along the way and to the left of it, of any point.
    fn locate(&self, point: Vector2<f64>) -> Vector2<f64> {
        if self.course.is_line() { point } else { self.near(self.nearest_sample(point).0, point) }
    }

    fn near(&self, along: f64, point: Vector2<f64>) -> Vector2<f64> {
        let range = [along - 2.0 * self.step, along + 2.0 * self.step];
        Vector2::from(self.course.within(point, range))
    }

    /// Place and distance of the nearest sample in the range [m].
    fn nearest_sample(&self, point: Vector2<f64>) -> (f64, f64) {
        let along_m = if self.along_m.is_finite() { self.along_m } else { 0.0 };
        let last = self.samples.len() - 1;
        let index = |along: f64| ((along + ENDS_M) / self.step).clamp(0.0, last as f64) as usize;
        let (first, end) = (index(along_m - RANGE_M[0]), index(along_m + RANGE_M[1]));
        let (mut nearest, mut least) = (first, f64::INFINITY);
        let mut compare = |index: usize| {
            let distance = (self.samples[index] - point).norm_squared();
            if distance < least {
                (nearest, least) = (index, distance);
            }
            nearest
        };
        let coarse = (first..=end).step_by(STRIDE).fold(first, |_, index| compare(index));
        for index in coarse.saturating_sub(STRIDE).max(first)..=(coarse + STRIDE).min(end) {
            compare(index);
        }
        (nearest as f64 * self.step - ENDS_M, least.sqrt())
    }

    /// Direction and curvature of the way at a point [rad, 1/m].
    pub(crate) fn bend_at(&self, point: Vector2<f64>) -> [f64; 2] {
        if self.course.is_line() {
            return [0.0, 0.0];
        }
        let tangent = self.course.at(self.locate(point).x);
        [tangent.yaw, tangent.curvature]
    }

    /// How far a point is ahead of the robot at `pose`: along the course, or forward on a line [m].
    pub(crate) fn ahead(&self, [x, y, yaw]: [f64; 3], point: Vector2<f64>) -> f64 {
        if self.course.is_line() {
            return to_robot(yaw, point.x - x, point.y - y).x;
        }
        let along = self.locate(point).x;
        if self.along_m.is_finite() { along - self.along_m } else { along }
    }

    /// Whether a return is beyond the lines within which bodies at rest are described.
    pub(crate) fn is_point_beside(&self, point: &Point) -> bool {
        let [low, high] = self.beside_y;
        !(low..=high).contains(&self.of(point).y)
    }

    /// Whether a body at rest with these vertices is beyond those lines; by noise it may reach 5 cm across.
    pub(crate) fn is_beside(&self, vertices: impl IntoIterator<Item = Vector2<f64>>) -> bool {
        let [low, high] = self.beside_y;
        let (mut right, mut left) = (true, true);
        for vertex in vertices {
            let across = self.locate(vertex).y;
            right &= across < low + BESIDE_NOISE_M;
            left &= across > high - BESIDE_NOISE_M;
        }
        right || left
    }

    /// [`Self::is_beside`] for a box, whose straight sides may reach into a bend where its corners do not.
    pub(crate) fn is_box_beside(&self, rectangle: &Rectangle) -> bool {
        let corners = rectangle.corners();
        if !self.is_beside(corners) {
            return false;
        }
        let is_short = rectangle.length.max(rectangle.width) <= SIDE_M;
        if self.course.is_line() || is_short {
            return true;
        }
        let sides = (0..4).map(|index| (corners[index], corners[(index + 1) % 4]));
        self.is_beside(sides.flat_map(|(from, to)| {
            let steps = ((to - from).norm() / SIDE_M).ceil().max(1.0);
            (0..steps as u32).map(move |step| from + (to - from) * (f64::from(step) / steps))
        }))
    }

    /// Distance of the walls from a course [m].
    fn wall(&self) -> f64 {
        let [low, high] = self.wall_y;
        high.max(-low)
    }

    /// Whether a beam ends at a wall around the track within the reach of the scanner.
    pub(crate) fn is_wall_near(&self, beams: &Beams, place: &Place, beam: usize) -> bool {
        let unit = beams.unit(beam);
        let direction = to_track(place.yaw, unit.x, unit.y);
        let [low, high] = self.wall_y;
        if self.course.is_line() {
            let across = direction.y;
            let distance = if across > 0.0 { high - place.at.y } else { place.at.y - low };
            return distance > 0.0 && distance < self.reach * across.abs();
        }
        if self.hall.is_empty() {
            return false;
        }
        // The hall is closed: a beam meets a wall when it comes to where no part of the course is as near as the walls.
        let limit = (self.wall() + self.step / 8.0).powi(2);
        let is_outside =
            |point: Vector2<f64>| self.hall.iter().all(|sample| (sample - point).norm_squared() > limit);
        let steps = (self.reach / MARCH_M).round() as u32;
        !is_outside(place.at)
            && (1..=steps).any(|step| is_outside(place.at + direction * (f64::from(step) * MARCH_M)))
    }
}

#[cfg(test)]
mod tests;
