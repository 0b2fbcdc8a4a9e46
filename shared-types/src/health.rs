//! What the description of obstacles can rely on: the health of the scanner.

use std::fmt;

use crate::describe::layout;
use crate::fault::finite;
use crate::named::wire_enum;
use crate::{BEAMS, Fault};

/// Beams of one sector of evidence: 3.9 deg.
pub const SECTOR_BEAMS: usize = 11;
/// Number of sectors of evidence, as many as have a bit in [`ScannerHealth::unseen_sectors`].
pub const SECTORS: usize = BEAMS / SECTOR_BEAMS;

/// Errors of factor, offset [m] and mounting angle [rad] that the margins of the controller cover.
pub const TOLERATED_ERRORS: [f64; 3] = [0.07, 0.12, 0.1];

const _: () = assert!(SECTORS * SECTOR_BEAMS == BEAMS && SECTORS <= 64);

wire_enum! {
    /// What the ranges of the scanner can be used for.
    pub enum ScannerState {
        /// Returns come where earlier scans predict them.
        Healthy = 0 "healthy",
        /// Many returns are missing or wrong: drive slowly.
        Degraded = 1 "degraded",
        /// Too few returns come to see an obstacle in time: block the wheels.
        Blind = 2 "blind",
        /// The same ranges are repeated while the robot moves: block the wheels.
        Stuck = 3 "stuck",
        /// The ranges contradict the motion of the robot: block the wheels.
        Contradictory = 4 "contradictory",
    }
}

impl ScannerState {
    /// Whether the wheels are blocked in this state.
    pub fn is_stop(self) -> bool {
        matches!(self, Self::Blind | Self::Stuck | Self::Contradictory)
    }
}

layout! {
    /// What is known of the scanner after one scan.
    pub struct ScannerHealth(72) {
        /// Whether and how fast the robot may drive with these ranges, `ScannerState`
        pub state: u32,
        /// Scans in a row with the ranges of the scan before, while the robot moved
        pub identical_scans: u32,
        /// Sectors without evidence, one bit each: sector k has the beams 11 k to 11 k + 10
        pub unseen_sectors: u64,
        /// Share of the window's beams with a valid range
        pub valid_share: f64,
        /// Share of the returns that came where earlier scans predict them; 1 where none are predicted
        pub returned_share: f64,
        /// Time since the last scan with ranges; zero when this one has them [s]
        pub blind_s: f64,
        /// Farthest distance ahead, from the robot's centre, at which nothing that appears can be missed [m]
        pub seen_ahead_m: f64,
        /// Estimated ratio of the reported ranges to the true ones
        pub range_factor: f64,
        /// Estimated length added to the reported ranges [m]
        pub range_offset_m: f64,
        /// Estimated error of the mounting angle, counter-clockwise [rad]
        pub yaw_error_rad: f64,
    }
}

impl ScannerHealth {
    /// A scanner without any fault that sees `seen_ahead_m` far.
    pub fn healthy(seen_ahead_m: f64) -> Self {
        Self { valid_share: 1.0, returned_share: 1.0, range_factor: 1.0, seen_ahead_m, ..Self::default() }
    }

    /// The state; one that is not known counts as blind.
    pub fn state(&self) -> ScannerState {
        ScannerState::try_from(self.state).unwrap_or(ScannerState::Blind)
    }

    /// Which error of the ranges contradicts the motion most, with its figure.
    fn contradiction(&self) -> String {
        let errors = [self.range_factor - 1.0, self.range_offset_m, self.yaw_error_rad];
        let relative: [f64; 3] = std::array::from_fn(|index| (errors[index] / TOLERATED_ERRORS[index]).abs());
        let largest = relative.into_iter().fold(1.0, f64::max);
        let factor = self.range_factor;
        match relative.iter().position(|error| *error >= largest) {
            Some(0) => format!("ranges {factor:.2} times the true ones by the motion"),
            Some(1) => format!("ranges {:+.2} m off the true ones by the motion", self.range_offset_m),
            Some(_) => format!("turned by {:+.2} rad by the motion", self.yaw_error_rad),
            None => "ranges differ from those that earlier scans predict".to_owned(),
        }
    }

