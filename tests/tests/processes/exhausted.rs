//! Limits of the kernel: too small for a start, or reached while the robot drives. Each is named, and a system can be
//! asked and stopped whatever has run out.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::path::PathBuf;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Resource, Rlimit, prlimit};
use scanloop_tests::TestSystem;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&[output.stdout.as_slice(), &output.stderr].concat()).into_owned()
}

#[test]
fn a_limit_that_is_too_small_for_a_system_is_named_and_nothing_is_left() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        for (limit, named) in [
            ("-f 1024", "`ulimit -f 262144`"),
            ("-f 100000", "`ulimit -f 262144`"),
            ("-v 50000", "`ulimit -v 524288`"),
            ("-v 400000", "`ulimit -v 524288`"),
            ("-d 20000", "`ulimit -d 262144`"),
            ("-t 10", "`ulimit -t 900`"),
            ("-n 64", "`ulimit -n 256`"),
            ("-s 512", "`ulimit -s 1024`"),
        ] {
            for command in ["run --quiet --out out free", "adopt --quiet"] {
                let id = system.id();
                let script = format!("ulimit {limit} && exec {EXECUTABLE} --system-id {id} {command}");
                let mut shell = Command::new("bash");
                let refused = shell.args(["-c", &script]).current_dir(system.folder()).output().unwrap();
                assert_eq!(refused.status.code(), Some(4), "{limit} {command}: {}", text(&refused));
                assert!(text(&refused).contains(named), "{limit}: {}", text(&refused));
                assert_eq!(text(&refused).lines().count(), 1, "{limit}: {}", text(&refused));
                assert!(!system.folder().join("out").exists(), "{limit}");
                system.assert_nothing_left();
            }
        }
    });
}

#[test]
fn a_file_that_may_not_become_larger_is_an_error_and_no_signal() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        std::fs::create_dir(system.folder().join("bags")).unwrap();
        let recorded = system.run(&["run", "--lockstep", "--quiet", "--record=f.mcap", "free"]);
        assert_eq!(recorded.status.code(), Some(0), "{}", text(&recorded));
        let script = format!("ulimit -f 64 && exec {EXECUTABLE} recording cut f.mcap --to 5 --out g.mcap");
        let cut = Command::new("bash").args(["-c", &script]).current_dir(system.folder()).output().unwrap();
        assert!(matches!(cut.status.code(), Some(2 | 4)), "{:?} {}", cut.status, text(&cut));
        assert!(text(&cut).contains("File too large"), "{}", text(&cut));
        system.assert_nothing_left();
    });
}

/// What a running system answers to its commands while nothing more can be started: each answer names the limit.
fn assert_answers(system: &TestSystem, limit: &str) {
    let status = system.run(&["status"]);
    assert_eq!(status.status.code(), Some(0), "{}", text(&status));
    assert!(text(&status).contains("driving"), "{}", text(&status));
    for command in [&["restart", "controller"][..], &["swap", "controller", "--to", "nmpc"]] {
        let asked = Instant::now();
        let refused = system.run(command);
        assert_eq!(refused.status.code(), Some(1), "{command:?}: {}", text(&refused));
        assert!(text(&refused).contains(limit), "{command:?}: {}", text(&refused));
        assert!(asked.elapsed() < Duration::from_secs(10), "{command:?}: {:?}", asked.elapsed());
    }
    // Several at once: one is served after the other.
    let children: Vec<_> = (0..4)
        .map(|_| system.command(&["status", "--json"]).stdout(std::process::Stdio::null()).spawn().unwrap())
        .collect();
    assert!(children.into_iter().all(|mut child| child.wait().unwrap().success()));
    let stopped = system.run(&["stop"]);
    assert_eq!(stopped.status.code(), Some(0), "{}", text(&stopped));
}

#[test]
fn a_system_without_a_free_descriptor_is_asked_and_stopped() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--set", "timeout_s=600"]);
        let pid = system.orchestrator();
        let open = std::fs::read_dir(format!("/proc/{pid}/fd")).unwrap().count() as u64;
        let limit = Rlimit { current: Some(open), maximum: Some(open) };
        prlimit(Pid::from_raw(pid), Resource::Nofile, limit).unwrap();
        assert_answers(&system, &format!("at most {open} files may be open in a process: raise `ulimit -n`"));
        assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
        system.assert_nothing_left();
    });
}

/// A control group with as many processes and threads as it allows.
struct Full(PathBuf);

impl Full {
    /// `None` where the test may not make one.
    fn new(name: &str) -> Option<Self> {
        ["/sys/fs/cgroup/pids", "/sys/fs/cgroup"].into_iter().find_map(|root| {
            let folder = PathBuf::from(root).join(format!("scanloop-{name}"));
            std::fs::create_dir(&folder).ok()?;
            let made = Self(folder);
            made.0.join("pids.max").exists().then_some(made)
        })
    }
}

