//! Real-time settings of a process, and the system calls behind them.
//!
//! The defaults need no privileges. A setting that the machine refuses is a warning that says what to change, because
//! a robot that reacts a little later is better than one that does not start.
#![expect(
    unsafe_code,
    reason = "the scheduler of a process is set by a system call that no crate of ours wraps"
)]

use std::num::NonZeroU64;

use key_table::{Documented, Setting, settings};
use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::Pid;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity, set_current_timer_slack};
use serde::{Deserialize, Serialize};

/// How the kernel chooses among processes that want to run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scheduler {
    /// By fair shares, SCHED_OTHER.
    #[default]
    Other,
    /// Before all processes of fair shares, SCHED_FIFO.
    Fifo,
}

impl Setting for Scheduler {}

/// What a time slice may be.
const SLICE: Documented = Documented {
    text: "0, or 100 to 1e5",
    schema: "anyOf = [{ enum = [0] }, { minimum = 100, maximum = 100000 }]",
};

settings! {
    /// The table `realtime` of the system file.
    pub struct Realtime {
        /// A process polls its doorbell without sleeping for this long before and after its next input is due [us].
        pub poll_us: u64 = 0, (0.0..=2000.0, "0 with a single processor in `cpu`");
        /// A process wakes once this long before its next input is due, so that code and data are in the caches; 0 for
        /// never [us]. It has no effect when scans are at most 5 ms apart.
        pub warm_up_us: u64 = 800, 0.0..=2000.0;
        /// Whether built-in stages rehearse their step when they warm up, on the input that is expected. The result of
        /// the step is the same with and without.
        pub rehearse: bool = true;
        /// Processors that the processes of the loop may run on; empty for all.
        pub cpu: Vec<usize> = Vec::new(), 0.0..=1023.0;
        /// Scheduling policy: the usual one of Linux, SCHED_OTHER, or SCHED_FIFO.
        pub scheduler: Scheduler = Scheduler::Other;
        /// Priority with `fifo`.
        pub priority: u32 = 40, 1.0..=98.0;
        /// Whether memory is mapped, written to and locked before the robot drives.
        pub lock_memory: bool = false;
        /// Whether idle processors may enter deep sleep states; `false` keeps them awake while the system runs.
        pub idle_states: bool = true;
        /// Timer slack: how much later than requested a sleep may end [ns].
        // The kernel gives 50 us to every process.
        pub timer_slack_ns: u64 = 50_000, 1.0..=1e6;
        /// Time slice that a process with `other` requests; 0 for the kernel's default [us]. The kernel lets a process with
        /// a short slice run first when it wakes.
        // 100 us is the smallest that the kernel grants.
        pub slice_us: u64 = 100, SLICE;
    }
}

impl Realtime {
    /// Sets processors, scheduler and slice of another process; returns a warning for each setting that the machine
    /// refused. Threads that the process starts later inherit them.
    pub fn apply_to(&self, pid: u32) -> Vec<String> {
        let mut refused = Vec::new();
        let Some(process) = Pid::from_raw(pid.cast_signed()) else { return refused };
        if !self.cpu.is_empty() {
            let mut set = CpuSet::new();
            self.cpu.iter().filter(|cpu| **cpu < CpuSet::MAX_CPU).for_each(|cpu| set.set(*cpu));
            if let Err(error) = sched_setaffinity(Some(process), &set) {
                refused.push(format!(
                    "realtime.cpu = {:?} has no effect ({error}): name processors that this machine has and may use",
                    self.cpu
                ));
            }
        }
        if self.scheduler == Scheduler::Fifo
            && let Err(error) = set_scheduler(pid, libc::SCHED_FIFO, self.priority)
        {
            refused.push(format!(
                "realtime.scheduler = \"fifo\" has no effect ({error}): allow it with `ulimit -r {0}`, \
                 `LimitRTPRIO={0}` in a systemd unit, or CAP_SYS_NICE",
                self.priority
            ));
        }
        if self.slice_us > 0
            && let Err(error) = set_slice(pid, 1000 * self.slice_us)
        {
            refused
                .push(format!("realtime.slice_us = {} has no effect ({error}): set it to 0", self.slice_us));
        }
        refused
    }

    /// These settings with the processors and the scheduler that another process really has. No processors stands for
    /// all that this process may use.
    pub fn granted(&self, pid: u32) -> Self {
        let used = |pid| {
            let set = sched_getaffinity(pid).unwrap_or_default();
            (0..CpuSet::MAX_CPU).filter(|cpu| set.is_set(*cpu)).collect::<Vec<_>>()
        };
        let (own, others) = (used(None), used(Pid::from_raw(pid.cast_signed())));
        let is_fifo = attributes(pid).is_ok_and(|has| has.sched_policy == libc::SCHED_FIFO.cast_unsigned());
        Self {
            cpu: if others == own { Vec::new() } else { others },
            scheduler: if is_fifo { Scheduler::Fifo } else { Scheduler::Other },
            ..self.clone()
        }
    }

