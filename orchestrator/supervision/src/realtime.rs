//! Processors, scheduler and idle states that a run asks the machine for; see `docs/tuning.md`.
//!
//! When the machine refuses a setting, one warning says what to change, and the run continues without it.

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::io::Write;

use runtime::Realtime;
use toml::{Table, Value};
use vehicle::{Invalid, require};

/// The profile of `--realtime`.
const PROFILE: &str = include_str!("../../systems/realtime.toml");
/// The device by which a process limits the wake-up latency of idle processors, as long as it is open.
const LATENCY_DEVICE: &str = "/dev/cpu_dma_latency";

/// Settings of a run, and the device that it holds open for them.
pub struct Machine {
    realtime: Realtime,
    warned: BTreeSet<String>,
    taken_in: BTreeSet<u32>,
    _awake: Option<File>,
}

impl Machine {
    /// Keeps processors awake from now on, if asked for.
    pub fn new(realtime: &Realtime) -> Self {
        let mut machine = Self {
            realtime: realtime.clone(),
            warned: BTreeSet::new(),
            taken_in: BTreeSet::new(),
            _awake: None,
        };
        if !realtime.idle_states {
            match keep_awake() {
                Ok(device) => machine._awake = Some(device),
                Err(error) => machine.warn_once(format!(
                    "realtime.idle_states = false has no effect ({LATENCY_DEVICE}: {error}): let this user write to \
                     the device, or boot with `cpuidle.off=1`"
                )),
            }
        }
        machine
    }

    /// Gives a process its processors and priority; does nothing the second time.
    pub fn take_in(&mut self, pid: u32) {
        if !self.taken_in.insert(pid) {
            return;
        }
        for refused in self.realtime.apply_to(pid) {
            self.warn_once(refused);
        }
    }

    fn warn_once(&mut self, warning: String) {
        if self.warned.insert(warning.clone()) {
            tracing::warn!("{warning}");
        }
    }
}

/// Adds the profile of `--realtime` to a system; keys that the system sets itself stay.
pub fn add_profile(system: &mut Table) {
    let Ok(profile) = PROFILE.parse::<Table>() else { return };
    let Some(Value::Table(profile)) = profile.get("realtime") else { return };
    let own = system.entry("realtime").or_insert_with(|| Value::Table(Table::new()));
    if let Value::Table(own) = own {
        for (key, value) in profile {
            own.entry(key).or_insert_with(|| value.clone());
        }
    }
}

/// Checks every value.
///
/// # Errors
/// The first value that is not allowed, with what is.
pub fn validate(realtime: &Realtime) -> Result<(), Invalid> {
    realtime.require_ranges()?;
    if realtime.slice_us > 0 {
        require("slice_us", realtime.slice_us as f64, 100.0..=100_000.0)?;
    }
    if realtime.poll_us > 0 && realtime.cpu.len() == 1 {
        let allowed = "0 with one processor in `cpu`: a process that polls there keeps the one it waits for from running";
        return Err(Invalid::new("poll_us", realtime.poll_us, allowed));
    }
    Ok(())
}

/// Keeps idle processors awake while the file is open: no wake-up latency is allowed.
fn keep_awake() -> std::io::Result<File> {
    let mut device = OpenOptions::new().write(true).open(LATENCY_DEVICE)?;
    device.write_all(&0i32.to_ne_bytes())?;
    Ok(device)
}

#[cfg(test)]
mod tests {
    use runtime::Scheduler;

    use super::*;

    fn profile_on(system: &str) -> Realtime {
        let mut table: Table = system.parse().unwrap();
        add_profile(&mut table);
        table["realtime"].clone().try_into().unwrap()
    }

    #[test]
    fn the_profile_is_valid_and_keys_of_the_system_override_it() {
        let profile = profile_on("");
        assert_eq!(validate(&profile), Ok(()));
        assert_eq!(profile.scheduler, Scheduler::Fifo);
        let own = profile_on("[realtime]\nscheduler = \"other\"");
        assert_eq!(own, Realtime { scheduler: Scheduler::Other, ..profile });
    }

    #[test]
    fn polling_with_one_processor_is_refused() {
        let realtime = Realtime { poll_us: 50, cpu: vec![0], ..Realtime::default() };
        let message = validate(&realtime).unwrap_err().to_string();
        assert!(message.starts_with("poll_us = 50 is not allowed: 0 with one processor"), "{message}");
    }
}
