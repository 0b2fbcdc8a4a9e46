//! Outline of a cluster: a few vertices instead of many noisy returns.
//!
//! A cluster is split at its corners (iterative end point fit) and each piece is replaced by its total least squares
//! line, so that the noise of the ranges is averaged over the returns of a face. The end of a body lies between its
//! last return and the next beam that misses it, so the line is extended by half the spacing.

use nalgebra::Vector2;

use crate::points::{Place, Point};
use crate::segment::{Cluster, End};

/// A corner or end of an outline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Vertex {
    /// Where it is [m].
    pub(crate) at: Vector2<f64>,
    /// What is next to it; corners count as seen.
    pub(crate) end: End,
}

/// Largest number of pieces of one outline that wait to be split.
const STACK: usize = 32;

/// Appends the outline of one cluster, seen from `place` with `pitch` from beam to beam, to `vertices` and returns the
/// direction of its edges.
///
/// That is the sum of (cos, sin) of four times the angle of each edge, weighted by its squared length: edges of
/// a box, which are at right angles, add up. Edges of fewer than four returns do not count.
pub(crate) fn trace(
    cluster: &Cluster,
    members: &[Point],
    (place, pitch): (&Place, f64),
    range_noise: f64,
    vertices: &mut Vec<Vertex>,
) -> Vector2<f64> {
    let mut edges = Vector2::zeros();
    let count = members.len();
    let mut stack = [(0, 0); STACK];
    stack[0] = (0, count - 1);
    let mut depth = 1;
    while depth > 0 {
        depth -= 1;
        let (first, last) = stack[depth];
        if depth + 2 <= STACK
            && let Some(corner) = corner(&members[first..=last], range_noise)
        {
            stack[depth] = (first + corner, last);
            stack[depth + 1] = (first, first + corner);
            depth += 2;
            continue;
        }
        let piece = &members[first..=last];
        let line = Line::fit(piece);
        let mut ends = [line.nearest(piece[0].at), line.nearest(piece[piece.len() - 1].at)];
        if first == 0 {
            ends[0] -= line.direction * half_spacing(&piece[0], line.direction, place, pitch);
        }
        if last == count - 1 {
            ends[1] += line.direction * half_spacing(&piece[piece.len() - 1], line.direction, place, pitch);
        }
        let end = |is_end: bool, end: End| if is_end { end } else { End::Seen };
        vertices.push(Vertex { at: ends[0], end: end(first == 0, cluster.ends[0]) });
        vertices.push(Vertex { at: ends[1], end: end(last == count - 1, cluster.ends[1]) });
        if piece.len() >= 4 {
            let double = squared(line.direction);
            edges += squared(double) * (ends[1] - ends[0]).norm_squared();
        }
    }
    edges
}

/// The unit vector at twice the angle.
fn squared(unit: Vector2<f64>) -> Vector2<f64> {
    Vector2::new(unit.x * unit.x - unit.y * unit.y, 2.0 * unit.x * unit.y)
}

/// Index of the return at which a piece is to be split, `None` when one line explains it.
fn corner(piece: &[Point], range_noise: f64) -> Option<usize> {
    let count = piece.len();
    if count < 4 {
        return None;
    }
    let chord = piece[count - 1].at - piece[0].at;
    let length = chord.norm();
    if length < 1e-6 {
        return None;
    }
    let normal = Vector2::new(-chord.y, chord.x) / length;
    let mut worst = (0.0, 0);
    for (index, point) in piece.iter().enumerate().take(count - 1).skip(1) {
        let deviation = normal.dot(&(point.at - piece[0].at)).abs();
        if deviation > worst.0 {
            worst = (deviation, index);
        }
    }
    // Noise of the ends alone gives deviations of up to 3.5 sigma; the fit decides whether there is a corner.
    let bent = worst.0 > 3.5 * range_noise && Line::fit(piece).rms > 1.5 * range_noise;
    bent.then_some(worst.1)
}

/// Half of the distance along the line to where the next beam would hit it, at most 5 cm.
fn half_spacing(end: &Point, direction: Vector2<f64>, place: &Place, pitch: f64) -> f64 {
    let ray = (end.at - place.at).try_normalize(1e-9).unwrap_or(direction);
    let sine = (ray.x * direction.y - ray.y * direction.x).abs();
    (0.5 * pitch * end.range / sine.max(0.1)).min(0.05)
}

/// A total least squares line.
struct Line {
    centre: Vector2<f64>,
    direction: Vector2<f64>,
    rms: f64,
}

impl Line {
    /// The line through at least one point, directed from the first to the last.
    fn fit(piece: &[Point]) -> Self {
        let share = 1.0 / piece.len() as f64;
        let centre = piece.iter().fold(Vector2::zeros(), |sum, point| sum + point.at) * share;
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for point in piece {
            let offset = point.at - centre;
            xx += offset.x * offset.x;
            xy += offset.x * offset.y;
            yy += offset.y * offset.y;
        }
        let (sin, cos) = (0.5 * (2.0 * xy).atan2(xx - yy)).sin_cos();
        let mut direction = Vector2::new(cos, sin);
        if direction.dot(&(piece[piece.len() - 1].at - piece[0].at)) < 0.0 {
            direction = -direction;
        }
        let across = xx * sin * sin - 2.0 * xy * sin * cos + yy * cos * cos;
        Self { centre, direction, rms: (across.max(0.0) * share).sqrt() }
    }

    fn nearest(&self, point: Vector2<f64>) -> Vector2<f64> {
        self.centre + self.direction * self.direction.dot(&(point - self.centre))
    }
}
