//! A system of real processes for one cell, in a folder of its own; dropping it leaves nothing behind.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use commands::laboratory::{PRODUCT_VARIABLE, SUFFIX, build_command};
use console::exit::Failure;
use console::new_file::{self, Scratch};
use emulator::Scenario;
use faults::ProcessName;
use runtime::Domain;
use rustix::process::{Pid, Signal, kill_process};
use session::control::{Reply, Request, SystemStatus, ask};
use shared_types::Role;

/// A system must drive within this time.
const START_TIMEOUT: Duration = Duration::from_secs(30);
/// The run must end within this time after a stop.
const END_TIMEOUT: Duration = Duration::from_secs(15);
/// Time between two checks.
const PAUSE: Duration = Duration::from_millis(2);
/// Without an orchestrator the robot drives on for this long [s]: a cell does not last as long as the default.
pub(super) const ORPHAN_STOP_S: f64 = 1.0;

static NEXT: AtomicU32 = AtomicU32::new(0);

/// The system of a cell.
pub(super) struct CellSystem {
    id: String,
    scratch: Scratch,
    orchestrator: Child,
    /// Process ids by role, once it drives.
    processes: Vec<(Role, Pid)>,
}

impl CellSystem {
    /// Starts a run of a scenario.
    ///
    /// # Errors
    /// Errors of the file system, and a program that can't be started.
    pub(super) fn start(scenario: &Scenario) -> anyhow::Result<Self> {
        // A system id has 16 letters at most.
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let id = format!("f{}-{number}", std::process::id());
        let scratch = Scratch::new()?;
        let folder = scratch.path();
        new_file::write(&folder.join("scenario.toml"), scenario.to_toml().as_bytes())?;
        let orphan_stop = format!("orphan_stop_s={ORPHAN_STOP_S}");
        let arguments = ["run", "scenario.toml", "--quiet", "--out", "out", "--set", orphan_stop.as_str()];
        let arguments = [&arguments[..], &["--set", "recording.ring_s=0"]].concat();
        let mut command = command_of(&id, folder)?;
        command.args(arguments).stderr(std::fs::File::create(folder.join("stderr.txt"))?);
        let orchestrator = command.spawn().context("scanloop run")?;
        Ok(Self { id, scratch, orchestrator, processes: Vec::new() })
    }

    /// Another command for this system, which is started and not waited for.
    ///
    /// # Errors
    /// A program that can't be started.
    pub(super) fn begin(&self, arguments: &[&str]) -> anyhow::Result<Child> {
        let mut command = command_of(&self.id, self.scratch.path())?;
        command.args(arguments).stderr(Stdio::null());
        command.spawn().with_context(|| format!("scanloop {}", arguments.join(" ")))
    }

    /// Waits until all processes are there; returns the domain.
    ///
    /// # Errors
    /// A run that ends before, or does not drive in time, with what it wrote; exit code 4.
    pub(super) fn wait_until_driving(&mut self) -> anyhow::Result<Domain> {
        let started = Instant::now();
        loop {
            if let Ok(Some(domain)) = Domain::find(&self.id)
                && let Some(status) = status_of(&domain)
                && status.state == "driving"
            {
                let pid = |pid: i32| Pid::from_raw(pid);
                self.processes =
                    status.processes.iter().filter_map(|row| Some((row.role, pid(row.pid)?))).collect();
                return Ok(domain);
            }
            if self.has_ended() || started.elapsed() > START_TIMEOUT {
                let text =
                    std::fs::read_to_string(self.scratch.path().join("stderr.txt")).unwrap_or_default();
                return Err(Failure::process(format!("the system of a cell does not drive: {text}")));
            }
            std::thread::sleep(PAUSE);
        }
    }

    /// Process ids that a fault of a process acts on.
    pub(super) fn targets(&self, process: ProcessName) -> Vec<Pid> {
        let of = |(_, pid): &(Role, Pid)| *pid;
        match process {
            ProcessName::Role(role) => self.processes.iter().filter(|(of, _)| *of == role).map(of).collect(),
            ProcessName::Orchestrator => self.orchestrator().into_iter().collect(),
            ProcessName::All => self.processes.iter().map(of).chain(self.orchestrator()).collect(),
        }
    }

    /// Process id of the orchestrator.
    fn orchestrator(&self) -> Option<Pid> {
        Pid::from_raw(self.orchestrator.id().cast_signed())
    }

    /// Whether the orchestrator has ended.
    pub(super) fn has_ended(&mut self) -> bool {
        self.orchestrator.try_wait().is_ok_and(|status| status.is_some())
    }

    /// The report of the run, if it wrote one.
    pub(super) fn report(&self) -> Option<report::Report> {
        report::Report::read(&self.scratch.path().join("out/report.json")).ok()
    }

    /// Ends the system.
    fn end(&mut self) {
        // Suspended processes can't end.
        self.targets(ProcessName::All).into_iter().for_each(|pid| _ = kill_process(pid, Signal::CONT));
        if let Ok(mut stop) = self.begin(&["stop"]) {
            let _ = stop.wait();
        }
        let asked = Instant::now();
        while !self.has_ended() && asked.elapsed() < END_TIMEOUT {
            std::thread::sleep(PAUSE);
        }
        if !self.has_ended() {
            let _ = self.orchestrator.kill();
            let _ = self.orchestrator.wait();
        }
        // The robot of an orphaned system comes to rest before it ends.
        while Domain::find(&self.id).is_ok_and(|domain| domain.is_some()) && asked.elapsed() < END_TIMEOUT {
            std::thread::sleep(PAUSE);
        }
    }
}

impl Drop for CellSystem {
    fn drop(&mut self) {
        self.end();
    }
}

/// The product, for a system.
fn command_of(id: &str, folder: &Path) -> anyhow::Result<Command> {
    let mut command = Command::new(product()?);
    command.args(["--system-id", id]).current_dir(folder).stdin(Stdio::null()).stdout(Stdio::null());
    Ok(command)
}

/// The product whose processes are started: the executable that has handed the command over, else that in the folder of
/// the laboratory.
///
/// # Errors
/// A missing product, with the command that builds it; exit code 4.
pub(crate) fn product() -> anyhow::Result<PathBuf> {
    if let Some(product) = std::env::var_os(PRODUCT_VARIABLE) {
        return Ok(PathBuf::from(product));
    }
    let own = std::env::current_exe().context("path of this executable")?;
    let name = own.file_name().unwrap_or_default().to_string_lossy();
    let product = own.with_file_name(name.strip_suffix(SUFFIX).unwrap_or_default());
    if !product.is_file() {
        let folder = own.parent().unwrap_or(&own).display();
        return Err(Failure::process(format!(
            "this drives real processes of the executable scanloop, which is not in {folder}: in the source tree \
             `{}` builds it",
            build_command("scanloop")
        )));
    }
    Ok(product)
}

fn status_of(domain: &Domain) -> Option<SystemStatus> {
    match ask(domain, &Request::Status) {
        Ok(Reply::Status(status)) => Some(*status),
        _ => None,
    }
}
