//! Real processes; each test waits for a condition with a deadline and leaves nothing behind.

use runtime::start_ticks;

use super::*;
use crate::child_log::tests::Scratch;

const LIMIT: Duration = Duration::from_secs(20);

fn shell(script: &str) -> Launch {
    Launch { command: vec!["sh".into(), "-c".into(), script.into()], ..Launch::default() }
}

fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let started = Instant::now();
    while !condition() {
        assert!(started.elapsed() < LIMIT, "{what} did not happen within {LIMIT:?}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// The first line of the output, once it is complete.
fn first_line(log: &ChildLog) -> String {
    let mut line = String::new();
    wait_until("a line of output", || {
        let text = std::fs::read_to_string(log.path()).unwrap();
        line = text.lines().next().unwrap_or_default().to_owned();
        text.contains('\n')
    });
    line
}

/// Whether a process runs; one that has ended but was not reaped does not.
fn runs(pid: u32) -> bool {
    start_ticks(pid).is_some()
}

#[test]
fn the_exit_code_and_the_output_come_back() {
    let scratch = Scratch::new();
    let log = scratch.log();
    let mut child = Child::spawn(&shell("echo out; echo err >&2; exit 2"), &log).unwrap();
    assert_eq!(child.wait_for(LIMIT).unwrap(), Some(ProcessExit::Code(2)));
    assert_eq!(child.try_wait().unwrap().unwrap().to_string(), "exit code 2");
    assert_eq!(log.last_lines(5).unwrap(), ["out", "err"]);
    assert_eq!(child.usage(), None);
    // The number may be another process's by now: signals must go nowhere.
    child.kill().unwrap();
    child.terminate().unwrap();
}

#[test]
fn a_file_that_is_no_program_is_named_for_what_it_is() {
    use std::os::unix::fs::PermissionsExt;

    let scratch = Scratch::new();
    let log = scratch.log();
    let file = scratch.0.join("stage");
    let refusal = |content: &[u8]| {
        std::fs::write(&file, content).unwrap();
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o700)).unwrap();
        let launch = Launch { command: vec![file.clone().into()], ..Launch::default() };
        loop {
            let error = Child::spawn(&launch, &log).unwrap_err().to_string();
            // Another test that forks meanwhile has the file open for writing until it executes its program.
            if !error.contains("Text file busy") {
                return error;
            }
        }
    };
    let own = std::fs::read("/proc/self/exe").unwrap();
    // Bytes 18 and 19 name the kind of processor.
    let foreign = [&own[..18], &[0xff, 0x7f], &own[20..64]].concat();
    for (content, expected) in [
        (&b"echo hello\n"[..], "line 1: a script must begin with `#!`"),
        (b"\xef\xbb\xbf#!/bin/sh\n", "it begins with a byte order mark"),
        (b"\xff\xfe#\0!\0", "it is a text in UTF-16"),
        (b"#!/bin/sh\r\necho\r\n", "line 1: it ends with CR LF"),
        (b"#!/no/such/sh\n", "line 1: there is no interpreter `/no/such/sh`"),
        (b"", "the file is empty"),
        (b"import scanloop  # Gr\xfc\xdfe\n", "line 1: a script must begin with `#!`"),
        (b"#!/etc/passwd\n", "line 1: the interpreter `/etc/passwd` is not executable"),
        (b"#!/usr/bin\n", "line 1: the interpreter `/usr/bin` is a directory"),
        (b"#!\necho\n", "line 1: no interpreter follows `#!`"),
        (b"\x7fELF\x02\x01", "it is a program of which a part is missing or damaged"),
        (&own[..64], "it is a program of which a part is missing or damaged"),
        (&foreign[..], "it is a program for another kind of processor"),
        (b"PK\x03\x04\x14\0", "it is a ZIP archive"),
    ] {
        let message = refusal(content);
        assert!(message.contains("stage` can't be executed: ") && message.contains(expected), "{message}");
    }
}

