//! Evidence: what the scans show of the scanner itself.
//!
//! A missing return is no proof of free space: it also comes from a covered window, a black surface or a defect. So
//! each scan is compared with earlier ones and the motion of the robot. What they predict must come:
//!
//! * [`returns`]: which share of the returns of the scan before comes again, at the predicted range;
//! * [`sectors`]: the same per direction, for what does not move, over some way;
//! * [`calibration`]: whether the ranges fit the way of the robot.
//!
//! [`verdict`] makes the state of the scanner out of it. A scan whose ranges are repeated, or contradict the one before,
//! counts as missing: bodies are remembered as if it had not come.
//!
//! Of a scanner with more beams than the URG-04LX, every so manieth is compared, see [`Thin`](crate::thin::Thin).

mod calibration;
mod returns;
mod sectors;
mod snapshot;
mod verdict;

use shared_types::{SECTORS, Scan, ScannerHealth, plain_state};
use std::ops::RangeInclusive;
use vehicle::geometry::Rectangle;
use vehicle::{Description, Surroundings};

use crate::config::SWEEP_SHARE;
use crate::points::{Beams, Place, Point};
use crate::way::Way;
use calibration::{CalibrationState, Errors, index_beams};
use returns::Returns;
use sectors::Looks;
pub(crate) use sectors::REACH_M;
use snapshot::{Snapshot, SnapshotState};
use verdict::{Brought, Findings, VerdictState};

/// A robot that has moved or turned less than this rests [m, rad].
const REST: (f64, f64) = (0.003, 0.003);
/// Ranges that are repeated count only with at least so many returns.
const STUCK_RETURNS: usize = 20;
/// Time between two comparisons per direction [s]: at higher scan rates they show nothing new.
const COMPARISON_S: f64 = 0.045;
/// A sector has shown something lately when it was in this time, or the time of this length before [s].
const LATELY_S: f64 = 1.0;
/// Way and turn after which what does not move is kept anew for comparison [m, rad].
const KEYFRAME: (f64, f64) = (0.25, 0.06);
/// Most returns of a scan are missing when another one has this many times as many.
const OUTAGE: usize = 2;
/// A scan with less than this share of the predicted ranges contradicts the one before ...
const CONTRADICTION: f64 = 0.2;
/// ... when so many returns came where some were predicted.
const CONTRADICTION_RETURNS: f64 = 30.0;
/// After this way or turn a scan is no longer compared with one from before [m, rad].
const INCOMPARABLE: (f64, f64) = (0.8, 0.6);
/// With ranges that contradict those before for longer than this nothing ahead is seen [s].
const DOUBTFUL_S: f64 = 0.15;
/// With so many scans that repeat ranges while the robot moves nothing ahead is seen: noise never does that.
const DOUBTFUL_SCANS: u32 = 2;
/// With fewer predicted returns than this their share tells nothing.
const PREDICTED: f64 = 25.0;
/// A body of this width is seen with three returns [m].
const THIN_M: f64 = 0.1;
/// With less sight ahead than this the scanner is degraded [m].
const DOUBTFUL_M: f64 = 1.0;
/// A robot slower than this rests [m/s]: blocked wheels are measured as exactly zero.
pub(crate) const REST_MPS: f64 = 0.02;
/// While the robot rests, what stood around it is taken anew for comparison after this time [s] ...
const RENEWED_S: f64 = 0.5;
/// ... and so many scans, after which what only seemed to move is known to stand: what is gone would be missed for ever otherwise.
const RENEWED_SCANS: f64 = 5.0;
/// What was around a robot that rests has changed when not more than this share of it comes again ...
const CHANGED: f64 = 0.5;
/// ... or when the ranges of all beams have changed by this on the average, in which noise vanishes [m]: something that
/// moves is all that is in view. Where more stands, what stands decides.
const SHIFTED_M: f64 = 0.05;
/// For how long the robot is careful after it has relied on a sector without knowing why it shows nothing, or on ranges that
/// seemed to be wrong [s].
const CAREFUL_S: f64 = 3.0;
/// Distance of the robot's side within which what a blind sector hides matters [m].
const STRIP_M: f64 = 0.15;

