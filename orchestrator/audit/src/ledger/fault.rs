//! A fault that the sample audit found with one sample.

use std::fmt;

use serde::{Deserialize, Serialize};
use shared_types::Topic;

/// A sample that was lost, repeated or out of order, and no rule explains it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeliveryFault {
    /// Name of the topic.
    pub topic: String,
    /// The kind of fault.
    pub kind: DeliveryFaultKind,
    /// Incarnation of the process that wrote it, or should have.
    pub incarnation: u32,
    /// Its sequence number; 0 when it never got one, or when it is not known. Of several samples in a row, the first.
    pub sequence: u64,
    /// How many samples in a row it is.
    #[serde(default = "one")]
    pub count: u64,
    /// The scan it belongs to; 0 when that is not known.
    pub scan_id: u64,
    /// `bus` when the orchestrator noticed it, else the role whose counters show it.
    pub noticed_by: String,
}

/// The kind of fault of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DeliveryFaultKind {
    /// It should have arrived and did not.
    Missing,
    /// It arrived at a process, which neither used nor dropped it.
    Vanished,
    /// It came twice, under the same number or for the same scan.
    Duplicate,
    /// It came after a later one.
    Reordered,
    /// Its number is one that no scan, or no sample of its writer, can have.
    Impossible,
}

fn one() -> u64 {
    1
}

impl DeliveryFault {
    pub(super) fn new(topic: Topic, kind: DeliveryFaultKind, incarnation: u32) -> Self {
        let (topic, noticed_by) = (topic.name().to_owned(), "bus".to_owned());
        Self { topic, kind, incarnation, sequence: 0, count: 1, scan_id: 0, noticed_by }
    }

    pub(super) fn sequence(self, sequence: u64) -> Self {
        Self { sequence, ..self }
    }

    pub(super) fn count(self, count: u64) -> Self {
        Self { count, ..self }
    }

    pub(super) fn scan(self, scan_id: u64) -> Self {
        Self { scan_id, ..self }
    }

    pub(super) fn noticed_by(self, role: impl fmt::Display) -> Self {
        Self { noticed_by: role.to_string(), ..self }
    }

    /// Its last sequence number.
    pub(super) fn last(&self) -> u64 {
        self.sequence.saturating_add(self.count.saturating_sub(1))
    }

    /// Whether both are faults of the same sample, perhaps noticed by different processes.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        let alike = |mine: u64, theirs: u64| mine != 0 && mine == theirs;
        let is_numbered = self.sequence != 0 && other.sequence != 0;
        let overlap = is_numbered && self.sequence <= other.last() && other.sequence <= self.last();
        self.topic == other.topic
            && self.kind == other.kind
            && self.incarnation == other.incarnation
            && (overlap || alike(self.scan_id, other.scan_id))
    }

    /// Takes what another fault of the same samples knows beyond this one; returns by how many samples it grew.
    pub(super) fn merge(&mut self, other: &Self) -> u64 {
        let before = self.count;
        if self.sequence == 0 {
            (self.sequence, self.count) = (other.sequence, self.count.max(other.count));
        } else if other.sequence != 0 {
            let (first, last) = (self.sequence.min(other.sequence), self.last().max(other.last()));
            (self.sequence, self.count) = (first, (last - first).saturating_add(1));
        }
        self.scan_id = if self.scan_id == 0 { other.scan_id } else { self.scan_id };
        self.count.saturating_sub(before)
    }
}

