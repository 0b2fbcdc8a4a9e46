//! Doorbells: one futex in shared memory per reader, on which it sleeps until a sample comes.
//!
//! A publisher increments the counter of each reader of its topic. When a process sleeps there, it asks the kernel to
//! wake it; a sleeper registers the topics it waits for. A reader loads the counter *before* it empties its inputs. It
//! sleeps later only if the counter is still the same, and the kernel compares once more under its own lock. So no
//! sample is slept through, and no notification is left over. Ringing and sleeping cost one system call each.
//!
//! All processes of a role share a bell, also a shadow and a standby: all that sleep there for the topic are woken.
//! Each topic has another bell, for observers, and for readers that ask which of their topics have new samples. There
//! is no lock and no owner. A process that is killed in its sleep stays counted as a sleeper until the system ends.
//! This costs a needless system call per sample, and never a wake-up.
//!
//! Limit: processes in other languages may not ring. They use the events of the bus, see [`crate::waiter`].
#![expect(unsafe_code, reason = "shared memory is mapped from a file")]

use std::fs::File;
use std::num::NonZeroU32;
use std::sync::Arc;
use std::sync::atomic::{AtomicU16, AtomicU32, Ordering};

use rustix::fs::OFlags;
use rustix::thread::futex::{self, Flags};
use shared_types::{ROLES, Role, TOPICS, Topic};

use crate::clock::timespec;
use crate::reserve::allocate;
use crate::shared_memory::Mapped;
use crate::{Domain, RuntimeError};

/// Name of the file in the directory of the bus. It carries the version of the layout: processes with another layout
/// would sleep at other addresses.
const FILE: &str = "doorbells.v2";
/// Processors read memory in lines of this many bytes; two bells never share one.
pub(crate) const LINE: usize = 64;

/// One futex to sleep on.
#[repr(C, align(64))]
pub(crate) struct Bell {
    rung: AtomicU32,
    /// By topic: how many processes sleep here until a sample of it comes.
    sleepers: [AtomicU16; TOPICS.len()],
    /// Bells of topics only: readers of this library that sleep on the events of the topic instead.
    listeners: AtomicU32,
}

/// What is in the file.
#[repr(C)]
struct Page {
    roles: [Bell; ROLES],
    topics: [Bell; TOPICS.len()],
}

const _: () = assert!(size_of::<Bell>() == LINE && size_of::<Page>() <= 4096);

/// All bells of one system.
#[derive(Debug)]
pub(crate) struct Bells(Mapped<Page>);

impl Bell {
    /// The counter that a reader compares later. Load it before the inputs are emptied.
    pub(crate) fn poll(&self) -> u32 {
        self.rung.load(Ordering::SeqCst)
    }

    /// Wakes all sleepers, whatever they wait for. Safe to call from a signal handler.
    pub(crate) fn ring_all(&self) {
        self.count();
        let _ = futex::wake(&self.rung, Flags::empty(), i32::MAX.cast_unsigned());
    }

    /// Wakes the sleepers that wait for a topic.
    fn ring(&self, topic: Topic) {
        self.count();
        self.wake(topic);
    }

    fn count(&self) {
        self.rung.fetch_add(1, Ordering::SeqCst);
    }

    fn wake(&self, topic: Topic) {
        // One order of all four accesses: a sleeper that is not seen here sees the new number and does not sleep.
        if self.sleepers[topic as usize].load(Ordering::SeqCst) > 0
            && let Some(bits) = NonZeroU32::new(bit(topic))
        {
            let _ = futex::wake_bitset(&self.rung, Flags::empty(), i32::MAX.cast_unsigned(), bits);
        }
    }

    /// Leaves the count that a process leaves when it is killed in its sleep.
    #[cfg(test)]
    pub(crate) fn leak_a_sleeper(&self, topic: Topic) {
        self.sleepers[topic as usize].fetch_add(1, Ordering::SeqCst);
    }

