//! Ellipses that the robot's centre stays outside of, (7.32)-(7.35).
//!
//! (7.35) uses the width of an obstacle only: b = |y_begin - y_end| + 2 theta, a = 1.2 m or 1.15 b. That ellipse keeps
//! the robot's body clear of obstacles up to about half a metre deep. Longer ones get a larger a, just large enough
//! that the ellipse holds the body's box with the robot's keep-off distance around it. Long bodies that are turned,
//! and very long ones, are cut into pieces along their length, each with an ellipse of its own: one ellipse around a
//! turned body would close the corridor where there is room to pass.
//!
//! The keep-off distance along the track is half the diagonal of the robot; across the track it is the robot's
//! extent at a yaw of 0.4 rad. The clearance is added to both. While the centre is outside of the ellipses the body
//! keeps the clearance, as long as the robot drives roughly along their boundary.
//!
//! Source note: (7.32), (7.33) place the centre between the first and last boundary point, which are points of
//! the visible front. Here the centre is that of the body's box, which grows as more of the body is seen.

use nalgebra::Vector2;
use vehicle::frame::to_track;
use vehicle::geometry::Rectangle;

use crate::shape::{DIRECTIONS, Directions};
use crate::{CoverRule, ObstaclesConfig};

/// Most ellipses that cover one body.
pub(crate) const MAX_PIECES: usize = 6;
/// Largest a of a single ellipse [m]; a body of 3 m needs 2.4.
const MAX_SINGLE_M: f64 = 2.6;
/// Length of a piece [m]: about the width of the robot's corridor beside it.
const PIECE_M: f64 = 0.65;
/// Shorter bodies are not cut, however they are turned [m].
const MIN_CUT_M: f64 = 0.8;
/// A body is turned when the box along the track around it is this much larger.
const TURNED: f64 = 1.5;
/// The decision of the last scan is kept until a value is this share beyond its limit.
const KEEP: f64 = 0.1;
/// Largest yaw at which the robot passes an ellipse [rad].
const PASSING_YAW: f64 = 0.4;
/// The same for tight ellipses: at the widest place the robot drives along the track.
const TIGHT_YAW: f64 = 0.12;
/// Semi-axis across the track per reach of a piece: 1 would need an endless a.
const ROOM: f64 = 1.05;
/// The same for tight ellipses, at least and at most.
const ROOMS: [f64; 2] = [1.015, 1.2];
/// Longer bodies are cut where the course bends away from them by more than this [m].
const BOW_M: f64 = 0.03;
/// What a metre of the semi-axis along the track costs in metres of that across it.
const LENGTH_COST: f64 = 0.05;
/// Share of the interval that a step of the golden section keeps, and the number of steps.
const GOLDEN: f64 = 0.618_033_988_749_895;
const NARROWINGS: usize = 7;

/// An ellipse (7.34) with axes along and across the track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ellipse {
    /// Centre [m].
    pub(crate) centre: Vector2<f64>,
    /// Semi-axis along the track [m].
    pub(crate) a: f64,
    /// Semi-axis across the track [m].
    pub(crate) b: f64,
}

/// Ellipses of one body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cover {
    ellipses: [Ellipse; MAX_PIECES],
    count: usize,
}

impl Cover {
    /// The ellipses.
    pub(crate) fn list(&self) -> &[Ellipse] {
        &self.ellipses[..self.count]
    }
}

/// Covers a body by ellipses.
///
/// `extent` holds its lowest and highest coordinates along axes that are turned around its centre into the direction of
/// the track there, `before` the number of ellipses of the scan before (0 when there was none): near a limit the number is
/// kept. `bend_at` tells direction and curvature of the track at a point [rad, 1/m].
pub(crate) fn cover(
    config: &ObstaclesConfig,
    rectangle: &Rectangle,
    extent: &[Vector2<f64>; 2],
    before: u32,
    directions: &Directions,
    bend_at: impl Fn(Vector2<f64>) -> [f64; 2],
) -> Cover {
    let sizing = Sizing::of(config, directions);
    let [turn, curvature] = bend_at(rectangle.centre);
    let turned = Rectangle { yaw: rectangle.yaw - turn, ..*rectangle };
    let mut single = sizing.single(&turned, extent);
    if turn != 0.0 {
        let offset = single.centre - rectangle.centre;
        single.centre = rectangle.centre + to_track(turn, offset.x, offset.y);
    }
    let mut ellipses = [single; MAX_PIECES];
    let bow = curvature.abs() * spans(&turned)[0].powi(2) / 8.0;
    let Some(count) = pieces(&turned, &single, bow, before) else { return Cover { ellipses, count: 1 } };
    for (index, ellipse) in ellipses.iter_mut().enumerate().take(count) {
        let piece = piece(rectangle, index, count);
        let piece = Rectangle { yaw: piece.yaw - bend_at(piece.centre)[0], ..piece };
        *ellipse = sizing.around(piece.centre, &piece, spans(&piece)[1]);
    }
    Cover { ellipses, count }
}

