//! Brings a run to a stop from outside: wheels blocked first, then rest, then the end of its processes.
//!
//! `scanloop stop`, a new run that finds an old one, and an orchestrator that ends for an error use it. It needs neither
//! the orchestrator nor the bus, the directory or the lock of the run.
//!
//! 1. [`block`]: the stop word is latched; actuator and robot are woken (CONT), asked to end (TERM) when they do not
//!    acknowledge. The actuator is killed after `KILL_AFTER_NS`, so that the dead man of the robot blocks in the end.
//! 2. [`finish`]: the orchestrator is given time to end its run itself. Then controller, obstacles and estimator end, then
//!    the actuator, then the robot, and last an orchestrator that does not respond. A robot is killed only when it is
//!    known to rest; otherwise it is left and named.
//! 3. Strays are asked to end, then killed. One may start processes again and again, so the search is repeated until it
//!    finds none. Those of actuator and robot are killed once no process of the run is left.

use std::time::Duration;

use runtime::{
    Domain, Identified, Identity, StopWord, Wheels, monotonic_ns, remove_bus_files_of, start_ticks,
};
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};
use shared_types::Role;

use crate::runs::{LivingRun, RunProcess};

/// The whole stop lasts this long at most, but not less than [`KILL_AFTER_NS`] and two scan periods [ns].
const LIMIT_NS: u64 = 1_000_000_000;
/// Of the limit, what is left for the start and the end of the command [ns].
const MARGIN_NS: u64 = 60_000_000;
/// An actuator or robot that does not acknowledge within this time is asked to end [ns].
const TERM_AFTER_NS: u64 = 100_000_000;
/// An actuator that does not acknowledge after this time is killed [ns].
const KILL_AFTER_NS: u64 = 300_000_000;
/// An orchestrator that responds ends its run within this time [ns].
const ORCHESTRATOR_NS: u64 = 8_000_000_000;
/// Wheels that were blocked at 2 m/s rest after 0.4 s; a robot that does not report is waited for this long [ns].
const REST_NS: u64 = 2_000_000_000;
/// Between the request to end and the kill [ns].
const GRACE_NS: u64 = 1_500_000_000;
/// A killed process ends within this time unless it hangs in the kernel [ns].
const KILLED_NS: u64 = 1_000_000_000;
/// Strays that start processes again and again are searched and killed for this long [ns].
const SWEEP_NS: u64 = 2_000_000_000;
/// The end of an orchestrator, of the processes of its run and of its strays takes less [ns].
const STRAYS_NS: u64 = 15_000_000_000;
/// Time between two searches for strays, each of which reads all of `/proc`.
const SEARCH_POLL: Duration = Duration::from_millis(20);
/// Time between two checks.
const POLL: Duration = Duration::from_millis(2);

/// What became of the request to block the wheels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Blocked {
    /// Whether the robot, or the actuator for one that does not report, has acknowledged.
    pub confirmed: bool,
    /// Time since the request [ns].
    pub after_ns: u64,
}

/// How long [`block`] may take for a run [ns].
pub fn limit_ns(run: &LivingRun) -> u64 {
    let period_ns = run.word.as_ref().map_or(0, StopWord::period_ns);
    LIMIT_NS.max(KILL_AFTER_NS + 2 * period_ns) - MARGIN_NS
}

/// Latches the stop of a run and waits until its wheels are blocked.
pub fn block(run: &LivingRun) -> Blocked {
    let began_ns = monotonic_ns();
    if let Some(word) = &run.word {
        word.latch();
    }
    let actuators: Vec<Identified> = run.of_role(Role::Actuator).collect();
    let robots: Vec<Identified> = run.of_role(Role::Robot).collect();
    actuators.iter().chain(&robots).for_each(|process| process.signal(Signal::CONT));
    // A robot on another host does not end with what stands for it here.
    let is_elsewhere = run.others().any(|process| process.role == Some(Role::Robot) && is_proxy(process));
    let (mut termed, mut killed) = (false, false);
    loop {
        let after_ns = monotonic_ns() - began_ns;
        if is_blocked(run, &robots, is_elsewhere) {
            return Blocked { confirmed: true, after_ns };
        }
        if after_ns >= limit_ns(run) {
            return Blocked { confirmed: false, after_ns };
        }
        if !termed && (after_ns >= TERM_AFTER_NS || run.word.is_none()) {
            termed = true;
            ask_to_end(&actuators);
            ask_to_end(&robots);
        }
        if !killed && after_ns >= KILL_AFTER_NS {
            killed = true;
            actuators.iter().for_each(|process| process.signal(Signal::KILL));
        }
        std::thread::sleep(POLL);
    }
}