    /// Sleeps until the bell is rung for one of `topics` (bits), a signal comes, or `until_ns` of CLOCK_MONOTONIC.
    /// Does not sleep when the bell was rung since `seen`. Returns whether it ended before that time.
    pub(crate) fn sleep(&self, seen: u32, until_ns: u64, topics: u32) -> bool {
        let Some(bits) = NonZeroU32::new(topics) else { return true };
        if self.poll() != seen {
            return true;
        }
        self.sleepers(topics).for_each(|sleepers| _ = sleepers.fetch_add(1, Ordering::SeqCst));
        let slept = futex::wait_bitset(&self.rung, Flags::empty(), seen, Some(&timespec(until_ns)), bits);
        self.sleepers(topics).for_each(|sleepers| _ = sleepers.fetch_sub(1, Ordering::SeqCst));
        slept != Err(rustix::io::Errno::TIMEDOUT)
    }

    fn sleepers(&self, topics: u32) -> impl Iterator<Item = &AtomicU16> {
        self.sleepers
            .iter()
            .enumerate()
            .filter(move |(topic, _)| topics & (1 << topic) != 0)
            .map(|(_, count)| count)
    }
}

impl Bells {
    /// Creates the page of a system, or opens an existing one, on which its processes may sleep.
    pub(crate) fn create(domain: &Domain) -> Result<Arc<Self>, RuntimeError> {
        let folder = domain.bus_folder()?;
        let error = |source| RuntimeError::file(folder.path().join(FILE), source);
        let file = folder.open_file(FILE, OFlags::RDWR | OFlags::CREATE).map_err(error)?;
        let length = size_of::<Page>() as u64;
        allocate(&file, length, length)?;
        Self::map(&file).map_err(error)
    }

    /// Opens the page of a running system.
    pub(crate) fn open(domain: &Domain) -> Result<Arc<Self>, RuntimeError> {
        let folder = domain.bus_folder()?;
        let error = |source| RuntimeError::file(folder.path().join(FILE), source);
        let file = folder.open_file(FILE, OFlags::RDWR).map_err(error)?;
        if file.metadata().map_err(error)?.len() < size_of::<Page>() as u64 {
            return Err(error(std::io::Error::other("the doorbells are not finished")));
        }
        Self::map(&file).map_err(error)
    }

    /// The bell of a role.
    pub(crate) fn role(&self, role: Role) -> &Bell {
        &self.0.roles[role.index()]
    }

    /// The bell of the observers of a topic.
    pub(crate) fn topic(&self, topic: Topic) -> &Bell {
        &self.0.topics[topic as usize]
    }

    /// Rings for all readers of a topic.
    pub(crate) fn ring(&self, topic: Topic) {
        // First: a woken reader asks this bell which topics have new samples.
        self.topic(topic).count();
        for role in Role::ALL {
            if topic == Topic::Directive || role.reads().contains(&topic) {
                self.role(*role).ring(topic);
            }
        }
        self.topic(topic).wake(topic);
    }

    /// Counts a reader that starts or stops to sleep on the events of a topic. One that is killed stays counted, which
    /// costs needless notifications until the system ends.
    pub(crate) fn listens(&self, topic: Topic, on: bool) {
        let listeners = &self.topic(topic).listeners;
        if on {
            listeners.fetch_add(1, Ordering::SeqCst);
        } else {
            listeners.fetch_sub(1, Ordering::SeqCst);
        }
    }

    /// Whether a reader of this library sleeps on the events of a topic.
    pub(crate) fn has_listeners(&self, topic: Topic) -> bool {
        self.topic(topic).listeners.load(Ordering::SeqCst) > 0
    }

    fn map(file: &File) -> std::io::Result<Arc<Self>> {
        // SAFETY: atomics only; callers ensure that the file is as large as the page, and it is never made smaller.
        Ok(Arc::new(Self(unsafe { Mapped::new(file) }?)))
    }
}

/// The bit by which a sleeper registers a topic.
pub(crate) const fn bit(topic: Topic) -> u32 {
    1 << topic as u32
}