plain_state! {
    /// What the evidence of the next scan depends on.
    pub struct EvidenceState {
        /// The scan before
        pub previous: SnapshotState,
        /// A scan from some way before
        pub keyframe: SnapshotState,
        /// Predicted returns and those that came
        pub returns: Returns,
        /// Per sector: returns of what does not move that were predicted, and those that came
        pub sectors: [[f64; 2]; SECTORS],
        /// Sectors in which a remembered body should be seen and is not, one bit each
        pub silent: u64,
        /// The same for bodies that seem to have gone while the robot rested
        pub gone: u64,
        /// For how long the robot has rested, or rests since the keyframe was taken [s]
        pub rested_s: f64,
        /// For how long it is still careful [s]
        pub careful_s: f64,
        /// Time since the last comparison per sector [s]
        pub waited_s: f64,
        /// Whether the ranges fit the motion
        pub calibration: CalibrationState,
        /// Sectors that have shown something, one bit each
        pub proven: u64,
        /// Those of them in this second, and in the one before
        pub shown: [u64; 2],
        /// Since when this second lasts [s]
        pub shown_s: f64,
        /// State of the scanner
        pub verdict: VerdictState,
    }
}

/// Compares scans with what earlier ones predict.
#[derive(Debug, Clone)]
pub(crate) struct Evidence {
    vehicle: Description,
    previous: Snapshot,
    keyframe: Snapshot,
    returns: Returns,
    sectors: [[f64; 2]; SECTORS],
    proven: u64,
    shown: [u64; 2],
    shown_s: f64,
    rested_s: f64,
    careful_s: f64,
    waited_s: f64,
    calibration: CalibrationState,
    /// By `calibration`, which changes seldom.
    errors: Errors,
    verdict: VerdictState,
    index_of: Vec<u16>,
    /// How many beams of the scanner make a sector.
    sector_beams: usize,
    /// What is needed of the beams without a scan.
    looks: Looks,
    /// Of this scan.
    findings: Findings,
    valid_share: f64,
    is_empty: bool,
    /// Sectors in which a remembered body should be seen and is not, one bit each.
    silent: u64,
    /// The same for bodies that seem to have gone while the robot rested.
    gone: u64,
    /// Sectors in which hardly anything came in this scan of what was predicted, one bit each.
    suspected: u64,
}

impl Evidence {
    /// Of every `stride`th beam of the vehicle's scanner: `beams`.
    pub(crate) fn new(vehicle: Description, beams: &Beams, stride: usize) -> Self {
        Self {
            vehicle,
            sector_beams: beams.sector * stride,
            looks: Looks::of(beams),
            proven: 0,
            shown: [0; 2],
            shown_s: 0.0,
            previous: Snapshot::empty(beams),
            keyframe: Snapshot::empty(beams),
            returns: Returns::default(),
            sectors: [[0.0; 2]; SECTORS],
            rested_s: 0.0,
            careful_s: 0.0,
            waited_s: 0.0,
            calibration: CalibrationState::default(),
            errors: CalibrationState::default().errors(),
            verdict: VerdictState::default(),
            index_of: Vec::with_capacity(beams.count()),
            findings: Findings::default(),
            valid_share: 0.0,
            is_empty: false,
            silent: 0,
            gone: 0,
            suspected: 0,
        }
    }

    /// A scan without ranges, `elapsed` seconds after the last.
    pub(crate) fn miss(&mut self, elapsed: f64) {
        self.findings = Findings { elapsed, brought: Brought::Nothing, ..Findings::default() };
        (self.valid_share, self.is_empty) = (0.0, false);
    }

    /// Compares a scan with the one before; `points` are its returns. Whether bodies can be found in it: otherwise it is as
    /// if it had not come.
    pub(crate) fn receive(
        &mut self,
        beams: &Beams,
        scan: &Scan,
        place: &Place,
        points: &[Point],
        elapsed: f64,
    ) -> bool {
        let [first, last] = beams.ahead(self.vehicle.scanner_yaw_rad);
        let valid = (first..=last).filter(|beam| beams.range_of(scan, *beam).is_some()).count();
        self.valid_share = valid as f64 / (last + 1 - first) as f64;
        self.is_empty = self.vehicle.surroundings == Surroundings::Hall
            && (points.len() as f64) < SWEEP_SHARE * beams.count() as f64;
        (self.silent, self.gone, self.suspected) = (0, 0, 0);
        self.rested_s = if place.speed() < REST_MPS { self.rested_s + elapsed } else { 0.0 };
        self.careful_s = (self.careful_s - elapsed).max(0.0);
        let brought = self.bring(beams, scan, place, points, elapsed);
        self.findings = Findings { elapsed, brought, ..Findings::default() };
        matches!(brought, Brought::Ranges | Brought::Nothing)
    }

