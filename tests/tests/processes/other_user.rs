//! Another local user: nothing that it plants, replaces or locks is executed, followed or able to stop a system.
//!
//! Each test has `/tmp`, `/dev/shm` and `/run/user` of its own in a mount namespace, and a real second user. Where
//! the test does not run as root, or may not mount, it prints what it skipped.

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions, Permissions};
use std::io::ErrorKind;
use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
use std::os::unix::net::{UnixListener, UnixStream};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use runtime::StopWord;
use rustix::fs::{FlockOperation, flock};
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::stranger::{
    HOME, PLACE, PLACE_OF_STRANGER, STRANGER, as_stranger, assert_refused, is_driving, kill, make_folder,
    of_stranger, shared_memory, system, text, tree,
};
use scanloop_tests::{SHORT_FREE, TestSystem, among_users, processes_of};
use shared_types::Role;

/// That a drive of root works.
fn assert_drives(system: &TestSystem) {
    let output = system.run(&["run", "--lockstep", "--quiet", "free"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
}

#[test]
fn a_directory_that_another_user_made_beforehand_is_refused_and_none_of_its_commands_runs() {
    repeat_when_late(|| {
        among_users!(
            "a_directory_that_another_user_made_beforehand_is_refused_and_none_of_its_commands_runs"
        );
        for mode in [0o755, 0o777] {
            let system = system();
            // A genuine run that could be adopted: the other user started it, killed its orchestrator, and moved the
            // directory here.
            let (ran_as, table) = (format!("{HOME}/ran_as_{mode}"), format!("{HOME}/system.toml"));
            let script = format!("id -u >> {ran_as}; exec sleep 60");
            let mut run = of_stranger(system.id(), &["run", "--quiet", "--system", &table]);
            let process = scanloop_tests::system_file(10, &[Role::Controller], "sh", &[])
                .replace(r#"["sh", "controller"]"#, &format!(r#"["sh", "-c", "{script}"]"#));
            as_stranger(|| std::fs::write(&table, process).unwrap());
            let mut run = run.spawn().unwrap();
            let theirs = Path::new(PLACE_OF_STRANGER).join(system.id());
            system.wait_until("his command runs", |_| {
                theirs.join("processes.toml").exists() && Path::new(&ran_as).exists()
            });
            run.kill().unwrap();
            run.wait().unwrap();
            let planted = Path::new(PLACE).join(system.id());
            as_stranger(|| {
                make_folder(PLACE, mode);
                std::fs::rename(&theirs, &planted).unwrap();
            });
            for arguments in [vec!["run", "--adopt-or-start", "--quiet"], vec!["run", "--quiet"]] {
                assert_refused(
                    &system.run(&arguments),
                    &[PLACE, "belongs to user 65534", "remove it", "SCANLOOP_RUNTIME_DIR"],
                );
            }
            for arguments in [["adopt", "--quiet"], ["status", "--json"]] {
                assert_refused(&system.run(&arguments), &[]);
            }
            assert_eq!(std::fs::read_to_string(&ran_as).unwrap(), "65534\n", "his command ran as root");
            kill(&system.processes());
            std::fs::remove_dir_all(PLACE).unwrap();
        }
    });
}

#[test]
fn a_link_in_the_place_of_the_directory_is_refused_and_its_target_stays() {
    repeat_when_late(|| {
        among_users!("a_link_in_the_place_of_the_directory_is_refused_and_its_target_stays");
        let system = system();
        let precious = Path::new("/tmp/tree").join(system.id()).join("precious");
        make_folder("/tmp/tree", 0o700);
        make_folder(precious.parent().unwrap(), 0o700);
        std::fs::write(&precious, "stays").unwrap();
        as_stranger(|| symlink("/tmp/tree", PLACE).unwrap());
        let parts = [PLACE, "is a symbolic link of user 65534", "remove it"];
        assert_refused(&system.run(&["run", "--lockstep", "--quiet", "free"]), &parts);
        assert_refused(&system.run(&["run", "--adopt-or-start", "--quiet", "free"]), &parts);
        assert_refused(&system.run(&["stop"]), &[]);
        assert_eq!(std::fs::read_to_string(&precious).unwrap(), "stays");
        assert_eq!(tree(Path::new("/tmp/tree")).len(), 3);
    });
}

#[test]
fn another_user_neither_reads_nor_plants_anything_in_the_directory_of_a_running_system() {
    repeat_when_late(|| {
        among_users!("another_user_neither_reads_nor_plants_anything_in_the_directory_of_a_running_system");
        let mut system = system();
        system.start(&["long"]);
        let folder = system.domain().directory().to_path_buf();
        let names: Vec<PathBuf> = tree(&folder);
        assert!(names.iter().any(|name| name.ends_with("control.sock")), "{names:?}");
        as_stranger(|| {
            let denied = |result: std::io::Result<()>| {
                assert_eq!(result.unwrap_err().kind(), ErrorKind::PermissionDenied);
            };
            for path in &names {
                denied(OpenOptions::new().read(true).open(path).map(drop));
                denied(OpenOptions::new().write(true).open(path).map(drop));
                denied(std::fs::rename(path, "/tmp/stolen"));
                denied(std::fs::remove_file(path));
            }
            denied(std::fs::read_dir(&folder).map(drop));
            denied(File::create(folder.join("planted")).map(drop));
            denied(symlink("/etc/passwd", folder.join("settings-controller.toml.tmp")));
            denied(std::fs::rename(PLACE, "/tmp/stolen"));
            denied(UnixStream::connect(folder.join("control.sock")).map(drop));
        });
        assert!(is_driving(&system));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn links_in_the_directory_are_not_written_through() {
    repeat_when_late(|| {
        among_users!("links_in_the_directory_are_not_written_through");
        let names = ["settings-controller.toml", "layouts.txt", "run.toml", "processes.toml", "lock"];
        let victim = Path::new("/tmp/victim");
        for names in [&names[..4], &names[4..]] {
            let system = system();
            make_folder(PLACE, 0o700);
            let folder = Path::new(PLACE).join(system.id());
            make_folder(&folder, 0o700);
            std::fs::write(victim, "untouched").unwrap();
            // What a run has left.
            std::fs::write(folder.join("run-id"), "deadrunaaa").unwrap();
            for name in names.iter().chain(&["control.sock", "controller.log"]) {
                symlink(victim, folder.join(name)).unwrap();
            }
            let output = system.run(&["run", "--lockstep", "--quiet", "free"]);
            let is_locked = names.contains(&"lock");
            assert_eq!(output.status.code() == Some(0), !is_locked, "{}", text(&output));
            assert!(!is_locked || text(&output).contains("/lock"), "{}", text(&output));
            assert_eq!(std::fs::read_to_string(victim).unwrap(), "untouched");
            let _ = std::fs::remove_dir_all(PLACE);
        }
        // A link is no mark of a run, wherever it leads.
        let system = system();
        make_folder(PLACE, 0o700);
        make_folder(Path::new(PLACE).join(system.id()), 0o700);
        std::fs::write(victim, "deadrunaaa").unwrap();
        symlink(victim, Path::new(PLACE).join(system.id()).join("run-id")).unwrap();
        assert_refused(&system.run(&["run", "--lockstep", "--quiet", "free"]), &["no directory of a system"]);
        assert_eq!(tree(Path::new(PLACE)).len(), 3);
    });
}

#[test]
fn a_socket_of_another_user_in_the_place_of_ours_receives_no_command() {
    repeat_when_late(|| {
        among_users!("a_socket_of_another_user_in_the_place_of_ours_receives_no_command");
        let mut system = system();
        system.start(&["long"]);
        make_folder(HOME, 0o777);
        let theirs = as_stranger(|| UnixListener::bind(Path::new(HOME).join("sock")).unwrap());
        theirs.set_nonblocking(true).unwrap();
        let socket = system.domain().directory().join("control.sock");
        std::fs::remove_file(&socket).unwrap();
        symlink(Path::new(HOME).join("sock"), &socket).unwrap();
        system.run(&["status"]);
        system.run(&["restart", "controller"]);
        while let Ok((mut connection, _)) = theirs.accept() {
            let received = std::io::read_to_string(&mut connection).unwrap_or_default();
            assert_eq!(received, "");
        }
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

/// Ends the processes of another user, also when the test fails.
struct Over<'a>(&'a AtomicBool);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Opens, renames and removes all files of buses as another user; returns the files and what succeeded.
fn grab(until: &AtomicBool) -> (BTreeSet<String>, BTreeSet<String>) {
    let (mut seen, mut achieved) = (BTreeSet::new(), BTreeSet::new());
    while !until.load(Ordering::Relaxed) {
        for name in shared_memory().filter(|name| name.starts_with("scanloop-")) {
            let path = Path::new("/dev/shm").join(&name);
            let tries = [
                ("written", OpenOptions::new().read(true).write(true).open(&path).map(drop)),
                ("read", std::fs::read(&path).map(drop)),
                ("listed", std::fs::read_dir(&path).map(drop)),
                ("renamed", std::fs::rename(&path, "/dev/shm/mine")),
                ("removed", std::fs::remove_file(&path)),
            ];
            let done = tries.into_iter().filter(|(_, result)| result.is_ok());
            achieved.extend(done.map(|(what, _)| format!("{what}: {name}")));
            seen.insert(name);
        }
    }
    (seen, achieved)
}

#[test]
fn no_file_of_the_bus_can_be_opened_by_another_user_while_a_run_starts_and_drives() {
    repeat_when_late(|| {
        among_users!("no_file_of_the_bus_can_be_opened_by_another_user_while_a_run_starts_and_drives");
        let system = system();
        let over = AtomicBool::new(false);
        let (seen, achieved) = std::thread::scope(|scope| {
            let other = scope.spawn(|| as_stranger(|| grab(&over)));
            let end = Over(&over);
            (0..3).for_each(|_| assert_drives(&system));
            drop(end);
            other.join().unwrap()
        });
        assert!(seen.len() > 100, "{seen:?}");
        // The segment that iceoryx2 makes writable for all users has a name that the run does not use, for milliseconds.
        let wrong: Vec<_> = achieved.iter().filter(|name| !name.contains("_seed")).collect();
        assert!(wrong.is_empty(), "{wrong:?}");
    });
}

/// Takes all names of files that an earlier run had, as soon as a run shows its id; returns how many.
fn squat(names: &[String], known: &str, until: &AtomicBool) -> usize {
    let mut taken = 0;
    while !until.load(Ordering::Relaxed) {
        let mut run =
            shared_memory().filter_map(|name| Some(name.strip_prefix("scanloop-")?.get(..10)?.to_owned()));
        let Some(run_id) = run.find(|run_id| run_id != known) else { continue };
        for name in names {
            let mut options = OpenOptions::new();
            let path = format!("/dev/shm/scanloop-{run_id}{name}");
            if options.write(true).create_new(true).open(&path).is_ok() {
                let _ = std::fs::set_permissions(&path, Permissions::from_mode(0o666));
                taken += 1;
            }
        }
    }
    taken
}

/// That no process of a system has a file of another user in its memory.
fn assert_maps_nothing_of_strangers(system: &TestSystem) {
    for pid in system.processes().into_iter().chain([system.orchestrator()]) {
        let maps = std::fs::read_to_string(format!("/proc/{pid}/maps")).unwrap_or_default();
        for path in maps.lines().filter_map(|line| line.find("/dev/shm/").map(|start| &line[start..])) {
            let owner = std::fs::metadata(path).map_or(0, |found| found.uid());
            assert_eq!(owner, 0, "{pid} uses {path}");
        }
    }
}

#[test]
fn names_that_another_user_takes_while_a_run_starts_are_never_used() {
    repeat_when_late(|| {
        among_users!("names_that_another_user_takes_while_a_run_starts_are_never_used");
        let mut first = system();
        first.start(&["long"]);
        let run_id = first.domain().run_id().to_owned();
        let names: Vec<String> = shared_memory()
            .filter_map(|name| Some(name.strip_prefix(&format!("scanloop-{run_id}"))?.to_owned()))
            .filter(|name| !name.is_empty())
            .collect();
        assert!(names.len() > 20, "{names:?}");
        // And the name that the run does not use itself.
        let seed = names.iter().find(|name| name.ends_with(".global_mgmt")).unwrap();
        let names: Vec<String> = [format!("_seed{seed}")].into_iter().chain(names.iter().cloned()).collect();
        let mut second = system();
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            let other = scope.spawn(|| as_stranger(|| squat(&names, &run_id, &over)));
            let end = Over(&over);
            second.launch(&["run", "--quiet", "--duration", "2", "--out", "out", "free"], &[]);
            second.wait_until("it drives, or the start failed", |second| {
                assert_maps_nothing_of_strangers(second);
                is_driving(second) || runtime::start_ticks(second.orchestrator().cast_unsigned()).is_none()
            });
            drop(end);
            assert!(other.join().unwrap() >= names.len(), "he was too slow");
        });
        // A drive over none of these files, or a start that fails with the reason; never a signal.
        assert_maps_nothing_of_strangers(&second);
        let status = second.wait();
        assert!(matches!(status.code(), Some(1 | 4 | 5)), "{status} {}", second.stderr());
        assert!(second.processes().is_empty() && is_driving(&first));
        assert_eq!(first.run(&["stop"]).status.code(), Some(0));
        first.wait();
    });
}

#[test]
fn locks_of_another_user_keep_the_owner_from_nothing() {
    repeat_when_late(|| {
        among_users!("locks_of_another_user_keep_the_owner_from_nothing");
        let mut system = system();
        system.start(&["long"]);
        // All that the other user can open: no file of the system, only the directories around it.
        let places = ["/tmp", "/dev/shm", PLACE];
        let all: Vec<PathBuf> = places.iter().flat_map(|place| tree(Path::new(place))).collect();
        let own = |path: &Path| path.starts_with(PLACE) || path.to_string_lossy().contains("/scanloop-");
        let locks: Vec<(PathBuf, File)> = as_stranger(|| {
            let opened = all.iter().filter_map(|path| Some((path.clone(), File::open(path).ok()?)));
            opened.filter(|(_, file)| flock(file, FlockOperation::NonBlockingLockExclusive).is_ok()).collect()
        });
        let locked: Vec<_> = locks.iter().map(|(path, _)| path.as_path()).collect();
        assert!(locked.contains(&Path::new("/tmp")) && locked.contains(&Path::new("/dev/shm")), "{locked:?}");
        let of_run: Vec<_> =
            locked.iter().filter(|path| own(path) && !path.starts_with(system.folder())).collect();
        assert!(of_run.is_empty(), "{of_run:?}");
        system.kill_orchestrator();
        system.adopt(&[]);
        system.kill_orchestrator();
        let stopped = system.run(&["stop"]);
        assert_eq!(stopped.status.code(), Some(0), "{}", text(&stopped));
        assert_drives(&system);
        system.assert_nothing_left();
    });
}

/// A run of the other user of a system of that id, which drives.
fn drive_of_stranger(system: &TestSystem, arguments: &[&str]) -> std::process::Child {
    let before = system.processes().len();
    let all = [&["run", "--quiet", "--out", "out"], arguments].concat();
    let child = of_stranger(system.id(), &all).spawn().expect("the executable runs");
    system.wait_until("his processes run", |system| system.processes().len() >= before + 5);
    system.wait_until("he drives", |system| {
        let status = of_stranger(system.id(), &["status", "--json"]).output().expect("the executable runs");
        String::from_utf8_lossy(&status.stdout).contains("\"driving\"")
    });
    child
}

#[test]
fn two_users_drive_systems_of_the_same_id_at_the_same_time() {
    repeat_when_late(|| {
        among_users!("two_users_drive_systems_of_the_same_id_at_the_same_time");
        let mut system = system();
        let mut other = drive_of_stranger(&system, &SHORT_FREE);
        system.start(&SHORT_FREE);
        assert!(system.wait().success(), "{}", system.stderr());
        assert!(other.wait().unwrap().success());
        assert!(system.report().processes.iter().all(|process| process.restarts == 0));
        system.assert_nothing_left();
        assert!(!Path::new(PLACE_OF_STRANGER).exists());
    });
}

#[test]
fn each_user_stops_his_own_system_and_root_one_of_another_user_when_he_names_him() {
    repeat_when_late(|| {
        among_users!("each_user_stops_his_own_system_and_root_one_of_another_user_when_he_names_him");
        let mut system = system();
        let mut other = drive_of_stranger(&system, &["long"]);
        system.start(&["long"]);
        let refused = of_stranger(system.id(), &["stop", "--uid", "0"]).output().unwrap();
        assert_refused(&refused, &["only root stops the systems of others"]);
        assert!(is_driving(&system));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        assert_eq!(system.wait().code(), Some(1));
        assert_eq!(system.report().outcome.to_string(), "interrupted");
        let status = of_stranger(system.id(), &["status", "--json"]).output().unwrap();
        assert!(String::from_utf8_lossy(&status.stdout).contains("\"driving\""), "his system drives on");
        let told = ["is that of user 65534", "SCANLOOP_RUNTIME_DIR=/tmp/scanloop-65534", "stop --uid 65534"];
        for arguments in [&["status"][..], &["stop"], &["restart", "controller"], &["adopt"], &["latency"]] {
            system.wait_until("root is told whose it is", |system| {
                let output = system.run(arguments);
                output.status.code() == Some(2) && told.iter().all(|part| text(&output).contains(part))
            });
        }
        let stopped = system.run(&["stop", "--uid", "65534"]);
        assert_eq!(stopped.status.code(), Some(0), "{}", text(&stopped));
        assert!(text(&stopped).contains("wheels blocked after"), "{}", text(&stopped));
        assert_eq!(other.wait().unwrap().code(), Some(1));
        system.assert_nothing_left();
        system.wait_until("nothing of his is left", |_| !Path::new(PLACE_OF_STRANGER).exists());
    });
}

#[test]
fn a_forged_stop_word_does_not_lead_root_to_one_of_its_own_processes() {
    repeat_when_late(|| {
        among_users!("a_forged_stop_word_does_not_lead_root_to_one_of_its_own_processes");
        let system = system();
        // The page claims that this test, a process of root, is the orchestrator of a run of the other user.
        let id = system.id();
        let mut his = as_stranger(|| {
            let stop_word = StopWord::create("forgedruna", 100_000_000).unwrap();
            stop_word.hand_down().unwrap();
            let mut sleep = std::process::Command::new("sleep");
            sleep.arg("60").uid(STRANGER).gid(STRANGER).env(runtime::SYSTEM_ID_VARIABLE, id);
            sleep.env(runtime::RUN_ID_VARIABLE, "forgedruna").env(runtime::INCARNATION_VARIABLE, "1");
            sleep.env(runtime::ROLE_VARIABLE, "robot").spawn().unwrap()
        });
        system.wait_until("it is his process", |system| system.processes().len() == 1);
        let stopped = system.run(&["stop", "--uid", "65534"]);
        assert!(text(&stopped).contains("and it has ended"), "{}", text(&stopped));
        assert!(his.wait().is_ok() && processes_of(system.id()).is_empty());
    });
}
