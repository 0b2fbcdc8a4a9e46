//! Scheduling policy and processors of the processes of a bench.
//!
//! They are set for processes of the loop when these have joined the bus, as in `run`, and for processes of other
//! transports before their program starts, so that all threads inherit them. The options are tried out before anything
//! is started, because SCHED_FIFO needs a privilege.

use clap::{Args, ValueEnum};
use console::exit::Failure;
use runtime::{Realtime, Scheduler};
use rustix::thread::{CpuSet, sched_getaffinity};

/// Scheduling policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SchedulingPolicy {
    /// SCHED_OTHER, the default of Linux.
    Other,
    /// SCHED_FIFO: real time, a process runs until it sleeps.
    Fifo,
}

/// Arguments of benches that start processes.
#[derive(Debug, Clone, Args, Default)]
pub struct SchedulingArguments {
    /// Scheduling policy of the processes; without it that of the system file. `fifo` needs root, or the right to
    /// priority 40.
    #[arg(long, value_name = "POLICY", value_enum)]
    pub sched: Option<SchedulingPolicy>,
    /// Processors that the processes may run on, for example `0` or `0,2-3`; without it all.
    #[arg(long, value_name = "LIST")]
    pub cpu: Option<String>,
}

/// Checked arguments.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Scheduling {
    /// The policy, if one is asked for.
    pub policy: Option<SchedulingPolicy>,
    /// The processors; empty for all.
    pub cpus: Vec<usize>,
}

impl Scheduling {
    /// Checks the arguments, and that the kernel allows what they ask for.
    ///
    /// # Errors
    /// A bad list or a processor that does not exist (exit code 2); settings that the kernel refuses (exit code 4).
    pub fn read(arguments: &SchedulingArguments) -> anyhow::Result<Self> {
        let mut scheduling = Self { policy: arguments.sched, cpus: Vec::new() };
        if let Some(list) = &arguments.cpu {
            let bad = |why: String| Failure::bad_input(format!("--cpu {list} is not allowed: {why}"));
            let cpus = parse(list).ok_or_else(|| bad("a list like `0` or `0,2-3`".to_owned()))?;
            // Processors of `isolcpus` are allowed too, although this process may not use them by default.
            let existing = processors();
            if let Some(cpu) = cpus.iter().find(|cpu| **cpu >= CpuSet::MAX_CPU || !existing.contains(cpu)) {
                let count = existing.len();
                return Err(bad(format!("processor {cpu} is not among the {count} of this machine")));
            }
            scheduling.cpus = cpus;
        }
        scheduling.try_out()?;
        Ok(scheduling)
    }

    /// Applies the settings that were asked for to those of a system.
    pub fn apply(&self, realtime: &mut Realtime) {
        match self.policy {
            Some(SchedulingPolicy::Fifo) => realtime.scheduler = Scheduler::Fifo,
            Some(SchedulingPolicy::Other) => realtime.scheduler = Scheduler::Other,
            None => {}
        }
        if !self.cpus.is_empty() {
            realtime.cpu.clone_from(&self.cpus);
        }
    }

    fn try_out(&self) -> anyhow::Result<()> {
        if !is_granted(Realtime { cpu: self.cpus.clone(), ..Realtime::default() })? {
            return Err(Failure::process(format!(
                "the kernel refuses processors {:?} to this process",
                self.cpus
            )));
        }
        let fifo = Realtime { scheduler: Scheduler::Fifo, ..Realtime::default() };
        let priority = fifo.priority;
        if self.policy == Some(SchedulingPolicy::Fifo) && !is_granted(fifo)? {
            return Err(Failure::process(format!(
                "the kernel refuses `--sched fifo`: run as root, or allow priority {priority}: `ulimit -r {priority}`, \
                 or a line `USER - rtprio {priority}` in /etc/security/limits.conf and log in anew"
            )));
        }
        Ok(())
    }
}

/// Whether the kernel grants the settings to a new thread.
fn is_granted(realtime: Realtime) -> std::io::Result<bool> {
    let try_out = move || {
        // The kernel accepts the id of a thread as that of a process.
        let thread = rustix::thread::gettid().as_raw_nonzero().get().cast_unsigned();
        Realtime { slice_us: 0, ..realtime }.apply_to(thread).is_empty()
    };
    Ok(std::thread::Builder::new().spawn(try_out)?.join().unwrap_or(false))
}

/// The processors of this machine that are online.
fn processors() -> Vec<usize> {
    let online = std::fs::read_to_string("/sys/devices/system/cpu/online").ok();
    online.and_then(|list| parse(list.trim())).unwrap_or_else(|| {
        let own = sched_getaffinity(None).unwrap_or_default();
        (0..CpuSet::MAX_CPU).filter(|cpu| own.is_set(*cpu)).collect()
    })
}

/// The processors of a list like `0,2-3`, in order.
fn parse(list: &str) -> Option<Vec<usize>> {
    let mut cpus = Vec::new();
    for part in list.split(',') {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let (first, last): (usize, usize) = (first.trim().parse().ok()?, last.trim().parse().ok()?);
        if first > last || last > 65_535 {
            return None;
        }
        cpus.extend(first..=last);
    }
    cpus.sort_unstable();
    cpus.dedup();
    Some(cpus)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_processors_are_read() {
        assert_eq!(parse("0"), Some(vec![0]));
        assert_eq!(parse("3,0-1,1"), Some(vec![0, 1, 3]));
        for list in ["", "a", "1-", "3-1", "0,,1", "-1", "0-99999999"] {
            assert_eq!(parse(list), None, "{list}");
        }
    }

    #[test]
    fn the_command_line_overrides_the_system() {
        let fifo = Realtime { scheduler: Scheduler::Fifo, cpu: vec![0], ..Realtime::default() };
        let applied = |policy, cpus: &[usize]| {
            let mut realtime = fifo.clone();
            Scheduling { policy, cpus: cpus.to_vec() }.apply(&mut realtime);
            (realtime.scheduler, realtime.cpu)
        };
        assert_eq!(applied(None, &[]), (Scheduler::Fifo, vec![0]));
        assert_eq!(applied(Some(SchedulingPolicy::Other), &[1]), (Scheduler::Other, vec![1]));
    }

    #[test]
    fn a_processor_that_does_not_exist_is_refused() {
        let arguments = SchedulingArguments { sched: None, cpu: Some("1000".to_owned()) };
        let error = Scheduling::read(&arguments).unwrap_err();
        assert!(error.to_string().contains("processor 1000 is not among"), "{error}");
    }
}
