//! The system that the demo drives, by the commands that a user has. Dropping it stops what is left.

use std::fs::File;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::Context;
use console::exit::{Exit, Failure};
use runtime::{Domain, RUN_ID_VARIABLE, Shutdown, wait_for};
use rustix::process::{Pid, Signal, kill_process};
use session::control::{Reply, Request, SystemStatus, ask};
use supervision::child::this_program;

/// A step of the demo that takes longer has failed.
pub(super) const STEP_TIMEOUT: Duration = Duration::from_secs(30);
/// Time between two checks [ns].
const POLL_NS: u64 = 5_000_000;
/// A run ends by itself after this driven time [s]: nothing drives on when the demo is killed.
const MAX_DRIVE_S: &str = "240";

/// A robot that stands ends the run after this time, not after the usual 5 s.
const STOP_FINAL: &str = "stop_final_s=2";

/// The demo was ended by a signal.
#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
pub(super) struct Interrupted;

/// A running system.
pub(super) struct System {
    pub(super) id: String,
    /// Where the outputs of its commands are written.
    pub(super) folder: PathBuf,
    /// Where the results of the drive are written.
    pub(super) drive: PathBuf,
    orchestrator: Option<Child>,
    /// Run id, once it is known: part of the names of its shared memory, and in the environment of its processes.
    run_id: String,
}

impl System {
    /// A system that is not started.
    pub(super) fn new(id: String, folder: PathBuf, drive: PathBuf) -> Self {
        Self { id, folder, drive, orchestrator: None, run_id: String::new() }
    }

    /// Starts a command of this program for the system; its output goes to files of that name.
    ///
    /// # Errors
    /// Errors of the file system.
    pub(super) fn begin(&self, name: &str, arguments: &[&str]) -> anyhow::Result<Child> {
        let file = |kind: &str| {
            let path = self.folder.join(format!("{name}.{kind}"));
            File::create(&path).with_context(|| path.display().to_string())
        };
        // In a group of its own, so that a Ctrl-C reaches only the demo, which ends everything in order.
        let mut command = Command::new(this_program());
        command.args(["--system-id", &self.id]).args(arguments);
        command.stdin(Stdio::null()).stdout(file("out")?).stderr(file("err")?).process_group(0);
        command.spawn().with_context(|| format!("scanloop {}", arguments.join(" ")))
    }

    /// What a command wrote to its output of a kind, `out` or `err`.
    pub(super) fn written(&self, name: &str, kind: &str) -> String {
        std::fs::read_to_string(self.folder.join(format!("{name}.{kind}"))).unwrap_or_default()
    }

    /// Runs a command to its end and returns its exit code.
    ///
    /// # Errors
    /// [`Interrupted`], and a command that does not end.
    pub(super) fn run(
        &self,
        name: &str,
        arguments: &[&str],
        shutdown: &Shutdown,
    ) -> anyhow::Result<Option<i32>> {
        let mut child = self.begin(name, arguments)?;
        let ended = wait_until(shutdown, || Ok(child.try_wait()?));
        if ended.is_err() {
            end(&mut child);
        }
        Ok(ended.with_context(|| format!("scanloop {}", arguments.join(" ")))?.code())
    }

    /// Starts the run and waits until it drives.
    ///
    /// # Errors
    /// What the run refuses, with its exit code, and [`Interrupted`].
    pub(super) fn start(&mut self, arguments: &[&str], shutdown: &Shutdown) -> anyhow::Result<()> {
        let out = self.drive.to_str().context("--out: the path of the folder is not UTF-8")?;
        let fixed = ["run", "endless", "--quiet", "--allow-inject", "--duration", MAX_DRIVE_S, "--out", out];
        let arguments = &[&["--set", STOP_FINAL], arguments].concat();
        self.orchestrator = Some(self.begin("run", &[&fixed[..], arguments].concat())?);
        self.wait_until_driving("run", shutdown)
    }

    /// Waits for the link to the live page.
    ///
    /// # Errors
    /// As [`System::start`].
    pub(super) fn link(&self, shutdown: &Shutdown) -> anyhow::Result<String> {
        wait_until(shutdown, || {
            let printed = self.written("run", "out") + &self.written("run", "err");
            Ok(printed.split_whitespace().find(|word| word.starts_with("http")).map(str::to_owned))
        })
        .context("link to the live page")
    }

    /// Takes the processes over after the death of the orchestrator.
    ///
    /// # Errors
    /// As [`System::start`].
    pub(super) fn adopt(&mut self, shutdown: &Shutdown) -> anyhow::Result<()> {
        self.orchestrator = Some(self.begin("adopt", &["adopt", "--quiet", "--duration", MAX_DRIVE_S])?);
        self.wait_until_driving("adopt", shutdown)
    }

