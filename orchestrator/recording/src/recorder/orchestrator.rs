//! The line to the orchestrator of a run: orders come from the orchestrator by standard input, reports go to standard
//! output.
//!
//! An orchestrator that dies closes both. The recorder then continues until the system ends, because processes drive on
//! and may be adopted.

use std::io::{Read, Stdin, Write, stdin, stdout};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};

use super::queue::Saved;

/// What the orchestrator asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Order {
    /// All publishers exist: make this end of the connections.
    Connect,
    /// The run has ended, and this was its last scan: finish the recording.
    End(u64),
    /// Something happened: write what is in memory.
    Incident,
    /// Somebody asks: write what is in memory into a file for that.
    Keep,
    /// Something to be recorded with the log lines.
    Note(String),
}

/// The line to the orchestrator.
pub(super) struct Orchestrator {
    input: Stdin,
    text: Vec<u8>,
    scan: u64,
    is_open: bool,
}

impl Orchestrator {
    pub(super) fn new() -> anyhow::Result<Self> {
        let input = stdin();
        fcntl_setfl(&input, fcntl_getfl(&input)? | OFlags::NONBLOCK)?;
        let mut orchestrator = Self { input, text: Vec::new(), scan: 0, is_open: true };
        orchestrator.say("attached");
        Ok(orchestrator)
    }

    /// Writes a line, unless the orchestrator is gone.
    pub(super) fn say(&mut self, line: &str) {
        let mut output = stdout().lock();
        let _ = writeln!(output, "{line}").and_then(|()| output.flush());
    }

    /// Reports the newest scan of which all samples were copied.
    pub(super) fn report_scan(&mut self, scan_id: u64) {
        if scan_id > self.scan {
            self.scan = scan_id;
            self.say(&format!("scan {scan_id}"));
        }
    }

    /// Reports a file of an incident that was written, or why it was not.
    pub(super) fn report_saved(&mut self, saved: &Saved) {
        match saved {
            Ok(file) => self.say(&format!("incident {}", file.display())),
            Err(error) => self.say(&format!("unsaved {error}")),
        }
    }

    /// Whether the orchestrator lives, as far as its end of the line shows.
    pub(super) fn is_open(&self) -> bool {
        self.is_open
    }

    /// The next order, if there is one.
    pub(super) fn next_order(&mut self) -> Option<Order> {
        self.read();
        loop {
            let end = self.text.iter().position(|byte| *byte == b'\n')?;
            let line: Vec<u8> = self.text.drain(..=end).collect();
            let line = String::from_utf8_lossy(&line[..end]);
            match line.split_once(' ').unwrap_or((&line, "")) {
                ("connect", _) => return Some(Order::Connect),
                ("end", scan) => return Some(Order::End(scan.parse().unwrap_or(0))),
                ("incident", _) => return Some(Order::Incident),
                ("keep", _) => return Some(Order::Keep),
                ("note", text) => return Some(Order::Note(text.to_owned())),
                _ => {}
            }
        }
    }

    fn read(&mut self) {
        let mut bytes = [0; 4096];
        while self.is_open && self.has_input() {
            match self.input.lock().read(&mut bytes) {
                Ok(0) => self.is_open = false,
                Ok(length) => self.text.extend_from_slice(&bytes[..length]),
                Err(_) => break,
            }
        }
    }

    fn has_input(&self) -> bool {
        let mut descriptors = [PollFd::new(&self.input, PollFlags::IN)];
        matches!(poll(&mut descriptors, Some(&Timespec { tv_sec: 0, tv_nsec: 0 })), Ok(1..))
    }
}
