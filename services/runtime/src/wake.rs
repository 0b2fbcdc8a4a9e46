//! Sleeping until something may have happened.
#![expect(unsafe_code, reason = "a listener lends its file descriptor as a bare number")]

use std::os::fd::{BorrowedFd, RawFd};

use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::{FileDescriptorBased, ipc};
use rustix::event::{PollFd, PollFlags, poll};

use crate::clock::timespec;

/// More descriptors than any process of the loop waits on.
const MAX_DESCRIPTORS: usize = 24;

/// Sleeps until one of the descriptors is readable or `timeout_ns` has passed; returns whether one is readable.
///
/// There is no wait without a time-out: iceoryx2 0.10 can lose a wake-up for good. A signal also ends the wait.
/// Descriptors beyond the first 24 are not waited on.
pub fn wait_for(descriptors: &[BorrowedFd<'_>], timeout_ns: u64) -> bool {
    let timeout = timespec(timeout_ns);
    let Some(first) = descriptors.first() else {
        return matches!(poll(&mut [], Some(&timeout)), Ok(ready) if ready > 0);
    };
    let mut set: [PollFd<'_>; MAX_DESCRIPTORS] = std::array::from_fn(|index| {
        PollFd::from_borrowed_fd(*descriptors.get(index).unwrap_or(first), PollFlags::IN)
    });
    let used = descriptors.len().min(MAX_DESCRIPTORS);
    matches!(poll(&mut set[..used], Some(&timeout)), Ok(ready) if ready > 0)
}

/// The descriptor of a listener.
pub(crate) fn descriptor(listener: &Listener<ipc::Service>) -> RawFd {
    // SAFETY: the number is only waited on while the listener that owns it is alive, never closed or read here.
    unsafe { listener.file_descriptor().native_handle() }
}

/// Borrows a descriptor that its owner keeps open for as long as the result is used.
pub(crate) fn borrow(descriptor: RawFd) -> BorrowedFd<'static> {
    // SAFETY: callers are the ports of a process; they hold the listener behind the descriptor and outlive the
    // wait, which is the only use of the result.
    unsafe { BorrowedFd::borrow_raw(descriptor) }
}

/// Takes all notifications, so that the next one wakes again.
///
/// Called after every wake-up and after every time-out: this also heals a lost wake-up.
pub(crate) fn clear(listener: &Listener<ipc::Service>) {
    while matches!(listener.try_wait(|_| {}), Ok(count) if count > 0) {}
}
