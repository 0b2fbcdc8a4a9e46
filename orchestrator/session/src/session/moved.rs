//! Whether somebody moves a robot whose wheels are blocked: the scanner shows it, and the odometry does not.
//!
//! While the controller does not drive and the robot stands, each scan is compared with the first one since it stands.
//! Somebody who walks by changes few beams; a robot that is pushed or lifted changes most of them. A robot whose wheels turn
//! when it is pushed is located by its odometry, which shows that it does not stand.

use runtime::{Bus, Observer, RuntimeError};
use shared_types::Scan;

/// A beam that changed by more shows another place [m].
const CHANGED_M: f64 = 0.1;
/// The robot was moved when more than this share of the beams changed.
const MOVED_SHARE: f64 = 0.6;
/// Fewer beams than this share with a return tell nothing.
const SEEN_SHARE: f64 = 0.1;
/// So many scans in a row must show it: one may be disturbed.
const SCANS: u32 = 3;

/// What the scanner shows while the robot stands.
#[derive(Default)]
pub(super) struct MovedWatch {
    scans: Option<Observer<Scan>>,
    /// The first scan since the robot stands.
    first: Option<Box<Scan>>,
    /// Scans in a row that differ from it.
    differing: u32,
}

impl MovedWatch {
    /// Forgets everything: the controller drives.
    pub(super) fn end(&mut self) {
        *self = Self::default();
    }

    /// Looks at the scans of a robot that stands, or not; the share of beams that changed, once, when it was moved.
    ///
    /// # Errors
    /// Errors of the bus.
    pub(super) fn look(&mut self, bus: &Bus, is_standing: bool) -> Result<Option<f64>, RuntimeError> {
        let Self { scans, first, differing } = self;
        let observer = match scans {
            Some(observer) => observer,
            None => scans.insert(Observer::new(bus)?),
        };
        let mut moved = None;
        observer.poll(|scan| {
            if !is_standing {
                *first = None;
                return;
            }
            if scan.missing.is_set() {
                return;
            }
            let Some(before) = first.as_deref().filter(|before| before.ranges().len() == scan.ranges().len())
            else {
                (*first, *differing) = (Some(Box::new(*scan)), 0);
                return;
            };
            let Some(share) = changed_share(before, scan) else { return };
            *differing = if share > MOVED_SHARE { *differing + 1 } else { 0 };
            if *differing == SCANS {
                // What comes next is compared with how it stands now.
                (*first, *differing, moved) = (Some(Box::new(*scan)), 0, Some(share));
            }
        })?;
        Ok(moved)
    }
}

/// The share of the beams with a return in both scans that changed; `None` where too few have one.
fn changed_share(before: &Scan, after: &Scan) -> Option<f64> {
    let both = |beam: usize| Some((before.range_m(beam)?, after.range_m(beam)?));
    let seen: Vec<(f64, f64)> = (0..after.ranges().len()).filter_map(both).collect();
    let changed = seen.iter().filter(|(one, other)| (one - other).abs() > CHANGED_M).count();
    let enough = seen.len() as f64 > SEEN_SHARE * after.ranges().len() as f64;
    enough.then(|| changed as f64 / seen.len() as f64)
}

#[cfg(test)]
mod tests {
    use shared_types::ScanGeometry;

    use super::*;

    /// A scan whose first beams see something at 2 m, of them some at 1.8 m, and whose others see nothing.
    fn scan(seen: usize, nearer: usize) -> Scan {
        let mut scan = Scan::default();
        scan.set_geometry(ScanGeometry::URG_04LX);
        scan.ranges_mut()[..seen].fill(2000);
        scan.ranges_mut()[..nearer].fill(1800);
        scan
    }

    #[test]
    fn the_share_is_that_of_beams_with_a_return_in_both() {
        assert_eq!(changed_share(&scan(200, 0), &scan(200, 150)), Some(0.75));
        assert_eq!(changed_share(&scan(200, 0), &scan(100, 0)), Some(0.0));
        assert_eq!(changed_share(&scan(60, 0), &scan(60, 60)), None, "too few");
        assert_eq!(changed_share(&scan(0, 0), &scan(0, 0)), None);
    }
}