    fn bring(
        &mut self,
        beams: &Beams,
        scan: &Scan,
        place: &Place,
        points: &[Point],
        elapsed: f64,
    ) -> Brought {
        let (way, turn) = self.previous.moved(place);
        if self.repeats(beams, scan, points.len()) {
            // The place of the first of them is kept, so that a slow motion adds up.
            return if way > REST.0 || turn > REST.1 { Brought::Repetition } else { Brought::Ranges };
        }
        let counts = Returns::count(&self.previous, beams, scan, place);
        let is_comparable = way < INCOMPARABLE.0 && turn < INCOMPARABLE.1;
        let is_wrong = counts.right_share(CONTRADICTION_RETURNS).is_some_and(|share| share < CONTRADICTION);
        if is_wrong {
            if !is_comparable {
                self.previous.keep(scan, place, points, |_| false);
            }
            if !self.calibration.contradicts(&self.errors) {
                return Brought::Jump;
            }
            // The ranges changed as a whole: what contradicted the motion has ended.
            self.trust_ranges();
            self.returns = Returns::default();
            self.keyframe.clear();
        } else {
            self.returns.add(&counts, elapsed);
        }
        self.previous.keep(scan, place, points, |_| false);
        if self.is_empty { Brought::Nothing } else { Brought::Ranges }
    }

    /// Forgets by how much the ranges seemed to be wrong.
    fn trust_ranges(&mut self) {
        self.calibration = CalibrationState::default();
        self.errors = self.calibration.errors();
    }

    /// Whether what is around has changed since the keyframe. A body that still moves when the robot has rested since then
    /// does move: in open surroundings its returns may have contradicted the motion before it was known to. Where a hall is
    /// in view, its walls have.
    fn has_changed(&self, beams: &Beams, scan: &Scan, place: &Place, something_moves: bool) -> bool {
        let counts = Returns::count(&self.keyframe, beams, scan, place);
        let (way, turn) = self.keyframe.moved(place);
        let has_rested = way < REST.0 && turn < REST.1;
        counts.agreed <= CHANGED * counts.predicted
            || has_rested
                && (something_moves && self.is_open() || self.keyframe.shift(beams, scan) > SHIFTED_M)
    }

    /// Compares what does not move with the scan from some way before; `is_fixed` tells of a beam what it shows, and
    /// `something_moves` whether the scan shows a body that seems to move.
    pub(crate) fn compare(
        &mut self,
        beams: &Beams,
        scan: &Scan,
        (place, way): (&Place, &Way),
        points: &[Point],
        something_moves: bool,
        is_fixed: impl Fn(usize) -> bool + Copy,
    ) {
        self.waited_s += self.findings.elapsed;
        if self.waited_s < COMPARISON_S {
            return;
        }
        let waited = std::mem::take(&mut self.waited_s);
        let mut counts = [[0.0; 2]; SECTORS];
        let shown = sectors::show(&mut counts, self.proven, (scan, beams), |beam| {
            way.is_wall_near(beams, place, beam)
        });
        self.note(shown, waited);
        if let Some(before) = self.keyframe.place() {
            let keyframe = &self.keyframe;
            // Every other beam each way: half of the time, and still all sectors.
            let kept =
                keyframe.points().iter().filter(|point| point.beam % 2 == 0 && keyframe.is_fixed(point.beam));
            sectors::compare(&mut counts, beams, keyframe.scan(), kept, (scan, place));
            let seen = points.iter().filter(|point| point.beam % 2 == 1 && is_fixed(point.beam));
            sectors::compare(&mut counts, beams, scan, seen, (keyframe.scan(), before));
        }
        sectors::add(&mut self.sectors, &counts, waited);
        self.suspected = sectors::suspected(&counts);
        if self.rested_s > RENEWED_S.max(RENEWED_SCANS * self.findings.elapsed) && !self.is_empty {
            self.rested_s = 0.0;
            // No error of the ranges moves anything while the robot rests: what moves or has gone contradicted nothing.
            if self.calibration.contradicts(&self.errors)
                && self.has_changed(beams, scan, place, something_moves)
            {
                self.verdict.settle();
                self.careful_s = CAREFUL_S;
                self.trust_ranges();
            }
            self.keyframe.keep(scan, place, points, is_fixed);
        }
        let (way, turn) = self.keyframe.moved(place);
        // A scan in which something seems to fail is no base for comparison before that was judged.
        let limit = if self.suspected != 0 { 2.0 } else { 1.0 };
        let (returns, kept) = (points.len(), self.keyframe.points().len());
        // Nor is one in which most returns are missing suddenly: the robot may come to rest before they come again, and
        // would then find no evidence in any direction of which that scan showed nothing.
        let limit = if OUTAGE * returns < kept { 3.0 } else { limit };
        let has_recovered = returns > OUTAGE * kept;
        if (way > limit * KEYFRAME.0 || turn > limit * KEYFRAME.1 || has_recovered) && !self.is_empty {
            if way < 3.0 * KEYFRAME.0 && turn < 4.0 * KEYFRAME.1 {
                index_beams(points, beams.count(), &mut self.index_of);
                self.calibration.add(&self.keyframe, beams, (place, points), &self.index_of);
                self.errors = self.calibration.errors();
            }
            self.keyframe.keep(scan, place, points, is_fixed);
        }
    }

