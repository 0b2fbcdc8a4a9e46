//! The way that the robot follows: arcs and lines through waypoints, with positions along and across it.
//!
//! A position has two pairs of coordinates. In the plane it is (x, y) with a yaw. On the course it is the length along
//! the way to the nearest point of it, the distance to the left of that point, and the yaw relative to the way there.
//! [`Course::on_course`] and [`Course::in_plane`] translate. Before its first waypoint and behind its last one a course
//! continues straight.
//!
//! The line of `[track]` is the course without waypoints: both pairs of coordinates are the same numbers there.
//!
//! Where it fails: the nearest point is unique only for positions nearer than the radius of the bend. A course may be no
//! wider than that, and a position is looked for near the one before it, so a course may cross itself.

mod biarc;
mod keys;
mod legs;
mod outline;
mod turning;
mod widths;

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use key_table::{Invalid, Key, Setting, Value};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::frame::{heading, wrap_angle};
use crate::state::State;

pub use keys::{CourseKeys, Waypoint};
pub use legs::{Leg, LegFollower};
pub use outline::{CourseOutline, ellipse_point};
pub use widths::Widths;

/// How far from where a position was a moment ago it is looked for, behind and ahead [m].
const NEAR_M: [f64; 2] = [2.0, 3.0];

/// Rounding of the place beside a point [m].
const OFF_M: f64 = 1e-6;

/// Places of a course that are no further apart are one: where a lap ends, the next one begins [m].
const SAME_M: f64 = 1.0;

/// The way that the robot follows.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(try_from = "CourseKeys", into = "CourseKeys")]
pub struct Course {
    keys: CourseKeys,
    pieces: Arc<[Piece]>,
    /// Where its first piece begins: not zero for a later leg of another course [m].
    begin_m: f64,
    /// Where its last piece ends [m].
    length_m: f64,
    /// Whether it has parts that are driven backwards beside others.
    turns_back: bool,
}

/// A part of constant curvature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Piece {
    /// Length of the course before it [m].
    begin_m: f64,
    /// Its own length [m].
    length_m: f64,
    /// Where it begins [m].
    point: Vector2<f64>,
    /// The direction in which it is driven there [rad].
    yaw: f64,
    /// To the left [1/m].
    curvature: f64,
    /// The waypoint before it, from 0.
    waypoint: usize,
    /// Largest velocity there; infinite without one [m/s].
    speed_mps: f64,
    /// How far beside it the way reaches to either side [m].
    half_width_m: f64,
    /// Whether it is driven backwards.
    is_reverse: bool,
}

impl Default for Piece {
    fn default() -> Self {
        Self {
            begin_m: 0.0,
            length_m: 0.0,
            point: Vector2::zeros(),
            yaw: 0.0,
            curvature: 0.0,
            waypoint: 0,
            speed_mps: f64::INFINITY,
            half_width_m: f64::INFINITY,
            is_reverse: false,
        }
    }
}

/// The course at one length along it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tangent {
    /// The point in the plane [m].
    pub point: Vector2<f64>,
    /// The direction in which the course is driven; it grows beyond a half turn on a course that turns round. A robot that
    /// drives backwards there looks the other way [rad].
    pub yaw: f64,
    /// To the left [1/m].
    pub curvature: f64,
}

/// The sharpest bend of a course.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bend {
    /// The waypoint before it, from 0.
    pub waypoint: usize,
    /// Its radius; infinite on a straight course [m].
    pub radius_m: f64,
}

impl Tangent {
    /// A point `ahead` metres further along the tangent and `left` metres to the left of it.
    pub fn point(&self, ahead: f64, left: f64) -> Vector2<f64> {
        let along = heading(self.yaw);
        self.point + along * ahead + Vector2::new(-along.y, along.x) * left
    }

    /// How far ahead along the tangent and to the left of it a point is [m].
    pub fn offset(&self, point: Vector2<f64>) -> [f64; 2] {
        let (along, from) = (heading(self.yaw), point - self.point);
        [along.dot(&from), along.perp(&from)]
    }
}

impl Course {
    /// Whether this is the line of `[track]`, where coordinates on the course are those in the plane.
    pub fn is_line(&self) -> bool {
        self.pieces.is_empty()
    }

    /// The keys that it was made from.
    pub fn keys(&self) -> &CourseKeys {
        &self.keys
    }

    /// Where it begins: zero but for a later leg of another course [m].
    pub fn begin_m(&self) -> f64 {
        self.begin_m
    }

    /// Length from the first waypoint to the last one; where a leg of another course ends [m].
    pub fn length_m(&self) -> f64 {
        self.length_m
    }

