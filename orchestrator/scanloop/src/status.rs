//! `scanloop status`: the processes of a running system.

use std::fmt::Write as _;

use console::answer;
use console::exit::{Exit, Failure};
use emulator::JudgedBy;
use runtime::{LinkedHost, RuntimeError};
use serde_json::Value;
use session::control::{CompanionStatus, ProcessStatus, SystemStatus};
use session::orphaned::{ORPHANED, SUSPENDED, current_status};
use shared_types::{Role, ScannerState};
use supervision::lock::{suspended_orchestrator, suspension};
use supervision::runs::{RunProcess, existing, strays_of};

use crate::print_json;

/// Prints the state of the system.
///
/// # Errors
/// A system that is not running; exit code 2. What its last run has left is named.
pub(crate) fn status(system_id: &str, json: bool) -> anyhow::Result<Exit> {
    let domain = &existing(system_id).map_err(|error| with_strays(error, system_id))?;
    let status = current_status(domain).map_err(|error| match error.downcast() {
        Ok(error) => with_strays(error, system_id),
        Err(other) => other,
    })?;
    if is_known(&status) {
        print_json(json, &status)?;
    } else {
        print_json(json, &with_unknowns(&status)?)?;
    }
    if !json {
        let mut hint = String::new();
        if status.state == ORPHANED {
            hint.push_str("its orchestrator died: `scanloop adopt` takes it over, `scanloop stop` ends it\n");
        }
        if status.state == SUSPENDED {
            let why = suspended_orchestrator(domain)
                .map_or_else(String::new, |pid| format!(": {}", suspension(pid)));
            let _ = writeln!(hint, "its orchestrator does not run{why}; `scanloop stop` blocks the wheels");
        }
        answer!(json, "{}{hint}", table(&status))?;
    }
    Ok(Exit::Done)
}

/// The error with the processes that no system lives by, but a run has left.
fn with_strays(error: RuntimeError, system_id: &str) -> anyhow::Error {
    let strays: Vec<String> = strays_of(system_id).iter().map(RunProcess::description).collect();
    match error {
        RuntimeError::NotRunning(_) if !strays.is_empty() => Failure::bad_input(format!(
            "{error}; an earlier run has left {}: `scanloop stop` ends it",
            strays.join("; ")
        )),
        error => error.into(),
    }
}

/// Another host: its clock, and the samples that it dropped.
fn host_line(host: &LinkedHost) -> String {
    let LinkedHost { name, offset_ns, bound_ns, round_trip_ns, clocks_lost, counts, .. } = host;
    if !host.refused.is_empty() {
        return format!("host {name}: refused: {}\n", host.refused);
    }
    if !host.is_connected {
        return format!("host {name}: not connected\n");
    }
    if !host.is_locked {
        return format!("host {name}: connected, its clock is not locked\n");
    }
    let us = |ns: u64| ns as f64 * 1e-3;
    let still = match host.stood_still_ms {
        0 => String::new(),
        lost_ms => format!(", stood still for {:.1} s", lost_ms as f64 * 1e-3),
    };
    let lost = if *clocks_lost > 0 { format!(", lost {clocks_lost} times") } else { String::new() };
    format!(
        "host {name}: connected, clock {:+.3} s within {:.0} us{lost}{still}, round trip {:.0} us; {} received, dropped {} old, \
         {} by clock, {} damaged\n",
        *offset_ns as f64 * 1e-9,
        us(*bound_ns),
        us(*round_trip_ns),
        counts.received,
        counts.old,
        counts.clock,
        counts.damaged
    )
}

/// Whether anything was received. Processes that do not run publish nothing, and without an orchestrator that answers it
/// is all that is known.
fn is_known(status: &SystemStatus) -> bool {
    status.scan > 0 || ![SUSPENDED, ORPHANED].contains(&status.state.as_str())
}

/// A status of which nothing was received, with null for what is not known.
fn with_unknowns(status: &SystemStatus) -> serde_json::Result<Value> {
    let mut json = serde_json::to_value(status)?;
    json["scan"] = Value::Null;
    for process in json["processes"].as_array_mut().into_iter().flatten() {
        ["rate_hz", "last_sample_age_ms"].iter().for_each(|key| process[*key] = Value::Null);
    }
    Ok(json)
}

