//! Commands in other PID and user namespaces than the run: what can't be seen is not said to be absent.
//!
//! Each test has `/tmp`, `/dev/shm` and `/run/user` of its own. Where it does not run as root, or may not make
//! namespaces, it prints what it skipped.

use std::process::{Command, Output};

use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::namespace::executable_for_all;
use scanloop_tests::stranger::{is_driving, kill, system, text};
use scanloop_tests::{TestSystem, TruthWatch, among_users};

/// Ways into a namespace from which the processes of a run can't be seen.
const WAYS: [&[&str]; 3] =
    [&["-pf", "--mount-proc"], &["-U", "-pf", "--map-root-user", "--mount-proc"], &["-U", "--map-root-user"]];

/// Runs a command in another namespace.
fn elsewhere(system: &TestSystem, way: &[&str], arguments: &[&str]) -> Output {
    let mut command = Command::new("unshare");
    command.args(way).arg(executable_for_all()).args(["--system-id", system.id()]).args(arguments);
    command.current_dir(system.folder()).output().expect("unshare runs")
}

fn may_be_made(way: &[&str]) -> bool {
    let made = Command::new("unshare").args(way).arg("true").status().is_ok_and(|status| status.success());
    if !made {
        eprintln!("skipped unshare {way:?}: not permitted");
    }
    made
}

#[test]
fn a_system_that_cannot_be_seen_is_stopped_over_its_control_socket() {
    repeat_when_late(|| {
        among_users!("a_system_that_cannot_be_seen_is_stopped_over_its_control_socket");
        for way in WAYS.into_iter().filter(|way| may_be_made(way)) {
            for stop in [&["stop"][..], &["stop", "--all"]] {
                let mut system = system();
                system.start(&["endless"]);
                let refused = elsewhere(&system, way, &["run", "--quiet", "free"]);
                assert_eq!(refused.status.code(), Some(2), "{}", text(&refused));
                let pid = format!("already running (process {})", system.orchestrator());
                assert!(text(&refused).contains(&pid), "{}", text(&refused));
                assert_eq!(elsewhere(&system, way, &["adopt", "--quiet"]).status.code(), Some(2));
                assert_eq!(elsewhere(&system, way, &["status"]).status.code(), Some(0));
                assert!(is_driving(&system));
                let stopped = elsewhere(&system, way, stop);
                assert_eq!(stopped.status.code(), Some(0), "{way:?} {}", text(&stopped));
                assert!(text(&stopped).contains("over its control socket"), "{}", text(&stopped));
                assert!(text(&stopped).contains("wheels blocked after"), "{}", text(&stopped));
                assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
                assert_eq!(system.report().reason, "stopped by command");
                system.assert_nothing_left();
            }
        }
    });
}

#[test]
fn an_orphaned_system_that_cannot_be_seen_is_left_alone_and_told() {
    repeat_when_late(|| {
        among_users!("an_orphaned_system_that_cannot_be_seen_is_left_alone_and_told");
        for way in WAYS.into_iter().filter(|way| may_be_made(way)) {
            let mut system = system();
            system.start(&["endless", "--set", "orphan_stop_s=30", "--set", "timeout_s=600"]);
            let watch = TruthWatch::new(&system);
            system.kill_orchestrator();
            let commands: [&[&str]; 7] = [
                &["run", "--quiet", "free"],
                &["run", "--adopt-or-start", "--quiet", "free"],
                &["adopt", "--quiet"],
                &["status"],
                &["restart", "controller"],
                &["stop"],
                &["stop", "--all"],
            ];
            for arguments in commands {
                let output = elsewhere(&system, way, arguments);
                assert_eq!(output.status.code(), Some(4), "{way:?} {arguments:?}: {}", text(&output));
                assert!(text(&output).contains("can't be seen from this PID namespace"), "{}", text(&output));
            }
            let scan = watch.newest().map_or(0, |truth| truth.header.scan_id);
            watch.wait_for(&system, "it drives on", |truth| {
                truth.header.scan_id > scan + 3 && truth.speed_mps > 0.5
            });
            drop(watch);
            let stopped = system.run(&["stop"]);
            assert_eq!(stopped.status.code(), Some(0), "{}", text(&stopped));
            system.assert_nothing_left();
        }
    });
}

#[test]
fn without_the_files_of_the_kernel_no_command_says_that_nothing_runs() {
    among_users!("without_the_files_of_the_kernel_no_command_says_that_nothing_runs");
    let system = system();
    for arguments in [&["status"][..], &["stop"], &["restart", "controller"], &["latency"], &["why", "5"]] {
        let mut command = Command::new("unshare");
        command.args(["-m", "sh", "-c", "mount -t tmpfs tmpfs /proc && exec \"$0\" \"$@\""]);
        command.arg(executable_for_all()).args(["--system-id", system.id()]).args(arguments);
        let output = command.output().expect("unshare runs");
        assert_eq!(output.status.code(), Some(4), "{arguments:?}: {}", text(&output));
        assert!(text(&output).contains("/proc is not mounted"), "{arguments:?}: {}", text(&output));
    }
}

#[test]
fn a_system_in_a_namespace_below_is_stopped_with_its_orchestrator() {
    repeat_when_late(|| {
        among_users!("a_system_in_a_namespace_below_is_stopped_with_its_orchestrator");
        let way = WAYS[0];
        if !may_be_made(way) {
            return;
        }
        let system = system();
        let mut command = Command::new("unshare");
        command.args(way).arg("--kill-child").arg(executable_for_all()).args(["--system-id", system.id()]);
        command.args(["run", "--quiet", "--out", "out", "endless"]).current_dir(system.folder());
        let mut container = command.spawn().expect("unshare runs");
        system.wait_until("it drives", is_driving);
        let stopped = system.run(&["stop"]);
        assert_eq!(stopped.status.code(), Some(0), "{}", text(&stopped));
        assert!(!text(&stopped).contains("lost its orchestrator"), "{}", text(&stopped));
        assert_eq!(container.wait().expect("a child of ours").code(), Some(1));
        system.assert_nothing_left();
    });
}

#[test]
fn what_a_namespace_that_is_gone_has_left_keeps_no_run_from_starting() {
    repeat_when_late(|| {
        among_users!("what_a_namespace_that_is_gone_has_left_keeps_no_run_from_starting");
        let way = WAYS[0];
        if !may_be_made(way) {
            return;
        }
        let system = system();
        let mut command = Command::new("unshare");
        command.args(way).arg("--kill-child").arg(executable_for_all()).args(["--system-id", system.id()]);
        command.args(["run", "--quiet", "--out", "out", "endless"]).current_dir(system.folder());
        let mut container = command.spawn().expect("unshare runs");
        system.wait_until("it drives", is_driving);
        // As the end of a container: all processes at once, without a clean-up.
        kill(&[container.id().cast_signed()]);
        container.wait().expect("a child of ours");
        // A process that ends gives up its environment before its locks.
        system.wait_until("no process lives", |system| {
            system.processes().is_empty() && !text(&system.run(&["status"])).contains("can't be seen")
        });
        assert!(system.find().is_some(), "its directory is left");
        let drive = system.run(&["run", "--lockstep", "--quiet", "free", "--set", "goal.x_m=2"]);
        assert_eq!(drive.status.code(), Some(0), "{}", text(&drive));
        system.assert_nothing_left();
    });
}