impl fmt::Display for DeliveryFault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { topic, incarnation, sequence, count, scan_id, .. } = self;
        match (sequence, scan_id) {
            (0, _) if *count > 1 => {
                write!(formatter, "{count} samples of {topic} of incarnation {incarnation}")
            }
            (first, 0) if *count > 1 => {
                write!(formatter, "{topic} numbers {first} to {} of incarnation {incarnation}", self.last())
            }
            (first, scan) if *count > 1 => write!(
                formatter,
                "{topic} numbers {first} to {} of incarnation {incarnation}, from scan {scan} on,",
                self.last()
            ),
            (0, 0) => write!(formatter, "{topic} of incarnation {incarnation}"),
            (0, _) => write!(formatter, "{topic} for scan {scan_id} of incarnation {incarnation}"),
            (_, 0) => write!(formatter, "{topic} number {sequence} of incarnation {incarnation}"),
            _ => write!(
                formatter,
                "{topic} number {sequence} of incarnation {incarnation}, for scan {scan_id},"
            ),
        }?;
        formatter.write_str(match self.kind {
            DeliveryFaultKind::Missing if *count > 1 => " are missing",
            DeliveryFaultKind::Vanished if *count > 1 => " came and vanished",
            DeliveryFaultKind::Missing => " is missing",
            DeliveryFaultKind::Vanished => " came and vanished",
            DeliveryFaultKind::Duplicate => " came twice",
            DeliveryFaultKind::Reordered => " came after a later one",
            DeliveryFaultKind::Impossible => " has a number that it can't have",
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
        let fault = DeliveryFault::new(Topic::Pose, DeliveryFaultKind::Missing, 2)
            .sequence(17)
            .scan(18)
            .noticed_by("obstacles");
        assert_eq!(
            fault.to_string(),
            "pose number 17 of incarnation 2, for scan 18, is missing (noticed by the obstacles)"
        );
        let fault = DeliveryFault::new(Topic::Pose, DeliveryFaultKind::Duplicate, 2).scan(18);
        assert_eq!(fault.to_string(), "pose for scan 18 of incarnation 2 came twice");
    }

    #[test]
    fn several_samples_in_a_row_are_one_fault() {
        let fault = |first, count| {
            DeliveryFault::new(Topic::Pose, DeliveryFaultKind::Missing, 2).sequence(first).count(count)
        };
        assert_eq!(
            fault(17, 3).scan(18).to_string(),
            "pose numbers 17 to 19 of incarnation 2, from scan 18 on, are missing"
        );
        assert_eq!(fault(0, 5).to_string(), "5 samples of pose of incarnation 2 are missing");
        let mut known = fault(17, 3);
        assert!(known.is_same(&fault(19, 1)) && !known.is_same(&fault(20, 1)));
        assert_eq!((known.merge(&fault(18, 1)), known.merge(&fault(18, 9))), (0, 7));
        assert_eq!((known.sequence, known.count), (17, 10));
        // Without numbers only the scan tells.
        assert!(!fault(0, 20).is_same(&fault(5, 1)) && !fault(5, 1).is_same(&fault(0, 20)));
        let mut unnumbered = fault(0, 5);
        assert_eq!(unnumbered.merge(&fault(7, 2)), 0);
        assert_eq!((unnumbered.sequence, unnumbered.count), (7, 5));
    }

    #[test]
    fn a_fault_of_a_report_without_a_count_is_one_sample() {
        let fault = DeliveryFault::new(Topic::Pose, DeliveryFaultKind::Missing, 2).sequence(17).count(3);
        let mut json = serde_json::to_value(&fault).unwrap();
        assert_eq!(serde_json::from_value::<DeliveryFault>(json.clone()).unwrap(), fault);
        json.as_object_mut().unwrap().remove("count");
        assert_eq!(serde_json::from_value::<DeliveryFault>(json).unwrap(), fault.count(1));
    }

    #[test]
    fn the_same_sample_is_one_fault_at_whichever_process_it_was_noticed() {
        let numbered = DeliveryFault::new(Topic::Scan, DeliveryFaultKind::Missing, 1).sequence(17).scan(18);
        assert!(numbered.is_same(
            &DeliveryFault::new(Topic::Scan, DeliveryFaultKind::Missing, 1).scan(18).noticed_by("obstacles")
        ));
        assert!(
            numbered.is_same(&DeliveryFault::new(Topic::Scan, DeliveryFaultKind::Missing, 1).sequence(17))
        );
        for other in [
            DeliveryFault::new(Topic::Scan, DeliveryFaultKind::Missing, 1),
            DeliveryFault::new(Topic::Scan, DeliveryFaultKind::Missing, 2).sequence(17),
            DeliveryFault::new(Topic::Scan, DeliveryFaultKind::Duplicate, 1).sequence(17),
            DeliveryFault::new(Topic::Odometry, DeliveryFaultKind::Missing, 1).sequence(17),
        ] {
            assert!(!numbered.is_same(&other), "{other}");
        }
    }
}
