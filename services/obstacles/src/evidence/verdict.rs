//! From what was found in each scan to the state of the scanner.
//!
//! A state ends when a better one was found for [`SETTLE_S`]. Ranges that contradict the motion can't become right
//! while the robot rests, as nothing moves: [`Evidence`](super::Evidence) forgets the contradiction when the ranges
//! change as a whole, which they do when the fault ends.

use shared_types::{ScannerState, plain_state};

/// Scans in a row with the same ranges while the robot moves: stuck.
const STUCK_SCANS: u32 = 5;
/// Without ranges for this long the scanner is blind [s].
const BLIND_S: f64 = 0.35;
/// With ranges that contradict those before for this long they are contradictory [s].
const JUMPED_S: f64 = 2.0;
/// Shares of the predicted returns below which the scanner is blind, and degraded.
const SHARES: [f64; 2] = [0.2, 0.4];
/// Share of right ranges among those that came, below which they are contradictory.
const RIGHT_SHARE: f64 = 0.3;
/// A state ends when a better one was found for this long [s].
const SETTLE_S: f64 = 1.0;

plain_state! {
    /// State of the scanner with what its change depends on.
    pub struct VerdictState {
        /// Time since the last ranges [s]
        pub blind_s: f64,
        /// How long the ranges contradict those before [s]
        pub jumped_s: f64,
        /// How long a better state was found [s]
        pub better_s: f64,
        /// The state, `ScannerState`
        pub state: u32,
        /// Scans in a row with repeated ranges while the robot moved
        pub identical: u32,
    }
}

/// What one scan brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Brought {
    /// Ranges that fit those before.
    #[default]
    Ranges,
    /// No ranges at all, or hardly any.
    Nothing,
    /// The ranges of the scan before although the robot has moved.
    Repetition,
    /// Ranges that contradict those before.
    Jump,
}

/// What is found after one scan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Findings {
    /// Time since the scan before [s].
    pub(crate) elapsed: f64,
    /// What the scan brought.
    pub(crate) brought: Brought,
    /// The ranges contradict the motion of the robot.
    pub(crate) contradicts: bool,
    /// They do but the odometry is the cause, or hardly anything ahead is seen.
    pub(crate) is_doubtful: bool,
    /// Share of the predicted returns that came at their range.
    pub(crate) agreed_share: Option<f64>,
    /// Share of right ranges among those that came.
    pub(crate) right_share: Option<f64>,
}

impl VerdictState {
    /// The state after a scan.
    pub(crate) fn judge(&mut self, findings: &Findings) -> ScannerState {
        let longer = |time: f64| (time + findings.elapsed).min(1e6);
        let brought = findings.brought;
        let is_blind = matches!(brought, Brought::Nothing | Brought::Repetition);
        self.blind_s = if is_blind { longer(self.blind_s) } else { 0.0 };
        self.jumped_s = if brought == Brought::Jump { longer(self.jumped_s) } else { 0.0 };
        self.identical = match brought {
            Brought::Repetition => self.identical.saturating_add(1),
            Brought::Nothing => self.identical,
            Brought::Ranges | Brought::Jump => 0,
        };
        let found = self.found(findings);
        if severity(found) >= severity(self.state()) {
            (self.state, self.better_s) = (found.wire(), 0.0);
        } else {
            self.better_s = longer(self.better_s);
            if self.better_s >= SETTLE_S - 1e-9 {
                (self.state, self.better_s) = (found.wire(), 0.0);
            }
        }
        self.state()
    }

    /// Ends the state with the next scan that finds a better one: its cause was none.
    pub(crate) fn settle(&mut self) {
        self.better_s = SETTLE_S;
    }

    /// The state.
    pub(crate) fn state(&self) -> ScannerState {
        ScannerState::try_from(self.state).unwrap_or(ScannerState::Blind)
    }

    /// Whether all numbers are possible.
    pub(crate) fn is_sound(&self) -> bool {
        [self.blind_s, self.jumped_s, self.better_s].iter().all(|time| (0.0..1e9).contains(time))
            && ScannerState::try_from(self.state).is_ok()
    }

    /// What this scan alone tells.
    fn found(&self, findings: &Findings) -> ScannerState {
        let [blind, degraded] = SHARES;
        let below = |share: Option<f64>, limit: f64| share.is_some_and(|share| share < limit);
        let is_wrong = below(findings.right_share, RIGHT_SHARE);
        if self.identical >= STUCK_SCANS {
            ScannerState::Stuck
        } else if findings.contradicts || self.jumped_s > JUMPED_S || is_wrong {
            ScannerState::Contradictory
        } else if self.blind_s > BLIND_S || below(findings.agreed_share, blind) {
            ScannerState::Blind
        } else if findings.is_doubtful || below(findings.agreed_share, degraded) {
            ScannerState::Degraded
        } else {
            ScannerState::Healthy
        }
    }
}

/// How bad a state is; those that stop the robot are equally bad.
fn severity(state: ScannerState) -> u32 {
    if state.is_stop() { 2 } else { state.wire() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(verdict: &mut VerdictState, findings: Findings, scans: usize) -> Vec<&'static str> {
        (0..scans).map(|_| verdict.judge(&Findings { elapsed: 0.1, ..findings }).name()).collect()
    }

    #[test]
    fn a_few_missing_scans_are_no_blindness_and_blindness_ends_after_a_second_of_health() {
        let mut verdict = VerdictState::default();
        let (missing, fine) =
            (Findings { brought: Brought::Nothing, ..Findings::default() }, Findings::default());
        assert_eq!(run(&mut verdict, missing, 3), ["healthy"; 3]);
        assert_eq!(run(&mut verdict, missing, 1), ["blind"]);
        assert_eq!(run(&mut verdict, fine, 9), ["blind"; 9]);
        assert_eq!(run(&mut verdict, fine, 1), ["healthy"]);
    }

    #[test]
    fn five_repetitions_are_stuck_and_wrong_ranges_contradict() {
        let mut verdict = VerdictState::default();
        let repeated = Findings { brought: Brought::Repetition, ..Findings::default() };
        let seen = run(&mut verdict, repeated, 5);
        assert_eq!(seen, ["healthy", "healthy", "healthy", "blind", "stuck"]);
        let wrong = Findings { right_share: Some(0.29), agreed_share: Some(0.29), ..Findings::default() };
        assert_eq!(run(&mut VerdictState::default(), wrong, 1), ["contradictory"]);
        let shares =
            [0.19, 0.39, 0.41].map(|share| Findings { agreed_share: Some(share), ..Findings::default() });
        let states = shares.map(|findings| run(&mut VerdictState::default(), findings, 1)[0]);
        assert_eq!(states, ["blind", "degraded", "healthy"]);
    }
}
