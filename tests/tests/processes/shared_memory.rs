//! Shared memory or the directory of the system full: an error with what is missing, never a signal, and the robot
//! drives.
//!
//! Each test has file systems of its own in a mount namespace of its own, for which it starts itself again.

use scanloop_tests::machine::repeat_when_late;
use std::fs::{File, OpenOptions};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};

use handover::swap::{Certificate, SwapOutcome};
use rustix::fs::{FallocateFlags, fallocate, statvfs};
use rustix::process::Signal;
use scanloop_tests::swaps::{assert_reached, assert_seamless, begin, certificate, rows, swap};
use scanloop_tests::{SHORT_CORRIDOR, SHORTENED_LONG, TestSystem, namespace};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const SHARED_MEMORY: &str = "/dev/shm";
/// Fits one system with its reserve, and not two.
const ROOMY: &str = "64m";

/// Whether the test runs with file systems of its own, of these sizes at these places; else it is started there.
fn is_inside(test: &str, mounts: &[(&str, &Path)]) -> bool {
    let mount = |(size, place): &(&str, &Path)| {
        let place = place.display();
        format!("mkdir -p '{place}' && mount -t tmpfs -o mode=0700,size={size} tmpfs '{place}' &&")
    };
    let script = mounts.iter().map(mount).collect::<String>();
    namespace::is_inside(&format!("{}::{test}", module_path!()), &script, |command| {
        command.envs(mounts.iter().filter(|(_, place)| *place != Path::new(SHARED_MEMORY)).map(runtime_dir));
    })
}

/// The place of systems, on a file system of the test's own.
fn runtime_dir(mount: &(&str, &Path)) -> (&'static str, PathBuf) {
    (runtime::RUNTIME_DIR_VARIABLE, mount.1.to_path_buf())
}

/// A file that takes all but so many bytes of a file system until it is dropped.
struct Ballast(PathBuf);

impl Ballast {
    fn leave(free: u64, place: &Path) -> Self {
        let path = place.join(format!("ballast{free}"));
        let file = OpenOptions::new().create_new(true).write(true).open(&path).expect("a new file");
        let there = free_bytes(place);
        if let Some(bytes) = there.checked_sub(free).filter(|bytes| *bytes > 0) {
            fallocate(&file, FallocateFlags::empty(), 0, bytes).expect("the bytes are free");
        }
        Self(path)
    }
}

impl Drop for Ballast {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn free_bytes(place: &Path) -> u64 {
    let status = statvfs(place).expect("a file system");
    status.f_bavail * status.f_frsize
}

/// The sum in a message that ends with `N KiB are missing`.
fn missing_kib(text: &str) -> u64 {
    let parts: Vec<&str> = text.split_whitespace().collect();
    let end = parts.windows(4).rposition(|parts| parts[1..] == ["KiB", "are", "missing"]);
    let end = end
        .or_else(|| parts.windows(4).rposition(|parts| parts[1] == "KiB" && parts[3].starts_with("missing")));
    end.and_then(|index| parts[index].parse().ok()).unwrap_or_else(|| panic!("no sum in: {text}"))
}

fn swapped(system: &TestSystem) -> Certificate {
    let certificate = swap(system, &["controller", "--to", "nmpc"]);
    assert_eq!(certificate.outcome, SwapOutcome::Swapped, "{}", certificate.reason);
    assert_seamless(&certificate);
    certificate
}

fn refused(system: &TestSystem, reason: &str) -> Certificate {
    let old = rows(system, Role::Controller);
    let certificate = swap(system, &["controller", "--to", "nmpc"]);
    assert_eq!(certificate.outcome, SwapOutcome::Refused, "{certificate:?}");
    assert!(certificate.reason.contains(reason), "{}", certificate.reason);
    assert_eq!(rows(system, Role::Controller), old, "the old one drives on");
    assert_seamless(&certificate);
    certificate
}

/// That no process of the run was ended by SIGBUS.
fn assert_no_signal(system: &TestSystem) {
    assert!(!system.stderr().contains("signal 7"), "{}", system.stderr());
    let logs = std::fs::read_dir(system.folder().join("out/logs")).expect("logs").flatten();
    for log in logs {
        let text = std::fs::read_to_string(log.path()).expect("a log");
        assert!(!text.contains("SIGBUS"), "{}: {text}", log.path().display());
    }
}

fn reached(system: TestSystem, certificates: &[Certificate]) {
    assert_no_signal(&system);
    assert_reached(system, certificates);
}

/// Waits until the orchestrator holds its reserve, after which so much is free.
fn wait_for_reserve(system: &TestSystem, free: u64) {
    system.wait_until("the reserve is held", |_| free_bytes(Path::new(SHARED_MEMORY)) <= free);
}

#[test]
fn a_system_that_does_not_fit_is_refused_with_what_is_missing() {
    repeat_when_late(|| {
        for size in ["64k", "1m", "8m"] {
            if !is_inside(
                "a_system_that_does_not_fit_is_refused_with_what_is_missing",
                &[(size, SHARED_MEMORY.as_ref())],
            ) {
                continue;
            }
            let system = TestSystem::new(EXECUTABLE);
            let free_kib = free_bytes(SHARED_MEMORY.as_ref()) / 1024;
            for arguments in [["run", "--quiet", "corridor"], ["run", "--lockstep", "corridor"]] {
                let output = system.run(&arguments);
                let text = String::from_utf8_lossy(&output.stderr);
                assert_eq!((output.status.code(), output.status.signal()), (Some(4), None), "{text}");
                // Less the file that names the system.
                let told = [free_kib, free_kib - 4].map(|kib| format!("/dev/shm has {kib} KiB free"));
                assert!(told.iter().any(|told| text.contains(told)), "{text}");
                assert!((30_000..60_000).contains(&(missing_kib(&text) + free_kib)), "{text}");
                system.assert_nothing_left();
                assert_eq!(free_bytes(SHARED_MEMORY.as_ref()) / 1024, free_kib);
            }
            return;
        }
    });
}

#[test]
fn a_swap_finds_the_reserve_however_full_shared_memory_is() {
    repeat_when_late(|| {
        let place = Path::new(SHARED_MEMORY);
        if !is_inside("a_swap_finds_the_reserve_however_full_shared_memory_is", &[(ROOMY, place)]) {
            return;
        }
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["long"]);
        let held = free_bytes(place);
        let mut certificates = Vec::new();
        for free in [0, 4 << 10, 100 << 10, 1 << 20] {
            wait_for_reserve(&system, held);
            let ballast = Ballast::leave(free, place);
            certificates.push(swapped(&system));
            // The memory of the old process is free now: enough for the reserve.
            wait_for_reserve(&system, free + (1 << 20));
            drop(ballast);
        }
        assert!(!system.stderr().contains("no reserve"), "{}", system.stderr());
        reached(system, &certificates);
    });
}

