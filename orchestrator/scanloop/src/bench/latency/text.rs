//! What the bench found, for people.

use std::fmt::Write as _;

use figures::{Figures, Table};

use super::results::Results;

/// Shortest run whose 99.9 % mean something [scans].
const ENOUGH: u64 = 1000;

/// The table of a bench.
pub(crate) fn text(results: &Results) -> String {
    let mut text = String::new();
    for (name, value) in head(results) {
        let _ = writeln!(text, "{name:<18} {value}");
    }
    let mut table = Table::of_numbers("latency [us]", &["p50", "p90", "p99", "p99.9", "max"]);
    let hops = &results.hops_us;
    let stages = &results.stages_us;
    let rows: [(&str, &Figures); 14] = [
        ("scan to actuation", &results.scan_to_actuation_us),
        ("  corrected", &results.scan_to_actuation_corrected_us),
        ("  transport", &results.transport_us),
        ("    to estimator", &hops.estimator),
        ("    to obstacles", &hops.obstacles),
        ("    to controller", &hops.controller),
        ("    to actuator", &hops.actuator),
        ("  estimator", &stages.estimator),
        ("  obstacles", &stages.obstacles),
        ("  controller", &stages.controller),
        ("  actuator", &stages.actuator),
        ("age of the data", &results.data_age_us),
        ("robot woke late", &results.robot_lateness_us),
        ("wake-up noise", &results.wake_up_noise_us),
    ];
    for (name, figures) in rows {
        let values = [figures.p50, figures.p90, figures.p99, figures.p999, figures.max];
        let shown = |value| if figures.count == 0 { "-".to_owned() } else { format!("{value:.1}") };
        table.row(std::iter::once(name.to_owned()).chain(values.map(shown)));
    }
    let _ = write!(text, "\n{table}");
    if results.scan_to_actuation_us.count < ENOUGH {
        let _ = writeln!(
            text,
            "\n{} scans are few: their 99 % and 99.9 % are close to the largest value",
            results.scan_to_actuation_us.count
        );
    }
    text
}

fn head(results: &Results) -> Vec<(&'static str, String)> {
    let machine = &results.machine;
    let compute = match (results.compute, results.payload_bytes) {
        ("none", Some(bytes)) => format!("none, {bytes} bytes on each hop"),
        ("none", None) => "none, the pipeline's own samples".to_owned(),
        (name, _) => name.to_owned(),
    };
    let mut lost = format!("{} lost", results.lost);
    if !results.lost_reasons.is_empty() {
        let reasons: Vec<String> = results
            .lost_reasons
            .iter()
            .map(|(reason, count)| format!("{count} {}", reason.replace('_', " ")))
            .collect();
        let _ = write!(lost, " ({})", reasons.join(", "));
    }
    let known = |value: &Option<String>| value.clone().unwrap_or_else(|| "unknown".to_owned());
    let idle: Vec<String> = machine
        .idle_states
        .iter()
        .map(|state| {
            let off = if state.disabled { " (off)" } else { "" };
            format!("{} {} us{off}", state.name, state.exit_latency_us)
        })
        .collect();
    vec![
        ("profile", results.profile.to_owned()),
        ("rate", format!("{} Hz for {:.1} s, compute {compute}", results.rate_hz, results.duration_s)),
        (
            "scans",
            format!(
                "{} published, {} commanded, {} late, {lost}, {} unaccounted, {} complete chains",
                results.published,
                results.commanded,
                results.late,
                results.unaccounted,
                results.complete_chains
            ),
        ),
        (
            "samples",
            match results.residual {
                0 => "all accounted for".to_owned(),
                residual => format!("{residual} unaccounted: {}", results.faults.join("; ")),
            },
        ),
        (
            "scheduling",
            format!(
                "{}{}{}",
                match machine.scheduling {
                    runtime::Scheduler::Other => "default",
                    runtime::Scheduler::Fifo => "fifo",
                },
                match machine.pinned_to.as_slice() {
                    [] => String::new(),
                    cpus => format!(", processors {cpus:?}"),
                },
                match machine.busy_loops {
                    0 => String::new(),
                    count => format!(", {count} busy loops beside"),
                }
            ),
        ),
        (
            "machine",
            format!(
                "{} cores of {}{}, kernel {}, clock {}",
                machine.cores,
                known(&machine.cpu_model),
                if machine.virtual_machine { " (virtual)" } else { "" },
                known(&machine.kernel),
                known(&machine.clocksource)
            ),
        ),
        (
            "power",
            format!(
                "governor {}, idle states {}, cpu_dma_latency {}, timer slack {} us",
                known(&machine.governor),
                if idle.is_empty() { "unknown".to_owned() } else { idle.join(", ") },
                machine.cpu_dma_latency_us.map_or("unknown".to_owned(), |us| match us {
                    2_000_000_000.. => "not asked for".to_owned(),
                    us => format!("{us} us"),
                }),
                machine.timer_slack_ns as f64 * 1e-3
            ),
        ),
        (
            "use",
            format!(
                "processors {:.0} % busy during the run, {:.1} % taken by the host; load average {} before",
                machine.busy_percent,
                machine.steal_percent,
                machine.load_average.map_or("unknown".to_owned(), |load| load.to_string())
            ),
        ),
        ("stamps", format!("{:.2} us per stage and scan", results.stamps_us_per_stage)),
        ("smallest visible", smallest(results)),
    ]
}

fn smallest(results: &Results) -> String {
    match results.smallest_visible_us.p50 {
        Some(p50) => format!(
            "a difference of {p50:.1} us in the median{} to another run like this",
            results
                .smallest_visible_us
                .p99
                .map_or(String::new(), |p99| format!(", of {p99:.1} us in the 99 %,"))
        ),
        None => "the run is too short to say".to_owned(),
    }
}
