//! Shared memory for one more process, kept while all is well, so that a swap or a restart finds it also when another
//! program has filled `/dev/shm`.

use runtime::{Reserve, RuntimeError, monotonic_ns};

/// Time between two attempts to get it back [ns].
const RETRY_NS: u64 = 1_000_000_000;

/// The reserve of one orchestrator.
#[derive(Debug, Default)]
pub(crate) struct Room {
    reserve: Option<Reserve>,
    retry_ns: u64,
    warned: bool,
}

impl Room {
    /// Frees the reserve for a process that is about to be started.
    ///
    /// # Errors
    /// [`RuntimeError::SharedMemory`] when there was no reserve and there is no room.
    pub(crate) fn make(&mut self) -> Result<(), RuntimeError> {
        if self.reserve.take().is_none() {
            Reserve::take(Reserve::of_a_process())?;
        }
        Ok(())
    }

    /// Takes the reserve again, if it is not held; returns what is missing, once until it was held again.
    pub(crate) fn keep(&mut self) -> Option<RuntimeError> {
        let now_ns = monotonic_ns();
        if self.reserve.is_some() || now_ns < self.retry_ns {
            return None;
        }
        self.retry_ns = now_ns + RETRY_NS;
        match Reserve::take(Reserve::of_a_process()) {
            Ok(reserve) => {
                (self.reserve, self.warned) = (Some(reserve), false);
                None
            }
            Err(error) => (!std::mem::replace(&mut self.warned, true)).then_some(error),
        }
    }
}
