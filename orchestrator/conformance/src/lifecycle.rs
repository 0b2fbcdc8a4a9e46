//! From start to end: what every process must do to be started, monitored, restarted and ended.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, getpgid, kill_process_group};
use shared_types::{Phase, ProcessState, Role};
use supervision::supervisor::ProcessExit;

use super::case::{Play, Trouble, Verdict, failed, observed, require};
use super::suite::{Setup, Suite};
use super::test_bench::{ANSWER_NS, TestBench};

/// Time between the request to end and the kill, the default of `grace_ms` in a system file [ms].
const GRACE_MS: u64 = 1000;
/// How long a process may run without directives in the case about it [ns].
const ORPHAN_NS: u64 = 1_000_000_000;
/// How long a process is suspended [s].
const PAUSE_S: f64 = 1.0;
/// Half of the heartbeats that a process without input publishes in two seconds.
const BEATS: usize = 10;

/// The cases of all roles.
pub(crate) const CASES: [(&str, Play); 8] = [
    ("states", states),
    ("heartbeats", heartbeats),
    ("joins-late", joins_late),
    ("pause", pause),
    ("ends-on-request", ends_on_request),
    ("ends-as-orphan", ends_as_orphan),
    ("survives-a-new-orchestrator", survives_a_new_orchestrator),
    ("leaves-nothing", leaves_nothing),
];

fn states(suite: &Suite) -> Verdict {
    let mut bench = suite.bench(Setup::default())?;
    bench.spawn(false, None)?;
    bench.attach()?;
    // Enough time for it to pass the barrier too early.
    bench.receive_for(2.0)?;
    let early = bench.heartbeats.iter().find(|beat| beat.state != ProcessState::Attached.wire());
    require(early.is_none(), || "it reported more than `attached` in the phase `starting`".to_owned())?;
    bench.announce(Phase::Connecting)?;
    bench.wait_for_state(ProcessState::Connected)?;
    bench.receive_for(1.0)?;
    require(bench.received.is_empty(), || {
        format!("it published {} samples before the phase `driving`", bench.received.len())
    })?;
    let ready =
        |bench: &TestBench<'_>| bench.heartbeats.iter().any(|beat| beat.state == ProcessState::Ready.wire());
    require(!ready(&bench), || "it reported `ready` before its first output".to_owned())?;
    bench.announce(Phase::Driving)?;
    bench.round()?;
    if !bench.until(ANSWER_NS, ready)? {
        return failed("it did not report `ready` after its first output");
    }
    require(bench.heartbeats.is_sorted_by_key(|beat| beat.state), || "its state went back".to_owned())?;
    let pid = bench.child.as_ref().map_or(0, |child| child.pid());
    for beat in &bench.heartbeats {
        require(beat.role == suite.role.wire(), || {
            format!("role {} in the heartbeat instead of {}", beat.role, suite.role.wire())
        })?;
        let theirs = i32::try_from(beat.pid).ok().and_then(Pid::from_raw);
        let group =
            theirs.and_then(|pid| getpgid(Some(pid)).ok()).map_or(0, |group| group.as_raw_nonzero().get());
        require(u32::try_from(group) == Ok(pid), || {
            format!("process id {} in the heartbeat is none of process {pid} and its children", beat.pid)
        })?;
    }
    Ok(format!("{} heartbeats, states in order", bench.heartbeats.len()))
}

fn heartbeats(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    bench.round()?;
    bench.heartbeats.clear();
    bench.until(2 * BEATS as u64 * 100_000_000, |bench| bench.heartbeats.len() >= BEATS)?;
    let beats = &bench.heartbeats;
    let count = beats.len();
    require(count >= BEATS, || format!("{count} heartbeats in 2 s without input, the minimum is {BEATS}"))?;
    for pair in beats.windows(2) {
        let [before, after] = pair else { continue };
        require(after.activations > before.activations, || {
            format!(
                "activations stay at {}, states {} and {}, {} us apart",
                before.activations,
                before.state,
                after.state,
                after.issued_ns.saturating_sub(before.issued_ns) / 1000
            )
        })?;
        let (was, is) = (before.header.sequence, after.header.sequence);
        require(is == was + 1, || format!("sequence {is} after {was}"))?;
        require(after.issued_ns > before.issued_ns, || "the time of issue decreases".to_owned())?;
    }
    Ok(format!("{count} heartbeats without input"))
}

fn joins_late(suite: &Suite) -> Verdict {
    let mut bench = suite.started_at(30)?;
    bench.rounds(3)?;
    bench.replace(false, None)?;
    if suite.role == Role::Robot {
        // A restarted robot begins with scan 1 again.
        bench.scan_id = 1;
    } else {
        bench.begin();
    }
    let first = bench.scan_id;
    bench.rounds(5)?;
    Ok(format!("took part from scan {first} on"))
}

fn pause(suite: &Suite) -> Verdict {
    let mut bench = suite.started_at(30)?;
    let answers = bench.rounds(5)?;
    observed(answers.iter().any(|answer| !answer.message.is_harmless()), || {
        "it does not drive before the pause either".to_owned()
    })?;
    let periods = (PAUSE_S * 1e9 / suite.period_ns as f64) as usize;
    send(&bench, Signal::STOP)?;
    if suite.role == Role::Robot {
        bench.receive_for(periods as f64)?;
    } else {
        for _ in 0..periods {
            bench.ask()?;
        }
    }
    bench.turn()?;
    let before = bench.received.len();
    send(&bench, Signal::CONT)?;
    bench.rounds(5)?;
    let limit_ns = 4 * suite.period_ns;
    let mut oldest_ns = 0;
    for received in &bench.received[before..] {
        let header = received.message.header();
        let age_ns = header.stage(suite.role).published_ns.saturating_sub(header.acquired_ns);
        if !received.message.is_harmless() {
            oldest_ns = oldest_ns.max(age_ns);
            require(age_ns <= limit_ns, || {
                format!("a sample of scan {} was {:.2} s old", header.scan_id, age_ns as f64 * 1e-9)
            })?;
        }
    }
    let (oldest_ms, limit_ms) = (oldest_ns as f64 * 1e-6, limit_ns / 1_000_000);
    Ok(format!("oldest scan in a sample: {oldest_ms:.0} ms; {limit_ms} are allowed"))
}

