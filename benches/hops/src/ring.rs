//! Slots in shared memory between one writer and one reader, messages written and read in place, and a bell.
//!
//! The writer fills the next free slot and counts `written` up, the reader uses the oldest and counts `taken` up: a
//! queue without locks for exactly one writer and one reader, as each hop of the chain has. A full queue refuses the
//! message.
#![expect(unsafe_code, reason = "memory shared between processes")]

use std::os::fd::BorrowedFd;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering, fence};

use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

use crate::HopError;

/// Largest number of waiting messages: that of a reader of the bus.
const SLOTS: u64 = 16;
/// Where the slots begin: a page for the counters.
const SLOTS_AT: usize = 4096;

/// The counters, each on a cache line of its own.
#[repr(C, align(64))]
struct Counter(AtomicU64);

#[repr(C)]
struct Head {
    written: Counter,
    taken: Counter,
    bell: Bell,
}

/// What the reader sleeps on, on a cache line of its own.
#[repr(C, align(64))]
pub(crate) struct Bell {
    /// Changes with every message that is rung for.
    pub(crate) strokes: AtomicU32,
    /// 1 while the reader sleeps or is about to.
    asleep: AtomicU32,
}

/// One process's view of the memory.
pub(crate) struct Ring {
    memory: *mut u8,
    bytes: usize,
    stride: usize,
}

impl Ring {
    /// Memory that a ring for messages of `payload` bytes needs.
    pub(crate) fn bytes(payload: usize) -> usize {
        SLOTS_AT + SLOTS as usize * stride(payload)
    }

    /// Maps memory of [`Ring::bytes`] that was zero at first.
    pub(crate) fn map(memory: BorrowedFd<'_>, payload: usize) -> Result<Self, HopError> {
        let bytes = Self::bytes(payload);
        let (access, shared) = (ProtFlags::READ | ProtFlags::WRITE, MapFlags::SHARED | MapFlags::POPULATE);
        // SAFETY: a new mapping at an address of the kernel's choice; no memory of this process is replaced.
        let mapped = unsafe { mmap(std::ptr::null_mut(), bytes, access, shared, memory, 0) };
        let memory = mapped.map_err(|error| HopError::system("map shared memory")(error.into()))?.cast();
        Ok(Self { memory, bytes, stride: stride(payload) })
    }

    /// Writes a message in place; false when all slots are taken.
    pub(crate) fn write(&self, payload: usize, fill: impl FnOnce(&mut [u8])) -> bool {
        let head = self.head();
        let written = head.written.0.load(Ordering::Relaxed);
        if written - head.taken.0.load(Ordering::Acquire) >= SLOTS {
            return false;
        }
        // SAFETY: the slot lies inside of the mapping, and the reader does not touch it until `written` says so.
        fill(unsafe { std::slice::from_raw_parts_mut(self.slot(written), payload) });
        head.written.0.store(written + 1, Ordering::Release);
        true
    }

    /// Hands the oldest message to `read` in place; `None` when there is none.
    pub(crate) fn read<T>(&self, payload: usize, read: impl FnOnce(&[u8]) -> T) -> Option<T> {
        let head = self.head();
        let taken = head.taken.0.load(Ordering::Relaxed);
        if head.written.0.load(Ordering::Acquire) == taken {
            return None;
        }
        // SAFETY: the slot lies inside of the mapping, and the writer does not touch it until `taken` says so.
        let result = read(unsafe { std::slice::from_raw_parts(self.slot(taken), payload) });
        head.taken.0.store(taken + 1, Ordering::Release);
        Some(result)
    }

    /// Whether there is a message.
    pub(crate) fn has_message(&self) -> bool {
        let head = self.head();
        head.written.0.load(Ordering::Acquire) != head.taken.0.load(Ordering::Relaxed)
    }

    /// After a message was written: counts the stroke and returns whether the reader must be woken.
    pub(crate) fn ring(&self) -> bool {
        let bell = self.bell();
        bell.strokes.fetch_add(1, Ordering::Release);
        // Pairs with the fence of `sleep_unless_rung`: one of the two sees what the other has stored.
        fence(Ordering::SeqCst);
        bell.asleep.load(Ordering::Relaxed) != 0
    }

    /// Calls `sleep` with the strokes so far unless a message is there; `sleep` must end at the next stroke.
    pub(crate) fn sleep_unless_rung(&self, sleep: impl FnOnce(u32)) {
        let bell = self.bell();
        let strokes = bell.strokes.load(Ordering::Acquire);
        bell.asleep.store(1, Ordering::Relaxed);
        fence(Ordering::SeqCst);
        if !self.has_message() {
            sleep(strokes);
        }
        bell.asleep.store(0, Ordering::Relaxed);
    }

    /// What the reader sleeps on.
    pub(crate) fn bell(&self) -> &Bell {
        &self.head().bell
    }

    fn head(&self) -> &Head {
        // SAFETY: the mapping is page aligned, larger than a head and lives as long as `self`; the fields are atomic,
        // and all bit patterns are values of theirs.
        unsafe { &*self.memory.cast::<Head>() }
    }

    fn slot(&self, number: u64) -> *mut u8 {
        // SAFETY: a slot number modulo the number of slots lies inside of the mapping.
        unsafe { self.memory.add(SLOTS_AT + (number % SLOTS) as usize * self.stride) }
    }
}

impl Drop for Ring {
    fn drop(&mut self) {
        // SAFETY: exactly what was mapped; references into it have ended with `self`.
        let _ = unsafe { munmap(self.memory.cast(), self.bytes) };
    }
}

/// Distance between two slots: whole cache lines.
fn stride(payload: usize) -> usize {
    payload.next_multiple_of(64)
}

#[cfg(test)]
mod tests {
    use std::os::fd::AsFd;

    use rustix::fs::{MemfdFlags, ftruncate, memfd_create};

    use super::*;

    #[test]
    fn messages_come_in_order_and_a_full_ring_refuses() {
        let memory = memfd_create("ring", MemfdFlags::CLOEXEC).unwrap();
        ftruncate(&memory, Ring::bytes(24) as u64).unwrap();
        // Two mappings of the same memory, as two processes have.
        let (writer, reader) =
            (Ring::map(memory.as_fd(), 24).unwrap(), Ring::map(memory.as_fd(), 24).unwrap());
        assert!(!reader.has_message());
        for lap in 0..3_u8 {
            for number in 0..SLOTS as u8 {
                assert!(writer.write(24, |slot| slot.fill(lap * 16 + number)));
            }
            assert!(!writer.write(24, |_| ()), "no slot is free");
            for number in 0..SLOTS as u8 {
                assert_eq!(reader.read(24, |slot| slot[23]), Some(lap * 16 + number));
            }
            assert_eq!(reader.read(24, |_| ()), None);
        }
    }

    #[test]
    fn only_a_reader_that_sleeps_is_woken() {
        let memory = memfd_create("ring", MemfdFlags::CLOEXEC).unwrap();
        ftruncate(&memory, Ring::bytes(24) as u64).unwrap();
        let ring = Ring::map(memory.as_fd(), 24).unwrap();
        assert!(!ring.ring());
        let mut woken = false;
        ring.sleep_unless_rung(|strokes| {
            woken = ring.ring() && ring.bell().strokes.load(Ordering::Relaxed) != strokes
        });
        assert!(woken);
        ring.write(24, |_| ());
        ring.sleep_unless_rung(|_| panic!("a message is there"));
    }
}
