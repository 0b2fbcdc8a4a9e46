//! The wake-up latency of this machine, without any part of the loop, and the time that a stamp takes.
//!
//! Like `cyclictest`, a process with the settings of the stages (processors, scheduler, slice, timer slack) sleeps
//! until absolute times at the rate of the scans and notes how late it wakes. No chain of processes is quieter than
//! its wake-ups, so this is the floor for the figures of the chain. Limit: it measures only the seconds before the
//! run, so noise once a minute is missed.

use std::num::NonZeroU64;
use std::process::{Command, Stdio};

use anyhow::Context;
use console::output::data;
use figures::Distribution;
use runtime::{Realtime, monotonic_ns};
use rustix::thread::{ClockId, clock_nanosleep_absolute, set_current_timer_slack};
use rustix::time::Timespec;
use shared_types::StageStamps;
use supervision::child::this_program;

/// Prefix of the name of this service; period, number of wake-ups and timer slack follow, separated by colons.
pub(crate) const PREFIX: &str = "wake-up-noise:";
/// Longest and shortest time that is spent on it [s].
const MAX_S: f64 = 5.0;
const MIN_S: f64 = 0.5;
/// Share of the duration of the bench that is spent on it.
const SHARE: f64 = 0.1;
/// Clock readings per stage and scan: woken, taken, computed, published.
const STAMPS: usize = 4;

/// Measures how late a process with the settings `realtime` wakes, for a bench of `duration_s` at a period.
/// Also returns the settings that the machine grants; refused ones are logged when the run starts.
///
/// # Errors
/// When the process can't be started, or does not answer.
pub(crate) fn measure(
    period_ns: u64,
    duration_s: f64,
    realtime: &Realtime,
) -> anyhow::Result<(Distribution, Realtime)> {
    let seconds = (SHARE * duration_s).clamp(MIN_S, MAX_S);
    let count = ((seconds * 1e9 / period_ns as f64) as u64).max(5);
    let service = format!("{PREFIX}{period_ns}:{count}:{}", realtime.timer_slack_ns);
    let mut child = Command::new(this_program())
        .args(["service", &service])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .context("the process for the wake-up noise")?;
    let _ = realtime.apply_to(child.id());
    let granted = realtime.granted(child.id());
    // The process begins when its standard input is closed.
    drop(child.stdin.take());
    let output = child.wait_with_output().context("the process for the wake-up noise")?;
    let mut late = Distribution::of_times();
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        late.record(line.parse().context("the wake-up noise")?);
    }
    anyhow::ensure!(late.count() == count, "the measurement of the wake-up noise was interrupted");
    Ok((late, granted))
}

/// The process behind [`measure`]: prints one lateness per line [ns]; `None` when `name` asks for something else.
pub(crate) fn run(name: &str) -> Option<anyhow::Result<()>> {
    let mut numbers = name.strip_prefix(PREFIX)?.split(':');
    let mut next = || numbers.next()?.parse::<u64>().ok();
    let (period_ns, count, slack_ns) = (next()?, next()?, next()?);
    Some(sleep_and_print(period_ns, count as usize, slack_ns))
}

fn sleep_and_print(period_ns: u64, count: usize, slack_ns: u64) -> anyhow::Result<()> {
    use std::fmt::Write as _;
    std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
    set_current_timer_slack(NonZeroU64::new(slack_ns))?;
    let mut late_ns = Vec::with_capacity(count);
    let mut due_ns = monotonic_ns() + period_ns;
    for _ in 0..count {
        let due =
            Timespec { tv_sec: (due_ns / 1_000_000_000) as i64, tv_nsec: (due_ns % 1_000_000_000) as i64 };
        while clock_nanosleep_absolute(ClockId::Monotonic, &due).is_err() {}
        let now_ns = monotonic_ns();
        late_ns.push(now_ns.saturating_sub(due_ns));
        // Missed wake-ups are not made up for: their time is part of this lateness.
        due_ns += period_ns * (1 + now_ns.saturating_sub(due_ns) / period_ns);
    }
    let mut text = String::new();
    for late in late_ns {
        let _ = writeln!(text, "{late}");
    }
    data(&text)?;
    Ok(())
}

/// Time for the stamps of one stage and scan: four readings of the clock, written to the header [us].
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
        for name in ["ekf", "wake-up-noise", "wake-up-noise:1:1", "wake-up-noise:a:1:1"] {
            assert!(run(name).is_none(), "{name}");
        }
    }

    #[test]
    fn stamps_cost_something() {
        assert!(stamp_cost_us() > 0.0);
    }
}
