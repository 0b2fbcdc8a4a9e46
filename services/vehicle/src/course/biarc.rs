//! Two arcs from one waypoint to the next, which leave and arrive in given directions.
//!
//! Of the arcs that do so, those whose joint is equally far from both ends along their tangents are taken: they are
//! a single arc, or a line, where one fits. (K. M. Bolton, Biarc curves, Computer-Aided Design 7, 1975,
//! DOI 10.1016/0010-4485(75)90086-X.)

use nalgebra::Vector2;

use super::{Piece, Waypoint};
use crate::frame::{heading, wrap_angle};

/// The pieces through all waypoints, at least two. A course that is closed has one direction where it begins and ends.
pub(super) fn through(waypoints: &[Waypoint], is_closed: bool) -> Vec<Piece> {
    let points: Vec<_> = waypoints.iter().map(|waypoint| Vector2::new(waypoint.x_m, waypoint.y_m)).collect();
    let mut yaws = directions(waypoints, &points);
    if is_closed {
        let last = points.len() - 1;
        let [begin, end] = [waypoints[0].yaw_rad, waypoints[last].yaw_rad];
        let joint =
            begin.or(end).unwrap_or_else(|| tangent(points[last] - points[last - 1], points[1] - points[0]));
        (yaws[0], yaws[last]) = (joint, joint);
    }
    let mut pieces: Vec<Piece> = Vec::with_capacity(2 * waypoints.len());
    let mut yaw = yaws[0];
    for index in 0..points.len() - 1 {
        let ends = [points[index], points[index + 1]];
        let [first, last] = [yaws[index], yaws[index + 1]].map(heading);
        let joint = joint(ends, [first, last]);
        for (from, to) in [(ends[0], joint), (joint, ends[1])] {
            let begin_m = pieces.last().map_or(0.0, |piece| piece.begin_m + piece.length_m);
            let piece = arc(from, yaw, to, begin_m, index);
            yaw += piece.curvature * piece.length_m;
            pieces.push(piece);
        }
    }
    pieces
}

/// Directions at the waypoints.
fn directions(waypoints: &[Waypoint], points: &[Vector2<f64>]) -> Vec<f64> {
    let way = |index: usize| points[index + 1] - points[index];
    let last = points.len() - 1;
    let mut yaws: Vec<f64> = (0..=last)
        .map(|index| {
            let [before, after] = [index.max(1) - 1, index.min(last - 1)].map(way);
            waypoints[index].yaw_rad.unwrap_or_else(|| tangent(before, after))
        })
        .collect();
    // At an end without a direction the arc to the waypoint beside it is a single one.
    if waypoints[0].yaw_rad.is_none() {
        yaws[0] = yaw(way(0)) - wrap_angle(yaws[1] - yaw(way(0)));
    }
    if waypoints[last].yaw_rad.is_none() {
        yaws[last] = yaw(way(last - 1)) + wrap_angle(yaw(way(last - 1)) - yaws[last - 1]);
    }
    yaws
}

/// The direction between two ways of the circle through their three ends [rad].
fn tangent(before: Vector2<f64>, after: Vector2<f64>) -> f64 {
    yaw(before / before.norm_squared() + after / after.norm_squared())
}

fn yaw(way: Vector2<f64>) -> f64 {
    way.y.atan2(way.x)
}

/// The pieces of a closed course, driven several times.
pub(super) fn laps(pieces: Vec<Piece>, laps: u32) -> Vec<Piece> {
    let Some(last) = pieces.last() else { return pieces };
    let length_m = last.begin_m + last.length_m;
    let turn = last.yaw + last.curvature * last.length_m - pieces[0].yaw;
    let lap = |lap: u32| {
        let lap = f64::from(lap);
        pieces.iter().map(move |piece| Piece {
            begin_m: piece.begin_m + lap * length_m,
            yaw: piece.yaw + lap * turn,
            ..*piece
        })
    };
    (0..laps).flat_map(lap).collect()
}

/// Where the two arcs between `ends` with these directions meet.
fn joint([from, to]: [Vector2<f64>; 2], [first, last]: [Vector2<f64>; 2]) -> Vector2<f64> {
    let way = to - from;
    let (ahead, bend) = (way.dot(&(first + last)), 2.0 * (1.0 - first.dot(&last)));
    // bend d^2 + 2 ahead d = way^2 with d > 0, in the form that holds for parallel directions as well.
    let root = (ahead * ahead + bend * way.norm_squared()).sqrt();
    let length = way.norm_squared() / (ahead + root).max(1e-9 * way.norm());
    (from + first * length + to - last * length) / 2.0
}

/// The arc that leaves `from` in direction `yaw` and ends at `to`.
fn arc(from: Vector2<f64>, yaw: f64, to: Vector2<f64>, begin_m: f64, waypoint: usize) -> Piece {
    let (way, along) = (to - from, heading(yaw));
    let chord = way.norm();
    let half = along.perp(&way).atan2(along.dot(&way));
    let straight = half.abs() < 1e-9 || chord < 1e-9;
    let (length_m, curvature) =
        if straight { (chord, 0.0) } else { (chord * half / half.sin(), 2.0 * half.sin() / chord) };
    Piece { begin_m, length_m, point: from, yaw, curvature, waypoint, ..Piece::default() }
}
