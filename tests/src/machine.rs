//! How late the machine itself was while a test ran, and tests whose verdict does not depend on it.
//!
//! Tests in real time share the processors with other tests and with whatever else runs. A thread that only sleeps
//! shows how late the machine wakes its threads. A scan that was lost while that was long says nothing of the program.
//! What can't be judged beside the other tests is judged alone.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::turns::{Alone, Turn};

/// Pause between two samples of the lateness.
const PAUSE: Duration = Duration::from_millis(2);
/// A machine that wakes a thread later than this may cost a system a scan: five processes answer one after the other
/// within 100 ms, with the links of two hosts ten within 50 ms, and each of them may be as late.
const LATE: Duration = Duration::from_millis(4);
/// A test is tried this often at most, so that a program that fails on a late machine only fails here too.
const TRIES: u32 = 6;
/// So many of the tries share the machine with other tests; the later ones are alone.
const TRIES_BESIDE_OTHERS: u32 = 2;
/// No new try begins when those before took this long.
const LIMIT: Duration = Duration::from_secs(240);

/// Runs a test, and once more when it failed while the machine was late: beside the other tests, then alone. The last try
/// counts whatever the machine does.
///
/// # Panics
/// As the test, when the machine was in time or in the last try.
pub fn repeat_when_late(test: impl Fn()) {
    let mut spent = Duration::ZERO;
    for number in 1.. {
        let is_alone = number > TRIES_BESIDE_OTHERS;
        let _turn = (!is_alone).then(Turn::begin);
        let _alone = is_alone.then(Alone::begin);
        let started = Instant::now();
        let sampler = Sampler::start();
        let result = catch_unwind(AssertUnwindSafe(&test));
        let late = sampler.end();
        let Err(panic) = result else { return };
        spent += started.elapsed();
        if late < LATE || number == TRIES || spent > LIMIT {
            eprintln!("the machine woke a thread up to {late:?} late in try {number}");
            resume_unwind(panic);
        }
        eprintln!("try {number} does not count: the machine woke a thread {late:?} late");
    }
}

/// A thread that measures how late it is woken.
struct Sampler {
    is_over: Arc<AtomicBool>,
    thread: JoinHandle<Duration>,
}

impl Sampler {
    fn start() -> Self {
        let is_over = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&is_over);
        let thread = std::thread::spawn(move || {
            let mut late = Duration::ZERO;
            while !seen.load(Ordering::Relaxed) {
                let begin = Instant::now();
                std::thread::park_timeout(PAUSE);
                late = late.max(begin.elapsed().saturating_sub(PAUSE));
            }
            late
        });
        Self { is_over, thread }
    }

    /// The longest time by which a wake-up was late.
    fn end(self) -> Duration {
        self.is_over.store(true, Ordering::Relaxed);
        self.thread.join().unwrap_or_default()
    }
}

/// What a process and its children wait for, for the message of a test that waits for their end: each thread with its
/// name, the kernel function and the system call that it is in, and all its callers where a debugger is installed.
pub fn waits_of(pid: u32) -> String {
    let read = |path: String| std::fs::read_to_string(path).unwrap_or_default();
    let mut text = format!("process {pid}: {}\n", read(format!("/proc/{pid}/cmdline")).replace('\0', " "));
    let mut children: Vec<u32> = Vec::new();
    for thread in std::fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten() {
        let path = thread.path().display().to_string();
        let part = |name: &str| read(format!("{path}/{name}")).trim_end().to_owned();
        text += &format!("  {} in {}: {}\n", part("comm"), part("wchan"), part("syscall"));
        children.extend(part("children").split_whitespace().filter_map(|child| child.parse::<u32>().ok()));
    }
    let mut debugger = std::process::Command::new("gdb");
    debugger.args(["-batch", "-ex", "thread apply all backtrace", "-p", &pid.to_string()]);
    if let Ok(output) = debugger.stdin(std::process::Stdio::null()).output() {
        text += &String::from_utf8_lossy(&output.stdout);
    }
    children.into_iter().fold(text, |text, child: u32| text + &waits_of(child))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    #[test]
    fn a_failure_of_a_machine_in_time_is_not_repeated_and_the_last_try_counts() {
        let tries = Cell::new(0);
        let failed = catch_unwind(AssertUnwindSafe(|| {
            repeat_when_late(|| {
                tries.set(tries.get() + 1);
                panic!("always");
            });
        }));
        assert!(failed.is_err());
        assert!((1..=TRIES).contains(&tries.get()), "{} tries", tries.get());
    }

    #[test]
    fn what_holds_is_tried_once() {
        let tries = Cell::new(0);
        repeat_when_late(|| tries.set(tries.get() + 1));
        assert_eq!(tries.get(), 1);
    }

    #[test]
    fn waits_name_each_thread() {
        let mut child = std::process::Command::new("sleep").arg("60").spawn().expect("a child");
        let since = std::time::Instant::now();
        let text = loop {
            let text = waits_of(child.id());
            // Until it is the program, it has another name.
            if text.contains("sleep 60") || since.elapsed() > Duration::from_secs(10) {
                break text;
            }
        };
        child.kill().and_then(|()| child.wait()).expect("the child ends");
        assert!(text.contains("sleep 60") && text.contains("sleep in "), "{text}");
    }
}
