//! The directory of a system is closed to other users, whatever the umask and the variables of the session.
//!
//! Each test that needs it has `/tmp`, `/dev/shm` and `/run/user` of its own in a mount namespace, and a real second user.
//! Where such a test does not run as root, or may not mount, it prints what it skipped.

use scanloop_tests::machine::repeat_when_late;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, symlink};
use std::path::Path;
use std::process::Output;

use rustix::fs::Mode;
use rustix::process::umask;
use scanloop_tests::stranger::{
    HOME, PLACE, PLACE_OF_STRANGER, as_stranger, assert_refused, make_folder, of_stranger, shared_memory,
    system, text, tree,
};
use scanloop_tests::{TestSystem, among_users};

/// Permissions of other users for the files of a running system, in its directory and in shared memory.
fn assert_private(system: &TestSystem) {
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
    repeat_when_late(|| {
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
    });
}

#[test]
fn a_user_without_privileges_drives_with_any_umask() {
    repeat_when_late(|| {
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
    });
}

#[test]
fn a_named_place_is_made_or_refused_with_what_is_wrong() {
    repeat_when_late(|| {
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
    });
}

/// Every command that searches, makes or removes the directory of a system.
const COMMANDS: [&[&str]; 8] = [
    &["status"],
    &["status", "--json"],
    &["stop"],
    &["adopt", "--quiet"],
    &["run", "--lockstep", "--quiet", "free"],
    &["run", "--adopt-or-start", "--quiet", "free"],
    &["restart", "controller"],
    &["record", "file.mcap"],
];

/// Names, modes and contents below a path.
fn state_of(path: &Path) -> Vec<(String, u32, Vec<u8>)> {
    let name = |path: &Path| path.display().to_string();
    let mode = |path: &Path| path.symlink_metadata().expect("it is there").mode();
    let content = |path: &Path| std::fs::read(path).unwrap_or_default();
    tree(path).iter().map(|path| (name(path), mode(path), content(path))).collect()
}

fn in_place(system: &TestSystem, place: &Path, arguments: &[&str]) -> Output {
    let mut command = system.command(arguments);
    command.env(runtime::RUNTIME_DIR_VARIABLE, place).output().expect("the executable runs")
}

#[test]
fn a_named_place_that_others_may_read_is_refused_and_not_changed() {
    repeat_when_late(|| {
        let system = TestSystem::new(env!("CARGO_BIN_EXE_scanloop-under-test"));
        for mode in [0o755, 0o750, 0o770, 0o500] {
            let place = system.folder().join(format!("own-{mode:o}"));
            make_folder(&place, 0o700);
            std::fs::create_dir(place.join(system.id())).unwrap();
            std::fs::write(place.join(system.id()).join("precious"), "stays").unwrap();
            std::fs::set_permissions(&place, std::os::unix::fs::PermissionsExt::from_mode(mode)).unwrap();
            let before = state_of(&place);
            for arguments in COMMANDS {
                let refused = in_place(&system, &place, arguments);
                assert_refused(
                    &refused,
                    &[place.to_str().unwrap(), &format!("has mode {mode:04o} instead of 0700")],
                );
                assert_eq!(state_of(&place), before, "{arguments:?}");
            }
        }
    });
}

