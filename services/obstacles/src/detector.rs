//! The steps of one scan: place returns, segment them into bodies, track the bodies, cover them by ellipses.

use std::hint::black_box;

use nalgebra::Vector2;
use shared_types::{
    BEAMS, Fault, Header, MAX_OBSTACLES, MIN_RANGE_MM, Obstacle, Obstacles, Pose, Scan, ScannerHealth,
};
use vehicle::Invalid;
use vehicle::frame::to_robot;
use vehicle::geometry::Rectangle;

use crate::Config;
use crate::ellipse::{MAX_PIECES, cover};
use crate::evidence::Evidence;
use crate::outline::{Vertex, trace};
use crate::part::Known;
use crate::points::{Beams, Place, Point};
use crate::segment::Segments;
use crate::shape::Directions;
use crate::state::{ObstaclesState, TRACKS, TrackState};
use crate::track::{Track, View};
use crate::visibility::{Sight, beams_towards, sight};
use crate::walls::Walls;

/// Identity of an ellipse: that of its body times this, plus the number of the piece.
const IDS_PER_BODY: u32 = 8;
const _: () = assert!(MAX_PIECES <= IDS_PER_BODY as usize);
/// Identities of bodies wrap after this many, so that those of ellipses fit a u32.
const MAX_BODY: u32 = u32::MAX / IDS_PER_BODY - 1;
/// Returns nearer than this to where a body is expected belong to it [m]; at 1 m/s it moves 0.1 m between scans.
const GATE_M: f64 = 0.2;
/// Growth of the gate with the distance: three standard deviations of a yaw that is off by 0.01 rad.
const GATE_PER_M: f64 = 0.03;
/// Bodies nearer to each other than this are one [m].
const TOUCHING_M: f64 = 0.04;
/// A body that is not confirmed is forgotten after this time [s].
const SPECKLE_MEMORY_S: f64 = 0.35;
/// When a body that stands should be in view and has shown nothing for this long, the scanner is doubted there [s].
const DOUBTFUL_S: f64 = 0.25;
/// Scans that must have shown a body before it counts as standing.
const STANDING: u32 = 5;
/// A body beside the track may seem to reach so far across its line [m].
const BESIDE_NOISE_M: f64 = 0.05;
/// A body further away than this is out of reach: the pose must have jumped [m].
const LOST_M: f64 = 12.0;

/// Detects and tracks obstacles; one call per scan.
#[derive(Debug, Clone)]
pub struct ObstacleDetector {
    config: Config,
    beams: Beams,
    directions: Directions,
    acquired_ns: u64,
    pose: [f64; 3],
    last_body: u32,
    tracks: Vec<Track>,
    evidence: Evidence,
    // Buffers of one step.
    returns: Vec<Point>,
    points: Vec<Point>,
    segments: Segments,
    outlines: Vec<Outline>,
    vertices: Vec<Vertex>,
    view: Vec<Vertex>,
    boxes: Vec<Rectangle>,
    expected: Vec<Known>,
    drawn: Vec<Drawn>,
    /// For each beam whether its return is of something that does not move.
    fixed: Vec<bool>,
}

/// Outline of one cluster: a range of the vertices.
#[derive(Debug, Clone, Copy)]
struct Outline {
    first: usize,
    end: usize,
    returns: usize,
    edges: Vector2<f64>,
    may_start: bool,
    /// Index of the track that it belongs to.
    track: Option<usize>,
}

/// An ellipse before it is sorted into the sample.
#[derive(Debug, Clone, Copy)]
struct Drawn {
    behind: bool,
    distance: f64,
    obstacle: Obstacle,
}

impl ObstacleDetector {
    /// A detector without tracks.
    ///
    /// # Errors
    /// [`Invalid`] when a setting is out of its range.
    pub fn new(config: Config) -> Result<Self, Invalid> {
        config.validate()?;
        Ok(Self {
            evidence: Evidence::new(config.vehicle, config.view_y_m()),
            returns: Vec::with_capacity(BEAMS),
            fixed: vec![false; BEAMS],
            config,
            beams: Beams::new(),
            directions: Directions::new(),
            acquired_ns: 0,
            pose: [0.0; 3],
            last_body: 0,
            tracks: Vec::with_capacity(TRACKS + 1),
            points: Vec::with_capacity(BEAMS),
            segments: Segments::with_capacity(),
            outlines: Vec::with_capacity(BEAMS),
            vertices: Vec::with_capacity(4 * BEAMS),
            view: Vec::with_capacity(4 * BEAMS),
            boxes: Vec::with_capacity(TRACKS + 1),
            expected: Vec::with_capacity(TRACKS + 1),
            drawn: Vec::with_capacity(TRACKS * MAX_PIECES),
        })
    }

