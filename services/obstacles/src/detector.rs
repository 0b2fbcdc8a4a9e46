//! The steps of one scan: place returns, segment them into bodies, track the bodies, cover them by ellipses.

use std::hint::black_box;

use nalgebra::Vector2;
use shared_types::{
    Fault, Header, MAX_OBSTACLES, MIN_RANGE_MM, Obstacle, Obstacles, Pose, Scan, ScannerHealth,
};
use vehicle::Invalid;
use vehicle::geometry::Rectangle;

use crate::ObstaclesConfig;
use crate::ellipse::{MAX_PIECES, cover};
use crate::evidence::Evidence;
use crate::outlines::Outlines;
use crate::points::{Beams, Place, Point};
use crate::state::{ObstaclesState, TRACKS, TrackState};
use crate::thin::Thin;
use crate::track::{IDS_PER_BODY, MAX_BODY, Track};
use crate::tracks::Tracks;
use crate::way::Way;

const _: () = assert!(MAX_PIECES <= IDS_PER_BODY as usize);

/// Detects and tracks obstacles; one call per scan.
#[derive(Debug, Clone)]
pub struct ObstacleDetector {
    config: ObstaclesConfig,
    beams: Beams,
    thin: Thin,
    acquired_ns: u64,
    pose: [f64; 3],
    way: Way,
    tracks: Tracks,
    evidence: Evidence,
    // Buffers of one step.
    returns: Vec<Point>,
    points: Vec<Point>,
    outlines: Outlines,
    drawn: Vec<Drawn>,
    /// For each beam whether its return is of something that does not move.
    fixed: Vec<bool>,
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
    pub fn new(config: ObstaclesConfig) -> Result<Self, Invalid> {
        config.validate()?;
        let beams = Beams::new(&config.vehicle.scanner, 1);
        let thin = Thin::new(&config.vehicle.scanner);
        let count = beams.count();
        Ok(Self {
            evidence: Evidence::new(config.vehicle, thin.beams(), thin.stride()),
            returns: Vec::with_capacity(count),
            fixed: vec![false; count],
            way: Way::new(&config),
            tracks: Tracks::new(config.clone(), &beams),
            outlines: Outlines::with_capacity(&beams, config.vehicle.scanner_yaw_rad),
            config,
            beams,
            thin,
            acquired_ns: 0,
            pose: [0.0; 3],
            points: Vec::with_capacity(count),
            drawn: Vec::with_capacity(TRACKS * MAX_PIECES),
        })
    }

    /// The obstacles known after `scan`, taken from `pose`; layout and sequence are left to the publisher.
    ///
    /// With a pose that is not finite nothing is detected: the known bodies count as unseen.
    pub fn step(&mut self, scan: &Scan, pose: &Pose) -> Obstacles {
        let elapsed = self.elapse(scan.header.acquired_ns);
        self.tracks.predict(elapsed);
        let place = Place::of(pose, &self.config.vehicle);
        if place.is_some() {
            self.pose = [pose.x_m, pose.y_m, pose.yaw_rad];
            self.way.follow(self.pose);
        }
        let overflow = match &place {
            Some(place) if !scan.missing.is_set() => self.find(scan, place, elapsed),
            _ => {
                self.evidence.miss(elapsed);
                0
            }
        };
        self.tracks.expire(self.pose, &self.way);
        let health = self.evidence.health(if pose.speed_mps.is_finite() { pose.speed_mps } else { 0.0 });
        self.describe(scan.header.answer_both(&pose.header), overflow, health)
    }

    /// Makes the next step faster: does it on the last scan as if it came again, a millimetre off, and puts the state
    /// back. What follows gives the same bits as without.
    pub fn rehearse(&mut self, scan: &Scan, pose: &Pose, period_ns: u64) {
        let (before, silent) = (self.state(), self.evidence.silent());
        let mut scan = Scan { header: scan.header.next(period_ns), ..*scan };
        // The step does less for a scan that repeats the one before.
        scan.ranges_mut().iter_mut().filter(|range| **range >= MIN_RANGE_MM).for_each(|range| *range ^= 1);
        black_box(self.step(&scan, pose));
        let restored = self.resume(&before);
        debug_assert!(restored.is_ok(), "tracks that are not sound have expired");
        self.evidence.set_silent(silent);
    }