/// How many pieces a body is cut into; `None` where one ellipse covers it whole.
fn pieces(rectangle: &Rectangle, single: &Ellipse, bow: f64, before: u32) -> Option<usize> {
    let length = rectangle.length.max(rectangle.width);
    let wanted = length / PIECE_M.max(rectangle.length.min(rectangle.width));
    let [dx, dy] = spans(rectangle);
    let turned = dx * dy / (rectangle.length * rectangle.width);
    // Once cut, a body stays cut until it is clearly short and straight again, and the other way round.
    let bias = if before > 1 { 1.0 - KEEP } else { 1.0 };
    let is_cut = (turned > TURNED * bias && length > MIN_CUT_M * bias)
        || single.a > MAX_SINGLE_M * bias
        || bow > BOW_M * bias;
    let before = (before as usize).clamp(1, MAX_PIECES);
    let count = (wanted - KEEP).ceil().clamp(1.0, MAX_PIECES as f64) as usize;
    let stays = count < before && wanted > before as f64 - 1.0 - 2.0 * KEEP;
    is_cut.then_some(if stays { before } else { count })
}

/// One of `count` equal pieces along the longer side.
fn piece(rectangle: &Rectangle, index: usize, count: usize) -> Rectangle {
    let Rectangle { yaw, length, width, .. } = *rectangle;
    let share = (index as f64 + 0.5) / count as f64 - 0.5;
    if length >= width {
        let centre = rectangle.centre + to_track(yaw, length, 0.0) * share;
        Rectangle { centre, length: length / count as f64, ..*rectangle }
    } else {
        let centre = rectangle.centre + to_track(yaw, 0.0, width) * share;
        Rectangle { centre, width: width / count as f64, ..*rectangle }
    }
}

/// How large ellipses are.
struct Sizing<'a> {
    config: &'a ObstaclesConfig,
    directions: &'a Directions,
    /// Distance that the robot's centre keeps from an obstacle's surface, along the track [m].
    along: f64,
    /// The same across the track [m].
    across: f64,
}

impl<'a> Sizing<'a> {
    fn of(config: &'a ObstaclesConfig, directions: &'a Directions) -> Self {
        let (yaw, clearance) = match config.cover {
            CoverRule::Tight => (TIGHT_YAW, config.tight_clearance_m),
            CoverRule::Source => (PASSING_YAW, config.clearance_m),
        };
        let (sin, cos) = yaw.sin_cos();
        let (length, width) = (config.vehicle.length_m, config.vehicle.width_m);
        let along = length.hypot(width) / 2.0 + clearance;
        let across = (length * sin + width * cos) / 2.0 + clearance;
        Self { config, directions, along, across }
    }

    /// The one ellipse of a body: its centre, see the source note on (7.32) and (7.33), and b of (7.35).
    fn single(&self, rectangle: &Rectangle, [low, high]: &[Vector2<f64>; 2]) -> Ellipse {
        let width = high.y - low.y;
        if self.config.cover == CoverRule::Tight {
            return self.around((low + high) / 2.0, rectangle, width);
        }
        let b = (width + 2.0 * self.config.safety_distance_m).max(1.03 * (width / 2.0 + self.across));
        self.ellipse((low + high) / 2.0, rectangle, b)
    }

    /// The ellipse around a rectangle of this width across the track.
    fn around(&self, centre: Vector2<f64>, rectangle: &Rectangle, width: f64) -> Ellipse {
        let reach = width / 2.0 + self.across;
        let ratio = match self.config.cover {
            CoverRule::Tight => self.tightest(centre, rectangle, reach),
            CoverRule::Source => ROOM,
        };
        self.ellipse(centre, rectangle, ratio * reach)
    }

