//! Signals that ask a process to end, as a flag that also ends a wait.
#![expect(unsafe_code, reason = "what a signal handler may do is not checked by the compiler")]

use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use shared_types::Role;
use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};

use crate::RuntimeError;
use crate::StopWord;
use crate::bell::Bells;

/// Whether the process has been asked to end.
#[derive(Debug)]
pub struct Shutdown {
    signals: &'static [i32],
    requested: Arc<AtomicBool>,
    wake: UnixStream,
}

impl Shutdown {
    /// Installs handlers for SIGTERM and SIGINT.
    ///
    /// # Errors
    /// [`RuntimeError::System`] when the handlers can't be installed.
    pub fn on_signals() -> Result<Self, RuntimeError> {
        Self::on(&[SIGTERM, SIGINT])
    }

    /// Installs handlers for all signals by which an operator or a terminal ends an orchestrator: SIGTERM, SIGINT,
    /// SIGQUIT, and SIGHUP unless it is ignored, as under `nohup`.
    ///
    /// # Errors
    /// As [`Shutdown::on_signals`].
    pub fn of_orchestrator() -> Result<Self, RuntimeError> {
        let all: &[i32] = &[SIGTERM, SIGINT, SIGQUIT, SIGHUP];
        Self::on(if is_ignored(SIGHUP) { &all[..3] } else { all })
    }

    /// Lets the signals stop the run at once, before the loop handles them.
    ///
    /// # Errors
    /// As [`Shutdown::on_signals`].
    pub fn latch_also(&self, word: &StopWord) -> Result<(), RuntimeError> {
        let latched = word.clone();
        // SAFETY: latching reads a clock and stores two words of mapped memory; it takes no lock, allocates nothing
        // and does not unwind. The closure keeps the memory mapped.
        unsafe { self.call_also(move || latched.latch()) }?;
        if self.requested() {
            word.latch();
        }
        Ok(())
    }

    /// Installs handlers for other signals.
    pub(crate) fn on(signals: &'static [i32]) -> Result<Self, RuntimeError> {
        let system = |action| move |source| RuntimeError::System { action, source };
        let (wake, end) = UnixStream::pair().map_err(system("make a wake-up socket"))?;
        wake.set_nonblocking(true).map_err(system("make a wake-up socket"))?;
        let requested = Arc::new(AtomicBool::new(false));
        for &signal in signals {
            signal_hook::flag::register(signal, Arc::clone(&requested))
                .map_err(system("listen to signals"))?;
            let end = end.try_clone().map_err(system("make a wake-up socket"))?;
            signal_hook::low_level::pipe::register(signal, end).map_err(system("listen to signals"))?;
        }
        Ok(Self { signals, requested, wake })
    }

    /// Lets the signals also ring the bell of a role, after the flag is set: a process that reads the bell and then
    /// the flag can't sleep through a signal.
    pub(crate) fn ring_also(&self, bells: &Arc<Bells>, role: Role) -> Result<(), RuntimeError> {
        let bells = Arc::clone(bells);
        // SAFETY: ringing is an addition to a word of mapped memory and at most one system call; it takes no lock,
        // allocates nothing and does not unwind. The closure keeps the memory mapped.
        unsafe { self.call_also(move || bells.role(role).ring_all()) }
    }

    /// Calls `action` from the handlers of the signals as well.
    ///
    /// # Safety
    /// `action` must do only what a signal handler may do.
    unsafe fn call_also(
        &self,
        action: impl Fn() + Clone + Send + Sync + 'static,
    ) -> Result<(), RuntimeError> {
        self.signals.iter().try_for_each(|signal| {
            // SAFETY: the caller guarantees it.
            let registered = unsafe { signal_hook::low_level::register(*signal, action.clone()) };
            registered
                .map(|_| ())
                .map_err(|source| RuntimeError::System { action: "listen to signals", source })
        })
    }

    /// Whether a signal has come.
    pub fn requested(&self) -> bool {
        self.requested.load(Ordering::SeqCst)
    }

    /// Readable once a signal has come.
    pub fn descriptor(&self) -> BorrowedFd<'_> {
        self.wake.as_fd()
    }
}

/// Whether a signal is ignored, as this process has inherited it.
fn is_ignored(signal: i32) -> bool {
    // SAFETY: a zeroed `sigaction` is valid, and the call only reads the action that is in force.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        libc::sigaction(signal, std::ptr::null(), &raw mut action) == 0
            && action.sa_sigaction == libc::SIG_IGN
    }
}
