//! The guard of a connection, as the driver sees it: starting it, giving it orders, noticing its end.

use std::io::Write;
use std::net::TcpStream;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use runtime::monotonic_ns;
use rustix::net::RecvFlags;

use super::Lost;
use crate::order::{ANSWER, Base, FRAME, Frame, GuardAnswer, GuardOrder};

/// The arguments with which `scanloop` is a guard.
const ARGUMENTS: [&str; 2] = ["service", "player-guard"];
/// Variables of a process of the system. The guard is none: it ends with the driver.
const PREFIX: &str = "SCANLOOP_";
/// The variable that chooses what is logged.
const LOG_VARIABLE: &str = "SCANLOOP_LOG";
/// A guard answers its first order within this time [ns]: a busy machine loads its program slowly.
const START_NS: u64 = 2_000_000_000;
/// A guard whose driver has closed its socket ends within this time, or is killed.
const END: Duration = Duration::from_millis(300);

/// Gives orders to the guard.
#[derive(Debug)]
pub struct Orders {
    socket: UnixStream,
    number: Arc<AtomicU64>,
}

impl Orders {
    /// Gives an order.
    ///
    /// # Errors
    /// The guard has ended, or does not read.
    pub fn give(&self, order: GuardOrder) -> std::io::Result<()> {
        let number = self.number.fetch_add(1, Ordering::SeqCst) + 1;
        let frame = Frame { number, given_ns: monotonic_ns(), order };
        // A guard that does not read is noticed by its missing answers; this process never waits for it.
        match rustix::net::send(&self.socket, &frame.to_bytes(), rustix::net::SendFlags::DONTWAIT) {
            Ok(FRAME) => Ok(()),
            Ok(_) => Err(std::io::ErrorKind::WriteZero.into()),
            Err(error) => Err(error.into()),
        }
    }

    fn try_clone(&self) -> std::io::Result<Self> {
        Ok(Self { socket: self.socket.try_clone()?, number: Arc::clone(&self.number) })
    }
}

/// A running guard.
pub(super) struct Guarded {
    child: Child,
    orders: Orders,
    base: Base,
    timeout_ns: u64,
    answer: GuardAnswer,
    /// Since when an order is known that is not answered [ns].
    waits_since_ns: Option<u64>,
}

impl Guarded {
    /// Starts the guard of a connection.
    pub(super) fn start(
        scanloop: &Path,
        server: &TcpStream,
        base: Base,
        timeout_ns: u64,
    ) -> Result<Self, Lost> {
        let (mine, its) = UnixStream::pair().map_err(Lost::GuardNotStarted)?;
        let output = OwnedFd::from(server.try_clone().map_err(Lost::GuardNotStarted)?);
        let mut command = Command::new(scanloop);
        command.args(ARGUMENTS).stdin(OwnedFd::from(its)).stdout(output).stderr(Stdio::inherit());
        // It survives signals to the group of the driver.
        command.process_group(0);
        let of_system = std::env::vars_os().map(|(name, _)| name).filter(|name| {
            name.to_str().is_some_and(|name| name.starts_with(PREFIX) && name != LOG_VARIABLE)
        });
        of_system.for_each(|name| _ = command.env_remove(name));
        let child = command.spawn().map_err(Lost::GuardNotStarted)?;
        let orders = Orders { socket: mine, number: Arc::default() };
        let guarded =
            Self { child, orders, base, timeout_ns, answer: GuardAnswer::default(), waits_since_ns: None };
        guarded.orders.give(GuardOrder::Guard(base, timeout_ns)).map_err(Lost::GuardNotStarted)?;
        tracing::info!(pid = guarded.child.id(), "the guard of the wheels runs");
        Ok(guarded)
    }

    /// Gives orders to it from another thread.
    pub(super) fn orders(&self) -> Result<Orders, Lost> {
        self.orders.try_clone().map_err(Lost::GuardNotStarted)
    }

    /// Asks for a round of data.
    pub(super) fn ask_for_data(&self) {
        // Whether it works is seen by its answers.
        let _ = self.orders.give(GuardOrder::Round);
    }

    /// Readable when the guard has answered or ended.
    pub(super) fn descriptor(&self) -> BorrowedFd<'_> {
        self.orders.socket.as_fd()
    }

    /// Reads its answers.
    pub(super) fn check(&mut self, now_ns: u64) -> Result<(), Lost> {
        loop {
            let mut bytes = [0; ANSWER];
            match rustix::net::recv(&self.orders.socket, &mut bytes[..], RecvFlags::DONTWAIT) {
                Ok((_, 0)) => return Err(Lost::GuardEnded),
                Ok(_) => self.note(GuardAnswer::from_bytes(&bytes)),
                Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => break,
                Err(_) => return Err(Lost::GuardEnded),
            }
        }
        if self.answer.number >= self.orders.number.load(Ordering::SeqCst) {
            self.waits_since_ns = None;
            return Ok(());
        }
        // Counted from the first check that finds it: this process may have been suspended itself.
        let silent_ns = now_ns.saturating_sub(*self.waits_since_ns.get_or_insert(now_ns));
        let limit_ns = if self.answer.number == 0 { START_NS } else { self.timeout_ns };
        if silent_ns > limit_ns { Err(Lost::GuardSilent(silent_ns / 1_000_000)) } else { Ok(()) }
    }

    fn note(&mut self, answer: GuardAnswer) {
        if answer.stops > self.answer.stops {
            tracing::warn!(stops = answer.stops, "the guard has stopped the wheels: it got no orders");
        }
        self.answer = answer;
    }

    /// Stops the wheels in place of the guard, which does not.
    pub(super) fn stop_instead(&self, mut server: &TcpStream) {
        let mut bytes = Vec::new();
        self.base.stop(&mut bytes);
        let _ = server.write_all(&bytes);
    }
}

impl Drop for Guarded {
    /// Ends the guard, which stops the wheels at its end.
    fn drop(&mut self) {
        let _ = self.orders.socket.shutdown(std::net::Shutdown::Both);
        let end = Instant::now() + END;
        while matches!(self.child.try_wait(), Ok(None)) {
            if Instant::now() >= end {
                let _ = self.child.kill();
                let _ = self.child.wait();
                return;
            }
            runtime::wait_for(&[], 1_000_000);
        }
    }
}