#[test]
fn a_folder_with_the_name_of_a_system_is_not_taken_for_one() {
    repeat_when_late(|| {
        let system = TestSystem::new(env!("CARGO_BIN_EXE_scanloop-under-test"));
        let place = system.folder().join("own");
        let own = place.join(system.id());
        let contents: [&[(&str, &str)]; 4] = [
            &[("precious", "stays"), ("lock", ""), ("run.toml", "mine = 1")],
            &[("run-id", "20261126-experiment"), ("precious", "stays")],
            &[("run-id", "")],
            &[],
        ];
        for content in contents {
            make_folder(&place, 0o700);
            make_folder(&own, 0o700);
            content.iter().for_each(|(name, text)| std::fs::write(own.join(name), text).unwrap());
            std::fs::write(place.join(format!("{}.stopped", system.id())), "mine").unwrap();
            let before = state_of(&place);
            for arguments in COMMANDS {
                let refused = in_place(&system, &place, arguments);
                assert_refused(
                    &refused,
                    &[own.to_str().unwrap(), "is no directory of a system", "--system-id"],
                );
                assert_eq!(state_of(&place), before, "{arguments:?} {content:?}");
            }
            std::fs::remove_dir_all(&place).unwrap();
        }
        // A drive beside such a folder leaves all that was there, the named place included.
        make_folder(&place, 0o700);
        make_folder(place.join("other"), 0o755);
        std::fs::write(place.join("other/precious"), "stays").unwrap();
        let before = state_of(&place);
        let drive =
            in_place(&system, &place, &["run", "--lockstep", "--quiet", "free", "--set", "goal.x_m=2"]);
        assert_eq!(drive.status.code(), Some(0), "{}", text(&drive));
        assert_eq!(state_of(&place), before);
    });
}

#[test]
fn a_stop_from_another_session_leaves_the_empty_place_that_the_user_named() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(env!("CARGO_BIN_EXE_scanloop-under-test"));
        let place = system.folder().join("scanloop");
        make_folder(&place, 0o700);
        let named = [(runtime::RUNTIME_DIR_VARIABLE, place.to_str().unwrap())];
        system.launch(&["run", "--quiet", "--out", "out", "long"], &named);
        let folder = place.join(system.id());
        system.wait_until("it drives", |system| {
            String::from_utf8_lossy(&in_place(system, &place, &["status"]).stdout).contains("driving")
                || String::from_utf8_lossy(&in_place(system, &place, &["status"]).stderr).contains("driving")
        });
        // Without the variable.
        system.kill_orchestrator();
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait_until("its directory is gone", |_| !folder.exists());
        assert!(place.exists(), "the place is the user's");
    });
}

#[test]
fn a_session_directory_that_is_not_private_is_passed_over() {
    repeat_when_late(|| {
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
    });
}

#[test]
fn a_system_in_another_place_is_not_started_twice_and_answers_all_commands() {
    repeat_when_late(|| {
        among_users!("a_system_in_another_place_is_not_started_twice_and_answers_all_commands");
        make_folder("/tmp/session", 0o700);
        for kill in [false, true] {
            let mut system = system();
            let environment = [("XDG_RUNTIME_DIR", "/tmp/session")];
            system.launch(&["run", "--quiet", "--out", "out", "long"], &environment);
            let folder = Path::new("/tmp/session/scanloop").join(system.id());
            let status = |system: &TestSystem| system.run(&["status", "--json"]);
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
    });
}

#[test]
fn a_file_in_the_output_folder_that_no_run_has_written_is_left() {
    repeat_when_late(|| {
        let system = TestSystem::new(env!("CARGO_BIN_EXE_scanloop-under-test"));
        std::fs::create_dir_all(system.folder().join("out/logs")).unwrap();
        let (log, incident) = ("out/logs/robot.log", "out/incident-of-mine.mcap");
        for name in [log, incident] {
            std::fs::write(system.folder().join(name), "mine").unwrap();
        }
        let run = ["run", "--lockstep", "--quiet", "--out", "out", "free", "--set", "goal.x_m=2"];
        assert_refused(&system.run(&run), &["out/logs/robot.log", "is no log of a run", "--out"]);
        for name in [log, incident] {
            assert_eq!(std::fs::read_to_string(system.folder().join(name)).unwrap(), "mine");
        }
        system.assert_nothing_left();
        std::fs::remove_file(system.folder().join(log)).unwrap();
        for _ in 0..2 {
            let drive = system.run(&run);
            assert_eq!(drive.status.code(), Some(0), "{}", text(&drive));
        }
    });
}
