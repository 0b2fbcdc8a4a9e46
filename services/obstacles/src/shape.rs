//! Shape of a body: how far it reaches in each of 48 directions.
//!
//! Reaches (values of the support function) are kept relative to the body's reference point in fixed directions
//! of the track, so what was seen from one side stays known while the robot sees another. Where the body faces
//! the robot a reach follows what is seen, up and down with the same small gain, so that noise averages out and
//! does not widen the body. Where it faces away, points only show that it reaches at least so far: such reaches grow,
//! and shrink only where their neighbours imply it, or where beams pass beside what is seen of the body ([`cut`]).
//!
//! Where it fails: a hollow in a body is filled, and two bodies that touch are one.

use nalgebra::Vector2;
use std::f64::consts::{FRAC_PI_2, TAU};
use vehicle::frame::{heading, to_robot};
use vehicle::geometry::Rectangle;

use crate::outline::Vertex;
use crate::segment::End;

/// Directions of the reaches: 7.5 deg apart, so a box 2 m long is described at most 0.07 m too wide at each side.
pub const DIRECTIONS: usize = 48;
/// Directions in a right angle.
const QUARTER: usize = DIRECTIONS / 4;
/// Smallest gain of a reach that is seen. One in twelve: noise of 2 cm becomes 4 mm, a change takes a second.
const SEEN_GAIN: f64 = 0.08;
/// A reach that grows by more than this shows a new part of the body rather than noise [m].
const NEW_PART_M: f64 = 0.12;
/// Gain for a new part: 90 % of it after four scans, while a single wrong return soon fades.
const GROWTH_GAIN: f64 = 0.5;
/// Gain for a small growth where the body faces away: growth by noise is never undone there.
const HIDDEN_GAIN: f64 = 0.2;
/// Nearer than this to the unseen rest of a body, the outermost point seen is not its end [m].
const OPEN_M: f64 = 0.15;
/// Growth that noise alone may cause where the body faces away [m].
const DEAD_BAND_M: f64 = 0.03;
/// Less than this is not cut off [m].
const CUT_M: f64 = 0.05;
/// Sine of how far a direction may turn away from the robot while its reach still counts as seen.
const SILHOUETTE: f64 = -0.1;
/// The same for the ends across the view of a body that is up to 60 deg wide: its corners are seen, and move with it.
pub(crate) const ENDS: f64 = -0.5;
/// A turned box must measure less than this share of the straight one to be preferred.
const STRAIGHT_SHARE: f64 = 0.92;
/// How much a box along the edges is preferred: one that is 8.5 deg off them counts a sixth larger.
const EDGE_WEIGHT: f64 = 0.5;
/// A box at another angle must measure less than this share of that of the last scan: keeps the angle steady.
const STEADY_SHARE: f64 = 0.92;

/// Unit vectors of all directions, the first along the track, counter-clockwise.
#[derive(Debug, Clone)]
pub(crate) struct Directions([Vector2<f64>; DIRECTIONS]);

impl Directions {
    /// The table.
    pub(crate) fn new() -> Self {
        Self(std::array::from_fn(|index| heading(yaw_of(index))))
    }

    /// The unit vector of one direction; indices wrap.
    pub(crate) fn unit(&self, index: usize) -> Vector2<f64> {
        self.0[index % DIRECTIONS]
    }

    /// Index of the direction nearest to a vector.
    pub(crate) fn nearest(&self, vector: Vector2<f64>) -> usize {
        let turns = vector.y.atan2(vector.x) / TAU;
        (turns * DIRECTIONS as f64).round().rem_euclid(DIRECTIONS as f64) as usize % DIRECTIONS
    }
}

fn yaw_of(index: usize) -> f64 {
    index as f64 * (TAU / DIRECTIONS as f64)
}

/// How far the outline of one scan reaches.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Seen {
    /// Reach per direction from the reference point [m].
    pub(crate) reach: [f64; DIRECTIONS],
    /// What limits it at its outermost vertices: the least that is known there.
    pub(crate) end: [End; DIRECTIONS],
}

