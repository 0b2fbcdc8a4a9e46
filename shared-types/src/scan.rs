//! One sweep of the Hokuyo URG-04LX laser scanner.

use std::ops::RangeInclusive;

use crate::sample::sample;
use crate::{Fault, Flag, Header};

/// Number of beams of a sweep: device steps 44 to 725.
pub const BEAMS: usize = 682;
/// Index of the beam that looks straight ahead: device step 384.
pub const FRONT_BEAM: usize = 340;
/// Angle between two beams: 360 deg / 1024.
pub const PITCH_RAD: f64 = std::f64::consts::TAU / 1024.0;
/// Angle of beam 0 from the robot's forward axis, counter-clockwise: the first beam is on the right.
pub const FIRST_BEAM_YAW_RAD: f64 = -(FRONT_BEAM as f64) * PITCH_RAD;
/// Readings below this are error codes of the device and mean "no return" [mm].
pub const MIN_RANGE_MM: u16 = 20;
/// The beams analysed for obstacles, 60 deg to each side.
pub const WINDOW: RangeInclusive<usize> = 170..=511;

sample! {
    /// The ranges of one sweep. The robot moves while it lasts, so beams are taken at different times.
    pub struct Scan(1576, Scan, 0xc986_39d1, "scanloop.Scan.v2", check) {
        /// Identity and stamps; acquired is the time of the front beam
        pub header: Header,
        /// How long the sweep over all beams lasts, two thirds of the scan period [ns]
        pub sweep_ns: u64,
        /// Time between the end of one scan and the end of the next [ns]
        pub period_ns: u64,
        /// Range per beam, counter-clockwise from the right; below 20 is an error code: no return [mm]
        pub ranges_mm: [u16; BEAMS],
        /// 1 when the scanner gave no ranges for this scan: all of them are zero
        pub missing: Flag,
    }
}

impl Scan {
    /// Range of a beam [m], `None` when nothing came back.
    #[inline]
    pub fn range_m(&self, beam: usize) -> Option<f64> {
        let range = self.ranges_mm[beam];
        (range >= MIN_RANGE_MM).then(|| f64::from(range) * 1e-3)
    }

    /// Angle of a beam from the robot's forward axis [rad].
    pub fn beam_yaw_rad(beam: usize) -> f64 {
        FIRST_BEAM_YAW_RAD + beam as f64 * PITCH_RAD
    }

    /// When a beam was taken, relative to the front beam [s].
    pub fn beam_time_s(&self, beam: usize) -> f64 {
        (beam as f64 - FRONT_BEAM as f64) / (BEAMS as f64) * self.sweep_ns as f64 * 1e-9
    }
}

fn check(scan: &Scan) -> Result<(), Fault> {
    scan.header.check::<Scan>()?;
    if scan.sweep_ns == 0 || scan.sweep_ns > scan.period_ns {
        return Err(Fault::OutOfRange { field: "sweep_ns", value: scan.sweep_ns as f64 });
    }
    let range = scan.ranges_mm.iter().find(|range| **range != 0).filter(|_| scan.missing.is_set());
    range.map_or(Ok(()), |range| Err(Fault::OutOfRange { field: "ranges_mm", value: f64::from(*range) }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sample;

    #[test]
    fn the_sweep_covers_240_degrees_and_looks_ahead_at_the_front_beam() {
        assert_eq!(Scan::beam_yaw_rad(FRONT_BEAM), 0.0);
        let opening = Scan::beam_yaw_rad(BEAMS - 1) - Scan::beam_yaw_rad(0);
        assert!((opening.to_degrees() - 239.4).abs() < 0.1);
        assert!((Scan::beam_yaw_rad(*WINDOW.start()).to_degrees() + 59.8).abs() < 0.1);
        assert!((Scan::beam_yaw_rad(*WINDOW.end()).to_degrees() - 60.1).abs() < 0.1);
    }

    #[test]
    fn an_error_code_is_no_return() {
        let mut scan = Scan::default();
        scan.ranges_mm[3] = 19;
        scan.ranges_mm[4] = 20;
        assert_eq!((scan.range_m(3), scan.range_m(4)), (None, Some(0.02)));
    }

    #[test]
    fn a_missing_scan_has_zeros_only() {
        let header = Header { layout: Scan::LAYOUT, ..Header::default() };
        let mut scan = Scan { header, sweep_ns: 2, period_ns: 3, ..Scan::default() };
        scan.ranges_mm[681] = 7;
        assert_eq!(scan.check(), Ok(()), "an error code of a scan that is there");
        scan.missing = true.into();
        assert_eq!(scan.check(), Err(Fault::OutOfRange { field: "ranges_mm", value: 7.0 }));
        scan.ranges_mm[681] = 0;
        assert_eq!(scan.check(), Ok(()));
    }
}
