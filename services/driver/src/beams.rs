//! From the beams of any scanner to those of the described one, which a scan has.
//!
//! A beam of the scan lies between two beams of the scanner. Where both hit the same surface, their ranges are
//! interpolated; elsewhere the nearer beam counts. So an edge is never turned into a surface between two bodies. Of a
//! scanner with finer steps, the nearest body counts.

use std::f64::consts::TAU;

use shared_types::{MAX_BEAMS, MIN_RANGE_MM, ScanGeometry};
use vehicle::ScannerDescription;

/// Neighbouring beams whose ranges differ by less than this share hit the same surface.
const SAME_SURFACE: f64 = 0.1;
/// Ranges this close to the longest one are no returns [m]: the resolution of a scan.
const RESOLUTION_M: f64 = 1e-3;
/// Error code of a scan: nothing came back.
const NO_RETURN: u32 = 0;
/// Error code of a scan: this beam is not measured.
const NOT_MEASURED: u32 = 19;
/// What has to be seen to each side of straight ahead [rad]: a sixth of a turn, less half a beam of the URG-04LX.
const NEEDED_RAD: f64 = TAU / 6.0 - TAU / 2048.0;
/// Beams may begin and end this much inside of the first and last beam of the scanner, in its steps: rounding.
const ROUNDING: f64 = 1e-6;

/// Ranges of a sweep by beam of a scan, as many as there are [mm].
pub type SweepRanges = [u32; MAX_BEAMS];

/// The scanner does not see what the obstacle detector needs.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Unusable {
    /// It has no beams, or impossible ones.
    #[error("{count} beams from {first_deg:.1} to {last_deg:.1} degrees, up to {max_range_m} m, are no scan")]
    Impossible {
        /// Number of beams.
        count: usize,
        /// Angle of the first one [deg].
        first_deg: f64,
        /// Angle of the last one [deg].
        last_deg: f64,
        /// Longest range [m].
        max_range_m: f64,
    },
    /// It does not cover 60 degrees to each side.
    #[error("the scanner covers {first_deg:.1} to {last_deg:.1} degrees, but at least -60 to 60 are needed")]
    Narrow {
        /// Angle of the first beam [deg].
        first_deg: f64,
        /// Angle of the last beam [deg].
        last_deg: f64,
    },
}

/// Where the beams of a sweep point, and how far they reach.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fan {
    /// Angle of the first beam from straight ahead, counter-clockwise [rad].
    pub first_rad: f64,
    /// Angle of the last beam; before that of the first one in a clockwise sweep [rad].
    pub last_rad: f64,
    /// Shorter ranges are no returns [m].
    pub min_range_m: f64,
    /// Range that stands for "nothing was hit" [m].
    pub max_range_m: f64,
}

impl Fan {
    /// A range if it is one, up to `reach_m`; `None` for no return: NaN, infinite, zero, too near, or the longest [m].
    pub fn range(&self, range_m: f64, reach_m: f64) -> Option<f64> {
        let furthest_m = self.max_range_m.min(reach_m + RESOLUTION_M) - RESOLUTION_M;
        let nearest_m = (f64::from(MIN_RANGE_MM) * 1e-3).max(self.min_range_m);
        (nearest_m..=furthest_m).contains(&range_m).then_some(range_m)
    }
}

/// Where a beam of the scan lies among those of a scanner.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// The beams of the scanner before and behind it.
    between: [usize; 2],
    /// How far it is behind the first of them, in steps.
    share: f64,
    /// The beams of the scanner that are nearer to it than to any other of the scan: the first, and how many.
    group: (usize, usize),
}

/// Where each beam of the scan lies among the beams of a scanner.
#[derive(Debug, Clone)]
pub struct Beams {
    fan: Fan,
    count: usize,
    /// Longest range of the scan [m].
    reach_m: f64,
    /// By beam of the scan; `None` for one that is not measured.
    places: Vec<Option<Place>>,
}

