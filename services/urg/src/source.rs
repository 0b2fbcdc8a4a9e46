//! A scanner as a source of scans: the conversation with its connection.

use std::os::fd::{AsFd, BorrowedFd};

use device_clock::DeviceClock;
use shared_types::Scan;

use crate::UrgError;
use crate::identity::ScannerIdentity;
use crate::link::{Link, Read};
use crate::place::ScannerConfig;
use crate::session::ScannerSession;
use crate::state::{Counters, Reading, SourceState};

/// A lost connection is made again after this time [ns].
const RECONNECT_NS: u64 = 500_000_000;
/// A connection that is not made within this time is given up, and the next address of the name is tried [ns].
const CONNECT_NS: u64 = 2_000_000_000;
/// Bytes that one read takes: nearly four scans.
const BUFFER: usize = 8192;
/// Reads of one step: a scanner that floods the line does not keep it busy for ever.
const READS: usize = 8;

/// A scanner that is connected to, started, and read.
///
/// No call blocks longer than it is told, except for the resolution of a host's name.
#[derive(Debug)]
pub struct ScannerConnection {
    config: ScannerConfig,
    now_ns: fn() -> u64,
    session: ScannerSession,
    link: Option<Link>,
    is_connected: bool,
    /// When to connect, or to give up connecting [ns].
    retry_ns: u64,
    failed_connections: u64,
    buffer: Box<[u8; BUFFER]>,
    /// What of the buffer was read and not taken, and when it arrived [ns].
    pending: std::ops::Range<usize>,
    arrived_ns: u64,
}

impl ScannerConnection {
    /// A source that will connect with the first call of [`Self::next`]; `now_ns` reads CLOCK_MONOTONIC.
    pub fn open(config: ScannerConfig, now_ns: fn() -> u64) -> Self {
        Self {
            session: ScannerSession::new(config.clone()),
            config,
            now_ns,
            link: None,
            is_connected: false,
            retry_ns: 0,
            failed_connections: 0,
            buffer: Box::new([0; BUFFER]),
            pending: 0..0,
            arrived_ns: 0,
        }
    }

    /// Waits for the next scan, but not longer than `timeout_ns`, and fills ranges, times and `header.acquired_ns`.
    ///
    /// `None` is no error: [`Self::state`] and [`Self::message`] tell why there is no scan.
    ///
    /// # Errors
    /// A model that can't be used.
    pub fn next(&mut self, timeout_ns: u64, scan: &mut Scan) -> Result<Option<Reading>, UrgError> {
        let until_ns = (self.now_ns)().saturating_add(timeout_ns);
        loop {
            if let Some(reading) = self.step(scan)? {
                return Ok(Some(reading));
            }
            let now_ns = (self.now_ns)();
            if now_ns >= until_ns || self.is_identified() {
                return Ok(None);
            }
            self.wait(until_ns.min(self.due_ns()).saturating_sub(now_ns));
        }
    }

    /// Does what is due and returns at once: for a process that waits for other events too, with
    /// [`Self::descriptor`] and [`Self::due_ns`].
    ///
    /// # Errors
    /// As [`Self::next`].
    pub fn step(&mut self, scan: &mut Scan) -> Result<Option<Reading>, UrgError> {
        for _ in 0..READS {
            // Bytes that an earlier call has left come first.
            if self.pending.is_empty() && !self.read() {
                break;
            }
            if let Some(reading) = self.take(scan)? {
                return Ok(Some(reading));
            }
            self.send();
        }
        let now_ns = (self.now_ns)();
        self.connect(now_ns);
        self.session.poll(now_ns);
        self.send();
        if self.session.gave_up() && !self.is_identified() {
            let reason = self.session.message().to_owned();
            self.close(&reason);
        }
        Ok(None)
    }

