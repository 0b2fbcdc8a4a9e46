//! A daemon that a process of a run has started is no system: all commands agree on what lives, and name it.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::process::Output;

use rustix::process::Signal;
use scanloop_tests::{SHORT_FREE, TestSystem};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// A system whose robot, estimator and companion each start a daemon in a session of its own.
fn system() -> TestSystem {
    let system = TestSystem::new(EXECUTABLE);
    let names = ["emulator", "ekf", "ellipses", "nmpc", "actuation"];
    let mut text = String::new();
    for (role, name) in Role::ALL.iter().zip(names) {
        text += &format!("[[process]]\nrole = \"{role}\"\n");
        text += &match role {
            Role::Robot | Role::Estimator => {
                let script = format!("setsid sleep 9741 & exec {EXECUTABLE} service {name}");
                format!("command = {:?}\n", ["sh", "-c", &script])
            }
            _ => format!("implementation = \"{name}\"\n"),
        };
    }
    let script = "setsid sleep 9742 & exec sleep 9743";
    text += "[[process]]\nrole = \"companion\"\nname = \"lidar\"\nrestart = \"never\"\n";
    text += &format!("command = {:?}\n", ["sh", "-c", script]);
    std::fs::write(system.folder().join("lab.toml"), text).unwrap();
    system
}

/// The built-in system with a companion that is a script.
fn system_with(script: &str) -> TestSystem {
    let system = TestSystem::new(EXECUTABLE);
    let command = ["sh", "-c", script];
    let text = format!(
        "[[process]]\nrole = \"companion\"\nname = \"lidar\"\nrestart = \"never\"\ncommand = {command:?}\n"
    );
    std::fs::write(system.folder().join("lab.toml"), text).unwrap();
    system
}

/// Waits until a program of the system runs that sleeps for so long.
fn wait_for_sleeper(system: &TestSystem, seconds: &str) {
    let line = format!("sleep\0{seconds}\0");
    let is_sleeper =
        |pid: &i32| std::fs::read(format!("/proc/{pid}/cmdline")).is_ok_and(|found| found == line.as_bytes());
    system.wait_until("the daemon sleeps", |system| system.processes().iter().any(is_sleeper));
}

/// A daemon that ignores the request to end and sleeps again when its program is ended.
const STUBBORN: &str = "setsid sh -c 'trap : TERM HUP INT; while :; do sleep 90114; done' & exec sleep 90214";
/// A daemon that starts others again and again, each in a session of its own.
const PROLIFIC: &str =
    "setsid sh -c 'trap \"\" TERM; while :; do setsid sleep 90115 & sleep 0.1; done' & exec sleep 90215";

/// Process ids of the daemons, once all three are there.
fn daemons(system: &TestSystem) -> Vec<i32> {
    let of = |pid: &i32| {
        let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        line == b"sleep\x009741\0" || line == b"sleep\x009742\0"
    };
    let found = || system.processes().into_iter().filter(of).collect::<Vec<_>>();
    system.wait_until("the daemons run", |_| found().len() == 3);
    found()
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&[output.stdout.as_slice(), &output.stderr].concat()).into_owned()
}

/// The exit code, and that each daemon is named.
fn named(system: &TestSystem, daemons: &[i32], arguments: &[&str]) -> Option<i32> {
    let output = system.run(arguments);
    for pid in daemons {
        assert!(
            text(&output).contains(&format!("process {pid} (sleep)")),
            "{arguments:?}: {}",
            text(&output)
        );
    }
    output.status.code()
}

/// That no system lives by the daemons: `status` and `adopt` find none, a run drives, and a stop ends them.
fn assert_no_system_lives(system: &TestSystem, daemons: &[i32]) {
    assert_eq!(named(system, daemons, &["status"]), Some(2));
    assert_eq!(named(system, daemons, &["adopt", "--quiet"]), Some(2));
    let run = ["run", "--lockstep", "--quiet", "free", "--set", "goal.x_m=2"];
    assert_eq!(named(system, daemons, &run), Some(0));
    assert_eq!(system.processes().len(), daemons.len(), "they are left alone");
    assert_eq!(named(system, daemons, &["stop"]), Some(0));
    assert_eq!(system.processes(), [0; 0]);
    assert_eq!(system.run(&["stop"]).status.code(), Some(2));
    system.assert_nothing_left();
}

