//! `swap --watch`: each saved change of a program takes over, or is refused, while the robot drives.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::fs::{OpenOptions, Permissions};
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Stdio};

use handover::swap::{Certificate, SwapOutcome};
use rustix::process::Signal;
use scanloop_tests::TestSystem;
use scanloop_tests::swaps::{assert_seamless, assert_seamless_swap, stop};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty-controller");

/// Starts the watch of a program; certificates go to a file.
fn watch(system: &TestSystem, command: &[&str]) -> Child {
    let file = |name: &str| std::fs::File::create(system.folder().join(name)).unwrap();
    let mut watch = system.command(&["swap", "controller", "--watch", "--gate-scans", "3", "--json", "--"]);
    watch.args(command).stdout(file("certificates.json")).stderr(Stdio::from(file("watch.txt")));
    watch.spawn().unwrap()
}

fn certificates(system: &TestSystem) -> Vec<Certificate> {
    let text = std::fs::read_to_string(system.folder().join("certificates.json")).unwrap_or_default();
    // The last one may not be whole yet.
    serde_json::Deserializer::from_str(&text).into_iter().map_while(Result::ok).collect()
}

/// Waits for the certificate of that number and returns it.
fn wait_for(system: &TestSystem, number: usize) -> Certificate {
    system.wait_until("the next certificate", |system| certificates(system).len() >= number);
    let all = certificates(system);
    assert_eq!(all.len(), number, "{all:?}");
    all[number - 1].clone()
}

fn end(mut watch: Child) {
    rustix::process::kill_process(rustix::process::Pid::from_child(&watch), Signal::INT).unwrap();
    assert_eq!(watch.wait().unwrap().code(), Some(0));
}

/// A shell script that becomes another program.
fn script(path: &Path, program: &str) {
    std::fs::write(path, format!("#!/bin/sh\nexec {program}\n")).unwrap();
    std::fs::set_permissions(path, Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn each_change_takes_over_and_a_worse_one_is_refused() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let (program, good) = (system.folder().join("mine"), format!("{EXECUTABLE} service nmpc"));
        script(&program, &good);
        let watch = watch(&system, &["./mine"]);
        assert_seamless_swap(&wait_for(&system, 1));
        let driving = system.pid(Role::Controller);

        script(&program, &format!("{FAULTY} nan"));
        let worse = wait_for(&system, 2);
        assert!(worse.outcome == SwapOutcome::Refused && worse.reason.contains("is not finite"), "{worse:?}");
        assert_seamless(&worse);
        assert_eq!(system.pid(Role::Controller), driving);

        // A file that is open for writing is not taken, however long its writer pauses.
        let mut writer = OpenOptions::new().write(true).truncate(true).open(&program).unwrap();
        writer.write_all(b"#!/bin/sh\n").unwrap();
        let scan = system.status().unwrap().scan;
        system.wait_until("ten scans have passed", |system| system.status().unwrap().scan > scan + 10);
        assert_eq!(certificates(&system).len(), 2);
        writer.write_all(format!("exec {good} # better\n").as_bytes()).unwrap();
        drop(writer);
        assert_seamless_swap(&wait_for(&system, 3));
        assert_ne!(system.pid(Role::Controller), driving);

        // A save without a change is none.
        script(&program, &format!("{good} # better"));
        let scan = system.status().unwrap().scan;
        system.wait_until("ten scans have passed", |system| system.status().unwrap().scan > scan + 10);
        assert_eq!(certificates(&system).len(), 3);
        end(watch);
        stop(&mut system);
        assert_eq!(system.report().swaps, certificates(&system));
        system.assert_nothing_left();
    });
}

