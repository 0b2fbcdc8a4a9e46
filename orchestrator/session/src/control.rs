//! How commands reach a running orchestrator: one line of JSON each way over a socket in its directory.
//!
//! The loop of the session never touches a client: `server` reads and writes in threads of its own, with limits of
//! number, length and time, and hands whole requests to the loop.

mod line;
mod request;
mod server;

use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context;
use audit::ledger::RefusedRow;
use console::exit::Failure;
use emulator::JudgedBy;
use handover::shadow::ShadowReport;
use handover::swap::Certificate;
use report::{BlockingReport, ScannerStatus};
use runtime::{Domain, LinkedHost, RuntimeError, Wheels, monotonic_ns, peer_uid};
use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, connect, socket_with};
use rustix::process::geteuid;
use serde::{Deserialize, Serialize};
use shared_types::{Device, DeviceState, Role};
use supervision::entry::role_name;
use supervision::fleet::companions::CompanionView;
use supervision::lock::{hidden, is_hidden, suspended_orchestrator, suspension};
use supervision::supervisor::VisibleState;

use self::line::{read_line, write_line};
pub use self::request::{Request, ShadowRequest, Successor, SwapRequest};
use self::server::{BUSY, Server};

/// A command waits this long for its answer, whatever the orchestrator does: longer than a request waits there.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(12);
/// The same for one that is suspended: it may be let run in a moment, but no more is to be expected.
const SUSPENDED_TIMEOUT: Duration = Duration::from_millis(800);
/// Longest answer [bytes]; the report of a shadow has some kilobytes.
const MAX_ANSWER: usize = 16 << 20;
/// A command comes again after this time when the orchestrator has too many connections.
const BUSY_PAUSE: Duration = Duration::from_millis(50);

/// What the orchestrator answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reply {
    /// The request is carried out.
    Done,
    /// The state of all processes.
    Status(Box<SystemStatus>),
    /// A fault is injected; one that acts on processes from outside is up to the command that asked.
    Injected {
        /// How long it lasts [s].
        for_s: f64,
        /// Process id of the orchestrator.
        orchestrator: u32,
    },
    /// A swap or a shadow was accepted; ask for its result by this number. For a goal the first scan that it counts for.
    Accepted(u64),
    /// It is in progress.
    Pending,
    /// A person drives by hand.
    Teleop {
        /// The number of the person, for [`Request::Control`].
        person: u64,
        /// The scan period [ns].
        period_ns: u64,
        /// Whether each control is for one scan, because time is simulated.
        lockstep: bool,
    },
    /// The report of a shadow.
    Shadow(Box<ShadowReport>),
    /// The certificate of a swap.
    Certificate(Box<Certificate>),
    /// The request is refused, with the reason.
    Refused(String),
    /// The request is right, but could not be carried out, as on a full disk; with the reason.
    Failed(String),
}

/// The state of a system, `status --json`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SystemStatus {
    /// The system.
    pub system_id: String,
    /// Phase of the system: starting, connecting, driving, stopping.
    pub state: String,
    /// Name of the scenario.
    pub scenario: String,
    /// The newest scan.
    pub scan: u64,
    /// What judges the run: `truth` or `estimate`; null before the drive begins.
    #[serde(default)]
    pub judged_by: Option<JudgedBy>,
    /// Whether time is simulated.
    #[serde(default)]
    pub lockstep: bool,
    /// What the wheels do by the report of the robot, or of the actuator for a robot without one; after a stop, only what was
    /// reported since. Null without an orchestrator.
    #[serde(default)]
    pub wheels: Option<Wheels>,
    /// Who drives: `controller`, `person` or `nobody`. Null without an orchestrator.
    #[serde(default)]
    pub driven_by: Option<String>,
    /// The obstacle that the wheels are blocked for now.
    #[serde(default)]
    pub blocking: Option<BlockingReport>,
    /// Why the wheels are blocked, or turn slower than a person asks for; null where they do not.
    #[serde(default)]
    pub hindered: Option<String>,
    /// The state of the scanner, once obstacles are described.
    #[serde(default)]
    pub scanner: Option<ScannerStatus>,
    /// One row per process.
    pub processes: Vec<ProcessStatus>,
    /// One row per process beside the loop.
    #[serde(default)]
    pub companions: Vec<CompanionStatus>,
    /// Samples that a reader dropped or refused because of their content: by writer, reader and rule.
    #[serde(default)]
    pub refused: Vec<RefusedRow>,
    /// One row per other host.
    #[serde(default)]
    pub hosts: Vec<LinkedHost>,
    /// The last events, the oldest first.
    #[serde(default)]
    pub events: Vec<EventRow>,
}

