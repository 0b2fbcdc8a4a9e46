//! The page of a run: `run --view` starts this program again to serve it, so that no browser ever costs the orchestrator
//! time. The run opens the listening socket, because a port in use must be found before anything is started.

use std::io;
use std::net::{IpAddr, Ipv4Addr, TcpListener};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use runtime::Domain;
use rustix::process::{Pid, Signal, getppid, kill_process};
use supervision::child::this_program;

use crate::arguments::listen;

/// The page has this time to end after a signal.
const TIMEOUT: Duration = Duration::from_secs(2);

/// The process that serves the page of a run; it ends with this value.
#[derive(Debug)]
pub struct ViewOfRun(Child);

impl ViewOfRun {
    /// Starts to serve the page of a system on a port of 127.0.0.1.
    ///
    /// # Errors
    /// A port that is in use (exit code 2), and a process that can't be started.
    pub fn start(system_id: &str, port: u16) -> anyhow::Result<Self> {
        let listener = listen(IpAddr::V4(Ipv4Addr::LOCALHOST), port)?;
        let mut command = Command::new(this_program());
        command.args(["--system-id", system_id, "view", "--for-run"]);
        // In a group of its own, the Ctrl-C that ends the drive does not end the page before.
        command.stdin(Stdio::from(OwnedFd::from(listener))).process_group(0);
        Ok(Self(command.spawn()?))
    }
}

impl Drop for ViewOfRun {
    fn drop(&mut self) {
        if let Some(pid) = i32::try_from(self.0.id()).ok().and_then(Pid::from_raw) {
            let _ = kill_process(pid, Signal::TERM);
        }
        let until = Instant::now() + TIMEOUT;
        while matches!(self.0.try_wait(), Ok(None)) && Instant::now() < until {
            runtime::wait_for(&[], 10_000_000);
        }
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The listening socket that a run handed over as standard input.
pub(crate) fn inherited() -> io::Result<TcpListener> {
    io::stdin().as_fd().try_clone_to_owned().map(TcpListener::from)
}

/// The run that started this process.
#[derive(Debug)]
pub(crate) struct Parent(Option<Pid>);

impl Parent {
    pub(crate) fn new() -> Self {
        Self(getppid())
    }

    /// Whether the page is still needed: while the run lives, and after its death while its system does.
    pub(crate) fn is_needed(&self, system_id: &str) -> bool {
        getppid() == self.0 || matches!(Domain::find(system_id), Ok(Some(_)))
    }
}
