//! The samples of one topic.

use std::collections::BTreeMap;

use shared_types::Sample;

/// Samples of one topic in the order of the recording.
#[derive(Debug, Default)]
pub(crate) struct Lane<S> {
    pub(crate) samples: Vec<S>,
    by_scan: BTreeMap<u64, Vec<usize>>,
}

impl<S: Sample> Lane<S> {
    pub(super) fn add(&mut self, bytes: &[u8]) {
        let sample: &S = bytemuck::from_bytes(bytes);
        self.by_scan.entry(sample.header().scan_id).or_default().push(self.samples.len());
        self.samples.push(*sample);
    }

    /// The samples of a scan.
    pub(crate) fn of_scan(&self, scan_id: u64) -> impl Iterator<Item = &S> {
        self.by_scan.get(&scan_id).into_iter().flatten().map(|index| &self.samples[*index])
    }

    /// The scans with samples, in order.
    pub(crate) fn scans(&self) -> impl Iterator<Item = u64> {
        self.by_scan.keys().copied()
    }

    /// The samples of a process, by number.
    pub(crate) fn of_process(&self, incarnation: u32) -> Vec<&S> {
        let mut found: Vec<&S> =
            self.samples.iter().filter(|sample| sample.header().incarnation == incarnation).collect();
        found.sort_by_key(|sample| sample.header().sequence);
        found
    }
}