#[test]
fn a_swap_without_room_is_refused_with_what_is_missing_and_the_robot_drives_on() {
    repeat_when_late(|| {
        let place = Path::new(SHARED_MEMORY);
        if !is_inside(
            "a_swap_without_room_is_refused_with_what_is_missing_and_the_robot_drives_on",
            &[(ROOMY, place)],
        ) {
            return;
        }
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORTENED_LONG);
        let mut certificates = Vec::new();
        // While a process starts, the reserve is free; this process takes nothing of it.
        let sleeper = begin(&system, &["controller", "--", "sleep", "60"]);
        system.wait_until("it starts", |system| rows(system, Role::Controller).len() == 2);
        let ballast = Ballast::leave(0, place);
        certificates.push(certificate(&sleeper.wait_with_output().unwrap()));
        system
            .wait_until("it warns", |system| system.stderr().contains("no reserve for a swap or a restart"));
        let refusal = refused(&system, "KiB are missing");
        assert!((2_000..20_000).contains(&missing_kib(&refusal.reason)), "{}", refusal.reason);
        certificates.push(refusal);
        // An observer would make the processes take memory that is not there.
        let observer = system.run(&["topic", "hz", "pose", "--duration", "1"]);
        let text = String::from_utf8_lossy(&observer.stderr);
        assert_eq!(observer.status.code(), Some(4), "{text}");
        assert!(missing_kib(&text) > 100, "{text}");
        drop(ballast);
        certificates.push(swapped(&system));
        reached(system, &certificates);
    });
}

#[test]
fn a_restart_after_a_death_finds_room_in_full_shared_memory() {
    repeat_when_late(|| {
        let place = Path::new(SHARED_MEMORY);
        if !is_inside("a_restart_after_a_death_finds_room_in_full_shared_memory", &[(ROOMY, place)]) {
            return;
        }
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_CORRIDOR);
        let _ballast = Ballast::leave(0, place);
        for role in [Role::Obstacles, Role::Controller] {
            let old = system.pid(role);
            system.signal(old, Signal::KILL);
            system.wait_until("it is there again", |system| {
                rows(system, role).first().is_some_and(|(pid, state)| *pid != old && state == "ready")
            });
        }
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        assert_no_signal(&system);
        assert!(system.report().processes.iter().all(|process| process.restarts <= 1), "{}", system.stderr());
        system.assert_nothing_left();
    });
}

#[test]
fn a_process_whose_memory_is_cut_off_reports_it_before_it_ends() {
    repeat_when_late(|| {
        let place = Path::new(SHARED_MEMORY);
        if !is_inside("a_process_whose_memory_is_cut_off_reports_it_before_it_ends", &[(ROOMY, place)]) {
            return;
        }
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["long"]);
        let doorbells = system.domain().bus_directory().join("doorbells.v2");
        File::options().write(true).open(doorbells).unwrap().set_len(0).unwrap();
        system.wait_until("a process says so", |system| {
            let log = |role: &Role| system.folder().join(format!("out/logs/{role}.log"));
            Role::ALL.iter().any(|role| {
                let text = std::fs::read_to_string(log(role)).unwrap_or_default();
                text.contains("shared memory ran out or was cut off (SIGBUS)")
            })
        });
    });
}

#[test]
fn a_swap_with_the_directory_of_the_system_full_is_refused_with_the_file() {
    repeat_when_late(|| {
        let test = "a_swap_with_the_directory_of_the_system_full_is_refused_with_the_file";
        // Any directory that is there on all machines; another one is mounted over it for this test alone.
        let place = Path::new("/mnt");
        if !is_inside(test, &[("1m", place)]) {
            return;
        }
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_CORRIDOR);
        let mut certificates = vec![];
        // Room for nothing, for a part of the state of the old one, and for that but not for the list of processes.
        for (free, name) in
            [(0, "controller.checkpoint"), (4 << 10, "controller.checkpoint"), (16 << 10, "processes")]
        {
            let ballast = Ballast::leave(free, place);
            let refusal = refused(&system, "No space left on device");
            let file = system.domain().directory().join(name);
            assert!(refusal.reason.contains(file.to_str().unwrap()), "{}", refusal.reason);
            certificates.push(refusal);
            drop(ballast);
        }
        certificates.push(swapped(&system));
        reached(system, &certificates);
    });
}
