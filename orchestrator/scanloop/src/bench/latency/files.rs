//! The files of a bench: `report.json`, `latency.hlog`, `.hgrm` of both series, two pictures and the trace.

use console::out_folder::OutFolder;
use figures::Distribution;
use hdrhistogram::Histogram;
use report::picture::chart;
use std::fmt::Write as _;

use super::collector::Collector;
use super::results::LatencyResults;
use super::{pictures, trace};

/// The names of all files.
pub(crate) const NAMES: [&str; 7] = [
    "report.json",
    "latency.hlog",
    "scan_to_actuation.hgrm",
    "scan_to_actuation_corrected.hgrm",
    "histogram.svg",
    "ccdf.svg",
    "trace.json",
];

/// Writes all files into a folder.
///
/// # Errors
/// The first error of the file system, with the file.
pub(crate) fn write(
    files: &OutFolder,
    results: &LatencyResults,
    collector: &Collector,
    noise: &Distribution,
) -> anyhow::Result<()> {
    let texts = [
        serde_json::to_string_pretty(results)? + "\n",
        log(results),
        percentiles(collector.reaction.histogram()),
        percentiles(collector.corrected.histogram()),
        chart::draw(&pictures::histogram(collector, noise, results))?,
        chart::draw(&pictures::exceedance(collector, noise, results))?,
        trace::text(&collector.stored()),
    ];
    NAMES.iter().zip(texts).try_for_each(|(name, text)| files.write(name, text.as_bytes()).map(drop))
}

/// A HdrHistogram log: all series of the stretches of the run, with their names as tags.
fn log(results: &LatencyResults) -> String {
    let mut text = String::from(
        "#[Histogram log format version 1.3]\n\
         #[Times in nanoseconds, start and length of intervals in seconds since the first scan]\n\
         \"StartTimestamp\",\"Interval_Length\",\"Interval_Max\",\"Interval_Compressed_Histogram\"\n",
    );
    for line in &results.intervals {
        let _ = writeln!(text, "{line}");
    }
    text
}

/// The percentile distribution as HdrHistogram's own tools print it [us].
fn percentiles(histogram: &Histogram<u64>) -> String {
    let mut text =
        format!("{:>12} {:>14} {:>10} {:>14}\n\n", "Value", "Percentile", "TotalCount", "1/(1-Percentile)");
    let mut total = 0;
    for step in histogram.iter_quantiles(5) {
        total += step.count_since_last_iteration();
        let (value, share) = (step.value_iterated_to() as f64 * 1e-3, step.quantile_iterated_to());
        let _ = if share < 1.0 {
            writeln!(text, "{value:>12.3} {share:>2.12} {total:>10} {:>14.2}", 1.0 / (1.0 - share))
        } else {
            writeln!(text, "{value:>12.3} {share:>2.12} {total:>10}")
        };
    }
    let _ = writeln!(
        text,
        "#[Mean    = {:>12.3}, StdDeviation   = {:>12.3}]\n#[Max     = {:>12.3}, Total count    = {:>12}]\n\
         #[Buckets = {:>12}, SubBuckets     = {:>12}]",
        histogram.mean() * 1e-3,
        histogram.stdev() * 1e-3,
        histogram.max() as f64 * 1e-3,
        histogram.len(),
        histogram.buckets(),
        2048
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_printed_as_tools_for_histograms_expect() {
        let mut distribution = Distribution::of_times();
        for time_us in 1..=100 {
            distribution.record(time_us * 1000);
        }
        let text = percentiles(distribution.histogram());
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].starts_with("       Value     Percentile TotalCount 1/(1-Percentile)"), "{text}");
        let median: Vec<&str> =
            lines.iter().find(|line| line.contains("0.500000000000")).unwrap().split_whitespace().collect();
        assert_eq!((median[0], median[2], median[3]), ("50.015", "50", "2.00"));
        assert!(text.contains("1.000000000000        100\n"), "{text}");
        assert!(text.contains("Total count    =          100]"), "{text}");
    }
}
