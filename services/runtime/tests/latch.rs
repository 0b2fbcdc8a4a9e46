//! A signal and a panic latch the stop word of an orchestrator whose loop does not hear of them.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use runtime::{Shutdown, StopWord, latch_on_crash};
use rustix::process::{Pid, Signal, kill_process};

/// Tells the program of these tests that it is the orchestrator, and what it does after its first line of input.
const MODE: &str = "SCANLOOP_TEST_OF_LATCH";
const DEADLINE: Duration = Duration::from_secs(20);

/// An orchestrator whose loop hangs, or panics once its input ends.
#[test]
fn orchestrator() {
    let Ok(mode) = std::env::var(MODE) else { return };
    let word = StopWord::create("abcdefghij", 100_000_000).unwrap();
    let shutdown = Shutdown::of_orchestrator().unwrap();
    shutdown.latch_also(&word).unwrap();
    latch_on_crash(&word);
    println!("\nword {}", word.descriptor());
    let mut rest = String::new();
    std::io::stdin().read_to_string(&mut rest).unwrap();
    assert!(mode != "panic", "as asked for");
    std::process::exit(0);
}

/// Starts one; returns its stop word too.
fn start(mode: &str) -> (Child, StopWord) {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "orchestrator", "--nocapture"]).env(MODE, mode);
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let descriptor =
        lines.find_map(|line| line.unwrap().strip_prefix("word ").map(ToOwned::to_owned)).unwrap();
    let word = StopWord::open(format!("/proc/{}/fd/{descriptor}", child.id()).as_ref()).unwrap();
    assert!(word.is_armed());
    // What it prints later has a reader.
    std::thread::spawn(move || lines.count());
    (child, word)
}

fn wait_until_latched(word: &StopWord) {
    let deadline = Instant::now() + DEADLINE;
    while word.is_armed() {
        assert!(Instant::now() < deadline, "the stop was not latched");
        std::thread::park_timeout(Duration::from_millis(1));
    }
}

/// Lets it continue; returns its exit status and its output.
fn end(mut child: Child) -> (ExitStatus, String) {
    drop(child.stdin.take());
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    (child.wait().unwrap(), said)
}

#[test]
fn each_signal_that_ends_a_run_stops_it_while_its_loop_hangs() {
    // Under `nohup` a hang-up is ignored, by who is started there as well.
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap();
    let ignored = u64::from_str_radix(ignored.trim(), 16).unwrap();
    let signals = [Signal::INT, Signal::TERM, Signal::QUIT, Signal::HUP];
    for signal in signals.into_iter().filter(|signal| ignored & (1 << (signal.as_raw() - 1)) == 0) {
        let (child, word) = start("hang");
        kill_process(Pid::from_child(&child), signal).unwrap();
        wait_until_latched(&word);
        assert_eq!(end(child).0.code(), Some(0), "{signal:?} only asks");
    }
}

#[test]
fn a_panic_stops_the_run_and_says_so() {
    let (child, word) = start("panic");
    let (status, said) = end(child);
    assert!(!word.is_armed() && !status.success());
    assert!(said.contains("as asked for") && said.contains("wheels are blocked"), "{said}");
}
