//! The report of a shadow as a table for people.

use std::fmt;

use super::{ShadowReport, Timing};

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
