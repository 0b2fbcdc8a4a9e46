//! What is around the processes: a container, a terminal, compilers, and the other programs of Scanloop.

use std::ffi::OsStr;
use std::path::PathBuf;

use runtime::{RUNTIME_DIR_VARIABLE, RuntimeError};

use super::check::Check;
use super::root::Root;

/// The link of a process in the first PID namespace of a machine.
const FIRST_NAMESPACE: &str = "pid:[4026531836]";
/// Columns and rows that `scanloop top` needs.
const TOP: [u16; 2] = [72, 20];

/// The terminal of this command.
pub(super) struct Terminal {
    /// Columns and rows; `None` where there is no terminal.
    pub size: Option<[u16; 2]>,
    /// The variable `TERM`.
    pub kind: String,
}

/// Whether this is a container, and sees the processes of the whole machine.
pub(super) fn container(root: &Root) -> Check {
    let name = "container";
    let marks = [".dockerenv", "run/.containerenv"];
    let mark = marks.iter().find(|mark| root.join(mark).exists());
    let mut found = mark.map_or_else(|| "none".to_owned(), |mark| format!("one (/{mark})"));
    // A kernel that does not tell is taken for the usual one.
    if root.link("proc/self/ns/pid").is_some_and(|namespace| namespace != FIRST_NAMESPACE) {
        found += ", with a PID namespace of its own: processes outside are not seen, and `stop` asks their orchestrator";
    }
    Check::ok(name, found)
}

/// Whether `scanloop top` can draw.
pub(super) fn terminal(terminal: &Terminal) -> Check {
    let name = "terminal";
    let Some([columns, rows]) = terminal.size else {
        return Check::ok(name, "none: `top` needs one, progress is not drawn");
    };
    let detail = format!("{columns} x {rows}, {}", terminal.kind);
    if ["", "dumb"].contains(&terminal.kind.as_str()) {
        return Check::warn(
            name,
            format!("{detail}: it may not move its cursor"),
            "`export TERM=xterm-256color`",
        );
    }
    if columns > 0 && (columns < TOP[0] || rows < TOP[1]) {
        return Check::warn(
            name,
            format!("{detail}: too small for `top`"),
            format!("{} x {} or more", TOP[0], TOP[1]),
        );
    }
    Check::ok(name, detail)
}

/// The programs that build a process of your own, on the `PATH`.
pub(super) fn compilers(root: &Root, path: &OsStr) -> Check {
    let name = "compilers";
    let is_there =
        |program: &&&str| std::env::split_paths(path).any(|folder| root.join(folder).join(program).is_file());
    let wanted = [("cc", "C"), ("cargo", "Rust"), ("python3", "Python")];
    let programs = wanted.map(|(program, _)| program);
    let found: Vec<&str> = programs.iter().filter(is_there).copied().collect();
    let missing = wanted.iter().filter(|(program, _)| !found.contains(program));
    let missing: Vec<String> =
        missing.map(|(program, language)| format!("{program} for {language}")).collect();
    if missing.is_empty() {
        return Check::ok(name, found.join(", "));
    }
    let detail = format!("found: {}", if found.is_empty() { "none".to_owned() } else { found.join(", ") });
    Check::warn(name, detail, format!("for a process of your own, install {}", missing.join(", ")))
}

/// The executable of the studies.
pub(super) fn laboratory(found: anyhow::Result<PathBuf>) -> Check {
    program("laboratory", found, "no studies")
}

/// The bridge between hosts.
pub(super) fn link(found: anyhow::Result<PathBuf>) -> Check {
    program("link", found, "no systems on several hosts")
}

/// The bridge to ROS 2.
pub(super) fn ros2(found: anyhow::Result<PathBuf>) -> Check {
    program("ros2", found, "no robots that speak ROS 2")
}

/// The lack of the files in which the kernel shows processes; `None` where they are there.
pub(super) fn processes_in_files(root: &Root) -> Option<Check> {
    let is_there = root.join("proc/self").exists();
    (!is_there).then(|| Check::fail("proc", "/proc is not mounted", "`mount -t proc proc /proc` as root"))
}

/// Where the directory of a new system can't be made; `None` where it can, so that all fits on a screen.
pub(super) fn runtime_directory(examined: Result<(), RuntimeError>) -> Option<Check> {
    let detail = match examined.err()? {
        RuntimeError::NotPrivate { path, reason } => format!("{} {reason}", path.display()),
        error => error.to_string(),
    };
    let fix = format!(
        "`export {RUNTIME_DIR_VARIABLE}=DIR` with the absolute path of a directory of this user with mode 0700, or unset it"
    );
    Some(Check::fail("runtime_directory", detail, fix))
}

fn program(name: &'static str, found: anyhow::Result<PathBuf>, without: &str) -> Check {
    match found {
        Ok(path) => Check::ok(name, path.display().to_string()),
        Err(missing) => Check::warn(name, format!("not found: {without}"), missing.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::check::State;
    use super::super::root::made_up::Machine;
    use super::*;

    #[test]
    fn a_container_is_known_by_its_mark_and_its_namespace() {
        let machine = Machine::new("around-container", &[(".dockerenv", ""), ("proc/self/ns/.keep", "")]);
        assert_eq!(container(&machine.root).detail, "one (/.dockerenv)");
        std::os::unix::fs::symlink("pid:[4026532011]", machine.root.join("proc/self/ns/pid")).unwrap();
        assert!(container(&machine.root).detail.contains("a PID namespace of its own"));
        assert!(processes_in_files(&machine.root).is_none());
        let none = Machine::new("around-none", &[]);
        assert_eq!(container(&none.root).detail, "none");
        assert_eq!(processes_in_files(&none.root).map(|check| check.state), Some(State::Fail));
    }

    #[test]
    fn a_terminal_that_is_small_or_dumb_is_a_warning_and_none_is_not() {
        let state = |size, kind: &str| terminal(&Terminal { size, kind: kind.to_owned() }).state;
        assert_eq!(state(None, ""), State::Ok);
        assert_eq!(state(Some([80, 24]), "xterm"), State::Ok);
        assert_eq!(state(Some([71, 24]), "xterm"), State::Warn);
        assert_eq!(state(Some([80, 24]), "dumb"), State::Warn);
    }

    #[test]
    fn compilers_are_searched_on_the_path() {
        let machine = Machine::new("around-compilers", &[("usr/bin/cc", ""), ("opt/bin/cargo", "")]);
        let found = compilers(&machine.root, OsStr::new("/usr/bin:/opt/bin"));
        assert_eq!(found.detail, "found: cc, cargo");
        assert!(found.fix.is_some_and(|fix| fix.ends_with("install python3 for Python")));
        machine.write("usr/bin/python3", "");
        assert_eq!(compilers(&machine.root, OsStr::new("/usr/bin:/opt/bin")).state, State::Ok);
        assert_eq!(compilers(&machine.root, OsStr::new("")).detail, "found: none");
    }

    #[test]
    fn a_program_that_is_missing_is_a_warning_with_what_builds_it() {
        assert_eq!(laboratory(Ok("/bin/scanloop-lab".into())).state, State::Ok);
        let missing = link(Err(anyhow::anyhow!("`cargo build`")));
        assert_eq!((missing.state, missing.fix.as_deref()), (State::Warn, Some("`cargo build`")));
    }
}
