//! Swaps without a session, a process or a bus: requests and events in, orders out.

use handover::swap::{Meant, OutputSummary, SwapOutcome, SwapOutput};
use shared_types::{Actuation, Authority, Command, CommandKind, Header};
use supervision::entry::ProcessEntry;

use super::*;
use crate::control::Successor;

const PERIOD_NS: u64 = 100_000_000;
const OLD: u32 = 4;
const NEW: u32 = 9;

fn entry() -> ProcessEntry {
    ProcessEntry::of(Role::Controller, &["./old".to_owned()])
}

fn request(shadow_scans: u64) -> SwapRequest {
    let (implementation, command) = (None, Some(vec!["./new".to_owned()]));
    let successor = Successor { role: Role::Controller, implementation, command, host: None };
    SwapRequest { successor, set: Vec::new(), shadow_scans, standby_scans: 2, tolerance: 1.0 }
}

fn ask(swaps: &mut Swaps, request: &SwapRequest, is_ready: bool) -> Result<u64, String> {
    swaps.ask(0, request, None, &Live { entry: &entry(), is_ready, hosts: &[], is_on_one_host: true })
}

/// A swap of the controller that was started.
fn begun(lockstep: bool) -> Swaps {
    let mut swaps = Swaps::new(PERIOD_NS, lockstep);
    assert_eq!(ask(&mut swaps, &request(5), true), Ok(1));
    let note = swaps.begin(0, [OLD, NEW], Ok(()));
    assert_eq!(note, Some(Order::Note("controller: ./new starts beside ./old".to_owned())));
    swaps
}

fn scan_record(scan: u64) -> ScanRecord {
    let actuations = vec![Actuation { answers: 1, ..Actuation::default() }];
    ScanRecord {
        header: Header { scan_id: scan, ..Header::default() },
        truth: None,
        poses: Vec::new(),
        obstacles: Vec::new(),
        commands: Vec::new(),
        actuations,
        missing: false,
    }
}

/// Both processes answer a scan alike, and it is recorded.
fn good_scan(swaps: &mut Swaps, scan: u64) -> Vec<Order> {
    let now_ns = scan * PERIOD_NS;
    let command = Command { kind: CommandKind::Drive.wire(), velocity_mps: 1.0, ..Command::default() };
    let mut orders = swaps.handle(now_ns, SwapEvent::Scans { newest: scan, answered: scan - 1 });
    for party in [Party::Old, Party::New] {
        let output = SwapOutput {
            scan,
            sequence: scan,
            scan_published_ns: now_ns,
            published_ns: now_ns + 2_000_000,
            compute_ns: 0,
            stamps_ns: [0; 2],
            content: Ok(OutputSummary::from(&command)),
        };
        orders.extend(swaps.handle(now_ns + 2_000_000, SwapEvent::Output(party, output)));
    }
    orders.extend(swaps.handle(now_ns + 3_000_000, SwapEvent::Tick));
    orders.extend(swaps.recorded(now_ns + 4_000_000, &scan_record(scan)));
    orders
}

fn certificate(swaps: &Swaps) -> Certificate {
    match swaps.result(1) {
        Reply::Certificate(certificate) => *certificate,
        other => panic!("no certificate: {other:?}"),
    }
}

#[test]
fn a_request_that_cannot_be_carried_out_is_refused_with_the_reason() {
    let mut swaps = Swaps::new(PERIOD_NS, false);
    let refused = |swaps: &mut Swaps, request: &SwapRequest, is_ready| {
        ask(swaps, request, is_ready).expect_err("a refusal")
    };
    assert_eq!(refused(&mut swaps, &request(0), true), "--shadow-scans 0 is not allowed: 1 to 10000");
    let wide = SwapRequest { tolerance: f64::NAN, ..request(5) };
    assert_eq!(refused(&mut swaps, &wide, true), "--tolerance NaN is not allowed: 0 to 1000");
    let message = refused(&mut swaps, &request(5), false);
    assert_eq!(message, "controller is not ready to be swapped: the system must drive");
    assert!(!swaps.is_busy() && matches!(swaps.result(1), Reply::Refused(_)));
    assert_eq!(ask(&mut swaps, &request(5), true), Ok(1));
    assert_eq!(refused(&mut swaps, &request(5), true), "another swap is in progress");
    assert!(swaps.concern(Role::Controller) && swaps.result(1) == Reply::Pending);
}

