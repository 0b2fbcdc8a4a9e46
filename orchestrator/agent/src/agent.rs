//! `scanloop agent`: runs the processes of this host that the orchestrator of another one wants.

#[cfg(test)]
mod tests;

use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::net::{TcpListener, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use anyhow::Context;
use console::exit::{Exit, Failure};
use console::note;
use plan::hosts::Transport;
use runtime::{STOOD_STILL_NS, Shutdown, link_version, monotonic_ns};

use crate::file::AgentFile;
use crate::link::{program, require_private};
use crate::message::{Down, RemoteOrder, RemoteState, Up};
use crate::served::{Served, refusal};

/// Longest sleep.
const POLL: Duration = Duration::from_millis(5);
/// The clock of the orchestrator was answered within this time: messages can come [ms].
const CONNECTED_MS: u64 = 300;
/// Messages of all processes had the time to come when the connection lasts for this long [ns].
const STEADY_NS: u64 = 1_000_000_000;
/// The end of a process is told this often when the agent ends, because a message may be lost.
const LAST_REPEATS: usize = 3;
/// Time between two of these messages.
const LAST_PAUSE: Duration = Duration::from_millis(20);
/// Time before a link that has ended is started again [ns].
const LINK_RESTART_NS: u64 = 500_000_000;

/// A running agent.
struct Agent {
    file: AgentFile,
    logs: PathBuf,
    link: Option<Link>,
    link_ended_ns: u64,
    served: Option<Served>,
    /// The orchestrator's clock minus ours [ns], while it is known.
    offset_ns: Option<i64>,
    /// Since when messages can come without a break [ns].
    connected_ns: Option<u64>,
    watched_ns: u64,
}

/// The program `scanloop-link` of this agent.
struct Link {
    process: Child,
    input: ChildStdin,
    lines: Receiver<String>,
}

/// Serves orchestrators until a signal ends it; what runs here then ends as well. Logs go to `logs`.
///
/// # Errors
/// A bad agent file (exit code 2), an address that is not ours or a missing program (exit code 4).
pub fn run(path: &Path, logs: &Path) -> anyhow::Result<Exit> {
    let file = AgentFile::read(path)?;
    let shutdown = Shutdown::of_orchestrator()?;
    let logs = std::path::absolute(logs)?;
    let link = Some(Link::start(&file)?);
    note!("agent {} listens at {}", file.name, file.endpoint());
    if let Some(warning) = plan::hosts::warning(file.transport, &file.listen) {
        note!("warning: {warning}");
    }
    let mut agent = Agent {
        file,
        logs,
        link,
        link_ended_ns: 0,
        served: None,
        offset_ns: None,
        connected_ns: None,
        watched_ns: monotonic_ns(),
    };
    while !shutdown.requested() {
        agent.take_messages()?;
        agent.watch();
    }
    agent.end_processes();
    agent.end_served();
    Ok(Exit::Done)
}

impl Agent {
    fn take_messages(&mut self) -> anyhow::Result<()> {
        let Some(link) = &self.link else {
            std::thread::sleep(POLL);
            if monotonic_ns().saturating_sub(self.link_ended_ns) > LINK_RESTART_NS {
                // Its address was good before: whatever it is now, it may be over.
                if let Err(error) = self.start_link() {
                    note!("{error:#}; it is tried again");
                    self.link_ended_ns = monotonic_ns();
                }
            }
            return Ok(());
        };
        match link.lines.recv_timeout(POLL) {
            Ok(line) => self.take(&line),
            Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => {
                note!("the link of this host has ended, and is started again");
                self.end_link();
                Ok(())
            }
        }
    }

    fn take(&mut self, line: &str) -> anyhow::Result<()> {
        match line.split_once(' ') {
            Some(("down", text)) => match serde_json::from_str::<Down>(text) {
                Ok(down) => self.obey(&down)?,
                Err(error) => note!("a message was not understood: {error}"),
            },
            Some(("clock", text)) => self.note_clock(text),
            _ => {}
        }
        Ok(())
    }

    /// `unknown`, or offset, bound and the time since the last answer.
    fn note_clock(&mut self, text: &str) {
        let numbers: Vec<i64> = text.split(' ').filter_map(|number| number.parse().ok()).collect();
        let is_connected =
            matches!(numbers.as_slice(), [_, _, silent_ms] if *silent_ms < CONNECTED_MS as i64);
        self.offset_ns = numbers.first().copied();
        self.connected_ns = is_connected.then(|| self.connected_ns.unwrap_or_else(monotonic_ns));
    }

    fn obey(&mut self, down: &Down) -> anyhow::Result<()> {
        if let Some(reason) = self.refuses(down) {
            if down.order == RemoteOrder::Start {
                note!(
                    "{}",
                    runtime::one_line(&format!(
                        "refused {} of system {}: {reason}",
                        down.role, down.system_id
                    ))
                );
            }
            return self.answer(&refusal(down, reason));
        }
        if self.served.as_ref().is_some_and(|served| served.run_id != down.run_id) {
            self.end_served();
        }
        if self.served.is_none() {
            let (RemoteOrder::Start, Some(start)) = (down.order, &down.start) else {
                let (run_id, incarnation) = (down.run_id.clone(), down.incarnation);
                return self.answer(&Up {
                    run_id,
                    incarnation,
                    state: RemoteState::Unknown,
                    stopped: false,
                    wheels: None,
                    last_lines: Vec::new(),
                });
            };
            match Served::new(&self.file.name, down, start) {
                Ok(served) => {
                    note!("serves system {} as {}", served.system_id, served.id());
                    self.say(&format!("join {}", served.id()));
                    self.served = Some(served);
                }
                Err(error) => return self.answer(&refusal(down, format!("{error:#}"))),
            }
        }
        let (offset_ns, logs) = (self.offset_ns, self.logs.clone());
        match self.served.as_mut().and_then(|served| served.obey(down, offset_ns, &logs)) {
            Some(up) => self.answer(&up),
            None => Ok(()),
        }
    }

    /// Why a message is not obeyed.
    fn refuses(&self, down: &Down) -> Option<String> {
        if down.version != link_version() {
            return Some(format!(
                "its agent has version and samples {}, the orchestrator {}; install the same on both",
                link_version(),
                down.version
            ));
        }
        if let Err(reason) = down.check() {
            return Some(reason);
        }
        if let Some(start) = &down.start
            && !self.file.implementations.contains(&start.implementation)
        {
            let (wanted, allowed) = (&start.implementation, self.file.implementations.join(", "));
            return Some(format!("agent.toml: implementations = {wanted} is not allowed: one of {allowed}"));
        }
        // The next run of a system may begin at once, when all of the one before has ended.
        let follows = |served: &Served| served.system_id == down.system_id && served.is_idle();
        let other = self.served.as_ref().filter(|served| served.run_id != down.run_id && served.is_wanted());
        let other = other.filter(|served| !follows(served));
        other.map(|served| format!("its agent serves system {} already", served.system_id))
    }

    fn watch(&mut self) {
        let now_ns = monotonic_ns();
        if now_ns.saturating_sub(std::mem::replace(&mut self.watched_ns, now_ns)) > STOOD_STILL_NS {
            // The messages of that time were not read: no process is forgotten for want of them.
            self.connected_ns = None;
        }
        let could_tell =
            self.connected_ns.is_some_and(|since_ns| now_ns.saturating_sub(since_ns) > STEADY_NS);
        let ended = self.served.as_mut().map_or_else(Vec::new, |served| served.watch(could_tell));
        for up in ended {
            let _ = self.answer(&up);
        }
        if self.served.as_ref().is_some_and(Served::has_ended) {
            self.end_served();
        }
    }

    /// Ends all processes, and tells the orchestrator while the link lives.
    fn end_processes(&mut self) {
        let ended = self.served.as_mut().map_or_else(Vec::new, Served::end);
        for up in ended.iter().cycle().take(LAST_REPEATS * ended.len()) {
            let _ = self.answer(up);
            std::thread::sleep(LAST_PAUSE);
        }
    }

    /// Ends the system, and with it the link, which has joined its bus.
    fn end_served(&mut self) {
        self.end_link();
        self.link_ended_ns = 0;
        if let Some(served) = self.served.take() {
            note!("system {} has ended here", served.system_id);
        }
        (self.offset_ns, self.connected_ns) = (None, None);
    }

    fn start_link(&mut self) -> anyhow::Result<()> {
        self.link = Some(Link::start(&self.file)?);
        if let Some(served) = &self.served {
            served.clean_up();
            let id = served.id().to_owned();
            self.say(&format!("join {id}"));
        }
        Ok(())
    }

    fn end_link(&mut self) {
        if let Some(mut link) = self.link.take() {
            drop(link.input);
            let _ = link.process.kill();
            let _ = link.process.wait();
        }
        self.link_ended_ns = monotonic_ns();
        self.connected_ns = None;
    }

    fn answer(&mut self, up: &Up) -> anyhow::Result<()> {
        let text = serde_json::to_string(up)?;
        self.say(&format!("up {} {text}", up.incarnation));
        Ok(())
    }

    /// A line for the link; one that has ended is noticed by its output.
    fn say(&mut self, line: &str) {
        if let Some(link) = &mut self.link {
            let _ = writeln!(link.input, "{line}").and_then(|()| link.input.flush());
        }
    }
}

impl Link {
    /// Starts the link, and waits until it listens.
    fn start(file: &AgentFile) -> anyhow::Result<Self> {
        let program = program()?;
        let credentials = file.credentials.as_deref();
        let credentials = credentials.map(|folder| require_private(folder, &file.name)).transpose()?;
        let mut process = Command::new(&program)
            .args(["agent", &file.name, &file.endpoint()])
            .args(credentials)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| Failure::process(format!("{}: {error}", program.display())))?;
        let input = process.stdin.take().context("the link has no input")?;
        let output = process.stdout.take().context("the link has no output")?;
        let (sender, lines): (Sender<String>, _) = channel();
        let forward = move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    break;
                }
            }
        };
        if let Err(error) = std::thread::Builder::new().name("link".to_owned()).spawn(forward) {
            let _ = process.kill();
            let _ = process.wait();
            return Err(error.into());
        }
        // It prints why it can't listen, and ends.
        match lines.recv() {
            Ok(_listening) => Ok(Self { process, input, lines }),
            Err(_) => {
                let _ = process.wait();
                let reason = refusal_of_address(file.transport, &file.listen);
                Err(Failure::process(format!("listen = {} can't be used: {reason}", file.listen)))
            }
        }
    }
}

/// Why nothing can listen at an address, as far as this machine tells.
fn refusal_of_address(transport: Transport, listen: &str) -> &'static str {
    let bound = match transport {
        Transport::Tcp => TcpListener::bind(listen).map(drop),
        Transport::Udp | Transport::Quic => UdpSocket::bind(listen).map(drop),
    };
    match bound.map_err(|error| error.kind()) {
        Err(ErrorKind::AddrInUse) => "another program has taken the port; name another one",
        Err(ErrorKind::AddrNotAvailable) => "it is not an address of this machine",
        _ => "see the message of the link",
    }
}
