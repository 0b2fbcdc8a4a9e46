//! Two results of `bench latency --json`, stretch by stretch.

use std::path::Path;

use console::exit::Failure;
use console::note;
use console::user_file::{self, DATA_BYTES};
use figures::difference::{DifferenceEstimate, stretches};
use report::latency::STAGES;
use serde::Deserialize;
use serde_json::Value;

use super::verdict::Verdict;
use commands::bench::latency::intervals;

/// The part of a result that is compared.
#[derive(Debug, Deserialize)]
struct LatencyRun {
    profile: Option<String>,
    rate_hz: f64,
    compute: String,
    payload_bytes: Option<u64>,
    interval_scans: u64,
    intervals: Vec<String>,
}

/// A number of bytes; a measurement with the built-in stages has none.
fn shown(bytes: Option<u64>) -> String {
    bytes.map_or("none".to_owned(), |bytes| bytes.to_string())
}

/// Compares the figures `metrics` of two files. A figure is left out, with a note, when the runs are too short for it.
///
/// # Errors
/// Files that are no results, that were made with different arguments, or that lack a figure; exit code 2.
pub(super) fn compare(files: [&Path; 2], metrics: &[String]) -> anyhow::Result<Vec<Verdict>> {
    let [(a, a_json), (b, b_json)] = [read(files[0])?, read(files[1])?];
    let names = [files[0].display(), files[1].display()];
    let same = [
        ("rate_hz", a.rate_hz.to_string(), b.rate_hz.to_string()),
        ("compute", a.compute.clone(), b.compute.clone()),
        ("payload_bytes", shown(a.payload_bytes), shown(b.payload_bytes)),
        ("interval_scans", a.interval_scans.to_string(), b.interval_scans.to_string()),
    ];
    if let Some((key, one, other)) = same.iter().find(|(_, one, other)| one != other) {
        return Err(Failure::bad_input(format!(
            "{} and {} can't be compared: {key} is {one} and {other}; make both with the same arguments",
            names[0], names[1]
        )));
    }
    if let (Some(of_a), Some(of_b)) = (&a.profile, &b.profile)
        && of_a != of_b
    {
        note!("A was built with the profile `{of_a}`, B with `{of_b}`: the difference includes that");
    }
    let mut verdicts = Vec::new();
    for metric in metrics {
        let (series, quantile) = series_of(metric).ok_or_else(|| {
            Failure::bad_input(format!(
                "--metric {metric} is not allowed for files: scan_to_actuation_us, scan_to_actuation_corrected_us, \
                 transport_us or stages_us.ROLE, with .p50, .p90 or .p99"
            ))
        })?;
        let Some(difference) = difference(&a, &b, files, series, quantile)? else {
            note!("{metric}: left out, too few scans; run longer");
            continue;
        };
        let whole = [&a_json, &b_json].map(|json| super::figure(json, metric).unwrap_or(f64::NAN));
        let mut verdict = Verdict::new(metric, whole, &difference, 1);
        if !difference.is_seen()
            && let Some((part, found)) = steadier_part(&a, &b, files, metric, &difference)?
        {
            verdict.settle_with(&part, &found);
        }
        verdicts.push(verdict);
    }
    if verdicts.is_empty() {
        return Err(Failure::bad_input(format!(
            "{} and {}: too few scans to compare {}; run longer",
            names[0],
            names[1],
            metrics.join(", ")
        )));
    }
    Ok(verdicts)
}

/// The difference of a quantile of a series [us]; `None` for too few scans.
fn difference(
    a: &LatencyRun,
    b: &LatencyRun,
    files: [&Path; 2],
    series: &str,
    quantile: f64,
) -> anyhow::Result<Option<DifferenceEstimate>> {
    let histograms = |run: &LatencyRun, file: &Path| {
        intervals::read(&run.intervals, series).ok_or_else(|| {
            Failure::bad_input(format!("{}: intervals: not the lines of a HdrHistogram log", file.display()))
        })
    };
    let found = stretches(&histograms(a, files[0])?, &histograms(b, files[1])?, quantile);
    Ok(found.map(|difference| difference.scaled(1e-3)))
}

