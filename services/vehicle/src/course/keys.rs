//! The keys of a course.

use key_table::{Invalid, settings};

use super::{Course, Piece, Widths, biarc, legs, turning};
use crate::track::Surroundings;

/// Most waypoints.
const MAX_WAYPOINTS: usize = 5_000;
/// The way from one waypoint to the next is at most this many times their distance.
const MAX_DETOUR: f64 = 10.0;
/// Smallest distance from one waypoint to the next [m].
const APART_M: f64 = 0.05;

settings! {
    /// A point that the course leads through.
    #[derive(Copy)]
    pub struct Waypoint {
        /// Position in the plane [m].
        pub x_m: f64 = 0.0, (-1e4..=1e4, "with bends that the robot can follow");
        /// Position in the plane, to the left of x [m].
        pub y_m: f64 = 0.0, (-1e4..=1e4, "with bends that the robot can follow");
        /// Direction of the course there; without the key that of the circle through it and the waypoints beside it [rad].
        pub yaw_rad: Option<f64> = None, (-7.0..=7.0, "with bends that the robot can follow");
        /// Largest velocity from there to the next waypoint; without the key `controller.cruise_mps` [m/s].
        pub speed_mps: Option<f64> = None, (0.01..=10.0, "at least `vehicle.bounds.velocity_min_mps`");
        /// Whether the way to it from the waypoint before is driven backwards. Where the robot changes between forwards and
        /// backwards, it stands for a moment; `yaw_rad` is the direction of the robot there.
        pub reverse: bool = false;
    }
}

impl Waypoint {
    /// A point that the course leads through, in a direction if one is given.
    pub fn new(x_m: f64, y_m: f64, yaw_rad: Option<f64>) -> Self {
        Self { x_m, y_m, yaw_rad, ..Self::default() }
    }
}

settings! {
    /// The way that the robot follows, where it is no line along x.
    pub struct CourseKeys {
        /// The course leads through these points in their order, from one to the next by two arcs.
        pub waypoints: Vec<Waypoint> = Vec::new();
        /// Instead of waypoints: a CSV file of points along the course, beside the scenario, with the columns `x_m`, `y_m` and,
        /// if need be, `speed_mps`. Enough of them become waypoints that no point is farther than 5 cm from the course.
        pub path: Option<String> = None, "a file";
        /// Width of the way: the robot's centre stays within half of it to either side. A number, or a list with one number for
        /// each way from a waypoint to the next [m].
        pub width_m: Widths = Widths::default();
        /// Without waypoints: radius of the turns that lead to the goals; also to those behind the robot, by turning round,
        /// backwards in the middle. Without the key the course only bends as far as it must [m].
        pub turn_radius_m: Option<f64> = None, (0.2..=100.0, "at least the smallest planned turn");
        /// How often the course is driven: several times where its last waypoint is its first one.
        pub laps: u32 = 1, (1.0..=100.0, "1 where the course is not closed");
        /// What the scanner sees outside of the way: as in `[track]`, where `hall` has its walls 2 m beside it.
        pub surroundings: Surroundings = Surroundings::Hall;
    }
}

impl TryFrom<CourseKeys> for Course {
    type Error = Invalid;

    fn try_from(keys: CourseKeys) -> Result<Self, Invalid> {
        if let Some(path) = &keys.path {
            let allowed = "a file that is read with the scenario, from a file of its own";
            return Err(Invalid::new("path", path, allowed));
        }
        let points = &keys.waypoints;
        // Numbers that are no positions are named by the rules of the keys.
        if points.is_empty() || keys.require_ranges().is_err() {
            return Ok(Self { keys, ..Self::default() });
        }
        if !(2..=MAX_WAYPOINTS).contains(&points.len()) {
            let allowed = format!("2 to {MAX_WAYPOINTS} of them");
            return Err(Invalid::new("waypoints", format!("{} waypoints", points.len()), allowed));
        }
        let [first, last] = [points[0], points[points.len() - 1]];
        for (index, pair) in points.windows(2).enumerate() {
            let apart_m = (pair[1].x_m - pair[0].x_m).hypot(pair[1].y_m - pair[0].y_m);
            if apart_m < APART_M {
                let place = format!("({}, {})", pair[1].x_m, pair[1].y_m);
                let allowed = format!("at least {APART_M} m from the one before");
                return Err(Invalid::new(&format!("waypoints[{}]", index + 1), place, allowed));
            }
        }
        keys.width_m.require_parts(points.len() - 1)?;
        let is_closed = (first.x_m, first.y_m) == (last.x_m, last.y_m);
        if keys.laps > 1 && !is_closed {
            let allowed = "1 where the last waypoint is another place than the first one";
            return Err(Invalid::new("laps", keys.laps, allowed));
        }
        if points[1].reverse {
            let allowed = "a course that begins forwards: what is behind the robot at the start was not seen";
            return Err(Invalid::new("waypoints[1].reverse", true, allowed));
        }
        if keys.laps > 1 && points.iter().any(|point| point.reverse) {
            return Err(Invalid::new("laps", keys.laps, "1 where a part of the course is driven backwards"));
        }
        let pieces = legs::through(points, is_closed);
        for (index, (pair, arcs)) in points.windows(2).zip(pieces.chunks(2)).enumerate() {
            let apart_m = (pair[1].x_m - pair[0].x_m).hypot(pair[1].y_m - pair[0].y_m);
            if arcs.iter().map(|arc| arc.length_m).sum::<f64>() > MAX_DETOUR * apart_m {
                let place = format!("({}, {})", pair[1].x_m, pair[1].y_m);
                let allowed = "a place that the way leads to without turning back";
                return Err(Invalid::new(&format!("waypoints[{}]", index + 1), place, allowed));
            }
        }
        let mut pieces = biarc::laps(pieces, keys.laps);
        for piece in &mut pieces {
            piece.speed_mps = points[piece.waypoint].speed_mps.unwrap_or(f64::INFINITY);
            piece.half_width_m = keys.width_m.of_part(piece.waypoint) / 2.0;
        }
        let length_m = pieces.last().map_or(0.0, |piece| piece.begin_m + piece.length_m);
        let turns_back = points.iter().any(|point| point.reverse);
        let course = Self { pieces: pieces.into(), begin_m: 0.0, length_m, turns_back, keys };
        let too_wide = course.pieces.iter().find(|piece| 1.0 / piece.curvature.abs() <= piece.half_width_m);
        if let Some(Piece { waypoint, curvature, half_width_m, .. }) = too_wide {
            let value = format!("a bend with a radius of {:.2} m", 1.0 / curvature.abs());
            let allowed = format!("above {half_width_m} m, half of width_m");
            return Err(Invalid::new(&format!("waypoints[{waypoint}]"), value, allowed));
        }
        Ok(course)
    }
}

impl CourseKeys {
    /// These keys with a course that leads through some places.
    #[must_use]
    pub fn through(&self, places: Vec<Waypoint>) -> Self {
        let waypoints = match (self.turn_radius_m, &places[..]) {
            (Some(radius_m), [first, others @ ..]) => {
                let mut waypoints = vec![*first];
                for place in others {
                    let from = waypoints[waypoints.len() - 1];
                    waypoints.extend(turning::between(&from, place, radius_m));
                }
                waypoints
            }
            _ => places,
        };
        Self { waypoints, ..self.clone() }
    }
}