    /// The course at `along_m`.
    pub fn at(&self, along_m: f64) -> Tangent {
        let next = self.pieces.partition_point(|piece| piece.begin_m <= along_m);
        let Some(piece) = self.pieces.get(next.saturating_sub(1)) else {
            return Tangent { point: Vector2::new(along_m, 0.0), yaw: 0.0, curvature: 0.0 };
        };
        let along = along_m - piece.begin_m;
        let inside = along.clamp(0.0, piece.length_m);
        let tangent = piece.at(inside);
        if along == inside || next < self.pieces.len() && next > 0 {
            return tangent;
        }
        Tangent { point: tangent.point(along - inside, 0.0), curvature: 0.0, ..tangent }
    }

    /// Curvature of the course at `along_m` [1/m].
    pub fn curvature(&self, along_m: f64) -> f64 {
        if self.is_line() { 0.0 } else { self.at(along_m).curvature }
    }

    /// How far beside the course its way reaches to either side at `along_m`; infinite on the line [m].
    pub fn half_width_m(&self, along_m: f64) -> f64 {
        let next = self.pieces.partition_point(|piece| piece.begin_m <= along_m);
        self.pieces.get(next.saturating_sub(1)).map_or(f64::INFINITY, |piece| piece.half_width_m)
    }

    /// Largest velocity at `along_m` with which the robot can slow down in time for all that is ahead; infinite on a course
    /// without velocities [m/s].
    pub fn speed_mps(&self, along_m: f64, deceleration_mps2: f64) -> f64 {
        let first = self.pieces.partition_point(|piece| piece.begin_m + piece.length_m <= along_m);
        let limited = self.pieces[first..].iter().filter(|piece| piece.speed_mps.is_finite());
        let limits = limited.map(|piece| {
            let ahead_m = (piece.begin_m - along_m).max(0.0);
            (piece.speed_mps * piece.speed_mps + 2.0 * deceleration_mps2 * ahead_m).sqrt()
        });
        limits.fold(f64::INFINITY, f64::min)
    }

    /// The sharpest bend.
    pub fn sharpest(&self) -> Bend {
        let straight = Bend { waypoint: 0, radius_m: f64::INFINITY };
        self.pieces.iter().fold(straight, |sharpest, piece| {
            let radius_m = 1.0 / piece.curvature.abs();
            if radius_m < sharpest.radius_m { Bend { waypoint: piece.waypoint, radius_m } } else { sharpest }
        })
    }

    /// Length along the course and distance to the left of a point, over the whole course [m]; of equally near places
    /// the first one.
    pub fn locate(&self, point: Vector2<f64>) -> [f64; 2] {
        self.within(point, [f64::NEG_INFINITY, f64::INFINITY])
    }

    /// The same between two lengths along the course, and straight on behind each of them.
    pub fn within(&self, point: Vector2<f64>, [from_m, to_m]: [f64; 2]) -> [f64; 2] {
        if self.is_line() {
            return [point.x, point.y];
        }
        let first = self.pieces.partition_point(|piece| piece.begin_m + piece.length_m <= from_m);
        let first = first.min(self.pieces.len() - 1);
        let mut best = (f64::INFINITY, 0.0);
        for piece in &self.pieces[first..] {
            if piece.begin_m > to_m && best.0 < f64::INFINITY {
                break;
            }
            let along = piece.nearest(point);
            let distance = (piece.at(along).point - point).norm();
            if distance < best.0 - 1e-9 {
                best = (distance, piece.begin_m + along);
            }
        }
        let [from_m, to_m] = [from_m.max(self.begin_m), to_m.min(self.length_m)];
        let along_m = best.1.max(from_m).min(to_m.max(from_m));
        let [ahead, left] = self.at(along_m).offset(point);
        // At an end of the range the course continues straight; elsewhere the point is beside it.
        let beyond = if along_m >= to_m { ahead.max(0.0) } else { 0.0 };
        let before = if along_m <= from_m { ahead.min(0.0) } else { 0.0 };
        // Where the course turns back, a point ahead of its end is as far beside it as it is away.
        let off = ahead - beyond - before;
        let left = if self.turns_back && off.abs() > OFF_M { off.hypot(left).copysign(left) } else { left };
        [along_m + beyond + before, left]
    }