    /// The ratio of b and `reach` with the best of both axes. The cost is convex, so noise in the rectangle changes the
    /// ellipse little.
    fn tightest(&self, centre: Vector2<f64>, rectangle: &Rectangle, reach: f64) -> f64 {
        let cost = |ratio: f64| {
            let b = ratio * reach;
            b + LENGTH_COST * (self.needed(centre, rectangle, b) - self.rule(b)).max(0.0)
        };
        let [mut low, mut high] = ROOMS;
        let mut inner = [high - GOLDEN * (high - low), low + GOLDEN * (high - low)];
        let mut costs = inner.map(cost);
        for _ in 0..NARROWINGS {
            if costs[0] <= costs[1] {
                (high, inner[1], costs[1]) = (inner[1], inner[0], costs[0]);
                inner[0] = high - GOLDEN * (high - low);
                costs[0] = cost(inner[0]);
            } else {
                (low, inner[0], costs[0]) = (inner[0], inner[1], costs[1]);
                inner[1] = low + GOLDEN * (high - low);
                costs[1] = cost(inner[1]);
            }
        }
        if costs[0] <= costs[1] { inner[0] } else { inner[1] }
    }

    /// a of (7.35) [m].
    fn rule(&self, b: f64) -> f64 {
        let ObstaclesConfig { long_axis_m, long_axis_ratio, .. } = *self.config;
        if b < long_axis_m { long_axis_m } else { long_axis_ratio * b }
    }

    /// The ellipse with semi-axis `b` and a of (7.35), enlarged so that it holds the rectangle with the distance to
    /// keep.
    fn ellipse(&self, centre: Vector2<f64>, rectangle: &Rectangle, b: f64) -> Ellipse {
        let b = b.clamp(0.01, 80.0);
        let a = self.rule(b).max(self.needed(centre, rectangle, b)).min(100.0);
        Ellipse { centre, a, b }
    }

    /// Semi-axis along the track of the smallest ellipse with `b` that holds the rectangle with the distance to keep [m].
    fn needed(&self, centre: Vector2<f64>, rectangle: &Rectangle, b: f64) -> f64 {
        let highest = if self.config.cover == CoverRule::Tight { 0.999 } else { 0.98 };
        let mut needed = 0.0_f64;
        for corner in rectangle.corners() {
            for index in (0..DIRECTIONS).step_by(3) {
                let unit = self.directions.unit(index);
                let reach = corner - centre + Vector2::new(unit.x * self.along, unit.y * self.across);
                // Near b the ellipse needs a multiple of the x; the neighbour or the bound on the ratio covers the rest.
                let height = (reach.y / b).clamp(-highest, highest);
                needed = needed.max(reach.x.abs() / (1.0 - height * height).sqrt());
            }
        }
        needed
    }
}

