//! What the cases of one suite share: the candidate's command, the recorded drives, and a test bench for each case.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::sync::atomic::AtomicU32;
use std::sync::{Arc, Mutex};

use plan::settings::{self, DriverTable};
use runtime::{ClockKind, Domain, Realtime, RunSettings, Shutdown};
use serde::Deserialize;
use shared_types::Role;
use supervision::lock::{SystemLock, clear};

use super::drive::{Course, Drive};
use super::test_bench::Button;
use super::vehicle::SuiteVehicle;

/// What all cases of a suite share.
pub(crate) struct Suite {
    /// Role of the candidate.
    pub(crate) role: Role,
    /// Program and arguments.
    pub(crate) command: Vec<OsString>,
    /// What drives.
    pub(crate) vehicle: SuiteVehicle,
    /// Scan period [ns].
    pub(crate) period_ns: u64,
    /// Settings of the driver of a robot.
    pub(crate) driver: Option<DriverTable>,
    /// Set when the user wants to end.
    pub(crate) shutdown: Shutdown,
    drives: Mutex<BTreeMap<Course, Arc<Drive>>>,
    /// How many test benches there were.
    pub(crate) benches: AtomicU32,
}

/// How a test bench is set up.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Setup {
    /// The drive that is played.
    pub(crate) course: Course,
    /// Whether time is simulated.
    pub(crate) lockstep: bool,
    /// How long the candidate may run without a directive [ns].
    pub(crate) orphan_ns: u64,
    /// The first scan that is played.
    pub(crate) first_scan: u64,
    /// Whether an actuator has an emergency stop from outside.
    pub(crate) button: bool,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            course: Course::Corridor,
            lockstep: false,
            orphan_ns: 30_000_000_000,
            first_scan: 1,
            button: false,
        }
    }
}

impl Suite {
    pub(crate) fn new(
        role: Role,
        command: Vec<OsString>,
        period_ns: u64,
        vehicle: SuiteVehicle,
    ) -> anyhow::Result<Self> {
        let shutdown = Shutdown::on_signals()?;
        sweep()?;
        let (drives, benches) = (Mutex::default(), AtomicU32::new(0));
        Ok(Self { role, command, vehicle, period_ns, driver: None, shutdown, drives, benches })
    }

    /// A recorded drive.
    pub(crate) fn drive(&self, course: Course) -> anyhow::Result<Arc<Drive>> {
        // Held while it is made, so that it is made once.
        let mut drives = self.drives.lock().map_err(|_| anyhow::anyhow!("another case has panicked"))?;
        if let Some(drive) = drives.get(&course) {
            return Ok(Arc::clone(drive));
        }
        let drive = Arc::new(Drive::record(course, self.period_ns, &self.vehicle)?);
        drives.insert(course, Arc::clone(&drive));
        Ok(drive)
    }

    /// Writes the settings that a candidate finds.
    pub(crate) fn write_settings(&self, domain: &Domain, drive: &Drive, setup: Setup) -> anyhow::Result<()> {
        let pipeline::PipelineSettings { scenario, tuning, period_ns } = &drive.settings;
        let run = RunSettings {
            period_ns: *period_ns,
            clock: if setup.lockstep { ClockKind::Simulated } else { ClockKind::Monotonic },
            orphan_stop_ns: setup.orphan_ns,
            orphan_timeout_ns: setup.orphan_ns,
        };
        if setup.button {
            Button::write(domain, run.clone())?;
        }
        let tuning = tuning.clone().for_scenario(scenario);
        settings::write(domain, &run, &Realtime::default(), scenario, &tuning, self.driver.as_ref())
    }
}

/// Removes what suites that were killed have left: systems that are named after a process which is gone.
fn sweep() -> anyhow::Result<()> {
    for domain in Domain::all()? {
        let suite = domain.system_id().strip_prefix('c').and_then(|rest| rest.split_once('-'));
        let pid = suite.and_then(|(pid, _)| pid.parse().ok());
        if pid.is_some_and(|pid| runtime::start_ticks(pid).is_none())
            && let Ok(lock) = SystemLock::take(&domain)
        {
            // Ends processes that still run; releasing the lock removes the files.
            clear(&domain, lock)?;
        }
    }
    Ok(())
}