impl Beams {
    /// The places for a scanner with `count` beams, in a scan of the `described` one; `sign` is -1 for one whose angles are
    /// clockwise.
    ///
    /// Angles may begin anywhere: -pi to pi and 0 to 2 pi are the same scanner.
    ///
    /// # Errors
    /// [`Unusable`].
    pub fn new(fan: Fan, count: usize, sign: f64, described: &ScannerDescription) -> Result<Self, Unusable> {
        let (first_deg, last_deg) = (fan.first_rad.to_degrees(), fan.last_rad.to_degrees());
        let step_rad = (fan.last_rad - fan.first_rad) / count.saturating_sub(1) as f64;
        let turn = TAU / step_rad.abs();
        // NaN is none of them.
        let is_possible = step_rad.is_finite() && step_rad != 0.0 && fan.max_range_m > fan.min_range_m;
        if !is_possible || count as f64 > turn + 1.5 {
            return Err(Unusable::Impossible { count, first_deg, last_deg, max_range_m: fan.max_range_m });
        }
        let last = (count - 1) as f64;
        let is_closed = count as f64 > turn - 0.5;
        let geometry: ScanGeometry = described.geometry();
        let half_group = geometry.increment_rad / 2.0 / step_rad.abs();
        let place = |beam: usize| {
            let steps = (sign * geometry.yaw_rad(beam) - fan.first_rad) / step_rad;
            // Steps behind the first beam, once around at most, and up to half a step before it.
            let place = (steps + 0.5 + ROUNDING).rem_euclid(turn) - 0.5 - ROUNDING;
            if !is_closed && place > last + 0.5 + ROUNDING {
                return None;
            }
            let first = (place - half_group + ROUNDING).ceil();
            let end = (place + half_group - ROUNDING).floor() + 1.0;
            let (place, first, end) = if is_closed {
                (place, first, end)
            } else {
                (place.clamp(0.0, last), first.max(0.0), end.min(last + 1.0))
            };
            let around = |index: f64| (index as i64).rem_euclid(count as i64) as usize;
            let before = if is_closed { place.floor() } else { place.floor().min((last - 1.0).max(0.0)) };
            Some(Place {
                between: [around(before), around(before + 1.0)],
                share: place - before,
                group: (around(first), (end - first).max(0.0) as usize),
            })
        };
        let places: Vec<Option<Place>> = (0..geometry.count).map(place).collect();
        let is_missed = |(beam, place): (usize, &Option<Place>)| {
            place.is_none() && geometry.yaw_rad(beam).abs() <= NEEDED_RAD
        };
        if places.iter().enumerate().any(is_missed) {
            return Err(Unusable::Narrow { first_deg, last_deg });
        }
        Ok(Self { fan, count, reach_m: described.range_m, places })
    }

    /// Whether these are the places for another sweep.
    pub fn fits(&self, fan: &Fan, count: usize) -> bool {
        self.fan == *fan && self.count == count
    }

    /// Fills the ranges of a scan; `range_m` gives the range of a beam of the scanner [m].
    pub fn fill(&self, range_m: impl Fn(usize) -> f64, ranges_mm: &mut [u32]) {
        let range = |beam: usize| self.fan.range(range_m(beam), self.reach_m);
        for (place, range_mm) in self.places.iter().zip(ranges_mm) {
            *range_mm = match place {
                None => NOT_MEASURED,
                Some(place) => {
                    self.at(place, &range).map_or(NO_RETURN, |range_m| (range_m * 1e3).round() as u32)
                }
            };
        }
    }

    /// The range of a beam: on a surface between its two neighbours; else the nearer beam, or the nearest body in the group.
    fn at(&self, place: &Place, range: &impl Fn(usize) -> Option<f64>) -> Option<f64> {
        let [before, behind] = place.between.map(range);
        let along = match (before, behind) {
            (Some(one), Some(other)) if (one - other).abs() < SAME_SURFACE * one.min(other) => {
                Some(one + place.share * (other - one))
            }
            _ if place.share < 0.5 => before,
            _ => behind,
        };
        let (first, size) = place.group;
        let group = (first..first + size).filter_map(|beam| range(beam % self.count));
        let nearest = group.fold(f64::INFINITY, f64::min);
        match along {
            Some(along) if nearest > (1.0 - SAME_SURFACE) * along => Some(along),
            None if nearest.is_infinite() => None,
            _ => Some(nearest),
        }
    }
}

#[cfg(test)]
mod tests {
    use shared_types::{BEAMS, FRONT_BEAM, PITCH_RAD};

    use super::*;

