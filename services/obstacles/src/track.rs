//! One body tracked from scan to scan: where it is, how it moves, how far it extends.

use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};
use vehicle::frame::to_robot;
use vehicle::geometry::Rectangle;

use crate::ObstaclesConfig;
use crate::motion::{Motion, Rest, agreed, noise_along};
use crate::outline::Vertex;
use crate::segment::End;
use crate::shape::{DIRECTIONS, Directions, ENDS, Seen, Shape, Sighting, cut, deepen, facing, merge, orient};
use crate::state::TrackState;

/// Identity of an ellipse: that of its body times this, plus the number of the piece.
pub(crate) const IDS_PER_BODY: u32 = 8;
/// Identities of bodies wrap after this many, so that those of ellipses fit a u32.
pub(crate) const MAX_BODY: u32 = u32::MAX / IDS_PER_BODY - 1;
/// Scans that must have shown a body before it counts as standing.
const STANDING: u32 = 5;
/// Standard deviation along an axis that a sighting does not measure [m].
const BLIND_M: f64 = 10.0;
/// A near surface that jumps farther than this has changed its shape and not its place [m].
const JUMP_M: f64 = 0.25;
/// Nearer than this an end that is seen may be another one at each scan, because the robot passes the body [m].
const ONE_END_M: f64 = 2.0;
/// How much noisier one end is than the mean of two that agree.
const ONE_END_NOISE: f64 = 2.0;
/// The place of rest is reset when it is this far from the moving place [m].
const LEFT_BEHIND_M: f64 = 0.15;
/// A body counts as moving only when it is this far from where it was first seen [m].
const MOVED_M: f64 = 0.1;
/// Three standard deviations of a velocity with two components.
const SIGNIFICANT: f64 = 11.8;
/// Less than two standard deviations: the body may have stopped.
const INSIGNIFICANT: f64 = 3.0;
/// A body this far from where it was first seen has moved, however slowly: no error of the pose does that [m].
const CARRIED_M: f64 = 0.25;
/// Sightings after which the place is an average of enough noisy scans.
const SETTLED: u32 = 12;
/// Scans in a row that must show a body moving.
const STARTS: u32 = 3;
/// Scans in a row that must show a body standing.
const STOPS: u32 = 5;
/// Weight of the edges seen before against those of a new scan: the last second counts most.
const EDGE_MEMORY: f64 = 0.9;
/// How long a body is remembered that was seen once, where nothing tells whether it is still there [s] ...
const FIRST_MEMORY_S: f64 = 0.5;
/// ... and for how many times the time that it was seen thereafter.
const MEMORY: f64 = 5.0;
/// Where nothing tells, a body may have moved with this speed [m/s], at most this far [m].
const GROWTH_MPS: f64 = 0.02;
const MAX_GROWTH_M: f64 = 0.2;
/// A body that ends this much, and this many beams, short of where it is known has not shrunk by noise [m].
const CUT_M: f64 = 0.03;
const CUT_BEAMS: f64 = 2.0;
/// A body that was found to move may have been this far beyond its box [m].
const SWEPT_M: f64 = 0.2;
/// Longest prediction of a filter at once [s].
const MAX_ELAPSED_S: f64 = 1.0;

/// A tracked body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Track {
    pub(crate) body: u32,
    pub(crate) sightings: u32,
    pub(crate) unseen_s: f64,
    /// For how long its returns have not come although it should be in view [s].
    pub(crate) silent_s: f64,
    /// For how much of that, or of the time in which a side of it has been silent, the robot has rested [s].
    pub(crate) rested_s: f64,
    /// Scans in a row that saw its place free, or a side of it while they saw the rest.
    pub(crate) free: u32,
    pub(crate) moving: bool,
    pub(crate) confirmed: bool,
    /// Ellipses of the last description, 0 before the first.
    pub(crate) pieces: u32,
    motion: Motion,
    rest: Rest,
    origin: Vector2<f64>,
    edges: Vector2<f64>,
    reach: [f32; DIRECTIONS],
    doubts: u32,
    orientation: u32,
}

