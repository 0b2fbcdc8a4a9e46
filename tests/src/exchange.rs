//! Exchanges and shadows, asked for as a user does.

use std::process::{Child, Output, Stdio};

use emulator::Outcome;
use handover::shadow::ShadowReport;
use handover::swap::{Certificate, SwapOutcome};
use shared_types::Role;

use crate::{STAGES, System};

/// Built-in implementations of the roles.
pub const BUILT_IN: [(Role, &str); 5] = [
    (Role::Estimator, "ekf"),
    (Role::Obstacles, "ellipses"),
    (Role::Actuator, "actuation"),
    (Role::Controller, "nmpc"),
    (Role::Robot, "emulator"),
];

/// Exchanges one process; the exit code must be that of the outcome.
pub fn swap(system: &System, arguments: &[&str]) -> Certificate {
    certificate(&system.run(&with_json("swap", arguments)))
}

/// Begins an exchange and does not wait for its end.
pub fn begin(system: &System, arguments: &[&str]) -> Child {
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
pub fn shadow(system: &System, arguments: &[&str]) -> ShadowReport {
    shadow_report(&system.run(&with_json("shadow", arguments)))
}

/// Begins a shadow and does not wait for its end.
pub fn begin_shadow(system: &System, arguments: &[&str]) -> Child {
    spawn(system, "shadow", arguments)
}

/// The report that `shadow --json` printed.
pub fn shadow_report(output: &Output) -> ShadowReport {
    let report: ShadowReport = parse(output);
    assert_eq!(output.status.code(), Some(i32::from(!report.outcome.is_good())), "{report}");
    report
}

/// That nobody but the one who asked has noticed the exchange.
pub fn assert_seamless(certificate: &Certificate) {
    assert_eq!((certificate.missed_scans, certificate.duplicate_scans), (0, 0), "{certificate:?}");
    if let (Some(last), Some(first)) = (certificate.last_scan_old, certificate.first_scan_new) {
        assert_eq!(first, last + 1);
    }
}

/// That the run reached its goal, answered every scan once and knows of its exchanges.
pub fn assert_reached(mut system: System, certificates: &[Certificate]) {
    assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
    let report = system.report();
    assert_eq!(report.outcome, Outcome::Reached);
    assert_eq!(report.swaps, certificates);
    assert!(report.processes.iter().all(|process| process.restarts == 0), "{:?}", report.processes);
    assert_every_scan_answered_once(&system);
    system.assert_nothing_left();
}

/// That the run that has ended answered every scan once.
pub fn assert_every_scan_answered_once(system: &System) {
    let report = system.report();
    let scans = &report.scans;
    assert_eq!((scans.lost, scans.unaccounted, scans.duplicates), (0, 0, 0), "{scans:?}");
    assert_eq!(report.ledger.residual, 0, "{:?}", report.ledger.faults);
}

/// Ends the run and checks that every scan was answered once.
pub fn stop(system: &mut System) {
    assert_eq!(system.run(&["stop"]).status.code(), Some(0));
    system.wait();
    assert_every_scan_answered_once(system);
    system.assert_nothing_left();
}

/// Rows of `status` of one role: process id and state, who is in charge first.
pub fn rows(system: &System, role: Role) -> Vec<(i32, String)> {
    let processes = system.status().map(|status| status.processes).unwrap_or_default();
    processes
        .into_iter()
        .filter(|process| process.role == role)
        .map(|process| (process.pid, process.state.to_string()))
        .collect()
}

/// Waits until so many more scans were published.
pub fn more_scans(system: &System, count: u64) {
    let scan = system.status().expect("a running system").scan;
    system
        .wait_until("more scans", |system| system.status().is_some_and(|status| status.scan >= scan + count));
}

/// Begins an exchange with a long standby and waits until the new process is in charge; returns both ids.
pub fn standby(system: &System, role: Role, arguments: &[&str]) -> (Child, i32, i32) {
    let all = [&[role.name(), "--standby-scans", "40"], arguments].concat();
    let child = begin(system, &all);
    system.wait_until("the old one stands by", |system| {
        rows(system, role).get(1).is_some_and(|(_, state)| state == "standby")
    });
    let rows = rows(system, role);
    // It is not only named but has answered.
    more_scans(system, 4);
    (child, rows[0].0, rows[1].0)
}

/// Restarts a role; exit code, and what was said.
pub fn restart(system: &System, role: Role) -> (Option<i32>, String) {
    let output = system.run(&["restart", role.name()]);
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

/// Restarts each stage while the robot drives; none may miss a scan.
pub fn restart_all(system: &System) {
    for role in STAGES {
        let before = system.pid(role);
        let (code, said) = restart(system, role);
        assert_eq!(code, Some(0), "{said}");
        let is_seamless =
            said.contains(&format!("{role} was restarted")) && said.contains("; 0 scans missed");
        assert!(is_seamless, "{said}");
        let [(now, state)] = rows(system, role).try_into().expect("one process");
        assert!(now != before && state == "ready", "{role} is {state}");
    }
    let status = system.status().expect("a running system");
    let restarts: Vec<u32> = status.processes.iter().map(|process| process.restarts).collect();
    assert_eq!(restarts, [0, 1, 1, 1, 1]);
}

fn spawn(system: &System, verb: &str, arguments: &[&str]) -> Child {
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
