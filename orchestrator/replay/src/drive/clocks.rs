//! The clocks of other hosts: a recording has times of the orchestrator's clock, a process knows those of its own host.

use std::collections::BTreeMap;

use shared_types::{ClockOffset, Sample, shift_times};
use supervision::entry::ProcessRow;

/// Which process was on which other host, and the offset of each host for each scan.
#[derive(Debug, Default)]
pub(crate) struct Clocks {
    hosts: BTreeMap<u32, String>,
    /// What the orchestrator's clock was ahead by [ns]; `None` for a scan of which a host has used more than one offset.
    offsets: BTreeMap<String, BTreeMap<u64, Option<i64>>>,
}

impl Clocks {
    /// Takes in where a process runs.
    pub(super) fn note(&mut self, row: &ProcessRow) {
        if let Some(host) = &row.entry.host {
            self.hosts.insert(row.identity.incarnation, host.clone());
        }
    }

    /// Takes in the offset of a host for a scan.
    pub(super) fn add(&mut self, offset: &ClockOffset) {
        let found = Some(offset.offset_ns());
        let scans = self.offsets.entry(offset.host_name().to_owned()).or_default();
        let known = scans.entry(offset.header.scan_id).or_insert(found);
        if *known != found {
            *known = None;
        }
    }

    /// Whether a process ran on another host.
    pub(super) fn is_elsewhere(&self, incarnation: u32) -> bool {
        self.hosts.contains_key(&incarnation)
    }

    /// What the orchestrator's clock is ahead of that of a process by in a scan [ns]; `None` when that is not known.
    fn offset_ns(&self, incarnation: u32, scan_id: u64) -> Option<i64> {
        match self.hosts.get(&incarnation) {
            Some(host) => *self.offsets.get(host)?.get(&scan_id)?,
            None => Some(0),
        }
    }

    /// The sample as a process has it on its host; `None` when its clock in that scan is not known.
    pub(crate) fn to_local<S: Sample>(&self, incarnation: u32, sample: &S) -> Option<S> {
        Some(moved(sample, self.offset_ns(incarnation, sample.header().scan_id)?.checked_neg()?))
    }

    /// A sample that a process has published, as it was recorded; `None` when its clock in that scan is not known.
    pub(crate) fn to_common<S: Sample>(&self, incarnation: u32, sample: &S) -> Option<S> {
        Some(moved(sample, self.offset_ns(incarnation, sample.header().scan_id)?))
    }
}

/// The sample with all its times moved.
pub(crate) fn moved<S: Sample>(sample: &S, by_ns: i64) -> S {
    let mut moved = *sample;
    if by_ns != 0 {
        shift_times(S::TYPE, bytemuck::bytes_of_mut(&mut moved), by_ns);
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::Pose;

    #[test]
    fn times_are_mapped_by_the_offset_of_the_scan_and_only_if_there_is_one() {
        let mut clocks = Clocks::default();
        clocks.hosts.insert(8, "lab".to_owned());
        clocks.add(&ClockOffset::new("lab", 3, 9_000, -500, 1));
        let mut pose = Pose { predicted_ns: 7_000, ..Pose::default() };
        pose.header.scan_id = 3;
        let local = clocks.to_local(8, &pose).unwrap();
        assert_eq!(local.predicted_ns, 7_500);
        assert_eq!(clocks.to_common(8, &local), Some(pose));
        assert_eq!(clocks.to_local(9, &pose), Some(pose), "it runs where the recorder is");
        pose.header.scan_id = 4;
        assert_eq!(clocks.to_local(8, &pose), None, "nothing is known of that scan");
        // Its link was started again within the scan.
        clocks.add(&ClockOffset::new("lab", 3, 9_100, -500, 1));
        assert!(clocks.to_common(8, &local).is_some());
        clocks.add(&ClockOffset::new("lab", 3, 9_200, -501, 1));
        assert_eq!(clocks.to_common(8, &local), None);
    }

    #[test]
    fn an_offset_that_has_no_opposite_is_not_known() {
        let mut clocks = Clocks::default();
        clocks.hosts.insert(8, "lab".to_owned());
        let mut offset = ClockOffset::new("lab", 3, 0, 0, 1);
        (offset.common_ns, offset.host_ns) = (1 << 63, 0);
        clocks.add(&offset);
        let mut pose = Pose::default();
        pose.header.scan_id = 3;
        assert_eq!(clocks.to_local(8, &pose), None);
    }
}
