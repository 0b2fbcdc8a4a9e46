//! A guard, as its driver sees it: starting it, giving it orders, noticing its end.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use runtime::monotonic_ns;
use rustix::net::RecvFlags;

use crate::order::{ANSWER, FRAME, Frame, GuardAnswer, GuardOrder};

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

/// What is wrong with a guard.
#[derive(Debug, thiserror::Error)]
pub enum GuardFault {
    /// It could not be started.
    #[error("the guard of the wheels could not be started: {0}")]
    NotStarted(std::io::Error),
    /// It has ended.
    #[error("the guard of the wheels has ended: the driver has stopped the wheels")]
    Ended,
    /// It hangs.
    #[error("the guard of the wheels has not answered for {0} ms: the driver has stopped the wheels")]
    Silent(u64),
}

/// A running guard.
#[derive(Debug)]
pub struct Held {
    child: Child,
    orders: Orders,
    timeout_ns: u64,
    answer: GuardAnswer,
    /// Since when an order is known that is not answered [ns].
    waits_since_ns: Option<u64>,
}

impl Held {
    /// Starts the guard by a command, whose standard input it gets; `guarded` is a number that it hands to its connection.
    ///
    /// # Errors
    /// [`GuardFault::NotStarted`].
    pub fn start(mut command: Command, guarded: u64, timeout_ns: u64) -> Result<Self, GuardFault> {
        let (mine, its) = UnixStream::pair().map_err(GuardFault::NotStarted)?;
        command.stdin(OwnedFd::from(its)).stderr(Stdio::inherit());
        // It survives signals to the group of the driver.
        command.process_group(0);
        let of_system = std::env::vars_os().map(|(name, _)| name).filter(|name| {
            name.to_str().is_some_and(|name| name.starts_with(PREFIX) && name != LOG_VARIABLE)
        });
        of_system.for_each(|name| _ = command.env_remove(name));
        let child = command.spawn().map_err(GuardFault::NotStarted)?;
        let orders = Orders { socket: mine, number: Arc::default() };
        let held = Self { child, orders, timeout_ns, answer: GuardAnswer::default(), waits_since_ns: None };
        held.orders.give(GuardOrder::Guard(guarded, timeout_ns)).map_err(GuardFault::NotStarted)?;
        tracing::info!(pid = held.child.id(), "the guard of the wheels runs");
        Ok(held)
    }

    /// Gives orders to it from another thread.
    ///
    /// # Errors
    /// [`GuardFault::NotStarted`].
    pub fn orders(&self) -> Result<Orders, GuardFault> {
        self.orders.try_clone().map_err(GuardFault::NotStarted)
    }

    /// Gives an order; whether the guard takes it is seen by its answers.
    pub fn give(&self, order: GuardOrder) {
        let _ = self.orders.give(order);
    }

    /// Whether it has answered: its connection is open.
    pub fn is_ready(&self) -> bool {
        self.answer.number > 0
    }

    /// Readable when the guard has answered or ended.
    pub fn descriptor(&self) -> BorrowedFd<'_> {
        self.orders.socket.as_fd()
    }

    /// Reads its answers.
    ///
    /// # Errors
    /// [`GuardFault::Ended`] and [`GuardFault::Silent`]: the driver has to stop the wheels.
    pub fn check(&mut self, now_ns: u64) -> Result<(), GuardFault> {
        loop {
            let mut bytes = [0; ANSWER];
            match rustix::net::recv(&self.orders.socket, &mut bytes[..], RecvFlags::DONTWAIT) {
                Ok((_, 0)) => return Err(GuardFault::Ended),
                Ok(_) => self.note(GuardAnswer::from_bytes(&bytes)),
                Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => break,
                Err(_) => return Err(GuardFault::Ended),
            }
        }
        if self.answer.number >= self.orders.number.load(Ordering::SeqCst) {
            self.waits_since_ns = None;
            return Ok(());
        }
        // Counted from the first check that finds it: this process may have been suspended itself.
        let silent_ns = now_ns.saturating_sub(*self.waits_since_ns.get_or_insert(now_ns));
        let limit_ns = if self.answer.number == 0 { START_NS } else { self.timeout_ns };
        if silent_ns > limit_ns { Err(GuardFault::Silent(silent_ns / 1_000_000)) } else { Ok(()) }
    }

    fn note(&mut self, answer: GuardAnswer) {
        if answer.stops > self.answer.stops {
            tracing::warn!(stops = answer.stops, "the guard has stopped the wheels: it got no orders");
        }
        self.answer = answer;
    }
}

impl Drop for Held {
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
