//! SIGTERM and SIGINT as a flag that also ends a wait.

use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};

use crate::RuntimeError;

/// Whether the process has been asked to end.
#[derive(Debug)]
pub struct Shutdown {
    requested: Arc<AtomicBool>,
    wake: UnixStream,
}

impl Shutdown {
    /// Starts listening to SIGTERM and SIGINT.
    ///
    /// # Errors
    /// [`RuntimeError::System`] when the handlers can't be installed.
    pub fn on_signals() -> Result<Self, RuntimeError> {
        let system = |action| move |source| RuntimeError::System { action, source };
        let (wake, end) = UnixStream::pair().map_err(system("make a wake-up socket"))?;
        wake.set_nonblocking(true).map_err(system("make a wake-up socket"))?;
        let requested = Arc::new(AtomicBool::new(false));
        for signal in [SIGTERM, SIGINT] {
            signal_hook::flag::register(signal, Arc::clone(&requested))
                .map_err(system("listen to signals"))?;
            let end = end.try_clone().map_err(system("make a wake-up socket"))?;
            signal_hook::low_level::pipe::register(signal, end).map_err(system("listen to signals"))?;
        }
        Ok(Self { requested, wake })
    }

    /// Whether a signal has come.
    pub fn requested(&self) -> bool {
        self.requested.load(Ordering::Relaxed)
    }

    /// Readable once a signal has come.
    pub fn descriptor(&self) -> BorrowedFd<'_> {
        self.wake.as_fd()
    }
}
