//! Properties of this machine that latencies depend on; null where the kernel does not tell.

use std::path::Path;

use runtime::{Realtime, Scheduler};
use serde::Serialize;

/// Properties of the machine.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct Machine {
    /// Release of the kernel.
    pub kernel: Option<String>,
    /// Whether it is a real-time kernel.
    pub realtime_kernel: bool,
    /// Processors that may be used.
    pub cores: usize,
    /// Model of the processor.
    pub cpu_model: Option<String>,
    /// Clock of the first processor [MHz].
    pub cpu_mhz: Option<f64>,
    /// Whether the machine is a virtual one.
    pub virtual_machine: bool,
    /// Frequency governor of the first processor; null where the frequency is not the kernel's.
    pub governor: Option<String>,
    /// Timer slack of the processes under the default policy [ns].
    pub timer_slack_ns: u64,
    /// Idle states of the first processor, deepest last.
    pub idle_states: Vec<IdleState>,
    /// Driver and governor of idling.
    pub idle_driver: Option<String>,
    /// Limit for the exit latency of idle states that a process requested [us]; null when it can't be read.
    pub cpu_dma_latency_us: Option<i32>,
    /// Source of the clock.
    pub clocksource: Option<String>,
    /// How many of the listed processor vulnerabilities are mitigated, open, or do not apply.
    pub mitigations: Option<String>,
    /// Load average over one minute when the bench began.
    pub load_average: Option<f64>,
    /// Policy that the machine grants the processes.
    pub scheduling: Scheduler,
    /// Processors that the machine grants the processes; empty for all.
    pub pinned_to: Vec<usize>,
    /// Number of busy loops during the run.
    pub busy_loops: usize,
    /// Share of the processors' time that was used during the run, by any process [%].
    pub busy_percent: f64,
    /// Share of the processors' time that the host gave to other virtual machines [%].
    pub steal_percent: f64,
}

/// One idle state of a processor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct IdleState {
    /// Its name.
    pub name: String,
    /// Time to leave it [us].
    pub exit_latency_us: u64,
    /// Whether it is switched off.
    pub disabled: bool,
}

impl Machine {
    /// The properties now, with the settings that the machine `granted`; [`Machine::note_use`] adds the shares of time.
    pub(crate) fn inspect(granted: &Realtime, busy_loops: usize) -> Self {
        let processors = read("/proc/cpuinfo").unwrap_or_default();
        let of_cpu = |key: &str| {
            let line = processors.lines().find(|line| line.starts_with(key))?;
            line.split_once(':').map(|(_, value)| value.trim().to_owned())
        };
        let cpu = Path::new("/sys/devices/system/cpu");
        let idle = |name: &str| read(cpu.join("cpuidle").join(name));
        Self {
            kernel: read("/proc/sys/kernel/osrelease"),
            realtime_kernel: read("/sys/kernel/realtime").is_some_and(|text| text == "1"),
            cores: rustix::thread::sched_getaffinity(None).map_or(0, |set| set.count() as usize),
            cpu_model: of_cpu("model name"),
            cpu_mhz: of_cpu("cpu MHz").and_then(|text| text.parse().ok()),
            virtual_machine: of_cpu("flags")
                .is_some_and(|flags| flags.split_whitespace().any(|flag| flag == "hypervisor")),
            governor: read(cpu.join("cpu0/cpufreq/scaling_governor")),
            timer_slack_ns: granted.timer_slack_ns,
            idle_states: idle_states(&cpu.join("cpu0/cpuidle")),
            idle_driver: idle("current_driver").map(|driver| {
                [Some(driver), idle("current_governor")].map(Option::unwrap_or_default).join("/")
            }),
            cpu_dma_latency_us: cpu_dma_latency(),
            clocksource: read("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
            mitigations: mitigations(&cpu.join("vulnerabilities")),
            load_average: read("/proc/loadavg").and_then(|text| text.split_whitespace().next()?.parse().ok()),
            scheduling: granted.scheduler,
            pinned_to: granted.cpu.clone(),
            busy_loops,
            ..Self::default()
        }
    }

    /// Sets the shares of time between two readings.
    pub(crate) fn note_use(&mut self, before: Ticks, after: Ticks) {
        let all = after.all.saturating_sub(before.all).max(1) as f64;
        self.busy_percent = 100.0 * after.busy.saturating_sub(before.busy) as f64 / all;
        self.steal_percent = 100.0 * after.steal.saturating_sub(before.steal) as f64 / all;
    }
}

/// Time of all processors since boot, in ticks of the kernel.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Ticks {
    all: u64,
    busy: u64,
    steal: u64,
}

impl Ticks {
    /// The ticks now; zeros where the kernel does not tell.
    pub(crate) fn now() -> Self {
        read("/proc/stat").map_or_else(Self::default, |text| Self::parse(&text))
    }

    /// From the first line: `cpu user nice system idle iowait irq softirq steal`.
    fn parse(text: &str) -> Self {
        let line = text.lines().next().unwrap_or_default();
        let numbers: Vec<u64> =
            line.split_whitespace().skip(1).take(8).map(|text| text.parse().unwrap_or(0)).collect();
        let at = |index: usize| numbers.get(index).copied().unwrap_or(0);
        let all = numbers.iter().sum();
        Self { all, busy: at(0) + at(1) + at(2) + at(5) + at(6), steal: at(7) }
    }
}

fn read(path: impl AsRef<Path>) -> Option<String> {
    let text = std::fs::read_to_string(path).ok()?.trim().to_owned();
    (!text.is_empty()).then_some(text)
}

/// The idle states of a processor in its folder `cpuidle`, deepest last.
pub(crate) fn idle_states(folder: &Path) -> Vec<IdleState> {
    (0..16)
        .map_while(|index| {
            let state = folder.join(format!("state{index}"));
            Some(IdleState {
                name: read(state.join("name"))?,
                exit_latency_us: read(state.join("latency"))?.parse().ok()?,
                disabled: read(state.join("disable")).is_some_and(|text| text != "0"),
            })
        })
        .collect()
}

fn cpu_dma_latency() -> Option<i32> {
    let bytes: [u8; 4] = std::fs::read("/dev/cpu_dma_latency").ok()?.try_into().ok()?;
    Some(i32::from_ne_bytes(bytes))
}

fn mitigations(folder: &Path) -> Option<String> {
    let entries: Vec<String> =
        std::fs::read_dir(folder).ok()?.flatten().filter_map(|entry| read(entry.path())).collect();
    let count = |start: &str| entries.iter().filter(|text| text.starts_with(start)).count();
    let [mitigated, vulnerable, unaffected] = ["Mitigation", "Vulnerable", "Not affected"].map(count);
    Some(format!("{mitigated} worked around, {vulnerable} vulnerable, {unaffected} not affected"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_machine_has_a_kernel_a_processor_and_a_clock() {
        let machine = Machine::inspect(&Realtime::default(), 2);
        assert!(machine.cores >= 1 && machine.busy_loops == 2);
        assert!(machine.kernel.is_some() && machine.load_average.is_some());
    }

    #[test]
    fn shares_of_time_are_those_between_two_readings() {
        let before = Ticks::parse("cpu 100 0 50 800 0 0 0 50 0 0\ncpu0 1 1 1 1");
        let after = Ticks::parse("cpu 120 0 60 860 0 0 0 60 0 0");
        let mut machine = Machine::default();
        machine.note_use(before, after);
        assert_eq!((machine.busy_percent, machine.steal_percent), (30.0, 10.0));
    }
}
