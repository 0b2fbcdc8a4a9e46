//! Shadows without a session, a process or a bus.

use std::time::{Duration, Instant};

use handover::swap::OutputSummary;
use shared_types::Command;

use super::*;
use crate::control::Successor;

const PERIOD_NS: u64 = 100_000_000;
const SHADOW: u32 = 9;

fn ask(shadows: &mut Shadows, is_ready: bool) -> Result<u64, String> {
    let (implementation, command) = (None, Some(vec!["./new".to_owned()]));
    let successor = Successor { role: Role::Controller, implementation, command, host: None };
    let entry = ProcessEntry::of(Role::Controller, &["./old".to_owned()]);
    shadows.ask(
        &ShadowRequest { successor, duration_ms: 1000 },
        &Live { entry: &entry, is_ready, hosts: &[], is_on_one_host: true },
    )
}

fn begin(shadows: &mut Shadows, started: Result<(), String>) -> Option<Order> {
    let asked = shadows.take_asked().pop().unwrap();
    shadows.begin(0, asked, SHADOW, started)
}

/// A shadow of one second that runs.
fn begun() -> Shadows {
    let mut shadows = Shadows::new(PERIOD_NS);
    assert_eq!(ask(&mut shadows, true), Ok(1));
    let note = begin(&mut shadows, Ok(()));
    assert_eq!(note, Some(Order::Note("controller: ./new starts in the shadow of ./old".to_owned())));
    shadows
}

fn output(shadows: &mut Shadows, now_ns: u64, party: Party) {
    let output = SwapOutput {
        scan: now_ns / PERIOD_NS,
        sequence: 0,
        scan_published_ns: now_ns,
        published_ns: now_ns,
        compute_ns: 0,
        stamps_ns: [0; 2],
        content: Ok(OutputSummary::from(&Command::default())),
    };
    shadows.output(now_ns, SHADOW, party, output);
}

/// The report of the first shadow, which a thread makes.
fn report(shadows: &mut Shadows) -> ShadowReport {
    let started = Instant::now();
    loop {
        shadows.advance(u64::MAX, false);
        if let Reply::Shadow(report) = shadows.result(1) {
            return *report;
        }
        assert!(started.elapsed() < Duration::from_secs(60), "a report of no scans takes less than a minute");
        std::thread::yield_now();
    }
}

#[test]
fn a_role_has_one_shadow_at_a_time_and_only_of_a_process_that_is_ready() {
    let mut shadows = Shadows::new(PERIOD_NS);
    let message = ask(&mut shadows, false).unwrap_err();
    assert_eq!(message, "controller is not ready for a shadow: the system must drive");
    assert!(!shadows.concern(Role::Controller));
    assert_eq!(ask(&mut shadows, true), Ok(1));
    assert_eq!(ask(&mut shadows, true).unwrap_err(), "a process runs in the shadow of controller already");
    assert_eq!(shadows.result(1), Reply::Pending);
    assert!(matches!(shadows.result(2), Reply::Refused(_)));
}

#[test]
fn a_shadow_that_cannot_be_started_has_a_report_at_once() {
    let mut shadows = Shadows::new(PERIOD_NS);
    ask(&mut shadows, true).unwrap();
    assert_eq!(begin(&mut shadows, Err("no memory".to_owned())), None);
    let report = report(&mut shadows);
    assert_eq!((report.outcome, report.role.as_str()), (ShadowOutcome::Died, "controller"));
    assert_eq!(report.reason, "could not be started: no memory");
}

#[test]
fn a_shadow_ends_after_its_time_and_its_role_is_free_again() {
    let mut shadows = begun();
    for scan in 1..=9 {
        output(&mut shadows, scan * PERIOD_NS, Party::Old);
        output(&mut shadows, scan * PERIOD_NS, Party::New);
    }
    assert_eq!(shadows.advance(1_000_000_000 - 1, false), []);
    assert_eq!(shadows.advance(1_000_000_000, false)[0], Order::Dismiss(SHADOW));
    assert!(!shadows.concern(Role::Controller));
    let report = report(&mut shadows);
    assert_eq!((report.outcome, report.scans), (ShadowOutcome::Completed, 9));
    assert_eq!(shadows.incarnations().count(), 0);
}

#[test]
fn the_report_names_why_a_shadow_ended() {
    let outcome = |end: fn(&mut Shadows)| {
        let mut shadows = begun();
        end(&mut shadows);
        let ShadowReport { outcome, reason, .. } = report(&mut shadows);
        (outcome, reason)
    };
    let nothing = String::new();
    assert_eq!(outcome(|shadows| _ = shadows.end_early(1)), (ShadowOutcome::Interrupted, nothing.clone()));
    assert_eq!(outcome(|shadows| _ = shadows.advance(1, true)), (ShadowOutcome::RunEnded, nothing));
    assert_eq!(outcome(|_| {}), (ShadowOutcome::Silent, "it gave no output".to_owned()));
    let silent = outcome(|shadows| {
        output(shadows, PERIOD_NS, Party::New);
        shadows.advance(3_000_000_000, false);
    });
    assert_eq!(silent, (ShadowOutcome::Silent, "no output in the last 2.9 s".to_owned()));
    let died = outcome(|shadows| {
        assert!(!shadows.ended(SHADOW + 1, String::new));
        assert!(shadows.ended(SHADOW, || "exit code 1".to_owned()));
    });
    assert_eq!(died, (ShadowOutcome::Died, "the process ended: exit code 1".to_owned()));
}
