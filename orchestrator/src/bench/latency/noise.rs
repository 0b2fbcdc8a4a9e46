//! What this machine adds to any wake-up, with nothing of ours in the way, and what a stamp costs.
//!
//! A process of its own, scheduled as the stages will be, sleeps until absolute times at the rate of the scans and
//! notes how late it wakes: what `cyclictest` does. No chain of processes can be quieter than its wake-ups, so this
//! is what figures of the chain are to be read against. Where it fails: it sees the seconds before the run only, and
//! a machine that is noisy once a minute looks quiet.

use std::process::{Command, Stdio};

use anyhow::Context;
use runtime::monotonic_ns;
use rustix::thread::{ClockId, clock_nanosleep_absolute};
use rustix::time::Timespec;
use shared_types::StageStamps;

use crate::bench::scheduling::Scheduling;
use crate::figures::Distribution;

/// Beginning of the name of this service; period and number of wake-ups follow, each after a colon.
pub(crate) const PREFIX: &str = "wake-up-noise:";
/// Longest and shortest time that is spent on it [s].
const LONGEST_S: f64 = 5.0;
const SHORTEST_S: f64 = 0.5;
/// Share of the duration of the bench that is spent on it.
const SHARE: f64 = 0.1;
/// Clock readings per stage and scan: woken, taken, computed, published.
const STAMPS: usize = 4;

/// Measures how late wake-ups are under `scheduling`, for a bench of `duration_s` at a period.
///
/// # Errors
/// When the process can't be started, or does not answer.
pub(crate) fn measure(
    period_ns: u64,
    duration_s: f64,
    scheduling: &Scheduling,
) -> anyhow::Result<Distribution> {
    let seconds = (SHARE * duration_s).clamp(SHORTEST_S, LONGEST_S);
    let count = ((seconds * 1e9 / period_ns as f64) as u64).max(5);
    let mut command = scheduling.prefix();
    command.push(std::env::current_exe().context("path of this executable")?.to_string_lossy().into_owned());
    command.extend(["service".to_owned(), format!("{PREFIX}{period_ns}:{count}")]);
    let (program, arguments) = command.split_first().context("a command")?;
    let output = Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output()
        .with_context(|| format!("{program} for the wake-up noise"))?;
    let mut late = Distribution::of_times();
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        late.record(line.parse().context("the wake-up noise")?);
    }
    anyhow::ensure!(late.count() == count, "the measurement of the wake-up noise was interrupted");
    Ok(late)
}

/// The process behind [`measure`]: prints one lateness per line [ns]; `None` when `name` asks for something else.
pub(crate) fn run(name: &str) -> Option<anyhow::Result<()>> {
    let (period, count) = name.strip_prefix(PREFIX)?.split_once(':')?;
    let (period_ns, count): (u64, usize) = (period.parse().ok()?, count.parse().ok()?);
    Some(sleep_and_print(period_ns, count))
}

fn sleep_and_print(period_ns: u64, count: usize) -> anyhow::Result<()> {
    use std::fmt::Write as _;
    let mut late_ns = Vec::with_capacity(count);
    let mut due_ns = monotonic_ns() + period_ns;
    for _ in 0..count {
        let due =
            Timespec { tv_sec: (due_ns / 1_000_000_000) as i64, tv_nsec: (due_ns % 1_000_000_000) as i64 };
        while clock_nanosleep_absolute(ClockId::Monotonic, &due).is_err() {}
        let now_ns = monotonic_ns();
        late_ns.push(now_ns.saturating_sub(due_ns));
        // A wake-up that was missed altogether has been late by that much; it is not made up for.
        due_ns += period_ns * (1 + now_ns.saturating_sub(due_ns) / period_ns);
    }
    let mut text = String::new();
    for late in late_ns {
        let _ = writeln!(text, "{late}");
    }
    print!("{text}");
    Ok(())
}

/// What the stamps of one stage cost for one scan: four readings of the clock and their places in the header [us].
pub(crate) fn stamp_cost_us() -> f64 {
    const LAPS: u32 = 20_000;
    const REPEATS: usize = 15;
    let mut header = shared_types::Header::default();
    let mut laps: Vec<u64> = (0..REPEATS)
        .map(|_| {
            let started_ns = monotonic_ns();
            for _ in 0..LAPS {
                let [woken_ns, taken_ns, computed_ns, published_ns]: [u64; STAMPS] =
                    std::array::from_fn(|_| monotonic_ns());
                let stamps = StageStamps { woken_ns, taken_ns, computed_ns, published_ns };
                *std::hint::black_box(&mut header).stage_mut(shared_types::Role::Actuator) = stamps;
            }
            monotonic_ns() - started_ns
        })
        .collect();
    laps.sort_unstable();
    laps[REPEATS / 2] as f64 * 1e-3 / f64::from(LAPS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_names_are_not_run() {
        for name in ["ekf", "wake-up-noise", "wake-up-noise:1", "wake-up-noise:a:1"] {
            assert!(run(name).is_none(), "{name}");
        }
    }

    #[test]
    fn stamps_cost_something() {
        assert!(stamp_cost_us() > 0.0);
    }
}
