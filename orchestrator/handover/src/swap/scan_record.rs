//! What the recorded scans show of a swap: which process answered which scan, which were missed, and how far commands
//! jumped.
//!
//! The answer of the actuator carries the stamp of the sample that it is based on, and that stamp identifies one of the
//! two processes. So the record shows what happened, which may differ from what was planned. In lock-step, where stamps
//! do not identify a process, the plan counts. A change is a scan at which the answers pass from one process to the other.

use std::collections::VecDeque;

use super::{Certificate, Party};

/// Scans before and after a change between which commands are compared.
const JUMP_SCANS: [u64; 2] = [2, 3];
/// Answers kept for the comparison before a change.
const ANSWERS: usize = 8;

/// One scan as it was recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordedScan {
    /// The scan; they come in order.
    pub scan: u64,
    /// Answers of the actuator.
    pub answers: u64,
    /// Desired steering angle and velocity of the last answer [rad, m/s].
    pub desired: [f64; 2],
    /// When the sample of the role was published that the last answer is based on [ns]; 0 when unknown.
    pub stamp_ns: u64,
}

/// The recorded scans of one swap.
#[derive(Debug, Clone, Default)]
pub(super) struct ScanRecord {
    missed: u64,
    duplicates: u64,
    /// Largest change of steering angle and velocity around the changes [rad, m/s].
    jump: [f64; 2],
    answers: VecDeque<(u64, [f64; 2])>,
    last_old: Option<u64>,
    first_new: Option<u64>,
    back: Option<u64>,
}

impl ScanRecord {
    /// Adds a scan that was answered with the output of `party`, as far as that is known.
    pub(super) fn record(&mut self, recorded: &RecordedScan, party: Party) {
        let RecordedScan { scan, answers, desired, .. } = *recorded;
        self.missed += u64::from(answers == 0);
        self.duplicates += answers.saturating_sub(1);
        if answers == 0 {
            return;
        }
        match (party, self.first_new) {
            (Party::Old, None) => self.last_old = Some(scan),
            (Party::New, None) => {
                self.first_new = Some(scan);
                self.changed_at(scan);
            }
            (Party::Old, Some(_)) if self.back.is_none() => {
                self.back = Some(scan);
                self.changed_at(scan);
            }
            (_, Some(_)) => {}
        }
        let is_change_near = |before| {
            [self.first_new, self.back].iter().flatten().any(|change| is_near(*change, before, scan))
        };
        if let Some(&(before, last)) = self.answers.back()
            && is_change_near(before)
        {
            self.jumped(last, desired);
        }
        self.answers.push_back((scan, desired));
        if self.answers.len() > ANSWERS {
            self.answers.pop_front();
        }
    }

    /// Compares the answers before a change that is just being recorded; those after it follow.
    fn changed_at(&mut self, change: u64) {
        for index in 1..self.answers.len() {
            let ((before, last), (scan, desired)) = (self.answers[index - 1], self.answers[index]);
            if is_near(change, before, scan) {
                self.jumped(last, desired);
            }
        }
    }

    /// The last scan that belongs to a change.
    pub(super) fn settled_at(change: u64) -> u64 {
        change + JUMP_SCANS[1]
    }

    /// Whether that scan was recorded.
    pub(super) fn reaches(&self, scan: u64) -> bool {
        self.answers.back().is_some_and(|(newest, _)| *newest >= scan)
    }

    /// Writes the record into a certificate.
    pub(super) fn fill(&self, certificate: &mut Certificate) {
        certificate.missed_scans = self.missed;
        certificate.duplicate_scans = self.duplicates;
        [certificate.command_jump_rad, certificate.command_jump_mps] = self.jump;
        certificate.last_scan_old = self.last_old.filter(|_| self.first_new.is_some());
        certificate.first_scan_new = self.first_new;
        certificate.first_scan_back = self.back;
    }

    fn jumped(&mut self, last: [f64; 2], desired: [f64; 2]) {
        for (jump, (before, after)) in self.jump.iter_mut().zip(last.iter().zip(&desired)) {
            *jump = jump.max((after - before).abs());
        }
    }
}

/// Two answers that both lie between two scans before and three after a change.
fn is_near(change: u64, before: u64, scan: u64) -> bool {
    before + JUMP_SCANS[0] >= change && scan <= change + JUMP_SCANS[1]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(parties: &[Party], steering: impl Fn(u64) -> f64) -> Certificate {
        let mut scan_record = ScanRecord::default();
        for (index, party) in parties.iter().enumerate() {
            let scan = index as u64 + 1;
            let recorded = RecordedScan { scan, answers: 1, desired: [steering(scan), 1.0], stamp_ns: 0 };
            scan_record.record(&recorded, *party);
        }
        let mut certificate = Certificate::default();
        scan_record.fill(&mut certificate);
        certificate
    }

    #[test]
    fn the_record_shows_which_process_answered() {
        use Party::{New, Old};
        let certificate = record(&[Old, Old, New, New, Old], |_| 0.0);
        assert_eq!(
            (certificate.last_scan_old, certificate.first_scan_new, certificate.first_scan_back),
            (Some(2), Some(3), Some(5))
        );
        let certificate = record(&[Old, New, Old, New, Old], |_| 0.0);
        assert_eq!(
            (certificate.first_scan_new, certificate.first_scan_back),
            (Some(2), Some(3)),
            "the first"
        );
        let certificate = record(&[Old, Old, Old], |_| 0.0);
        assert_eq!(
            (certificate.last_scan_old, certificate.first_scan_new, certificate.first_scan_back),
            (None, None, None)
        );
    }

    #[test]
    fn jumps_count_from_two_scans_before_a_change_to_three_after_it() {
        let parties: Vec<Party> =
            (1..=20).map(|scan| if scan < 10 { Party::Old } else { Party::New }).collect();
        for (step_at, expected) in [(8, 0.0), (9, 0.1), (10, 0.1), (13, 0.1), (14, 0.0)] {
            let certificate = record(&parties, |scan| if scan < step_at { 0.0 } else { 0.1 });
            assert_eq!(certificate.command_jump_rad, expected, "a step at scan {step_at}");
        }
    }
}
