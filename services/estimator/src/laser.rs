//! The pose is corrected by the laser: each scan is laid onto the surfaces that stand still.
//!
//! [`pieces`] makes straight pieces of a scan, [`surface`] remembers those that were seen, [`known`] has those that the
//! track states or a map, and [`align`] finds the pose from which pieces and surfaces agree; where they contradict it, [`search`]
//! finds another. Where the odometer is too poor for a surface to seem to stand still, a scan is laid onto one before it,
//! whatever its shape ([`key`], [`outline`]).
//!
//! A match is computed when the actuation of its scan is out, so the way from scan to wheels gets no longer, and corrects
//! the pose of the next scan.

pub mod align;
pub mod grid;
pub mod key;
pub mod known;
pub mod map;
pub mod offset;
pub mod outline;
pub mod pieces;
pub mod round;
pub mod search;
pub mod surface;

use nalgebra::{Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use shared_types::{Scan, plain_state};
use vehicle::{Description, Setting, Track};

use crate::dead_reckoning::{DeadReckoning, DriftSources};
use align::{Prior, align, part_of};
use key::{KeyScan, KeyScans};
use known::Stated;
use offset::RangeOffset;
use pieces::{Pieces, SweepMotion};
use search::{Search, Whereabouts};
use surface::{Placed, SURFACES, Sight, SurfaceLine, SurfaceMap};

/// Lines that are compared with one scan at most.
const MAX_LINES: usize = 256;
/// Scans that are matched are at least so far apart [ns].
const INTERVAL_NS: u64 = 9_000_000;
/// A new surface has so many returns.
const MIN_COUNT: f64 = 5.0;
/// Standard deviations of where a new surface is seen, beside those by its returns, of a short one and of a long one
/// [rad, m, m]: with these 95 % of the poses of a kilometre are in their ellipse.
const BESIDE: ([f64; 3], [f64; 3]) = ([3e-3, 1.5e-2, 1.5e-2], [5e-4, 2e-3, 2e-3]);
/// A robot that is slower rests [m/s, rad/s].
const REST: (f64, f64) = (0.02, 0.02);
/// How well a robot that was searched for is known when it was found, and when it was not [m, rad].
const FOUND_M: f64 = 0.1;
const FOUND_RAD: f64 = 0.05;
const LOST_M: f64 = 1.0;
const LOST_RAD: f64 = 0.3;

/// What of the scans corrects the pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LaserMode {
    /// Nothing: the pose is that of the odometry.
    Off,
    /// Surfaces that the track states: its walls, or the hall around it.
    Walls,
    /// Surfaces that were seen before.
    Match,
}

impl Setting for LaserMode {}

impl LaserMode {
    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Walls => "walls",
            Self::Match => "match",
        }
    }
}

plain_state! {
    /// What became of the scans.
    pub struct LaserState {
        /// Time of the last scan that was matched [ns]
        pub looked_ns: u64,
        /// Scans that corrected the pose
        pub matched: u64,
        /// Scans that showed too little of what is known
        pub unmatched: u64,
        /// Scans that came too fast after the one before
        pub skipped: u64,
        /// Fingerprint of the ranges of the last scan
        pub ranges: u64,
        /// 1 while the ranges are those from before the robot moved
        pub is_stuck: u64,
        /// Scans that came after the next pose was computed
        pub late: u64,
        /// What the ranges have too much
        pub offset: RangeOffset,
        /// Whether the surfaces that the track states are there
        pub stated: Stated,
        /// The search for a robot that is not where it was
        pub search: Search,
        /// Surfaces that were seen
        pub map: SurfaceMap,
        /// The scan that others are laid onto, of a poor odometer
        pub key: KeyScan,
    }
}

/// What scans may say against the pose or the scanner, in the words of a log.
pub const EVENTS: [&str; 6] = [
    "all ranges are too long or too short: the difference is taken off",
    "the robot was elsewhere and has found itself",
    "the robot is elsewhere and does not find itself",
    "scans contradict the motion: a scanner that has turned, wrong ranges, or an odometer beyond estimator.odometry_scale",
    "the walls that the track states are not there: they are not used",
    "the pillars that the track states are not there: they are not used",
];

