//! A process that runs out of shared memory says so before it ends.
//!
//! The kernel reports a page that it can't provide by SIGBUS, whose default ends a process without a word. The handler
//! writes one line to standard error, which is the log of the process, and gives the signal to the one before it.
#![expect(unsafe_code, reason = "a signal that comes from a fault needs a handler of the system's own kind")]

use std::cell::UnsafeCell;
use std::mem::MaybeUninit;
use std::sync::Once;

/// What the handler writes.
const LINE: &[u8] = b"shared memory ran out or was cut off (SIGBUS): see `df /dev/shm`\n";

/// What was set for SIGBUS before.
static BEFORE: Before = Before(UnsafeCell::new(MaybeUninit::zeroed()));
static INSTALLED: Once = Once::new();

struct Before(UnsafeCell<MaybeUninit<libc::sigaction>>);

// SAFETY: written once, in `report_crashes` before the handler is set; from then on only read, by the handler.
unsafe impl Sync for Before {}

/// Lets SIGBUS write a line to standard error before it does what it did before. Once per process; a kernel that
/// refuses leaves everything as it is.
pub fn report_crashes() {
    INSTALLED.call_once(|| {
        // SAFETY: the structure is zeroed, which is a valid value of plain C fields, and filled as sigaction(2) asks; the
        // handler has the signature that SA_SIGINFO asks for. `BEFORE` is written here only, before a handler reads it.
        unsafe {
            if libc::sigaction(libc::SIGBUS, std::ptr::null(), BEFORE.0.get().cast()) != 0 {
                return;
            }
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = handle as *const () as usize;
            action.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
            libc::sigaction(libc::SIGBUS, &action, std::ptr::null_mut());
        }
    });
}

/// Writes the line and restores what was set before. A fault then happens again by itself when this returns; a signal
/// that a process has sent is raised again.
extern "C" fn handle(signal: libc::c_int, information: *mut libc::siginfo_t, _: *mut libc::c_void) {
    // SAFETY: write(2), sigaction(2) and raise(3) may be called in a signal handler; the kernel hands over a valid
    // `information`, and `BEFORE` was filled before this handler was set.
    unsafe {
        libc::write(libc::STDERR_FILENO, LINE.as_ptr().cast(), LINE.len());
        libc::sigaction(signal, BEFORE.0.get().cast(), std::ptr::null_mut());
        if (*information).si_code <= 0 {
            libc::raise(signal);
        }
    }
}
