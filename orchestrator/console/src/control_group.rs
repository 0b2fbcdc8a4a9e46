//! The control group of a process: its limits, and whether it is frozen. Both versions of the interface are read.
//!
//! Limit: in a container that does not show the file system of control groups, nothing is found.

use std::path::{Path, PathBuf};

/// Where the kernel shows control groups.
const ROOT: &str = "/sys/fs/cgroup";

/// A limit of a control group that is reached.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reached {
    /// The group, as a path.
    pub group: String,
    /// The most that it allows.
    pub limit: u64,
}

/// The control group of this process, or one above it, whose number of processes and threads has reached its limit.
pub fn processes_reached() -> Option<Reached> {
    folders("self", "pids").into_iter().find_map(|folder| {
        let limit = number(&folder.join("pids.max"))?;
        (number(&folder.join("pids.current"))? >= limit).then(|| Reached { group: name(&folder), limit })
    })
}

/// The smallest limit of processes and threads of the control groups of this process, if one of them has refused a start.
/// Meanwhile some of them may have ended.
pub fn processes_refused() -> Option<Reached> {
    let folders = folders("self", "pids");
    let has_refused = |folder: &PathBuf| {
        let events = std::fs::read_to_string(folder.join("pids.events")).unwrap_or_default();
        events.lines().any(|line| line.strip_prefix("max ").is_some_and(|count| count.trim() != "0"))
    };
    let limit =
        |folder: &PathBuf| Some(Reached { group: name(folder), limit: number(&folder.join("pids.max"))? });
    let is_refused = folders.iter().any(has_refused);
    folders.iter().filter_map(limit).min_by_key(|found| found.limit).filter(|_| is_refused)
}

/// The smallest limit of memory of the control groups of this process [bytes].
pub fn memory_limit() -> Option<Reached> {
    let of = |folder: PathBuf| {
        let limit = number(&folder.join("memory.max")).or_else(|| {
            number(&folder.join("memory.limit_in_bytes")).filter(|limit| *limit < u64::MAX / 4)
        })?;
        Some(Reached { group: name(&folder), limit })
    };
    folders("self", "memory").into_iter().filter_map(of).min_by_key(|found| found.limit)
}

/// How many processes the kernel has killed because control groups of this process had no memory left; 0 when unknown.
pub fn out_of_memory_kills() -> u64 {
    let of = |folder: PathBuf| {
        let files = ["memory.events", "memory.oom_control"];
        let text = files.into_iter().find_map(|file| std::fs::read_to_string(folder.join(file)).ok())?;
        text.lines().find_map(|line| line.strip_prefix("oom_kill "))?.trim().parse::<u64>().ok()
    };
    folders("self", "memory").into_iter().filter_map(of).max().unwrap_or(0)
}

/// Whether a process can't run because its control group is frozen.
pub fn is_frozen(pid: u32) -> bool {
    let of = |folder: &PathBuf| {
        let events = std::fs::read_to_string(folder.join("cgroup.events")).unwrap_or_default();
        let state = std::fs::read_to_string(folder.join("freezer.state")).unwrap_or_default();
        events.lines().any(|line| line == "frozen 1") || matches!(state.trim(), "FROZEN" | "FREEZING")
    };
    folders(&pid.to_string(), "freezer").iter().any(of)
}

/// The folders of the control groups that a process is in for a controller, the innermost first.
fn folders(pid: &str, controller: &str) -> Vec<PathBuf> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/cgroup")).unwrap_or_default();
    let mut found = Vec::new();
    for (root, path) in text.lines().filter_map(|line| root_of(line, controller)) {
        let group = root.join(path.trim_start_matches('/'));
        found.extend(group.ancestors().take_while(|above| above.starts_with(&root)).map(Path::to_path_buf));
    }
    found
}

/// The folder of the hierarchy that a line of `/proc/PID/cgroup` is about, and the path in it; `None` when it is not that
/// of the controller.
fn root_of<'a>(line: &'a str, controller: &str) -> Option<(PathBuf, &'a str)> {
    let mut parts = line.splitn(3, ':');
    let (_number, controllers, path) = (parts.next()?, parts.next()?, parts.next()?);
    match controllers {
        // The second version has one hierarchy, beside the others where both are in use.
        "" if Path::new(ROOT).join("unified").is_dir() => Some((Path::new(ROOT).join("unified"), path)),
        "" => Some((ROOT.into(), path)),
        _ if controllers.split(',').any(|name| name == controller) => {
            Some((Path::new(ROOT).join(controller), path))
        }
        _ => None,
    }
}

fn name(folder: &Path) -> String {
    let below = folder.strip_prefix(ROOT).unwrap_or(folder);
    format!("/{}", below.display())
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
