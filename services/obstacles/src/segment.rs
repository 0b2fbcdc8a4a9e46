//! Segmentation: which neighbouring returns belong to one body.
//!
//! Two returns belong together when they are nearer than neighbouring returns of a surface at a grazing angle of
//! 10 deg, plus three standard deviations of the range. Missing beams (dropouts) widen the gap that is allowed, a
//! single return off the surface (speckle) is skipped. The last return of a body is dropped when it trails far behind
//! along its ray: a beam that hit an edge and the background at once (mixed pixel).
//!
//! Where it fails: bodies less than about 0.2 m apart at 5 m range are one. No robot fits in between.

use shared_types::Scan;

use crate::points::{Beams, Point};

/// Sine of the flattest angle between beam and surface that still connects two returns: 10 deg.
const GRAZING: f64 = 0.174;
/// Largest gap within one body, whatever the range [m]. The robot needs more than 0.4 m to pass.
const MAX_GAP_M: f64 = 0.35;
/// Largest step in beams from one return to the next of a body: four dropouts in a row are one in 160 000 at 5 %.
const MAX_BEAM_STEP: usize = 5;
/// A body this near counts wherever the scanner sees it [m].
const BESIDE_M: f64 = 1.5;
/// Bodies nearer than this show at least three beams of the URG-04LX when they are 3 cm wide [m].
const SPARSE_M: f64 = 3.0;
/// A neighbour nearer than the end of a body by this hides what is behind it [m].
pub(crate) const HIDING_M: f64 = 0.15;
/// Beyond this range of the URG-04LX the end of a body cannot be told from the end of the view [m].
const FADING_M: f64 = 5.4;

/// Returns of one body: a range of [`Segments::members`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cluster {
    /// Index of the first member.
    pub(crate) first: usize,
    /// Index behind the last member.
    pub(crate) end: usize,
    /// Whether it is evidence enough for a new body.
    pub(crate) may_start: bool,
    /// What limits it at its first and at its last member.
    pub(crate) ends: [End; 2],
}

/// What is next to the last return of a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    /// A return of what is behind: the body ends there.
    Seen,
    /// No return at all: the view of nothing, or beams that see nothing.
    Silent,
    /// Something nearer, or the end of the view: the body may continue.
    Hidden,
}

/// Clusters of one scan; buffers are kept.
#[derive(Debug, Clone, Default)]
pub(crate) struct Segments {
    /// Members of all clusters, one cluster behind the other.
    pub(crate) members: Vec<Point>,
    /// The clusters from right to left.
    pub(crate) clusters: Vec<Cluster>,
    /// The first and the last beam that look ahead.
    pub(crate) ahead: [usize; 2],
    // Buffers of the parting.
    pub(crate) parts: Vec<Cluster>,
    pub(crate) owners: Vec<Option<usize>>,
    pub(crate) front: Vec<usize>,
}

impl Segments {
    /// Buffers large enough for any scan of a scanner that is turned by `yaw_rad`.
    pub(crate) fn with_capacity(beams: &Beams, yaw_rad: f64) -> Self {
        let count = beams.count();
        Self {
            ahead: beams.ahead(yaw_rad),
            members: Vec::with_capacity(count),
            clusters: Vec::with_capacity(count),
            parts: Vec::with_capacity(count),
            owners: Vec::with_capacity(count),
            front: Vec::with_capacity(count),
        }
    }

    /// Finds the clusters among `points`, which are in the order of beams. None reaches across the lines that tell
    /// what is beside the track: a body at rest ends there, however far what it touches extends.
    pub(crate) fn find(
        &mut self,
        (scan, beams): (&Scan, &Beams),
        points: &[Point],
        range_noise: f64,
        is_beside: impl Fn(&Point) -> bool,
    ) {
        self.members.clear();
        self.clusters.clear();
        let (mut first, mut continues) = (0, false);
        for (index, point) in points.iter().enumerate() {
            if let Some(last) = self.members[first..].last().copied() {
                let is_one = connected(&last, point, range_noise, beams.pitch());
                if !is_one || is_beside(&last) != is_beside(point) {
                    if is_speckle(points, index, &last, range_noise, beams.pitch()) {
                        continue;
                    }
                    self.close((scan, beams), first, range_noise, [continues, is_one]);
                    (first, continues) = (self.members.len(), is_one);
                }
            }
            self.members.push(*point);
        }
        self.close((scan, beams), first, range_noise, [continues, false]);
    }

    /// Ends the cluster that starts at member `first`, or forgets it when it is too small. What it is of `continues` beyond
    /// its ends, or does not.
    fn close(
        &mut self,
        (scan, beams): (&Scan, &Beams),
        mut first: usize,
        range_noise: f64,
        continues: [bool; 2],
    ) {
        let start = first;
        if let [.., inner, neighbour, end] = &self.members[first..]
            && is_mixed(end, neighbour, inner, range_noise)
        {
            self.members.pop();
        }
        if let [end, neighbour, inner, ..] = &self.members[first..]
            && is_mixed(end, neighbour, inner, range_noise)
        {
            first += 1;
        }
        let members = &self.members[first..];
        let range = members.iter().map(|point| point.range).fold(f64::INFINITY, f64::min);
        let needed = if range > SPARSE_M / beams.coarseness() { 2 } else { 3 };
        if members.len() < needed {
            self.members.truncate(start);
            return;
        }
        let may_start = may_start(members, self.ahead, range_noise);
        let end = |member: &Point, leftwards| end_of(scan, beams, member, leftwards);
        let mut ends = [end(&members[0], false), end(&members[members.len() - 1], true)];
        for (end, continues) in ends.iter_mut().zip(continues) {
            if continues {
                *end = End::Hidden;
            }
        }
        self.clusters.push(Cluster { first, end: self.members.len(), may_start, ends });
    }
}

