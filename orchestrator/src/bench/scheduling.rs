//! Under which policy and on which processors the processes of a bench run.
//!
//! The five processes of the loop get them as those of `run` do, when they have joined the bus. Any other process is
//! started through `taskset` and `chrt` of util-linux, which change themselves and then become it: so policy and
//! processors hold from its first instruction on, for all of its threads, and for a peer of any language alike.
//! `SCHED_FIFO` takes a privilege; whether it is there is tried before anything is started.

use std::process::{Command, Stdio};

use clap::{Args, ValueEnum};
use runtime::{Realtime, Scheduler};
use rustix::thread::sched_getaffinity;
use serde::Serialize;

use crate::exit::Failure;

/// Scheduling policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Policy {
    /// The default of the system.
    #[default]
    Other,
    /// SCHED_FIFO: real time, runs until it sleeps.
    Fifo,
}

/// Arguments of benches that start processes.
#[derive(Debug, Clone, Args, Default)]
pub struct SchedulingArguments {
    /// Scheduling policy of the processes; `fifo` takes root, or the right to priority 40.
    #[arg(long, value_name = "POLICY", value_enum, default_value = "other")]
    pub sched: Policy,
    /// Processors that the processes may run on, like `0` or `0,2-3`; without it all.
    #[arg(long, value_name = "LIST")]
    pub cpu: Option<String>,
}

/// Checked arguments.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub(crate) struct Scheduling {
    /// The policy.
    pub policy: Policy,
    /// The processors; empty for all.
    pub cpus: Vec<usize>,
    /// The priority with `fifo`.
    pub priority: u32,
}

impl Scheduling {
    /// Checks the arguments, and that the kernel allows what they ask for.
    ///
    /// # Errors
    /// A list that is none, or a processor that is not there (exit code 2); what the kernel refuses (exit code 4).
    pub(crate) fn read(arguments: &SchedulingArguments) -> anyhow::Result<Self> {
        let cpus = match &arguments.cpu {
            None => Vec::new(),
            Some(list) => {
                let cpus = parse(list).ok_or_else(|| {
                    Failure::bad_input(format!("--cpu {list} is not allowed: a list like `0` or `0,2-3`"))
                })?;
                let there = sched_getaffinity(None)?;
                if let Some(cpu) =
                    cpus.iter().find(|&&cpu| cpu >= rustix::thread::CpuSet::MAX_CPU || !there.is_set(cpu))
                {
                    let count = there.count();
                    return Err(Failure::bad_input(format!(
                        "--cpu {list} is not allowed: processor {cpu} is not among the {count} that may be used"
                    )));
                }
                cpus
            }
        };
        let scheduling = Self { policy: arguments.sched, cpus, priority: Realtime::default().priority };
        scheduling.try_out()?;
        Ok(scheduling)
    }

    /// How the processes of a system are run.
    pub(crate) fn of(realtime: &Realtime) -> Self {
        let policy = match realtime.scheduler {
            Scheduler::Other => Policy::Other,
            Scheduler::Fifo => Policy::Fifo,
        };
        Self { policy, cpus: realtime.cpu.clone(), priority: realtime.priority }
    }

    /// Has the processes of a system run so, where this says something.
    pub(crate) fn apply(&self, realtime: &mut Realtime) {
        if self.policy == Policy::Fifo {
            realtime.scheduler = Scheduler::Fifo;
        }
        if !self.cpus.is_empty() {
            realtime.cpu.clone_from(&self.cpus);
        }
    }

    /// What stands before a command to start it so; empty for the defaults.
    pub(crate) fn prefix(&self) -> Vec<String> {
        let mut prefix = Vec::new();
        if !self.cpus.is_empty() {
            let cpus: Vec<String> = self.cpus.iter().map(usize::to_string).collect();
            prefix.extend(["taskset".to_owned(), "--cpu-list".to_owned(), cpus.join(",")]);
        }
        if self.policy == Policy::Fifo {
            prefix.extend(["chrt".to_owned(), "--fifo".to_owned(), self.priority.to_string()]);
        }
        prefix
    }

    fn try_out(&self) -> anyhow::Result<()> {
        let prefix = self.prefix();
        let Some((program, arguments)) = prefix.split_first() else { return Ok(()) };
        let tried = Command::new(program)
            .args(arguments)
            .arg("true")
            .stdin(Stdio::null())
            .output()
            .map_err(|error| Failure::process(format!("{program}: {error}; install util-linux")))?;
        if tried.status.success() {
            return Ok(());
        }
        let said = String::from_utf8_lossy(&tried.stderr).trim().replace('\n', "; ");
        let way_out = match self.policy {
            Policy::Fifo => {
                "; run as root, or allow the priority: a line `USER - rtprio 40` in /etc/security/limits.conf, \
                 then log in anew"
            }
            Policy::Other => "",
        };
        Err(Failure::process(format!("the kernel refuses `{}`: {said}{way_out}", prefix.join(" "))))
    }
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
    fn processes_are_pinned_before_they_become_real_time() {
        assert_eq!(Scheduling::default().prefix(), [] as [String; 0]);
        let both = Scheduling { policy: Policy::Fifo, cpus: vec![0, 1], priority: 40 };
        assert_eq!(both.prefix(), ["taskset", "--cpu-list", "0,1", "chrt", "--fifo", "40"]);
    }

    #[test]
    fn a_processor_that_is_not_there_is_refused() {
        let arguments = SchedulingArguments { sched: Policy::Other, cpu: Some("1000".to_owned()) };
        let error = Scheduling::read(&arguments).unwrap_err();
        assert!(error.to_string().contains("processor 1000 is not among"), "{error}");
    }
}