    /// The obstacles known after `scan`, taken from `pose`; layout and sequence are left to the publisher.
    ///
    /// With a pose that is not finite nothing is detected: the known bodies count as unseen.
    pub fn step(&mut self, scan: &Scan, pose: &Pose) -> Obstacles {
        let elapsed = self.elapse(scan.header.acquired_ns);
        for track in &mut self.tracks {
            track.predict(elapsed);
        }
        let place = Place::of(pose, &self.config.vehicle);
        if place.is_some() {
            self.pose = [pose.x_m, pose.y_m, pose.yaw_rad];
        }
        let overflow = match &place {
            Some(place) if !scan.missing.is_set() => self.find(scan, place, elapsed),
            _ => {
                self.evidence.miss(elapsed);
                0
            }
        };
        self.expire();
        let health = self.evidence.health(if pose.speed_mps.is_finite() { pose.speed_mps } else { 0.0 });
        self.describe(scan.header.answer_both(&pose.header), overflow, health)
    }

    /// Makes the next step faster: does it on the last scan as if it came again, a millimetre off, and puts the state
    /// back. What follows gives the same bits as without.
    pub fn rehearse(&mut self, scan: &Scan, pose: &Pose, period_ns: u64) {
        let (before, silent) = (self.state(), self.evidence.silent());
        let mut scan = Scan { header: scan.header.next(period_ns), ..*scan };
        // The step does less for a scan that repeats the one before.
        scan.ranges_mm.iter_mut().filter(|range| **range >= MIN_RANGE_MM).for_each(|range| *range ^= 1);
        black_box(self.step(&scan, pose));
        let restored = self.resume(&before);
        debug_assert!(restored.is_ok(), "tracks that are not sound have expired");
        self.evidence.set_silent(silent);
    }

    /// All that the next step depends on.
    pub fn state(&self) -> ObstaclesState {
        let mut tracks = [TrackState::default(); TRACKS];
        for (state, track) in tracks.iter_mut().zip(&self.tracks) {
            *state = track.to_state();
        }
        ObstaclesState {
            acquired_ns: self.acquired_ns,
            pose: self.pose,
            last_body: self.last_body,
            count: self.tracks.len().min(TRACKS) as u32,
            tracks,
            evidence: self.evidence.state(),
        }
    }

    /// Continues from a state.
    ///
    /// # Errors
    /// [`Fault`] when a number of the state is impossible; the detector is unchanged then.
    pub fn resume(&mut self, state: &ObstaclesState) -> Result<(), Fault> {
        let count = state.count as usize;
        if count > TRACKS {
            return Err(Fault::OutOfRange { field: "count", value: f64::from(state.count) });
        }
        if !state.pose.iter().all(|value| value.abs() < 1e6) {
            return Err(Fault::NotFinite { field: "pose" });
        }
        let sound = |state: &TrackState| Track::from_state(state).filter(|track| track.body <= MAX_BODY);
        if state.last_body > MAX_BODY || !state.tracks[..count].iter().all(|state| sound(state).is_some()) {
            return Err(Fault::NotFinite { field: "tracks" });
        }
        if !Evidence::is_sound(&state.evidence) {
            return Err(Fault::NotFinite { field: "evidence" });
        }
        self.evidence.resume(&state.evidence, &self.beams);
        self.acquired_ns = state.acquired_ns;
        self.pose = state.pose;
        self.last_body = state.last_body;
        self.tracks.clear();
        self.tracks.extend(state.tracks[..count].iter().filter_map(sound));
        Ok(())
    }

    /// Time since the scan before [s], zero for the first and for one that is not newer.
    fn elapse(&mut self, acquired_ns: u64) -> f64 {
        let before = self.acquired_ns;
        if acquired_ns <= before {
            return 0.0;
        }
        self.acquired_ns = acquired_ns;
        if before == 0 { 0.0 } else { (acquired_ns - before) as f64 * 1e-9 }
    }

