//! One sweep of a laser scanner.

use std::ops::RangeInclusive;

use crate::sample::sample;
use crate::{Fault, Flag, Header};

/// Largest number of beams of a scan.
pub const MAX_BEAMS: usize = 2048;
/// Number of beams of the Hokuyo URG-04LX: device steps 44 to 725.
pub const BEAMS: usize = 682;
/// Index of its beam that looks straight ahead: device step 384.
pub const FRONT_BEAM: usize = 340;
/// Angle between two of its beams: 360 deg / 1024.
pub const PITCH_RAD: f64 = std::f64::consts::TAU / 1024.0;
/// Angle of its beam 0 from the robot's forward axis, counter-clockwise: the first beam is on the right.
pub const FIRST_BEAM_YAW_RAD: f64 = -(FRONT_BEAM as f64) * PITCH_RAD;
/// Readings below this are error codes of the device and mean "no return" [mm].
pub const MIN_RANGE_MM: u32 = 20;
/// Its beams that are analysed for obstacles, 60 deg to each side.
pub const WINDOW: RangeInclusive<usize> = 170..=511;

sample! {
    /// The ranges of one sweep. The robot moves while it lasts, so beams are taken at different times.
    pub struct Scan(8520, Scan, 0x277a_4128, "scanloop.Scan.v3", check) {
        /// Identity and stamps; acquired is the time of the front beam
        pub header: Header,
        /// How long the sweep over all beams lasts, two thirds of the scan period [ns]
        pub sweep_ns: u64,
        /// Time between the end of one scan and the end of the next [ns]
        pub period_ns: u64,
        /// Angle of beam 0 from straight ahead, counter-clockwise [rad]
        pub first_rad: f64,
        /// Angle from one beam to the next; negative where the sweep is clockwise [rad]
        pub increment_rad: f64,
        /// How many beams there are: as many of `ranges_mm` count
        pub beams: u32,
        /// 1 when the scanner gave no ranges for this scan: all of them are zero
        pub missing: Flag,
        /// Range per beam in the order of the sweep; below 20 is an error code: no return [mm]
        pub ranges_mm: [u32; MAX_BEAMS],
    }
}

/// Where the beams of a scan look, in the order of the sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanGeometry {
    /// How many there are.
    pub count: usize,
    /// Angle of beam 0 from straight ahead, counter-clockwise [rad].
    pub first_rad: f64,
    /// Angle from one beam to the next; negative where the sweep is clockwise [rad].
    pub increment_rad: f64,
}

impl ScanGeometry {
    /// Those of the Hokuyo URG-04LX, counter-clockwise from the right.
    pub const URG_04LX: Self = Self { count: BEAMS, first_rad: FIRST_BEAM_YAW_RAD, increment_rad: PITCH_RAD };

    /// Angle of a beam from straight ahead, counter-clockwise [rad].
    pub fn yaw_rad(&self, beam: usize) -> f64 {
        self.first_rad + beam as f64 * self.increment_rad
    }

    /// Index of the beam that looks straight ahead; between two beams, or outside, where none does.
    pub fn front(&self) -> f64 {
        -self.first_rad / self.increment_rad
    }

    /// # Errors
    /// The first number that no scanner has.
    fn check(&self) -> Result<(), Fault> {
        let is_turn = |angle: f64| angle.abs() <= std::f64::consts::TAU;
        let span_rad = self.count.saturating_sub(1) as f64 * self.increment_rad;
        let wrong = if !(1..=MAX_BEAMS).contains(&self.count) {
            ("beams", self.count as f64)
        } else if !is_turn(self.first_rad) {
            ("first_rad", self.first_rad)
        } else if self.increment_rad == 0.0 || !is_turn(span_rad) {
            ("increment_rad", self.increment_rad)
        } else {
            return Ok(());
        };
        Err(Fault::OutOfRange { field: wrong.0, value: wrong.1 })
    }
}

impl Scan {
    /// A scan with these beams and no return.
    pub fn of(geometry: ScanGeometry) -> Self {
        let mut scan = Self::default();
        scan.set_geometry(geometry);
        scan
    }

    /// Says where the beams look.
    pub fn set_geometry(&mut self, geometry: ScanGeometry) {
        let ScanGeometry { count, first_rad, increment_rad } = geometry;
        (self.beams, self.first_rad, self.increment_rad) = (count as u32, first_rad, increment_rad);
    }

    /// Where its beams look.
    pub fn geometry(&self) -> ScanGeometry {
        ScanGeometry {
            count: self.beams as usize,
            first_rad: self.first_rad,
            increment_rad: self.increment_rad,
        }
    }

    /// Range per beam [mm].
    pub fn ranges(&self) -> &[u32] {
        &self.ranges_mm[..(self.beams as usize).min(MAX_BEAMS)]
    }

    /// Range per beam, to fill them [mm].
    pub fn ranges_mut(&mut self) -> &mut [u32] {
        let count = (self.beams as usize).min(MAX_BEAMS);
        &mut self.ranges_mm[..count]
    }

