//! `scanloop stop` blocks the wheels whatever the orchestrator does, and each end of the orchestrator is as
//! docs/supervision.md describes it.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::os::unix::process::ExitStatusExt;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

use emulator::Outcome;
use runtime::{Bus, Observer};
use rustix::process::{Pid, Signal, kill_process};
use scanloop_tests::{TestSystem, TruthWatch, is_ignored, pause, printed, system_file};
use shared_types::{Actuation, Role};

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty");
/// The command returns after a second at the latest when wheels are blocked [ms].
const LIMIT_MS: u64 = 1000;

/// A system that drives.
fn driving(arguments: &[&str]) -> (TestSystem, TruthWatch) {
    let mut system = TestSystem::new(EXECUTABLE);
    system.start(&[&["endless"], arguments].concat());
    let watch = TruthWatch::new(&system);
    watch.wait_for(&system, "it drives", |truth| truth.speed_mps > 0.5);
    (system, watch)
}

fn wait_for_rest(system: &TestSystem, watch: &TruthWatch) {
    let rest = watch.wait_for(system, "it rests", |truth| truth.blocked == 1 && truth.speed_mps <= 0.0);
    assert_eq!(rest.collided, 0);
}

/// Stops the system, which must acknowledge within the limit; returns what was printed.
fn stop(system: &TestSystem) -> String {
    let output = system.run(&["stop"]);
    let text = printed(&output);
    assert_eq!(output.status.code(), Some(0), "{text}");
    let after = text.split("wheels blocked after ").nth(1).unwrap_or_else(|| panic!("{text}"));
    let after_ms: u64 = after.split(' ').next().unwrap().parse().unwrap();
    assert!(after_ms <= LIMIT_MS, "{text}");
    text
}

#[test]
fn a_stopped_run_has_the_reason_in_its_report() {
    repeat_when_late(|| {
        let (mut system, watch) = driving(&[]);
        stop(&system);
        wait_for_rest(&system, &watch);
        assert_eq!(system.wait().code(), Some(1));
        let report = system.report();
        assert_eq!((report.outcome, report.reason.as_str()), (Outcome::Interrupted, "stopped by command"));
        assert_eq!((report.drive.final_speed_mps, report.scans.unaccounted), (0.0, 0));
        drop(watch);
        system.assert_nothing_left();
    });
}

#[test]
fn a_suspended_orchestrator_does_not_prevent_a_stop() {
    repeat_when_late(|| {
        for signal in [Signal::STOP, Signal::TSTP] {
            let (mut system, watch) = driving(&[]);
            system.signal(system.orchestrator(), signal);
            stop(&system);
            wait_for_rest(&system, &watch);
            // A background process of the command wakes it, and it ends its run itself.
            assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
            assert_eq!(system.report().reason, "stopped by command");
            drop(watch);
            system.assert_nothing_left();
        }
    });
}

#[test]
fn processes_that_are_suspended_as_well_are_woken_and_stop() {
    repeat_when_late(|| {
        let (mut system, watch) = driving(&[]);
        let stages = [Role::Actuator, Role::Robot].map(|role| system.pid(role));
        system.signal(system.orchestrator(), Signal::STOP);
        stages.iter().for_each(|pid| system.signal(*pid, Signal::STOP));
        stop(&system);
        wait_for_rest(&system, &watch);
        system.wait();
        drop(watch);
        system.assert_nothing_left();
    });
}

#[test]
fn a_stop_of_a_paused_run_names_no_process_that_has_obeyed_as_the_reason() {
    repeat_when_late(|| {
        let (mut system, watch) = driving(&["--set", "orphan_timeout_s=1.0", "--set", "orphan_stop_s=0.5"]);
        let estimator = system.pid(Role::Estimator);
        let paused = [system.pid(Role::Robot), system.orchestrator()];
        paused.iter().for_each(|pid| system.signal(*pid, Signal::STOP));
        system.wait_until("the estimator has ended", |_| {
            let stat = std::fs::read_to_string(format!("/proc/{estimator}/stat")).unwrap_or_default();
            stat.rsplit(')').next().is_some_and(|rest| rest.trim_start().starts_with('Z'))
        });
        stop(&system);
        wait_for_rest(&system, &watch);
        system.wait();
        assert!(!system.stderr().contains("the run ends"), "{}", system.stderr());
        assert_eq!(system.report().reason, "stopped by command");
        drop(watch);
        system.assert_nothing_left();
    });
}

