//! Two pictures of a run: how often each time was seen (the plot of `cyclictest`), and how often it was exceeded.

use figures::{Distribution, Figures};
use hdrhistogram::Histogram;
use report::ScanReport;
use report::latency::STAGES;
use report::picture::chart::{Chart, Curve};

use super::collector::Collector;
use super::results::LatencyResults;

/// Bins of the histogram.
const BINS: usize = 160;
/// Values above this many medians of scan to actuation are counted in the last bin.
const MEDIANS: f64 = 6.0;

/// The series of both pictures with their names, scan to actuation first.
fn series<'a>(
    collector: &'a Collector,
    noise: &'a Distribution,
) -> impl Iterator<Item = (String, &'a Histogram<u64>)> {
    let whole = [("scan to actuation", &collector.reaction), ("transport", &collector.transport)];
    let stages = STAGES.iter().map(|role| role.name()).zip(&collector.compute);
    whole
        .into_iter()
        .chain(stages)
        .chain([("wake-up noise", noise)])
        .filter(|(_, distribution)| distribution.count() > 0)
        .map(|(name, distribution)| (name.to_owned(), distribution.histogram()))
}

fn subtitle(results: &LatencyResults) -> String {
    let LatencyResults { rate_hz, compute, .. } = results;
    let ScanReport { published, late, lost, .. } = results.scans;
    let Figures { p50, p99, max, .. } = results.scan_to_actuation_us;
    format!(
        "{published} scans at {rate_hz} Hz, compute {compute}, {late} late, {lost} lost; median {p50:.0} us, \
         99 % {p99:.0} us, largest {max:.0} us"
    )
}

/// How often each time was seen.
pub(crate) fn histogram(collector: &Collector, noise: &Distribution, results: &LatencyResults) -> Chart {
    let figures = &results.scan_to_actuation_us;
    let right_us = (MEDIANS * figures.p50).clamp(1.0, figures.max.max(1.0));
    let width_ns = (right_us * 1e3 / BINS as f64).max(1.0);
    let curves = series(collector, noise)
        .map(|(name, histogram)| Curve {
            name,
            points: steps(&bins(histogram, width_ns), width_ns),
            dots: false,
        })
        .collect();
    Chart {
        title: "How often each time was seen".to_owned(),
        subtitle: subtitle(results),
        x: format!("time [us]; the last bin has all above {right_us:.0}"),
        y: "scans per bin".to_owned(),
        logarithmic: true,
        curves,
        ..Chart::default()
    }
}

/// How many values lie in each bin; the last one has all beyond.
fn bins(histogram: &Histogram<u64>, width_ns: f64) -> Vec<u64> {
    let mut bins = vec![0; BINS + 1];
    for value in histogram.iter_recorded() {
        let bin = (value.value_iterated_to() as f64 / width_ns) as usize;
        bins[bin.min(BINS)] += value.count_at_value();
    }
    bins
}

/// The outline of the bins from the first to the last that is not empty; an empty bin is drawn as half a scan.
fn steps(bins: &[u64], width_ns: f64) -> Vec<[f64; 2]> {
    let Some(first) = bins.iter().position(|&count| count > 0) else { return Vec::new() };
    let last = bins.iter().rposition(|&count| count > 0).unwrap_or(first);
    let edge = |bin: usize| bin as f64 * width_ns * 1e-3;
    let mut points = vec![[edge(first), 0.5]];
    for (bin, &count) in bins.iter().enumerate().take(last + 1).skip(first) {
        let height = (count as f64).max(0.5);
        points.extend([[edge(bin), height], [edge(bin + 1), height]]);
    }
    points.push([edge(last + 1), 0.5]);
    points
}

/// How often each time was exceeded.
pub(crate) fn exceedance(collector: &Collector, noise: &Distribution, results: &LatencyResults) -> Chart {
    let corrected = ("corrected".to_owned(), collector.corrected.histogram());
    let curves = series(collector, noise)
        .chain([corrected])
        .map(|(name, histogram)| {
            let all = histogram.len() as f64;
            let mut below = 0;
            let mut points = Vec::new();
            for value in histogram.iter_recorded() {
                let time_us = value.value_iterated_to() as f64 * 1e-3;
                points.push([time_us, (all - below as f64) / all]);
                below += value.count_at_value();
                points.push([time_us, (all - below as f64) / all]);
            }
            Curve { name, points: thinned(points), dots: false }
        })
        .collect();
    Chart {
        title: "How often each time was exceeded".to_owned(),
        subtitle: subtitle(results),
        x: "time [us], logarithmic".to_owned(),
        logarithmic_x: true,
        y: "share of scans above".to_owned(),
        logarithmic: true,
        curves,
        ..Chart::default()
    }
}

/// Leaves out points that are closer to the one before than 0.004 decades in both directions.
fn thinned(points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    let is_near = |one: f64, other: f64| (one.log10() - other.log10()).abs() < 0.004;
    let mut left: Vec<[f64; 2]> = Vec::new();
    for point in points.into_iter().filter(|point| point[1] > 0.0) {
        if left.last().is_none_or(|last| !is_near(last[0], point[0]) || !is_near(last[1], point[1])) {
            left.push(point);
        }
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;
    use report::picture::chart;

    #[test]
    fn bins_hold_every_value_and_their_outline_starts_and_ends_low() {
        let mut distribution = Distribution::of_times();
        for time_us in [1, 1, 5, 90] {
            distribution.record(time_us * 1000);
        }
        let bins = bins(distribution.histogram(), 100.0);
        assert_eq!((bins.iter().sum::<u64>(), bins[BINS]), (4, 1));
        let outline = steps(&bins, 100.0);
        assert_eq!((outline[0][1], outline.last().unwrap()[1]), (0.5, 0.5));
        assert!(outline.iter().any(|point| point[1] == 2.0));
        assert!(steps(&[0; 4], 1.0).is_empty());
    }

    #[test]
    fn both_pictures_are_drawn_even_of_nothing() {
        let collector = Collector::new(1_000_000, 10);
        let noise = Distribution::of_times();
        for chart in [histogram, exceedance].map(|make| make(&collector, &noise, &LatencyResults::default()))
        {
            assert!(chart::draw(&chart).unwrap().contains(&chart.title));
        }
    }
}
