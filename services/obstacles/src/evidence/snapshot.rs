//! A scan that is kept for comparison, with the pose that it was taken from.

use nalgebra::Vector2;
use shared_types::{BEAMS, Scan, plain_state};
use vehicle::geometry::Rectangle;

use crate::points::{Beams, Place, Point};

/// A beam that is predicted to be turned by more than this (sine) is not compared.
const MAX_TURN: f64 = 0.7;
/// Words of the mask with one bit per beam; of more beams than the URG-04LX has, only some are kept.
const WORDS: usize = BEAMS.div_ceil(64);

plain_state! {
    /// A scan that is kept for comparison.
    pub struct SnapshotState {
        /// Position of the scanner, its yaw, its velocity on the track and its yaw rate [m, rad, m/s, rad/s]
        pub place: [f64; 6],
        /// How long the sweep took [ns]; zero for none
        pub sweep_ns: u64,
        /// One bit for each beam whose return is of something that does not move
        pub fixed: [u64; WORDS],
        /// Ranges, below 20 for no return; beyond the reach of the detector they may be shorter [mm]
        pub ranges_mm: [u16; BEAMS],
        /// Unused, zero
        pub reserved: u32,
    }
}

/// A kept scan with its returns placed on the track.
#[derive(Debug, Clone)]
pub(crate) struct Snapshot {
    scan: Scan,
    place: Option<Place>,
    fixed: [u64; WORDS],
    points: Vec<Point>,
}

/// Where a return of one scan is expected in another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Expected {
    /// Index of the beam.
    pub(crate) beam: usize,
    /// Range [m].
    pub(crate) range: f64,
}

impl Snapshot {
    /// No scan yet.
    pub(crate) fn empty(beams: &Beams) -> Self {
        Self {
            scan: Scan::of(beams.geometry),
            place: None,
            fixed: [0; WORDS],
            points: Vec::with_capacity(beams.count()),
        }
    }

    /// The scan as plain bytes.
    pub(crate) fn state(&self) -> SnapshotState {
        let Some(place) = self.place else { return SnapshotState::default() };
        let mut state = SnapshotState {
            place: place.to_array(),
            sweep_ns: self.scan.sweep_ns,
            fixed: self.fixed,
            ..SnapshotState::default()
        };
        for (kept, range) in state.ranges_mm.iter_mut().zip(self.scan.ranges()) {
            *kept = u16::try_from(*range).unwrap_or(u16::MAX);
        }
        state
    }

    /// The scan of a state; none where its place is impossible.
    pub(crate) fn resume(&mut self, state: &SnapshotState, beams: &Beams) {
        self.clear();
        if state.sweep_ns == 0 || !state.place.iter().all(|value| value.abs() < 1e6) {
            return;
        }
        (self.scan.sweep_ns, self.fixed) = (state.sweep_ns, state.fixed);
        for (range, kept) in self.scan.ranges_mut().iter_mut().zip(&state.ranges_mm) {
            *range = u32::from(*kept);
        }
        let place = Place::from_array(state.place);
        beams.place(&self.scan, &place, &mut self.points);
        self.place = Some(place);
    }

    /// Keeps a scan; `points` are all its returns and `is_fixed` tells which of them do not move.
    pub(crate) fn keep(
        &mut self,
        scan: &Scan,
        place: &Place,
        points: &[Point],
        is_fixed: impl Fn(usize) -> bool,
    ) {
        self.place = Some(*place);
        self.scan.sweep_ns = scan.sweep_ns;
        self.scan.ranges_mut().copy_from_slice(scan.ranges());
        self.points.clear();
        self.points.extend_from_slice(points);
        self.fixed = [0; WORDS];
        for point in points.iter().filter(|point| is_fixed(point.beam)) {
            self.fixed[point.beam / 64] |= 1 << (point.beam % 64);
        }
    }

    /// The returns within `rectangle` may have moved: they are not of what stands.
    pub(crate) fn loosen(&mut self, rectangle: &Rectangle) {
        for point in &self.points {
            if rectangle.distance_to_point(point.at) < 0.0 {
                self.fixed[point.beam / 64] &= !(1 << (point.beam % 64));
            }
        }
    }

    /// Forgets the scan.
    pub(crate) fn clear(&mut self) {
        self.place = None;
        self.fixed = [0; WORDS];
        self.points.clear();
    }

    /// Pose of the scanner, `None` when no scan is kept.
    pub(crate) fn place(&self) -> Option<&Place> {
        self.place.as_ref()
    }

    /// The kept scan.
    pub(crate) fn scan(&self) -> &Scan {
        &self.scan
    }

    /// All returns, in the order of beams.
    pub(crate) fn points(&self) -> &[Point] {
        &self.points
    }

    /// Whether the return of a beam is of something that does not move.
    pub(crate) fn is_fixed(&self, beam: usize) -> bool {
        self.fixed[beam / 64] >> (beam % 64) & 1 == 1
    }

    /// By how much the ranges of `scan`, from the same place, are longer or shorter on the average [m].
    pub(crate) fn shift(&self, beams: &Beams, scan: &Scan) -> f64 {
        let change = |point: &Point| Some(beams.range_of(scan, point.beam)? - point.range);
        let changes = self.points.iter().filter_map(change);
        let (count, sum) = changes.fold((0, 0.0), |(count, sum), change| (count + 1, sum + change));
        (sum / f64::from(count.max(1))).abs()
    }