/// Whether the wheels are known to be blocked since the stop: by the robot, or by the actuator for a robot that does not
/// report. Without a process of the role robot there are none, except on another host.
fn is_blocked(run: &LivingRun, robots: &[Identified], is_elsewhere: bool) -> bool {
    // Without a free descriptor a process can't be opened, and lives nevertheless.
    let own = run.others().filter(|process| process.identity.uid == run.uid);
    let rows = own.filter(|process| process.role == Some(Role::Robot));
    let lives =
        |process: &RunProcess| start_ticks(process.identity.pid) == Some(process.identity.start_ticks);
    if !is_elsewhere && have_ended(robots) && !rows.clone().any(lives) {
        return true;
    }
    let Some(word) = &run.word else { return false };
    let reports = rows.clone().any(|robot| robot.identity.pid == word.obeyed_by(Role::Robot));
    let (wheels, seen_ns) = word.wheels(if reports { Role::Robot } else { Role::Actuator });
    wheels >= Wheels::Blocked && seen_ns >= word.stopped_ns()
}

/// Whether a process stands for one on another host: it is `scanloop remote HOST IMPLEMENTATION`.
fn is_proxy(process: &RunProcess) -> bool {
    let line = std::fs::read(format!("/proc/{}/cmdline", process.identity.pid)).unwrap_or_default();
    line.split(|byte| *byte == 0).nth(1) == Some(b"remote")
}

/// Waits until no process of the run lives, for `timeout_ns` at most; returns whether none does.
pub fn wait_for_end(run: &LivingRun, timeout_ns: u64) -> bool {
    wait_until(timeout_ns, POLL, || run.is_over())
}

/// Ends all processes of a run that was stopped and removes its files; returns labels of those that could not be ended.
pub fn finish(run: &LivingRun) -> Vec<String> {
    if let Some(pid) = foreign_orchestrator(run) {
        signal_orchestrator(run, pid, Signal::CONT);
        wait_for_end(run, ORCHESTRATOR_NS);
    }
    let mut left = end_processes(run);
    if let Some(pid) = foreign_orchestrator(run) {
        end_orchestrator(run, pid);
        left.extend(foreign_orchestrator(run).map(|pid| format!("orchestrator {pid}")));
    }
    clean(run);
    left
}

/// Ends all processes of a run whose wheels were blocked, but no orchestrator; returns labels of those that are left.
pub fn end_processes(run: &LivingRun) -> Vec<String> {
    // More processes may have been started since `run` was read.
    let now = LivingRun::with_strays(run.uid).into_iter().find(|found| found.run_id == run.run_id);
    let run = now.unwrap_or_else(|| run.clone());
    let others = run.others();
    let others = others.filter(|process| !matches!(process.role, Some(Role::Actuator | Role::Robot)));
    end_all(others.filter_map(|process| process.open()).collect());
    sweep(|| strays_of(&[&run], |stray| !is_of_wheels(stray)));
    end_all(run.of_role(Role::Actuator).collect());
    end_robots(&run);
    if run.members().next().is_none() {
        end_strays(&[&run]);
    }
    run.members().map(RunProcess::label).chain(run.strays().map(RunProcess::description)).collect()
}

/// Ends the processes of the run that this orchestrator drove and gives up: first the wheels are blocked.
pub fn end_own_run(domain: &Domain, stop_word: &StopWord) {
    stop_word.latch();
    let Some(run) = LivingRun::of(domain.run_id()) else { return };
    block(&run);
    for left in end_processes(&run) {
        tracing::error!("{left} does not end, and is not known to rest: it is left");
    }
}

/// Ends the strays of runs, also those that they start meanwhile; returns those that live after it.
pub fn end_strays(runs: &[&LivingRun]) -> Vec<RunProcess> {
    let search = || strays_of(runs, |_| true);
    let asked: Vec<Identified> = search().iter().filter_map(RunProcess::open).collect();
    ask_to_end(&asked);
    let have_all_ended = || have_ended(&asked) && search().is_empty();
    if !wait_until(GRACE_NS, SEARCH_POLL, have_all_ended) {
        sweep(search);
    }
    search()
}