impl Drop for Full {
    fn drop(&mut self) {
        let until = Instant::now() + Duration::from_secs(5);
        // A group with processes can't be removed; those of the test are about to end.
        while std::fs::remove_dir(&self.0).is_err() && Instant::now() < until {
            scanloop_tests::pause();
        }
    }
}

#[test]
fn a_system_whose_control_group_allows_no_more_processes_is_asked_and_stopped() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let Some(group) = Full::new(system.id()) else {
            eprintln!(
                "skipped a_system_whose_control_group_allows_no_more_processes: no control group can be made"
            );
            return;
        };
        system.start(&["endless", "--set", "timeout_s=600"]);
        for pid in system.processes().into_iter().chain([system.orchestrator()]) {
            std::fs::write(group.0.join("cgroup.procs"), pid.to_string()).unwrap();
        }
        let current = std::fs::read_to_string(group.0.join("pids.current")).unwrap();
        std::fs::write(group.0.join("pids.max"), &current).unwrap();
        assert_answers(
            &system,
            &format!("allows {} processes and threads, and has as many: raise `pids.max`", current.trim()),
        );
        assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
        system.assert_nothing_left();
        drop(group);
    });
}

/// Runs a command of the executable in a control group that allows so many processes and threads.
fn run_in(group: &Full, most: u32, system: &TestSystem, arguments: &str) -> Output {
    std::fs::write(group.0.join("pids.max"), most.to_string()).unwrap();
    let (procs, id) = (group.0.join("cgroup.procs").display().to_string(), system.id());
    let script = format!("echo $$ > {procs} && exec {EXECUTABLE} --system-id {id} {arguments}");
    Command::new("sh").args(["-c", &script]).current_dir(system.folder()).output().unwrap()
}

#[test]
fn a_command_whose_control_group_allows_no_thread_names_the_limit() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let Some(group) = Full::new(system.id()) else {
            eprintln!("skipped a_command_whose_control_group_allows_no_thread: no control group can be made");
            return;
        };
        let recorded = system.run(&["run", "--lockstep", "--quiet", "--record=f.mcap", "free"]);
        assert_eq!(recorded.status.code(), Some(0), "{}", text(&recorded));
        for most in [1, 2] {
            for command in [
                "replay f.mcap",
                "bench latency --duration 1 --out latency",
                "conformance controller --to nmpc --only header",
            ] {
                let refused = run_in(&group, most, &system, command);
                // With two, a machine with one processor replays a drive.
                if command.starts_with("replay") && refused.status.success() && most == 2 {
                    continue;
                }
                assert_eq!(refused.status.code(), Some(4), "{most} {command}: {}", text(&refused));
                let named = format!("allows {most} processes and threads");
                assert!(text(&refused).contains(&named), "{command}: {}", text(&refused));
                assert!(!text(&refused).contains("ulimit -u"), "{command}: {}", text(&refused));
                assert!(!text(&refused).contains("panicked"), "{command}: {}", text(&refused));
            }
        }
        drop(group);
    });
}

#[test]
fn a_command_beside_a_running_system_names_the_limit_of_files_or_of_their_size() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--set", "timeout_s=600"]);
        let limited = |limit: &str, command: &str| {
            let script = format!("ulimit {limit} && exec {EXECUTABLE} --system-id {} {command}", system.id());
            Command::new("bash").args(["-c", &script]).current_dir(system.folder()).output().unwrap()
        };
        // A recorder gets some of its topics, and closes them again before it tells what it lacks.
        for (files, commands) in [
            (4, &["status", "stop", "topic hz scan --duration 1"][..]),
            (5, &["status", "stop", "topic hz scan --duration 1"][..]),
            (18, &["record x.mcap --duration 1"][..]),
            (48, &["record x.mcap --duration 1"][..]),
        ] {
            for command in commands {
                let refused = limited(&format!("-n {files}"), command);
                assert_eq!(refused.status.code(), Some(4), "{files} {command}: {}", text(&refused));
                let named = format!("at most {files} files may be open in a process: raise `ulimit -n`");
                assert!(text(&refused).contains(&named), "{command}: {}", text(&refused));
                for wrong in ["remove it", "move it", "not running"] {
                    assert!(!text(&refused).contains(wrong), "{command}: {}", text(&refused));
                }
            }
        }
        for command in ["topic hz scan --duration 1", "record x.mcap --duration 1"] {
            let refused = limited("-f 0", command);
            assert_eq!(refused.status.code(), Some(4), "{command}: {}", text(&refused));
            assert!(text(&refused).contains("raise `ulimit -f`"), "{command}: {}", text(&refused));
        }
        assert!(!system.folder().join("x.mcap").exists(), "a recording that was not begun has left a file");
        let stopped = system.run(&["stop"]);
        assert_eq!(stopped.status.code(), Some(0), "{}", text(&stopped));
        assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
        system.assert_nothing_left();
    });
}
