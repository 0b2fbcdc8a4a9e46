//! The floor: the lowest cost of a hop when processes sleep. A ring in shared memory and one wake-up.
//!
//! A hop takes two system calls, one that wakes and one that sleeps: write and read of an eventfd, or two of a futex.
//! There is no header, no counter, no observer, and no way to join later, so it is not usable as a bus.
#![expect(unsafe_code, reason = "descriptors inherited from the driver arrive as bare numbers")]

use std::os::fd::{AsFd, FromRawFd, OwnedFd, RawFd};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::thread::futex;

use crate::message::{Arrival, Stamp};
use crate::policy::MAX_WAIT_NS;
use crate::ring::Ring;
use crate::stage::ChainStage;
use crate::{HopError, Setup};

/// A ring and how its reader is woken.
struct End {
    ring: Ring,
    payload: usize,
    /// `None` for the futex in the ring.
    event: Option<OwnedFd>,
}

/// The ports of one process.
pub(crate) struct Floor {
    inlet: Option<End>,
    outlet: Option<End>,
}

impl Floor {
    /// Opens the ends that the setup names: `MEMORY,EVENT` or `MEMORY` as numbers of descriptors.
    pub(crate) fn open(setup: &Setup) -> Result<Self, HopError> {
        let end = |address: Option<&str>, payload| address.map(|text| End::open(text, payload)).transpose();
        Ok(Self {
            inlet: end(setup.inlet(), setup.inlet_bytes())?,
            outlet: end(setup.outlet(), setup.outlet_bytes())?,
        })
    }
}

impl End {
    fn open(address: &str, payload: usize) -> Result<Self, HopError> {
        let mut descriptors = address.split(',').map(inherited);
        let memory =
            descriptors.next().ok_or_else(|| HopError::Setup(format!("no address: `{address}`")))??;
        let event = descriptors.next().transpose()?;
        Ok(Self { ring: Ring::map(memory.as_fd(), payload)?, payload, event })
    }

    fn wake(&self) {
        match &self.event {
            Some(event) => {
                let _ = rustix::io::write(event, &1_u64.to_ne_bytes());
            }
            None => {
                let _ = futex::wake(&self.ring.bell().strokes, futex::Flags::empty(), 1);
            }
        }
    }

    fn sleep(&self, strokes: u32, timeout_ns: Option<u64>) {
        match (&self.event, timeout_ns) {
            (Some(event), None) => {
                let _ = rustix::io::read(event, &mut [0_u8; 8]);
            }
            (Some(event), Some(timeout_ns)) => {
                let mut events = [PollFd::new(event, PollFlags::IN)];
                if matches!(poll(&mut events, Some(&time(timeout_ns))), Ok(1)) {
                    let _ = rustix::io::read(event, &mut [0_u8; 8]);
                }
            }
            (None, timeout_ns) => {
                let longest = time(timeout_ns.unwrap_or(MAX_WAIT_NS));
                let bell = &self.ring.bell().strokes;
                let _ = futex::wait(bell, futex::Flags::empty(), strokes, Some(&longest));
            }
        }
    }
}

impl ChainStage for Floor {
    fn send(&mut self, stamp: Stamp) -> Result<(), HopError> {
        if let Some(outlet) = &self.outlet
            && outlet.ring.write(outlet.payload, |message| stamp.write(message))
            && outlet.ring.ring()
        {
            outlet.wake();
        }
        Ok(())
    }

    fn take(&mut self) -> Option<Arrival> {
        let inlet = self.inlet.as_ref()?;
        inlet.ring.read(inlet.payload, Stamp::read)?.map(Arrival::now)
    }

    fn poll(&mut self) -> bool {
        self.inlet.as_ref().is_some_and(|inlet| inlet.ring.has_message())
    }

    fn block(&mut self, timeout_ns: Option<u64>) {
        if let Some(inlet) = &self.inlet {
            inlet.ring.sleep_unless_rung(|strokes| inlet.sleep(strokes, timeout_ns));
        }
    }
}

/// A descriptor that the driver has left open for this process.
pub(crate) fn inherited(number: &str) -> Result<OwnedFd, HopError> {
    let number: RawFd =
        number.parse().map_err(|_| HopError::Setup(format!("`{number}` is no descriptor")))?;
    rustix::io::fcntl_getfd(borrow(number))
        .map_err(|error| HopError::system("use a descriptor")(error.into()))?;
    // SAFETY: the number is open, was made for this process by the driver, and is taken once.
    Ok(unsafe { OwnedFd::from_raw_fd(number) })
}

fn borrow(number: RawFd) -> std::os::fd::BorrowedFd<'static> {
    // SAFETY: only asked whether it is open; a number of -1 is refused by parsing the address of the driver.
    unsafe { std::os::fd::BorrowedFd::borrow_raw(number.max(0)) }
}

fn time(timeout_ns: u64) -> Timespec {
    Timespec { tv_sec: (timeout_ns / 1_000_000_000) as i64, tv_nsec: (timeout_ns % 1_000_000_000) as i64 }
}
