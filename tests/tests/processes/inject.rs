//! Faults that a command injects into a running system.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use recording::mcap::McapReader;
use runtime::{Bus, Observer};
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::{DEADLINE, TestSystem, pause, printed};
use shared_types::{Actuation, ActuationKind, Role, Truth};

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

fn inject(system: &TestSystem, arguments: &[&str]) -> (Option<i32>, String) {
    let output = system.run(&[&["inject"], arguments].concat());
    (output.status.code(), printed(&output))
}

/// Waits for an actuation of a kind.
fn wait_for(actuations: &Observer<Actuation>, what: &str, kind: ActuationKind) {
    let (started, mut seen) = (std::time::Instant::now(), false);
    actuations.poll(|_| {}).unwrap();
    while !seen {
        assert!(started.elapsed() < DEADLINE, "{what}");
        actuations.poll(|actuation| seen |= actuation.kind == kind.wire()).unwrap();
        pause();
    }
}

/// A fault begins, is seen at the wheels, and ends: the robot drives again.
fn blocks_for_a_time(system: &TestSystem, actuations: &Observer<Actuation>, fault: &str) {
    assert_eq!(inject(system, &[fault, "--for", "1s"]), (Some(0), format!("{fault}: for 1 s\n")));
    wait_for(actuations, &format!("{fault}: the wheels are blocked"), ActuationKind::Block);
    wait_for(actuations, &format!("{fault}: the robot drives again"), ActuationKind::Drive);
}

#[test]
fn faults_of_samples_robot_and_processes_act_for_their_time_and_are_recorded() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--allow-inject", "--record"]);
        let bus = Bus::open(&system.domain(), "observer").unwrap();
        let actuations = Observer::<Actuation>::new(&bus).unwrap();
        wait_for(&actuations, "the robot drives", ActuationKind::Drive);
        blocks_for_a_time(&system, &actuations, "command-not-verified");
        blocks_for_a_time(&system, &actuations, "command-silent");
        blocks_for_a_time(&system, &actuations, "scanner-dead");
        let before = system.pid(Role::Estimator);
        assert_eq!(inject(&system, &["process-estimator-dies"]).0, Some(0));
        system.wait_until("there is another estimator", |system| {
            let status = system.status().unwrap_or_default();
            status.processes.iter().any(|row| row.role == Role::Estimator && row.pid > 0 && row.pid != before)
        });
        wait_for(&actuations, "the robot drives with it", ActuationKind::Drive);
        let events = system.status().unwrap().events;
        for fault in ["command-not-verified", "command-silent", "scanner-dead", "process-estimator-dies"] {
            let is_noted = events.iter().any(|event| event.warning && event.text.contains(fault));
            assert!(is_noted, "{fault}: {events:?}");
        }
        drop((actuations, bus));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        let report = system.report();
        assert_eq!((report.scans.unaccounted, report.drive.truth.unwrap().collided), (0, false));
        let file = std::fs::File::open(system.folder().join("out/recording.mcap")).unwrap();
        let (mut reader, mut is_recorded) = (McapReader::new(file).unwrap(), false);
        let text = b"fault injected for 1 s: scanner-dead";
        while let Some(message) = reader.next_message().unwrap() {
            is_recorded |= message.data.windows(text.len()).any(|part| part == text);
        }
        assert!(is_recorded, "the recording has the event");
        // What the faults have changed is told apart from differences.
        let output = system.run(&["replay", "out/recording.mcap", "--json"]);
        let replay: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!((output.status.code(), &replay["identical"]), (Some(0), &replay["compared"]), "{replay}");
        assert!(replay["injected"].as_u64() > Some(10) && replay["skipped"] == 0, "{replay}");
        system.assert_nothing_left();
    });
}

#[test]
fn after_numbers_of_scans_that_do_not_exist_the_robot_drives_on_and_reaches_the_goal() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["free", "--allow-inject"]);
        let bus = Bus::open(&system.domain(), "observer").unwrap();
        let actuations = Observer::<Actuation>::new(&bus).unwrap();
        wait_for(&actuations, "the robot drives", ActuationKind::Drive);
        for fault in
            ["command-wrong-scan", "command-impossible-scan", "command-impossible-number", "pose-wrong-scan"]
        {
            blocks_for_a_time(&system, &actuations, fault);
        }
        let refused = system.run(&["status", "--json"]);
        let status: serde_json::Value = serde_json::from_slice(&refused.stdout).unwrap();
        let rows = status["refused"].as_array().unwrap();
        let named = |writer: &str, field: &str| {
            rows.iter().any(|row| {
                row["rule"] == "impossible_number" && row["writer"] == writer && row["field"] == field
            })
        };
        assert!(named("controller", "header.scan_id") && named("controller", "header.sequence"), "{rows:?}");
        assert!(named("estimator", "header.scan_id"), "{rows:?}");
        drop((actuations, bus));
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        let report = system.report();
        assert_eq!(report.outcome, emulator::Outcome::Reached, "{}", report.reason);
        assert_eq!(report.scans.unaccounted, 0, "{:?}", report.scans);
        assert!(report.ledger.impossible > 0 && report.scans.published < 2_000, "{:?}", report.scans);
        system.assert_nothing_left();
    });
}

#[test]
fn what_can_t_be_injected_is_refused_with_what_can() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let (code, text) = inject(&system, &["scanner-dead"]);
        assert!(code == Some(2) && text.contains("is not running"), "{text}");
        let list = String::from_utf8(system.run(&["inject", "--list"]).stdout).unwrap();
        let has = |name: &str| list.lines().any(|line| line == name);
        assert!(has("scanner-dead") && has("process-actuator-hangs") && !has("shared-memory-full"), "{list}");
        system.start(&["endless", "--allow-inject"]);
        for (arguments, reason) in [
            (
                &["scanner-ded"][..],
                "fault `scanner-ded` is unknown. Did you mean `scanner-dead`? Expected one of actuation-",
            ),
            (&["command-late-400ms"], "it could not answer the next scan; these can: actuation-"),
            (&["shared-memory-full"], "it fills the memory of all programs of this machine; these can: "),
            (&["scanner-dead", "--for", "0s"], "0s is not allowed: 1ms to 10m"),
            (&[], "required"),
        ] {
            let (code, text) = inject(&system, arguments);
            assert!(code == Some(2) && text.contains(reason), "{arguments:?}: {text}");
        }
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.start(&["endless"]);
        let (code, text) = inject(&system, &["scanner-dead"]);
        assert!(code == Some(2) && text.contains("start it with `scanloop run --allow-inject`"), "{text}");
        let bus = Bus::open(&system.domain(), "observer").unwrap();
        let truths = Observer::<Truth>::new(&bus).unwrap();
        let mut speed_mps = 0.0;
        while speed_mps < 0.5 {
            truths.poll(|truth| speed_mps = truth.speed_mps).unwrap();
            pause();
        }
        drop((truths, bus));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}