/// What the orchestrator told its user.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct EventRow {
    /// Numbers the events of a run from 1.
    pub number: u64,
    /// Driven time [s].
    pub time_s: f64,
    /// Whether it is a warning.
    pub warning: bool,
    /// One line of text.
    pub text: String,
}

/// One process in [`SystemStatus`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProcessStatus {
    /// The role.
    #[serde(with = "role_name")]
    pub role: Role,
    /// Built-in implementation, with its host when that is another one, or the command.
    pub implementation: String,
    /// Name of the host that it runs on; null for the one of the orchestrator.
    #[serde(default)]
    pub host: Option<String>,
    /// Process id, 0 when none runs.
    pub pid: i32,
    /// starting, ready, standby, shadow, hung, backoff, failed or stopped.
    pub state: VisibleState,
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
    /// Whether it sees the stop word, and so obeys `scanloop stop` by itself.
    #[serde(default)]
    pub obeys_stop: bool,
    /// What the devices behind the process do: connecting, running or fault; null when it reports none.
    #[serde(default)]
    pub device: Option<String>,
    /// For how long they have done it [s].
    #[serde(default)]
    pub device_for_s: Option<f64>,
    /// Why they do it, in the words of the process; empty without a reason.
    #[serde(default)]
    pub device_reason: Option<String>,
    /// Last log lines of the process before the one that runs.
    pub last_words: Vec<String>,
}

/// One process beside the loop in [`SystemStatus`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CompanionStatus {
    /// Its name.
    pub name: String,
    /// Its command.
    pub implementation: String,
    /// Process id, 0 when none runs.
    pub pid: u32,
    /// starting, ready, hung, backoff or failed.
    pub state: VisibleState,
    /// Starts after the first.
    pub restarts: u32,
    /// Whether the run ends when it has failed.
    pub needed: bool,
    /// Samples published per second.
    pub rate_hz: f64,
    /// Age of the newest one [ms].
    pub last_sample_age_ms: f64,
    /// Share of one processor since the status before [%].
    pub cpu_percent: f64,
    /// Resident memory [KiB].
    pub memory_kib: u64,
    /// Samples of its first topic that it has taken.
    pub taken: u64,
    /// Of these, those that it is done with.
    pub answered: u64,
    /// Samples that it has published.
    pub published: u64,
    /// Inputs dropped because of their content.
    pub invalid: u64,
    /// Inputs dropped because their writer was not in charge.
    pub foreign: u64,
    /// Inputs that never arrived.
    pub missed: u64,
    /// Last log lines of the process before the one that runs.
    pub last_words: Vec<String>,
}

impl From<CompanionView> for CompanionStatus {
    fn from(view: CompanionView) -> Self {
        let CompanionView { report, load, .. } = view;
        let age_ns = monotonic_ns().saturating_sub(report.published_ns);
        Self {
            name: view.name,
            implementation: view.command,
            pid: view.pid,
            state: view.state,
            restarts: view.restarts,
            needed: view.needed,
            rate_hz: view.rate_hz,
            last_sample_age_ms: if report.published_ns == 0 { 0.0 } else { age_ns as f64 * 1e-6 },
            cpu_percent: load.cpu_percent,
            memory_kib: load.memory_kib,
            taken: report.taken,
            answered: report.answered,
            published: report.published,
            invalid: report.invalid,
            foreign: report.foreign,
            missed: report.missed,
            last_words: view.last_log_lines,
        }
    }
}

impl ProcessStatus {
    /// The row of a process of which nothing else is known.
    pub(crate) fn new(role: Role, state: VisibleState) -> Self {
        Self {
            role,
            implementation: String::new(),
            host: None,
            pid: 0,
            state,
            restarts: 0,
            rate_hz: 0.0,
            last_sample_age_ms: 0.0,
            cpu_percent: 0.0,
            memory_kib: 0,
            obeys_stop: false,
            device: None,
            device_for_s: None,
            device_reason: None,
            last_words: Vec::new(),
        }
    }