/// Whether returns of one surface are evidence enough for a new body: it is ahead, or so near that it may come from the side.
pub(crate) fn may_start(members: &[Point], [first, last]: [usize; 2], range_noise: f64) -> bool {
    let is_in_view = |point: &&Point| (first..=last).contains(&point.beam) || point.range < BESIDE_M;
    let in_view = members.iter().filter(is_in_view).count();
    // A few returns one behind the other are mixed pixels between an edge and its background.
    let nearest = members.iter().map(|point| point.range).fold(f64::INFINITY, f64::min);
    let farthest = members.iter().map(|point| point.range).fold(0.0, f64::max);
    in_view >= 2 && (members.len() > 3 || farthest - nearest < 6.0 * range_noise)
}

/// Whether two returns can lie on one surface, with `pitch` from beam to beam.
fn connected(a: &Point, b: &Point, range_noise: f64, pitch: f64) -> bool {
    let step = b.beam - a.beam;
    if step > MAX_BEAM_STEP {
        return false;
    }
    let spacing = step as f64 * pitch * a.range.min(b.range);
    let gap = (3.0 * range_noise + spacing / GRAZING).min(MAX_GAP_M);
    (b.at - a.at).norm_squared() <= gap * gap
}

/// Whether the return at `index` stands alone between two of one surface.
fn is_speckle(points: &[Point], index: usize, last: &Point, range_noise: f64, pitch: f64) -> bool {
    points.get(index + 1).is_some_and(|next| {
        connected(last, next, range_noise, pitch) && !connected(&points[index], next, range_noise, pitch)
    })
}

/// Whether `end` trails behind (or ahead of) its neighbours along the ray.
fn is_mixed(end: &Point, neighbour: &Point, inner: &Point, range_noise: f64) -> bool {
    let trail = (end.at - neighbour.at).norm();
    let usual = (neighbour.at - inner.at).norm();
    let along = (end.range - neighbour.range).abs();
    trail > 4.0 * range_noise && trail > 2.5 * usual && along > 0.8 * trail
}

/// What limits a body beyond its return `end`.
fn end_of(scan: &Scan, beams: &Beams, end: &Point, leftwards: bool) -> End {
    if end.range > beams.reach(FADING_M) {
        return End::Hidden;
    }
    for step in 1..=4 {
        let beam = if leftwards { end.beam.checked_add(step) } else { end.beam.checked_sub(step) };
        let Some(beam) = beam.filter(|beam| *beam < beams.count()) else { return End::Hidden };
        if let Some(range) = beams.range_of(scan, beam) {
            return if range < end.range - HIDING_M { End::Hidden } else { End::Seen };
        }
    }
    End::Silent
}

#[cfg(test)]
mod tests {
    use shared_types::ScanGeometry;

    use super::*;
    use crate::points::Place;
    use nalgebra::Vector2;

    /// How many bodies ten returns on each side of `lost` beams without one are, 2 m away.
    fn bodies(lost: usize) -> usize {
        let mut scan = Scan::of(ScanGeometry::URG_04LX);
        scan.ranges_mm[330..350 + lost].fill(2000);
        scan.ranges_mm[340..340 + lost].fill(0);
        let (mut points, beams) = (Vec::new(), Beams::urg());
        beams.place(&scan, &Place::standing(Vector2::zeros(), 0.0), &mut points);
        let mut segments = Segments::with_capacity(&beams, 0.0);
        segments.find((&scan, &beams), &points, 0.01, |point| point.at.y.abs() > 2.0);
        segments.clusters.len()
    }

    #[test]
    fn four_lost_beams_part_no_body_and_five_do() {
        assert_eq!([0, 1, 4, 5, 6].map(bodies), [1, 1, 1, 2, 2]);
    }

    #[test]
    fn a_body_continues_where_the_line_beside_the_track_cuts_it() {
        let mut scan = Scan::of(ScanGeometry::URG_04LX);
        scan.ranges_mm[300..=340].fill(2000);
        let (mut points, beams) = (Vec::new(), Beams::urg());
        beams.place(&scan, &Place::standing(Vector2::zeros(), 0.0), &mut points);
        let mut segments = Segments::with_capacity(&beams, 0.0);
        // 20 beams to the right of the front is 0.245 m across.
        segments.find((&scan, &beams), &points, 0.01, |point| !(-0.24..=2.0).contains(&point.at.y));
        let ends: Vec<_> = segments.clusters.iter().map(|cluster| cluster.ends).collect();
        assert_eq!(ends, [[End::Silent, End::Hidden], [End::Hidden, End::Silent]]);
    }
}