    /// Length along the course of the first place from `from_m` on that is nearest to a point [m].
    pub fn next(&self, point: Vector2<f64>, from_m: f64) -> f64 {
        let ahead = self.pieces.iter().filter(|piece| piece.begin_m + piece.length_m > from_m);
        let places = ahead.map(|piece| (piece.begin_m + piece.nearest(point)).max(from_m));
        let distance = |along_m: f64| (self.at(along_m).point - point).norm();
        let nearer =
            |best: f64, along_m: f64| if distance(along_m) < distance(best) - 1e-9 { along_m } else { best };
        places.reduce(nearer).unwrap_or(self.length_m)
    }

    /// A state in the plane on the course, near `near_m`.
    #[must_use]
    pub fn on_course(&self, state: &State, near_m: f64) -> State {
        if self.is_line() {
            return *state;
        }
        let range = [near_m - NEAR_M[0], near_m + NEAR_M[1]];
        let [along, left] = self.within(Vector2::new(state.x, state.y), range);
        State { x: along, y: left, yaw: wrap_angle(state.yaw - self.at(along).yaw), ..*state }
    }

    /// A state on the course in the plane.
    #[must_use]
    pub fn in_plane(&self, state: &State) -> State {
        if self.is_line() {
            return *state;
        }
        let tangent = self.at(state.x);
        let point = tangent.point(0.0, state.y);
        State { x: point.x, y: point.y, yaw: tangent.yaw + state.yaw, ..*state }
    }

    /// The place of a state in the plane on the whole course: near it, and in its direction. Where the course comes by
    /// again, it is the first of these places, so a robot that stands a little before the start has all laps to drive.
    pub fn find(&self, state: &State) -> f64 {
        self.find_from(state, f64::NEG_INFINITY)
    }

    /// The same from a length along the course on [m].
    pub fn find_from(&self, state: &State, from_m: f64) -> f64 {
        let point = Vector2::new(state.x, state.y);
        let misfit = |along: f64| {
            let tangent = self.at(along);
            let turned = if self.turns_back && self.is_reverse(along) { PI } else { 0.0 };
            (tangent.point - point).norm() + wrap_angle(state.yaw - tangent.yaw - turned).abs()
        };
        let ahead = self.pieces.iter().filter(|piece| piece.begin_m + piece.length_m >= from_m);
        let mut places = ahead.map(|piece| (piece.begin_m + piece.nearest(point)).max(from_m));
        let best = places.clone().min_by(|one, other| misfit(*one).total_cmp(&misfit(*other)));
        let Some(best) = best else { return if self.is_line() { state.x } else { self.length_m } };
        let is_same = |along: f64| {
            let apart = (self.at(along).point - self.at(best).point).norm();
            apart <= SAME_M && misfit(along) <= misfit(best) + SAME_M
        };
        let first = places.find(|along| is_same(*along)).unwrap_or(best);
        self.within(point, [first, first + 2.0 * SAME_M])[0].max(from_m)
    }
}

impl Piece {
    /// The place `along` metres behind its begin.
    fn at(&self, along: f64) -> Tangent {
        let half = self.curvature * along / 2.0;
        // The chord of an arc is shorter than the arc by sin(half) / half and has its middle direction.
        let chord = if half.abs() < 1e-6 { along } else { along * half.sin() / half };
        let point = self.point + heading(self.yaw + half) * chord;
        Tangent { point, yaw: self.yaw + self.curvature * along, curvature: self.curvature }
    }

    /// How far behind its begin its nearest point to `point` is.
    fn nearest(&self, point: Vector2<f64>) -> f64 {
        let (along, from) = (heading(self.yaw), point - self.point);
        let (ahead, left) = (along.dot(&from), along.perp(&from));
        if self.curvature.abs() * self.length_m < 1e-9 {
            return ahead.clamp(0.0, self.length_m);
        }
        // The angle by which the radius has turned from the begin to the point.
        let (side, sharp) = (self.curvature.signum(), self.curvature.abs());
        let turned = ahead.atan2(1.0 / sharp - side * left) / sharp;
        let whole = TAU / sharp;
        match turned.rem_euclid(whole) {
            inside if inside <= self.length_m => inside,
            outside if whole - outside < outside - self.length_m => 0.0,
            _ => self.length_m,
        }
    }
}

impl Setting for Course {
    fn from_value(path: &str, value: Value) -> Result<Self, Invalid> {
        Self::try_from(CourseKeys::from_value(path, value)?).map_err(|error| error.within(path))
    }

    fn require_all(&self, name: &str) -> Result<(), Invalid> {
        self.keys.require_ranges().map_err(|error| error.within(name))
    }

    fn keys() -> Vec<Key> {
        <CourseKeys as Setting>::keys()
    }
}

impl From<Course> for CourseKeys {
    fn from(course: Course) -> Self {
        course.keys
    }
}

#[cfg(test)]
mod tests;
