//! Swaps and shadows, started by command as a user does.

use std::process::{Child, Output, Stdio};

use emulator::Outcome;
use handover::shadow::ShadowReport;
use handover::swap::{Certificate, SwapOutcome};
use rustix::process::Signal;
use shared_types::Role;

use crate::{SHORT_CORRIDOR, STAGES, TestSystem};

/// Built-in implementations of the roles.
pub const BUILT_IN: [(Role, &str); 5] = [
    (Role::Estimator, "ekf"),
    (Role::Obstacles, "ellipses"),
    (Role::Actuator, "actuation"),
    (Role::Controller, "nmpc"),
    (Role::Robot, "emulator"),
];

/// Swaps one process; the exit code must be that of the outcome.
pub fn swap(system: &TestSystem, arguments: &[&str]) -> Certificate {
    certificate(&system.run(&with_json("swap", arguments)))
}

/// Swaps one process, which must succeed without a missed scan.
pub fn swap_seamlessly(system: &TestSystem, arguments: &[&str]) -> Certificate {
    let certificate = swap(system, arguments);
    assert_seamless_swap(&certificate);
    certificate
}

/// Swaps one process, which must be refused or rolled back without a missed scan, for a reason that has this text.
pub fn swap_in_vain(
    system: &TestSystem,
    arguments: &[&str],
    outcome: SwapOutcome,
    reason: &str,
) -> Certificate {
    let certificate = swap(system, arguments);
    assert_eq!(certificate.outcome, outcome, "{certificate:?}");
    assert!(certificate.reason.contains(reason), "{certificate:?}");
    assert_seamless(&certificate);
    certificate
}

/// Begins a swap and does not wait for its end.
pub fn begin(system: &TestSystem, arguments: &[&str]) -> Child {
    spawn(system, "swap", arguments)
}

/// The certificate that `swap --json` printed.
pub fn certificate(output: &Output) -> Certificate {
    let certificate: Certificate = parse(output);
    let swapped = certificate.outcome == SwapOutcome::Swapped;
    assert_eq!(output.status.code(), Some(i32::from(!swapped)), "{certificate:?}");
    certificate
}

/// Lets a process run in the shadow to its end; the exit code must be that of the outcome.
pub fn shadow(system: &TestSystem, arguments: &[&str]) -> ShadowReport {
    shadow_report(&system.run(&with_json("shadow", arguments)))
}

/// Begins a shadow and does not wait for its end.
pub fn begin_shadow(system: &TestSystem, arguments: &[&str]) -> Child {
    spawn(system, "shadow", arguments)
}

/// The report that `shadow --json` printed.
pub fn shadow_report(output: &Output) -> ShadowReport {
    let report: ShadowReport = parse(output);
    assert_eq!(output.status.code(), Some(i32::from(!report.outcome.is_good())), "{report}");
    report
}

/// Asserts that no scan was missed or answered twice because of the swap.
pub fn assert_seamless(certificate: &Certificate) {
    assert_eq!((certificate.missed_scans, certificate.duplicate_scans), (0, 0), "{certificate:?}");
    if let (Some(last), Some(first)) = (certificate.last_scan_old, certificate.first_scan_new) {
        assert_eq!(first, last + 1);
    }
}

/// Asserts that the swap was completed and that no scan was missed or answered twice.
pub fn assert_seamless_swap(certificate: &Certificate) {
    assert_eq!(certificate.outcome, SwapOutcome::Swapped, "{certificate:?}");
    assert_seamless(certificate);
}

/// Asserts that the run reached its goal, answered every scan once and reports its swaps.
pub fn assert_reached(mut system: TestSystem, certificates: &[Certificate]) {
    assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
    let report = system.report();
    assert_eq!(report.outcome, Outcome::Reached);
    assert_eq!(report.swaps, certificates);
    assert!(report.processes.iter().all(|process| process.restarts == 0), "{:?}", report.processes);
    assert_every_scan_answered_once(&system);
    system.assert_nothing_left();
}

/// Asserts that the run, which has ended, answered every scan once.
pub fn assert_every_scan_answered_once(system: &TestSystem) {
    let report = system.report();
    let scans = &report.scans;
    assert_eq!((scans.lost, scans.unaccounted, scans.duplicates), (0, 0, 0), "{scans:?}");
    assert_eq!(report.ledger.residual, 0, "{:?}", report.ledger.faults);
}

