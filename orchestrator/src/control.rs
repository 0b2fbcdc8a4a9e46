//! How commands reach a running orchestrator: one line of JSON each way over a socket in its directory.

use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context;
use runtime::{Domain, RuntimeError};
use serde::{Deserialize, Serialize};

use crate::ledger::RefusedRow;
use crate::shadow::ShadowReport;
use crate::swap::Certificate;

/// A client that does not finish its line within this time is dropped; the loop does not depend on it.
const PATIENCE: Duration = Duration::from_millis(200);
/// How long a command waits for its answer.
const ANSWER_PATIENCE: Duration = Duration::from_secs(10);

/// What can be asked of a running orchestrator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Request {
    /// The state of all processes.
    Status,
    /// Block the wheels and end everything.
    Stop,
    /// End one process and start it again.
    Restart {
        /// Name of the role.
        role: String,
    },
    /// Exchange one process for another.
    Swap(SwapRequest),
    /// What became of an exchange.
    SwapResult {
        /// Its number, from [`Reply::Accepted`].
        number: u64,
    },
    /// Let a process run in the shadow of another.
    Shadow(ShadowRequest),
    /// What became of a shadow.
    ShadowResult {
        /// Its number, from [`Reply::Accepted`].
        number: u64,
    },
    /// End a shadow early.
    ShadowEnd {
        /// Its number, from [`Reply::Accepted`].
        number: u64,
    },
}

/// An exchange that is asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SwapRequest {
    /// Name of the role.
    pub role: String,
    /// Built-in implementation; exactly one of this and `command`.
    pub implementation: Option<String>,
    /// Program and arguments.
    pub command: Option<Vec<String>>,
    /// Scans in a row on which the new process must agree before it takes over.
    pub shadow_scans: u64,
    /// Scans after that during which the old process stands by.
    pub standby_scans: u64,
    /// Factor on the bounds of agreement.
    pub tolerance: f64,
}

/// A shadow that is asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShadowRequest {
    /// Name of the role.
    pub role: String,
    /// Built-in implementation; exactly one of this and `command`.
    pub implementation: Option<String>,
    /// Program and arguments.
    pub command: Option<Vec<String>>,
    /// How long it is to run [ms].
    pub duration_ms: u64,
}

/// What it answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reply {
    /// The request is carried out.
    Done,
    /// The state of all processes.
    Status(Box<Status>),
    /// An exchange or a shadow has begun; ask for its result by this number.
    Accepted(u64),
    /// It goes on.
    Pending,
    /// What became of a shadow.
    Shadow(Box<ShadowReport>),
    /// What became of an exchange.
    Certificate(Box<Certificate>),
    /// The request is refused, with the reason.
    Refused(String),
}

/// The state of a system, `status --json`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Status {
    /// The system.
    pub system_id: String,
    /// Phase of the system: starting, connecting, driving, stopping.
    pub state: String,
    /// Name of the scenario.
    pub scenario: String,
    /// The newest scan.
    pub scan: u64,
    /// Whether time is simulated.
    #[serde(default)]
    pub lockstep: bool,
    /// One row per process.
    pub processes: Vec<ProcessStatus>,
    /// Samples that a reader dropped or refused because of their content: by writer, reader and rule.
    #[serde(default)]
    pub refused: Vec<RefusedRow>,
}

/// One process in [`Status`].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ProcessStatus {
    /// Name of the role.
    pub role: String,
    /// Built-in implementation, or the command.
    pub implementation: String,
    /// Process id, 0 when none runs.
    pub pid: i32,
    /// starting, ready, standby, shadow, hung, backoff, failed or stopped.
    pub state: String,
    /// Starts after the first.
    pub restarts: u32,
    /// Outputs per second over the last seconds.
    pub rate_hz: f64,
    /// Age of the newest output [ms].
    pub last_sample_age_ms: f64,
    /// Share of one processor since the status before [%].
    pub cpu_percent: f64,
    /// Resident memory [KiB].
    pub memory_kib: u64,
    /// Last lines that a process wrote before it died.
    pub last_words: Vec<String>,
}

/// The orchestrator's end.
#[derive(Debug)]
pub struct ControlSocket {
    listener: UnixListener,
}

impl ControlSocket {
    /// Opens the socket of the system.
    ///
    /// # Errors
    /// Errors of the file system.
    pub fn open(domain: &Domain) -> anyhow::Result<Self> {
        let path = socket_path(domain);
        let _ = std::fs::remove_file(&path);
        let listener = UnixListener::bind(&path).with_context(|| format!("{}", path.display()))?;
        listener.set_nonblocking(true).with_context(|| format!("{}", path.display()))?;
        Ok(Self { listener })
    }

    /// Readable when a client has come.
    pub fn descriptor(&self) -> BorrowedFd<'_> {
        self.listener.as_fd()
    }

    /// Answers all clients that are waiting.
    pub fn serve(&self, mut answer: impl FnMut(Request) -> Reply) {
        loop {
            match self.listener.accept() {
                Ok((stream, _)) => {
                    if let Err(error) = converse(&stream, &mut answer) {
                        tracing::debug!(%error, "a client of the control socket was dropped");
                    }
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return,
            }
        }
    }
}

/// Asks the orchestrator of a system.
///
/// # Errors
/// [`RuntimeError::NotRunning`] when nobody answers, and what was refused.
pub fn ask(domain: &Domain, request: &Request) -> anyhow::Result<Reply> {
    let not_running = || RuntimeError::NotRunning(domain.system_id().to_owned());
    let mut stream = UnixStream::connect(socket_path(domain)).map_err(|_| not_running())?;
    stream.set_read_timeout(Some(ANSWER_PATIENCE))?;
    writeln!(stream, "{}", serde_json::to_string(request)?)?;
    let mut line = String::new();
    BufReader::new(stream).read_line(&mut line).context("the orchestrator does not answer")?;
    if line.is_empty() {
        return Err(not_running().into());
    }
    Ok(serde_json::from_str(&line)?)
}

fn converse(stream: &UnixStream, answer: &mut impl FnMut(Request) -> Reply) -> anyhow::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut line = String::new();
    BufReader::new(stream).read_line(&mut line)?;
    let reply = match serde_json::from_str(&line) {
        Ok(request) => answer(request),
        Err(error) => Reply::Refused(format!("not a request: {error}")),
    };
    let mut stream = stream;
    writeln!(stream, "{}", serde_json::to_string(&reply)?)?;
    Ok(())
}

fn socket_path(domain: &Domain) -> PathBuf {
    domain.directory().join("control.sock")
}
