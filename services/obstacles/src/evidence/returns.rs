//! How many of the returns that an earlier scan predicts come.

use shared_types::{Scan, plain_state};

use crate::evidence::snapshot::{Snapshot, Viewpoint, is_surface};
use crate::points::{Beams, Place};

/// Returns predicted from farther away need not come to the URG-04LX [m].
const REACH_M: f64 = 5.0;
/// A return agrees with the predicted range within this [m] ...
const TOLERANCE_M: f64 = 0.1;
/// ... and this share of the range.
const TOLERANCE: f64 = 0.05;
/// Time constant of the counts [s].
const MEMORY_S: f64 = 0.45;
/// A scan that comes later than this counts for more than one [s].
const SELDOM_S: f64 = 0.31;
/// Predicted returns from which on a scan has its full weight.
const ENOUGH: f64 = 15.0;
/// Beams on each side of the expected one that count as well.
const BESIDE: usize = 1;

plain_state! {
    /// Counts of predicted returns, which fade.
    pub struct Returns {
        /// Returns that were predicted
        pub predicted: f64,
        /// Those that came at any range
        pub came: f64,
        /// Those that came at the predicted range
        pub agreed: f64,
    }
}

impl Returns {
    /// Counts what `scan` makes of every other return of an earlier scan.
    pub(crate) fn count(earlier: &Snapshot, beams: &Beams, scan: &Scan, place: &Place) -> Self {
        let mut counts = Self::default();
        let view = Viewpoint::new(beams, scan, place);
        let (reach, each) = (beams.reach(REACH_M), beams.weight());
        for point in earlier.points().iter().step_by(2) {
            let Some(expected) = view.expected(point) else { continue };
            let is_inside = (BESIDE..beams.count() - BESIDE).contains(&expected.beam);
            if !is_inside || expected.range > reach || !is_surface(beams, earlier.scan(), point) {
                continue;
            }
            let tolerance = TOLERANCE_M + TOLERANCE * expected.range;
            counts.predicted += each;
            for beam in expected.beam - BESIDE..=expected.beam + BESIDE {
                let Some(range) = beams.range_of(scan, beam) else { continue };
                let weight = each / (2 * BESIDE + 1) as f64;
                counts.came += weight;
                if (range - expected.range).abs() < tolerance {
                    counts.agreed += weight;
                }
            }
        }
        counts
    }

    /// Adds the counts of a scan `elapsed` seconds after the last. All scans that predict enough returns weigh the same:
    /// where most returns are missing, the next scan is compared with few, and those before must not outweigh it.
    pub(crate) fn add(&mut self, scan: &Self, elapsed: f64) {
        let keep = (-elapsed / MEMORY_S).exp();
        // Scans that come seldom count for more of them.
        let weight = ENOUGH / scan.predicted.max(ENOUGH) * (elapsed / SELDOM_S).max(1.0);
        self.predicted = self.predicted * keep + weight * scan.predicted;
        self.came = self.came * keep + weight * scan.came;
        self.agreed = self.agreed * keep + weight * scan.agreed;
    }

    /// Share of the predicted returns that came at their range; `None` when too few were predicted to tell.
    pub(crate) fn agreed_share(&self, needed: f64) -> Option<f64> {
        (self.predicted >= needed).then(|| self.agreed / self.predicted)
    }

    /// Share of those that came that have their range; `None` when too few came to tell.
    pub(crate) fn right_share(&self, needed: f64) -> Option<f64> {
        (self.came >= needed).then(|| self.agreed / self.came)
    }

    /// Whether the counts are possible.
    pub(crate) fn is_sound(&self) -> bool {
        let counts = [self.predicted, self.came, self.agreed];
        counts.iter().all(|count| (0.0..1e9).contains(count)) && self.came <= self.predicted + 1e-6
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_any_rate_a_few_scans_tell_how_many_returns_come() {
        for elapsed in [0.02, 0.1, 0.2, 0.43, 1.0] {
            let mut returns = Returns::default();
            for _ in 0..10 {
                returns.add(&Returns { predicted: 100.0, came: 40.0, agreed: 40.0 }, elapsed);
            }
            let share = returns.agreed_share(25.0).unwrap();
            assert!((share - 0.4).abs() < 1e-9, "{elapsed}: {share}");
        }
    }
}
