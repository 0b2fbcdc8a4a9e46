//! The samples of one topic.

use std::collections::BTreeMap;

use shared_types::Sample;

/// Samples of one topic in the order of the recording.
#[derive(Debug, Default)]
pub(crate) struct Lane<S> {
    pub(crate) samples: Vec<S>,
    by_scan: BTreeMap<u64, Vec<usize>>,
    /// By incarnation and sequence number.
    by_number: BTreeMap<(u32, u64), usize>,
}

impl<S: Sample> Lane<S> {
    pub(super) fn add(&mut self, bytes: &[u8]) {
        let sample: &S = bytemuck::from_bytes(bytes);
        let header = sample.header();
        // A forged number was refused by each reader in the drive too.
        if header.check_numbers().is_err() {
            return;
        }
        self.by_scan.entry(header.scan_id).or_default().push(self.samples.len());
        self.by_number.insert((header.incarnation, header.sequence), self.samples.len());
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

    /// The scans with samples up to this one, the newest first.
    pub(crate) fn scans_down_from(&self, scan_id: u64) -> impl Iterator<Item = u64> {
        self.by_scan.range(..=scan_id).rev().map(|(scan, _)| *scan)
    }

    /// The sample of a process with this number.
    pub(crate) fn of_number(&self, incarnation: u32, sequence: u64) -> Option<&S> {
        self.by_number.get(&(incarnation, sequence)).map(|index| &self.samples[*index])
    }

    /// The scan of a sample.
    pub(crate) fn scan_of(&self, (incarnation, sequence): (u32, u64)) -> Option<u64> {
        self.of_number(incarnation, sequence).map(|sample| sample.header().scan_id)
    }

    /// The samples of a process, by number.
    pub(crate) fn of_process(&self, incarnation: u32) -> impl Iterator<Item = &S> {
        self.by_number
            .range((incarnation, 0)..=(incarnation, u64::MAX))
            .map(|(_, index)| &self.samples[*index])
    }
}
