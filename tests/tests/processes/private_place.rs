//! The directory of a system is closed to other users, whatever the umask and the variables of the session.
//!
//! Each test has `/tmp`, `/dev/shm` and `/run/user` of its own in a mount namespace, and a real second user. Where
//! the test does not run as root, or may not mount, it prints what it skipped.

use std::os::unix::fs::{DirBuilderExt, MetadataExt, symlink};
use std::path::Path;

use rustix::fs::Mode;
use rustix::process::umask;
use scanloop_tests::stranger::{
    HOME, PLACE, PLACE_OF_STRANGER, as_stranger, assert_refused, make_folder, of_stranger, shared_memory,
    system, text, tree,
};
use scanloop_tests::{System, among_users};

/// Permissions of other users for the files of a running system, in its directory and in shared memory.
fn assert_private(system: &System) {
    let domain = system.domain();
    let of_run = shared_memory().filter(|name| name.contains(domain.run_id()));
    let mut all = tree(domain.directory().parent().expect("a place"));
    all.extend(of_run.flat_map(|name| tree(&Path::new("/dev/shm").join(name))));
    assert!(all.len() > 60, "{all:?}");
    for path in all {
        // Sockets of the bus come and go.
        let Ok(found) = path.symlink_metadata() else { continue };
        // The bus makes directories for its group too, all within one that is private.
        let is_of_bus = path.starts_with("/dev/shm") && path.parent() != Some(Path::new("/dev/shm"));
        let closed = if is_of_bus && found.is_dir() { 0o027 } else { 0o077 };
        assert_eq!((found.uid(), found.mode() & closed), (0, 0), "{}: {:o}", path.display(), found.mode());
    }
}

#[test]
fn files_are_private_whatever_the_umask() {
    among_users!("files_are_private_whatever_the_umask");
    for mask in [Mode::empty(), Mode::RWXU | Mode::RWXG | Mode::RWXO] {
        let mut system = system();
        std::fs::create_dir(system.folder().join("out")).unwrap();
        let old = umask(mask);
        system.launch(&["run", "--quiet", "--out", "out", "long"], &[]);
        umask(old);
        system.wait_until_driving();
        assert_private(&system);
        let restarted = system.run(&["restart", "controller"]);
        assert_eq!(restarted.status.code(), Some(0), "{}", text(&restarted));
        assert_private(&system);
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    }
}

#[test]
fn a_user_without_privileges_drives_with_any_umask() {
    among_users!("a_user_without_privileges_drives_with_any_umask");
    let system = system();
    for mask in [Mode::empty(), Mode::RWXU | Mode::RWXG | Mode::RWXO] {
        let mut run = of_stranger(system.id(), &["run", "--lockstep", "--quiet", "--out", "out", "free"]);
        as_stranger(|| std::fs::create_dir_all(Path::new(HOME).join("out/logs")).unwrap());
        let old = umask(mask);
        let output = run.output().unwrap();
        umask(old);
        assert_eq!(output.status.code(), Some(0), "{mask:?}: {}", text(&output));
        assert!(!Path::new(PLACE_OF_STRANGER).exists());
        as_stranger(|| std::fs::remove_dir_all(Path::new(HOME).join("out")).unwrap());
    }
}

#[test]
fn a_named_place_is_made_or_refused_with_what_is_wrong() {
    among_users!("a_named_place_is_made_or_refused_with_what_is_wrong");
    let system = system();
    let run = |path: &str| {
        let mut command = system.command(&["run", "--lockstep", "--quiet", "free"]);
        command.env("SCANLOOP_RUNTIME_DIR", path).output().unwrap()
    };
    assert_refused(
        &run("relative/place"),
        &["relative/place", "is no absolute path", "SCANLOOP_RUNTIME_DIR"],
    );
    as_stranger(|| std::fs::DirBuilder::new().mode(0o700).create("/tmp/his").unwrap());
    assert_refused(&run("/tmp/his"), &["/tmp/his", "belongs to user 65534", "mode 0700", "remove it"]);
    make_folder("/tmp/open", 0o777);
    assert_refused(&run("/tmp/open"), &["/tmp/open", "has mode 0777 instead of 0700"]);
    as_stranger(|| symlink("/tmp", "/tmp/link").unwrap());
    assert_refused(&run("/tmp/link"), &["/tmp/link", "is a symbolic link of user 65534"]);
    std::fs::write("/tmp/file", "").unwrap();
    assert_refused(&run("/tmp/file"), &["/tmp/file", "is no directory"]);
    let made = run("/tmp/made");
    assert_eq!(made.status.code(), Some(0), "{}", text(&made));
    assert_eq!(std::fs::metadata("/tmp/made").unwrap().mode() & 0o777, 0o700);
    assert!(!Path::new(PLACE).exists());
}

#[test]
fn a_session_directory_that_is_not_private_is_passed_over() {
    among_users!("a_session_directory_that_is_not_private_is_passed_over");
    as_stranger(|| std::fs::DirBuilder::new().mode(0o700).create("/tmp/his").unwrap());
    make_folder("/tmp/readable", 0o755);
    for path in ["/tmp/his", "/tmp/readable", "/tmp/missing", "relative"] {
        let mut system = system();
        system.launch(&["run", "--quiet", "--out", "out", "long"], &[("XDG_RUNTIME_DIR", path)]);
        system.wait_until_driving();
        assert_eq!(system.domain().directory(), Path::new(PLACE).join(system.id()), "{path}");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    }
}

#[test]
fn a_system_in_another_place_is_not_started_twice_and_answers_all_commands() {
    among_users!("a_system_in_another_place_is_not_started_twice_and_answers_all_commands");
    make_folder("/tmp/session", 0o700);
    for kill in [false, true] {
        let mut system = system();
        let environment = [("XDG_RUNTIME_DIR", "/tmp/session")];
        system.launch(&["run", "--quiet", "--out", "out", "long"], &environment);
        let folder = Path::new("/tmp/session/scanloop").join(system.id());
        let status = |system: &System| system.run(&["status", "--json"]);
        system.wait_until("it drives", |system| {
            String::from_utf8_lossy(&status(system).stdout).contains("\"driving\"")
        });
        let refused = system.run(&["run", "--quiet", "free"]);
        assert_refused(&refused, &[folder.to_str().unwrap(), "already running", "--system-id"]);
        assert_eq!(system.run(&["restart", "obstacles"]).status.code(), Some(0));
        if kill {
            system.kill_orchestrator();
            assert_eq!(status(&system).status.code(), Some(0), "{}", text(&status(&system)));
        }
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        if !kill {
            assert_eq!(system.wait().code(), Some(1));
        }
        system.assert_nothing_left();
        system.wait_until("its directory is gone", |_| !folder.exists());
    }
}
