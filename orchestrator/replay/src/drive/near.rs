//! A recorded drive of any length, of which only the time around a scan is in memory.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use bytemuck::bytes_of;
use console::exit::Failure;
use recording::read::{RECORDING, metadata};
use recording::{LogLine, Recording};
use shared_types::{Actuation, ClockOffset, Directive, Scan, Topic};

use super::ReplayDrive;
use crate::why::{NEW_SCANS, decided_at};

/// So much is read before and after a scan [ns]; four times as much before it until that is enough.
const SPAN_NS: u64 = 20_000_000_000;
/// A process is led from a recorded state of it, about one a second: one is within this time before a scan [ns].
const LEAD_NS: u64 = 5_000_000_000;
/// What is answered about a scan needs so much after it [ns].
const AFTER_NS: u64 = 2_000_000_000;

/// A recording that is open, with the time around one scan in memory.
pub struct NearDrive {
    path: PathBuf,
    recording: Recording,
    /// Where each chunk begins in the file, and the times of its samples [ns].
    chunks: Vec<(u64, Range<u64>)>,
    /// When each scan was recorded [ns].
    scans: BTreeMap<u64, u64>,
    /// The newest scan that was answered.
    answered: u64,
    /// What is small, and counts from its time on.
    directives: Vec<(u64, Directive)>,
    clocks: Vec<(u64, ClockOffset)>,
    lines: Vec<LogLine>,
    window: Option<(Range<u64>, ReplayDrive)>,
}

impl NearDrive {
    /// Opens a recording of one drive, and finds its scans. Of one that `is_growing` the end may be missing.
    ///
    /// # Errors
    /// A file that can't be read, and several drives that were joined; exit code 2.
    pub fn open(path: &Path, is_growing: bool) -> anyhow::Result<Self> {
        let mut recording = Recording::open(path)?;
        if is_growing {
            recording = recording.growing();
        }
        let (mut chunks, mut scans) = (Vec::<(u64, Range<u64>)>::new(), BTreeMap::new());
        let (mut directives, mut clocks, mut answered) = (Vec::new(), Vec::new(), 0);
        recording.samples(|_, sample| {
            let log_ns = sample.log_ns;
            match chunks.last_mut().filter(|(at, _)| *at == sample.chunk_at) {
                Some((_, times)) => *times = times.start.min(log_ns)..times.end.max(log_ns),
                None => chunks.push((sample.chunk_at, log_ns..log_ns)),
            }
            match sample.topic {
                Topic::Scan => {
                    let scan: &Scan = bytemuck::from_bytes(sample.bytes);
                    scans.entry(scan.header.scan_id).or_insert(log_ns);
                }
                Topic::Actuation => {
                    let actuation: &Actuation = bytemuck::from_bytes(sample.bytes);
                    answered = answered.max(actuation.header.scan_id);
                }
                Topic::Directive => directives.push((log_ns, *bytemuck::from_bytes(sample.bytes))),
                Topic::Clock => clocks.push((log_ns, *bytemuck::from_bytes(sample.bytes))),
                _ => {}
            }
            Ok(())
        })?;
        if recording.files().len() > 1 {
            return Err(ReplayDrive::joined(path));
        }
        let path = path.to_owned();
        let lines = recording.take_lines();
        Ok(Self { path, recording, chunks, scans, answered, directives, clocks, lines, window: None })
    }

    /// Its file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Random id of the run that was recorded.
    pub fn run_id(&self) -> &str {
        metadata(self.recording.contents(), RECORDING, "run_id").unwrap_or_default()
    }

    /// Its first and its last scan.
    pub fn span(&self) -> Option<(u64, u64)> {
        Some((*self.scans.first_key_value()?.0, *self.scans.last_key_value()?.0))
    }

    /// Whether it has all of a scan: the next one was answered, or was not for long.
    pub fn has_all_of(&self, scan_id: u64) -> bool {
        let (next, later) = (scan_id.saturating_add(1), scan_id.saturating_add(NEW_SCANS));
        self.has_scan(scan_id) && (self.answered >= next || self.has_scan(later))
    }

    /// Whether it has a scan.
    pub fn has_scan(&self, scan_id: u64) -> bool {
        self.scans.contains_key(&scan_id)
    }

    /// The drive around a scan: with the scan in which its stop was decided, a state of each process before that, and some
    /// scans after it.
    ///
    /// # Errors
    /// A scan that the recording does not have, and a file without the settings of a drive; exit code 2.
    pub fn near(&mut self, scan_id: u64) -> anyhow::Result<&ReplayDrive> {
        let Some(at_ns) = self.scans.get(&scan_id).copied() else {
            let (first, last) = self.span().unwrap_or_default();
            let reason = format!("scan {scan_id} is not in it: it has the scans {first} to {last}");
            return Err(Failure::bad_input(format!("{}: {reason}", self.path.display())));
        };
        let mut before_ns = SPAN_NS;
        while !self.holds(scan_id, at_ns) {
            let times = at_ns.saturating_sub(before_ns)..at_ns.saturating_add(SPAN_NS);
            self.window = Some((times.clone(), self.read(times)?));
            before_ns = before_ns.saturating_mul(4);
        }
        self.window.as_ref().map(|(_, drive)| drive).ok_or_else(|| anyhow::anyhow!("nothing was read"))
    }

    /// Whether all that an answer about a scan needs is in memory.
    fn holds(&self, scan_id: u64, at_ns: u64) -> bool {
        let Some((times, drive)) = &self.window else { return false };
        let (first_ns, last_ns) = (self.chunks[0].1.start, at_ns.saturating_add(AFTER_NS));
        let end_ns = self.chunks.last().map_or(0, |(_, times)| times.end);
        let needed_ns = |from_ns: u64| from_ns.saturating_sub(LEAD_NS).max(first_ns);
        if times.start > needed_ns(at_ns) || times.end < last_ns.min(end_ns) {
            return false;
        }
        let decided_ns = self.scans.get(&decided_at(drive, scan_id)).copied();
        times.start <= needed_ns(decided_ns.unwrap_or(at_ns))
    }

    fn read(&mut self, wanted: Range<u64>) -> anyhow::Result<ReplayDrive> {
        let mut drive = ReplayDrive { path: self.path.clone(), ..ReplayDrive::default() };
        for (log_ns, directive) in &self.directives {
            drive.add(Topic::Directive, *log_ns, bytes_of(directive));
        }
        for (log_ns, clock) in &self.clocks {
            drive.add(Topic::Clock, *log_ns, bytes_of(clock));
        }
        let is_wanted = |times: &Range<u64>| times.start <= wanted.end && times.end >= wanted.start;
        for (at, _) in self.chunks.iter().filter(|(_, times)| is_wanted(times)) {
            self.recording.chunk(*at, |sample| {
                if !matches!(sample.topic, Topic::Directive | Topic::Clock) {
                    drive.add(sample.topic, sample.log_ns, sample.bytes);
                }
            })?;
        }
        drive.lines = self.lines.iter().filter(|line| wanted.contains(&line.log_ns)).cloned().collect();
        let refuse = |reason: String| Failure::bad_input(format!("{}: {reason}", self.path.display()));
        drive.note_contents(self.recording.contents(), &refuse)?;
        Ok(drive)
    }
}