    /// Finds the bodies of one scan; returns how many did not fit.
    fn find(&mut self, scan: &Scan, place: &Place, elapsed: f64) -> u32 {
        self.beams.place(scan, place, &mut self.points);
        self.returns.clone_from(&self.points);
        if !self.evidence.receive(&self.beams, scan, place, &self.returns, elapsed) {
            return 0;
        }
        self.outline(scan, place);
        self.associate(place);
        self.sight(place, elapsed);
        self.mark_fixed();
        let fixed = &self.fixed;
        self.evidence.compare(&self.beams, scan, place, &self.returns, |beam| fixed[beam]);
        let overflow = self.start(place);
        self.forget(scan, place, elapsed);
        self.unite();
        overflow
    }

    /// Marks the beams whose return is outside of the track, on a wall, or on a body that stands.
    fn mark_fixed(&mut self) {
        self.fixed.fill(true);
        let [low, high] = self.config.beside_y_m();
        for point in self.points.iter().filter(|point| (low..=high).contains(&point.at.y)) {
            self.fixed[point.beam] = false;
        }
        for (cluster, outline) in self.segments.clusters.iter().zip(&self.outlines) {
            let Some(track) = outline.track.map(|index| &self.tracks[index]) else { continue };
            if track.moving || track.sightings >= STANDING {
                for member in &self.segments.members[cluster.first..cluster.end] {
                    self.fixed[member.beam] = !track.moving;
                }
            }
        }
    }

    /// Segments the scan into outlines of bodies.
    fn outline(&mut self, scan: &Scan, place: &Place) {
        let walls = Walls::fit(&self.config, place, &self.points);
        self.points.retain(|point| walls.leaves(point.at));
        self.segments.find(scan, &self.points, self.config.range_noise_m, self.config.beside_y_m());
        self.expected.clear();
        let known = |track: &Track| (track.expected(&self.directions), track.moving);
        self.expected.extend(self.tracks.iter().map(known));
        self.segments.part(&self.expected);
        self.outlines.clear();
        self.vertices.clear();
        for cluster in &self.segments.clusters {
            let members = &self.segments.members[cluster.first..cluster.end];
            let first = self.vertices.len();
            let edges = trace(cluster, members, place, self.config.range_noise_m, &mut self.vertices);
            walls.extend(&mut self.vertices, first);
            let end = self.vertices.len();
            self.outlines.push(Outline {
                first,
                end,
                returns: members.len(),
                edges,
                may_start: cluster.may_start,
                track: None,
            });
        }
    }

    /// Gives each outline to the track whose expected box it is nearest to.
    fn associate(&mut self, place: &Place) {
        for outline in &mut self.outlines {
            let vertices = &self.vertices[outline.first..outline.end];
            let mut best = f64::INFINITY;
            let beside = is_beside(&self.config, vertices.iter().map(|vertex| vertex.at));
            for (index, (expected, moves)) in self.expected.iter().enumerate() {
                if !moves && is_beside(&self.config, expected.corners()) != beside {
                    continue;
                }
                let (mut least, mut sum) = (f64::INFINITY, 0.0);
                for vertex in vertices {
                    let distance = expected.distance_to_point(vertex.at).max(0.0);
                    least = least.min(distance);
                    sum += distance;
                }
                let gate = GATE_M + GATE_PER_M * (expected.centre - place.at).norm();
                // The mean decides between two boxes that both touch the outline.
                let cost = least + 0.1 * sum / vertices.len() as f64;
                if least < gate && cost < best {
                    (best, outline.track) = (cost, Some(index));
                }
            }
        }
    }

    /// Updates each track with all outlines that belong to it.
    fn sight(&mut self, place: &Place, elapsed: f64) {
        for (index, track) in self.tracks.iter_mut().enumerate() {
            self.view.clear();
            let (mut returns, mut edges) = (0, Vector2::zeros());
            for outline in self.outlines.iter().filter(|outline| outline.track == Some(index)) {
                self.view.extend_from_slice(&self.vertices[outline.first..outline.end]);
                returns += outline.returns;
                edges += outline.edges;
            }
            if returns == 0 {
                continue;
            }
            // Time since it was last seen, which may be longer than a scan.
            let elapsed = track.unseen_s.max(elapsed);
            let view = View { vertices: &self.view, edges, returns, robot: place.at, elapsed };
            track.sight(&view, &self.config, &self.directions);
            track.confirmed = true;
        }
    }