#[test]
fn a_good_process_is_authorised_promoted_and_certified() {
    let mut swaps = begun(false);
    assert_eq!(swaps.candidate(), Some(NEW));
    let orders: Vec<Order> = (11..=40).flat_map(|scan| good_scan(&mut swaps, scan)).collect();
    let promote = Order::Promote { role: Role::Controller, incarnation: NEW, is_restart: false };
    let authority = Authority { incarnation: NEW, previous: OLD, from_scan: 17 };
    let first = Order::Authorise { role: Role::Controller, parties: [OLD, NEW], authority };
    assert_eq!(orders[0], first);
    assert!(orders.contains(&promote) && matches!(orders.last(), Some(Order::Note(_))), "{orders:?}");
    assert_eq!(certificate(&swaps).outcome, SwapOutcome::Swapped);
    assert!(!swaps.is_busy() && swaps.certificates().len() == 1);
}

#[test]
fn changed_settings_go_with_the_program_that_runs() {
    let mut swaps = Swaps::new(PERIOD_NS, false);
    let set = vec!["controller.intervals=7".to_owned(), "controller.horizon_s=2".to_owned()];
    let successor = Successor { role: Role::Controller, implementation: None, command: None, host: None };
    let request = SwapRequest { successor, set, ..request(5) };
    let live = &Live { entry: &entry(), is_ready: true, hosts: &[], is_on_one_host: true };
    let changed = Changed { settings: "file".to_owned(), meant: Meant::default() };
    swaps.ask(0, &request, Some(changed), live).unwrap();
    let candidate = swaps.due(0, 0, |_| None).unwrap();
    assert_eq!(candidate, Candidate { entry: entry(), settings: Some("file".to_owned()) });
    swaps.begin(0, [OLD, NEW], Err("no memory".to_owned()));
    assert_eq!(certificate(&swaps).to, "./old with controller.intervals=7, controller.horizon_s=2");
}

#[test]
fn a_restart_is_a_swap_without_a_certificate_in_the_report() {
    let mut swaps = Swaps::new(PERIOD_NS, false);
    swaps.restart(0, &Live { entry: &entry(), is_ready: true, hosts: &[], is_on_one_host: true }).unwrap();
    swaps.begin(0, [OLD, NEW], Ok(()));
    let orders: Vec<Order> = (11..=40).flat_map(|scan| good_scan(&mut swaps, scan)).collect();
    assert!(
        orders.iter().any(|order| matches!(order, Order::Promote { is_restart: true, .. })),
        "{orders:?}"
    );
    assert_eq!((certificate(&swaps).outcome, swaps.certificates().len()), (SwapOutcome::Swapped, 0));
}

#[test]
fn a_process_that_cannot_be_started_is_refused_and_the_next_swap_is_accepted() {
    let mut swaps = Swaps::new(PERIOD_NS, false);
    ask(&mut swaps, &request(5), true).unwrap();
    let note = swaps.begin(0, [OLD, NEW], Err("no memory".to_owned()));
    assert!(matches!(note, Some(Order::Note(_))));
    let certificate = certificate(&swaps);
    assert_eq!(certificate.reason, "could not be started: no memory");
    assert_eq!((certificate.from.as_str(), certificate.to.as_str()), ("./old", "./new"));
    assert_eq!(ask(&mut swaps, &request(5), true), Ok(2));
}

