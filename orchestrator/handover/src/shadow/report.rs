//! The report of a shadow, and its table for people.

use std::fmt;

use serde::{Deserialize, Serialize};

/// How a shadow ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ShadowOutcome {
    /// It ran as long as asked.
    #[default]
    Completed,
    /// It was ended early on request.
    Interrupted,
    /// The run ended first.
    RunEnded,
    /// The process ended by itself, or could not be started.
    Died,
    /// It had no output in the last second, or never.
    Silent,
}

impl ShadowOutcome {
    /// The name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Completed => "completed",
            Self::Interrupted => "interrupted",
            Self::RunEnded => "run ended",
            Self::Died => "died",
            Self::Silent => "silent",
        }
    }

    /// Whether the process ran to the end.
    pub const fn is_good(self) -> bool {
        matches!(self, Self::Completed | Self::Interrupted | Self::RunEnded)
    }
}

/// The report of a shadow, `shadow --json`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ShadowReport {
    /// Name of the role.
    pub role: String,
    /// Implementation or command of the live process.
    pub live: String,
    /// Implementation or command of the shadow.
    pub shadow: String,
    /// How it ended.
    pub outcome: ShadowOutcome,
    /// Why it ended so; empty when all went as asked.
    pub reason: String,
    /// Scans that the live process answered in this time.
    pub scans: u64,
    /// Of these, answered by the shadow.
    pub answered: u64,
    /// `answered / scans`.
    pub answered_share: f64,
    /// Answered by the shadow later than half a period (3 ms at least) after the scan.
    pub late: u64,
    /// Outputs that readers would drop: wrong layout, numbers that are not finite, impossible values.
    pub invalid: u64,
    /// Outputs after the first for a scan, including those that were overwritten before they could be read.
    pub repeated: u64,
    /// Scans on which both gave a valid output.
    pub compared: u64,
    /// Of these, scans on which only one of them drove.
    pub kind_differs: u64,
    /// Shadow minus live, quantity by quantity.
    pub differences: Vec<QuantityDifference>,
    /// From the publication of the scan to that of the output [ms].
    pub reaction_ms: Timing,
    /// From the inputs to the result [ms].
    pub compute_ms: Timing,
}

/// One quantity, shadow minus live.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct QuantityDifference {
    /// What is compared.
    pub quantity: String,
    /// Unit of all numbers here.
    pub unit: String,
    /// Mean difference.
    pub mean: f64,
    /// 95 % interval of the mean; nothing with fewer than 20 scans.
    pub mean_interval: Option<[f64; 2]>,
    /// Largest magnitude.
    pub max_abs: f64,
}

/// How long both took.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Timing {
    /// Median of the live process.
    pub live_p50: f64,
    /// 99th percentile of the live process.
    pub live_p99: f64,
    /// Median of the shadow.
    pub shadow_p50: f64,
    /// 99th percentile of the shadow.
    pub shadow_p99: f64,
    /// Shadow over live, medians.
    pub ratio_p50: f64,
    /// 95 % interval of the ratio of the medians; nothing with fewer than 20 scans.
    pub ratio_p50_interval: Option<[f64; 2]>,
    /// Shadow over live, 99th percentiles.
    pub ratio_p99: f64,
    /// 95 % interval of the ratio of the 99th percentiles.
    pub ratio_p99_interval: Option<[f64; 2]>,
}

impl fmt::Display for ShadowReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { role, live, shadow, scans, answered, .. } = self;
        let because = if self.reason.is_empty() { String::new() } else { format!(": {}", self.reason) };
        writeln!(formatter, "{role}: {shadow} in the shadow of {live}, {}{because}", self.outcome.name())?;
        writeln!(
            formatter,
            "scans {scans}, answered {answered} ({:.1} %), late {}, invalid {}, repeated {}, other kind {}",
            100.0 * self.answered_share,
            self.late,
            self.invalid,
            self.repeated,
            self.kind_differs
        )?;
        let heading = ["shadow minus live", "mean", "95 % interval", "largest"];
        let [quantity, mean, interval, largest] = heading;
        writeln!(formatter, "\n{quantity:<26}{mean:>12}  {interval:<26}{largest:>12}")?;
        for difference in &self.differences {
            let unit =
                if difference.unit.is_empty() { String::new() } else { format!(" [{}]", difference.unit) };
            writeln!(
                formatter,
                "{:<26}{:>12.6}  {:<26}{:>12.6}",
                format!("{}{unit}", difference.quantity),
                difference.mean,
                ends(difference.mean_interval, 6),
                difference.max_abs
            )?;
        }
        let [time, live, shadow] = ["time [ms]", "live", "shadow"];
        writeln!(formatter, "\n{time:<26}{live:>12}{shadow:>12}  ratio, 95 % interval")?;
        rows(formatter, "reaction", &self.reaction_ms)?;
        rows(formatter, "compute", &self.compute_ms)
    }
}

fn rows(formatter: &mut fmt::Formatter<'_>, name: &str, timing: &Timing) -> fmt::Result {
    let quantiles = [
        ("p50", timing.live_p50, timing.shadow_p50, timing.ratio_p50, timing.ratio_p50_interval),
        ("p99", timing.live_p99, timing.shadow_p99, timing.ratio_p99, timing.ratio_p99_interval),
    ];
    for (quantile, live, shadow, ratio, interval) in quantiles {
        let name = format!("{name} {quantile}");
        writeln!(formatter, "{name:<26}{live:>12.3}{shadow:>12.3}  {ratio:.2} {}", ends(interval, 2))?;
    }
    Ok(())
}

fn ends(interval: Option<[f64; 2]>, digits: usize) -> String {
    interval.map_or_else(
        || "(too few scans)".to_owned(),
        |[low, high]| format!("[{low:.digits$}, {high:.digits$}]"),
    )
}