fn table(status: &SystemStatus) -> String {
    let SystemStatus { system_id, state, scenario, .. } = status;
    let is_known = is_known(status);
    let known = |figure: String| if is_known { figure } else { "-".to_owned() };
    let scan = if is_known { format!(", scan {}", status.scan) } else { String::new() };
    let judged_by = status.judged_by.filter(|judged_by| *judged_by == JudgedBy::Estimate);
    let judged_by = judged_by.map_or("", |_| ", judged by the estimate");
    let driven_by = match status.driven_by.as_deref() {
        Some("nobody") => ", paused: `scanloop resume`",
        Some("person") => ", driven by a person",
        _ => "",
    };
    let blocking = status.blocking.map(|blocking| format!("stopped: blocked by {blocking}\n"));
    let scanner = status.scanner.as_ref().filter(|scanner| scanner.state != ScannerState::Healthy.name());
    let scanner = scanner.map(|scanner| format!("scanner {}\n", scanner.explanation));
    let mut text = format!(
        "system {system_id}: {state}, scenario {scenario}{scan}{judged_by}{driven_by}\n{}{}\
         {:<11} {:<16} {:>7}  {:<9} {:>8} {:>8} {:>8} {:>6} {:>9}\n",
        blocking.unwrap_or_default(),
        scanner.unwrap_or_default(),
        "role",
        "implementation",
        "pid",
        "state",
        "restarts",
        "rate/Hz",
        "age/ms",
        "cpu/%",
        "mem/KiB"
    );
    for process in &status.processes {
        let _ = writeln!(
            text,
            "{:<11} {:<16.16} {:>7}  {:<9} {:>8} {:>8} {:>8} {:>6.1} {:>9}",
            process.role,
            process.implementation,
            process.pid,
            process.state,
            process.restarts,
            known(format!("{:.1}", process.rate_hz)),
            known(format!("{:.0}", process.last_sample_age_ms)),
            process.cpu_percent,
            process.memory_kib
        );
        if let Some(device) = device(process) {
            let _ = writeln!(text, "            device {device}");
        }
        if !process.obeys_stop && matches!(process.role, Role::Robot | Role::Actuator) {
            let _ = writeln!(text, "            ! it does not see the stop word: `scanloop stop` ends it");
        }
        for line in &process.last_words {
            let _ = writeln!(text, "            | {line}");
        }
        for row in status.refused.iter().filter(|row| row.writer == process.role.name()) {
            let _ = writeln!(text, "            ! {row}");
        }
    }
    status.hosts.iter().for_each(|host| text += &host_line(host));
    for companion in &status.companions {
        let CompanionStatus { name, implementation, pid, state, restarts, .. } = companion;
        let _ = writeln!(
            text,
            "{name:<11} {implementation:<16.16} {pid:>7}  {state:<9} {restarts:>8} {:>8.1} {:>8.0} {:>6.1} {:>9}",
            companion.rate_hz, companion.last_sample_age_ms, companion.cpu_percent, companion.memory_kib
        );
        for line in &companion.last_words {
            let _ = writeln!(text, "            | {line}");
        }
    }
    text
}