#[test]
fn a_stop_ends_what_processes_of_the_run_have_started_in_sessions_of_their_own() {
    repeat_when_late(|| {
        let mut system = system();
        system.start(&["endless", "--system", "lab.toml"]);
        let daemons = daemons(&system);
        assert_eq!(named(&system, &daemons, &["stop"]), Some(0));
        system.wait();
        system.wait_until("the daemons have ended", |system| system.processes().is_empty());
        assert_eq!(system.run(&["status"]).status.code(), Some(2));
        system.assert_nothing_left();
    });
}

#[test]
fn a_daemon_that_outlives_its_run_is_named_and_keeps_no_run_from_starting() {
    repeat_when_late(|| {
        let mut system = system();
        system.start(&[&SHORT_FREE[..], &["--system", "lab.toml"]].concat());
        let daemons = daemons(&system);
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        for pid in &daemons {
            assert!(
                system.stderr().contains(&format!("has left process {pid} (sleep)")),
                "{}",
                system.stderr()
            );
        }
        assert_no_system_lives(&system, &daemons);
    });
}

#[test]
fn a_run_of_which_only_daemons_are_left_is_over() {
    repeat_when_late(|| {
        let mut system = system();
        system.start(&["endless", "--system", "lab.toml"]);
        let daemons = daemons(&system);
        system.kill_orchestrator();
        for pid in system.processes().into_iter().filter(|pid| !daemons.contains(pid)) {
            system.signal(pid, Signal::KILL);
        }
        system.wait_until("only the daemons live", |system| system.processes().len() == daemons.len());
        assert_no_system_lives(&system, &daemons);
    });
}

#[test]
fn a_stop_returns_when_daemons_that_ignore_the_request_have_ended() {
    repeat_when_late(|| {
        for (script, seconds) in [(STUBBORN, "90114"), (PROLIFIC, "90115")] {
            let mut system = system_with(script);
            system.start(&["endless", "--system", "lab.toml"]);
            wait_for_sleeper(&system, seconds);
            let output = system.run(&["stop"]);
            assert_eq!(output.status.code(), Some(0), "{}", text(&output));
            assert!(
                text(&output).contains("which companion lidar has started, is ended too"),
                "{}",
                text(&output)
            );
            // What was said holds at once.
            assert_eq!(system.processes(), [0; 0], "{}", text(&output));
            system.wait();
            system.assert_nothing_left();
        }
    });
}

#[test]
fn a_stop_ends_daemons_of_a_run_that_is_over_and_what_they_start_meanwhile() {
    repeat_when_late(|| {
        for (script, seconds) in [(STUBBORN, "90114"), (PROLIFIC, "90115")] {
            let mut system = system_with(script);
            system.start(&[&SHORT_FREE[..], &["--system", "lab.toml"]].concat());
            wait_for_sleeper(&system, seconds);
            assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
            let output = system.run(&["stop"]);
            assert_eq!(output.status.code(), Some(0), "{}", text(&output));
            assert!(text(&output).contains("a run that is over had left process"), "{}", text(&output));
            assert_eq!(system.processes(), [0; 0], "{}", text(&output));
            system.assert_nothing_left();
        }
    });
}

#[test]
fn a_daemon_that_has_changed_its_user_is_named_and_ended_by_root() {
    repeat_when_late(|| {
        let changes = std::process::Command::new("setpriv").args(["--reuid", "1234", "true"]).output();
        if !changes.is_ok_and(|output| output.status.success()) {
            println!("skipped: this test needs root and `setpriv`");
            return;
        }
        let script = "setsid setpriv --reuid 1234 sleep 90105 & exec sleep 90205";
        let mut system = system_with(script);
        system.start(&["endless", "--system", "lab.toml"]);
        wait_for_sleeper(&system, "90105");
        let output = system.run(&["stop"]);
        assert!(
            text(&output).contains("(sleep), which companion lidar has started, is ended too"),
            "{}",
            text(&output)
        );
        assert_eq!((output.status.code(), system.processes()), (Some(0), Vec::new()));
        system.wait();
        let mut system = system_with(script);
        system.start(&[&SHORT_FREE[..], &["--system", "lab.toml"]].concat());
        wait_for_sleeper(&system, "90105");
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        assert!(system.stderr().contains("has left process"), "{}", system.stderr());
        let daemons = system.processes();
        assert_eq!(named(&system, &daemons, &["status"]), Some(2));
        assert_eq!(named(&system, &daemons, &["stop"]), Some(0));
        assert_eq!(system.processes(), [0; 0]);
        system.assert_nothing_left();
    });
}
