//! What a process logs and does before a crash ends it.
//!
//! The kernel reports a page that it can't provide by SIGBUS, and a bad address by SIGSEGV. By default both end a
//! process without a message. The handler here writes one line to standard error, which is the log of a process. In
//! an orchestrator it latches the stop word first, and so does a panic. It runs on a stack of its own, so that it
//! also handles a stack overflow. Then it restores the earlier handler and lets the fault happen again.
//!
//! Limits: KILL, an abort, and a machine without memory leave no time. Then the processes notice the missing
//! directives.
#![expect(unsafe_code, reason = "signal handlers are installed for signals that no safe interface allows")]

use std::cell::UnsafeCell;
use std::mem::MaybeUninit;
use std::sync::{Once, OnceLock};
use std::time::Duration;

use crate::logging::{Priority, print};
use crate::stop::StopWord;
use crate::terminal::flush_terminal;

/// Signals of the processor that end a process.
const SIGNALS: [libc::c_int; 3] = [libc::SIGSEGV, libc::SIGBUS, libc::SIGILL];
/// Memory for the handler, on which the handler before it runs as well [bytes].
const STACK: usize = 64 << 10;
/// The message of a panic is waited for at most this long.
const FLUSH: Duration = Duration::from_millis(300);

/// The stop word of the run that this process orchestrates.
static STOP_WORD: OnceLock<StopWord> = OnceLock::new();
static INSTALLED: Once = Once::new();
/// The earlier actions of the signals.
static BEFORE: Before = Before([const { UnsafeCell::new(MaybeUninit::zeroed()) }; SIGNALS.len()]);

struct Before([UnsafeCell<MaybeUninit<libc::sigaction>>; SIGNALS.len()]);

// SAFETY: each cell is written once, before its handler can run, and only read afterwards.
unsafe impl Sync for Before {}

/// From now on a crash of this process writes a line to standard error. Acts once per process; where the kernel
/// refuses, nothing changes.
pub(crate) fn report_crashes() {
    INSTALLED.call_once(|| {
        // The main thread has a stack for stack overflows already, but a small one.
        let stack = Box::leak(vec![0_u8; STACK].into_boxed_slice());
        let stack = libc::stack_t { ss_sp: stack.as_mut_ptr().cast(), ss_flags: 0, ss_size: STACK };
        // SAFETY: the memory is never freed, and no handler runs on the stack that it replaces.
        unsafe { libc::sigaltstack(&raw const stack, std::ptr::null_mut()) };
        for (index, signal) in SIGNALS.into_iter().enumerate() {
            // SAFETY: a zeroed `sigaction` is valid; the handler does only what a signal handler may do; the place for
            // the old action is written before the new one is in force.
            unsafe {
                if libc::sigaction(signal, std::ptr::null(), BEFORE.0[index].get().cast()) != 0 {
                    continue;
                }
                let mut action: libc::sigaction = std::mem::zeroed();
                action.sa_sigaction = handle as *const () as libc::sighandler_t;
                action.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
                libc::sigaction(signal, &raw const action, std::ptr::null_mut());
            }
        }
    });
}

/// From now on a panic or a crash of this process, an orchestrator, first latches `word`. Acts once per process.
pub fn latch_on_crash(word: &StopWord) {
    if STOP_WORD.set(word.clone()).is_err() {
        return;
    }
    std::panic::set_hook(Box::new(|panic| {
        latch();
        // Not with the default hook, which would wait for a terminal that is not read.
        print(Priority::Error, &format!("internal error: {panic}; wheels are blocked"));
        flush_terminal(FLUSH);
    }));
    report_crashes();
}

fn latch() {
    if let Some(word) = STOP_WORD.get() {
        word.latch();
    }
}

/// The line for a signal.
fn line(signal: libc::c_int) -> &'static [u8] {
    match (signal, STOP_WORD.get().is_some()) {
        (libc::SIGBUS, false) => b"shared memory ran out or was cut off (SIGBUS): see `df /dev/shm`\n",
        (libc::SIGBUS, true) => {
            b"scanloop: shared memory ran out or was cut off (SIGBUS): the orchestrator ends, wheels are blocked\n"
        }
        (libc::SIGILL, false) => b"this process ends: illegal instruction (SIGILL)\n",
        (libc::SIGILL, true) => b"scanloop: the orchestrator ends (SIGILL), wheels are blocked\n",
        (_, false) => b"this process ends: bad address or stack overflow (SIGSEGV)\n",
        (_, true) => b"scanloop: the orchestrator ends (SIGSEGV), wheels are blocked\n",
    }
}

/// A fault happens again by itself when this returns; a signal that a process sent is raised again.
extern "C" fn handle(signal: libc::c_int, information: *mut libc::siginfo_t, _: *mut libc::c_void) {
    latch();
    let text = line(signal);
    // SAFETY: plain system calls on valid memory; the old action was stored before this handler could run, and the
    // kernel hands over a valid `information`.
    unsafe {
        // A terminal that is not read must not hold this up.
        let mut ready = libc::pollfd { fd: libc::STDERR_FILENO, events: libc::POLLOUT, revents: 0 };
        if libc::poll(&raw mut ready, 1, 0) == 1 {
            let _ = libc::write(libc::STDERR_FILENO, text.as_ptr().cast(), text.len());
        }
        let is_sent = information.as_ref().is_none_or(|information| information.si_code <= 0);
        if is_sent {
            libc::signal(signal, libc::SIG_DFL);
            libc::raise(signal);
        } else if let Some(index) = SIGNALS.iter().position(|known| *known == signal) {
            libc::sigaction(signal, BEFORE.0[index].get().cast(), std::ptr::null_mut());
        }
    }
}