    /// Starts a track for each outline in the window that belongs to none; returns how many did not fit.
    fn start(&mut self, place: &Place) -> u32 {
        let mut overflow = 0;
        for outline in self.outlines.iter().filter(|outline| outline.track.is_none() && outline.may_start) {
            let vertices = &self.vertices[outline.first..outline.end];
            let nearest =
                vertices.iter().map(|vertex| (vertex.at - place.at).norm()).fold(f64::INFINITY, f64::min);
            if self.tracks.len() >= TRACKS {
                if is_beside(&self.config, vertices.iter().map(|vertex| vertex.at)) {
                    continue;
                }
                let Some(farthest) =
                    least_needed(&self.tracks, &self.config, place, nearest, &self.directions)
                else {
                    overflow += 1;
                    continue;
                };
                self.tracks.remove(farthest);
            }
            self.last_body = self.last_body % MAX_BODY + 1;
            let view = View {
                vertices,
                edges: outline.edges,
                returns: outline.returns,
                robot: place.at,
                elapsed: 0.0,
            };
            let mut track = Track::start(self.last_body, &view, &self.config, &self.directions);
            // A wall may be near although its ends, the only vertices, are not.
            let distance = track.rectangle(&self.directions).distance_to_point(place.at);
            track.confirmed = distance < self.config.first_sight_m();
            self.tracks.push(track);
        }
        overflow
    }

    /// Forgets bodies whose place is free, or from which nothing has come for too long.
    fn forget(&mut self, scan: &Scan, place: &Place, elapsed: f64) {
        let is_reliable = self.evidence.is_reliable();
        for track in self.tracks.iter_mut().filter(|track| track.unseen_s > 0.0) {
            let rectangle = track.rectangle(&self.directions);
            match sight(scan, &self.beams, place, &rectangle) {
                Sight::Free => track.free = track.free.saturating_add(1),
                Sight::Taken => track.free = 0,
                Sight::Silent => {
                    track.silent_s += if is_reliable { elapsed } else { 0.0 };
                    let stands = !track.moving && track.sightings >= STANDING;
                    if stands
                        && !is_beside(&self.config, rectangle.corners())
                        && track.silent_s > DOUBTFUL_S
                        && let Some(beams) = beams_towards(place, &rectangle)
                    {
                        self.evidence.doubt(beams);
                    }
                }
                Sight::Unknown => {}
            }
        }
        let limit = self.config.free_scans;
        let memory_s = self.config.memory_s;
        self.tracks.retain(|track| {
            track.free < if track.confirmed { limit } else { limit.min(2) } && !track.is_outdated(memory_s)
        });
    }

    /// Merges standing bodies that touch: parts of one body that were first seen apart.
    fn unite(&mut self) {
        self.boxes.clear();
        self.boxes.extend(self.tracks.iter().map(|track| track.rectangle(&self.directions)));
        let mut older = 0;
        while older < self.tracks.len() {
            let mut younger = older + 1;
            while younger < self.tracks.len() {
                let (a, b) = (&self.boxes[older], &self.boxes[younger]);
                let standing = !self.tracks[older].moving && !self.tracks[younger].moving;
                let reach = (a.length.hypot(a.width) + b.length.hypot(b.width)) / 2.0 + TOUCHING_M;
                let touch = standing
                    && is_beside(&self.config, a.corners()) == is_beside(&self.config, b.corners())
                    && (a.centre - b.centre).norm_squared() < reach * reach
                    && a.distance_to_rectangle(b) < TOUCHING_M;
                if touch {
                    let part = self.tracks.remove(younger);
                    self.boxes.remove(younger);
                    self.tracks[older].absorb(&part, &self.directions);
                    self.boxes[older] = self.tracks[older].rectangle(&self.directions);
                } else {
                    younger += 1;
                }
            }
            older += 1;
        }
    }

    /// Forgets bodies that are far behind, out of reach, moved out of sight, or never confirmed.
    fn expire(&mut self) {
        let [x, y, yaw] = self.pose;
        let (config, directions) = (&self.config, &self.directions);
        self.tracks.retain(|track| {
            if !track.is_sound() {
                return false;
            }
            let rectangle = track.rectangle(directions);
            let at = Vector2::new(x, y);
            let forward = |corner: Vector2<f64>| to_robot(yaw, corner.x - x, corner.y - y).x;
            let front = rectangle.corners().map(forward).into_iter().fold(f64::NEG_INFINITY, f64::max);
            let lost = rectangle.distance_to_point(at) > LOST_M || front < -config.keep_behind_m;
            let gone = track.moving && track.unseen_s > config.moving_memory_s;
            let speckle = !track.confirmed && track.unseen_s > SPECKLE_MEMORY_S;
            !(lost || gone || speckle)
        });
    }