impl Seen {
    /// Reaches of the vertices from `origin`.
    pub(crate) fn of(vertices: &[Vertex], origin: Vector2<f64>, directions: &Directions) -> Self {
        let mut seen = Self { reach: [f64::NEG_INFINITY; DIRECTIONS], end: [End::Seen; DIRECTIONS] };
        let (mut silent, mut hidden) = (seen.reach, seen.reach);
        for vertex in vertices {
            let offset = vertex.at - origin;
            for (index, unit) in directions.0.iter().enumerate() {
                let reach = unit.dot(&offset);
                seen.reach[index] = seen.reach[index].max(reach);
                match vertex.end {
                    End::Seen => {}
                    End::Silent => silent[index] = silent[index].max(reach),
                    End::Hidden => hidden[index] = hidden[index].max(reach),
                }
            }
        }
        seen.end = std::array::from_fn(|index| match seen.reach[index] - OPEN_M {
            outermost if hidden[index] > outermost => End::Hidden,
            outermost if silent[index] > outermost => End::Silent,
            _ => End::Seen,
        });
        seen
    }
}

/// Reaches of a body and the angle of its box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Shape<'a> {
    /// Reach per direction from the reference point [m].
    pub(crate) reach: &'a [f32; DIRECTIONS],
    /// Direction of the box's axis, below a quarter of the directions.
    pub(crate) orientation: u32,
}

impl Shape<'_> {
    /// The box around the body whose reference point is at `reference`; its yaw lies in (-45, 45] deg.
    pub(crate) fn rectangle(&self, reference: Vector2<f64>, directions: &Directions) -> Rectangle {
        let axis = self.orientation as usize % QUARTER;
        let (mut yaw, mut shift) = (yaw_of(axis), 0);
        if axis > QUARTER / 2 {
            (yaw, shift) = (yaw - FRAC_PI_2, 3 * QUARTER);
        }
        let reach = |quarter: usize| f64::from(self.reach[(axis + shift + quarter * QUARTER) % DIRECTIONS]);
        let [front, left, back, right] = [0, 1, 2, 3].map(reach);
        let centre = reference
            + directions.unit(axis + shift) * ((front - back) / 2.0)
            + directions.unit(axis + shift + QUARTER) * ((left - right) / 2.0);
        Rectangle { centre, yaw, length: (front + back).max(0.02), width: (left + right).max(0.02) }
    }

    /// Lowest and highest coordinates of the body whose reference point is at `reference`.
    pub(crate) fn extent(&self, reference: Vector2<f64>) -> [Vector2<f64>; 2] {
        let reach = |quarter: usize| f64::from(self.reach[quarter * QUARTER]);
        let low = Vector2::new(reference.x - reach(2), reference.y - reach(3));
        let high = Vector2::new(reference.x + reach(0), reference.y + reach(1));
        [low, Vector2::new(high.x.max(low.x), high.y.max(low.y))]
    }

    /// The same along axes that are turned by `turn` around `about`.
    pub(crate) fn turned_extent(
        &self,
        turn: f64,
        about: Vector2<f64>,
        reference: Vector2<f64>,
    ) -> [Vector2<f64>; 2] {
        let offset = reference - about;
        let centre = about + to_robot(turn, offset.x, offset.y);
        let reach = |quarter: u32| self.reach_towards(turn + f64::from(quarter) * FRAC_PI_2);
        let low = centre - Vector2::new(reach(2), reach(3));
        [low, (centre + Vector2::new(reach(0), reach(1))).sup(&low)]
    }

    /// Reach in a direction between those of the table: that of the corner between the two beside it [m].
    fn reach_towards(&self, yaw: f64) -> f64 {
        const PITCH: f64 = TAU / DIRECTIONS as f64;
        let turns = (yaw / PITCH).rem_euclid(DIRECTIONS as f64);
        let first = turns.floor();
        let beyond = (turns - first) * PITCH;
        let reach = |index: usize| f64::from(self.reach[index % DIRECTIONS]);
        let (before, after) = (reach(first as usize), reach(first as usize + 1));
        (before * (PITCH - beyond).sin() + after * beyond.sin()) / PITCH.sin()
    }
}