#[test]
fn the_end_of_the_run_refuses_a_swap_that_has_not_begun_and_rejects_one_that_has() {
    let mut swaps = Swaps::new(PERIOD_NS, false);
    ask(&mut swaps, &request(5), true).unwrap();
    assert_eq!(swaps.run_ends(1).len(), 1);
    assert_eq!(certificate(&swaps).to_string(), "controller: ./new was refused: the run ends");
    let mut swaps = begun(false);
    assert_eq!(swaps.run_ends(1)[0], Order::Reject(NEW));
    assert!(!swaps.is_busy());
}

#[test]
fn in_lock_step_the_new_process_starts_with_the_state_after_the_last_scan() {
    let mut swaps = Swaps::new(PERIOD_NS, true);
    ask(&mut swaps, &request(5), true).unwrap();
    swaps.recorded(1, &scan_record(7));
    let checkpoint = |scan_id| {
        let header = Header { scan_id, ..Header::default() };
        Checkpoint { header, ..Checkpoint::default() }
    };
    let (old, new) = (checkpoint(6), checkpoint(7));
    assert_eq!(swaps.due(1, 7, |_| Some(&old)), None, "the state is not there yet");
    assert_eq!(swaps.due(1, 8, |_| Some(&new)), None, "the robot may publish one more scan");
    let expected = Candidate { entry: entry_of_request(), settings: None };
    assert_eq!(swaps.due(1, 7, |_| Some(&new)), Some(expected));
    assert!(swaps.due(LOCKSTEP_TIMEOUT_NS, 8, |_| None).is_some(), "it is not waited for longer");
}

fn entry_of_request() -> ProcessEntry {
    ProcessEntry::of(Role::Controller, &["./new".to_owned()])
}

#[test]
fn in_lock_step_the_loop_is_held_until_the_new_process_is_connected_and_for_its_outputs() {
    let mut swaps = Swaps::new(PERIOD_NS, true);
    assert_eq!(swaps.granted_scan(0), Some(GRANT_AHEAD));
    ask(&mut swaps, &request(5), true).unwrap();
    assert_eq!(swaps.granted_scan(0), None, "it has not begun");
    let mut swaps = begun(true);
    swaps.recorded(1, &scan_record(10));
    assert_eq!(swaps.granted_scan(1), None, "it is not connected");
    swaps.received(OLD, ProcessState::Connected);
    assert_eq!(swaps.granted_scan(1), None, "the old process does not matter");
    swaps.received(NEW, ProcessState::Connected);
    assert_eq!(swaps.granted_scan(1), Some(11), "one scan at a time");
    swaps.recorded(2, &scan_record(11));
    assert_eq!(swaps.granted_scan(2), None, "its output is not there");
    assert_eq!(swaps.granted_scan(2 + LOCKSTEP_TIMEOUT_NS), Some(12));
}

#[test]
fn both_processes_are_known_until_the_outcome_is_decided() {
    let mut swaps = begun(false);
    assert_eq!([OLD, NEW, 5].map(|of| swaps.party_of(of)), [Some(Party::Old), Some(Party::New), None]);
    let orders = swaps.handle(1, SwapEvent::Exited(Party::New, "exit code 1".to_owned()));
    assert_eq!(orders[0], Order::Reject(NEW));
    assert_eq!((swaps.party_of(NEW), swaps.candidate()), (None, None));
}

#[test]
fn a_number_of_scans_that_a_swap_may_not_wait_for_is_refused() {
    let mut swaps = Swaps::new(PERIOD_NS, false);
    for scans in [0, MAX_SCANS + 1, u64::MAX] {
        let refused = ask(&mut swaps, &request(scans), true).unwrap_err();
        assert_eq!(refused, format!("--shadow-scans {scans} is not allowed: 1 to {MAX_SCANS}"));
        let standby = SwapRequest { standby_scans: scans, ..request(5) };
        assert!(ask(&mut swaps, &standby, true).unwrap_err().starts_with("--standby-scans "), "{scans}");
    }
    assert_eq!(ask(&mut swaps, &request(MAX_SCANS), true), Ok(1));
}