/// What one scan shows of one body.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View<'a> {
    /// Outline of what was seen.
    pub(crate) vertices: &'a [Vertex],
    /// Direction of its edges, see [`trace`](crate::outline::trace).
    pub(crate) edges: Vector2<f64>,
    /// Number of its returns.
    pub(crate) returns: usize,
    /// Where the robot stands [m].
    pub(crate) robot: Vector2<f64>,
    /// Time since the scan before [s].
    pub(crate) elapsed: f64,
}

impl Track {
    /// A body seen for the first time; `view` has at least one vertex.
    pub(crate) fn start(
        body: u32,
        view: &View<'_>,
        config: &ObstaclesConfig,
        directions: &Directions,
    ) -> Self {
        let share = 1.0 / view.vertices.len().max(1) as f64;
        let at = view.vertices.iter().fold(Vector2::zeros(), |sum, vertex| sum + vertex.at) * share;
        let noise = deviations(view, (at - view.robot).norm(), config).1;
        let mut reach = Seen::of(view.vertices, at, directions).reach.map(|reach| reach as f32);
        deepen(&mut reach, view.vertices, at, direction(view.robot, at), config.unseen_depth_m, directions);
        Self {
            body,
            sightings: 1,
            unseen_s: 0.0,
            silent_s: 0.0,
            rested_s: 0.0,
            free: 0,
            moving: false,
            confirmed: false,
            pieces: 0,
            motion: Motion::start(at, noise),
            rest: Rest { place: at, covariance: Matrix2::identity() * (noise * noise) },
            origin: at,
            orientation: orient(&reach, view.edges, 0, directions),
            edges: view.edges,
            reach,
            doubts: 0,
        }
    }

    /// The body `elapsed` seconds later; one that stands and is out of sight stays where it is.
    pub(crate) fn predict(&mut self, elapsed: f64) {
        if self.moving || self.unseen_s == 0.0 {
            self.motion.predict(elapsed.min(MAX_ELAPSED_S));
        }
        self.unseen_s = (self.unseen_s + elapsed).min(1e6);
    }

    /// The box where the next sighting is expected.
    pub(crate) fn expected(&self, directions: &Directions) -> Rectangle {
        self.shape().rectangle(self.motion.place(), directions)
    }

    /// The box where the body is, by the best estimate.
    pub(crate) fn rectangle(&self, directions: &Directions) -> Rectangle {
        self.shape().rectangle(self.place(), directions)
    }

    /// The box in which the body was since it was first seen, or last came to rest.
    pub(crate) fn swept(&self, directions: &Directions) -> Rectangle {
        let rectangle = self.rectangle(directions);
        let way = self.place() - self.origin;
        let turned = to_robot(rectangle.yaw, way.x, way.y);
        Rectangle {
            centre: rectangle.centre - way / 2.0,
            length: rectangle.length + turned.x.abs() + 2.0 * SWEPT_M,
            width: rectangle.width + turned.y.abs() + 2.0 * SWEPT_M,
            ..rectangle
        }
    }

    /// Lowest and highest coordinates of the body, along axes that are turned by `turn` around `about`.
    pub(crate) fn extent(&self, turn: f64, about: Vector2<f64>) -> [Vector2<f64>; 2] {
        if turn == 0.0 {
            return self.shape().extent(self.place());
        }
        self.shape().turned_extent(turn, about, self.place())
    }

    /// Whether it is forgotten by its age: nothing has shown it for too long where it should be in view. `period` is the time
    /// between scans [s].
    pub(crate) fn is_outdated(&self, memory_s: f64, period: f64) -> bool {
        let seen_s = period * f64::from(self.sightings.saturating_sub(1));
        self.silent_s > (FIRST_MEMORY_S + MEMORY * seen_s).min(memory_s)
    }

    /// How much larger than seen it may be by now, at each side [m].
    pub(crate) fn growth(&self) -> f64 {
        (GROWTH_MPS * self.silent_s).min(MAX_GROWTH_M)
    }

    /// Whether enough scans have shown it at rest.
    pub(crate) fn stands(&self) -> bool {
        !self.moving && self.sightings >= STANDING
    }

    /// Velocity, zero unless the body clearly moves [m/s].
    pub(crate) fn velocity(&self) -> Vector2<f64> {
        if self.moving { self.motion.velocity() } else { Vector2::zeros() }
    }