#[test]
fn environment_and_empty_input_are_as_asked() {
    let scratch = Scratch::new();
    let log = scratch.log();
    let launch = Launch {
        environment: vec![("SCANLOOP_TEST".into(), "a b".into())],
        ..shell("echo \"$SCANLOOP_TEST\"; wc -c")
    };
    let mut child = Child::spawn(&launch, &log).unwrap();
    assert_eq!(child.wait_for(LIMIT).unwrap(), Some(ProcessExit::Code(0)));
    let lines = log.last_lines(2).unwrap();
    assert_eq!((lines[0].as_str(), lines[1].trim()), ("a b", "0"));
}

#[test]
fn a_terminated_process_is_told_by_its_signal() {
    let scratch = Scratch::new();
    let log = scratch.log();
    let mut child = Child::spawn(&shell("echo up; exec sleep 1000"), &log).unwrap();
    assert_eq!(first_line(&log), "up");
    assert_eq!(child.try_wait().unwrap(), None);
    child.terminate().unwrap();
    assert_eq!(child.wait_for(LIMIT).unwrap().unwrap().to_string(), "killed by signal 15 (SIGTERM)");
}

#[test]
fn a_process_that_ignores_the_request_or_is_stopped_can_be_killed() {
    let scratch = Scratch::new();
    let log = scratch.log();
    let mut child = Child::spawn(&shell("trap '' TERM; echo up; kill -STOP $$; sleep 1000"), &log).unwrap();
    assert_eq!(first_line(&log), "up");
    child.terminate().unwrap();
    assert_eq!(child.wait_for(Duration::from_millis(50)).unwrap(), None);
    child.kill().unwrap();
    assert_eq!(child.wait_for(LIMIT).unwrap(), Some(ProcessExit::Signal(9)));
}

#[test]
fn a_signal_reaches_the_whole_group() {
    let scratch = Scratch::new();
    let log = scratch.log();
    let mut child = Child::spawn(&shell("sleep 1000 & echo $!; wait"), &log).unwrap();
    let grandchild: u32 = first_line(&log).parse().unwrap();
    assert!(runs(grandchild));
    child.kill().unwrap();
    assert_eq!(child.wait_for(LIMIT).unwrap(), Some(ProcessExit::Signal(9)));
    wait_until("the end of the grandchild", || !runs(grandchild));
}

#[test]
fn the_rest_of_a_group_does_not_outlive_its_leader() {
    let scratch = Scratch::new();
    let log = scratch.log();
    let mut child = Child::spawn(&shell("sleep 1000 & echo $!; exit 3"), &log).unwrap();
    let grandchild: u32 = first_line(&log).parse().unwrap();
    assert_eq!(child.wait_for(LIMIT).unwrap(), Some(ProcessExit::Code(3)));
    wait_until("the end of the grandchild", || !runs(grandchild));
}

#[test]
fn a_dropped_process_is_gone_with_its_group() {
    let scratch = Scratch::new();
    let log = scratch.log();
    let child = Child::spawn(&shell("sleep 1000 & echo $!; wait"), &log).unwrap();
    let (leader, grandchild) = (child.pid(), first_line(&log).parse().unwrap());
    drop(child);
    assert!(!std::path::Path::new(&format!("/proc/{leader}")).exists(), "it is reaped");
    wait_until("the end of the grandchild", || !runs(grandchild));
}

#[test]
fn the_pidfd_wakes_a_poll_at_the_end_of_the_process() {
    let scratch = Scratch::new();
    let log = scratch.log();
    let mut child = Child::spawn(&shell("echo up; exec sleep 1000"), &log).unwrap();
    let ready = |child: &Child, limit_s| {
        let limit = Timespec { tv_sec: limit_s, tv_nsec: 0 };
        poll(&mut [PollFd::new(child, PollFlags::IN)], Some(&limit)).unwrap()
    };
    assert_eq!(first_line(&log), "up");
    assert_eq!(ready(&child, 0), 0);
    child.kill().unwrap();
    assert_eq!(ready(&child, 20), 1);
    assert_eq!(
        child.try_wait().unwrap(),
        Some(ProcessExit::Signal(9)),
        "what the poll told can be read at once"
    );
}

