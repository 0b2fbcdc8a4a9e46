//! The processors: what a control group leaves of them, their clock, their frequency, and how deep they sleep.

use console::control_group;

use super::check::Check;
use super::root::Root;
use crate::bench::latency::machine::idle_states as list_idle_states;

/// The device by which `--realtime` keeps processors awake.
pub(super) const LATENCY_DEVICE: &str = "/dev/cpu_dma_latency";
/// Clocks that a process reads without the help of the kernel, or of a host, in less than 100 ns.
const FAST_CLOCKS: [&str; 5] =
    ["tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page", "riscv_clocksource"];
/// A processor that takes longer to wake delays each of five stages by that [us].
const SLOW_WAKE_US: u64 = 100;

/// The share of the processors that control groups allow.
pub(super) fn share(root: &Root) -> Check {
    let name = "processors";
    let Some(share) = control_group::processor_share(root.path()) else {
        return Check::ok(name, "no control group limits their time");
    };
    let processors = share.quota_us as f64 / share.period_us.max(1) as f64;
    let period_ms = share.period_us as f64 * 1e-3;
    let detail =
        format!("control group {} has {processors:.2} processors per {period_ms:.0} ms", share.group);
    if processors < 1.0 {
        let pause_ms = period_ms * (1.0 - processors);
        let detail = format!("{detail}: all processes may pause for {pause_ms:.0} ms");
        let fix = "raise `cpu.max`: `CPUQuota=` of a systemd unit, `--cpus` of a container";
        return Check::warn(name, detail, fix);
    }
    Check::ok(name, detail)
}

/// The source of the clock.
pub(super) fn clock_source(root: &Root) -> Check {
    let name = "clock_source";
    let folder = "sys/devices/system/clocksource/clocksource0";
    let Some(clock) = root.read(&format!("{folder}/current_clocksource")) else {
        return Check::ok(name, "the kernel does not tell");
    };
    if FAST_CLOCKS.contains(&clock.as_str()) {
        return Check::ok(name, clock);
    }
    let there = root.read(&format!("{folder}/available_clocksource")).unwrap_or_default();
    let better = there.split_whitespace().find(|clock| FAST_CLOCKS.contains(clock));
    let fix = match better {
        Some(better) => format!("`echo {better} > /{folder}/current_clocksource` as root"),
        None => "boot with `tsc=reliable`, if the processor has a steady counter".to_owned(),
    };
    Check::warn(name, format!("{clock}: each stamp costs a microsecond or more"), fix)
}

/// The governor of the frequency.
pub(super) fn governor(root: &Root) -> Check {
    let name = "governor";
    match root.read("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor") {
        None => Check::ok(name, "the frequency is not the kernel's"),
        Some(governor) if governor == "performance" => Check::ok(name, governor),
        Some(governor) => {
            let detail = format!("{governor}: the processors are slow when a scan comes");
            Check::warn(name, detail, "`cpupower frequency-set -g performance` as root")
        }
    }
}

/// The deepest idle state that processors may enter, and whether `--realtime` may forbid it.
pub(super) fn idle_states(root: &Root, may_forbid: bool) -> Check {
    let name = "idle_states";
    let states = list_idle_states(&root.join("sys/devices/system/cpu/cpu0/cpuidle"));
    let deepest =
        states.into_iter().filter(|state| !state.disabled).max_by_key(|state| state.exit_latency_us);
    let Some(state) = deepest else { return Check::ok(name, "the kernel lists none") };
    let detail = format!("{} takes {} us to leave", state.name, state.exit_latency_us);
    if state.exit_latency_us <= SLOW_WAKE_US {
        return Check::ok(name, detail);
    }
    let fix = match may_forbid {
        true => "`scanloop run --realtime` keeps processors awake".to_owned(),
        false => format!("let this user write to {LATENCY_DEVICE}, for `scanloop run --realtime`"),
    };
    Check::warn(name, detail, fix)
}

#[cfg(test)]
mod tests {
    use super::super::check::State::{Ok, Warn};
    use super::super::root::made_up::Machine;
    use super::*;

    #[test]
    fn less_than_a_processor_is_a_warning_with_the_pause_that_follows() {
        let cgroup = ("proc/self/cgroup", "0::/small\n");
        let machine =
            Machine::new("processor-share", &[cgroup, ("sys/fs/cgroup/small/cpu.max", "30000 100000\n")]);
        let found = share(&machine.root);
        assert_eq!(found.state, Warn);
        assert!(found.detail.ends_with("0.30 processors per 100 ms: all processes may pause for 70 ms"));
        machine.write("sys/fs/cgroup/small/cpu.max", "200000 100000\n");
        assert_eq!(share(&machine.root).state, Ok);
        machine.write("sys/fs/cgroup/small/cpu.max", "max 100000\n");
        assert_eq!(share(&machine.root).detail, "no control group limits their time");
    }

    #[test]
    fn a_slow_clock_is_a_warning_that_names_a_faster_one() {
        let folder = "sys/devices/system/clocksource/clocksource0";
        let (current, available) =
            (format!("{folder}/current_clocksource"), format!("{folder}/available_clocksource"));
        let machine =
            Machine::new("processor-clock", &[(&current, "hpet\n"), (&available, "tsc hpet acpi_pm \n")]);
        let found = clock_source(&machine.root);
        assert!(found.fix.is_some_and(|fix| fix.starts_with("`echo tsc > /sys/")));
        machine.write(&available, "hpet acpi_pm\n");
        assert!(clock_source(&machine.root).fix.is_some_and(|fix| fix.contains("boot")));
        machine.write(&current, "tsc\n");
        assert_eq!(clock_source(&machine.root), Check::ok("clock_source", "tsc"));
    }

    #[test]
    fn a_governor_that_saves_power_and_a_deep_sleep_are_warnings() {
        let cpu = "sys/devices/system/cpu/cpu0";
        let machine = Machine::new("processor-sleep", &[]);
        assert_eq!([governor(&machine.root).state, idle_states(&machine.root, true).state], [Ok; 2]);
        machine.write(&format!("{cpu}/cpufreq/scaling_governor"), "powersave\n");
        for (index, [state, latency_us, disabled]) in
            [["POLL", "0", "0"], ["C1", "2", "0"], ["C6", "133", "0"]].into_iter().enumerate()
        {
            let state_folder = format!("{cpu}/cpuidle/state{index}");
            machine.write(&format!("{state_folder}/name"), state);
            machine.write(&format!("{state_folder}/latency"), latency_us);
            machine.write(&format!("{state_folder}/disable"), disabled);
        }
        assert_eq!(governor(&machine.root).state, Warn);
        let found = idle_states(&machine.root, false);
        assert_eq!((found.state, found.detail.as_str()), (Warn, "C6 takes 133 us to leave"));
        assert!(found.fix.is_some_and(|fix| fix.contains(LATENCY_DEVICE)));
        machine.write(&format!("{cpu}/cpuidle/state2/disable"), "1");
        machine.write(&format!("{cpu}/cpufreq/scaling_governor"), "performance");
        assert_eq!([governor(&machine.root).state, idle_states(&machine.root, false).state], [Ok; 2]);
    }
}
