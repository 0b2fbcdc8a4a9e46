//! The control group of a process: its limits, and whether it is frozen. Both versions of the interface are read.
//!
//! Limit: in a container that does not show the file system of control groups, nothing is found.

use std::path::{Path, PathBuf};

/// Where the kernel shows control groups, below the root of all files.
const GROUPS: &str = "sys/fs/cgroup";

/// A limit of a control group that is reached.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reached {
    /// The group, as a path.
    pub group: String,
    /// The most that it allows.
    pub limit: u64,
}

/// A share of the processors that a control group may use.
#[derive(Debug, Clone, PartialEq)]
pub struct ProcessorShare {
    /// The group, as a path.
    pub group: String,
    /// Time on processors in each period [us].
    pub quota_us: u64,
    /// The period [us].
    pub period_us: u64,
}

/// The control group of this process, or one above it, that allows the fewest further processes and threads: how many more
/// it allows. The files of the machine are those below `root`.
pub fn processes_left(root: &Path) -> Option<Reached> {
    let of = |folder: PathBuf| {
        let (most, now) = (number(&folder.join("pids.max"))?, number(&folder.join("pids.current"))?);
        Some(Reached { group: name(root, &folder), limit: most.saturating_sub(now) })
    };
    folders(root, "self", "pids").into_iter().filter_map(of).min_by_key(|found| found.limit)
}

/// The smallest share of the processors among the control groups of this process.
pub fn processor_share(root: &Path) -> Option<ProcessorShare> {
    let of = |folder: PathBuf| {
        let first = || {
            let text = std::fs::read_to_string(folder.join("cpu.max")).ok()?;
            let (quota, period) = text.trim().split_once(' ')?;
            Some((quota.parse().ok()?, period.parse().ok()?))
        };
        let second =
            || Some((number(&folder.join("cpu.cfs_quota_us"))?, number(&folder.join("cpu.cfs_period_us"))?));
        let (quota_us, period_us) = first().or_else(second)?;
        Some(ProcessorShare { group: name(root, &folder), quota_us, period_us })
    };
    let share = |found: &ProcessorShare| found.quota_us as f64 / found.period_us.max(1) as f64;
    let found = folders(root, "self", "cpu").into_iter().filter_map(of);
    found.min_by(|one, other| share(one).total_cmp(&share(other)))
}

/// The control group of this process, or one above it, whose number of processes and threads has reached its limit.
pub fn processes_reached() -> Option<Reached> {
    folders(machine(), "self", "pids").into_iter().find_map(|folder| {
        let limit = number(&folder.join("pids.max"))?;
        let is_reached = number(&folder.join("pids.current"))? >= limit;
        is_reached.then(|| Reached { group: name(machine(), &folder), limit })
    })
}

/// The smallest limit of processes and threads of the control groups of this process, if one of them has refused a start.
/// Meanwhile some of them may have ended.
pub fn processes_refused() -> Option<Reached> {
    let folders = folders(machine(), "self", "pids");
    let has_refused = |folder: &PathBuf| {
        let events = std::fs::read_to_string(folder.join("pids.events")).unwrap_or_default();
        events.lines().any(|line| line.strip_prefix("max ").is_some_and(|count| count.trim() != "0"))
    };
    let limit = |folder: &PathBuf| {
        Some(Reached { group: name(machine(), folder), limit: number(&folder.join("pids.max"))? })
    };
    let is_refused = folders.iter().any(has_refused);
    folders.iter().filter_map(limit).min_by_key(|found| found.limit).filter(|_| is_refused)
}

/// The smallest limit of memory of the control groups of this process [bytes].
pub fn memory_limit() -> Option<Reached> {
    memory_limit_in(machine())
}

/// [`memory_limit`] with the files of the machine below `root`.
pub fn memory_limit_in(root: &Path) -> Option<Reached> {
    let of = |folder: PathBuf| {
        let limit = number(&folder.join("memory.max")).or_else(|| {
            number(&folder.join("memory.limit_in_bytes")).filter(|limit| *limit < u64::MAX / 4)
        })?;
        Some(Reached { group: name(root, &folder), limit })
    };
    folders(root, "self", "memory").into_iter().filter_map(of).min_by_key(|found| found.limit)
}