#[test]
fn a_system_that_lost_its_orchestrator_is_stopped_without_its_directory() {
    repeat_when_late(|| {
        let (mut system, watch) = driving(&[]);
        let directory = system.domain().directory().to_path_buf();
        system.kill_orchestrator();
        std::fs::remove_dir_all(directory).unwrap();
        let text = stop(&system);
        assert!(text.contains("had lost its orchestrator"), "{text}");
        wait_for_rest(&system, &watch);
        drop(watch);
        system.assert_nothing_left();
    });
}

#[test]
fn a_stop_is_never_taken_back() {
    repeat_when_late(|| {
        let (mut system, watch) = driving(&["--set", "orphan_timeout_s=60"]);
        system.signal(system.orchestrator(), Signal::STOP);
        stop(&system);
        let adopted = system.run(&["adopt", "--quiet"]);
        assert_ne!(adopted.status.code(), Some(0), "{}", printed(&adopted));
        wait_for_rest(&system, &watch);
        system.wait();
        let all = watch.all();
        let stopped =
            all.iter().position(|truth| truth.speed_mps <= 0.0 && truth.header.scan_id > 10).unwrap();
        assert!(all[stopped..].iter().all(|truth| truth.speed_mps <= 0.0), "it moved again after the stop");
        drop(watch);
        system.assert_nothing_left();
    });
}

#[test]
fn a_crashed_orchestrator_has_stopped_its_run_and_reports_it() {
    repeat_when_late(|| {
        for signal in [Signal::SEGV, Signal::BUS, Signal::ILL] {
            let (mut system, watch) = driving(&["--set", "orphan_timeout_s=3"]);
            system.signal(system.orchestrator(), signal);
            assert_eq!(system.wait().code(), None, "a signal ends it");
            wait_for_rest(&system, &watch);
            assert!(system.stderr().contains("wheels are blocked"), "{}", system.stderr());
            let adopted = system.run(&["adopt", "--quiet"]);
            assert_eq!(adopted.status.code(), Some(1), "{}", printed(&adopted));
            assert!(printed(&adopted).contains("was stopped"), "{}", printed(&adopted));
            drop(watch);
            // It cannot be adopted any more, so it ends by itself.
            system.assert_nothing_left();
        }
    });
}

#[test]
fn a_closed_terminal_and_a_quit_key_end_the_run_in_order() {
    repeat_when_late(|| {
        // Under `nohup` a hang-up is ignored, also by the processes that are started.
        let signals = [Signal::HUP, Signal::QUIT, Signal::TERM];
        for signal in signals.into_iter().filter(|signal| !is_ignored(*signal)) {
            let (mut system, watch) = driving(&[]);
            system.signal(system.orchestrator(), signal);
            assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
            let report = system.report();
            assert_eq!((report.outcome, report.drive.final_speed_mps), (Outcome::Interrupted, 0.0));
            drop(watch);
            system.assert_nothing_left();
        }
    });
}

#[test]
fn without_directives_the_robot_rests_after_orphan_stop_s_until_it_is_adopted() {
    repeat_when_late(|| {
        for signal in [Signal::KILL, Signal::ABORT] {
            let (mut system, watch) = driving(&["--set", "orphan_stop_s=1.5", "--set", "timeout_s=600"]);
            let killed = watch.newest().unwrap();
            system.signal(system.orchestrator(), signal);
            system.wait();
            wait_for_rest(&system, &watch);
            let blocked = watch
                .all()
                .into_iter()
                .find(|truth| truth.header.scan_id > killed.header.scan_id && truth.blocked == 1)
                .unwrap();
            let alone_s = blocked.time_s - killed.time_s;
            assert!((1.2..3.0).contains(&alone_s), "it drove on for {alone_s} s");
            system.adopt(&[]);
            watch.wait_for(&system, "it drives on", |truth| truth.speed_mps > 0.5);
            stop(&system);
            system.wait();
            drop(watch);
            system.assert_nothing_left();
        }
    });
}