impl LaserState {
    /// How often each of [`EVENTS`] was.
    pub fn events(&self) -> [u64; 6] {
        let Self { offset, search, stated, .. } = self;
        let is_missing = |is_long| u64::from(!stated.is_there(is_long));
        [offset.found, search.found, search.lost, search.again, is_missing(true), is_missing(false)]
    }
}

/// The matcher: memory that is kept between scans, but no state.
#[derive(Debug, Clone)]
pub struct Matcher {
    laser: LaserMode,
    track: Track,
    vehicle: Description,
    pieces: Pieces,
    lines: Vec<SurfaceLine>,
    /// Those of a map, and which of them are near and how far [m].
    given: Vec<SurfaceLine>,
    near: Vec<(f64, usize)>,
    /// Where the odometer is poor.
    keys: Option<KeyScans>,
}

impl Matcher {
    /// A matcher for scans of this robot.
    pub fn new(laser: LaserMode, track: Track, vehicle: &Description) -> Self {
        let (lines, given, near) = (Vec::with_capacity(MAX_LINES), Vec::new(), Vec::new());
        Self { laser, track, vehicle: *vehicle, pieces: Pieces::default(), lines, given, near, keys: None }
    }

    /// One that follows a robot with this odometer.
    #[must_use]
    pub fn with_odometer(self, odometer: &DriftSources) -> Self {
        let needs_keys = self.laser == LaserMode::Match && key::is_poor(odometer);
        Self { keys: needs_keys.then(KeyScans::default), ..self }
    }

    /// One that knows the surfaces of a map, instead of those that the track states.
    #[must_use]
    pub fn with_map(self, given: Vec<SurfaceLine>) -> Self {
        Self { near: Vec::with_capacity(given.len()), given, ..self }
    }

    /// Corrects the pose, which is that of the time of the scan, and remembers the surfaces.
    pub fn see(
        &mut self,
        scan: &Scan,
        motion: &SweepMotion,
        state: &mut LaserState,
        reckoning: &mut DeadReckoning,
    ) {
        let acquired_ns = scan.header.acquired_ns;
        if self.laser == LaserMode::Off || scan.missing.is_set() || acquired_ns <= state.looked_ns {
            return;
        }
        if state.looked_ns > 0 && acquired_ns < state.looked_ns + INTERVAL_NS {
            state.skipped += 1;
            return;
        }
        state.looked_ns = acquired_ns;
        let ranges = fingerprint(scan.ranges());
        let is_repeated = std::mem::replace(&mut state.ranges, ranges) == ranges;
        let moves = motion.speed_mps.abs() > REST.0 || motion.yaw_rate_radps.abs() > REST.1;
        state.is_stuck = u64::from(is_repeated && (moves || state.is_stuck == 1));
        // They would say that the robot has not moved.
        if state.is_stuck == 1 {
            state.unmatched += 1;
            return;
        }
        self.pieces.find(scan, &self.vehicle, motion, state.offset.offset_m);
        self.pieces.longer_m = state.offset.seems_m();
        let shared = self.keys.as_mut().and_then(|keys| {
            let seen = (scan, motion, state.offset.offset_m);
            keys.lay(seen, &state.key, &self.vehicle, reckoning)
        });
        self.gather(state, &reckoning.pose);
        match state.search.follow(
            scan,
            &self.pieces,
            &self.lines,
            reckoning.pose,
            &self.vehicle,
            &mut state.stated,
        ) {
            Whereabouts::Known => {}
            Whereabouts::Sought => return,
            Whereabouts::Found(pose) => {
                state.key = KeyScan::default();
                return reckoning.put(pose, FOUND_M, FOUND_RAD);
            }
            Whereabouts::Lost => {
                // What it has learned of its surroundings is of no use here.
                (state.map, state.key) = (SurfaceMap::default(), KeyScan::default());
                return reckoning.put(Vector3::from(reckoning.pose), LOST_M, LOST_RAD);
            }
        }
        if state.offset.follow(&self.pieces, &self.lines, reckoning) {
            self.pieces.find(scan, &self.vehicle, motion, state.offset.offset_m);
        }
        if state.offset.is_in_doubt() {
            state.unmatched += 1;
            return;
        }
        let mut known = *reckoning;
        if self.keys.is_some() {
            known.weigh_anchor();
        }
        let found = align(&self.pieces, &self.lines, &known);
        let is_known = found.is_some_and(|found| known.correct(&found.sighting));
        if is_known {
            *reckoning = known;
        }
        if self.keys.is_some() && (is_known || state.key.is_passed(&reckoning.pose, shared)) {
            state.key = KeyScan::of(scan, motion, reckoning.pose, state.offset.offset_m);
            reckoning.anchor();
        }
        *(if is_known || shared.is_some() { &mut state.matched } else { &mut state.unmatched }) += 1;
        if self.remembers() {
            self.remember(acquired_ns, motion.speed_mps, state, reckoning);
        }
    }