/// How many processes the kernel has killed because control groups of this process had no memory left; 0 when unknown.
pub fn out_of_memory_kills() -> u64 {
    let of = |folder: PathBuf| {
        let files = ["memory.events", "memory.oom_control"];
        let text = files.into_iter().find_map(|file| std::fs::read_to_string(folder.join(file)).ok())?;
        text.lines().find_map(|line| line.strip_prefix("oom_kill "))?.trim().parse::<u64>().ok()
    };
    folders(machine(), "self", "memory").into_iter().filter_map(of).max().unwrap_or(0)
}

/// Whether a process can't run because its control group is frozen.
pub fn is_frozen(pid: u32) -> bool {
    let of = |folder: &PathBuf| {
        let events = std::fs::read_to_string(folder.join("cgroup.events")).unwrap_or_default();
        let state = std::fs::read_to_string(folder.join("freezer.state")).unwrap_or_default();
        events.lines().any(|line| line == "frozen 1") || matches!(state.trim(), "FROZEN" | "FREEZING")
    };
    folders(machine(), &pid.to_string(), "freezer").iter().any(of)
}

/// The folders of the control groups that a process is in for a controller, the innermost first.
fn folders(root: &Path, pid: &str, controller: &str) -> Vec<PathBuf> {
    let text = std::fs::read_to_string(root.join("proc").join(pid).join("cgroup")).unwrap_or_default();
    let mut found = Vec::new();
    for (hierarchy, path) in text.lines().filter_map(|line| hierarchy_of(root, line, controller)) {
        let group = hierarchy.join(path.trim_start_matches('/'));
        found.extend(
            group.ancestors().take_while(|above| above.starts_with(&hierarchy)).map(Path::to_path_buf),
        );
    }
    found
}

/// The folder of the hierarchy that a line of `/proc/PID/cgroup` is about, and the path in it; `None` when it is not that
/// of the controller.
fn hierarchy_of<'a>(root: &Path, line: &'a str, controller: &str) -> Option<(PathBuf, &'a str)> {
    let mut parts = line.splitn(3, ':');
    let (_number, controllers, path) = (parts.next()?, parts.next()?, parts.next()?);
    match controllers {
        // The second version has one hierarchy, beside the others where both are in use.
        "" if root.join(GROUPS).join("unified").is_dir() => Some((root.join(GROUPS).join("unified"), path)),
        "" => Some((root.join(GROUPS), path)),
        _ if controllers.split(',').any(|name| name == controller) => {
            Some((root.join(GROUPS).join(controller), path))
        }
        _ => None,
    }
}

fn name(root: &Path, folder: &Path) -> String {
    let below = folder.strip_prefix(root.join(GROUPS)).unwrap_or(folder);
    format!("/{}", below.display())
}

/// The root of the files of this machine.
fn machine() -> &'static Path {
    Path::new("/")
}

/// `None` for a file that does not exist, and for `max`.
fn number(file: &Path) -> Option<u64> {
    std::fs::read_to_string(file).ok()?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_either_version_leads_to_its_folder() {
        let root_of = |line, controller| hierarchy_of(machine(), line, controller);
        let first = root_of("8:pids:/robot/drive", "pids").unwrap();
        assert_eq!(first, (PathBuf::from("/sys/fs/cgroup/pids"), "/robot/drive"));
        assert_eq!(root_of("8:pids:/robot", "memory"), None);
        let joined = root_of("4:cpu,cpuacct:/robot", "cpuacct").unwrap();
        assert_eq!(joined.1, "/robot");
        assert_eq!(root_of("0::/robot.service", "pids").unwrap().1, "/robot.service");
        assert_eq!(root_of("damaged", "pids"), None);
    }

    #[test]
    fn this_process_is_not_frozen() {
        assert!(!is_frozen(std::process::id()) && !is_frozen(u32::MAX));
    }
}