#[test]
fn only_a_path_to_a_regular_file_is_read_before_it_is_executed() {
    use rustix::fs::{CWD, Mode, mkfifoat};

    let scratch = Scratch::new();
    let log = scratch.log();
    let pipe = scratch.0.join("pipe");
    mkfifoat(CWD, &pipe, Mode::RWXU).unwrap();
    let launch = Launch { command: vec![pipe.clone().into()], ..Launch::default() };
    let error = Child::spawn(&launch, &log).unwrap_err();
    assert!(matches!(error, ChildError::NotExecutable(_)), "{error}");
    require_script(&pipe).unwrap();
    // The tests run in the folder of the crate.
    assert!(Path::new("Cargo.toml").exists());
    require_script(Path::new("Cargo.toml")).unwrap();
    assert!(require_script(Path::new("./Cargo.toml")).is_err());
}

#[test]
fn a_command_that_cannot_run_is_named() {
    let scratch = Scratch::new();
    let log = scratch.log();
    let message = |launch: Launch| Child::spawn(&launch, &log).unwrap_err().to_string();
    let launch = |program: &str| Launch { command: vec![program.into()], ..Launch::default() };
    assert_eq!(message(launch("no-such-program-here")), "command `no-such-program-here` was not found");
    assert_eq!(message(Launch::default()), "the command is empty");
    let file = log.path().to_str().unwrap().to_owned();
    assert_eq!(message(launch(&file)), format!("command `{file}` may not be executed: permission denied"));
}

#[test]
fn the_use_of_processor_and_memory_is_measured() {
    let scratch = Scratch::new();
    let log = scratch.log();
    let child = Child::spawn(&shell("echo up; while :; do :; done"), &log).unwrap();
    assert_eq!(first_line(&log), "up");
    assert!(start_ticks(child.pid()) >= start_ticks(std::process::id()), "it is younger than this test");
    // Five ticks of 10 ms: enough to show that it is counted.
    wait_until("use of the processor", || child.usage().is_some_and(|usage| usage.cpu_s >= 0.05));
    // A shell takes between some hundred KiB and some MiB.
    assert!((100..100_000).contains(&child.usage().unwrap().memory_kib));
}

#[test]
fn a_process_that_writes_while_its_log_is_trimmed_keeps_its_file() {
    let scratch = Scratch::new();
    let log = scratch.log();
    let script = "i=0; while [ $i -lt 40000 ]; do echo \"line $i ........................................\"; \
                  i=$((i+1)); done; echo done";
    let mut child = Child::spawn(&shell(script), &log).unwrap();
    let mut trimmed = 0;
    while child.wait_for(Duration::from_millis(5)).unwrap().is_none() {
        trimmed += u32::from(log.trim().unwrap());
    }
    trimmed += u32::from(log.trim().unwrap());
    // 40,000 lines of about 52 bytes are 2 MB: at least one cut.
    assert!(trimmed >= 1, "never trimmed");
    assert_eq!(log.last_lines(1).unwrap(), ["done"]);
    let kept = std::fs::read(log.path()).unwrap();
    assert!(kept.len() as u64 <= crate::child_log::TRIM_ABOVE_BYTES + 100_000);
    assert!(!kept.contains(&0), "cutting leaves no hole");
    let numbers: Vec<u32> = String::from_utf8(kept)
        .unwrap()
        .lines()
        .filter_map(|line| line.strip_prefix("line ")?.split(' ').next()?.parse().ok())
        .collect();
    assert!(numbers.is_sorted(), "cutting keeps the order");
}