    /// Shows what the devices behind the process do, if it reports them.
    pub(crate) fn set_device(&mut self, device: &Device, now_ns: u64) {
        let state = Some(device.state()).filter(|state| *state != DeviceState::None);
        self.device = state.map(|state| state.name().to_owned());
        self.device_for_s = state.map(|_| now_ns.saturating_sub(device.since_ns) as f64 * 1e-9);
        self.device_reason = state.map(|_| device.reason());
    }
}

/// The orchestrator's end.
#[derive(Debug)]
pub struct ControlSocket {
    server: Server,
}

impl ControlSocket {
    /// Opens the socket of the system.
    ///
    /// # Errors
    /// Errors of the file system, and a thread that can't be started.
    pub fn open(domain: &Domain) -> anyhow::Result<Self> {
        let path = socket_path(domain);
        let server = Server::open(&path).with_context(|| format!("{}", path.display()))?;
        Ok(Self { server })
    }

    /// Readable when a request has come.
    pub fn descriptor(&self) -> BorrowedFd<'_> {
        self.server.wake.as_fd()
    }

    /// Answers all requests that are waiting; never waits for a client.
    pub fn serve(&self, mut answer: impl FnMut(Request) -> Reply) {
        for asked in self.server.take() {
            if asked.is_awaited() {
                let _ = asked.answer.try_send(answer(asked.request));
            }
        }
    }
}

/// Asks the orchestrator of a system.
///
/// # Errors
/// [`RuntimeError::NotRunning`] when none answers, what was refused, and an answer that does not come in time.
pub fn ask(domain: &Domain, request: &Request) -> anyhow::Result<Reply> {
    let path = socket_path(domain);
    let is_suspended = suspended_orchestrator(domain).is_some();
    let until = Instant::now() + if is_suspended { SUSPENDED_TIMEOUT } else { ANSWER_TIMEOUT };
    loop {
        let reply = ask_once(&path, request, until).map_err(|error| with_reason(domain, error))?;
        let Some(reply) = reply else {
            return Err(match is_hidden(domain) {
                true => hidden(domain),
                false => RuntimeError::NotRunning(domain.system_id().to_owned()).into(),
            });
        };
        if !matches!(&reply, Reply::Refused(reason) if reason == BUSY) || Instant::now() + BUSY_PAUSE > until
        {
            return Ok(reply);
        }
        std::thread::sleep(BUSY_PAUSE);
    }
}

/// One request and its answer; `None` when nothing is there to answer it.
fn ask_once(path: &Path, request: &Request, until: Instant) -> anyhow::Result<Option<Reply>> {
    let Some(stream) = connect_until(path, until)? else { return Ok(None) };
    // A connection that is refused may be closed before the request is written: its answer contains the reason.
    let _ = write_line(&stream, &serde_json::to_string(request)?, until);
    match read_line(&stream, MAX_ANSWER, until) {
        Ok(Some(line)) => Ok(Some(serde_json::from_str(&line)?)),
        Ok(None) => Ok(None),
        Err(error) if error.kind() == std::io::ErrorKind::ConnectionReset => Ok(None),
        Err(error) => Err(error).context("the orchestrator does not answer"),
    }
}

/// The reason why an orchestrator does not answer, where it is known; exit code 4.
fn with_reason(domain: &Domain, error: anyhow::Error) -> anyhow::Error {
    match suspended_orchestrator(domain) {
        Some(pid) => Failure::process(format!("{error:#}: {}", suspension(pid))),
        None => error,
    }
}

/// A connection to the socket; `None` when nothing listens there.
fn connect_until(path: &Path, until: Instant) -> anyhow::Result<Option<UnixStream>> {
    let Ok(address) = SocketAddrUnix::new(path) else { return Ok(None) };
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
    loop {
        match connect(&socket, &address) {
            Ok(()) => break,
            Err(Errno::INTR) => {}
            // The socket of an orchestrator that is suspended accepts connections until its queue is full.
            Err(Errno::AGAIN) if Instant::now() < until => std::thread::sleep(BUSY_PAUSE),
            Err(Errno::AGAIN) => anyhow::bail!("the orchestrator does not answer"),
            Err(_) => return Ok(None),
        }
    }
    let stream = UnixStream::from(socket);
    stream.set_nonblocking(false)?;
    // The path may be a link to a socket of another user.
    if peer_uid(&stream)? != geteuid().as_raw() {
        return Ok(None);
    }
    Ok(Some(stream))
}

fn socket_path(domain: &Domain) -> PathBuf {
    // By descriptor: the path of a socket may have 107 bytes only.
    domain.folder().by_descriptor("control.sock")
}