/// The state of the devices behind a process, for how long, and why; `None` when the process reports none.
fn device(process: &ProcessStatus) -> Option<String> {
    let mut text = process.device.clone()?;
    if let Some(for_s) = process.device_for_s {
        let _ = write!(text, " for {for_s:.1} s");
    }
    if let Some(reason) = process.device_reason.as_ref().filter(|reason| !reason.is_empty()) {
        let _ = write!(text, ": {reason}");
    }
    Some(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use report::{BlockingReport, ScannerStatus};
    use shared_types::ScannerHealth;

    #[test]
    fn a_scanner_that_is_not_healthy_has_a_line_of_its_own() {
        let status =
            |health: ScannerHealth| SystemStatus { scanner: Some(health.into()), ..SystemStatus::default() };
        let healthy = ScannerHealth::healthy(5.0);
        assert!(!table(&status(healthy)).contains("scanner "));
        let wrong = ScannerHealth {
            state: ScannerState::Contradictory.wire(),
            range_factor: 1.36,
            seen_ahead_m: 0.0,
            ..healthy
        };
        let expected = "scanner contradictory: ranges 1.36 times the true ones by the motion";
        assert_eq!(table(&status(wrong)).lines().nth(1), Some(expected));
        let json: serde_json::Value = serde_json::to_value(status(wrong)).unwrap();
        let keys = serde_json::json!({
            "state": "contradictory",
            "explanation": expected.strip_prefix("scanner ").unwrap(),
            "valid_share": 1.0,
            "returned_share": 1.0,
            "seen_ahead_m": 0.0,
        });
        assert_eq!(json["scanner"], keys);
        assert_eq!(ScannerStatus::from(healthy).state, "healthy");
    }

    #[test]
    fn what_is_not_known_of_a_suspended_system_is_not_shown_as_zero() {
        let row = serde_json::json!({
            "role": "robot", "implementation": "emulator", "pid": 7, "state": "ready", "restarts": 0,
            "rate_hz": 0.0, "last_sample_age_ms": 0.0, "cpu_percent": 0.0, "memory_kib": 9,
            "obeys_stop": true, "last_words": [],
        });
        let process: ProcessStatus = serde_json::from_value(row).unwrap();
        let shown = |state: &str, scan| {
            let state = state.to_owned();
            table(&SystemStatus { state, scan, processes: vec![process.clone()], ..SystemStatus::default() })
        };
        let frozen = SystemStatus {
            state: SUSPENDED.to_owned(),
            processes: vec![process.clone()],
            ..SystemStatus::default()
        };
        let (driving, json) = (SystemStatus { scan: 7, ..frozen.clone() }, with_unknowns(&frozen).unwrap());
        assert!(is_known(&driving) && !is_known(&frozen));
        assert_eq!((&json["scan"], &json["processes"][0]["rate_hz"]), (&Value::Null, &Value::Null));
        let suspended = shown(SUSPENDED, 0);
        assert!(!suspended.contains("scan 0"), "{suspended}");
        assert!(suspended.ends_with("       0        -        -    0.0         9\n"), "{suspended}");
        assert!(shown("starting", 0).contains(", scan 0\n"));
        assert!(shown(ORPHANED, 12).contains(", scan 12\n"));
    }

    #[test]
    fn a_device_and_its_reason_have_a_line_below_their_process() {
        let row = |device: serde_json::Value| {
            let mut row = serde_json::json!({
                "role": "robot", "implementation": "player", "pid": 7, "state": "ready", "restarts": 0,
                "rate_hz": 0.0, "last_sample_age_ms": 0.0, "cpu_percent": 0.0, "memory_kib": 0,
                "obeys_stop": true, "last_words": [],
            });
            row.as_object_mut().unwrap().extend(device.as_object().unwrap().clone());
            let process: ProcessStatus = serde_json::from_value(row).unwrap();
            table(&SystemStatus { processes: vec![process], ..SystemStatus::default() })
        };
        let fault = serde_json::json!({
            "device": "fault", "device_for_s": 2.54, "device_reason": "scanner: no scan comes",
        });
        assert!(row(fault).ends_with("\n            device fault for 2.5 s: scanner: no scan comes\n"));
        let running = serde_json::json!({"device": "running", "device_for_s": 0.0, "device_reason": ""});
        assert!(row(running).ends_with("device running for 0.0 s\n"));
        assert!(!row(serde_json::json!({})).contains("device"));
    }

    #[test]
    fn a_run_without_truth_is_shown_as_judged_by_the_estimate() {
        let heading = |judged_by| table(&SystemStatus { judged_by, ..SystemStatus::default() });
        assert!(
            heading(Some(JudgedBy::Estimate)).lines().next().unwrap().ends_with(", judged by the estimate")
        );
        assert!(!heading(Some(JudgedBy::Truth)).contains("judged") && !heading(None).contains("judged"));
        let status = SystemStatus { judged_by: Some(JudgedBy::Estimate), ..SystemStatus::default() };
        assert_eq!(serde_json::to_value(status).unwrap()["judged_by"], "estimate");
    }

    #[test]
    fn a_stop_for_an_obstacle_has_a_line_of_its_own() {
        let blocking = BlockingReport { id: 17, x_m: 6.0, y_m: 0.1, gap_m: 0.12, needed_m: 0.62 };
        let status = SystemStatus { blocking: Some(blocking), ..SystemStatus::default() };
        let expected = "stopped: blocked by obstacle 17 at (6.0, 0.1): gap 0.12 m, needs 0.62 m";
        assert_eq!(table(&status).lines().nth(1), Some(expected));
        assert!(!table(&SystemStatus::default()).contains("stopped"));
        let json: serde_json::Value = serde_json::to_value(&status).unwrap();
        let keys = serde_json::json!({"id": 17, "x_m": 6.0, "y_m": 0.1, "gap_m": 0.12, "needed_m": 0.62});
        assert_eq!(json["blocking"], keys);
        assert!(serde_json::to_value(SystemStatus::default()).unwrap()["blocking"].is_null());
    }
}