#[test]
fn a_change_of_an_imported_module_counts() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let module = system.folder().join("plan.py");
        let start = "import os, plan\nos.execv(plan.COMMAND[0], plan.COMMAND)\n";
        std::fs::write(system.folder().join("mine.py"), start).unwrap();
        let command = |more: &str| format!("COMMAND = [{EXECUTABLE:?}, 'service', 'nmpc']{more}\n");
        std::fs::write(&module, command("")).unwrap();
        let watch = watch(&system, &["python3", "mine.py"]);
        assert_seamless_swap(&wait_for(&system, 1));
        // As most editors save: a new file takes the place of the old one.
        let new = system.folder().join("plan.py.new");
        std::fs::write(&new, command(" # better")).unwrap();
        std::fs::rename(&new, &module).unwrap();
        assert_seamless_swap(&wait_for(&system, 2));
        std::fs::write(&module, "this is no Python").unwrap();
        let worse = wait_for(&system, 3);
        assert!(worse.outcome == SwapOutcome::Refused && worse.reason.contains("SyntaxError"), "{worse:?}");
        let text = std::fs::read_to_string(system.folder().join("watch.txt")).unwrap();
        assert!(text.contains("watching mine.py, plan.py") && text.contains("plan.py changed"), "{text}");
        end(watch);
        stop(&mut system);
        system.assert_nothing_left();
    });
}

#[test]
fn a_watch_needs_a_file_and_ends_with_the_system() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let output = system.run(&["swap", "controller", "--watch", "--", "no-such-command"]);
        assert_eq!(output.status.code(), Some(2));
        assert!(String::from_utf8_lossy(&output.stderr).contains("the command names no file"));
        script(&system.folder().join("mine"), &format!("{EXECUTABLE} service nmpc"));
        let mut watch = watch(&system, &["./mine"]);
        assert_seamless_swap(&wait_for(&system, 1));
        stop(&mut system);
        assert_eq!(watch.wait().unwrap().code(), Some(0));
        system.assert_nothing_left();
    });
}

#[test]
fn a_program_that_another_user_can_replace_is_not_watched() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let (outer, inner) = (system.folder().join("outer"), system.folder().join("outer/inner"));
        std::fs::create_dir_all(&inner).unwrap();
        let program = inner.join("mine");
        script(&program, &format!("{EXECUTABLE} service nmpc"));
        let set_mode =
            |path: &Path, mode| std::fs::set_permissions(path, Permissions::from_mode(mode)).unwrap();
        let text = |output: &std::process::Output| String::from_utf8_lossy(&output.stderr).into_owned();
        let driving = system.pid(Role::Controller);
        for part in [&outer, &inner, &program] {
            let before = std::fs::metadata(part).unwrap().permissions().mode();
            set_mode(part, 0o777);
            let refused = system.run(&["swap", "controller", "--watch", "--", "./outer/inner/mine"]);
            assert_eq!(refused.status.code(), Some(2), "{}", text(&refused));
            let named =
                format!("{} has owner {} and mode 0777", part.display(), rustix::process::geteuid().as_raw());
            assert!(text(&refused).contains("--watch: another user can replace"), "{}", text(&refused));
            assert!(text(&refused).contains(&named), "{}", text(&refused));
            assert_eq!(system.pid(Role::Controller), driving);
            set_mode(part, before & 0o777);
        }
        // Without a watch it runs once, by the user's own word, with a warning.
        set_mode(&inner, 0o777);
        let once = system.run(&["swap", "controller", "--gate-scans", "3", "--", "./outer/inner/mine"]);
        // A busy machine may have it rolled back.
        assert!(matches!(once.status.code(), Some(0 | 1)), "{}", text(&once));
        assert!(text(&once).contains("warning: another user can replace"), "{}", text(&once));
        set_mode(&inner, 0o755);
        // The folder is opened to all while the watch lasts: what comes then is not run.
        let mut watch = watch(&system, &["./outer/inner/mine"]);
        wait_for(&system, 1);
        let driving = system.pid(Role::Controller);
        set_mode(&inner, 0o777);
        script(&program, &format!("{EXECUTABLE} service nmpc --other"));
        assert_eq!(watch.wait().unwrap().code(), Some(2));
        let told = std::fs::read_to_string(system.folder().join("watch.txt")).unwrap();
        assert!(told.contains("has owner"), "{told}");
        assert_eq!((certificates(&system).len(), system.pid(Role::Controller)), (1, driving));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}
