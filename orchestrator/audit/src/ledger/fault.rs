//! A fault that the sample audit found with one sample.

use std::fmt;

use serde::{Deserialize, Serialize};
use shared_types::Topic;

/// A sample that was lost, repeated or out of order, and no rule explains it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fault {
    /// Name of the topic.
    pub topic: String,
    /// The kind of fault.
    pub kind: Kind,
    /// Incarnation of the process that wrote it, or should have.
    pub incarnation: u32,
    /// Its sequence number; 0 when it never got one.
    pub sequence: u64,
    /// The scan it belongs to; 0 when that is not known.
    pub scan_id: u64,
    /// `bus` when the orchestrator noticed it, else the role whose counters show it.
    pub noticed_by: String,
}

/// The kind of fault of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// It should have arrived and did not.
    Missing,
    /// It arrived at a process, which neither used nor dropped it.
    Vanished,
    /// It came twice, under the same number or for the same scan.
    Duplicate,
    /// It came after a later one.
    Reordered,
}

impl Fault {
    pub(super) fn new(topic: Topic, kind: Kind, incarnation: u32) -> Self {
        let (topic, noticed_by) = (topic.name().to_owned(), "bus".to_owned());
        Self { topic, kind, incarnation, sequence: 0, scan_id: 0, noticed_by }
    }

    pub(super) fn sequence(self, sequence: u64) -> Self {
        Self { sequence, ..self }
    }

    pub(super) fn scan(self, scan_id: u64) -> Self {
        Self { scan_id, ..self }
    }

    pub(super) fn noticed_by(self, role: impl fmt::Display) -> Self {
        Self { noticed_by: role.to_string(), ..self }
    }

    /// Whether both are faults of the same sample, perhaps noticed by different processes.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        let alike = |mine: u64, theirs: u64| mine != 0 && mine == theirs;
        self.topic == other.topic
            && self.kind == other.kind
            && self.incarnation == other.incarnation
            && (alike(self.sequence, other.sequence) || alike(self.scan_id, other.scan_id))
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { topic, incarnation, sequence, scan_id, .. } = self;
        match (sequence, scan_id) {
            (0, 0) => write!(formatter, "{topic} of incarnation {incarnation}"),
            (0, _) => write!(formatter, "{topic} for scan {scan_id} of incarnation {incarnation}"),
            (_, 0) => write!(formatter, "{topic} number {sequence} of incarnation {incarnation}"),
            _ => write!(
                formatter,
                "{topic} number {sequence} of incarnation {incarnation}, for scan {scan_id},"
            ),
        }?;
        formatter.write_str(match self.kind {
            Kind::Missing => " is missing",
            Kind::Vanished => " came and vanished",
            Kind::Duplicate => " came twice",
            Kind::Reordered => " came after a later one",
        })?;
        match self.noticed_by.as_str() {
            "bus" => Ok(()),
            role => write!(formatter, " (noticed by the {role})"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_names_topic_number_and_scan() {
        let fault = Fault::new(Topic::Pose, Kind::Missing, 2).sequence(17).scan(18).noticed_by("obstacles");
        assert_eq!(
            fault.to_string(),
            "pose number 17 of incarnation 2, for scan 18, is missing (noticed by the obstacles)"
        );
        let fault = Fault::new(Topic::Pose, Kind::Duplicate, 2).scan(18);
        assert_eq!(fault.to_string(), "pose for scan 18 of incarnation 2 came twice");
    }

    #[test]
    fn the_same_sample_is_one_fault_at_whichever_process_it_was_noticed() {
        let numbered = Fault::new(Topic::Scan, Kind::Missing, 1).sequence(17).scan(18);
        assert!(
            numbered.is_same(&Fault::new(Topic::Scan, Kind::Missing, 1).scan(18).noticed_by("obstacles"))
        );
        assert!(numbered.is_same(&Fault::new(Topic::Scan, Kind::Missing, 1).sequence(17)));
        for other in [
            Fault::new(Topic::Scan, Kind::Missing, 1),
            Fault::new(Topic::Scan, Kind::Missing, 2).sequence(17),
            Fault::new(Topic::Scan, Kind::Duplicate, 1).sequence(17),
            Fault::new(Topic::Odometry, Kind::Missing, 1).sequence(17),
        ] {
            assert!(!numbered.is_same(&other), "{other}");
        }
    }
}