    /// Sets the timer slack of this process.
    pub(crate) fn apply_timer_slack(&self) {
        if let Err(error) = set_current_timer_slack(NonZeroU64::new(self.timer_slack_ns)) {
            tracing::warn!(%error, "realtime.timer_slack_ns has no effect");
        }
    }

    /// Returns this process to fair shares, because leaving the bus takes time that other processes need.
    pub(crate) fn leave_real_time(&self) {
        if self.scheduler == Scheduler::Fifo {
            let _ = set_scheduler(0, libc::SCHED_OTHER, 0);
        }
    }

    /// Maps and locks all memory of this process, if set. Call it when all ports and connections exist.
    pub(crate) fn apply_memory(&self) {
        if self.lock_memory
            && let Err(error) = mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE)
        {
            tracing::warn!(
                %error,
                "realtime.lock_memory has no effect: allow it with `ulimit -l unlimited`, `LimitMEMLOCK=infinity` in a \
                 systemd unit, or CAP_IPC_LOCK"
            );
        }
    }
}

/// Asks the kernel itself: musl has no `sched_setscheduler`.
fn set_scheduler(pid: u32, policy: i32, priority: u32) -> std::io::Result<()> {
    // SAFETY: the kernel's parameters are the priority alone; it reads it during the call and keeps no pointer to it.
    let result = unsafe { libc::syscall(libc::SYS_sched_setscheduler, pid, policy, &raw const priority) };
    if result == 0 { Ok(()) } else { Err(std::io::Error::last_os_error()) }
}

/// Asks the kernel for a slice; processes other than SCHED_OTHER stay as they are. Kernels before 6.12 ignore it.
fn set_slice(pid: u32, slice_ns: u64) -> std::io::Result<()> {
    let mut attributes = attributes(pid)?;
    if attributes.sched_policy != libc::SCHED_OTHER.cast_unsigned() {
        return Ok(());
    }
    attributes.sched_runtime = slice_ns;
    // SAFETY: the kernel reads the value during the call and keeps no pointer to it.
    let result = unsafe { libc::syscall(libc::SYS_sched_setattr, pid, &raw const attributes, 0) };
    if result == 0 { Ok(()) } else { Err(std::io::Error::last_os_error()) }
}

/// How the kernel runs a process now.
fn attributes(pid: u32) -> std::io::Result<libc::sched_attr> {
    let size = size_of::<libc::sched_attr>() as u32;
    // SAFETY: all fields are numbers, for which zero is valid.
    let mut attributes: libc::sched_attr = unsafe { std::mem::zeroed() };
    // SAFETY: the kernel writes at most `size` bytes into the value, which is as large.
    let result = unsafe { libc::syscall(libc::SYS_sched_getattr, pid, &raw mut attributes, size, 0) };
    if result == 0 { Ok(attributes) } else { Err(std::io::Error::last_os_error()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_of_the_machine_by_default_is_granted_to_everyone() {
        assert_eq!(Realtime::default().apply_to(std::process::id()), [] as [String; 0]);
    }

    #[test]
    fn a_process_gets_the_slice_that_it_asks_for_unless_it_is_real_time() {
        // A thread of its own: the kernel takes its number for that of a process.
        std::thread::spawn(|| {
            let thread = rustix::thread::gettid().as_raw_nonzero().get().cast_unsigned();
            if attributes(thread).unwrap().sched_runtime == 0 {
                return; // A kernel without slices.
            }
            set_slice(thread, 300_000).unwrap();
            assert_eq!(attributes(thread).unwrap().sched_runtime, 300_000);
            if set_scheduler(thread, libc::SCHED_FIFO, 1).is_ok() {
                set_slice(thread, 200_000).unwrap();
                assert_eq!(attributes(thread).unwrap().sched_policy, libc::SCHED_FIFO.cast_unsigned());
            }
        })
        .join()
        .unwrap();
    }

    #[test]
    fn what_is_granted_is_what_a_process_has_not_what_was_asked_for() {
        let asked = Realtime { cpu: vec![1023], scheduler: Scheduler::Fifo, ..Realtime::default() };
        assert_eq!(asked.granted(std::process::id()), Realtime::default());
    }

    #[test]
    fn a_refusal_says_what_to_change() {
        let realtime = Realtime { cpu: vec![1023], ..Realtime::default() };
        let refused = realtime.apply_to(std::process::id());
        assert!(refused.len() == 1 && refused[0].contains("name processors"), "{refused:?}");
    }
}
