//! `doctor` on this machine, with what is really missing: a limit that is too small, and what a dead system has left.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::{TestSystem, namespace, printed};
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// The check of that name, and the exit code.
fn check(output: &Output, name: &str) -> (Value, Option<i32>) {
    let report: Value =
        serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", printed(output)));
    let checks = report["checks"].as_array().unwrap();
    let found = checks.iter().find(|check| check["name"] == name).unwrap();
    (found.clone(), output.status.code())
}

/// A command of the executable below a limit of the shell.
fn below(system: &TestSystem, limit: &str, command: &str) -> Output {
    let script = format!("ulimit {limit} && exec {EXECUTABLE} --system-id {} {command}", system.id());
    Command::new("bash").args(["-c", &script]).current_dir(system.folder()).output().unwrap()
}

#[test]
fn a_limit_that_stops_a_drive_fails_and_run_points_to_it() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let (usual, _) = check(&system.run(&["doctor", "--json"]), "open_files");
        assert_eq!((usual["state"].as_str(), usual["fix"].is_null()), (Some("ok"), true));
        for (limit, name, fix) in
            [("-n 64", "open_files", "`ulimit -n 256`"), ("-f 1024", "file_size", "`ulimit -f 262144`")]
        {
            let (found, code) = check(&below(&system, limit, "doctor --json"), name);
            assert_eq!((found["state"].as_str(), code), (Some("fail"), Some(1)), "{found}");
            assert!(found["fix"].as_str().unwrap().contains(fix), "{found}");
        }
        let text = String::from_utf8(below(&system, "-n 64", "doctor").stdout).unwrap();
        assert!(
            text.contains("\nfail open files        at most 64 files may be open, 256 are needed\n"),
            "{text}"
        );
        let run = below(&system, "-n 64", "run --quiet free");
        assert_eq!(run.status.code(), Some(4));
        assert!(printed(&run).contains("`scanloop doctor`"), "{}", printed(&run));
        system.assert_nothing_left();
    });
}

#[test]
fn shared_memory_that_can_only_be_read_stops_a_drive_and_run_points_to_doctor() {
    let test = concat!(
        module_path!(),
        "::shared_memory_that_can_only_be_read_stops_a_drive_and_run_points_to_doctor"
    );
    if !namespace::is_inside(test, "mount -t tmpfs -o ro tmpfs /dev/shm &&", |_| {}) {
        return;
    }
    let system = TestSystem::new(EXECUTABLE);
    let (found, code) = check(&system.run(&["doctor", "--json"]), "shared_memory");
    assert_eq!((found["state"].as_str(), code), (Some("fail"), Some(1)), "{found}");
    assert_eq!(found["fix"], "`mount -o remount,rw /dev/shm` as root");
    let run = system.run(&["run", "--quiet", "--lockstep", "free"]);
    assert_eq!(run.status.code(), Some(4), "{}", printed(&run));
    assert!(printed(&run).contains("Read-only file system") && printed(&run).contains("`scanloop doctor`"));
    system.assert_nothing_left();
}

#[test]
fn a_process_that_can_not_be_started_points_to_doctor() {
    let system = TestSystem::new(EXECUTABLE);
    std::fs::write(
        system.folder().join("system.toml"),
        "[[process]]\nrole = \"controller\"\ncommand = [\"/nowhere\"]\n",
    )
    .unwrap();
    let run = system.run(&["run", "--quiet", "--lockstep", "--system", "system.toml", "free"]);
    assert_eq!(run.status.code(), Some(4), "{}", printed(&run));
    assert!(String::from_utf8_lossy(&run.stderr).contains("`scanloop doctor`"), "{}", printed(&run));
    system.assert_nothing_left();
}

#[test]
fn what_a_dead_system_has_left_is_named_with_the_command_that_clears_it() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--set", "orphan_timeout_s=600"]);
        let left = |system: &TestSystem| {
            let (found, _) = check(&system.run(&["doctor", "--json"]), "left_overs");
            let is_named = |key: &str| found[key].as_str().is_some_and(|text| text.contains(system.id()));
            (is_named("detail"), is_named("fix"), found.to_string())
        };
        let (running, _) = check(&system.run(&["doctor", "--json"]), "running");
        assert!(
            running["detail"].as_str().unwrap().contains(&format!("`{}` with 5 processes", system.id())),
            "{running}"
        );
        assert!(!left(&system).0, "a running system is no left-over: {}", left(&system).2);
        system.kill_orchestrator();
        let (is_named, has_fix, found) = left(&system);
        assert!(is_named && has_fix && found.contains("lost its orchestrator"), "{found}");
        // All at once, as when the machine runs out of memory: its files are left.
        for pid in system.processes() {
            system.signal(pid, rustix::process::Signal::KILL);
        }
        system.wait_until("all are dead", |system| system.processes().is_empty());
        let (is_named, has_fix, found) = left(&system);
        assert!(is_named && has_fix && found.contains("nothing lives"), "{found}");
        // The fix is the command itself.
        let stop = Command::new(EXECUTABLE).args(["stop", "--system-id", system.id()]).output().unwrap();
        let (is_named, ..) = left(&system);
        assert!(!is_named, "{}", printed(&stop));
        system.assert_nothing_left();
    });
}

#[test]
fn a_directory_for_systems_that_run_refuses_fails() {
    let system = TestSystem::new(EXECUTABLE);
    let open = system.folder().join("open");
    std::fs::create_dir(&open).unwrap();
    std::fs::set_permissions(&open, std::fs::Permissions::from_mode(0o755)).unwrap();
    for (place, reason) in [
        (open.as_path(), "open has mode"),
        (Path::new("relative"), "relative is no absolute path"),
        (&system.folder().join("missing/inner"), "missing: No such file"),
    ] {
        let command = |words: &[&str]| {
            let mut command = Command::new(EXECUTABLE);
            command.args(words).current_dir(system.folder()).env("SCANLOOP_RUNTIME_DIR", place);
            command.output().unwrap()
        };
        let (found, code) = check(&command(&["doctor", "--json"]), "runtime_directory");
        assert_eq!((found["state"].as_str(), code), (Some("fail"), Some(1)), "{found}");
        assert!(found["detail"].as_str().unwrap().contains(reason), "{found}");
        assert!(found["fix"].as_str().unwrap().contains("SCANLOOP_RUNTIME_DIR"), "{found}");
        let run = command(&["--system-id", system.id(), "run", "--quiet", "--lockstep", "free"]);
        assert!(![Some(0), Some(1)].contains(&run.status.code()), "{}", printed(&run));
        assert!(!system.folder().join("missing").exists(), "nothing is made");
    }
    system.assert_nothing_left();
}