    /// What can be waited for: bytes of the scanner. It changes with each connection.
    pub fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        self.link.as_ref().filter(|_| self.is_connected).map(AsFd::as_fd)
    }

    /// When [`Self::step`] has something to do without bytes of the scanner [ns].
    pub fn due_ns(&self) -> u64 {
        if self.is_connected { self.session.due_ns() } else { self.retry_ns }
    }

    /// What the scanner does.
    pub fn state(&self) -> SourceState {
        self.session.state()
    }

    /// Why it does not measure; empty when it does.
    pub fn message(&self) -> &str {
        self.session.message()
    }

    /// What the scanner has told about itself.
    pub fn identity(&self) -> &ScannerIdentity {
        self.session.identity()
    }

    /// Counters since the start.
    pub fn counters(&self) -> Counters {
        self.session.counters()
    }

    /// Connections that failed or were lost.
    pub fn failed_connections(&self) -> u64 {
        self.failed_connections
    }

    /// The mapping of its stamps, once its parameters are known.
    pub fn clock(&self) -> Option<&DeviceClock> {
        self.session.clock()
    }

    /// Whether all questions of a source that only identifies are answered.
    pub fn is_identified(&self) -> bool {
        self.config.identify_only && self.is_connected && self.session.gave_up() && self.message().is_empty()
    }

    /// Takes bytes that were read, until a scan is complete.
    fn take(&mut self, scan: &mut Scan) -> Result<Option<Reading>, UrgError> {
        let bytes = &self.buffer[self.pending.clone()];
        let (count, reading) = self.session.receive(bytes, self.arrived_ns, scan)?;
        self.pending.start += count;
        Ok(reading)
    }

    /// Reads once; false when there was nothing.
    fn read(&mut self) -> bool {
        let Some(link) = self.link.as_ref().filter(|_| self.is_connected) else { return false };
        match link.read(&mut self.buffer[..]) {
            Read::Bytes(count) => {
                (self.pending, self.arrived_ns) = (0..count, (self.now_ns)());
                true
            }
            Read::Nothing => false,
            Read::Closed(error) => {
                self.close(&error.to_string());
                false
            }
        }
    }

    fn send(&mut self) {
        let Some(link) = self.link.as_ref().filter(|_| self.is_connected) else { return };
        if self.session.output().is_empty() {
            return;
        }
        match link.write(self.session.output()) {
            Ok(count) => self.session.sent(count),
            Err(error) => self.close(&error.to_string()),
        }
    }

    /// Makes the connection, or goes one step towards it.
    fn connect(&mut self, now_ns: u64) {
        if self.is_connected {
            return;
        }
        let Some(link) = &mut self.link else {
            if now_ns >= self.retry_ns {
                self.retry_ns = now_ns.saturating_add(CONNECT_NS);
                match Link::open(&self.config.place, self.config.bit_rate) {
                    Ok(link) => self.link = Some(link),
                    Err(error) => return self.close(&error.to_string()),
                }
                self.connect(now_ns);
            }
            return;
        };
        match link.is_made() {
            Ok(true) => {
                self.is_connected = true;
                self.session.connected(now_ns);
            }
            Ok(false) if now_ns < self.retry_ns => {}
            Ok(false) => {
                let late =
                    std::io::Error::new(std::io::ErrorKind::TimedOut, "the connection is not made in time");
                match link.try_next(late) {
                    Ok(()) => self.retry_ns = now_ns.saturating_add(CONNECT_NS),
                    Err(error) => self.close(&error.to_string()),
                }
            }
            Err(error) => self.close(&error.to_string()),
        }
    }

    fn close(&mut self, reason: &str) {
        (self.link, self.is_connected, self.pending) = (None, false, 0..0);
        self.retry_ns = (self.now_ns)().saturating_add(RECONNECT_NS);
        self.failed_connections += 1;
        self.session.disconnected(&format!("{}: {reason}", self.config.place));
    }

    fn wait(&self, limit_ns: u64) {
        match &self.link {
            // An error shows in the next read.
            Some(link) => drop(link.wait_for_input(limit_ns)),
            None => pause(limit_ns),
        }
    }
}

impl Drop for ScannerConnection {
    /// Switches the laser off, if that is possible.
    fn drop(&mut self) {
        if let Some(link) = self.link.as_ref().filter(|_| self.is_connected) {
            let _ = link.write(b"QT\n");
        }
    }
}

/// Waits without a connection.
fn pause(limit_ns: u64) {
    let limit_ns = limit_ns.min(i64::MAX as u64).cast_signed();
    let limit =
        rustix::event::Timespec { tv_sec: limit_ns / 1_000_000_000, tv_nsec: limit_ns % 1_000_000_000 };
    let _ = rustix::event::poll(&mut [], Some(&limit));
}
