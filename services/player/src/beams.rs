//! From the beams of any scanner to the 682 beams of a scan.
//!
//! A beam of the scan lies between two beams of the scanner. Where both hit the same surface, their ranges are
//! interpolated; elsewhere the nearer beam counts. So an edge is never turned into a surface between two bodies.

use shared_types::{BEAMS, MIN_RANGE_MM, ScanGeometry, WINDOW};

use crate::message::Fan;
use crate::xdr::Numbers;

/// Neighbouring beams whose ranges differ by less than this share hit the same surface.
const SAME_SURFACE: f64 = 0.1;
/// Longest range of the scan [m]: that of the URG-04LX.
const MAX_RANGE_M: f64 = 5.6;
/// Ranges this close to the longest one are no returns [m]: the resolution of a scan.
const RESOLUTION_M: f64 = 1e-3;
/// Error code of a scan: nothing came back.
const NO_RETURN: u32 = 0;
/// Error code of a scan: this beam is not measured.
const NOT_MEASURED: u32 = 19;
/// Beams may begin and end this much inside of the first and last beam of the scanner, in its steps: rounding.
const ROUNDING: f64 = 1e-6;

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

/// Where each beam of the scan lies among the beams of a scanner.
#[derive(Debug, Clone)]
pub struct Beams {
    fan: Fan,
    count: usize,
    /// By beam of the scan: the beam of the scanner before it, and how far behind that, in steps.
    places: [Option<(usize, f64)>; BEAMS],
}

impl Beams {
    /// The places for a scanner with `count` beams; `sign` is -1 for one whose angles are clockwise.
    ///
    /// # Errors
    /// [`Unusable`].
    pub fn new(fan: Fan, count: usize, sign: f64) -> Result<Self, Unusable> {
        let (first_deg, last_deg) = (fan.first_rad.to_degrees(), fan.last_rad.to_degrees());
        let step_rad = (fan.last_rad - fan.first_rad) / count.saturating_sub(1) as f64;
        // NaN is neither.
        if !(step_rad.is_finite() && step_rad > 0.0 && fan.max_range_m > 0.0) {
            return Err(Unusable::Impossible { count, first_deg, last_deg, max_range_m: fan.max_range_m });
        }
        let place = |beam: usize| {
            let place = (sign * ScanGeometry::URG_04LX.yaw_rad(beam) - fan.first_rad) / step_rad;
            let last = (count - 1) as f64;
            let is_seen = (-0.5 - ROUNDING..=last + 0.5 + ROUNDING).contains(&place);
            let place = place.clamp(0.0, last);
            let before = (place as usize).min(count.saturating_sub(2));
            is_seen.then_some((before, place - before as f64))
        };
        let places = std::array::from_fn(place);
        if places[WINDOW].iter().any(Option::is_none) {
            return Err(Unusable::Narrow { first_deg, last_deg });
        }
        Ok(Self { fan, count, places })
    }

    /// Whether these are the places for another sweep.
    pub fn fits(&self, fan: &Fan, count: usize) -> bool {
        self.fan == *fan && self.count == count
    }

    /// Fills the ranges of a scan.
    pub fn fill(&self, ranges_m: &Numbers<'_>, ranges_mm: &mut [u32]) {
        let furthest_m = self.fan.max_range_m.min(MAX_RANGE_M + RESOLUTION_M) - RESOLUTION_M;
        let nearest_m = f64::from(MIN_RANGE_MM) * 1e-3;
        let range =
            |beam: usize| Some(ranges_m.get(beam)).filter(|range| (nearest_m..=furthest_m).contains(range));
        for (place, range_mm) in self.places.iter().zip(ranges_mm) {
            *range_mm = match *place {
                None => NOT_MEASURED,
                Some((before, share)) => {
                    let nearer = if share < 0.5 { range(before) } else { range(before + 1) };
                    let range_m = match (range(before), range(before + 1)) {
                        (Some(one), Some(other)) if (one - other).abs() < SAME_SURFACE * one.min(other) => {
                            Some(one + share * (other - one))
                        }
                        _ => nearer,
                    };
                    range_m.map_or(NO_RETURN, |range_m| (range_m * 1e3).round() as u32)
                }
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use shared_types::{FRONT_BEAM, PITCH_RAD};

    use super::*;
    use crate::xdr::{XdrReader, put_f64s, put_u32};

    fn filled(fan: Fan, sign: f64, ranges: &[f64]) -> Result<[u32; BEAMS], Unusable> {
        let mut bytes = Vec::new();
        put_u32(&mut bytes, ranges.len() as u32);
        put_u32(&mut bytes, ranges.len() as u32);
        put_f64s(&mut bytes, ranges);
        let mut ranges_mm = [1; BEAMS];
        let numbers = Numbers::f64s(&mut XdrReader::new(&bytes)).unwrap();
        Beams::new(fan, ranges.len(), sign)?.fill(&numbers, &mut ranges_mm);
        Ok(ranges_mm)
    }

    /// The fan of the scan itself.
    fn own() -> Fan {
        let (first_rad, last_rad) =
            (ScanGeometry::URG_04LX.yaw_rad(0), ScanGeometry::URG_04LX.yaw_rad(BEAMS - 1));
        Fan { first_rad, last_rad, max_range_m: 5.6 }
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
        let fan =
            Fan { first_rad: own().first_rad - half, last_rad: own().last_rad + half, max_range_m: 5.6 };
        let ranges: Vec<f64> =
            (0..=BEAMS).map(|beam| if beam <= FRONT_BEAM { 1.0 + beam as f64 * 2e-3 } else { 4.0 }).collect();
        let filled = filled(fan, 1.0, &ranges).unwrap();
        assert_eq!(filled[100], 1201);
        assert!([1680, 4000].contains(&filled[FRONT_BEAM]), "{}", filled[FRONT_BEAM]);
        assert_eq!((filled[FRONT_BEAM - 1], filled[FRONT_BEAM + 1]), (1679, 4000));
    }

    #[test]
    fn a_clockwise_scanner_is_mirrored() {
        let mirrored = Fan { first_rad: -own().last_rad, last_rad: -own().first_rad, max_range_m: 5.6 };
        let mut ranges = vec![3.0; BEAMS];
        ranges[0] = 1.0;
        let filled = filled(mirrored, -1.0, &ranges).unwrap();
        assert_eq!((filled[BEAMS - 1], filled[0]), (1000, 3000));
    }

    #[test]
    fn beams_that_are_not_measured_are_marked_and_a_narrow_scanner_is_refused() {
        let fan =
            |deg: f64| Fan { first_rad: -deg.to_radians(), last_rad: deg.to_radians(), max_range_m: 4.0 };
        let wide = filled(fan(90.0), 1.0, &[2.0; 181]).unwrap();
        assert_eq!((wide[0], wide[FRONT_BEAM], wide[BEAMS - 1]), (NOT_MEASURED, 2000, NOT_MEASURED));
        let narrow = filled(fan(45.0), 1.0, &[2.0; 91]).unwrap_err().to_string();
        assert_eq!(narrow, "the scanner covers -45.0 to 45.0 degrees, but at least -60 to 60 are needed");
        for count in [0, 1] {
            assert!(matches!(Beams::new(fan(90.0), count, 1.0), Err(Unusable::Impossible { .. })));
        }
        assert!(Beams::new(Fan { first_rad: f64::NAN, ..fan(90.0) }, 181, 1.0).is_err());
    }
}