    /// Notes the sectors that a scan shows something in.
    fn note(&mut self, shown: u64, elapsed: f64) {
        self.proven |= shown;
        self.shown_s += elapsed;
        if self.shown_s > LATELY_S {
            (self.shown, self.shown_s) = ([0, self.shown[0]], 0.0);
        }
        self.shown[0] |= shown;
    }

    /// Counts the sectors of these beams as without evidence: a remembered body that they should show is not seen. One that
    /// `may_have_gone` counts only if other returns are missing too.
    pub(crate) fn doubt(&mut self, beams: &RangeInclusive<usize>, may_have_gone: bool) {
        let sectors = self.sectors_of(*beams.start(), *beams.end());
        if may_have_gone {
            // What else is missing at its ends is of the same body.
            let beside = (beams.end() - beams.start()) / 3 + self.sector_beams;
            self.gone |= self.sectors_of(beams.start().saturating_sub(beside), beams.end() + beside);
            self.careful_s = CAREFUL_S;
        } else {
            self.silent |= sectors;
        }
    }

    /// Whether hardly anything came in one of the sectors of these beams, in this scan, of what was predicted.
    pub(crate) fn suspects(&self, beams: &RangeInclusive<usize>) -> bool {
        self.suspected & self.sectors_of(*beams.start(), *beams.end()) != 0
    }

    /// How many beams of the scanner make a sector.
    pub(crate) fn sector_beams(&self) -> usize {
        self.sector_beams
    }

    /// The sectors of the beams of the scanner from `first` to `last`, one bit each.
    fn sectors_of(&self, first: usize, last: usize) -> u64 {
        let sectors = first / self.sector_beams..=(last / self.sector_beams).min(SECTORS - 1);
        sectors.fold(0, |mask, sector| mask | 1 << sector)
    }

    /// Whether all that is missing is of bodies that may have gone.
    pub(crate) fn lacks_only_bodies(&self) -> bool {
        self.failing() & !(self.silent | self.gone) == 0
    }

    /// The returns within `rectangle` are no longer expected: the body there moves, or has gone.
    pub(crate) fn release(&mut self, rectangle: &Rectangle) {
        self.keyframe.loosen(rectangle);
    }

    /// Share of the predicted returns that come.
    fn returned_share(&self) -> f64 {
        self.returns.agreed_share(PREDICTED).unwrap_or(1.0).clamp(0.0, 1.0)
    }

    /// Sectors in which hardly anything came of what earlier scans or walls predict.
    fn failing(&self) -> u64 {
        sectors::failing(&self.sectors, self.returned_share())
    }

    /// Sectors without evidence of this scan. A scan without ranges keeps those of the scan before.
    pub(crate) fn silent(&self) -> u64 {
        self.silent
    }

    /// Puts back [`Evidence::silent`].
    pub(crate) fn set_silent(&mut self, silent: u64) {
        self.silent = silent;
    }