    /// All that the next step depends on.
    pub fn state(&self) -> ObstaclesState {
        let mut tracks = [TrackState::default(); TRACKS];
        for (state, track) in tracks.iter_mut().zip(&self.tracks.list) {
            *state = track.to_state();
        }
        ObstaclesState {
            acquired_ns: self.acquired_ns,
            pose: self.pose,
            along_m: self.way.along_m(),
            last_body: self.tracks.last_body,
            count: self.tracks.list.len().min(TRACKS) as u32,
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
        if !(state.along_m.abs() < 1e6 || state.along_m == f64::NEG_INFINITY) {
            return Err(Fault::OutOfRange { field: "along_m", value: state.along_m });
        }
        let sound = |state: &TrackState| Track::from_state(state).filter(|track| track.body <= MAX_BODY);
        if state.last_body > MAX_BODY || !state.tracks[..count].iter().all(|state| sound(state).is_some()) {
            return Err(Fault::NotFinite { field: "tracks" });
        }
        if !Evidence::is_sound(&state.evidence) {
            return Err(Fault::NotFinite { field: "evidence" });
        }
        self.evidence.resume(&state.evidence, self.thin.beams());
        self.acquired_ns = state.acquired_ns;
        self.pose = state.pose;
        self.way.resume(state.along_m);
        self.tracks.last_body = state.last_body;
        self.tracks.list.clear();
        self.tracks.list.extend(state.tracks[..count].iter().filter_map(sound));
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
        self.thin.take(scan, &self.points, &mut self.returns);
        if !self.evidence.receive(self.thin.beams(), self.thin.of(scan), place, &self.returns, elapsed) {
            return 0;
        }
        self.way.place(&self.points);
        let way = &self.way;
        let known = self.tracks.expected();
        self.outlines.find(&self.config, (scan, &self.beams), (place, way), &mut self.points, known);
        self.tracks.sight(&self.outlines, &mut self.evidence, place, elapsed);
        self.mark_fixed();
        let (fixed, way, stride) = (&self.fixed, &self.way, self.thin.stride());
        let (thin, compared) = (self.thin.beams(), self.thin.of(scan));
        let something_moves = self.tracks.list.iter().any(|track| track.moving && track.unseen_s == 0.0);
        self.evidence.compare(thin, compared, (place, way), &self.returns, something_moves, |beam| {
            fixed[beam * stride]
        });
        let overflow = self.tracks.start(&self.outlines, place, way);
        self.tracks.forget(scan, &self.beams, &mut self.evidence, (place, way), elapsed);
        self.tracks.unite(place.at, way);
        overflow
    }

    /// Marks the beams whose return is outside of the track, on a wall, or on a body that stands. In open surroundings nothing
    /// is known to stand that is too far away to be followed.
    fn mark_fixed(&mut self) {
        self.fixed.fill(!self.evidence.is_open() || self.config.walls);
        for point in &self.points {
            self.fixed[point.beam] = self.way.is_point_beside(point);
        }
        for (outline, members) in self.outlines.members() {
            let Some(track) = outline.track.map(|index| &self.tracks.list[index]) else { continue };
            if track.moving || track.stands() {
                for member in members {
                    self.fixed[member.beam] = !track.moving;
                }
            }
        }
    }

    /// The ellipses of all confirmed tracks, nearest ahead first.
    fn describe(&mut self, header: Header, overflow: u32, scanner: ScannerHealth) -> Obstacles {
        let [x, y, _] = self.pose;
        self.drawn.clear();
        let Tracks { list, directions, .. } = &mut self.tracks;
        for track in list.iter_mut().filter(|track| track.confirmed) {
            let rectangle = track.rectangle(directions);
            if !track.moving && self.way.is_box_beside(&rectangle) {
                continue;
            }
            let growth = track.growth();
            let grown = Rectangle {
                length: rectangle.length + 2.0 * growth,
                width: rectangle.width + 2.0 * growth,
                ..rectangle
            };
            let [turn, _] = self.way.bend_at(grown.centre);
            let [low, high] = track.extent(turn, grown.centre);
            let extent = [low.add_scalar(-growth), high.add_scalar(growth)];
            let bend_at = |point| self.way.bend_at(point);
            let cover = cover(&self.config, &grown, &extent, track.pieces, directions, bend_at);
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
                let behind = self.way.ahead(self.pose, ellipse.centre) < 0.0;
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
