//! Counts of the scanner's states.

use shared_types::{ScannerHealth, ScannerState};

use crate::report::ScannerReport;

/// States of the scanner over all descriptions of obstacles.
#[derive(Debug, Clone, Default)]
pub(super) struct Scanner {
    /// The newest state.
    pub(super) newest: Option<ScannerHealth>,
    /// Whether the newest command blocks the wheels for it.
    pub(super) stops: bool,
    scans: u64,
    valid: f64,
    counts: ScannerReport,
}

impl Scanner {
    /// Counts the state of the scanner after one scan.
    pub(super) fn add(&mut self, health: ScannerHealth) {
        self.newest = Some(health);
        self.scans += 1;
        self.valid += health.valid_share;
        let counts = &mut self.counts;
        match health.state() {
            ScannerState::Healthy => {}
            ScannerState::Degraded => counts.degraded_scans += 1,
            ScannerState::Blind => counts.blind_scans += 1,
            ScannerState::Stuck => counts.stuck_scans += 1,
            ScannerState::Contradictory => counts.contradictory_scans += 1,
        }
    }

    /// The counts, with the mean share of valid beams.
    pub(super) fn report(&self) -> ScannerReport {
        ScannerReport { valid_share: self.valid / self.scans.max(1) as f64, ..self.counts }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_state_is_counted_and_the_share_is_the_mean() {
        let mut scanner = Scanner::default();
        assert_eq!(scanner.report(), ScannerReport::default());
        for (state, count) in ScannerState::ALL.iter().zip([5, 1, 2, 3, 4]) {
            for index in 0..count {
                let valid_share = if index == 0 { 0.5 } else { 0.8 };
                let health = ScannerHealth { state: state.wire(), valid_share, ..ScannerHealth::default() };
                scanner.add(health);
            }
        }
        let report = scanner.report();
        assert!((report.valid_share - 0.7).abs() < 1e-12, "{}", report.valid_share);
        let ScannerReport { degraded_scans, blind_scans, stuck_scans, contradictory_scans, .. } = report;
        assert_eq!([degraded_scans, blind_scans, stuck_scans, contradictory_scans], [1, 2, 3, 4]);
        assert_eq!(scanner.newest.map(|health| health.state()), Some(ScannerState::Contradictory));
        let text =
            "70.0 % of beams valid, 1 scans degraded, 2 scans blind, 3 scans stuck, 4 scans contradictory";
        assert_eq!(report.to_string(), text);
    }
}