    /// Whether scans are laid onto those before, as those of a poor odometer are.
    pub fn has_keys(&self) -> bool {
        self.keys.is_some()
    }

    /// Whether surfaces that were seen are remembered: a robot with a poor odometer takes one for another.
    fn remembers(&self) -> bool {
        self.laser == LaserMode::Match && self.keys.is_none()
    }

    /// The lines that the scan may show.
    fn gather(&mut self, state: &LaserState, pose: &[f64; 3]) {
        self.lines.clear();
        let [_, x, y] = *pose;
        let (place, reach_m) = (Vector2::new(x, y), self.vehicle.scanner.range_m);
        let mut take = |line: SurfaceLine| {
            if self.lines.len() < MAX_LINES - SURFACES && state.stated.is_there(line.is_long) {
                self.lines.push(line);
            }
        };
        if self.given.is_empty() {
            known::surfaces(&self.track, place, reach_m, &mut take);
        } else {
            let (near, most) = (&mut self.near, MAX_LINES - SURFACES);
            known::within(&self.given, place, (reach_m, most), near, &mut take);
        }
        if self.remembers() {
            self.lines.extend(state.map.lines(place));
        }
    }

    /// Remembers the pieces of the scan, seen from the corrected pose.
    fn remember(&mut self, now_ns: u64, speed_mps: f64, state: &mut LaserState, reckoning: &DeadReckoning) {
        let (prior, covariance) = (Prior::of(reckoning), reckoning.of_pose());
        let pose = prior.pose;
        let [rate_radps, share, _] = reckoning.deviations();
        let sight = Sight {
            place: Vector2::new(pose[1], pose[2]),
            covariance,
            rate_radps,
            rate_mps: share * speed_mps.abs(),
            noise_m: self.pieces.noise_m,
        };
        for piece in self.pieces.all() {
            let placed = Placed::new(piece, &pose);
            match part_of(piece, &self.lines, &prior, self.pieces.noise_m).and_then(|line| line.index) {
                Some(index) => state.map.see(index, piece.count, &placed, now_ns, &sight),
                None if piece.count >= MIN_COUNT => {
                    let own = placed.uncertainty(piece.count, self.pieces.noise_m, &pose);
                    let beside = if placed.is_long() { BESIDE.1 } else { BESIDE.0 };
                    let beside = Matrix3::from_diagonal(&Vector3::from(beside)).map(|sigma| sigma * sigma);
                    state.map.add(piece, &placed, &pose, &(covariance + own + beside), now_ns);
                }
                None => {}
            }
        }
    }
}

/// FNV-1a of the ranges, taken whole.
fn fingerprint(ranges: &[u32]) -> u64 {
    let hash = |hash: u64, range: &u32| (hash ^ u64::from(*range)).wrapping_mul(0x100_0000_01b3);
    ranges.iter().fold(0xcbf2_9ce4_8422_2325, hash)
}

#[cfg(test)]
mod tests;
