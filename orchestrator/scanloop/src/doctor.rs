//! `scanloop doctor`: what this machine is missing for a drive, on one screen.
//!
//! Each check is a function of files below a root, and of facts that only a system call tells. So a test can make up a
//! machine. A check fails where a drive would not start or would be ended; it warns of what makes one worse or a command
//! impossible.

mod check;
mod limits;
mod processor;
mod root;
mod shared_memory;
mod surroundings;
mod systems;

use std::fmt::Write as _;
use std::path::Path;

use clap::Args;
use console::answer;
use console::exit::Exit;
use plan::system::ROS2;
use runtime::Domain;
use rustix::termios::{isatty, tcgetwinsize};
use serde::Serialize;
use supervision::child::other_program;

use crate::print_json;
use check::{Check, State};
use root::Root;
use shared_memory::Room;
use surroundings::Terminal;

/// Arguments of `doctor`.
#[derive(Debug, Args)]
pub struct DoctorArguments {
    /// Print the checks as JSON to standard output.
    #[arg(long)]
    pub json: bool,
}

/// All checks.
#[derive(Debug, Serialize)]
struct Report {
    checks: Vec<Check>,
}

/// Checks this machine for a system of that id, and prints the result. Exit code 1 if something would stop a drive.
///
/// # Errors
/// An output that can't be written.
pub(crate) fn doctor(system_id: &str, arguments: &DoctorArguments) -> anyhow::Result<Exit> {
    let report = Report { checks: examine(system_id, &Root::of_this_machine()) };
    print_json(arguments.json, &report)?;
    if !arguments.json {
        answer!(false, "{}", text(&report.checks))?;
    }
    let stops = report.checks.iter().any(|check| check.state == State::Fail);
    Ok(if stops { Exit::NotReached } else { Exit::Done })
}

fn examine(system_id: &str, root: &Root) -> Vec<Check> {
    let mut checks = vec![shared_memory::shared_memory(root, Room::now())];
    checks.extend(limits::of_process(root));
    checks.extend([
        limits::processes(root),
        limits::tasks(root),
        limits::memory(root),
        limits::locked_memory(root),
        limits::realtime_priority(root),
        processor::share(root),
        processor::clock_source(root),
        processor::governor(root),
        processor::idle_states(root, is_writable(processor::LATENCY_DEVICE)),
        surroundings::container(root),
        surroundings::terminal(&terminal()),
        surroundings::compilers(root, &std::env::var_os("PATH").unwrap_or_default()),
        surroundings::laboratory(crate::laboratory::find()),
        surroundings::link(agent::link::program()),
        surroundings::ros2(other_program(ROS2, "services/ros2")),
        systems::running(),
        systems::left_overs(),
    ]);
    checks.extend(surroundings::processes_in_files(root));
    let place = surroundings::runtime_directory(Domain::examine_place());
    checks.extend(place.or_else(|| systems::id(Domain::find(system_id))));
    checks
}

fn is_writable(path: &str) -> bool {
    rustix::fs::access(Path::new(path), rustix::fs::Access::WRITE_OK).is_ok()
}

fn terminal() -> Terminal {
    let is_there = isatty(std::io::stdin()) && isatty(std::io::stderr());
    let size = tcgetwinsize(std::io::stderr()).ok().filter(|_| is_there);
    Terminal {
        size: size.map(|size| [size.ws_col, size.ws_row]),
        kind: std::env::var("TERM").unwrap_or_default(),
    }
}

/// One line for each check, and one for its fix.
fn text(checks: &[Check]) -> String {
    let mut text = String::new();
    for Check { name, state, detail, fix } in checks {
        let _ = writeln!(text, "{:<5}{:<18}{detail}", state.name(), name.replace('_', " "));
        if let Some(fix) = fix {
            let _ = writeln!(text, "{:<23}-> {fix}", "");
        }
    }
    let count = |state| checks.iter().filter(|check| check.state == state).count();
    let _ = match (count(State::Fail), count(State::Warn)) {
        (0, 0) => writeln!(text, "This machine is ready."),
        (0, warnings) => writeln!(text, "This machine is ready to drive; warnings: {warnings}."),
        (failures, _) => writeln!(text, "A drive would be stopped; failures: {failures}."),
    };
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_check_is_one_line_and_one_with_its_fix() {
        let checks = [
            Check::ok("open_files", "1024"),
            Check::warn("clock_source", "hpet", "boot with tsc"),
            Check::fail("shared_memory", "none", "mount it"),
        ];
        let expected = "ok   open files        1024\n\
                        warn clock source      hpet\n                       -> boot with tsc\n\
                        fail shared memory     none\n                       -> mount it\n\
                        A drive would be stopped; failures: 1.\n";
        assert_eq!(text(&checks), expected);
        assert!(text(&checks[..2]).ends_with("This machine is ready to drive; warnings: 1.\n"));
        assert!(text(&checks[..1]).ends_with("This machine is ready.\n"));
    }

    #[test]
    fn this_machine_is_examined_in_a_screen_when_nothing_is_missing() {
        let checks = examine("default", &Root::of_this_machine());
        assert!(checks.len() <= 23, "with the last line, a terminal of 24 lines: {}", checks.len());
        let mut names: Vec<&str> = checks.iter().map(|check| check.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), checks.len(), "a name is used once");
    }
}
