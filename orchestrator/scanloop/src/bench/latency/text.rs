//! The result of the bench as text.

use std::fmt::Write as _;

use figures::{Figures, Table};
use report::ScanReport;
use report::summary::counts;
use runtime::Scheduler;

use super::machine::{IdleState, Machine};
use super::results::{LatencyResults, Smallest};

/// Below this the 99.9 % are close to the largest value [scans].
const MIN_SCANS: u64 = 1000;

/// The table of a bench.
pub(crate) fn text(results: &LatencyResults) -> String {
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
    let count = results.scan_to_actuation_us.count;
    if count < MIN_SCANS {
        let _ =
            writeln!(text, "\n{count} scans are few: their 99 % and 99.9 % are close to the largest value");
    }
    text
}

fn head(results: &LatencyResults) -> Vec<(&'static str, String)> {
    let LatencyResults { machine, scans, .. } = results;
    let compute = match (results.compute, results.payload_bytes) {
        ("none", Some(bytes)) => format!("none, {bytes} bytes on each hop"),
        ("none", None) => "none, the pipeline's own samples".to_owned(),
        (name, _) => name.to_owned(),
    };
    let ScanReport { published, commanded, late, unaccounted, .. } = scans;
    let Machine { cores, busy_percent, steal_percent, .. } = machine;
    let known = |value: &Option<String>| value.clone().unwrap_or_else(|| "unknown".to_owned());
    let load_average = known(&machine.load_average.map(|load| load.to_string()));
    vec![
        ("profile", results.profile.to_owned()),
        ("rate", format!("{} Hz for {:.1} s, compute {compute}", results.rate_hz, results.duration_s)),
        (
            "scans",
            format!(
                "{published} published, {commanded} commanded, {late} late, {}, {unaccounted} unaccounted, \
                 {} complete chains",
                lost(scans),
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
        ("scheduling", scheduling(machine)),
        (
            "machine",
            format!(
                "{cores} cores of {}{}, kernel {}, clock {}",
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
                idle_states(&machine.idle_states),
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
                "processors {busy_percent:.0} % busy during the run, {steal_percent:.1} % taken by the host; \
                 load average {load_average} before"
            ),
        ),
        ("stamps", format!("{:.2} us per stage and scan", results.stamps_us_per_stage)),
        ("smallest visible", smallest(results)),
    ]
}

fn lost(scans: &ScanReport) -> String {
    match counts(scans.lost_reasons.iter()) {
        reasons if reasons.is_empty() => format!("{} lost", scans.lost),
        reasons => format!("{} lost ({reasons})", scans.lost),
    }
}

fn scheduling(machine: &Machine) -> String {
    let policy = match machine.scheduling {
        Scheduler::Other => "default",
        Scheduler::Fifo => "fifo",
    };
    let pinned = match machine.pinned_to.as_slice() {
        [] => String::new(),
        cpus => format!(", processors {cpus:?}"),
    };
    let load = match machine.busy_loops {
        0 => String::new(),
        count => format!(", {count} busy loops in parallel"),
    };
    format!("{policy}{pinned}{load}")
}

fn idle_states(states: &[IdleState]) -> String {
    let text = |state: &IdleState| {
        let off = if state.disabled { " (off)" } else { "" };
        format!("{} {} us{off}", state.name, state.exit_latency_us)
    };
    match states {
        [] => "unknown".to_owned(),
        states => states.iter().map(text).collect::<Vec<_>>().join(", "),
    }
}

fn smallest(results: &LatencyResults) -> String {
    let Smallest { p50, p99 } = results.smallest_visible_us;
    let Some(p50) = p50 else { return "the run is too short".to_owned() };
    let p99 = p99.map_or(String::new(), |p99| format!(", of {p99:.1} us in the 99 %,"));
    format!("a difference of {p50:.1} us in the median{p99} to another run like this")
}
