//! Processes restarted by command while the robot drives: the old one is ended last.

use emulator::Outcome;
use rustix::process::Signal;
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::swaps::{assert_every_scan_answered_once, restart, restart_all, rows};
use scanloop_tests::{SHORT_CORRIDOR, STAGES, TestSystem, printed, system_file};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

#[test]
fn a_restart_loses_no_scan_and_is_no_swap() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_CORRIDOR);
        restart_all(&system);
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        let report = system.report();
        assert_eq!((report.outcome, report.swaps.len()), (Outcome::Reached, 0));
        let restarts: Vec<u32> = report.processes.iter().map(|process| process.restarts).collect();
        assert_eq!(restarts, [0, 1, 1, 1, 1]);
        assert_every_scan_answered_once(&system);
        system.assert_nothing_left();
    });
}

#[test]
fn processes_are_restarted_and_killed_while_the_robot_drives_backwards() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["park-parallel", "--record=drive.mcap"]);
        system.wait_until("it drives backwards", |system| {
            let newest = system.run(&["topic", "echo", "actuation", "-n", "1"]);
            printed(&newest).contains("\"sent_velocity_mps\":-")
        });
        restart_all(&system);
        system.signal(system.pid(Role::Controller), Signal::KILL);
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        let report = system.report();
        assert_eq!((report.outcome, report.scans.unaccounted), (Outcome::Reached, 0), "{}", report.reason);
        // One in the process that was killed; on a busy machine the next one takes a period or two to start.
        assert!(report.scans.lost <= 3, "{:?}", report.scans);
        let replayed = system.run(&["replay", "drive.mcap"]);
        assert_eq!(replayed.status.code(), Some(0), "{}", printed(&replayed));
        system.assert_nothing_left();
    });
}

#[test]
fn a_restart_whose_process_does_not_come_up_leaves_the_old_one_driving() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let (script, started) = (system.folder().join("controller.sh"), system.folder().join("started"));
        let text = format!(
            "if [ -e {started} ]; then echo no room for another one >&2; exit 1; fi\n\
         touch {started}\nexec {EXECUTABLE} service nmpc\n",
            started = started.display()
        );
        std::fs::write(&script, text).unwrap();
        let file = system.folder().join("system.toml");
        let by_script = system_file(10, &[Role::Controller], "sh", &[]);
        let by_script = by_script.replace("[\"sh\", \"controller\"]", &format!("[\"sh\", {script:?}]"));
        std::fs::write(&file, by_script).unwrap();
        system.start(&[&SHORT_CORRIDOR[..], &["--system", file.to_str().unwrap()]].concat());
        let before = rows(&system, Role::Controller);
        let (code, printed) = restart(&system, Role::Controller);
        assert_eq!(code, Some(1), "{printed}");
        assert!(printed.contains("controller was not restarted, the old process keeps driving"), "{printed}");
        assert!(printed.contains("no room for another one"), "{printed}");
        assert_eq!(rows(&system, Role::Controller), before);
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        let report = system.report();
        assert!(report.processes.iter().all(|process| process.restarts == 0), "{:?}", report.processes);
        assert_eq!(report.outcome, Outcome::Reached);
        assert_every_scan_answered_once(&system);
        system.assert_nothing_left();
    });
}

#[test]
fn a_restart_whose_state_cannot_be_written_leaves_the_old_one_driving() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_CORRIDOR);
        // As on a full disk, nothing can be written to a folder.
        std::fs::create_dir(system.domain().directory().join("controller.checkpoint")).unwrap();
        let before = rows(&system, Role::Controller);
        let (code, printed) = restart(&system, Role::Controller);
        assert_eq!(code, Some(1), "{printed}");
        assert!(
            printed.contains("could not be started") && printed.contains("controller.checkpoint"),
            "{printed}"
        );
        assert_eq!(rows(&system, Role::Controller), before);
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        assert_every_scan_answered_once(&system);
        system.assert_nothing_left();
    });
}

#[test]
fn a_restart_in_lock_step_changes_no_bit_of_the_drive() {
    repeat_when_late(|| {
        let undisturbed = TestSystem::new(EXECUTABLE).lockstep(&["endless", "--duration", "120"]);
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--lockstep", "--duration", "120"]);
        for role in STAGES {
            let (code, printed) = restart(&system, role);
            assert_eq!(code, Some(0), "{printed}");
        }
        system.wait();
        let report = system.report();
        assert_eq!(report.digests, undisturbed.digests);
        let restarts: Vec<u32> = report.processes.iter().map(|process| process.restarts).collect();
        assert_eq!(restarts, [0, 1, 1, 1, 1]);
        system.assert_nothing_left();
    });
}