    /// Covariance of the velocity: xx, xy, yy [m^2/s^2].
    pub(crate) fn velocity_covariance(&self) -> [f64; 3] {
        let covariance = self.motion.velocity_covariance();
        [covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]]
    }

    /// Updates the track with what a scan shows of the body.
    pub(crate) fn sight(&mut self, view: &View<'_>, config: &ObstaclesConfig, directions: &Directions) {
        let origin = self.motion.place();
        let expected = self.expected(directions);
        let seen = Seen::of(view.vertices, origin, directions);
        let nearest = expected.nearest_to(view.robot);
        let distance = (nearest - view.robot).norm();
        // From afar the view is along the line to the centre; beside a long body, to its nearest side.
        let far = (expected.centre - view.robot).norm() > 1.5 * expected.length.hypot(expected.width) / 2.0;
        let near = directions.nearest(view.robot - if far { expected.centre } else { nearest });
        let excess = |index: usize| {
            let index = index % DIRECTIONS;
            let usable = seen.end[index] != End::Hidden
                && facing(&expected, directions.unit(index), view.robot) > ENDS;
            usable
                .then_some(seen.reach[index] - f64::from(self.reach[index]))
                .filter(|excess| excess.is_finite())
        };
        let sides = [near + DIRECTIONS / 4, near + DIRECTIONS * 3 / 4];
        let is_cut = is_cut(&seen, &self.reach, sides, config.vehicle.scanner.increment_rad * distance);
        let along = excess(near).filter(|excess| excess.abs() < JUMP_M && !is_cut);
        let ends = (excess(near + DIRECTIONS / 4), excess(near + DIRECTIONS * 3 / 4));
        let is_hidden = |index: usize| seen.end[index % DIRECTIONS] == End::Hidden;
        let is_told_by_one = along.is_some() && distance > ONE_END_M;
        let across = match ends {
            (Some(left), Some(right)) => Some(agreed(left, -right)),
            // The end that is seen shows the motion: what comes into view is at the hidden one.
            (Some(left), None) if is_told_by_one && is_hidden(near + DIRECTIONS * 3 / 4) => Some(left),
            (None, Some(right)) if is_told_by_one && is_hidden(near + DIRECTIONS / 4) => Some(-right),
            _ => None,
        };
        let across = across.filter(|across| across.abs() < JUMP_M && !is_cut);

        let shift = directions.unit(near) * along.unwrap_or(0.0)
            + directions.unit(near + DIRECTIONS / 4) * across.unwrap_or(0.0);
        let (along_noise, across_noise) = deviations(view, distance, config);
        let is_one = ends.0.is_none() || ends.1.is_none();
        let across_noise = if is_one { ONE_END_NOISE * across_noise } else { across_noise };
        let noise = noise_along(
            directions.unit(near),
            along.map_or(BLIND_M, |_| along_noise),
            across.map_or(BLIND_M, |_| across_noise),
        );
        self.motion.update(origin + shift, &noise);
        self.rest.update(origin + shift, &noise, view.elapsed.min(MAX_ELAPSED_S));
        if !self.moving {
            let blind = [(along, near), (across, near + DIRECTIONS / 4)];
            for (_, index) in blind.into_iter().filter(|(measured, _)| measured.is_none()) {
                self.motion.hold(directions.unit(index), self.rest.place);
            }
        }

        let sighting =
            Sighting { seen: &seen, shift, expected, robot: view.robot, is_cut, sightings: self.sightings };
        merge(&mut self.reach, &sighting, directions);
        let away = direction(view.robot, expected.centre);
        deepen(&mut self.reach, view.vertices, origin + shift, away, config.unseen_depth_m, directions);
        self.edges = self.edges * EDGE_MEMORY + view.edges;
        self.orientation = orient(&self.reach, self.edges, self.orientation, directions);
        self.sightings = self.sightings.saturating_add(1);
        (self.unseen_s, self.silent_s) = (0.0, 0.0);
        self.judge(config);
    }

    /// Ends the body at these directions of beams from the scanner, to the right and to the left of what is seen of it: a part of
    /// it has gone, or was another body that moved on. Returns the box before, where something was cut off.
    pub(crate) fn trim(
        &mut self,
        sides: [Option<Vector2<f64>>; 2],
        scanner: Vector2<f64>,
        directions: &Directions,
    ) -> Option<Rectangle> {
        let before = self.rectangle(directions);
        let offset = scanner - self.place();
        let mut is_cut = false;
        for (side, along) in [-1.0, 1.0].into_iter().zip(sides) {
            let Some(along) = along else { continue };
            // To the right, or to the left of the beam.
            let normal = Vector2::new(-along.y, along.x) * side;
            is_cut |= cut(&mut self.reach, normal, normal.dot(&offset), directions);
        }
        self.orientation = orient(&self.reach, self.edges, self.orientation, directions);
        is_cut.then_some(before)
    }

    /// Merges another body, which is a part of this one.
    pub(crate) fn absorb(&mut self, other: &Self, directions: &Directions) {
        let offset = other.place() - self.place();
        for index in 0..DIRECTIONS {
            let reach = f64::from(other.reach[index]) + directions.unit(index).dot(&offset);
            self.reach[index] = self.reach[index].max(reach as f32);
        }
        self.edges += other.edges;
        self.orientation = orient(&self.reach, self.edges, self.orientation, directions);
        self.sightings = self.sightings.max(other.sightings);
        self.confirmed |= other.confirmed;
        if other.unseen_s < self.unseen_s {
            (self.unseen_s, self.silent_s, self.free) = (other.unseen_s, other.silent_s, other.free);
            self.rested_s = other.rested_s;
        }
    }

    /// Whether all numbers of the track can be used.
    pub(crate) fn is_sound(&self) -> bool {
        let place = self.motion.state.iter().chain(self.rest.place.iter()).chain(self.origin.iter());
        place.copied().all(|value| value.abs() < 1e7)
            && self
                .motion
                .covariance
                .iter()
                .chain(self.rest.covariance.iter())
                .chain(self.edges.iter())
                .all(|value| value.is_finite())
            && self.reach.iter().all(|reach| reach.abs() < 50.0)
            && self.body != 0
            && self.unseen_s >= 0.0
            && self.unseen_s.is_finite()
            && self.silent_s >= 0.0
            && self.silent_s.is_finite()
            && self.rested_s >= 0.0
            && self.rested_s.is_finite()
    }

    /// The track as plain bytes.
    pub(crate) fn to_state(self) -> TrackState {
        let mut motion_covariance = [0.0; 16];
        motion_covariance.copy_from_slice(self.motion.covariance.as_slice());
        let rest = self.rest.covariance;
        TrackState {
            motion: self.motion.state.into(),
            motion_covariance,
            rest: self.rest.place.into(),
            rest_covariance: [rest[(0, 0)], rest[(0, 1)], rest[(1, 1)]],
            origin: self.origin.into(),
            edges: self.edges.into(),
            unseen_s: self.unseen_s,
            silent_s: self.silent_s,
            rested_s: self.rested_s,
            reach: self.reach.map(f32::to_bits),
            body: self.body,
            sightings: self.sightings,
            free: self.free,
            moving: self.moving.into(),
            doubts: self.doubts,
            orientation: self.orientation,
            pieces: self.pieces,
            confirmed: self.confirmed.into(),
        }
    }

    /// The track of a state; `None` when the state is impossible.
    pub(crate) fn from_state(state: &TrackState) -> Option<Self> {
        let [xx, xy, yy] = state.rest_covariance;
        let track = Self {
            body: state.body,
            sightings: state.sightings,
            unseen_s: state.unseen_s,
            silent_s: state.silent_s,
            rested_s: state.rested_s,
            free: state.free,
            moving: state.moving.is_set(),
            confirmed: state.confirmed.is_set(),
            pieces: state.pieces,
            motion: Motion {
                state: Vector4::from(state.motion),
                covariance: Matrix4::from_column_slice(&state.motion_covariance),
            },
            rest: Rest { place: state.rest.into(), covariance: Matrix2::new(xx, xy, xy, yy) },
            origin: state.origin.into(),
            edges: state.edges.into(),
            reach: state.reach.map(f32::from_bits),
            doubts: state.doubts,
            orientation: state.orientation,
        };
        track.is_sound().then_some(track)
    }

    fn shape(&self) -> Shape<'_> {
        Shape { reach: &self.reach, orientation: self.orientation }
    }

    /// Place of the reference point by the best estimate.
    fn place(&self) -> Vector2<f64> {
        if self.moving { self.motion.place() } else { self.rest.place }
    }

    /// Decides whether the body moves.
    fn judge(&mut self, config: &ObstaclesConfig) {
        let (squared, speed) = self.motion.significance();
        if self.moving {
            let stands = squared < INSIGNIFICANT || speed < 0.5 * config.moving_mps;
            self.doubts = if stands { self.doubts.saturating_add(1) } else { 0 };
            if self.doubts >= STOPS {
                (self.moving, self.doubts) = (false, 0);
                self.settle();
                self.origin = self.rest.place;
            }
            return;
        }
        let distance = (self.motion.place() - self.origin).norm();
        let left = distance > MOVED_M && squared > SIGNIFICANT;
        let carried = distance > CARRIED_M && squared > INSIGNIFICANT && self.sightings >= SETTLED;
        let moves = (left || carried) && speed > config.moving_mps;
        self.doubts = if moves { self.doubts.saturating_add(1) } else { 0 };
        if self.doubts >= STARTS {
            (self.moving, self.doubts) = (true, 0);
        } else if (self.rest.place - self.motion.place()).norm() > LEFT_BEHIND_M {
            self.settle();
        }
    }

    /// Moves the place of rest to where the body is.
    fn settle(&mut self) {
        self.rest.place = self.motion.place();
        self.rest.covariance = self.motion.covariance.fixed_view::<2, 2>(0, 0).into();
    }
}

