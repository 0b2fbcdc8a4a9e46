//! Starts a chain, lets it measure once, and takes it down.
//!
//! While messages are on their way the driver sleeps; five times a second it checks that all processes run.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process, kill_process_group};

use crate::peers;
use crate::setup::PROCESSES;
use crate::spawn::prepare;
use crate::wiring::{Files, Wiring};
use crate::{ChainPlan, Contender, HopError, Setup};

/// How long a chain may take until its first message has come through.
const START: Duration = Duration::from_secs(30);
/// How long the last messages may take.
const LATE: Duration = Duration::from_secs(1);
/// How long processes may take to end before they are killed.
const END: Duration = Duration::from_secs(3);
/// Time between two polls of processes that start or end.
const POLL: Duration = Duration::from_millis(2);

/// One chain's latencies, in the order of sending.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Block {
    /// Latency of each message [ns]; 0 when it did not arrive.
    pub latencies_ns: Vec<u64>,
}

impl Block {
    /// How many messages did not arrive.
    pub fn lost(&self) -> u64 {
        self.latencies_ns.iter().filter(|latency| **latency == 0).count() as u64
    }

    /// Latencies of the messages that arrived [ns].
    pub fn arrived_ns(&self) -> impl Iterator<Item = u64> {
        self.latencies_ns.iter().copied().filter(|latency| *latency > 0)
    }
}

/// Runs the chain of a plan once, from the start of its processes to their end.
///
/// # Errors
/// [`HopError::Chain`] when it does not come up or a process of it ends, [`HopError::Interrupted`] when `stop`
/// returns true, and errors of the operating system.
pub fn measure(plan: &ChainPlan, stop: &dyn Fn() -> bool) -> Result<Block, HopError> {
    let mut chain = Chain::start(plan, stop)?;
    chain.connect()?;
    chain.measure()
}

/// A chain whose processes have been started; taken down when dropped.
struct Chain<'a> {
    plan: &'a ChainPlan,
    stop: &'a dyn Fn() -> bool,
    listener: UnixListener,
    ends: Vec<End>,
    children: Vec<Child>,
    // The bus and its files go last.
    wiring: Wiring,
    files: Files,
}

/// The driver's end of the connection to one process.
struct End {
    stream: UnixStream,
    received: Vec<u8>,
    index: Option<usize>,
}

impl<'a> Chain<'a> {
    fn start(plan: &'a ChainPlan, stop: &'a dyn Fn() -> bool) -> Result<Self, HopError> {
        let files = Files::create()?;
        let control = files.directory().join("control");
        let listener = UnixListener::bind(&control).map_err(HopError::system("listen to the processes"))?;
        listener.set_nonblocking(true).map_err(HopError::system("listen to the processes"))?;
        let wiring = Wiring::new(plan, &files)?;
        let setup = |index| Setup {
            contender: plan.contender.name().to_owned(),
            index,
            control: control.clone(),
            payload_bytes: plan.payload.bytes(),
            period_ns: plan.period_ns(),
            warm_up: plan.warm_up,
            samples: plan.samples,
            policy: plan.policy,
            addresses: wiring.addresses.clone(),
        };
        let commands = wiring.commands(plan, &files, setup)?;
        let descriptors = wiring.descriptors();
        let mut chain = Self { plan, stop, listener, ends: Vec::new(), children: Vec::new(), wiring, files };
        for (index, mut command) in commands.into_iter().enumerate() {
            let log = std::fs::File::create(chain.log(index)).map_err(HopError::system("make a log"))?;
            let also = log.try_clone().map_err(HopError::system("make a log"))?;
            command.stdin(Stdio::null()).stdout(also).stderr(log);
            prepare(&mut command, plan.scheduling, &plan.cpus, &descriptors);
            let program = command.get_program().to_string_lossy().into_owned();
            let child = command.spawn().map_err(HopError::system(format!("start {program}")))?;
            chain.children.push(child);
        }
        Ok(chain)
    }

    /// Waits until every process has opened its ports and the first message has come through.
    fn connect(&mut self) -> Result<(), HopError> {
        let started = Instant::now();
        let mut greeted = 0;
        while greeted < PROCESSES {
            self.check(started, START, "the processes do not open their ports")?;
            self.wiring.assist()?;
            match self.listener.accept() {
                Ok((stream, _)) => self.ends.push(End { stream, received: Vec::new(), index: None }),
                Err(error) if error.kind() == ErrorKind::WouldBlock => std::thread::sleep(POLL),
                Err(error) => return Err(HopError::system("listen to the processes")(error)),
            }
            for end in self.ends.iter_mut().filter(|end| end.index.is_none()) {
                let hello = end.line(Duration::from_micros(100))?;
                end.index = hello.and_then(|line| line.strip_prefix("hello ")?.parse().ok());
                greeted += usize::from(end.index.is_some());
            }
        }
        while self.receive(PROCESSES - 1, Duration::from_millis(50))?.as_deref() != Some("seen") {
            self.check(started, START, "no message comes through")?;
        }
        Ok(())
    }