#[test]
fn a_run_that_was_suspended_drives_on() {
    repeat_when_late(|| {
        let (mut system, watch) = driving(&["--set", "orphan_stop_s=0.5", "--set", "timeout_s=600"]);
        system.signal(system.orchestrator(), Signal::STOP);
        wait_for_rest(&system, &watch);
        system.signal(system.orchestrator(), Signal::CONT);
        watch.wait_for(&system, "it drives on", |truth| truth.speed_mps > 0.5);
        stop(&system);
        system.wait();
        drop(watch);
        system.assert_nothing_left();
    });
}

/// The built-in system in which these roles are started without the stop word.
fn without_stop_word(system: &TestSystem, roles: &[Role]) -> String {
    let names = ["emulator", "ekf", "ellipses", "nmpc", "actuation"];
    let mut text = String::new();
    for (role, name) in Role::ALL.iter().zip(names) {
        text += &format!("[[process]]\nrole = \"{role}\"\n");
        text += &match roles.contains(role) {
            true => {
                let command = ["env", "-u", "SCANLOOP_STOP_FD", EXECUTABLE, "service", name];
                format!("command = {command:?}\n")
            }
            false => format!("implementation = \"{name}\"\n"),
        };
    }
    let path = system.folder().join("system.toml");
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn a_process_that_does_not_see_the_stop_word_is_ended_and_the_block_is_confirmed_by_the_other() {
    repeat_when_late(|| {
        for role in [Role::Actuator, Role::Robot] {
            let mut system = TestSystem::new(EXECUTABLE);
            let file = without_stop_word(&system, &[role]);
            system.start(&["endless", "--system", &file]);
            let watch = TruthWatch::new(&system);
            watch.wait_for(&system, "it drives", |truth| truth.speed_mps > 0.5);
            system.signal(system.orchestrator(), Signal::STOP);
            stop(&system);
            wait_for_rest(&system, &watch);
            system.wait();
            drop(watch);
            system.assert_nothing_left();
        }
    });
}

#[test]
fn a_block_that_no_process_acknowledges_is_not_confirmed_and_names_what_lives() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let file = without_stop_word(&system, &[Role::Actuator, Role::Robot]);
        system.start(&["endless", "--system", &file]);
        let watch = TruthWatch::new(&system);
        watch.wait_for(&system, "it drives", |truth| truth.speed_mps > 0.5);
        system.signal(system.orchestrator(), Signal::STOP);
        let output = system.run(&["stop"]);
        let text = printed(&output);
        // The robot may rest and end before the limit: then there are no wheels to block.
        match output.status.code() {
            Some(4) => assert!(text.contains("is not confirmed") && text.contains("alive: "), "{text}"),
            code => assert_eq!(code, Some(0), "{text}"),
        }
        wait_for_rest(&system, &watch);
        system.wait();
        drop(watch);
        system.assert_nothing_left();
    });
}

