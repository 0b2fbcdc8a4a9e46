//! Starts the processes of a chain: with a scheduler, on given processors, and never longer than the driver.
#![expect(
    unsafe_code,
    reason = "scheduling has to be set between fork and exec, so that all threads inherit it"
)]

use std::io;
use std::os::fd::RawFd;
use std::os::unix::process::CommandExt;
use std::process::Command;

use crate::HopError;

/// Priority of all processes under SCHED_FIFO: above all other processes, below the interrupt threads of the kernel.
pub const PRIORITY: i32 = 40;

/// How the kernel chooses among processes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SchedulingClass {
    /// SCHED_OTHER, the default.
    Other,
    /// SCHED_FIFO: a process that wakes takes the processor from all others.
    Fifo,
}

impl SchedulingClass {
    /// Name on the command line and in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Other => "other",
            Self::Fifo => "fifo",
        }
    }

    /// Whether this user may use it on these processors; empty for all.
    ///
    /// # Errors
    /// [`HopError::System`] when a process can't be started at all.
    pub fn is_allowed(self, cpus: &[usize]) -> Result<bool, HopError> {
        use io::ErrorKind::{InvalidInput, PermissionDenied};
        let mut command = Command::new("true");
        prepare(&mut command, self, cpus, &[]);
        match command.status() {
            Ok(status) => Ok(status.success()),
            Err(error) if [InvalidInput, PermissionDenied].contains(&error.kind()) => Ok(false),
            Err(error) => Err(HopError::system("try the scheduler")(error)),
        }
    }
}

/// The processors that this process may use.
pub fn processors() -> Vec<usize> {
    let mut set = empty();
    // SAFETY: the kernel writes at most the size given into a set that lives on this stack.
    let known = unsafe { libc::sched_getaffinity(0, size_of_val(&set), &raw mut set) } == 0;
    // SAFETY: the index is below the number of bits of the set.
    (0..libc::CPU_SETSIZE as usize).filter(|cpu| known && unsafe { libc::CPU_ISSET(*cpu, &set) }).collect()
}

/// Has the command run under `scheduling` on `cpus` (empty: all), with `descriptors` open, in a group of its own, and
/// killed when this thread ends.
pub(crate) fn prepare(
    command: &mut Command,
    scheduling: SchedulingClass,
    cpus: &[usize],
    descriptors: &[RawFd],
) {
    let mut set = empty();
    for cpu in cpus.iter().filter(|cpu| **cpu < libc::CPU_SETSIZE as usize) {
        // SAFETY: the index is below the number of bits of the set.
        unsafe { libc::CPU_SET(*cpu, &mut set) };
    }
    let (pinned, descriptors) = (!cpus.is_empty(), descriptors.to_vec());
    command.process_group(0);
    // SAFETY: between fork and exec only system calls are made, on memory that was prepared before.
    unsafe {
        command.pre_exec(move || {
            checked(libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL))?;
            for descriptor in &descriptors {
                checked(libc::fcntl(*descriptor, libc::F_SETFD, 0))?;
            }
            if pinned {
                checked(libc::sched_setaffinity(0, size_of_val(&set), &raw const set))?;
            }
            if scheduling == SchedulingClass::Fifo {
                let parameters = libc::sched_param { sched_priority: PRIORITY };
                checked(libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters))?;
            }
            Ok(())
        });
    }
}

fn checked(result: i32) -> io::Result<()> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}

fn empty() -> libc::cpu_set_t {
    // SAFETY: a set of processors is an array of integers; zero is the empty set.
    unsafe { std::mem::zeroed() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_runs_on_the_processor_it_was_given() {
        let first = processors()[0];
        let mut command = Command::new("grep");
        command.args(["Cpus_allowed_list", "/proc/self/status"]);
        prepare(&mut command, SchedulingClass::Other, &[first], &[]);
        let output = String::from_utf8(command.output().unwrap().stdout).unwrap();
        assert_eq!(output.split_whitespace().last(), Some(first.to_string().as_str()), "{output}");
    }
}