/// The part of a figure of the whole chain with a visible difference, or else with the smallest visible one; `None`
/// when no part varies less than the whole, or the figure is a part itself.
fn steadier_part(
    a: &LatencyRun,
    b: &LatencyRun,
    files: [&Path; 2],
    metric: &str,
    whole: &DifferenceEstimate,
) -> anyhow::Result<Option<(String, DifferenceEstimate)>> {
    let Some((_, figure)) = metric.rsplit_once('.').filter(|(key, _)| key.starts_with("scan_to_")) else {
        return Ok(None);
    };
    let stages = STAGES.map(|stage| format!("stages_us.{stage}.{figure}"));
    let mut best: Option<(String, DifferenceEstimate)> = None;
    for part in stages.into_iter().chain([format!("transport_us.{figure}")]) {
        let Some((series, quantile)) = series_of(&part) else { continue };
        let Some(found) = difference(a, b, files, series, quantile)? else { continue };
        let rank = |one: &DifferenceEstimate| (!one.is_seen(), one.smallest_visible);
        let varies_less = found.smallest_visible < whole.smallest_visible;
        if varies_less && best.as_ref().is_none_or(|(_, best)| rank(&found) < rank(best)) {
            best = Some((part, found));
        }
    }
    Ok(best)
}

fn read(file: &Path) -> anyhow::Result<(LatencyRun, Value)> {
    let bad = |reason: String| Failure::bad_input(format!("{}: {reason}", file.display()));
    let text = user_file::read(file, DATA_BYTES).map_err(bad)?;
    let json: Value = serde_json::from_str(&text).map_err(|error| bad(error.to_string()))?;
    let run = LatencyRun::deserialize(&json)
        .map_err(|error| bad(format!("{error}: not what `scanloop bench latency --json` prints")))?;
    Ok((run, json))
}

/// The series of the log and the quantile of a metric.
fn series_of(metric: &str) -> Option<(&str, f64)> {
    let (key, figure) = metric.rsplit_once('.')?;
    let quantile = match figure {
        "p50" => 0.5,
        "p90" => 0.9,
        "p99" => 0.99,
        _ => return None,
    };
    let name = key.strip_prefix("stages_us.").or_else(|| key.strip_suffix("_us"))?;
    intervals::NAMES.contains(&name).then_some((name, quantile))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_are_series_of_the_log() {
        assert_eq!(series_of("scan_to_actuation_us.p50"), Some(("scan_to_actuation", 0.5)));
        assert_eq!(series_of("stages_us.controller.p99"), Some(("controller", 0.99)));
        for metric in ["scan_to_actuation_us", "scan_to_actuation_us.max", "late", "stages_us.pilot.p50"] {
            assert_eq!(series_of(metric), None, "{metric}");
        }
    }

    #[test]
    fn files_that_are_none_or_do_not_belong_together_are_refused() {
        let folder = std::env::temp_dir().join(format!("scanloop-compare-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let write = |name: &str, rate: f64| {
            let path = folder.join(name);
            let json = serde_json::json!({"rate_hz": rate, "compute": "real", "interval_scans": 10, "intervals": []});
            std::fs::write(&path, json.to_string()).unwrap();
            path
        };
        let (a, b) = (write("a.json", 10.0), write("b.json", 20.0));
        let metrics = ["scan_to_actuation_us.p50".to_owned()];
        let refusal = |files: [&Path; 2]| compare(files, &metrics).unwrap_err().to_string();
        assert!(refusal([&a, &b]).contains("rate_hz is 10 and 20"), "{}", refusal([&a, &b]));
        assert!(refusal([&a, &a]).contains("too few scans"));
        std::fs::write(&b, "{}").unwrap();
        assert!(refusal([&a, &b]).contains("b.json: missing field"), "{}", refusal([&a, &b]));
        assert!(refusal([&a, &folder.join("none.json")]).contains("none.json"));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