#[test]
fn a_service_whose_orchestrator_hung_stays_stopped_once() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let arguments = ["run", "--adopt-or-start", "--quiet", "--out", "out", "endless"];
        system.launch(&arguments, &[]);
        system.wait_until_driving();
        let watch = TruthWatch::new(&system);
        watch.wait_for(&system, "it drives", |truth| truth.speed_mps > 0.5);
        let pid = Pid::from_raw(system.orchestrator()).unwrap();
        let is_over = AtomicBool::new(false);
        let status = std::thread::scope(|scope| {
            // It hangs again whenever it is woken, so that only KILL ends it.
            scope.spawn(|| {
                while !is_over.load(Ordering::SeqCst) {
                    let _ = kill_process(pid, Signal::STOP);
                    pause();
                }
            });
            stop(&system);
            wait_for_rest(&system, &watch);
            let status = system.wait();
            is_over.store(true, Ordering::SeqCst);
            status
        });
        assert_eq!(status.signal(), Some(Signal::KILL.as_raw()));
        drop(watch);
        system.assert_nothing_left();
        // The service manager starts it again because a signal ended it; then an operator does.
        let again = system.run(&arguments);
        assert_eq!(again.status.code(), Some(1), "{}", printed(&again));
        assert!(printed(&again).contains("stopped"), "{}", printed(&again));
        system.launch(&arguments, &[]);
        system.wait_until_driving();
        stop(&system);
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn a_robot_that_tells_nothing_of_its_wheels_is_not_killed_at_the_end_of_a_run() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let text = system_file(10, &[Role::Robot], FAULTY, &["stubborn"]);
        let path = system.folder().join("system.toml");
        std::fs::write(&path, text).unwrap();
        system
            .launch(&["run", "--quiet", "--out", "out", "endless", "--system", path.to_str().unwrap()], &[]);
        system.wait_until("it drives", |system| {
            system.status().is_some_and(|status| status.state == "driving")
        });
        let robot = system.pid(Role::Robot);
        let bus = Bus::open(&system.domain(), "test").unwrap();
        let actuations = Observer::<Actuation>::new(&bus).unwrap();
        system.wait_until("it was sent something", |_| actuations.next().unwrap().is_some());
        drop((actuations, bus));
        system.signal(system.orchestrator(), Signal::TERM);
        assert_eq!(system.wait().code(), Some(4), "{}", system.stderr());
        assert!(system.stderr().contains("is not known to rest: it is left"), "{}", system.stderr());
        assert!(system.processes().contains(&robot), "only it knows how to stop");
        system.signal(robot, Signal::KILL);
        system.wait_until("it is gone", |system| system.processes().is_empty());
        system.run(&["stop"]);
        system.assert_nothing_left();
    });
}

#[test]
fn a_wrong_id_names_the_systems_that_run() {
    repeat_when_late(|| {
        let (mut system, watch) = driving(&[]);
        let output = Command::new(EXECUTABLE).args(["--system-id", "none-such", "stop"]).output().unwrap();
        assert_eq!(output.status.code(), Some(2));
        assert!(printed(&output).contains(&format!("`{}`", system.id())), "{}", printed(&output));
        stop(&system);
        system.wait();
        drop(watch);
        system.assert_nothing_left();
        let again = system.run(&["stop"]);
        assert_eq!(again.status.code(), Some(2), "{}", printed(&again));
    });
}

#[test]
fn a_new_run_waits_for_one_that_was_just_stopped() {
    repeat_when_late(|| {
        let (mut system, watch) = driving(&[]);
        drop(watch);
        stop(&system);
        let report = system.lockstep(&["free"]);
        assert_eq!(report.outcome, Outcome::Reached);
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn a_program_that_is_replaced_while_it_drives_still_starts_processes_and_stops() {
    repeat_when_late(|| {
        let folder = std::env::temp_dir().join(format!("scanloop-replaced-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let program = folder.join("scanloop");
        // By another process: a file that a test thread writes is busy while others start programs.
        let copy = || assert!(Command::new("cp").arg(EXECUTABLE).arg(&program).status().unwrap().success());
        copy();
        let mut system = TestSystem::new(program.to_str().unwrap());
        system.start(&["endless"]);
        std::fs::remove_file(&program).unwrap();
        copy();
        let restarted = system.run(&["restart", "estimator"]);
        assert_eq!(restarted.status.code(), Some(0), "{}", printed(&restarted));
        stop(&system);
        assert_eq!(system.wait().code(), Some(1));
        system.assert_nothing_left();
        std::fs::remove_dir_all(folder).unwrap();
    });
}
