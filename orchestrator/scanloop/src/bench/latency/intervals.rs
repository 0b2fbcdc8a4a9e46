//! Histograms of consecutive stretches of a run, as lines of a HdrHistogram log.
//!
//! A run is cut into about 24 stretches of equal numbers of scans. Each has one histogram per series, in
//! nanoseconds with three significant digits, written as a line of the log format V2 with the name of the series as
//! its tag. The lines are part of the JSON and of the `.hlog` file, so every tool for such logs reads them, and
//! `bench compare` needs no file of its own.

use std::time::Duration;

use base64::Engine as _;
use hdrhistogram::Histogram;
use hdrhistogram::serialization::interval_log::{
    IntervalLogIterator, IntervalLogWriterBuilder, LogEntry, Tag,
};
use hdrhistogram::serialization::{Deserializer, V2DeflateSerializer};

/// Stretches that a run is cut into, as far as it has enough scans.
pub(crate) const INTERVALS: u64 = 24;
/// Smallest number of scans of a stretch.
const MIN_SCANS: u64 = 10;
/// Longest time of the histograms; longer ones count as this [ns].
const MAX_NS: u64 = 60_000_000_000;

/// A measured time of each scan; the order is that of [`NAMES`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Series {
    /// From the publication of the scan to that of its actuation.
    ScanToActuation,
    /// The same, from when the scan was due, including lost scans.
    Corrected,
    /// Scan to actuation without compute.
    Transport,
    /// Compute of a stage, by its place in `latency::STAGES`.
    Stage(usize),
}

/// Names of the series: tags of the log.
pub const NAMES: [&str; 7] = [
    "scan_to_actuation",
    "scan_to_actuation_corrected",
    "transport",
    "estimator",
    "obstacles",
    "controller",
    "actuator",
];

impl Series {
    const fn index(self) -> usize {
        match self {
            Self::ScanToActuation => 0,
            Self::Corrected => 1,
            Self::Transport => 2,
            Self::Stage(index) => 3 + index,
        }
    }
}

/// The stretches of a run in progress.
#[derive(Debug)]
pub(crate) struct Intervals {
    scans: u64,
    histograms: [Histogram<u64>; NAMES.len()],
    first_scan: Option<u64>,
    origin_ns: u64,
    started_ns: u64,
    newest_ns: u64,
    lines: Vec<String>,
}

impl Intervals {
    /// The stretches of a run of about `expected_scans` scans.
    pub(crate) fn new(expected_scans: u64) -> Self {
        Self {
            scans: expected_scans.div_ceil(INTERVALS).max(MIN_SCANS),
            histograms: std::array::from_fn(|_| empty()),
            first_scan: None,
            origin_ns: 0,
            started_ns: 0,
            newest_ns: 0,
            lines: Vec::new(),
        }
    }

    /// Scans of a stretch.
    pub(crate) fn scans(&self) -> u64 {
        self.scans
    }

    /// Starts a scan with its due time; values recorded from now on belong to its stretch.
    pub(crate) fn scan(&mut self, scan_id: u64, due_ns: u64) {
        match self.first_scan {
            None => {
                self.first_scan = Some(scan_id);
                (self.origin_ns, self.started_ns) = (due_ns, due_ns);
            }
            Some(first) if scan_id >= first + self.scans => {
                self.newest_ns = due_ns;
                self.close();
                self.first_scan = Some(scan_id);
                self.started_ns = due_ns;
            }
            Some(_) => {}
        }
        self.newest_ns = due_ns;
    }

    /// Records a value [ns].
    pub(crate) fn record(&mut self, series: Series, value_ns: u64) {
        self.histograms[series.index()].saturating_record(value_ns);
    }

    /// The lines of all stretches. The last stretch is left out if it is shorter than half of the others.
    pub(crate) fn finish(mut self) -> Vec<String> {
        let few = 2 * self.histograms[0].len() < self.scans;
        if !few || self.lines.is_empty() {
            self.close();
        }
        self.lines
    }

    fn close(&mut self) {
        let start = Duration::from_nanos(self.started_ns.saturating_sub(self.origin_ns));
        let length = Duration::from_nanos(self.newest_ns.saturating_sub(self.started_ns));
        let mut serializer = V2DeflateSerializer::new();
        let mut text = Vec::new();
        if let Ok(mut writer) = IntervalLogWriterBuilder::new().begin_log_with(&mut text, &mut serializer) {
            for (histogram, name) in self.histograms.iter_mut().zip(NAMES) {
                // Writing to memory fails for no histogram of these bounds.
                let _ = writer.write_histogram(histogram, start, length, Tag::new(name));
                histogram.reset();
            }
        }
        let text = String::from_utf8_lossy(&text);
        self.lines.extend(text.lines().filter(|line| !line.is_empty()).map(str::to_owned));
    }
}

/// The histograms of one series, in the order of the stretches; `None` when a line is not of such a log.
pub fn read(lines: &[String], series: &str) -> Option<Vec<Histogram<u64>>> {
    let mut found = Vec::new();
    let mut deserializer = Deserializer::new();
    for line in lines {
        let text = format!("{line}\n");
        for entry in IntervalLogIterator::new(text.as_bytes()) {
            let LogEntry::Interval(interval) = entry.ok()? else { continue };
            if interval.tag()?.as_str() != series {
                continue;
            }
            let bytes =
                base64::engine::general_purpose::STANDARD.decode(interval.encoded_histogram()).ok()?;
            found.push(deserializer.deserialize(&mut bytes.as_slice()).ok()?);
        }
    }
    Some(found)
}

fn empty() -> Histogram<u64> {
    Histogram::new_with_bounds(1, MAX_NS, 3).expect("the bounds are constant and valid")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_written_is_read_back() {
        let mut intervals = Intervals::new(480);
        for scan_id in 1..=490 {
            intervals.scan(scan_id, scan_id * 1_000_000);
            intervals.record(Series::ScanToActuation, 500_000 + scan_id * 100);
            intervals.record(Series::Stage(2), 7_000);
        }
        let lines = intervals.finish();
        assert_eq!(lines.len(), 24 * NAMES.len() + NAMES.len(), "24 of 20 scans, and one of 10");
        let read = read(&lines, "scan_to_actuation").unwrap();
        assert_eq!(read.iter().map(Histogram::len).sum::<u64>(), 490);
        assert_eq!(read[0].value_at_quantile(0.5), read[0].highest_equivalent(501_000));
        assert!(lines[0].starts_with("Tag=scan_to_actuation,0.000,0.020,"), "{}", lines[0]);
        assert_eq!(super::read(&lines, "controller").unwrap()[3].len(), 20);
        assert_eq!(super::read(&lines, "transport").unwrap()[3].len(), 0);
        assert!(super::read(&["Tag=a,nonsense".to_owned()], "a").is_none());
    }

    #[test]
    fn a_short_run_has_few_stretches_and_the_rest_of_a_stretch_is_left_out() {
        let mut intervals = Intervals::new(20);
        for scan_id in 1..=24 {
            intervals.scan(scan_id, scan_id);
            intervals.record(Series::ScanToActuation, 1000);
        }
        let lines = intervals.finish();
        assert_eq!(read(&lines, "scan_to_actuation").unwrap().len(), 2, "the last four scans are none");
        let empty = Intervals::new(20).finish();
        assert_eq!(read(&empty, "scan_to_actuation").unwrap().len(), 1);
    }
}