    /// How far the scanner is from where the scan was taken, and how far it has turned [m, rad].
    pub(crate) fn moved(&self, place: &Place) -> (f64, f64) {
        self.place.as_ref().map_or((f64::INFINITY, f64::INFINITY), |before| {
            ((place.at - before.at).norm(), (place.yaw - before.yaw).abs())
        })
    }
}

/// What a scan would see of points that are known: its pose with sine and cosine of the yaw.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Viewpoint<'a> {
    beams: &'a Beams,
    place: &'a Place,
    /// Time from one beam to the next [s].
    beam_s: f64,
    sin: f64,
    cos: f64,
}

impl<'a> Viewpoint<'a> {
    /// The view of a scan from `place`.
    pub(crate) fn new(beams: &'a Beams, scan: &Scan, place: &'a Place) -> Self {
        let (sin, cos) = place.yaw.sin_cos();
        let beam_s = 1.0 / beams.count() as f64 * scan.sweep_ns as f64 * 1e-9;
        Self { beams, place, beam_s, sin, cos }
    }

    /// Where the return at `point` is expected; `None` when the view has changed too much.
    #[inline]
    pub(crate) fn expected(&self, point: &Point) -> Option<Expected> {
        let time = self.beam_s * (point.beam as f64 - self.beams.front);
        let (at, turned) = self.place.moved_by(time);
        let offset = point.at - at;
        // The turn within a sweep is below 0.1 rad, where the error of the series is 1e-6.
        let (turn_sin, turn_cos) = (turned - turned * turned * turned / 6.0, 1.0 - turned * turned / 2.0);
        let (sin, cos) =
            (self.sin * turn_cos + self.cos * turn_sin, self.cos * turn_cos - self.sin * turn_sin);
        let seen = Vector2::new(cos * offset.x + sin * offset.y, cos * offset.y - sin * offset.x);
        let range = seen.norm();
        let unit = self.beams.unit(point.beam);
        let sine = (unit.x * seen.y - unit.y * seen.x) / range.max(1e-6);
        if sine.abs() > MAX_TURN || unit.dot(&seen) <= 0.0 {
            return None;
        }
        // Series of the arc sine: 1e-3 rad off at the largest turn.
        let square = sine * sine;
        let turn =
            sine * (1.0 + square * (1.0 / 6.0 + square * (0.075 + square * (0.0446 + square * 0.0304))));
        // Rounded to the nearest beam; the sum is positive where the beam exists.
        let beam = point.beam as f64 + turn * (1.0 / self.beams.pitch()) + 0.5;
        (0.0..self.beams.count() as f64).contains(&beam).then_some(Expected { beam: beam as usize, range })
    }
}

/// Whether the returns around a beam have about the same range, so that it shows a surface and no edge.
pub(crate) fn is_surface(beams: &Beams, scan: &Scan, point: &Point) -> bool {
    let low = point.beam.saturating_sub(2);
    let high = (point.beam + 2).min(beams.count() - 1);
    (low..=high)
        .filter_map(|beam| beams.range_of(scan, beam))
        .all(|range| (range - point.range).abs() < 0.1 + 0.1 * point.range)
}

/// Normal of the surface at a return; `None` at an edge, a corner, or a return that stands alone.
pub(crate) fn normal_at(points: &[Point], index: usize) -> Option<Vector2<f64>> {
    let reach = 3;
    let (low, high) = (index.saturating_sub(reach), (index + reach).min(points.len().saturating_sub(1)));
    let (first, last) = (&points[low], &points[high]);
    let along = last.at - first.at;
    let length = along.norm();
    let is_near = last.beam - first.beam <= 4 * reach && length > 0.01 && length < 0.6;
    if !is_near || high - low < reach {
        return None;
    }
    let normal = Vector2::new(-along.y, along.x) / length;
    // The points between lie on the line: an edge or a corner has no normal.
    let is_straight = points[low..=high].iter().all(|point| normal.dot(&(point.at - first.at)).abs() < 0.06);
    is_straight.then_some(normal)
}

#[cfg(test)]
mod tests {
    use shared_types::ScanGeometry;

    use super::*;

    #[test]
    fn ranges_that_change_as_a_whole_shift_the_scan_and_noise_does_not() {
        let (beams, place) = (Beams::urg(), Place::standing(Vector2::zeros(), 0.0));
        let mut scan = Scan::of(ScanGeometry::URG_04LX);
        scan.ranges_mm[300..320].fill(2000);
        let (mut points, mut snapshot) = (Vec::new(), Snapshot::empty(&beams));
        beams.place(&scan, &place, &mut points);
        snapshot.keep(&scan, &place, &points, |_| true);
        assert_eq!(snapshot.shift(&beams, &scan), 0.0);
        scan.ranges_mm[300..310].fill(2100);
        scan.ranges_mm[310..320].fill(1900);
        assert!(snapshot.shift(&beams, &scan) < 1e-12);
        // Half of the beams are 0.2 m longer; a lost one does not count.
        scan.ranges_mm[300..310].fill(2200);
        scan.ranges_mm[310..320].fill(2000);
        assert!((snapshot.shift(&beams, &scan) - 0.1).abs() < 1e-12);
        scan.ranges_mm[300..320].fill(0);
        assert_eq!(snapshot.shift(&beams, &scan), 0.0);
    }
}
