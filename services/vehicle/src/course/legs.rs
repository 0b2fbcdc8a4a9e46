//! The legs of a course: parts that are driven forwards, and parts that are driven backwards.
//!
//! Where one ends and the next begins the robot stands and changes its direction of travel. A leg is a course of its own
//! with the coordinates of the whole one, and behind both of its ends it continues straight, so a place near such an end
//! is looked for on the leg that is driven, not on the one that leads the other way.

use std::f64::consts::PI;

use nalgebra::Vector2;

use super::{Course, CourseKeys, Piece, Waypoint, biarc};
use crate::frame::wrap_angle;
use crate::state::State;

/// A robot that is so near to the end of a leg has driven it [m].
const DRIVEN_M: f64 = 0.3;

/// A part of a course that is driven in one direction.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Leg {
    /// Its part of the course, in lengths along the whole one.
    pub course: Course,
    /// Whether it is driven backwards.
    pub is_reverse: bool,
    /// Where it ends along the course [m].
    pub end_m: f64,
}

impl Course {
    /// The legs in their order, at least one.
    pub fn legs(&self) -> Vec<Leg> {
        let parts = self.pieces.chunk_by(|one, next| one.is_reverse == next.is_reverse);
        let legs: Vec<Leg> = parts.map(Leg::of).collect();
        match &legs[..] {
            [] | [_] => vec![Leg { course: self.clone(), is_reverse: false, end_m: f64::INFINITY }],
            _ => legs,
        }
    }

    /// The course from its end to its begin; a place on it is as far from the end as the same place was from the begin. The
    /// line is as long as `line_m`.
    #[must_use]
    pub fn returned(&self, line_m: [f64; 2]) -> Self {
        let [begin_m, end_m] = line_m;
        let point = Vector2::new(begin_m, 0.0);
        let line = [Piece { begin_m, length_m: end_m - begin_m, point, ..Piece::default() }];
        let pieces: &[Piece] = if self.is_line() { &line } else { &self.pieces };
        let (first, last) = (pieces[0], pieces[pieces.len() - 1]);
        let (begin_m, length_m) = (first.begin_m, last.begin_m + last.length_m);
        let turn = |piece: &Piece| {
            let end = piece.at(piece.length_m);
            Piece {
                begin_m: begin_m + length_m - piece.begin_m - piece.length_m,
                point: end.point,
                yaw: end.yaw + PI,
                curvature: -piece.curvature,
                speed_mps: f64::INFINITY,
                ..*piece
            }
        };
        let pieces = pieces.iter().rev().map(turn).collect();
        Self { keys: CourseKeys::default(), pieces, begin_m, length_m, turns_back: false }
    }

    /// Whether the course is driven backwards at `along_m`.
    pub fn is_reverse(&self, along_m: f64) -> bool {
        let next = self.pieces.partition_point(|piece| piece.begin_m <= along_m);
        self.pieces.get(next.saturating_sub(1)).is_some_and(|piece| piece.is_reverse)
    }

    /// The direction of a robot that follows the course at `along_m` [rad].
    pub fn robot_yaw(&self, along_m: f64) -> f64 {
        let turned = if self.is_reverse(along_m) { PI } else { 0.0 };
        wrap_angle(self.at(along_m).yaw + turned)
    }
}

impl Leg {
    fn of(pieces: &[Piece]) -> Self {
        let (first, last) = (pieces[0], pieces[pieces.len() - 1]);
        let length_m = last.begin_m + last.length_m;
        let course = Course {
            keys: CourseKeys::default(),
            pieces: pieces.into(),
            begin_m: first.begin_m,
            length_m,
            turns_back: false,
        };
        Self { course, is_reverse: first.is_reverse, end_m: length_m }
    }
}

/// The place of a robot on a course whose legs it drives one after the other.
#[derive(Debug, Clone, PartialEq)]
pub struct LegFollower {
    legs: Vec<Leg>,
    index: usize,
    along_m: f64,
}

impl LegFollower {
    /// A robot at `along_m`.
    pub fn new(course: &Course, along_m: f64) -> Self {
        let legs = course.legs();
        let index = legs.iter().position(|leg| along_m < leg.end_m).unwrap_or(legs.len() - 1);
        Self { legs, index, along_m }
    }

    /// The state of the robot on the course, with its yaw relative to how it is driven there.
    pub fn follow(&mut self, state: &State) -> State {
        let place = |leg: &Leg, near_m: f64| {
            let driven = if leg.is_reverse { State { yaw: state.yaw + PI, ..*state } } else { *state };
            leg.course.on_course(&driven, near_m)
        };
        let mut here = place(&self.legs[self.index], self.along_m);
        if self.index + 1 < self.legs.len() && self.legs[self.index].end_m - here.x < DRIVEN_M {
            self.index += 1;
            here = place(&self.legs[self.index], here.x);
        }
        self.along_m = here.x;
        here
    }

    /// Goes to a place that was found otherwise [m].
    pub fn put(&mut self, along_m: f64) {
        self.index = self.legs.iter().position(|leg| along_m < leg.end_m).unwrap_or(self.legs.len() - 1);
        self.along_m = along_m;
    }

    /// How far the robot has come [m].
    pub fn along_m(&self) -> f64 {
        self.along_m
    }
}