/// Waits until another process has ended the strays of a run; returns those that live after it.
pub fn wait_for_strays(run: &LivingRun) -> Vec<RunProcess> {
    let search = || strays_of(&[run], |_| true);
    wait_until(STRAYS_NS, SEARCH_POLL, || search().is_empty());
    search()
}

/// The strays of runs that live now.
fn strays_of(runs: &[&LivingRun], is_wanted: impl Fn(&RunProcess) -> bool) -> Vec<RunProcess> {
    let Some(uid) = runs.first().map(|run| run.uid) else { return Vec::new() };
    let found = LivingRun::with_strays(uid).into_iter();
    let found = found.filter(|found| runs.iter().any(|run| run.run_id == found.run_id));
    found.flat_map(|run| run.strays().filter(|stray| is_wanted(stray)).cloned().collect::<Vec<_>>()).collect()
}

/// Whether a stray may be what makes the robot move and stop.
fn is_of_wheels(stray: &RunProcess) -> bool {
    matches!(stray.role, Some(Role::Actuator | Role::Robot))
}

/// Kills all that a search finds, and searches again until it finds none, for [`SWEEP_NS`] at most.
///
/// A process that is killed may be started again by another one. So all are suspended first, until a search finds no new
/// one, and killed then.
fn sweep(search: impl Fn() -> Vec<RunProcess>) {
    let deadline_ns = monotonic_ns() + SWEEP_NS;
    let mut suspended: Vec<Identity> = Vec::new();
    loop {
        let found = search();
        if found.is_empty() {
            return;
        }
        let opened: Vec<Identified> = found.iter().filter_map(RunProcess::open).collect();
        let is_over = monotonic_ns() >= deadline_ns;
        if is_over || found.iter().all(|process| suspended.contains(&process.identity)) {
            kill(&opened);
        } else {
            opened.iter().for_each(|process| process.signal(Signal::STOP));
        }
        if is_over {
            return;
        }
        suspended = found.into_iter().map(|process| process.identity).collect();
    }
}

/// The orchestrator of the run, unless it is this process.
fn foreign_orchestrator(run: &LivingRun) -> Option<u32> {
    run.orchestrator().filter(|pid| *pid != std::process::id())
}

/// TERM, grace, KILL.
fn end_all(processes: Vec<Identified>) {
    ask_to_end(&processes);
    if !wait_until(GRACE_NS, POLL, || have_ended(&processes)) {
        kill(&processes);
    }
}

fn ask_to_end(processes: &[Identified]) {
    for process in processes {
        process.signal(Signal::TERM);
        process.signal(Signal::CONT);
    }
}

fn kill(processes: &[Identified]) {
    processes.iter().for_each(|process| process.signal(Signal::KILL));
    wait_until(KILLED_NS, POLL, || have_ended(processes));
}

/// A robot ends when it rests; one that does not report is given the time to. It is killed only when it is known to rest.
fn end_robots(run: &LivingRun) {
    let robots: Vec<Identified> = run.of_role(Role::Robot).collect();
    let rests = || run.word.as_ref().is_some_and(|word| word.wheels(Role::Robot).0 == Wheels::Resting);
    wait_until(REST_NS, POLL, || rests() || have_ended(&robots));
    ask_to_end(&robots);
    if !wait_until(GRACE_NS, POLL, || have_ended(&robots)) && rests() {
        kill(&robots);
    }
}

/// Ends an orchestrator that does not respond. If a service manager would start it again, leaves a mark that prevents a
/// new run.
fn end_orchestrator(run: &LivingRun, pid: u32) {
    let starts_again = std::fs::read(format!("/proc/{pid}/cmdline"))
        .is_ok_and(|line| line.split(|byte| *byte == 0).any(|word| word == b"--adopt-or-start"));
    if starts_again && let Err(error) = Domain::mark_stopped(&run.system_id) {
        tracing::warn!("a service manager may start the system again: {error}");
    }
    signal_orchestrator(run, pid, Signal::KILL);
    wait_for_end(run, KILLED_NS);
}

fn have_ended(processes: &[Identified]) -> bool {
    processes.iter().all(Identified::has_ended)
}

