//! The drivers that users copy for a robot of their own, with the simulated devices that they come with.

use std::path::PathBuf;
use std::process::Output;

use conformance::{Outcome as CaseOutcome, Report as Suite};
use emulator::{JudgedBy, Outcome};
use scanloop_tests::System;

use super::swaps::system_with;
use super::tools::{EXECUTABLE, MY_ROBOT, compile, examples, python, root};

/// What only an emulated robot can do.
const NOT_FOR_REAL_ROBOTS: [&str; 3] = ["truth", "grants", "repeatable"];

fn template(language: &str) -> PathBuf {
    root().join("examples/template-robot").join(language)
}

/// Language, command, and the rate at which it is tested: lower for an interpreter on a busy machine [Hz].
fn drivers(system: &System, test: &str) -> Vec<(&'static str, Vec<String>, &'static str)> {
    let program = system.folder().join("robot");
    compile(&template("c").join("robot.c"), &examples("c"), &program);
    let mut all = vec![
        ("rust", vec![MY_ROBOT.to_owned()], "20"),
        ("c", vec![program.to_str().unwrap().to_owned()], "20"),
    ];
    if let Some(python) = python(test) {
        let script = template("python").join("robot.py");
        let command = [python.to_str().unwrap(), "-B", script.to_str().unwrap()];
        all.push(("python", command.map(str::to_owned).to_vec(), "10"));
    }
    all
}

#[test]
fn drivers_to_be_copied_honour_all_that_is_asked_of_a_real_robot() {
    let system = System::new(EXECUTABLE);
    let drivers = drivers(&system, "drivers_to_be_copied_honour_all, the driver");
    std::thread::scope(|scope| {
        for (language, command, rate_hz) in &drivers {
            let mut suite = system.command(&["conformance", "robot", "--json", "--rate", rate_hz, "--"]);
            scope.spawn(move || honours_all(language, &suite.args(command).output().unwrap()));
        }
    });
    system.assert_nothing_left();
}

fn honours_all(language: &str, output: &Output) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{language}: {text}");
    let suite: Suite = serde_json::from_slice(&output.stdout).unwrap();
    let failed = suite.cases.iter().filter(|case| case.outcome != CaseOutcome::Passed);
    let failed: Vec<&str> = failed.map(|case| case.name.as_str()).collect();
    assert_eq!(failed, NOT_FOR_REAL_ROBOTS, "{language}: {text}");
    // Its device restarts and breaks sweeps off, so the cases about that have something to find.
    let gaps = suite.cases.iter().find(|case| case.name == "gaps").unwrap();
    assert!(!gaps.reason.starts_with("0 of"), "{language}: {}", gaps.reason);
}

#[test]
fn drivers_to_be_copied_drive_to_the_goal_by_the_estimate() {
    let test = "drivers_to_be_copied_drive_to_the_goal, the driver";
    for (language, command, _) in drivers(&System::new(EXECUTABLE), test) {
        let mut system = System::new(EXECUTABLE);
        let program = system.folder().join("robot");
        if language == "c" {
            compile(&template("c").join("robot.c"), &examples("c"), &program);
        }
        let own = vec![program.to_str().unwrap().to_owned()];
        let command = if language == "c" { own } else { command };
        let words: Vec<&str> = command.iter().map(String::as_str).collect();
        let file = system_with(system.folder(), "robot", &words);
        system.start(&["free", "--system", &file]);
        system.wait_until("its devices run", |system| {
            let processes = system.status().map_or(Vec::new(), |status| status.processes);
            processes.iter().any(|process| process.device.as_deref() == Some("running"))
        });
        assert_eq!(system.wait().code(), Some(0), "{language}: {}", system.stderr());
        let report = system.report();
        assert_eq!((report.outcome, report.judged_by), (Outcome::Reached, JudgedBy::Estimate), "{language}");
        assert_eq!((report.scans.unaccounted, report.ledger.residual), (0, 0), "{language}");
        assert!(report.drive.final_distance_m <= 0.1, "{language}: {}", report.drive.final_distance_m);
        system.assert_nothing_left();
    }
}