/// Sine of how far the face of `rectangle` in direction `unit` turns towards the robot, seen from its outermost point.
pub(crate) fn facing(rectangle: &Rectangle, unit: Vector2<f64>, robot: Vector2<f64>) -> f64 {
    let (axis, across) = axes(rectangle);
    let outermost = rectangle.centre
        + axis * (rectangle.length / 2.0).copysign(axis.dot(&unit))
        + across * (rectangle.width / 2.0).copysign(across.dot(&unit));
    let view = robot - outermost;
    view.dot(&unit) / view.norm().max(1e-9)
}

fn axes(rectangle: &Rectangle) -> (Vector2<f64>, Vector2<f64>) {
    let forward = heading(rectangle.yaw);
    (forward, Vector2::new(-forward.y, forward.x))
}

/// What one scan shows of the shape.
pub(crate) struct Sighting<'a> {
    /// What was seen, from the reference point expected for this scan.
    pub(crate) seen: &'a Seen,
    /// How much of it is a move of the whole body [m].
    pub(crate) shift: Vector2<f64>,
    /// The box expected for this scan.
    pub(crate) expected: Rectangle,
    /// Where the robot stands [m].
    pub(crate) robot: Vector2<f64>,
    /// Whether beams that see nothing cut it off, so that it may reach farther than seen.
    pub(crate) is_cut: bool,
    /// How many scans have shown the body before.
    pub(crate) sightings: u32,
}

/// Updates the reaches with a sighting.
pub(crate) fn merge(reach: &mut [f32; DIRECTIONS], sighting: &Sighting<'_>, directions: &Directions) {
    let settled = (1.0 / (f64::from(sighting.sightings) + 1.0)).max(SEEN_GAIN);
    for (index, unit) in directions.0.iter().enumerate() {
        let known = f64::from(reach[index]);
        let excess = sighting.seen.reach[index] - unit.dot(&sighting.shift) - known;
        if !excess.is_finite() {
            continue;
        }
        let faced = facing(&sighting.expected, *unit, sighting.robot) > SILHOUETTE;
        let change = if excess > NEW_PART_M {
            GROWTH_GAIN * excess
        } else if faced && !(excess < 0.0 && (sighting.is_cut || sighting.seen.end[index] == End::Hidden)) {
            settled * excess
        } else {
            HIDDEN_GAIN * (excess - DEAD_BAND_M).max(0.0)
        };
        reach[index] = (known + change) as f32;
    }
    tighten(reach);
}

/// Limits every reach to the corner that its two neighbours form.
fn tighten(reach: &mut [f32; DIRECTIONS]) {
    let limit = 0.5 / (TAU / DIRECTIONS as f64).cos();
    for index in 0..DIRECTIONS {
        let before = f64::from(reach[(index + DIRECTIONS - 1) % DIRECTIONS]);
        let after = f64::from(reach[(index + 1) % DIRECTIONS]);
        reach[index] = f64::from(reach[index]).min((before + after) * limit) as f32;
    }
}

/// Cuts off what lies beyond a line: where `normal` points to, more than `limit` away from the reference point. Whether
/// anything was cut off; a body that lies beyond it as a whole stays.
pub(crate) fn cut(
    reach: &mut [f32; DIRECTIONS],
    normal: Vector2<f64>,
    limit: f64,
    directions: &Directions,
) -> bool {
    // The corners between neighbouring directions.
    let step = TAU / DIRECTIONS as f64;
    let corner = |index: usize| {
        let [own, next] = [index, index + 1].map(|index| f64::from(reach[index % DIRECTIONS]));
        let unit = directions.unit(index);
        unit * own + Vector2::new(-unit.y, unit.x) * ((next - own * step.cos()) / step.sin())
    };
    let mut kept = [f64::NEG_INFINITY; DIRECTIONS];
    let mut is_cut = false;
    for index in 0..DIRECTIONS {
        let (from, to) = (corner(index), corner(index + 1));
        let [before, after] = [from, to].map(|at| normal.dot(&at) - limit);
        is_cut |= before > CUT_M;
        let on_the_line = (before * after < 0.0).then(|| from + (to - from) * (before / (before - after)));
        for at in on_the_line.into_iter().chain((before <= 0.0).then_some(from)) {
            for (reach, unit) in kept.iter_mut().zip(&directions.0) {
                *reach = reach.max(unit.dot(&at));
            }
        }
    }
    if !is_cut || kept[0] == f64::NEG_INFINITY {
        return false;
    }
    reach.iter_mut().zip(kept).for_each(|(reach, kept)| *reach = reach.min(kept as f32));
    true
}