/// Whether a sector that sees nothing cuts a body off: one end is short of where it is known, next to beams without
/// return, and the other has not moved the same way. The beams are `spacing` apart there [m].
fn is_cut(seen: &Seen, reach: &[f32; DIRECTIONS], ends: [usize; 2], spacing: f64) -> bool {
    let short = CUT_M + CUT_BEAMS * spacing;
    let [left, right] = ends.map(|index| {
        let index = index % DIRECTIONS;
        (seen.end[index], seen.reach[index] - f64::from(reach[index]))
    });
    let cuts =
        |(end, excess): (End, f64), other: f64| end == End::Silent && excess < -short && other < short / 2.0;
    cuts(left, right.1) || cuts(right, left.1)
}

/// Unit vector from one point to another, along the track when they coincide.
fn direction(from: Vector2<f64>, to: Vector2<f64>) -> Vector2<f64> {
    (to - from).try_normalize(1e-9).unwrap_or(Vector2::new(1.0, 0.0))
}

/// Standard deviations of a place seen at `distance`: along the view and across it [m].
fn deviations(view: &View<'_>, distance: f64, config: &ObstaclesConfig) -> (f64, f64) {
    let along = config.pose_noise_m.hypot(config.range_noise_m / (view.returns.clamp(1, 50) as f64).sqrt());
    let across = config
        .pose_noise_m
        .hypot(distance * (config.pose_noise_rad + 0.5 * config.vehicle.scanner.increment_rad));
    (along, across)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A body first seen 3 m ahead of a robot at the origin.
    fn track() -> Track {
        let vertices = [-0.2, 0.2].map(|y| Vertex { at: Vector2::new(3.0, y), end: End::Seen });
        let view = View {
            vertices: &vertices,
            edges: Vector2::zeros(),
            returns: 20,
            robot: Vector2::zeros(),
            elapsed: 0.0,
        };
        Track::start(1, &view, &ObstaclesConfig::default(), &Directions::new())
    }

    /// Whether the body moves after sightings that show this speed each, 0.2 m from where it was first seen.
    fn moves_after(track: &mut Track, speeds: &[f64]) -> bool {
        for speed in speeds {
            track.motion.state = Vector4::new(3.2, 0.0, *speed, 0.0);
            track.motion.covariance = Matrix4::identity() * 1e-4;
            track.judge(&ObstaclesConfig::default());
        }
        track.moving
    }

    #[test]
    fn only_showings_of_motion_in_a_row_make_a_body_move_and_only_those_of_rest_stop_it() {
        let mut track = track();
        let (rest, moves) = (0.0, 0.5);
        assert!(!moves_after(&mut track, &[moves, moves, rest, moves, moves, rest, moves, moves]));
        assert!(moves_after(&mut track, &[moves]), "the third in a row");
        assert!(moves_after(&mut track, &[rest, rest, rest, rest, moves, rest, rest, rest, rest]));
        assert!(!moves_after(&mut track, &[rest]), "the fifth in a row");
    }
}
