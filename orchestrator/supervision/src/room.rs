//! A reserve of shared memory for one more process, so that a swap or a restart succeeds also when another program
//! has filled `/dev/shm`.

use runtime::{Bus, Reserve, RuntimeError, monotonic_ns};

/// Time between two attempts to get it back [ns].
const RETRY_NS: u64 = 100_000_000;
/// A reserve that is missing for longer than this is reported [ns]: the memory of a process is free only when the last
/// of its readers has noticed that it ended.
const WARN_NS: u64 = 2_000_000_000;

/// The reserve of one orchestrator.
#[derive(Debug)]
pub struct Room {
    /// Its size [bytes].
    bytes: u64,
    reserve: Option<Reserve>,
    retry_ns: u64,
    /// When it could not be taken for the first time.
    missing_ns: Option<u64>,
    warned: bool,
}

impl Room {
    /// No reserve yet, in a system with this scan period.
    pub fn new(period_ns: u64) -> Self {
        let bytes = Reserve::of_a_process(period_ns);
        Self { bytes, reserve: None, retry_ns: 0, missing_ns: None, warned: false }
    }

    /// Frees the reserve for a process that is about to be started.
    ///
    /// # Errors
    /// [`RuntimeError::SharedMemory`] when there was no reserve and there is no room.
    pub fn make(&mut self) -> Result<(), RuntimeError> {
        self.missing_ns = None;
        if self.reserve.take().is_none() {
            Reserve::take(self.bytes)?;
        }
        Ok(())
    }

    /// While the reserve is not held: allocates the memory of new processes, as those in other languages do not, and
    /// takes the reserve again once no process `is_moving`. Returns what is missing, once until it is held again.
    pub fn keep(&mut self, bus: &Bus, is_moving: bool) -> Option<RuntimeError> {
        let now_ns = monotonic_ns();
        if self.reserve.is_some() || now_ns < self.retry_ns {
            return None;
        }
        self.retry_ns = now_ns + RETRY_NS;
        let bytes = self.bytes;
        let reserve = || if is_moving { Ok(None) } else { Reserve::take(bytes).map(Some) };
        match bus.allocate().and_then(|()| reserve()) {
            Ok(None) => None,
            Ok(reserve) => {
                *self = Self { bytes, reserve, retry_ns: 0, missing_ns: None, warned: false };
                None
            }
            Err(error) => {
                let is_new = now_ns - *self.missing_ns.get_or_insert(now_ns) >= WARN_NS && !self.warned;
                self.warned |= is_new;
                is_new.then_some(error)
            }
        }
    }
}
