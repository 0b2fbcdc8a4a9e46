//! What the scanner measures, as its data sheet states it: the table `[vehicle.scanner]`.

use std::f64::consts::{PI, TAU};

use key_table::{Invalid, settings};
use shared_types::{BEAMS, MAX_BEAMS, PITCH_RAD, ScanGeometry};

/// A scanner has to see this far to each side of the robot's forward axis [rad]: 59 degrees, as the URG-04LX sees its first
/// beam that is analysed at 59.8.
const AHEAD_RAD: f64 = 59.0 * TAU / 360.0;

settings! {
    /// What the scanner measures; the defaults describe a Hokuyo URG-04LX. Its sweep is counter-clockwise.
    #[derive(Copy)]
    pub struct ScannerDescription {
        /// Number of beams of a sweep: the measurement steps of a data sheet.
        pub beams: usize = BEAMS,
            (3.0..=MAX_BEAMS as f64, "at most a turn, and 59 degrees to each side ahead are seen");
        /// Angle from one beam to the next: the angular resolution of a data sheet [rad].
        pub increment_rad: f64 = PITCH_RAD, (5e-4..=0.2, "at most a turn with all beams");
        /// Angle of the first beam from the scanner's front, counter-clockwise; without the key the middle beam looks to the
        /// front [rad].
        pub first_rad: Option<f64> = None,
            (-PI..=0.0, "with `vehicle.scanner_yaw_rad`, 59 degrees to each side ahead are seen");
        /// Largest distance that is measured [m].
        pub range_m: f64 = 5.6, 1.0..=100.0;
        /// Smallest distance that is measured [m].
        pub min_range_m: f64 = 0.02, 0.02..=1.0;
        /// Share of the scan period that the sweep over all beams takes.
        pub sweep_share: f64 = 2.0 / 3.0, 0.01..=1.0;
    }
}

impl ScannerDescription {
    /// Where its beams look.
    pub fn geometry(&self) -> ScanGeometry {
        let Self { beams: count, increment_rad, first_rad, .. } = *self;
        let first_rad = first_rad.unwrap_or(-(((count - 1) / 2) as f64) * increment_rad);
        ScanGeometry { count, first_rad, increment_rad }
    }

    /// How long a sweep over all beams lasts, with a scan each `period_ns` [ns].
    pub fn sweep_ns(&self, period_ns: u64) -> u64 {
        // Two thirds of a multiple of three are a whole number, whatever the rounding of the share.
        ((period_ns as f64 * self.sweep_share + 1e-3) as u64).clamp(1, period_ns.max(1))
    }

    /// How long after the front beam the last one is taken, with a scan each `period_ns` [ns].
    pub fn after_front_ns(&self, period_ns: u64) -> u64 {
        let beams = self.beams - 1 - self.front_beam();
        (beams as u128 * u128::from(self.sweep_ns(period_ns)) / self.beams as u128) as u64
    }

    /// The same in scan periods.
    pub fn after_front_share(&self) -> f64 {
        let beams = self.beams - 1 - self.front_beam();
        beams as f64 / self.beams as f64 * self.sweep_share
    }

    /// The beam that looks most to the front.
    pub fn front_beam(&self) -> usize {
        (self.geometry().front().round() as usize).min(self.beams - 1)
    }

    /// Passes when the beams cover a turn at most, and what is ahead of a robot that has the scanner turned by `yaw_rad`.
    ///
    /// # Errors
    /// [`Invalid`] with the key that does not fit the others.
    pub fn require_view(&self, yaw_rad: f64) -> Result<(), Invalid> {
        let Self { beams, increment_rad, .. } = *self;
        let geometry = self.geometry();
        let (first_rad, last_rad) = (geometry.first_rad, geometry.yaw_rad(beams - 1));
        if beams as f64 * increment_rad > TAU + 1e-3 || last_rad > PI + increment_rad {
            let allowed = format!(
                "{beams} beams from {first_rad:.4} rad on end before the scanner's back, at {PI:.4} rad"
            );
            return Err(Invalid::new("increment_rad", increment_rad, allowed));
        }
        if first_rad + yaw_rad > -AHEAD_RAD || last_rad + yaw_rad < AHEAD_RAD {
            let (from, to) = (first_rad + yaw_rad, last_rad + yaw_rad);
            let allowed = format!(
                "at least {AHEAD_RAD:.2} rad to each side ahead are seen, found {from:.2} to {to:.2}"
            );
            return Err(Invalid::new("beams", beams, allowed));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A Hokuyo UST-10LX.
    fn ust() -> ScannerDescription {
        ScannerDescription { beams: 1081, increment_rad: TAU / 1440.0, ..ScannerDescription::default() }
    }

    #[test]
    fn the_default_is_the_urg_04lx() {
        let urg = ScannerDescription::default();
        assert_eq!((urg.geometry(), urg.front_beam()), (ScanGeometry::URG_04LX, 340));
        assert_eq!((urg.require_ranges(), urg.require_view(0.0)), (Ok(()), Ok(())));
        for period_ns in (25_000_000..25_000_100).chain([100_000_000, 99_999_999, 1_000_000_000]) {
            let sweep_ns = period_ns / 3 * 2 + period_ns % 3 * 2 / 3;
            assert_eq!((urg.sweep_ns(period_ns), urg.after_front_ns(period_ns)), (sweep_ns, sweep_ns / 2));
        }
    }

    #[test]
    fn the_middle_beam_looks_to_the_front() {
        let beams = ust().geometry();
        assert!((beams.first_rad.to_degrees() + 135.0).abs() < 1e-9);
        assert!((beams.yaw_rad(1080).to_degrees() - 135.0).abs() < 1e-9);
        assert_eq!(ust().front_beam(), 540);
    }

    #[test]
    fn a_view_that_does_not_cover_what_is_ahead_or_more_than_a_turn_is_refused_by_name() {
        let key =
            |scanner: ScannerDescription, yaw_rad| scanner.require_view(yaw_rad).map_err(|error| error.key);
        assert_eq!(key(ust(), 1.3), Ok(()), "135 degrees less 74 are 61");
        assert_eq!(key(ust(), 1.4), Err("beams".to_owned()));
        assert_eq!(key(ScannerDescription { beams: 100, ..ust() }, 0.0), Err("beams".to_owned()));
        let around = ScannerDescription { beams: 360, increment_rad: TAU / 360.0, ..ust() };
        assert_eq!(key(around, 0.0), Ok(()));
        assert_eq!(key(ScannerDescription { beams: 361, ..around }, 0.0), Err("increment_rad".to_owned()));
        let from_the_front = ScannerDescription { first_rad: Some(0.0), ..around };
        assert_eq!(key(from_the_front, 0.0), Err("increment_rad".to_owned()));
    }
}