    /// Passes when all numbers are possible.
    pub(crate) fn check(&self) -> Result<(), Fault> {
        if ScannerState::try_from(self.state).is_err() {
            return Err(Fault::OutOfRange { field: "scanner.state", value: f64::from(self.state) });
        }
        finite("scanner", &[self.range_factor, self.range_offset_m, self.yaw_error_rad])?;
        let shares =
            [("scanner.valid_share", self.valid_share), ("scanner.returned_share", self.returned_share)];
        for (field, value) in shares {
            if !(0.0..=1.0).contains(&value) {
                return Err(Fault::OutOfRange { field, value });
            }
        }
        for (field, value) in [("scanner.blind_s", self.blind_s), ("scanner.seen_ahead_m", self.seen_ahead_m)]
        {
            if !(0.0..=1e6).contains(&value) {
                return Err(Fault::OutOfRange { field, value });
            }
        }
        Ok(())
    }
}

impl fmt::Display for ScannerHealth {
    /// The state with the figures that explain it, like `blind: no new ranges for 0.4 s`.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let state = self.state();
        write!(formatter, "{state}: ")?;
        match state {
            ScannerState::Blind if self.blind_s > 0.0 => {
                write!(formatter, "no new ranges for {:.1} s", self.blind_s)
            }
            ScannerState::Stuck => {
                write!(formatter, "the same ranges in {} more scans", self.identical_scans)
            }
            ScannerState::Contradictory => write!(formatter, "{}", self.contradiction()),
            ScannerState::Healthy | ScannerState::Degraded | ScannerState::Blind => write!(
                formatter,
                "{:.0} % of the predicted returns come, {} of {SECTORS} sectors without evidence, {:.1} m seen ahead",
                100.0 * self.returned_share,
                self.unseen_sectors.count_ones(),
                self.seen_ahead_m
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_state_is_explained_by_its_figures() {
        let of = |state: ScannerState| ScannerHealth { state: state.wire(), ..ScannerHealth::healthy(1.2) };
        let blind = ScannerHealth { blind_s: 0.44, ..of(ScannerState::Blind) };
        assert_eq!(blind.to_string(), "blind: no new ranges for 0.4 s");
        let degraded =
            ScannerHealth { returned_share: 0.34, unseen_sectors: 0b110, ..of(ScannerState::Degraded) };
        assert_eq!(
            degraded.to_string(),
            "degraded: 34 % of the predicted returns come, 2 of 62 sectors without evidence, 1.2 m seen ahead"
        );
        let stuck = ScannerHealth { identical_scans: 7, ..of(ScannerState::Stuck) };
        assert_eq!(stuck.to_string(), "stuck: the same ranges in 7 more scans");
        let wrong = |range_factor, range_offset_m, yaw_error_rad| {
            let health = of(ScannerState::Contradictory);
            ScannerHealth { range_factor, range_offset_m, yaw_error_rad, ..health }.to_string()
        };
        let text = "contradictory: ranges";
        assert_eq!(wrong(1.36, 0.2, 0.1), format!("{text} 1.36 times the true ones by the motion"));
        assert_eq!(wrong(1.01, -0.2, 0.1), format!("{text} -0.20 m off the true ones by the motion"));
        assert_eq!(wrong(0.95, 0.0, 0.3), "contradictory: turned by +0.30 rad by the motion");
        assert_eq!(wrong(1.06, 0.1, 0.09), format!("{text} differ from those that earlier scans predict"));
    }

    #[test]
    fn an_unknown_state_and_a_share_above_one_are_refused() {
        assert_eq!(ScannerHealth::healthy(5.0).check(), Ok(()));
        let unknown = ScannerHealth { state: 9, ..ScannerHealth::healthy(5.0) };
        assert_eq!(unknown.state(), ScannerState::Blind);
        assert_eq!(unknown.check(), Err(Fault::OutOfRange { field: "scanner.state", value: 9.0 }));
        let share = ScannerHealth { returned_share: 1.1, ..ScannerHealth::healthy(5.0) };
        assert_eq!(share.check(), Err(Fault::OutOfRange { field: "scanner.returned_share", value: 1.1 }));
    }
}
