//! In which directions the scanner shows nothing although something is there.
//!
//! What does not move is compared between the scan and one that was taken some way before, both ways: a return of
//! either must be in the other, unless something nearer hides it. A sector that has not shown anything yet is compared
//! with the walls that stand around. A sector in which hardly any of these returns come has no evidence: its missing
//! returns show nothing. The same holds for sectors that have not shown anything lately and lie between such
//! sectors.

use shared_types::{SECTOR_BEAMS, SECTORS, Scan, ScanGeometry};

use crate::evidence::snapshot::{Viewpoint, is_surface};
use crate::points::{Beams, Place, Point};

/// Returns predicted from farther away need not come to the URG-04LX [m].
pub(crate) const REACH_M: f64 = 5.4;
/// A return nearer than predicted by more than this hides what was predicted [m].
const HIDING_M: f64 = 0.2;
/// Every other return is compared, so each counts for two.
const EACH: f64 = 2.0;
/// Time constant of the counts [s].
const MEMORY_S: f64 = 0.15;
/// With fewer predicted returns than this a sector is not judged.
const NEEDED: f64 = 10.0;
/// With fewer in one scan it is not even suspected.
const SUSPICIOUS: f64 = 4.0;
/// A sector has no evidence when its share of returns is below this part of that of all directions.
const BLIND_SHARE: f64 = 0.3;
/// Where returns are missing at random in all directions, so many standard deviations may be missing in a sector by chance.
const CHANCE: f64 = 4.0;
/// A sector works when so many of eleven of its beams gave a return in one scan.
const PROOF: usize = 6;
/// With more sectors than this without evidence, nothing ahead can be relied on ...
const MAX_BLIND: usize = 3;
/// ... counting those within this angle of the front [rad].
const FORWARD_RAD: f64 = 1.4;
/// Beyond this distance obstacles need not be seen by the URG-04LX [m].
const VIEW_M: f64 = 5.0;

/// Where sectors look, and how far.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Looks {
    geometry: ScanGeometry,
    /// Beams of a sector.
    sector: usize,
    /// Beyond this distance obstacles need not be seen [m].
    view_m: f64,
}

impl Looks {
    pub(crate) fn of(beams: &Beams) -> Self {
        Self { geometry: beams.geometry, sector: beams.sector, view_m: beams.reach(VIEW_M) }
    }
}

/// Counts per sector: returns that were predicted, and those that came.
pub(crate) type Counts = [[f64; 2]; SECTORS];

/// Adds the counts of a scan `elapsed` seconds after the last.
pub(crate) fn add(sums: &mut Counts, counts: &Counts, elapsed: f64) {
    let keep = (-elapsed / MEMORY_S).exp();
    for (sum, count) in sums.iter_mut().flatten().zip(counts.iter().flatten()) {
        *sum = *sum * keep + count;
    }
}

/// The sectors in which hardly anything of what was predicted came in one scan, one bit each.
pub(crate) fn suspected(counts: &Counts) -> u64 {
    let is_suspected =
        |[predicted, came]: &[f64; 2]| *predicted >= SUSPICIOUS && *came < BLIND_SHARE * predicted;
    mask(counts, is_suspected)
}

/// The sectors whose counts are such, one bit each.
fn mask(counts: &Counts, is_such: impl Fn(&[f64; 2]) -> bool) -> u64 {
    (0..).zip(counts).filter(|(_, count)| is_such(count)).fold(0, |mask, (sector, _)| mask | 1 << sector)
}

/// Compares the returns of `points` that are fixed, all of `from`, with `scan`, and counts them per sector.
pub(crate) fn compare<'a>(
    counts: &mut Counts,
    beams: &Beams,
    from: &Scan,
    points: impl Iterator<Item = &'a Point>,
    (scan, place): (&Scan, &Place),
) {
    let view = Viewpoint::new(beams, scan, place);
    let (reach, each) = (beams.reach(REACH_M), EACH * SECTOR_BEAMS as f64 / beams.sector as f64);
    for point in points {
        let Some(expected) = view.expected(point) else { continue };
        let is_inside = (1..beams.count() - 1).contains(&expected.beam) && expected.range < reach;
        if !is_inside || !is_surface(beams, from, point) {
            continue;
        }
        let around = expected.beam - 1..=expected.beam + 1;
        let ranges = || around.clone().filter_map(|beam| beams.range_of(scan, beam));
        if ranges().any(|range| range < expected.range - HIDING_M) {
            continue;
        }
        let [predicted, came] = &mut counts[expected.beam / beams.sector];
        *predicted += each;
        *came += each * ranges().count() as f64 / 3.0;
    }
}

/// The sectors that show something in a scan, one bit each. Those of the others that are not `proven` are compared with the
/// walls around: `is_wall_near` tells whether a beam ends at one.
pub(crate) fn show(
    counts: &mut Counts,
    proven: u64,
    (scan, beams): (&Scan, &Beams),
    is_wall_near: impl Fn(usize) -> bool,
) -> u64 {
    let mut shown = 0;
    for (sector, [predicted, came]) in counts.iter_mut().enumerate() {
        let first = sector * beams.sector;
        let end = (first + beams.sector).min(beams.count());
        if first >= end {
            break;
        }
        let returns = (first..end).filter(|beam| beams.range_of(scan, *beam).is_some()).count();
        if returns * SECTOR_BEAMS >= PROOF * (end - first) {
            shown |= 1 << sector;
        }
        if (proven | shown) >> sector & 1 == 0 && is_wall_near(first + (end - first) / 2) {
            *predicted += SECTOR_BEAMS as f64;
            *came += returns as f64 * (SECTOR_BEAMS as f64 / (end - first) as f64);
        }
    }
    shown
}