    fn filled(fan: Fan, sign: f64, ranges: &[f64]) -> Result<[u32; BEAMS], Unusable> {
        let mut ranges_mm = [1; BEAMS];
        Beams::new(fan, ranges.len(), sign, &ScannerDescription::default())?
            .fill(|beam| ranges[beam], &mut ranges_mm);
        Ok(ranges_mm)
    }

    /// The fan of the scan itself.
    fn own() -> Fan {
        let (first_rad, last_rad) =
            (ScanGeometry::URG_04LX.yaw_rad(0), ScanGeometry::URG_04LX.yaw_rad(BEAMS - 1));
        Fan { first_rad, last_rad, min_range_m: 0.0, max_range_m: 5.6 }
    }

    #[test]
    fn beams_at_the_same_angles_keep_their_ranges() {
        let ranges: Vec<f64> = (0..BEAMS).map(|beam| 1.0 + beam as f64 * 1e-3).collect();
        let filled = filled(own(), 1.0, &ranges).unwrap();
        for (beam, range_mm) in filled.iter().enumerate() {
            assert_eq!(*range_mm as usize, 1000 + beam);
        }
    }

    #[test]
    fn codes_are_no_returns_and_never_far() {
        let mut ranges = vec![2.0; BEAMS];
        (ranges[340], ranges[342], ranges[344], ranges[346]) = (5.6, 0.0, f64::NAN, -1.0);
        let filled = filled(own(), 1.0, &ranges).unwrap();
        assert_eq!([340, 341, 342, 344, 346].map(|beam| filled[beam]), [0, 2000, 0, 0, 0]);
        let far = Fan { max_range_m: 30.0, ..own() };
        assert_eq!(
            super::tests::filled(far, 1.0, &[9.0; BEAMS]).unwrap()[FRONT_BEAM],
            0,
            "further than a scan reaches"
        );
    }

    #[test]
    fn an_edge_stays_an_edge_and_a_surface_is_interpolated() {
        // Half a step beside the beams of the scan, as in Stage.
        let half = PITCH_RAD / 2.0;
        let fan = Fan {
            first_rad: own().first_rad - half,
            last_rad: own().last_rad + half,
            min_range_m: 0.0,
            max_range_m: 5.6,
        };
        let ranges: Vec<f64> =
            (0..=BEAMS).map(|beam| if beam <= FRONT_BEAM { 1.0 + beam as f64 * 2e-3 } else { 4.0 }).collect();
        let filled = filled(fan, 1.0, &ranges).unwrap();
        assert_eq!(filled[100], 1201);
        assert!([1680, 4000].contains(&filled[FRONT_BEAM]), "{}", filled[FRONT_BEAM]);
        assert_eq!((filled[FRONT_BEAM - 1], filled[FRONT_BEAM + 1]), (1679, 4000));
    }

    #[test]
    fn a_clockwise_scanner_is_mirrored() {
        let mirrored = Fan {
            first_rad: -own().last_rad,
            last_rad: -own().first_rad,
            min_range_m: 0.0,
            max_range_m: 5.6,
        };
        let mut ranges = vec![3.0; BEAMS];
        ranges[0] = 1.0;
        let filled = filled(mirrored, -1.0, &ranges).unwrap();
        assert_eq!((filled[BEAMS - 1], filled[0]), (1000, 3000));
    }

    #[test]
    fn beams_that_are_not_measured_are_marked_and_a_narrow_scanner_is_refused() {
        let fan = |deg: f64| Fan {
            first_rad: -deg.to_radians(),
            last_rad: deg.to_radians(),
            min_range_m: 0.0,
            max_range_m: 4.0,
        };
        let wide = filled(fan(90.0), 1.0, &[2.0; 181]).unwrap();
        assert_eq!((wide[0], wide[FRONT_BEAM], wide[BEAMS - 1]), (NOT_MEASURED, 2000, NOT_MEASURED));
        let narrow = filled(fan(45.0), 1.0, &[2.0; 91]).unwrap_err().to_string();
        assert_eq!(narrow, "the scanner covers -45.0 to 45.0 degrees, but at least -60 to 60 are needed");
        for count in [0, 1] {
            assert!(matches!(
                Beams::new(fan(90.0), count, 1.0, &ScannerDescription::default()),
                Err(Unusable::Impossible { .. })
            ));
        }
        let nowhere = Fan { first_rad: f64::NAN, ..fan(90.0) };
        assert!(Beams::new(nowhere, 181, 1.0, &ScannerDescription::default()).is_err());
    }

