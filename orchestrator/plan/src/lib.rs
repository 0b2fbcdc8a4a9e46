//! What is to be driven: scenario and system, read, overridden and checked before anything is started.

pub mod calibration_file;
pub mod overrides;
mod rate;
pub mod reference;
pub mod settings;
pub mod system;
mod vehicle_table;

use std::path::{Path, PathBuf};

use clap::Args;
use console::exit::Failure;
use console::user_file::{self, TEXT_BYTES};
use emulator::Scenario;
use runtime::{ClockKind, Domain, RunSettings};
use supervision::realtime;
use toml::{Table, Value};
use vehicle::{Invalid, Setting};

pub use system::System;

/// Arguments that choose and change a scenario and a system.
#[derive(Debug, Args, Clone, Default)]
pub struct Choice {
    /// System file; without it the built-in one.
    #[arg(long, value_name = "FILE")]
    pub system: Option<PathBuf>,
    /// Calibration file from `scanloop calibrate`; its values replace the calibration of the system.
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// Add the real-time profile to the system: one processor, SCHED_FIFO, no idle states, locked memory (docs/tuning.md).
    #[arg(long)]
    pub realtime: bool,
    /// Seed of all random numbers of the scenario.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Override a key of the scenario or the system, for example `robot.velocity_factor=1.3`; may be repeated.
    ///
    /// `scanloop reference` lists the keys. Elements of a list are named by index or role: `obstacle.0.x_m=6`,
    /// `process.controller.grace_ms=500`.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
}

/// Scenario of a run without one.
const DEFAULT_SCENARIO: &str = "corridor";

/// What is to be driven, checked.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The scenario.
    pub scenario: Scenario,
    /// The system.
    pub system: System,
    /// What a user should know before it is driven: old keys, and where the robot differs from its description.
    pub warnings: Vec<String>,
}

impl Plan {
    /// Reads and checks scenario and system, with overrides.
    ///
    /// # Errors
    /// One message with file, key, value and allowed range; exit code 2.
    pub fn read(scenario: Option<&str>, choice: &Choice) -> anyhow::Result<Self> {
        let (mut scenario, scenario_file) = read_scenario(scenario.unwrap_or(DEFAULT_SCENARIO))?;
        let (mut system, system_file) = System::read_table(choice.system.as_deref())?;
        if choice.realtime {
            realtime::add_profile(&mut system);
        }
        if let Some(file) = &choice.calibration {
            calibration_file::apply(file, &mut system)?;
        }
        for text in &choice.overrides {
            let (key, value) = overrides::parse_override(text)?;
            let first = key.split('.').next().unwrap_or_default();
            let target = if is_of_scenario(first) { &mut scenario } else { &mut system };
            overrides::set(target, &key, value)?;
        }
        if let Some(seed) = choice.seed {
            let seed = i64::try_from(seed).map_err(|_| {
                Failure::bad_input(format!("--seed {seed} is not allowed: 0 to {}", i64::MAX))
            })?;
            scenario.insert("seed".to_owned(), Value::Integer(seed));
        }
        vehicle_table::adopt_robot(&scenario, &mut system);
        let scenario = Scenario::from_table(scenario, &scenario_file).map_err(Failure::bad_input)?;
        let refuse = |invalid: Invalid| Failure::bad_input(format!("{system_file}: {invalid}"));
        let mut warnings = vehicle_table::distribute(&mut system).map_err(refuse)?;
        if system.get("controller").is_some_and(|table| table.get("period_s").is_some()) {
            warnings.push("controller.period_s has no effect: the scan period is 1 / rate_hz".to_owned());
        }
        let system = System::from_table(system, &system_file)?;
        // What the stages take from the scenario may be allowed there and too much for them.
        let together = system.tuning().for_scenario(&scenario).validate();
        together.map_err(|invalid| Failure::bad_input(format!("{scenario_file}: {invalid}")))?;
        Ok(Self { scenario, system, warnings })
    }

    /// Writes the settings file of each process of a system.
    ///
    /// # Errors
    /// Settings that are not allowed, and errors of the file system.
    pub fn write_settings(&self, domain: &Domain, lockstep: bool) -> anyhow::Result<()> {
        let Self { scenario, system, .. } = self;
        let run = RunSettings {
            period_ns: system.period_ns(),
            clock: if lockstep { ClockKind::Simulated } else { ClockKind::Monotonic },
            orphan_stop_ns: (system.orphan_stop_s() * 1e9) as u64,
            orphan_timeout_ns: (system.orphan_timeout_s * 1e9) as u64,
        };
        settings::write(domain, &run, &system.realtime, scenario, &system.tuning().for_scenario(scenario))
    }
}

/// Whether a key or table belongs to the scenario; all others belong to the system.
fn is_of_scenario(name: &str) -> bool {
    Scenario::keys().iter().any(|key| key.name == name)
}

/// The table of a scenario file, or of a shipped scenario, and its name in messages.
fn read_scenario(name: &str) -> anyhow::Result<(Table, String)> {
    let path = Path::new(name);
    let (text, file) = match Scenario::shipped(name) {
        Some(text) if !path.is_file() => (text.to_owned(), format!("shipped scenario {name}")),
        _ => {
            let text = user_file::read(path, TEXT_BYTES).map_err(|error| {
                let shipped: Vec<&str> = Scenario::names().collect();
                Failure::bad_input(format!("{name}: {error}; shipped scenarios are {}", shipped.join(", ")))
            })?;
            (text, name.to_owned())
        }
    };
    system::table_of(&text, file)
}
