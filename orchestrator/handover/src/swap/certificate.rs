//! The certificate of a swap, which `scanloop swap` prints and `report.json` contains.

use std::fmt;

use serde::{Deserialize, Serialize};

/// How a swap ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SwapOutcome {
    /// The new process is in charge.
    Swapped,
    /// The new process never was in charge.
    #[default]
    Refused,
    /// The new process was in charge, and the old one is again.
    RolledBack,
}

/// The reason of a swap that the end of the run decides.
pub const RUN_ENDS: &str = "the run ends";

impl fmt::Display for Certificate {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { role, from, to, reason, missed_scans, duplicate_scans, .. } = self;
        let because = if reason.is_empty() { String::new() } else { format!(": {reason}") };
        match (self.outcome, self.first_scan_new) {
            (SwapOutcome::Swapped, Some(first)) => {
                write!(formatter, "{role}: {to} has taken over from {from} at scan {first}{because}")?;
            }
            (SwapOutcome::RolledBack, _) => {
                write!(formatter, "{role}: {to} was rolled back to {from}{because}")?
            }
            _ if reason == RUN_ENDS => return write!(formatter, "{role}: {to} was refused{because}"),
            _ => return write!(formatter, "{role}: {to} was refused, {from} keeps driving{because}"),
        }
        write!(formatter, "; {missed_scans} scans missed, {duplicate_scans} answered twice")
    }
}

impl Certificate {
    /// The text for a swap to the same program, which is a restart.
    pub fn of_restart(&self) -> String {
        let Self { role, missed_scans, reason, .. } = self;
        match (self.outcome, self.first_scan_new) {
            (SwapOutcome::Swapped, Some(first)) => {
                format!(
                    "{role} was restarted: the new process drives since scan {first}; {missed_scans} scans missed"
                )
            }
            (SwapOutcome::Swapped, None) => format!("{role} was restarted: {reason}"),
            _ if reason == RUN_ENDS => format!("{role} was not restarted: {reason}"),
            _ => format!("{role} was not restarted, the old process keeps driving: {reason}"),
        }
    }
}

/// The record of one swap, `swap --json`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Certificate {
    /// Name of the role.
    pub role: String,
    /// Implementation or command of the old process.
    pub from: String,
    /// Implementation or command of the new process.
    pub to: String,
    /// Scans in a row on which the new process agreed with the old one before it took over.
    pub shadow_scans: u64,
    /// The last scan that is answered with the old process before the change.
    pub last_scan_old: Option<u64>,
    /// The first scan that is answered with the new process; nothing when none is.
    pub first_scan_new: Option<u64>,
    /// After a rollback: the first scan that is answered with the old process again.
    #[serde(default)]
    pub first_scan_back: Option<u64>,
    /// Scans without an answer between start and end.
    pub missed_scans: u64,
    /// Answers to scans that had been answered already, between start and end.
    pub duplicate_scans: u64,
    /// Largest change of the desired steering angle between two answers around the change [rad].
    pub command_jump_rad: f64,
    /// Largest change of the desired velocity between two answers around the change [m/s].
    pub command_jump_mps: f64,
    /// How it ended.
    pub outcome: SwapOutcome,
    /// Why it ended so; empty when all went as asked.
    pub reason: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_certificate_tells_how_it_ended() {
        let certificate = |outcome, first_scan_new, reason: &str| Certificate {
            role: "controller".to_owned(),
            from: "nmpc".to_owned(),
            to: "mine".to_owned(),
            first_scan_new,
            outcome,
            reason: reason.to_owned(),
            missed_scans: 2,
            ..Certificate::default()
        };
        let swapped = certificate(SwapOutcome::Swapped, Some(7), "");
        let text = "controller: mine has taken over from nmpc at scan 7; 2 scans missed, 0 answered twice";
        assert_eq!(swapped.to_string(), text);
        let text = "controller was restarted: the new process drives since scan 7; 2 scans missed";
        assert_eq!(swapped.of_restart(), text);
        let unseen = certificate(SwapOutcome::Swapped, None, RUN_ENDS);
        assert_eq!(unseen.of_restart(), "controller was restarted: the run ends");
        let back = certificate(SwapOutcome::RolledBack, Some(7), "it hangs");
        let text = "controller: mine was rolled back to nmpc: it hangs; 2 scans missed, 0 answered twice";
        assert_eq!(back.to_string(), text);
        let text = "controller was not restarted, the old process keeps driving: it hangs";
        assert_eq!(back.of_restart(), text);
        let refused = certificate(SwapOutcome::Refused, None, "it hangs");
        assert_eq!(refused.to_string(), "controller: mine was refused, nmpc keeps driving: it hangs");
        // Nothing drives on then.
        let ended = certificate(SwapOutcome::Refused, None, RUN_ENDS);
        assert_eq!(ended.to_string(), "controller: mine was refused: the run ends");
        assert_eq!(ended.of_restart(), "controller was not restarted: the run ends");
    }
}
