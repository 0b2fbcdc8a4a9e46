//! Swaps while the robot drives, and whole runs in lock-step, with the processes of the examples.

use scanloop_tests::machine::repeat_when_late;
use std::path::{Path, PathBuf};

use conformance::{CaseOutcome, SuiteReport};
use emulator::Outcome;
use handover::swap::{Certificate, SwapOutcome};
use scanloop_tests::{SHORTENED_LONG, TestSystem};

use super::tools::{DEAD_RECKONING, EXECUTABLE, MY_CONTROLLER, compile, examples, python};

/// A swap is requested up to this often, because an answer may be late on a busy machine.
const TRIES: usize = 4;

/// Swaps a process, and adds the certificates of all tries.
fn swap(system: &TestSystem, role: &str, command: &[&str], certificates: &mut Vec<Certificate>) {
    for _ in 0..TRIES {
        let output = system.run(&[&["swap", "--json", role, "--"], command].concat());
        let certificate: Certificate = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&output.stderr)));
        assert_eq!((certificate.missed_scans, certificate.duplicate_scans), (0, 0), "{certificate:?}");
        certificates.push(certificate.clone());
        if certificate.outcome == SwapOutcome::Swapped {
            assert_eq!(certificate.first_scan_new, certificate.last_scan_old.map(|scan| scan + 1));
            return;
        }
        let too_slow = ["late: ", "hangs: ", "no output within"];
        assert!(too_slow.iter().any(|start| certificate.reason.starts_with(start)), "{}", certificate.reason);
    }
    panic!("refused {TRIES} times: {certificates:?}");
}

/// That the run reached its goal and lost no scan, with the new processes to the end.
fn reached(mut system: TestSystem, certificates: &[Certificate]) {
    assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
    let report = system.report();
    assert_eq!(report.outcome, Outcome::Reached);
    let scans = &report.scans;
    assert_eq!((scans.lost, scans.unaccounted, scans.duplicates), (0, 0, 0), "{scans:?}");
    assert_eq!(report.swaps, certificates);
    let last = certificates.last().unwrap();
    let process = report.processes.iter().find(|process| process.role == last.role).unwrap();
    assert_eq!((&process.implementation, process.restarts), (&last.to, 0));
    system.assert_nothing_left();
}

fn c_obstacles(system: &TestSystem) -> PathBuf {
    let program = system.folder().join("obstacles");
    compile(&examples("c").join("obstacles.c"), &examples("c"), &program);
    program
}

/// The built-in system with another command in one role.
pub(crate) fn system_with(folder: &Path, role: &str, command: &[&str]) -> String {
    let built_in = [
        ("robot", "emulator"),
        ("estimator", "ekf"),
        ("obstacles", "ellipses"),
        ("controller", "nmpc"),
        ("actuator", "actuation"),
    ];
    let entry = |(name, implementation): (&str, &str)| {
        let by = if name == role {
            format!("command = {command:?}")
        } else {
            format!("implementation = {implementation:?}")
        };
        format!("[[process]]\nrole = {name:?}\n{by}\n")
    };
    let file = folder.join("system.toml");
    std::fs::write(&file, built_in.map(entry).concat()).unwrap();
    file.to_str().unwrap().to_owned()
}

/// The state goes from one C process to the next, which the built-in one can't read. The estimator believes the
/// odometer, so that has to be right.
#[test]
fn obstacles_in_c_and_an_estimator_in_rust_take_over_from_the_built_in_ones() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let program = c_obstacles(&system);
        let program = program.to_str().unwrap();
        system.start(&[&SHORTENED_LONG[..], &["--set", "robot.odometry_longitudinal=0"]].concat());
        let mut certificates = Vec::new();
        swap(&system, "estimator", &[DEAD_RECKONING], &mut certificates);
        swap(&system, "obstacles", &[program], &mut certificates);
        swap(&system, "obstacles", &[program], &mut certificates);
        reached(system, &certificates);
    });
}

/// On a free track all three agree: the solver, the rule of thumb and the other solver. At 5 Hz, so that an
/// interpreter on a busy machine keeps the limit of half a period.
#[test]
fn controllers_in_python_take_over_from_the_built_in_one_and_from_each_other() {
    repeat_when_late(|| {
        let Some(python) = python("controllers_in_python_take_over") else { return };
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["free", "--set", "goal.x_m=21", "--set", "rate_hz=5"]);
        let mut certificates = Vec::new();
        for program in ["pure_pursuit.py", "casadi_controller.py"] {
            let program = examples("python").join(program);
            let command = [python.to_str().unwrap(), "-B", program.to_str().unwrap()];
            swap(&system, "controller", &command, &mut certificates);
        }
        reached(system, &certificates);
    });
}