fn ends_on_request(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    bench.rounds(3)?;
    bench.may_end = true;
    let took = end(&mut bench)?;
    Ok(format!("ended after {} ms", took.as_millis()))
}

/// Asks the candidate to end and waits for it.
pub(crate) fn end(bench: &mut TestBench<'_>) -> Result<Duration, Trouble> {
    if let Some(child) = &bench.child {
        child.terminate()?;
    }
    match wait_for_exit(bench, Duration::from_millis(GRACE_MS))? {
        Some((ProcessExit::Code(_), took)) => Ok(took),
        Some((other, _)) => failed(format!("it did not end by itself: {other}{}", bench.last_lines())),
        None => failed(format!("it still ran {GRACE_MS} ms after SIGTERM")),
    }
}

/// Waits until the candidate has ended; returns how and when.
fn wait_for_exit(
    bench: &mut TestBench<'_>,
    limit: Duration,
) -> Result<Option<(ProcessExit, Duration)>, Trouble> {
    let started = Instant::now();
    while started.elapsed() <= limit {
        bench.turn()?;
        if let Some(exit) = bench.exit()? {
            let took = started.elapsed();
            // Its last message may be on its way.
            bench.turn()?;
            return Ok(Some((exit, took)));
        }
        runtime::wait_for(&[], 1_000_000);
    }
    Ok(None)
}

fn ends_as_orphan(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { orphan_ns: ORPHAN_NS, ..Setup::default() })?;
    bench.rounds(3)?;
    bench.withholds_directives = true;
    bench.may_end = true;
    let limit = Duration::from_nanos(ORPHAN_NS + ANSWER_NS);
    let Some((_, took)) = wait_for_exit(&mut bench, limit)? else {
        return failed(format!("it still ran {} s after the last directive", limit.as_secs()));
    };
    // The last directive is at most a tenth of a second old when they are withheld.
    let (took_ms, set_ms) = (took.as_millis(), u128::from(ORPHAN_NS / 1_000_000));
    require(took_ms >= set_ms - 300, || format!("it ended {took_ms} ms after the last directive"))?;
    Ok(format!("ended {took_ms} ms after the last directive; {set_ms} ms were set"))
}

fn survives_a_new_orchestrator(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { orphan_ns: 10 * ORPHAN_NS, ..Setup::default() })?;
    bench.rounds(3)?;
    bench.withholds_directives = true;
    bench.rounds(5)?;
    bench.withholds_directives = false;
    bench.renew_publisher()?;
    bench.rounds(5)?;
    Ok("13 scans, 5 of them without an orchestrator".to_owned())
}

fn leaves_nothing(suite: &Suite) -> Verdict {
    let mut bench = suite.bench(Setup::default())?;
    let before = shared_memory(&bench)?;
    bench.start()?;
    bench.rounds(3)?;
    let group = bench.child.as_ref().and_then(|child| Pid::from_raw(child.pid().cast_signed()));
    bench.kill();
    let started = Instant::now();
    let left = loop {
        // A publisher releases its end of a dead connection when it publishes again.
        for topic in suite.role.reads() {
            let mut message = bench.message(*topic, bench.scan_id)?;
            bench.publish(&mut message)?;
        }
        bench.bus.clean_up_dead_processes();
        bench.receive_for(0.2)?;
        let left: Vec<_> = shared_memory(&bench)?.difference(&before).cloned().collect();
        if left.is_empty() || started.elapsed() > Duration::from_nanos(ANSWER_NS / 2) {
            break left;
        }
    };
    require(left.is_empty(), || format!("{} files left in shared memory: {}", left.len(), left.join(", ")))?;
    let alive = group.is_some_and(|group| rustix::process::test_kill_process_group(group).is_ok());
    require(!alive, || "processes of its group are left".to_owned())?;
    Ok("nothing left".to_owned())
}

fn send(bench: &TestBench<'_>, signal: Signal) -> Result<(), Trouble> {
    let group = bench.child.as_ref().and_then(|child| Pid::from_raw(child.pid().cast_signed()));
    if let Some(group) = group {
        kill_process_group(group, signal).map_err(std::io::Error::from)?;
    }
    Ok(())
}

/// Names of all files that the system has in shared memory, those in the directory of its bus included.
fn shared_memory(bench: &TestBench<'_>) -> Result<BTreeSet<String>, Trouble> {
    let mut names = BTreeSet::new();
    let mut directories = vec![bench.domain.bus_directory()];
    while let Some(directory) = directories.pop() {
        // A directory may be gone, because it was just removed.
        for entry in std::fs::read_dir(directory).into_iter().flatten().flatten() {
            let path = entry.path();
            names.insert(path.display().to_string());
            if path.is_dir() {
                directories.push(path);
            }
        }
    }
    let files = std::fs::read_dir("/dev/shm")?.flatten();
    let files = files.map(|entry| entry.file_name().to_string_lossy().into_owned());
    names.extend(files.filter(|name| name.starts_with(bench.domain.shared_memory_prefix())));
    Ok(names)
}
