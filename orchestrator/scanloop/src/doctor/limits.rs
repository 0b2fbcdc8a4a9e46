//! Limits of this process, its user and its control groups.

use console::control_group;
use console::limits::{ExaminedLimit, examine, hard_limit};

use super::check::{Check, size};
use super::root::Root;

/// Processes and threads of a system: 13 were counted while one drove and recorded; a swap, a view and studies add to them.
const TASKS_OF_A_SYSTEM: u64 = 48;
/// Memory of a system: resident pages of one that drove and recorded added up to 140 MiB [bytes].
const MEMORY_OF_A_SYSTEM: u64 = 256 << 20;
/// Memory that a process of `--realtime` locks at most [bytes].
const LOCKED_BYTES: u64 = 64 << 20;
/// The priority of `--realtime`.
const PRIORITY: u64 = 40;

/// Bits of the capabilities of a process that lift a limit.
const CAP_IPC_LOCK: u32 = 14;
const CAP_SYS_NICE: u32 = 23;
const CAP_SYS_RESOURCE: u32 = 24;

/// The limits that `run` refuses to start with, those that are named most on lines of their own.
pub(super) fn of_process(root: &Root) -> [Check; 3] {
    let found = examine(&root.read("proc/self/limits").unwrap_or_default());
    let one = |name: &'static str, limit: &str, shown: fn(u64) -> String| {
        let Some(found) = found.iter().find(|found| found.name == limit) else {
            return Check::ok(name, "the kernel does not tell");
        };
        match &found.fault {
            None => Check::ok(name, shown(found.hard)),
            Some(fault) => with_fix(name, fault),
        }
    };
    let own = ["Max open files", "Max file size"];
    let others: Vec<&ExaminedLimit> = found.iter().filter(|found| !own.contains(&found.name)).collect();
    let faults: Vec<&str> = others.iter().filter_map(|found| found.fault.as_deref()).collect();
    [
        one(
            "open_files",
            own[0],
            |count| if count == u64::MAX { "unlimited".to_owned() } else { count.to_string() },
        ),
        one("file_size", own[1], size),
        match faults.first() {
            Some(first) => with_fix("other_limits", first),
            None => Check::ok("other_limits", "addresses, data, stack and processor time suffice"),
        },
    ]
}

/// `at most 64 files may be open, 256 are needed: ``ulimit -n 256```, with the command as the fix.
fn with_fix(name: &'static str, fault: &str) -> Check {
    let (what, command) = fault.split_once(": ").unwrap_or((fault, ""));
    Check::fail(name, what, format!("{command}, or `Limit...` of the systemd unit; root may raise it"))
}

/// Processes and threads of this user.
pub(super) fn processes(root: &Root) -> Check {
    let name = "processes";
    let limit = hard_limit(&root.read("proc/self/limits").unwrap_or_default(), "Max processes");
    let Some(limit) = limit.filter(|limit| *limit < u64::MAX) else { return Check::ok(name, "unlimited") };
    if has_capability(root, CAP_SYS_RESOURCE) {
        return Check::ok(name, format!("{limit}, which does not hold for this user"));
    }
    let used = threads_of_user(root);
    let detail = format!("{used} of {limit} processes and threads of this user are in use");
    if limit.saturating_sub(used) < TASKS_OF_A_SYSTEM {
        let needed = used + TASKS_OF_A_SYSTEM;
        return Check::fail(
            name,
            format!("{detail}, a system needs {TASKS_OF_A_SYSTEM}"),
            format!("`ulimit -u {needed}`"),
        );
    }
    Check::ok(name, detail)
}

/// Processes and threads of the control groups.
pub(super) fn tasks(root: &Root) -> Check {
    let name = "tasks";
    let Some(left) = control_group::processes_left(root.path()) else {
        return Check::ok(name, "no control group limits them");
    };
    let detail = format!("control group {} allows {} more processes and threads", left.group, left.limit);
    if left.limit < TASKS_OF_A_SYSTEM {
        let fix = "raise `pids.max`: `TasksMax=` of a systemd unit, `--pids-limit` of a container";
        return Check::fail(name, format!("{detail}, a system needs {TASKS_OF_A_SYSTEM}"), fix);
    }
    Check::ok(name, detail)
}

