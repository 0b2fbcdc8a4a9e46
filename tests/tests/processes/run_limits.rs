//! Runs in real time end by the clock of this computer, whatever the stamps of the robot do.

use emulator::Outcome;
use scanloop_tests::TestSystem;
use scanloop_tests::machine::repeat_when_late;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty");

/// Drives with a faulty robot and returns how the run ended and why.
fn ended(fault: &str, settings: &[&str]) -> (Outcome, String) {
    let mut system = TestSystem::new(EXECUTABLE);
    let built_in =
        [("estimator", "ekf"), ("obstacles", "ellipses"), ("controller", "nmpc"), ("actuator", "actuation")]
            .map(|(role, name)| format!("[[process]]\nrole = \"{role}\"\nimplementation = \"{name}\"\n"));
    let robot = format!("[[process]]\nrole = \"robot\"\ncommand = [{FAULTY:?}, \"robot\", {fault:?}]\n");
    let file = system.folder().join("system.toml");
    std::fs::write(&file, robot + &built_in.concat()).expect("a system file");
    let file = file.to_str().expect("a readable path").to_owned();
    let sets = settings.iter().flat_map(|set| ["--set", set]);
    let arguments = ["run", "--quiet", "--out", "out", "--system", &file, "free"];
    system.launch(&arguments.into_iter().chain(sets).collect::<Vec<_>>(), &[]);
    assert_eq!(system.wait().code(), Some(1), "{fault}: {}", system.stderr());
    let report = system.report();
    system.assert_nothing_left();
    (report.outcome, report.reason)
}

#[test]
fn a_robot_that_sends_no_scan_or_nothing_at_all_times_out() {
    repeat_when_late(|| {
        std::thread::scope(|scope| {
            for fault in ["scanless", "silent"] {
                scope.spawn(move || {
                    let (outcome, reason) = ended(fault, &["timeout_s=2"]);
                    assert_eq!(outcome, Outcome::Timeout, "{fault}: {reason}");
                    assert!(reason.starts_with("2 s are over, and no scan has come"), "{fault}: {reason}");
                });
            }
        });
    });
}

#[test]
fn stamps_that_stand_still_or_run_backwards_do_not_keep_a_run_from_ending() {
    repeat_when_late(|| {
        std::thread::scope(|scope| {
            for fault in ["timeless", "backward"] {
                scope.spawn(move || {
                    let (outcome, reason) = ended(fault, &["stop_final_s=1"]);
                    assert_eq!(outcome, Outcome::Stopped, "{fault}: {reason}");
                    assert!(reason.starts_with("wheels blocked for 1 s: "), "{fault}: {reason}");
                    let (outcome, reason) = ended(fault, &["timeout_s=2", "stop_final_s=60"]);
                    assert_eq!(outcome, Outcome::Timeout, "{fault}: {reason}");
                });
            }
        });
    });
}
