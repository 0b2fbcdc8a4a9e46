//! Parting at hollows: a surface that bends away from the robot is cut where it is deepest.
//!
//! Reaches describe convex bodies, see [`shape`](crate::shape). Kept as one body, a corner of a room would fill the
//! room, and two boxes that touch the space between them. So each cluster is cut into parts that bulge towards the
//! robot, as the visible side of a convex body does; the parts next to each other are different bodies.
//!
//! Returns come in the order of their direction. The front of a convex body then turns right at each return, and a
//! hollow is what lies behind the chord between two returns of that front.
//!
//! Where it fails: a hollow that is not deeper than [`HOLLOW_M`] is filled.

use crate::hull::{HOLLOW_M, cross};
use crate::points::Point;
use crate::segment::{End, HIDING_M, Segments, may_start};

/// The noise of single returns makes no hollow: at least so many standard deviations of a range.
const HOLLOW_SIGMAS: f64 = 5.0;
/// So many returns show a part.
const ENOUGH: usize = 3;

impl Segments {
    /// Parts the clusters at their hollows.
    pub(crate) fn part_at_hollows(&mut self, range_noise: f64) {
        let Self { members, clusters, parts, front, ahead, .. } = self;
        let depth = HOLLOW_M.max(HOLLOW_SIGMAS * range_noise);
        parts.clear();
        for cluster in clusters.iter() {
            let mut rest = *cluster;
            // The part on the right is convex before the next one begins, so the order is kept.
            while let Some(cut) = first_cut(&members[rest.first..rest.end], depth, front) {
                let (mut part, at) = (rest, rest.first + cut);
                let (right, left) = (members[at - 1].range, members[at].range);
                part.end = at;
                part.ends[1] = end(right, left);
                (rest.first, rest.ends[0]) = (at, end(left, right));
                for part in [&mut part, &mut rest] {
                    part.may_start &= may_start(&members[part.first..part.end], *ahead, range_noise);
                }
                parts.push(part);
            }
            parts.push(rest);
        }
        std::mem::swap(clusters, parts);
    }
}

/// What is next to a cut, for a part with the range `own` there: what is nearer may hide more of it.
fn end(own: f64, other: f64) -> End {
    if other < own - HIDING_M { End::Hidden } else { End::Seen }
}

/// Index of the first return behind the first cut; `None` when the surface has no hollow deeper than `depth`.
fn first_cut(members: &[Point], depth: f64, front: &mut Vec<usize>) -> Option<usize> {
    let mut end = members.len();
    let mut cut = None;
    // A cut may leave a hollow on its right side.
    while let Some(deepest) = deepest(&members[..end], depth, front) {
        (end, cut) = (deepest, Some(deepest));
    }
    cut
}

/// Index of the return at the bottom of the deepest hollow, if that is deeper than `depth`.
fn deepest(members: &[Point], depth: f64, front: &mut Vec<usize>) -> Option<usize> {
    front.clear();
    for (index, member) in members.iter().enumerate() {
        while let [.., before, last] = front[..]
            && turn(&members[before], &members[last], member) > 0.0
        {
            front.pop();
        }
        front.push(index);
    }
    let mut best = (depth, None);
    for chord in front.windows(2) {
        let (from, to) = (chord[0], chord[1]);
        for index in (from + 1).max(ENOUGH)..to.min((members.len() + 1).saturating_sub(ENOUGH)) {
            let behind = |index: usize| distance_behind(&members[from], &members[to], &members[index]);
            // One or two returns behind the others are noise: the chord leads through those that noise brought nearest.
            let here = behind(index);
            if here > best.0 && behind(index - 1).min(behind(index + 1)) > depth {
                best = (here, Some(index));
            }
        }
    }
    best.1
}

/// Positive where the way from `a` over `b` to `c` turns left.
fn turn(a: &Point, b: &Point, c: &Point) -> f64 {
    cross(b.at - a.at, c.at - b.at)
}

/// How far a return is behind the chord from `a` to `b`, seen from the robot [m].
fn distance_behind(a: &Point, b: &Point, point: &Point) -> f64 {
    let (chord, offset) = (b.at - a.at, point.at - a.at);
    let length = chord.norm();
    if length < 1e-6 { offset.norm() } else { -cross(chord, offset) / length }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::points::Beams;
    use crate::segment::Cluster;

    /// Returns along straight lines from corner to corner, 5 cm apart.
    fn along(corners: &[[f64; 2]]) -> Vec<Point> {
        let mut points = Vec::new();
        for pair in corners.windows(2) {
            let [from, to] = [pair[0], pair[1]].map(Vector2::from);
            let count = ((to - from).norm() / 0.05).round() as usize;
            points.extend((0..count).map(|step| from + (to - from) * (step as f64 / count as f64)));
        }
        let point = |(beam, at): (usize, Vector2<f64>)| Point { at, range: at.norm(), beam };
        points.into_iter().enumerate().map(point).collect()
    }

    /// Where the surface is cut.
    fn cuts(corners: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let mut segments = Segments::with_capacity(&Beams::urg(), 0.0);
        segments.members = along(corners);
        let end = segments.members.len();
        segments.clusters = vec![Cluster { first: 0, end, may_start: true, ends: [End::Seen; 2] }];
        segments.part_at_hollows(0.01);
        let firsts = segments.clusters.iter().skip(1).map(|part| segments.members[part.first].at);
        firsts.map(|at| [at.x, at.y].map(|value| (value * 100.0).round() / 100.0)).collect()
    }

    #[test]
    fn the_front_of_a_convex_body_stays_whole() {
        // A box that shows one face, two faces, and a bow of six faces.
        assert!(cuts(&[[4.0, -1.0], [4.0, 1.0]]).is_empty());
        assert!(cuts(&[[5.0, -1.0], [4.0, -0.5], [4.0, 1.0]]).is_empty());
        assert!(cuts(&[[4.4, -0.8], [4.1, -0.4], [4.0, 0.0], [4.1, 0.4], [4.4, 0.8]]).is_empty());
    }

    #[test]
    fn a_room_is_parted_at_each_of_its_corners() {
        assert_eq!(cuts(&[[0.5, -1.0], [4.0, -1.0], [4.0, 1.0]]), [[4.0, -1.0]]);
        let room = [[0.5, -1.0], [4.0, -1.0], [4.0, 1.0], [0.5, 1.0]];
        assert_eq!(cuts(&room), [[4.0, -1.0], [4.0, 1.0]]);
    }

    #[test]
    fn two_boxes_one_behind_the_other_are_parted_where_they_touch() {
        // The front of the right box is 0.3 m nearer; its side is hidden.
        assert_eq!(cuts(&[[4.0, -0.5], [4.0, 0.0], [4.3, 0.05], [4.3, 0.5]]), [[4.3, 0.05]]);
        // A post before a wall: what is on its left and on its right is of the wall.
        let post = [[4.0, -1.0], [4.0, -0.1], [3.7, -0.05], [3.7, 0.2], [4.0, 0.25], [4.0, 1.0]];
        assert_eq!(cuts(&post).len(), 2);
    }

    #[test]
    fn a_shallow_hollow_and_a_wrong_return_part_nothing() {
        assert!(cuts(&[[4.0, -1.0], [4.09, 0.0], [4.0, 1.0]]).is_empty());
        let mut segments = Segments::with_capacity(&Beams::urg(), 0.0);
        segments.members = along(&[[4.0, -1.0], [4.0, 1.0]]);
        segments.members[20].at.x = 4.3;
        assert_eq!(deepest(&segments.members, HOLLOW_M, &mut Vec::new()), None);
    }
}