/// Memory of the control groups.
pub(super) fn memory(root: &Root) -> Check {
    let name = "memory";
    let Some(most) = control_group::memory_limit_in(root.path()) else {
        return Check::ok(name, "no control group limits it");
    };
    let detail = format!("control group {} allows {}", most.group, size(most.limit));
    if most.limit < MEMORY_OF_A_SYSTEM {
        let detail = format!("{detail}, a system needs {}", size(MEMORY_OF_A_SYSTEM));
        let fix = "raise `memory.max`: `MemoryMax=` of a systemd unit, `--memory` of a container";
        return Check::fail(name, detail, fix);
    }
    Check::ok(name, detail)
}

/// What `--realtime` may lock.
pub(super) fn locked_memory(root: &Root) -> Check {
    let name = "locked_memory";
    let limit = hard_limit(&root.read("proc/self/limits").unwrap_or_default(), "Max locked memory");
    let limit = limit.unwrap_or(u64::MAX);
    if limit >= LOCKED_BYTES || has_capability(root, CAP_IPC_LOCK) {
        return Check::ok(
            name,
            if limit >= LOCKED_BYTES { size(limit) } else { "allowed by CAP_IPC_LOCK".to_owned() },
        );
    }
    let detail = format!("{}: `--realtime` can't lock its memory", size(limit));
    let fix = "`LimitMEMLOCK=infinity` of a systemd unit, or `memlock unlimited` in /etc/security/limits.d";
    Check::warn(name, detail, fix)
}

/// Whether `--realtime` gets its priority.
pub(super) fn realtime_priority(root: &Root) -> Check {
    let name = "realtime_priority";
    let limit = hard_limit(&root.read("proc/self/limits").unwrap_or_default(), "Max realtime priority");
    let limit = limit.unwrap_or(0);
    if limit >= PRIORITY {
        return Check::ok(name, format!("up to {}", limit.min(99)));
    }
    if has_capability(root, CAP_SYS_NICE) {
        return Check::ok(name, "allowed by CAP_SYS_NICE");
    }
    let detail = format!("up to {limit}: `--realtime` can't have SCHED_FIFO at {PRIORITY}");
    let fix = format!(
        "`LimitRTPRIO={PRIORITY}` of a systemd unit, or `rtprio {PRIORITY}` in /etc/security/limits.d"
    );
    Check::warn(name, detail, fix)
}

/// Whether this process has a capability by its bit.
fn has_capability(root: &Root, bit: u32) -> bool {
    let status = root.read("proc/self/status").unwrap_or_default();
    let mask = value(&status, "CapEff:").and_then(|text| u64::from_str_radix(text, 16).ok());
    mask.is_some_and(|mask| mask >> bit & 1 == 1)
}

/// Threads of all processes of the user of this process.
fn threads_of_user(root: &Root) -> u64 {
    let user = |status: &str| value(status, "Uid:").map(str::to_owned);
    let own = user(&root.read("proc/self/status").unwrap_or_default());
    let entries = std::fs::read_dir(root.join("proc")).into_iter().flatten().flatten();
    let numbered =
        entries.filter(|entry| entry.file_name().to_string_lossy().bytes().all(|byte| byte.is_ascii_digit()));
    let statuses = numbered.filter_map(|entry| std::fs::read_to_string(entry.path().join("status")).ok());
    let threads = statuses.filter(|status| user(status) == own);
    threads.filter_map(|status| value(&status, "Threads:")?.parse::<u64>().ok()).sum()
}

/// The first word behind a name in `/proc/PID/status`.
fn value<'a>(status: &'a str, name: &str) -> Option<&'a str> {
    status.lines().find_map(|line| line.strip_prefix(name))?.split_whitespace().next()
}

#[cfg(test)]
mod tests {
    use super::super::check::State::{self, Fail, Ok, Warn};
    use super::super::root::made_up::Machine;
    use super::*;

    const LIMITS: &str = "Limit                     Soft Limit           Hard Limit           Units\n\
        Max cpu time              unlimited            unlimited            seconds\n\
        Max file size             unlimited            unlimited            bytes\n\
        Max data size             unlimited            unlimited            bytes\n\
        Max stack size            8388608              unlimited            bytes\n\
        Max processes             100                  100                  processes\n\
        Max open files            1024                 4096                 files\n\
        Max locked memory         8388608              8388608              bytes\n\
        Max address space         unlimited            unlimited            bytes\n\
        Max realtime priority     0                    0\n";
    const USER: &str =
        "Name:\tscanloop\nUid:\t1000\t1000\t1000\t1000\nThreads:\t1\nCapEff:\t0000000000000000\n";