/// Size of a rectangle along and across the track.
fn spans(rectangle: &Rectangle) -> [f64; 2] {
    let (sin, cos) = rectangle.yaw.sin_cos();
    let (sin, cos) = (sin.abs(), cos.abs());
    [rectangle.length * cos + rectangle.width * sin, rectangle.length * sin + rectangle.width * cos]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body(length: f64, width: f64, yaw: f64) -> Rectangle {
        Rectangle { centre: Vector2::new(5.0, 0.3), yaw, length, width }
    }

    fn source() -> ObstaclesConfig {
        ObstaclesConfig { cover: CoverRule::Source, ..ObstaclesConfig::default() }
    }

    fn covered(config: &ObstaclesConfig, rectangle: &Rectangle) -> Cover {
        let [dx, dy] = spans(rectangle);
        let half = Vector2::new(dx, dy) / 2.0;
        let extent = [rectangle.centre - half, rectangle.centre + half];
        cover(config, rectangle, &extent, 0, &Directions::new(), |_| [0.0; 2])
    }

    /// Smallest distance of the robot's body to the rectangle while its centre moves around the ellipses,
    /// heading along them, by at most 0.8 rad off the track.
    fn smallest_clearance(config: &ObstaclesConfig, rectangle: &Rectangle) -> f64 {
        let cover = covered(config, rectangle);
        let mut smallest = f64::INFINITY;
        for (index, ellipse) in cover.list().iter().enumerate() {
            for step in 0..720 {
                let (sin, cos) = (f64::from(step) * std::f64::consts::TAU / 720.0).sin_cos();
                let centre = ellipse.centre + Vector2::new(ellipse.a * cos, ellipse.b * sin);
                let inside = |other: &Ellipse| {
                    let offset = centre - other.centre;
                    (offset.x / other.a).powi(2) + (offset.y / other.b).powi(2) < 1.0
                };
                if cover.list().iter().enumerate().any(|(other, ellipse)| other != index && inside(ellipse)) {
                    continue;
                }
                let slope = (-ellipse.b * cos).atan2(ellipse.a * sin.abs()).clamp(-0.8, 0.8) * sin.signum();
                let robot = Rectangle { centre, yaw: slope, length: 0.56, width: 0.40 };
                smallest = smallest.min(robot.distance_to_rectangle(rectangle));
            }
        }
        smallest
    }

    #[test]
    fn a_small_obstacle_has_the_printed_ellipse() {
        let cover = covered(&source(), &body(0.1, 0.4, 0.0));
        let [ellipse] = cover.list() else { panic!("{cover:?}") };
        assert!((ellipse.b - 0.8).abs() < 1e-12 && ellipse.a == 1.2);
        assert_eq!(ellipse.centre, Vector2::new(5.0, 0.3));
        let wide = covered(&source(), &body(0.1, 1.0, 0.0));
        assert!((wide.list()[0].a - 1.15 * 1.4).abs() < 1e-12, "a = 1.15 b for b of 1.2 m or more");
    }

    #[test]
    fn on_a_course_along_y_the_width_is_that_along_x() {
        let body = body(0.1, 0.4, 0.0);
        // Turned to the right by 90 deg, the body is 0.4 m long and 0.1 m wide.
        let half = Vector2::new(0.2, 0.05);
        let extent = [body.centre - half, body.centre + half];
        let along_y = |_| [std::f64::consts::FRAC_PI_2, 0.0];
        let cover = cover(&source(), &body, &extent, 0, &Directions::new(), along_y);
        let [ellipse] = cover.list() else { panic!("{cover:?}") };
        assert!((ellipse.b - 0.5).abs() < 1e-12 && ellipse.a == 1.2);
        assert!((ellipse.centre - body.centre).norm() < 1e-12);
    }

    #[test]
    fn the_body_keeps_its_distance_to_long_and_turned_bodies() {
        for length in [0.05, 0.3, 0.5, 0.8, 1.2, 2.0, 3.5] {
            for width in [0.05, 0.2, 0.4, 0.8, 1.2] {
                for yaw in [0.0, 0.1, 0.3, 0.8, -0.8, 1.2] {
                    let body = body(length, width, yaw);
                    let clearance = smallest_clearance(&source(), &body);
                    assert!(clearance >= 0.1, "{length} x {width} at {yaw}: {clearance}");
                    let clearance = smallest_clearance(&ObstaclesConfig::default(), &body);
                    // The body of the verification keeps 5 cm; the ellipse of a very long box may be 2 mm short of it.
                    assert!(clearance >= 0.048, "tight, {length} x {width} at {yaw}: {clearance}");
                }
            }
        }
    }

    #[test]
    fn a_long_turned_body_in_the_middle_leaves_room_to_pass() {
        let cover = covered(&source(), &Rectangle { centre: Vector2::new(5.0, 0.0), ..body(2.0, 0.3, 0.8) });
        let reach = cover.list().iter().map(|ellipse| ellipse.centre.y + ellipse.b).fold(0.0, f64::max);
        assert!(cover.list().len() > 1 && reach < 1.4, "{cover:?}");
        let straight = covered(&source(), &body(2.0, 0.4, 0.0));
        assert!(straight.list().len() == 1 && straight.list()[0].a < 1.9, "{straight:?}");
    }

    #[test]
    fn the_number_of_ellipses_is_kept_near_its_limit() {
        let near = body(0.78, 0.2, 0.8);
        let [dx, dy] = spans(&near);
        let extent = [near.centre - Vector2::new(dx, dy) / 2.0, near.centre + Vector2::new(dx, dy) / 2.0];
        let count = |before| cover(&source(), &near, &extent, before, &Directions::new(), |_| [0.0; 2]).count;
        assert_eq!((count(0), count(1), count(2)), (1, 1, 2));
    }
}