    /// The ellipses of all confirmed tracks, nearest ahead first.
    fn describe(&mut self, header: Header, overflow: u32, scanner: ScannerHealth) -> Obstacles {
        let [x, y, yaw] = self.pose;
        self.drawn.clear();
        for track in self.tracks.iter_mut().filter(|track| track.confirmed) {
            let rectangle = track.rectangle(&self.directions);
            if !track.moving && is_beside(&self.config, rectangle.corners()) {
                continue;
            }
            let growth = track.growth();
            let grown = Rectangle {
                length: rectangle.length + 2.0 * growth,
                width: rectangle.width + 2.0 * growth,
                ..rectangle
            };
            let [low, high] = track.extent();
            let extent = [low.add_scalar(-growth), high.add_scalar(growth)];
            let cover = cover(&self.config, &grown, &extent, track.pieces, &self.directions);
            track.pieces = cover.list().len() as u32;
            let velocity = track.velocity();
            for (piece, ellipse) in (0..).zip(cover.list()) {
                let offset = ellipse.centre - Vector2::new(x, y);
                let obstacle = Obstacle {
                    id: track.body * IDS_PER_BODY + piece,
                    body: track.body,
                    x_m: ellipse.centre.x,
                    y_m: ellipse.centre.y,
                    a_m: ellipse.a,
                    b_m: ellipse.b,
                    velocity_x_mps: velocity.x,
                    velocity_y_mps: velocity.y,
                    velocity_covariance: track.velocity_covariance(),
                    box_x_m: rectangle.centre.x,
                    box_y_m: rectangle.centre.y,
                    box_length_m: grown.length,
                    box_width_m: grown.width,
                    box_yaw_rad: rectangle.yaw,
                    unseen_s: track.unseen_s,
                    sightings: u64::from(track.sightings),
                };
                let behind = to_robot(yaw, offset.x, offset.y).x < 0.0;
                self.drawn.push(Drawn { behind, distance: offset.norm(), obstacle });
            }
        }
        self.drawn.sort_unstable_by(|a, b| {
            (a.behind.cmp(&b.behind))
                .then(a.distance.total_cmp(&b.distance))
                .then(a.obstacle.id.cmp(&b.obstacle.id))
        });
        let count = self.drawn.len().min(MAX_OBSTACLES);
        let mut items = [Obstacle::default(); MAX_OBSTACLES];
        for (item, drawn) in items.iter_mut().zip(&self.drawn) {
            *item = drawn.obstacle;
        }
        Obstacles {
            header,
            count: count as u32,
            overflow: overflow + (self.drawn.len() - count) as u32,
            scanner,
            items,
        }
    }
}

/// Whether a body is beyond the lines within which bodies at rest are described; it may reach 5 cm across by noise.
fn is_beside(config: &Config, corners: impl IntoIterator<Item = Vector2<f64>>) -> bool {
    let [low, high] = config.beside_y_m();
    let (mut right, mut left) = (true, true);
    for corner in corners {
        right &= corner.y < low + BESIDE_NOISE_M;
        left &= corner.y > high - BESIDE_NOISE_M;
    }
    right || left
}

/// Index of the track that is needed least: the farthest that is at rest beside the track, else the farthest among those not
/// seen now, when it is farther than `distance`.
fn least_needed(
    tracks: &[Track],
    config: &Config,
    place: &Place,
    distance: f64,
    directions: &Directions,
) -> Option<usize> {
    let mut farthest = (distance, None);
    for (index, track) in tracks.iter().enumerate() {
        let rectangle = track.rectangle(directions);
        let beside = !track.moving && is_beside(config, rectangle.corners());
        let distance = rectangle.distance_to_point(place.at) + if beside { LOST_M } else { 0.0 };
        if (beside || track.unseen_s > 0.0) && distance > farthest.0 {
            farthest = (distance, Some(index));
        }
    }
    farthest.1
}