/// The sectors in which hardly anything of what was predicted came, one bit each, where `share` of all predicted returns
/// come.
pub(crate) fn failing(counts: &Counts, share: f64) -> u64 {
    let share = share.min(1.0);
    let is_failing = |[predicted, came]: &[f64; 2]| {
        let by_chance = CHANCE * (share * (1.0 - share) * predicted).sqrt();
        *predicted >= NEEDED && *came < (BLIND_SHARE * share * predicted).min(share * predicted - by_chance)
    };
    mask(counts, is_failing)
}

/// The sectors without evidence, one bit each: `failing` with the sectors that have not shown anything lately and have failing
/// ones at both ends.
pub(crate) fn unseen(failing: u64, lately: u64) -> u64 {
    let mut unseen = failing;
    let mut begin = None;
    for sector in 0..SECTORS {
        if failing >> sector & 1 == 1 {
            if let Some(begin) = begin {
                (begin..sector).for_each(|sector| unseen |= 1 << sector);
            }
            begin = Some(sector + 1);
        } else if lately >> sector & 1 == 1 {
            begin = None;
        }
    }
    unseen
}

/// Distance ahead of the robot's centre within which whatever stands in a strip of `half_width` was seen, before it
/// came into the sectors without evidence, or will be seen beyond them [m].
///
/// A point at the lateral distance y is hidden in a sector from a to b while its distance ahead is from y / tan a to
/// y / tan b. It was seen before when y / tan a is within the view; what was not comes into view at y / tan b.
pub(crate) fn seen_ahead(unseen: u64, looks: &Looks, mounting_rad: f64, half_width: f64) -> f64 {
    let Looks { geometry, sector: beams, view_m } = *looks;
    let edge = |beam: usize| geometry.yaw_rad(beam) - geometry.increment_rad / 2.0 + mounting_rad;
    let is_forward = |sector: &usize| edge(sector * beams + beams / 2).abs() < FORWARD_RAD;
    let blind = |sector: &usize| unseen >> sector & 1 == 1;
    let count = (0..SECTORS).filter(|sector| blind(sector) && is_forward(sector)).count();
    if count > MAX_BLIND {
        return 0.0;
    }
    let mut farthest = view_m;
    let mut sector = 0;
    while sector < SECTORS {
        if !blind(&sector) {
            sector += 1;
            continue;
        }
        let first = sector;
        while sector < SECTORS && blind(&sector) {
            sector += 1;
        }
        let (low, high) = (edge(first * beams), edge(sector * beams));
        farthest = farthest.min(hidden_until(low, high, half_width, view_m));
    }
    farthest
}

/// Distance ahead at which what a sector from `low` to `high` hides comes into view [m].
fn hidden_until(low: f64, high: f64, half_width: f64, view_m: f64) -> f64 {
    if low <= 0.0 && high >= 0.0 {
        return 0.0;
    }
    let (near, far) = (low.abs().min(high.abs()), low.abs().max(high.abs()));
    if near.tan() * view_m >= half_width || near > std::f64::consts::FRAC_PI_2 {
        return view_m;
    }
    if far >= std::f64::consts::FRAC_PI_2 { 0.0 } else { view_m * near.tan() / far.tan() }
}

#[cfg(test)]
mod tests {
    use shared_types::PITCH_RAD;

    use super::*;

    fn seen_ahead(unseen: u64, mounting_rad: f64, half_width: f64) -> f64 {
        super::seen_ahead(unseen, &Looks::of(&Beams::urg()), mounting_rad, half_width)
    }

    #[test]
    fn a_gap_between_failing_sectors_is_unseen_unless_one_of_it_has_shown_something_lately() {
        assert_eq!(unseen(0b100_0100, 0), 0b111_1100);
        assert_eq!(unseen(0b100_0100, 0b1_0000), 0b100_0100);
        assert_eq!(unseen(0b100, 0), 0b100);
    }

    #[test]
    fn a_sector_fails_where_more_is_missing_than_by_chance() {
        let fails = |predicted, came, share| {
            let mut counts = [[0.0; 2]; SECTORS];
            counts[5] = [predicted, came];
            failing(&counts, share) != 0
        };
        assert!(fails(10.0, 2.9, 1.0) && !fails(10.0, 3.1, 1.0) && !fails(9.0, 0.0, 1.0));
        // Where every other return comes, 1.9 of 14 are within four standard deviations of 7, and none of 20 is not.
        assert!(!fails(14.0, 1.9, 0.5) && fails(20.0, 0.0, 0.5) && !fails(20.0, 3.1, 0.5));
        assert!(!fails(20.0, 0.0, 0.0) && fails(20.0, 0.0, 1.5));
    }

    #[test]
    fn a_blind_front_hides_everything_and_a_blind_side_nothing() {
        let front = 340 / SECTOR_BEAMS;
        assert_eq!(seen_ahead(0, 0.0, 0.45), VIEW_M);
        assert_eq!(seen_ahead(1 << front, 0.0, 0.45), 0.0);
        // Sectors 36 and 37 begin 19.5 deg left of the front: 0.45 m to the side they begin 1.3 m ahead.
        assert_eq!(seen_ahead(0b11 << 36, 0.0, 0.45), VIEW_M);
        // The same sectors of a scanner that is turned by 19 deg to the right begin 0.5 deg off the front.
        let turned = seen_ahead(0b11 << 36, -(396.0 - 340.0) * PITCH_RAD + 0.01, 0.45);
        assert!(turned < 0.5, "{turned}");
        assert_eq!(seen_ahead(0b1111 << 40, 0.0, 0.45), 0.0, "four sectors are too many");
    }
}
