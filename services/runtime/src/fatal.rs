//! An orchestrator that is about to end for a reason of its own stops its run first.
//!
//! A panic, and a signal of the processor (SEGV, BUS, ILL), latch the stop word before anything else happens. The handler
//! runs on a stack of its own, so that a stack overflow does not keep it from running; it writes one line, gives the
//! signal back to the handler that was there before, and lets it happen again.
//!
//! Where this fails: KILL, an abort, and a machine without memory leave no time. Then the processes notice the silence.
#![expect(unsafe_code, reason = "signal handlers are installed for signals that no safe interface allows")]

use std::cell::UnsafeCell;
use std::mem::MaybeUninit;
use std::sync::OnceLock;

use crate::stop::StopWord;

/// Signals of the processor that end a process.
const SIGNALS: [libc::c_int; 3] = [libc::SIGSEGV, libc::SIGBUS, libc::SIGILL];
/// Memory for the handler, on which it also stands while the handler before it runs [bytes].
const STACK: usize = 64 << 10;

/// The stop word of the run that this process orchestrates.
static WORD: OnceLock<StopWord> = OnceLock::new();

/// What the signals did before.
static BEFORE: Before = Before([const { UnsafeCell::new(MaybeUninit::uninit()) }; SIGNALS.len()]);

struct Before([UnsafeCell<MaybeUninit<libc::sigaction>>; SIGNALS.len()]);

// SAFETY: each cell is written once, before its handler can run, and only read afterwards.
unsafe impl Sync for Before {}

/// From now on a panic or a crash of this process latches `word`. Once per process; later calls change nothing.
pub fn latch_on_crash(word: &StopWord) {
    if WORD.set(word.clone()).is_err() {
        return;
    }
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        latch();
        before(panic);
    }));
    // The main thread has an alternative stack for stack overflows already, but a small one.
    let stack = Box::leak(vec![0_u8; STACK].into_boxed_slice());
    let stack = libc::stack_t { ss_sp: stack.as_mut_ptr().cast(), ss_flags: 0, ss_size: STACK };
    // SAFETY: the memory is never freed, and no handler runs on the stack that it replaces.
    unsafe { libc::sigaltstack(&raw const stack, std::ptr::null_mut()) };
    for (index, signal) in SIGNALS.into_iter().enumerate() {
        // SAFETY: a zeroed `sigaction` is valid; the handler below does only what a signal handler may do; the place for
        // the old action is written before the new one is in force.
        unsafe {
            let slot = BEFORE.0[index].get();
            libc::sigaction(signal, std::ptr::null(), (*slot).as_mut_ptr());
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = on_crash as *const () as libc::sighandler_t;
            action.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
            libc::sigaction(signal, &raw const action, std::ptr::null_mut());
        }
    }
}

/// Stops the run of this process, if it orchestrates one. Safe to call from a signal handler.
fn latch() {
    if let Some(word) = WORD.get() {
        word.latch();
    }
}

extern "C" fn on_crash(signal: libc::c_int, info: *mut libc::siginfo_t, _: *mut libc::c_void) {
    latch();
    let text: &[u8] = match signal {
        libc::SIGBUS => b"scanloop: the orchestrator ended with SIGBUS (memory that is gone, or shared memory is full); wheels are blocked\n",
        libc::SIGILL => b"scanloop: the orchestrator ended with SIGILL; wheels are blocked\n",
        _ => b"scanloop: the orchestrator ended with SIGSEGV; wheels are blocked\n",
    };
    // SAFETY: plain system calls on valid memory; the old action was stored before this handler could run, and `info` is
    // what the kernel passed.
    unsafe {
        // A terminal that is not read must not hold this up.
        let mut ready = libc::pollfd { fd: 2, events: libc::POLLOUT, revents: 0 };
        if libc::poll(&raw mut ready, 1, 0) == 1 {
            let _ = libc::write(2, text.as_ptr().cast(), text.len());
        }
        let sent = info.as_ref().is_none_or(|info| info.si_code <= 0);
        if sent {
            // Nothing goes wrong again when the handler returns, so the signal is sent once more.
            libc::signal(signal, libc::SIG_DFL);
            libc::raise(signal);
        } else if let Some(index) = SIGNALS.iter().position(|known| *known == signal) {
            libc::sigaction(signal, (*BEFORE.0[index].get()).as_ptr(), std::ptr::null_mut());
        }
    }
}