    fn wait_until_driving(&mut self, name: &'static str, shutdown: &Shutdown) -> anyhow::Result<()> {
        wait_until(shutdown, || {
            if let Some(domain) = self.domain() {
                domain.run_id().clone_into(&mut self.run_id);
            }
            if let Some(status) = self.orchestrator.as_mut().map(Child::try_wait).transpose()?.flatten() {
                self.orchestrator = None;
                let (text, exit) = (self.written(name, "err"), exit_of(status));
                let message = text.trim().trim_start_matches("error: ").to_owned();
                return Err(Failure { exit, message }.into());
            }
            Ok(self.status().filter(|status| status.state == "driving" && status.scan > 3))
        })
        .map(|_| ())
    }

    /// The directory of the system.
    pub(super) fn domain(&self) -> Option<Domain> {
        Domain::find(&self.id).ok().flatten()
    }

    /// Its state, if it answers.
    pub(super) fn status(&self) -> Option<SystemStatus> {
        match ask(&self.domain()?, &Request::Status) {
            Ok(Reply::Status(status)) => Some(*status),
            _ => None,
        }
    }

    /// Kills the orchestrator and waits until it is gone; returns its process id.
    pub(super) fn kill_orchestrator(&mut self) -> Option<u32> {
        let mut child = self.orchestrator.take()?;
        let _ = child.kill();
        let _ = child.wait();
        Some(child.id())
    }

    /// Waits for the end of the run.
    ///
    /// # Errors
    /// [`Interrupted`], and a run that does not end.
    pub(super) fn wait(&mut self, shutdown: &Shutdown) -> anyhow::Result<()> {
        let Some(child) = &mut self.orchestrator else { return Ok(()) };
        wait_until(shutdown, || Ok(child.try_wait()?)).context("the run does not end")?;
        self.orchestrator = None;
        Ok(())
    }

    /// Counts processes of the run, its directory and its shared memory.
    pub(super) fn left_behind(&self) -> usize {
        if self.run_id.is_empty() {
            return usize::from(self.domain().is_some());
        }
        let memory = names("/dev/shm").iter().filter(|name| name.contains(&self.run_id)).count();
        let wanted = format!("{RUN_ID_VARIABLE}={}", self.run_id);
        let is_process = |name: &&String| {
            let environment =
                std::fs::read(Path::new("/proc").join(name).join("environ")).unwrap_or_default();
            environment.split(|byte| *byte == 0).any(|text| text == wanted.as_bytes())
        };
        let is_number = |name: &&String| name.bytes().all(|byte| byte.is_ascii_digit());
        let processes = names("/proc").iter().filter(is_number).filter(is_process).count();
        memory + processes + usize::from(self.domain().is_some())
    }
}

impl Drop for System {
    fn drop(&mut self) {
        if self.orchestrator.is_none() && self.domain().is_none() {
            return;
        }
        if let Ok(mut stop) = self.begin("stop", &["stop"]) {
            let _ = stop.wait();
        }
        let until = Instant::now() + STEP_TIMEOUT / 2;
        while self.left_behind() > 0 && Instant::now() < until {
            if let Some(child) = &mut self.orchestrator
                && let Ok(Some(_)) = child.try_wait()
            {
                self.orchestrator = None;
            }
            wait_for(&[], POLL_NS);
        }
        if let Some(child) = &mut self.orchestrator {
            end(child);
        }
    }
}

/// Asks a command to end, and kills it when it does not.
fn end(child: &mut Child) {
    if let Some(pid) = Pid::from_raw(child.id().cast_signed()) {
        let _ = kill_process(pid, Signal::TERM);
    }
    let until = Instant::now() + Duration::from_secs(5);
    while matches!(child.try_wait(), Ok(None)) && Instant::now() < until {
        wait_for(&[], POLL_NS);
    }
    let _ = child.kill();
    let _ = child.wait();
}

fn exit_of(status: ExitStatus) -> Exit {
    match status.code() {
        Some(2) => Exit::BadInput,
        Some(4) => Exit::ProcessFailed,
        _ => Exit::Internal,
    }
}

/// Names in a folder.
fn names(folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
}

/// Waits for a value.
///
/// # Errors
/// [`Interrupted`] after a signal, the error of the check, and a value that does not come in time.
pub(super) fn wait_until<T>(
    shutdown: &Shutdown,
    mut check: impl FnMut() -> anyhow::Result<Option<T>>,
) -> anyhow::Result<T> {
    let started = Instant::now();
    loop {
        if shutdown.requested() {
            return Err(Interrupted.into());
        }
        if let Some(value) = check()? {
            return Ok(value);
        }
        anyhow::ensure!(started.elapsed() < STEP_TIMEOUT, "not within {} s", STEP_TIMEOUT.as_secs());
        wait_for(&[shutdown.descriptor()], POLL_NS);
    }
}