/// Ends the run and checks that every scan was answered once.
pub fn stop(system: &mut TestSystem) {
    assert_eq!(system.run(&["stop"]).status.code(), Some(0));
    system.wait();
    assert_every_scan_answered_once(system);
    system.assert_nothing_left();
}

/// Rows of `status` of one role: process id and state, the process in charge first.
pub fn rows(system: &TestSystem, role: Role) -> Vec<(i32, String)> {
    let processes = system.status().map(|status| status.processes).unwrap_or_default();
    processes
        .into_iter()
        .filter(|process| process.role == role)
        .map(|process| (process.pid, process.state.to_string()))
        .collect()
}

/// Waits until so many more scans were published.
pub fn more_scans(system: &TestSystem, count: u64) {
    let scan = system.status().expect("a running system").scan;
    system
        .wait_until("more scans", |system| system.status().is_some_and(|status| status.scan >= scan + count));
}

/// Begins a swap with a long standby and waits until the new process is in charge; returns both ids.
pub fn standby(system: &TestSystem, role: Role, arguments: &[&str]) -> (Child, i32, i32) {
    let all = [&[role.name(), "--standby-scans", "40"], arguments].concat();
    let child = begin(system, &all);
    system.wait_until("the old one is standby", |system| {
        rows(system, role).get(1).is_some_and(|(_, state)| state == "standby")
    });
    let rows = rows(system, role);
    // The new process has not only authority but has answered.
    more_scans(system, 4);
    (child, rows[0].0, rows[1].0)
}

/// A process that hangs while it is in charge is rolled back before the wheels are blocked.
pub fn rolls_back_a_hang_in_charge(mut system: TestSystem, role: Role, faulty: &str) {
    system.start(&SHORT_CORRIDOR);
    let arguments = [role.name(), "--standby-scans", "40", "--", faulty, "hang-after", "30"];
    let certificate = swap_in_vain(&system, &arguments, SwapOutcome::RolledBack, "");
    assert!(certificate.reason.starts_with("hangs: no output for scan"), "{}", certificate.reason);
    assert!(certificate.command_jump_mps < 0.3, "the wheels were blocked: {certificate:?}");
    assert_reached(system, &[certificate]);
}

/// The new process stays when the old one is killed during its standby.
pub fn survives_the_death_of_the_standby(mut system: TestSystem, role: Role, implementation: &str) {
    system.start(&SHORT_CORRIDOR);
    let (child, new, old) = standby(&system, role, &["--to", implementation]);
    system.signal(old, Signal::KILL);
    let certificate = certificate(&child.wait_with_output().expect("the command ends"));
    assert_seamless_swap(&certificate);
    assert_eq!(certificate.reason, "the old process ended: killed by signal 9 (SIGKILL)");
    assert_eq!(rows(&system, role), [(new, "ready".to_owned())]);
    assert_reached(system, &[certificate]);
}

/// Restarts a role; returns exit code and what it printed.
pub fn restart(system: &TestSystem, role: Role) -> (Option<i32>, String) {
    let output = system.run(&["restart", role.name()]);
    (output.status.code(), crate::printed(&output))
}

/// Restarts each stage while the robot drives; none may miss a scan.
pub fn restart_all(system: &TestSystem) {
    for role in STAGES {
        let before = system.pid(role);
        let (code, printed) = restart(system, role);
        assert_eq!(code, Some(0), "{printed}");
        let is_seamless =
            printed.contains(&format!("{role} was restarted")) && printed.contains("; 0 scans missed");
        assert!(is_seamless, "{printed}");
        let [(now, state)] = rows(system, role).try_into().expect("one process");
        assert!(now != before && state == "ready", "{role} is {state}");
    }
    let status = system.status().expect("a running system");
    let restarts: Vec<u32> = status.processes.iter().map(|process| process.restarts).collect();
    assert_eq!(restarts, [0, 1, 1, 1, 1]);
}

fn spawn(system: &TestSystem, verb: &str, arguments: &[&str]) -> Child {
    let mut command = system.command(&with_json(verb, arguments));
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the executable runs")
}

fn with_json<'a>(verb: &'a str, arguments: &[&'a str]) -> Vec<&'a str> {
    [&[verb, "--json"], arguments].concat()
}

fn parse<T: serde::de::DeserializeOwned>(output: &Output) -> T {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&output.stderr)))
}
