//! The common clock at one host: the own one at the host of the orchestrator, a followed one everywhere else.

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::clock::{HostClock, Offset};

/// The common clock.
#[derive(Debug)]
pub(crate) enum CommonClock {
    /// Ours is the common clock.
    Own,
    /// It is followed by probes of stamps.
    Followed(Mutex<HostClock>),
}

impl CommonClock {
    /// The common clock of a host that is not the orchestrator's.
    pub(crate) fn followed() -> Self {
        Self::Followed(Mutex::new(HostClock::new()))
    }

    /// What is to be added to our time; `None` while the clock is not locked.
    pub(crate) fn offset(&self, now_ns: u64) -> Option<Offset> {
        match self {
            Self::Own => Some(Offset { offset_ns: 0, bound_ns: 0 }),
            Self::Followed(clock) => lock(clock).offset(now_ns),
        }
    }

    /// The clock that follows, unless ours is the common one.
    pub(crate) fn following(&self) -> Option<MutexGuard<'_, HostClock>> {
        match self {
            Self::Own => None,
            Self::Followed(clock) => Some(lock(clock)),
        }
    }
}

fn lock(clock: &Mutex<HostClock>) -> MutexGuard<'_, HostClock> {
    clock.lock().unwrap_or_else(PoisonError::into_inner)
}