    /// Lets the first process send at its rate and fetches what the last one has measured.
    fn measure(&mut self) -> Result<Block, HopError> {
        let lasts =
            Duration::from_nanos(self.plan.period_ns()) * (self.plan.warm_up + self.plan.samples) as u32;
        self.tell(0, b"g")?;
        let started = Instant::now();
        while self.receive(0, Duration::from_millis(200))?.as_deref() != Some("sent") {
            self.check(started, 2 * lasts + START, "the messages are not sent")?;
        }
        let (sent, last, mut asked) = (Instant::now(), PROCESSES - 1, false);
        loop {
            if let Some(line) = self.receive(last, Duration::from_millis(100))? {
                let count = line.strip_prefix("result ").and_then(|count| count.parse::<usize>().ok());
                let Some(count) = count else { continue };
                let bytes = self.end(last)?.bytes(8 * count)?;
                let (numbers, _) = bytes.as_chunks();
                return Ok(Block {
                    latencies_ns: numbers.iter().map(|number| u64::from_le_bytes(*number)).collect(),
                });
            }
            if sent.elapsed() > LATE && !std::mem::replace(&mut asked, true) {
                self.tell(last, b"f")?;
            }
            self.check(sent, LATE + START, "the last process does not report")?;
        }
    }

    /// An error when a process has ended, the caller wants to stop, or `limit` has passed.
    fn check(&mut self, since: Instant, limit: Duration, what: &str) -> Result<(), HopError> {
        if (self.stop)() {
            return Err(HopError::Interrupted);
        }
        let mut reason = None;
        for (index, child) in self.children.iter_mut().enumerate() {
            if let Ok(Some(status)) = child.try_wait() {
                reason = Some((index, format!("process {index} ended ({status})")));
            }
        }
        if reason.is_none() && since.elapsed() > limit {
            reason = Some((0, what.to_owned()));
        }
        let Some((index, reason)) = reason else { return Ok(()) };
        let log = std::fs::read(self.log(index)).unwrap_or_default();
        let log = String::from_utf8_lossy(&log);
        let last_line = log.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it logged nothing");
        let reason = format!("{reason}: {}", last_line.trim());
        Err(HopError::Chain { contender: self.plan.contender.name(), reason })
    }

    fn log(&self, index: usize) -> PathBuf {
        self.files.directory().join(format!("process{index}.log"))
    }

    fn end(&mut self, index: usize) -> Result<&mut End, HopError> {
        let end = self.ends.iter_mut().find(|end| end.index == Some(index));
        end.ok_or_else(|| HopError::transport("find a process", index))
    }

    fn receive(&mut self, index: usize, timeout: Duration) -> Result<Option<String>, HopError> {
        self.end(index)?.line(timeout)
    }

    fn tell(&mut self, index: usize, word: &[u8]) -> Result<(), HopError> {
        self.end(index)?.stream.write_all(word).map_err(HopError::system("tell a process"))
    }
}

impl Drop for Chain<'_> {
    fn drop(&mut self) {
        self.ends.clear();
        for child in &self.children {
            // Processes that must leave their bus in order do so when the connection is closed; the others are ended.
            let orderly =
                [Contender::Zenoh, Contender::ZenohShm, Contender::Dora].contains(&self.plan.contender);
            if let (false, Some(pid)) = (orderly, Pid::from_raw(child.id().cast_signed())) {
                let _ = kill_process(pid, Signal::TERM);
            }
        }
        let asked = Instant::now();
        while asked.elapsed() < END
            && self.children.iter_mut().any(|child| matches!(child.try_wait(), Ok(None)))
        {
            std::thread::sleep(POLL);
        }
        for child in &mut self.children {
            // The whole group: what a process has started must not outlive it.
            if let Some(pid) = Pid::from_raw(child.id().cast_signed()) {
                let _ = kill_process_group(pid, Signal::KILL);
            }
            let _ = child.wait();
        }
        peers::tidy(self.plan.contender);
    }
}

impl End {
    /// The next line, waiting up to `timeout` for it.
    fn line(&mut self, timeout: Duration) -> Result<Option<String>, HopError> {
        loop {
            if let Some(end) = self.received.iter().position(|byte| *byte == b'\n') {
                let line: Vec<u8> = self.received.drain(..=end).collect();
                return Ok(Some(String::from_utf8_lossy(&line[..end]).into_owned()));
            }
            if !self.read(timeout)? {
                return Ok(None);
            }
        }
    }

    /// So many bytes after a line.
    fn bytes(&mut self, count: usize) -> Result<Vec<u8>, HopError> {
        while self.received.len() < count {
            if !self.read(START)? {
                return Err(HopError::transport("read a report", "it does not end"));
            }
        }
        Ok(self.received.drain(..count).collect())
    }

    /// Reads the waiting bytes; false when none came in time, or none will.
    fn read(&mut self, timeout: Duration) -> Result<bool, HopError> {
        let error = || HopError::system("listen to a process");
        self.stream.set_nonblocking(false).map_err(error())?;
        self.stream.set_read_timeout(Some(timeout)).map_err(error())?;
        let mut bytes = [0; 65_536];
        match self.stream.read(&mut bytes) {
            Ok(0) => {
                // Its process ends, which the next check reports.
                std::thread::sleep(POLL);
                Ok(false)
            }
            Ok(count) => {
                self.received.extend_from_slice(&bytes[..count]);
                Ok(true)
            }
            Err(error)
                if [ErrorKind::WouldBlock, ErrorKind::TimedOut, ErrorKind::Interrupted]
                    .contains(&error.kind()) =>
            {
                Ok(false)
            }
            // Reset by a process that has died: as above.
            Err(error) if error.kind() == ErrorKind::ConnectionReset => Ok(false),
            Err(source) => Err(error()(source)),
        }
    }
}