/// The pieces through all waypoints, two between each pair of them. A leg begins in the direction opposite to that in which
/// the one before ends.
pub(super) fn through(waypoints: &[Waypoint], is_closed: bool) -> Vec<Piece> {
    let mut pieces: Vec<Piece> = Vec::with_capacity(2 * waypoints.len());
    let mut first = 0;
    while first + 1 < waypoints.len() {
        let is_reverse = waypoints[first + 1].reverse;
        let others = &waypoints[first + 2..];
        let last = first + 1 + others.iter().take_while(|point| point.reverse == is_reverse).count();
        let turned = if is_reverse { PI } else { 0.0 };
        let mut points = waypoints[first..=last].to_vec();
        points.iter_mut().for_each(|point| point.yaw_rad = point.yaw_rad.map(|yaw| yaw + turned));
        let before = pieces.last().copied();
        if let Some(before) = before {
            points[0].yaw_rad = Some(before.yaw + before.curvature * before.length_m + PI);
        }
        let begin_m = before.map_or(0.0, |before| before.begin_m + before.length_m);
        let is_whole = first == 0 && last + 1 == waypoints.len();
        pieces.extend(biarc::through(&points, is_closed && is_whole).into_iter().map(|piece| Piece {
            begin_m: begin_m + piece.begin_m,
            waypoint: first + piece.waypoint,
            is_reverse,
            ..piece
        }));
        first = last;
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 6 m forwards, back round a quarter of a circle of 4 m to the right, and forwards again.
    fn course() -> Course {
        let reverse = |point: Waypoint| Waypoint { reverse: true, ..point };
        let waypoints = vec![
            Waypoint::new(0.0, 0.0, Some(0.0)),
            Waypoint::new(6.0, 0.0, Some(0.0)),
            reverse(Waypoint::new(2.0, -4.0, Some(PI / 2.0))),
            Waypoint::new(2.0, 3.0, None),
        ];
        Course::try_from(CourseKeys { waypoints, ..CourseKeys::default() }).unwrap()
    }

    #[test]
    fn legs_change_their_direction_where_the_robot_stands() {
        let course = course();
        let quarter_m = 2.0 * PI;
        assert!((course.length_m() - (6.0 + quarter_m + 7.0)).abs() < 1e-9, "{}", course.length_m());
        let legs = course.legs();
        assert_eq!([false, true, false], [0, 1, 2].map(|index| legs[index].is_reverse));
        assert!((legs[1].end_m - (6.0 + quarter_m)).abs() < 1e-9);
        // Driven backwards to (2, -4), the robot looks along y.
        assert!((course.robot_yaw(6.0 + quarter_m) - PI / 2.0).abs() < 1e-9);
        assert!((course.robot_yaw(6.5 + quarter_m) - PI / 2.0).abs() < 1e-9);
        assert!((course.at(7.0).curvature.abs() - 0.25).abs() < 1e-9);
        // Behind its ends a leg goes straight on, also where the whole course turns back.
        let beyond = legs[0].course.at(7.0);
        assert!((beyond.point.x - 7.0).abs() < 1e-9 && beyond.curvature == 0.0);
        let before = legs[1].course.within(Vector2::new(6.5, 0.0), [4.0, 9.0]);
        assert!((before[0] - 5.5).abs() < 1e-9, "{before:?}");
    }

    #[test]
    fn a_robot_is_followed_over_the_ends_of_legs() {
        let course = course();
        let mut follower = LegFollower::new(&course, 0.0);
        for step in 0..=58 {
            let state = State { x: 0.1 * f64::from(step), ..State::default() };
            assert!((follower.follow(&state).x - state.x).abs() < 0.61);
        }
        // Backwards over the place where it was before.
        for step in 0..=20 {
            let along_m = 6.0 + 0.1 * f64::from(step);
            let point = course.at(along_m).point;
            let yaw = course.robot_yaw(along_m.max(6.01));
            let place = follower.follow(&State { x: point.x, y: point.y, yaw, ..State::default() });
            assert!((place.x - along_m).abs() < 0.02 && place.yaw.abs() < 0.02, "{along_m}: {place:?}");
        }
    }

    #[test]
    fn a_course_from_its_end_has_the_same_places() {
        let quarter = vec![
            Waypoint::new(0.0, 0.0, Some(0.0)),
            Waypoint::new(5.0, 0.0, Some(0.0)),
            Waypoint::new(9.0, 4.0, Some(PI / 2.0)),
        ];
        let course = Course::try_from(CourseKeys { waypoints: quarter, ..CourseKeys::default() }).unwrap();
        let back = course.returned([0.0, 1.0]);
        for along_m in [-1.0, 2.0, 7.0, 10.0, 12.0] {
            let (there, here) = (course.at(along_m), back.at(course.length_m() - along_m));
            assert!((there.point - here.point).norm() < 1e-9, "{along_m}");
            assert!(wrap_angle(there.yaw - here.yaw - PI).abs() < 1e-9);
        }
        let line = Course::default().returned([2.0, 12.0]);
        let point = line.at(3.0);
        assert!((point.point - Vector2::new(11.0, 0.0)).norm() < 1e-9 && !line.is_line());
        assert_eq!(line.locate(Vector2::new(4.0, -1.0)).map(|value| (1e9 * value).round()), [1e10, 1e9]);
    }

    #[test]
    fn a_course_without_reverse_has_one_leg_and_one_that_begins_backwards_is_refused() {
        let waypoints = vec![Waypoint::default(), Waypoint::new(5.0, 0.0, None)];
        let plain =
            Course::try_from(CourseKeys { waypoints: waypoints.clone(), ..CourseKeys::default() }).unwrap();
        assert_eq!(plain.legs(), [Leg { course: plain.clone(), is_reverse: false, end_m: f64::INFINITY }]);
        let mut backwards = waypoints;
        backwards[1].reverse = true;
        let refused = Course::try_from(CourseKeys { waypoints: backwards, ..CourseKeys::default() });
        assert_eq!(refused.unwrap_err().key, "waypoints[1].reverse");
        assert_eq!(Course::default().legs().len(), 1);
    }
}