fn wait_until(timeout_ns: u64, poll: Duration, is_done: impl Fn() -> bool) -> bool {
    let deadline_ns = monotonic_ns() + timeout_ns;
    while !is_done() {
        if monotonic_ns() >= deadline_ns {
            return false;
        }
        std::thread::sleep(poll);
    }
    true
}

/// Removes all files of the run, and no others.
fn clean(run: &LivingRun) {
    if run.uid != rustix::process::geteuid().as_raw() {
        return;
    }
    let removed = match run.domain() {
        Some(domain) => domain.remove(),
        None => remove_bus_files_of(&run.run_id),
    };
    if let Err(error) = removed {
        tracing::warn!("not cleaned up: {error}");
    }
}

/// Signals the orchestrator. It is opened first and identified then, so that no other process with its number is signalled.
fn signal_orchestrator(run: &LivingRun, pid: u32, signal: Signal) {
    let opened = Pid::from_raw(pid.cast_signed()).and_then(|raw| pidfd_open(raw, PidfdFlags::empty()).ok());
    if let Some(process) = opened
        && run.orchestrator() == Some(pid)
    {
        let _ = pidfd_send_signal(process, signal);
    }
}

#[cfg(test)]
mod tests {
    use std::process::{Child, Command};

    use runtime::{INCARNATION_VARIABLE, ROLE_VARIABLE, RUN_ID_VARIABLE};

    use super::*;

    /// A process of a run without orchestrator and stop word, so a stray.
    fn stray(run_id: &str, script: &str) -> Child {
        let mut command = Command::new("setsid");
        command.args(["sh", "-c", script]).env(RUN_ID_VARIABLE, run_id).env(INCARNATION_VARIABLE, "7");
        command.spawn().unwrap()
    }

    /// The run, once so many processes of it are found.
    fn run_of(run_id: &str, count: usize) -> LivingRun {
        let uid = rustix::process::geteuid().as_raw();
        loop {
            let found = LivingRun::with_strays(uid).into_iter().find(|run| run.run_id == run_id);
            if let Some(run) = found.filter(|run| run.strays().count() >= count) {
                return run;
            }
            std::thread::sleep(POLL);
        }
    }

    #[test]
    fn strays_that_ignore_the_request_or_start_others_are_ended_with_what_they_start() {
        for (run_id, script) in [
            ("haltstubborn", "trap : TERM HUP INT; while :; do sleep 90; done"),
            ("haltprolific", "trap '' TERM; while :; do setsid sleep 90 & sleep 0.02; done"),
        ] {
            let mut first = stray(run_id, script);
            let left = end_strays(&[&run_of(run_id, 2)]);
            first.wait().unwrap();
            let uid = rustix::process::geteuid().as_raw();
            assert!(left.is_empty(), "{left:?}");
            assert!(LivingRun::with_strays(uid).iter().all(|run| run.run_id != run_id));
        }
    }

    #[test]
    fn the_end_of_what_stands_for_a_robot_on_another_host_is_no_stop_of_its_wheels() {
        let folder = std::env::temp_dir().join(format!("scanloop-halt-{}", std::process::id()));
        std::fs::create_dir(&folder).unwrap();
        for (name, is_stop) in [("remote", false), ("service", true)] {
            assert!(Command::new("mkfifo").arg(folder.join(name)).status().unwrap().success());
            let run_id = format!("halt{name}");
            // It waits for what no process writes, until it is asked to end.
            let mut command = Command::new("cat");
            command.arg(name).current_dir(&folder).env(RUN_ID_VARIABLE, &run_id);
            let mut robot =
                command.env(INCARNATION_VARIABLE, "7").env(ROLE_VARIABLE, "robot").spawn().unwrap();
            assert_eq!(block(&run_of(&run_id, 1)).confirmed, is_stop, "{name}");
            robot.wait().unwrap();
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_command_that_a_process_of_the_run_has_started_does_not_end_itself() {
        let mut other = stray("haltasking", "exec sleep 90");
        let found = run_of("haltasking", 1);
        let mut run = found.clone();
        assert!(run.others().any(|process| process.identity.pid == other.id()));
        run.processes.iter_mut().for_each(|process| process.identity.pid = std::process::id());
        assert!(run.others().next().is_none());
        assert!(end_strays(&[&found]).is_empty());
        other.wait().unwrap();
    }
}