/// Gives a body that is seen as a thin line at least the depth `depth`, away from the robot.
pub(crate) fn deepen(
    reach: &mut [f32; DIRECTIONS],
    vertices: &[Vertex],
    origin: Vector2<f64>,
    away: Vector2<f64>,
    depth: f64,
    directions: &Directions,
) {
    let back = directions.nearest(away);
    let thickness = f64::from(reach[back]) + f64::from(reach[(back + DIRECTIONS / 2) % DIRECTIONS]);
    // A tenth below the depth: a body must not be deepened again and again because of noise.
    if thickness >= 0.9 * depth {
        return;
    }
    let missing = depth - thickness.max(0.0);
    for (index, unit) in directions.0.iter().enumerate() {
        for vertex in vertices {
            let deepened = unit.dot(&(vertex.at - origin + away * missing));
            if deepened > f64::from(reach[index]) && unit.dot(&away) > 0.0 {
                reach[index] = deepened as f32;
            }
        }
    }
}

/// The angle of the box around the body: small, along the edges that were seen, and steady.
///
/// Boxes are compared by area times perimeter. Size alone does not decide: two visible sides of a box form a
/// triangle, and the box along its longest side, which is no edge, is as small. `edges` is the direction of the
/// edges as of [`trace`](crate::outline::trace), zero when unknown.
pub(crate) fn orient(
    reach: &[f32; DIRECTIONS],
    edges: Vector2<f64>,
    current: u32,
    directions: &Directions,
) -> u32 {
    let edges = edges.try_normalize(1e-9).unwrap_or_default();
    let side = |axis: usize| (f64::from(reach[axis]) + f64::from(reach[axis + 2 * QUARTER])).max(0.05);
    let mut best = (f64::INFINITY, 0);
    for axis in 0..QUARTER {
        let (length, width) = (side(axis), side(axis + QUARTER));
        let along = 1.0 - EDGE_WEIGHT * edges.dot(&directions.unit(4 * axis));
        let straight = if axis == 0 { STRAIGHT_SHARE } else { 1.0 };
        let steady = if axis == current as usize { STEADY_SHARE } else { 1.0 };
        let measured = length * width * (length + width) * along * straight * steady;
        if measured < best.0 {
            best = (measured, axis);
        }
    }
    best.1 as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reaches(rectangle: &Rectangle, origin: Vector2<f64>) -> [f32; DIRECTIONS] {
        let vertices = rectangle.corners().map(|at| Vertex { at, end: End::Seen });
        Seen::of(&vertices, origin, &Directions::new()).reach.map(|reach| reach as f32)
    }

    #[test]
    fn a_box_is_read_back_from_its_reaches() {
        let origin = Vector2::new(4.0, 0.5);
        for yaw in [0.0, TAU / 12.0, -TAU / 12.0, 0.785, 0.8] {
            let truth = Rectangle { centre: Vector2::new(5.0, 0.2), yaw, length: 2.0, width: 0.3 };
            let reach = reaches(&truth, origin);
            let directions = Directions::new();
            let shape =
                Shape { reach: &reach, orientation: orient(&reach, Vector2::zeros(), 0, &directions) };
            let found = shape.rectangle(origin, &directions);
            assert!((found.centre - truth.centre).norm() < 1e-6, "{yaw}");
            // The nearest of the directions is at most 0.015 rad off in this list: 3 cm over 2 m.
            assert!(
                (found.length - 2.0).abs() < 0.01 && (found.width - 0.3).abs() < 0.035,
                "{yaw}: {found:?}"
            );
        }
    }

    #[test]
    fn two_visible_sides_show_the_angle_of_the_box() {
        let directions = Directions::new();
        let truth = Rectangle { centre: Vector2::zeros(), yaw: TAU / 8.0, length: 2.0, width: 0.3 };
        let [_, back, right_back, right] = truth.corners().map(|at| Vertex { at, end: End::Seen });
        let seen = Seen::of(&[back, right_back, right], Vector2::zeros(), &directions);
        let reach = seen.reach.map(|reach| reach as f32);
        // Four times 45 deg is 180 deg.
        let axis = orient(&reach, Vector2::new(-4.0, 0.0), 0, &directions);
        assert_eq!(axis, 6);
    }

    #[test]
    fn faces_towards_the_robot_are_seen_and_the_back_is_not() {
        let body = Rectangle { centre: Vector2::new(5.0, 0.0), yaw: 0.0, length: 2.0, width: 0.4 };
        let robot = Vector2::zeros();
        let is_faced = |body, unit, robot| facing(body, unit, robot) > SILHOUETTE;
        assert!(is_faced(&body, Vector2::new(-1.0, 0.0), robot));
        assert!(is_faced(&body, Vector2::new(0.0, 1.0), robot), "the silhouette counts as seen");
        assert!(!is_faced(&body, Vector2::new(1.0, 0.0), robot));
        let beside = Vector2::new(5.0, 1.0);
        assert!(
            is_faced(&body, Vector2::new(0.0, 1.0), beside)
                && !is_faced(&body, Vector2::new(0.0, -1.0), beside)
        );
    }

    #[test]
    fn a_box_reaches_as_far_along_turned_axes_as_its_corners() {
        let truth = Rectangle { centre: Vector2::new(5.0, 0.2), yaw: 0.0, length: 2.0, width: 0.3 };
        let reach = reaches(&truth, Vector2::new(4.0, 0.5));
        let shape = Shape { reach: &reach, orientation: 0 };
        for turn in [0.0, 0.3, -1.0, FRAC_PI_2, 3.0, 7.0] {
            let [low, high] = shape.turned_extent(turn, truth.centre, Vector2::new(4.0, 0.5));
            let (sin, cos) = f64::sin_cos(turn);
            let half = Vector2::new(cos.abs() + 0.15 * sin.abs(), sin.abs() + 0.15 * cos.abs());
            // Corners between the directions are 1 / cos 3.75 deg too far at most: 2 mm of 1 m.
            assert!((high - truth.centre - half).amax() < 2.5e-3, "{turn}: {high:?}");
            assert!((truth.centre - low - half).amax() < 2.5e-3, "{turn}: {low:?}");
        }
    }

    #[test]
    fn what_lies_beyond_a_line_is_cut_off() {
        let directions = Directions::new();
        let origin = Vector2::new(1.0, 2.0);
        let whole = Rectangle { centre: Vector2::new(1.5, 2.0), yaw: 0.0, length: 2.0, width: 1.0 };
        let mut reach = reaches(&whole, origin);
        // Along x it reaches from -0.5 to 1.5 m; what is beyond 0.5 m goes.
        assert!(cut(&mut reach, Vector2::new(1.0, 0.0), 0.5, &directions));
        let left = Shape { reach: &reach, orientation: 0 }.rectangle(origin, &directions);
        assert!((left.length - 1.0).abs() < 1e-5 && (left.width - 1.0).abs() < 1e-5, "{left:?}");
        assert!((left.centre - Vector2::new(1.0, 2.0)).norm() < 1e-5, "{left:?}");
        // A corner is cut off at an angle, and the sides stay: x + y reaches 1.0 m.
        let normal = Vector2::new(1.0, 1.0) / 2.0_f64.sqrt();
        assert!(cut(&mut reach, normal, 0.5, &directions));
        let at = |index: usize| f64::from(reach[index]);
        assert!((at(QUARTER / 2) - 0.5).abs() < 1e-5 && (at(0) - 0.5).abs() < 1e-5, "{reach:?}");
        // Less than 5 cm, nothing, and all of it stay.
        for limit in [0.46, 0.8, -2.0] {
            let before = reach;
            assert!(!cut(&mut reach, Vector2::new(1.0, 0.0), limit, &directions));
            assert_eq!(reach, before);
        }
    }
}
