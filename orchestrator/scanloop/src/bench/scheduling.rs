//! Under which policy and on which processors the processes of a bench run.
//!
//! Processes of the loop get them as those of `run` do, when they have joined the bus. Processes of other transports get
//! them before their program begins, so that all of its threads inherit them. What a command line asks for is tried
//! before anything is started: SCHED_FIFO takes a privilege.

use clap::{Args, ValueEnum};
use console::exit::Failure;
use runtime::{Realtime, Scheduler};
use rustix::thread::CpuSet;

/// Scheduling policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Policy {
    /// The default of the system.
    Other,
    /// SCHED_FIFO: real time, runs until it sleeps.
    Fifo,
}

/// Arguments of benches that start processes.
#[derive(Debug, Clone, Args, Default)]
pub struct SchedulingArguments {
    /// Scheduling policy of the processes; `fifo` takes root, or the right to priority 40. Without it that of the
    /// system.
    #[arg(long, value_name = "POLICY", value_enum)]
    pub sched: Option<Policy>,
    /// Processors that the processes may run on, like `0` or `0,2-3`; without it all.
    #[arg(long, value_name = "LIST")]
    pub cpu: Option<String>,
}

/// Checked arguments.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Scheduling {
    /// The policy, if one is asked for.
    policy: Option<Policy>,
    /// The processors; empty for all.
    pub(crate) cpus: Vec<usize>,
}

impl Scheduling {
    /// Checks the arguments, and that the kernel allows what they ask for.
    ///
    /// # Errors
    /// A list that is none, or a processor that is not there (exit code 2); what the kernel refuses (exit code 4).
    pub(crate) fn read(arguments: &SchedulingArguments) -> anyhow::Result<Self> {
        let mut scheduling = Self { policy: arguments.sched, cpus: Vec::new() };
        if let Some(list) = &arguments.cpu {
            let bad = |why: String| Failure::bad_input(format!("--cpu {list} is not allowed: {why}"));
            let cpus = parse(list).ok_or_else(|| bad("a list like `0` or `0,2-3`".to_owned()))?;
            // Those set apart by `isolcpus` are not among those that this process may use, and yet may be asked for.
            let there = processors();
            if let Some(cpu) = cpus.iter().find(|cpu| **cpu >= CpuSet::MAX_CPU || !there.contains(cpu)) {
                let count = there.len();
                return Err(bad(format!("processor {cpu} is not among the {count} of this machine")));
            }
            scheduling.cpus = cpus;
        }
        scheduling.try_out()?;
        Ok(scheduling)
    }

    /// Has the processes of a system run so, where this says something.
    pub(crate) fn apply(&self, realtime: &mut Realtime) {
        match self.policy {
            Some(Policy::Fifo) => realtime.scheduler = Scheduler::Fifo,
            Some(Policy::Other) => realtime.scheduler = Scheduler::Other,
            None => {}
        }
        if !self.cpus.is_empty() {
            realtime.cpu.clone_from(&self.cpus);
        }
    }

    /// The policy of processes that belong to no system.
    pub(crate) fn class(&self) -> hops::Scheduling {
        match self.policy {
            Some(Policy::Fifo) => hops::Scheduling::Fifo,
            Some(Policy::Other) | None => hops::Scheduling::Other,
        }
    }

    fn try_out(&self) -> anyhow::Result<()> {
        if hops::Scheduling::Other.is_allowed(&self.cpus)? {
            if self.class().is_allowed(&self.cpus)? {
                return Ok(());
            }
            return Err(Failure::process(format!(
                "the kernel refuses `--sched fifo`: run as root, or allow priority {0}: `ulimit -r {0}`, or a line \
                 `USER - rtprio {0}` in /etc/security/limits.conf and log in anew",
                hops::PRIORITY
            )));
        }
        Err(Failure::process(format!("the kernel refuses processors {:?} to this process", self.cpus)))
    }
}

/// The processors of this machine that are switched on.
fn processors() -> Vec<usize> {
    let online = std::fs::read_to_string("/sys/devices/system/cpu/online").ok();
    online.and_then(|list| parse(list.trim())).unwrap_or_else(hops::processors)
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
    fn what_a_command_line_asks_for_goes_before_the_system() {
        let fifo = Realtime { scheduler: Scheduler::Fifo, cpu: vec![0], ..Realtime::default() };
        let applied = |policy, cpus: &[usize]| {
            let mut realtime = fifo.clone();
            Scheduling { policy, cpus: cpus.to_vec() }.apply(&mut realtime);
            (realtime.scheduler, realtime.cpu)
        };
        assert_eq!(applied(None, &[]), (Scheduler::Fifo, vec![0]));
        assert_eq!(applied(Some(Policy::Other), &[1]), (Scheduler::Other, vec![1]));
    }

    #[test]
    fn real_time_processes_of_both_benches_have_one_priority() {
        assert_eq!(hops::PRIORITY.cast_unsigned(), Realtime::default().priority);
    }

    #[test]
    fn a_processor_that_is_not_there_is_refused() {
        let arguments = SchedulingArguments { sched: None, cpu: Some("1000".to_owned()) };
        let error = Scheduling::read(&arguments).unwrap_err();
        assert!(error.to_string().contains("processor 1000 is not among"), "{error}");
    }
}