    fn machine(name: &str, limits: &str, status: &str) -> Machine {
        Machine::new(name, &[("proc/self/limits", limits), ("proc/self/status", status)])
    }

    fn states<const N: usize>(checks: &[Check; N]) -> [State; N] {
        std::array::from_fn(|index| checks[index].state)
    }

    #[test]
    fn each_limit_that_is_too_small_fails_with_the_command_that_raises_it() {
        let usual = machine("limits-usual", LIMITS, USER);
        assert_eq!(states(&of_process(&usual.root)), [Ok; 3]);
        let small = LIMITS.replace("1024                 4096", "64                   64  ");
        let few = machine("limits-few", &small, USER);
        let checks = of_process(&few.root);
        assert_eq!(states(&checks), [Fail, Ok, Ok]);
        assert_eq!(checks[0].detail, "at most 64 files may be open, 256 are needed");
        assert!(checks[0].fix.as_ref().is_some_and(|fix| fix.starts_with("`ulimit -n 256`")));
        let text = LIMITS
            .replace("Max data size             unlimited            unlimited", "Max data size 1024 1024");
        assert_eq!(states(&of_process(&machine("limits-data", &text, USER).root)), [Ok, Ok, Fail]);
    }

    #[test]
    fn processes_of_the_user_count_with_their_threads_and_not_for_root() {
        let machine = machine("limits-tasks", LIMITS, USER);
        for (pid, threads, uid) in [(7, 30, 1000), (8, 20, 1000), (9, 500, 0)] {
            let status = format!("Uid:\t{uid}\t{uid}\t{uid}\t{uid}\nThreads:\t{threads}\n");
            machine.write(&format!("proc/{pid}/status"), &status);
        }
        assert_eq!(processes(&machine.root).state, Ok);
        machine.write("proc/7/status", "Uid:\t1000\nThreads:\t33\n");
        let full = processes(&machine.root);
        assert_eq!(full.state, Fail);
        assert!(full.detail.starts_with("53 of 100 processes and threads"), "{}", full.detail);
        machine.write("proc/self/status", &USER.replace("0000000000000000", "000001ffffffffff"));
        assert_eq!(processes(&machine.root).state, Ok);
    }

    #[test]
    fn what_realtime_needs_is_a_warning_unless_a_capability_allows_it() {
        let user = machine("limits-realtime", LIMITS, USER);
        assert_eq!([locked_memory(&user.root).state, realtime_priority(&user.root).state], [Warn; 2]);
        user.write("proc/self/status", &USER.replace("0000000000000000", "0000000000804000"));
        assert_eq!([locked_memory(&user.root).state, realtime_priority(&user.root).state], [Ok; 2]);
        let allowed =
            LIMITS.replace("priority     0                    0", "priority     98                   98");
        user.write("proc/self/status", USER);
        user.write("proc/self/limits", &allowed);
        assert_eq!(realtime_priority(&user.root).detail, "up to 98");
    }

    #[test]
    fn control_groups_of_both_versions_limit_tasks_and_memory() {
        let second = Machine::new(
            "limits-groups",
            &[
                ("proc/self/cgroup", "0::/robot.slice/drive.service\n"),
                ("sys/fs/cgroup/robot.slice/drive.service/pids.max", "max\n"),
                ("sys/fs/cgroup/robot.slice/pids.max", "60\n"),
                ("sys/fs/cgroup/robot.slice/pids.current", "20\n"),
                ("sys/fs/cgroup/robot.slice/memory.max", "67108864\n"),
            ],
        );
        let found = tasks(&second.root);
        assert_eq!(
            (found.state, found.detail.starts_with("control group /robot.slice allows 40 more")),
            (Fail, true)
        );
        assert_eq!(memory(&second.root).state, Fail);
        let first = Machine::new(
            "limits-groups-first",
            &[
                ("proc/self/cgroup", "3:pids:/a\n4:memory:/a\n"),
                ("sys/fs/cgroup/pids/a/pids.max", "500\n"),
                ("sys/fs/cgroup/pids/a/pids.current", "20\n"),
                ("sys/fs/cgroup/memory/a/memory.limit_in_bytes", "1073741824\n"),
            ],
        );
        assert_eq!([tasks(&first.root).state, memory(&first.root).state], [Ok; 2]);
        let none = Machine::new("limits-no-groups", &[]);
        assert_eq!([tasks(&none.root).state, memory(&none.root).state], [Ok; 2]);
    }
}