    /// A scanner with a beam each quarter of a degree, of which one sees a body.
    fn fine(seen: usize) -> Vec<f64> {
        (0..1081).map(|beam| if beam == seen { 0.7 } else { 4.0 }).collect()
    }

    #[test]
    fn a_thin_body_between_the_beams_of_a_finer_scanner_is_seen_in_its_direction() {
        let end_rad = 135.0_f64.to_radians();
        let fan = Fan { first_rad: -end_rad, last_rad: end_rad, min_range_m: 0.1, max_range_m: 10.0 };
        for seen in 300..=780 {
            let ranges_mm = filled(fan, 1.0, &fine(seen)).unwrap();
            let hit: Vec<usize> = (0..BEAMS).filter(|beam| ranges_mm[*beam] == 700).collect();
            let yaw_rad = (seen as f64 - 540.0).to_radians() / 4.0;
            let is_there = |beam: &usize| (ScanGeometry::URG_04LX.yaw_rad(*beam) - yaw_rad).abs() < PITCH_RAD;
            assert!(!hit.is_empty() && hit.iter().all(is_there), "{seen}: {hit:?}");
        }
    }

    #[test]
    fn a_scanner_that_is_described_keeps_all_its_beams_and_its_reach() {
        let end_rad = 135.0_f64.to_radians();
        let fan = Fan { first_rad: -end_rad, last_rad: end_rad, min_range_m: 0.1, max_range_m: 30.0 };
        let utm = ScannerDescription { beams: 1081, increment_rad: TAU / 1440.0, ..Default::default() };
        let beams = |range_m| {
            let beams = Beams::new(fan, 1081, 1.0, &ScannerDescription { range_m, ..utm }).unwrap();
            let mut ranges_mm: SweepRanges = [7; MAX_BEAMS];
            beams.fill(|beam| 4.0 + 0.01 * beam as f64, &mut ranges_mm[..1081]);
            ranges_mm
        };
        let far = beams(30.0);
        assert!((0..1081).all(|beam| far[beam] as usize == 4000 + 10 * beam), "{:?}", &far[..4]);
        assert!(far[1081..].iter().all(|range| *range == 7));
        let near = beams(10.0);
        assert_eq!((near[600], near[601]), (10_000, 0), "further than is described");
    }

    #[test]
    fn a_scanner_that_turns_all_the_way_may_begin_anywhere_and_turn_either_way() {
        // 360 beams, one a degree; the one at 10 degrees to the left sees a body.
        let sweep = |first_deg: f64, step_deg: f64| {
            let at = |beam: usize| (first_deg + step_deg * beam as f64).rem_euclid(360.0);
            let ranges: Vec<f64> =
                (0..360).map(|beam| if (at(beam) - 10.0).abs() < 0.1 { 1.0 } else { 4.0 }).collect();
            let last_rad = (first_deg + step_deg * 359.0).to_radians();
            let first_rad = first_deg.to_radians();
            filled(Fan { first_rad, last_rad, min_range_m: 0.0, max_range_m: 9.0 }, 1.0, &ranges).unwrap()
        };
        let expected = sweep(-180.0, 1.0);
        // 10 degrees are 28.4 pitches of 360 / 1024 degrees.
        assert_eq!(
            (expected[FRONT_BEAM + 28], expected[FRONT_BEAM - 28], expected[FRONT_BEAM]),
            (1000, 4000, 4000)
        );
        assert!(expected.iter().all(|range_mm| *range_mm != NOT_MEASURED));
        for (first_deg, step_deg) in [(0.0, 1.0), (180.0, -1.0), (360.0, -1.0), (90.0, 1.0)] {
            assert_eq!(sweep(first_deg, step_deg), expected, "from {first_deg} by {step_deg}");
        }
    }

    #[test]
    fn ranges_below_that_of_the_scanner_and_infinite_ones_are_no_returns() {
        let fan = Fan { min_range_m: 0.12, ..own() };
        let mut ranges = vec![2.0; BEAMS];
        (ranges[340], ranges[342], ranges[344]) = (0.1, f64::INFINITY, f64::NEG_INFINITY);
        let filled = filled(fan, 1.0, &ranges).unwrap();
        assert_eq!([340, 341, 342, 344].map(|beam| filled[beam]), [0, 2000, 0, 0]);
    }
}