    /// Becomes `other`, but for places beyond its beams: a copy of a third of the bytes for an URG-04LX.
    pub fn assign(&mut self, other: &Self) {
        let Self { header, sweep_ns, period_ns, first_rad, increment_rad, beams, missing, ranges_mm: _ } =
            *other;
        (self.header, self.sweep_ns, self.period_ns) = (header, sweep_ns, period_ns);
        (self.first_rad, self.increment_rad, self.beams) = (first_rad, increment_rad, beams);
        self.missing = missing;
        self.ranges_mut().copy_from_slice(other.ranges());
    }

    /// Range of a beam [m], `None` when nothing came back.
    #[inline]
    pub fn range_m(&self, beam: usize) -> Option<f64> {
        let range = self.ranges_mm[beam];
        (range >= MIN_RANGE_MM).then(|| f64::from(range) * 1e-3)
    }

    /// Angle of a beam from straight ahead, counter-clockwise [rad].
    pub fn beam_yaw_rad(&self, beam: usize) -> f64 {
        self.geometry().yaw_rad(beam)
    }

    /// When a beam was taken, relative to the one straight ahead [s].
    pub fn beam_time_s(&self, beam: usize) -> f64 {
        let ScanGeometry { count, .. } = self.geometry();
        (beam as f64 - self.geometry().front()) / count as f64 * self.sweep_ns as f64 * 1e-9
    }
}

fn check(scan: &Scan) -> Result<(), Fault> {
    scan.header.check::<Scan>()?;
    if scan.sweep_ns == 0 || scan.sweep_ns > scan.period_ns {
        return Err(Fault::OutOfRange { field: "sweep_ns", value: scan.sweep_ns as f64 });
    }
    scan.geometry().check()?;
    let range = scan.ranges().iter().find(|range| **range != 0).filter(|_| scan.missing.is_set());
    range.map_or(Ok(()), |range| Err(Fault::OutOfRange { field: "ranges_mm", value: f64::from(*range) }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sample;

    #[test]
    fn the_sweep_covers_240_degrees_and_looks_ahead_at_the_front_beam() {
        let beams = ScanGeometry::URG_04LX;
        assert_eq!((beams.yaw_rad(FRONT_BEAM), beams.front()), (0.0, FRONT_BEAM as f64));
        let opening = beams.yaw_rad(BEAMS - 1) - beams.yaw_rad(0);
        assert!((opening.to_degrees() - 239.4).abs() < 0.1);
        assert!((beams.yaw_rad(*WINDOW.start()).to_degrees() + 59.8).abs() < 0.1);
        assert!((beams.yaw_rad(*WINDOW.end()).to_degrees() - 60.1).abs() < 0.1);
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
        let mut scan = Scan { header, sweep_ns: 2, period_ns: 3, ..Scan::of(ScanGeometry::URG_04LX) };
        scan.ranges_mm[681] = 7;
        assert_eq!(scan.check(), Ok(()), "an error code of a scan that is there");
        scan.missing = true.into();
        assert_eq!(scan.check(), Err(Fault::OutOfRange { field: "ranges_mm", value: 7.0 }));
        scan.ranges_mm[681] = 0;
        assert_eq!(scan.check(), Ok(()));
    }
    #[test]
    fn beams_are_such_as_a_scanner_can_have() {
        let header = Header { layout: Scan::LAYOUT, ..Header::default() };
        let wrong = |change: fn(&mut Scan)| {
            let mut scan = Scan { header, sweep_ns: 2, period_ns: 3, ..Scan::of(ScanGeometry::URG_04LX) };
            change(&mut scan);
            scan.check().map_err(|fault| fault.finding().0)
        };
        assert_eq!(wrong(|scan| scan.beams = 0), Err("beams"));
        assert_eq!(wrong(|scan| scan.beams = 2049), Err("beams"));
        assert_eq!(wrong(|scan| scan.first_rad = f64::NAN), Err("first_rad"));
        assert_eq!(wrong(|scan| scan.increment_rad = 0.0), Err("increment_rad"));
        assert_eq!(wrong(|scan| scan.increment_rad = f64::INFINITY), Err("increment_rad"));
        assert_eq!(wrong(|scan| scan.beams = 1026), Err("increment_rad"), "more than a turn");
        let around = ScanGeometry { count: 2048, first_rad: 3.0, increment_rad: -0.003 };
        let mut scan = Scan { header, sweep_ns: 2_048, period_ns: 3_000, ..Scan::of(around) };
        assert_eq!((scan.check(), scan.ranges().len()), (Ok(()), 2048));
        scan.ranges_mm[2047] = 100_000;
        let mut other = Scan::of(ScanGeometry::URG_04LX);
        other.assign(&scan);
        assert_eq!((bytemuck::bytes_of(&other) == bytemuck::bytes_of(&scan), other.beams), (true, 2048));
        assert_eq!(scan.range_m(2047), Some(100.0));
        assert!((scan.beam_yaw_rad(2000) + 3.0).abs() < 1e-12);
        assert!(
            (scan.beam_time_s(2000) - 1000e-9).abs() < 1e-15,
            "clockwise, 1,000 beams after straight ahead"
        );
    }
}