    /// The health of the scanner after this scan; `speed` is the robot's [m/s].
    pub(crate) fn health(&mut self, speed: f64) -> ScannerHealth {
        let agreed = self.returns.agreed_share(PREDICTED);
        self.findings.agreed_share = agreed;
        self.findings.right_share = self.returns.right_share(PREDICTED);
        self.findings.contradicts = self.calibration.contradicts(&self.errors);
        self.findings.is_doubtful = self.calibration.blames_odometry.is_set();
        self.findings.is_doubtful |= self.careful_s > 0.0;
        let share = self.returned_share();
        let lately = self.shown[0] | self.shown[1];
        let silent = self.silent | if self.lacks_only_bodies() { 0 } else { self.gone };
        let unseen_sectors = sectors::unseen(self.failing() | silent, lately);
        // They have to show something again before they are relied on.
        self.proven &= !unseen_sectors;
        let sight_m = self.sight(unseen_sectors, share);
        self.findings.is_doubtful |= sight_m < DOUBTFUL_M;
        let state = self.verdict.judge(&self.findings);
        let [factor, range_offset_m, yaw_error_rad] = self.errors.values;
        ScannerHealth {
            state: state.wire(),
            identical_scans: self.verdict.identical,
            unseen_sectors,
            valid_share: self.valid_share,
            returned_share: share,
            blind_s: self.verdict.blind_s,
            seen_ahead_m: (sight_m - speed.abs() * self.verdict.blind_s).max(0.0),
            range_factor: 1.0 + factor,
            range_offset_m,
            yaw_error_rad,
        }
    }

    /// Distance ahead of the robot's centre within which the scanner misses nothing that stands there [m].
    fn sight(&self, unseen_sectors: u64, share: f64) -> f64 {
        let has_seen = self.previous.place().is_some();
        let is_doubtful = self.verdict.jumped_s > DOUBTFUL_S || self.verdict.identical >= DOUBTFUL_SCANS;
        if !has_seen || self.is_empty || is_doubtful {
            return 0.0;
        }
        let strip = self.vehicle.width_m / 2.0 + STRIP_M;
        let seen = sectors::seen_ahead(unseen_sectors, &self.looks, self.vehicle.scanner_yaw_rad, strip);
        seen.min(THIN_M * share / (3.0 * self.vehicle.scanner.increment_rad))
    }

    /// Whether nothing need be in view.
    pub(crate) fn is_open(&self) -> bool {
        self.vehicle.surroundings == Surroundings::Open
    }

    /// Whether the ranges can be relied on, so that it tells something when none comes from a direction.
    pub(crate) fn is_reliable(&self) -> bool {
        !self.verdict.state().is_stop()
    }

    /// All that the next scan depends on.
    pub(crate) fn state(&self) -> EvidenceState {
        EvidenceState {
            previous: self.previous.state(),
            keyframe: self.keyframe.state(),
            returns: self.returns,
            sectors: self.sectors,
            proven: self.proven,
            shown: self.shown,
            shown_s: self.shown_s,
            silent: self.silent,
            gone: self.gone,
            rested_s: self.rested_s,
            careful_s: self.careful_s,
            waited_s: self.waited_s,
            calibration: self.calibration,
            verdict: self.verdict,
        }
    }

    /// Whether a state is possible.
    pub(crate) fn is_sound(state: &EvidenceState) -> bool {
        let counts = state.sectors.iter().flatten();
        counts.copied().all(|count| (0.0..1e9).contains(&count))
            && [state.waited_s, state.shown_s, state.rested_s, state.careful_s]
                .iter()
                .all(|time| (0.0..1e9).contains(time))
            && state.returns.is_sound()
            && state.calibration.is_sound()
            && state.verdict.is_sound()
    }

    /// Continues from a state that is possible.
    pub(crate) fn resume(&mut self, state: &EvidenceState, beams: &Beams) {
        self.previous.resume(&state.previous, beams);
        self.keyframe.resume(&state.keyframe, beams);
        self.returns = state.returns;
        self.sectors = state.sectors;
        self.proven = state.proven;
        (self.shown, self.shown_s) = (state.shown, state.shown_s);
        (self.silent, self.gone) = (state.silent, state.gone);
        (self.rested_s, self.careful_s) = (state.rested_s, state.careful_s);
        self.waited_s = state.waited_s;
        self.calibration = state.calibration;
        self.errors = self.calibration.errors();
        self.verdict = state.verdict;
    }

    /// Whether the scan has the same returns as the one before.
    fn repeats(&self, beams: &Beams, scan: &Scan, returns: usize) -> bool {
        let before = self.previous.scan();
        returns >= STUCK_RETURNS
            && self.previous.place().is_some()
            && (0..beams.count()).all(|beam| beams.range_of(scan, beam) == beams.range_of(before, beam))
    }
}