/// A process without counters is not at fault: the bus knows what it received.
#[test]
fn a_swap_to_python_and_back_loses_no_sample() {
    repeat_when_late(|| {
        let Some(python) = python("a_swap_to_python_and_back") else { return };
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["free", "--set", "goal.x_m=21", "--set", "rate_hz=5"]);
        let mut certificates = Vec::new();
        let program = examples("python").join("pure_pursuit.py");
        let command = [python.to_str().unwrap(), "-B", program.to_str().unwrap()];
        swap(&system, "controller", &command, &mut certificates);
        let scan = system.status().unwrap().scan;
        system.wait_until("it drives in Python", |system| {
            system.status().is_some_and(|now| now.scan > scan + 10)
        });
        swap(&system, "controller", &[EXECUTABLE, "service", "nmpc"], &mut certificates);
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        let report = system.report();
        let lost: u64 = report.ledger.topics.iter().map(|row| row.lost).sum();
        assert_eq!(
            (lost, report.scans.lost, report.ledger.residual),
            (0, 0, 0),
            "{:?}",
            report.ledger.topics
        );
        assert!(!report.controller.status.contains_key("not_solved"), "{:?}", report.controller.status);
        system.assert_nothing_left();
    });
}

/// At half the usual rate in Python, for busy machines.
#[test]
fn the_examples_honour_all_that_is_asked_of_their_roles() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let obstacles = c_obstacles(&system);
        let mut commands = vec![
            ("obstacles", "10", vec![obstacles.to_str().unwrap().to_owned()]),
            ("controller", "10", vec![MY_CONTROLLER.to_owned()]),
        ];
        if let Some(python) = python("the_examples_honour_all_that_is_asked_of_their_roles, the controller") {
            let program = examples("python").join("pure_pursuit.py");
            let arguments = [python.to_str().unwrap(), "-B", program.to_str().unwrap()];
            commands.push(("controller", "5", arguments.map(str::to_owned).to_vec()));
        }
        std::thread::scope(|scope| {
            for (role, rate_hz, arguments) in &commands {
                let mut command = system.command(&["conformance", role, "--json", "--rate", rate_hz, "--"]);
                scope.spawn(move || {
                    let output = command.args(arguments).output().unwrap();
                    let text = String::from_utf8_lossy(&output.stderr);
                    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {text}");
                    let suite: SuiteReport = serde_json::from_slice(&output.stdout).unwrap();
                    let failed = suite.cases.iter().filter(|case| case.outcome == CaseOutcome::Failed);
                    // The controllers follow a line, no course.
                    let allowed: &[&str] = if *role == "controller" { &["bend"] } else { &[] };
                    assert_eq!(
                        failed.map(|case| &case.name).collect::<Vec<_>>(),
                        allowed,
                        "{arguments:?}: {text}"
                    );
                });
            }
        });
        system.assert_nothing_left();
    });
}

#[test]
fn every_example_drives_the_whole_way_in_lock_step() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let program = c_obstacles(&system);
        for (role, program) in [("obstacles", program.to_str().unwrap()), ("controller", MY_CONTROLLER)] {
            let file = system_with(system.folder(), role, &[program]);
            for (scenario, outcome) in
                [("slalom", Outcome::Reached), ("walls", Outcome::Reached), ("blocked", Outcome::Stopped)]
            {
                let report = system.lockstep(&[scenario, "--system", &file]);
                assert_eq!(report.outcome, outcome, "{role} {scenario}");
                assert_eq!((report.scans.lost, report.drive.truth.unwrap().collided), (0, false));
            }
        }
        let Some(python) = python("every_example_drives_the_whole_way_in_lock_step, the controllers") else {
            return;
        };
        // At 5 Hz pure pursuit comes too near to the last body in one drive of four.
        for (program, scenario, seed) in
            [("pure_pursuit.py", "slalom", "2"), ("casadi_controller.py", "corridor", "1")]
        {
            let program = examples("python").join(program);
            let command = [python.to_str().unwrap(), "-B", program.to_str().unwrap()];
            let file = system_with(system.folder(), "controller", &command);
            // At 5 Hz a process may take 600 ms of the machine's time before it counts as hung.
            let rate = ["--set", "rate_hz=5", "--seed", seed];
            let report = system.lockstep(&[&[scenario, "--system", &file][..], &rate].concat());
            assert_eq!(report.outcome, Outcome::Reached, "{}: {}", program.display(), report.reason);
            assert_eq!((report.scans.lost, report.drive.truth.unwrap().collided), (0, false));
        }
        system.assert_nothing_left();
    });
}
