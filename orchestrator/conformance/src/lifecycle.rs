//! From start to end: what every process must do to be started, monitored, restarted and ended.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, getpgid, kill_process_group};
use shared_types::{Header, Heartbeat, Phase, ProcessState, Role};
use supervision::supervisor::ProcessExit;

use super::case::{Tried, Verdict, failed, observed, require};
use super::suite::{Setup, Suite};
use super::test_bench::{ANSWER_NS, TestBench};

/// Time between the request to end and the kill, the default of `grace_ms` in a system file [ms].
const GRACE_MS: u64 = 1000;
/// How long a process is suspended [s].
const PAUSE_S: f64 = 1.0;
/// Half of the heartbeats that a process without input publishes in two seconds.
const BEATS: usize = 10;

pub(crate) fn states(suite: &Suite) -> Verdict {
    let mut bench = suite.bench(Setup::default())?;
    bench.spawn(false, None)?;
    bench.attach()?;
    // Enough time for it to pass the barrier too early.
    bench.receive_for(2.0)?;
    let early = bench.heartbeats.iter().find(|beat| beat.state != ProcessState::Attached.wire());
    require(early.is_none(), || "it reported more than `attached` in the phase `starting`")?;
    bench.announce(Phase::Connecting)?;
    bench.wait_for_state(ProcessState::Connected)?;
    bench.receive_for(1.0)?;
    let early = bench.received.len();
    require(early == 0, || format!("it published {early} samples before the phase `driving`"))?;
    let ready =
        |bench: &TestBench<'_>| bench.heartbeats.iter().any(|beat| beat.state == ProcessState::Ready.wire());
    require(!ready(&bench), || "it reported `ready` before its first output")?;
    bench.announce(Phase::Driving)?;
    bench.round()?;
    require(bench.until(ANSWER_NS, ready)?, || "it did not report `ready` after its first output")?;
    require(bench.heartbeats.is_sorted_by_key(|beat| beat.state), || "its state went back")?;
    let group = group(&bench);
    for Heartbeat { role, pid, .. } in &bench.heartbeats {
        let expected = suite.role.wire();
        require(*role == expected, || format!("role {role} in the heartbeat instead of {expected}"))?;
        let theirs = i32::try_from(*pid).ok().and_then(Pid::from_raw);
        let its = Pid::as_raw(group);
        let other = || format!("process id {pid} in the heartbeat is none of process {its} and its children");
        require(theirs.and_then(|pid| getpgid(Some(pid)).ok()) == group, other)?;
    }
    Ok(format!("{} heartbeats, states in order", bench.heartbeats.len()))
}

pub(crate) fn heartbeats(bench: &mut TestBench<'_>) -> Verdict {
    bench.round()?;
    bench.heartbeats.clear();
    bench.until(2 * BEATS as u64 * 100_000_000, |bench| bench.heartbeats.len() >= BEATS)?;
    let beats = &bench.heartbeats;
    let count = beats.len();
    require(count >= BEATS, || format!("{count} heartbeats in 2 s without input, the minimum is {BEATS}"))?;
    for [before, after] in beats.array_windows() {
        let states = format!("states {} and {}", before.state, after.state);
        let apart_us = after.issued_ns.saturating_sub(before.issued_ns) / 1000;
        let stay = || format!("activations stay at {}, {states}, {apart_us} us apart", before.activations);
        require(after.activations > before.activations, stay)?;
        let (was, is) = (before.header.sequence, after.header.sequence);
        require(is == was + 1, || format!("sequence {is} after {was}"))?;
        require(after.issued_ns > before.issued_ns, || "the time of issue decreases")?;
    }
    Ok(format!("{count} heartbeats without input"))
}

pub(crate) fn joins_late(bench: &mut TestBench<'_>) -> Verdict {
    bench.rounds(3)?;
    bench.replace(false, None)?;
    let first = bench.scan_id;
    bench.rounds(5)?;
    Ok(format!("took part from scan {first} on"))
}

pub(crate) fn pause(bench: &mut TestBench<'_>) -> Verdict {
    let drives = bench.rounds(5)?.iter().any(|answer| !answer.is_harmless());
    observed(drives, || "it does not drive before the pause either")?;
    let periods = (PAUSE_S * 1e9 / bench.suite.period_ns as f64) as usize;
    send(bench, Signal::STOP)?;
    for _ in 0..periods {
        if bench.suite.role == Role::Robot { bench.receive_for(1.0)? } else { bench.ask().map(|_| ())? }
    }
    bench.turn()?;
    let before = bench.received.len();
    send(bench, Signal::CONT)?;
    bench.rounds(5)?;
    let limit_ns = 4 * bench.suite.period_ns;
    let mut oldest_ns = 0;
    for message in &bench.received[before..] {
        if !message.is_harmless() {
            let Header { scan_id, acquired_ns, .. } = message.header();
            let published_ns = message.header().stage(bench.suite.role).published_ns;
            let age_ns = published_ns.saturating_sub(*acquired_ns);
            oldest_ns = oldest_ns.max(age_ns);
            let age_s = age_ns as f64 * 1e-9;
            require(age_ns <= limit_ns, || format!("a sample of scan {scan_id} was {age_s:.2} s old"))?;
        }
    }
    let (oldest_ms, limit_ms) = (oldest_ns as f64 * 1e-6, limit_ns / 1_000_000);
    Ok(format!("oldest scan in a sample: {oldest_ms:.0} ms; {limit_ms} are allowed"))
}

pub(crate) fn ends_on_request(bench: &mut TestBench<'_>) -> Verdict {
    bench.rounds(3)?;
    bench.may_end = true;
    let took = end(bench)?;
    Ok(format!("ended after {} ms", took.as_millis()))
}

/// Asks the candidate to end and waits for it.
pub(crate) fn end(bench: &mut TestBench<'_>) -> Tried<Duration> {
    if let Some(child) = &bench.child {
        child.terminate()?;
    }
    match wait_for_exit(bench, Duration::from_millis(GRACE_MS))? {
        Some((ProcessExit::Code(_), took)) => Ok(took),
        Some((other, _)) => {
            failed(format!("it did not end by itself: {other}{}", bench.log.last_lines_suffix()))
        }
        None => failed(format!("it still ran {GRACE_MS} ms after SIGTERM")),
    }
}

/// Waits until the candidate has ended; returns how and when.
fn wait_for_exit(bench: &mut TestBench<'_>, limit: Duration) -> Tried<Option<(ProcessExit, Duration)>> {
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

pub(crate) fn ends_as_orphan(bench: &mut TestBench<'_>) -> Verdict {
    bench.rounds(3)?;
    bench.system.withholds_directives = true;
    bench.may_end = true;
    let orphan_ns = bench.setup.orphan_ns;
    let limit = Duration::from_nanos(orphan_ns + ANSWER_NS);
    let Some((_, took)) = wait_for_exit(bench, limit)? else {
        return failed(format!("it still ran {} s after the last directive", limit.as_secs()));
    };
    // The last directive is at most a tenth of a second old when they are withheld.
    let (took_ms, set_ms) = (took.as_millis(), u128::from(orphan_ns / 1_000_000));
    require(took_ms >= set_ms - 300, || format!("it ended {took_ms} ms after the last directive"))?;
    Ok(format!("ended {took_ms} ms after the last directive; {set_ms} ms were set"))
}

pub(crate) fn survives_a_new_orchestrator(bench: &mut TestBench<'_>) -> Verdict {
    bench.rounds(3)?;
    bench.system.withholds_directives = true;
    bench.rounds(5)?;
    bench.system.withholds_directives = false;
    bench.renew_publisher()?;
    bench.rounds(5)?;
    Ok("13 scans, 5 of them without an orchestrator".to_owned())
}

pub(crate) fn leaves_nothing(suite: &Suite) -> Verdict {
    let mut bench = suite.bench(Setup::default())?;
    let before = shared_memory(&bench)?;
    bench.start()?;
    bench.rounds(3)?;
    let group = group(&bench);
    bench.kill();
    let started = Instant::now();
    let left = loop {
        // A publisher releases its end of a dead connection when it publishes again.
        for topic in suite.role.reads() {
            let mut message = bench.message(*topic, bench.scan_id)?;
            bench.publish(&mut message)?;
        }
        bench.system.bus.clean_up_dead_processes();
        bench.receive_for(0.2)?;
        let left: Vec<_> = shared_memory(&bench)?.difference(&before).cloned().collect();
        if left.is_empty() || started.elapsed() > Duration::from_nanos(ANSWER_NS / 2) {
            break left;
        }
    };
    require(left.is_empty(), || format!("{} files left in shared memory: {}", left.len(), left.join(", ")))?;
    let alive = group.is_some_and(|group| rustix::process::test_kill_process_group(group).is_ok());
    require(!alive, || "processes of its group are left")?;
    Ok("nothing left".to_owned())
}

fn send(bench: &TestBench<'_>, signal: Signal) -> Tried {
    if let Some(group) = group(bench) {
        kill_process_group(group, signal).map_err(std::io::Error::from)?;
    }
    Ok(())
}

/// The process group of the candidate.
fn group(bench: &TestBench<'_>) -> Option<Pid> {
    bench.child.as_ref().and_then(|child| Pid::from_raw(child.pid().cast_signed()))
}

/// Names of all files that the system has in shared memory, those in the directory of its bus included.
fn shared_memory(bench: &TestBench<'_>) -> Tried<BTreeSet<String>> {
    let files = std::fs::read_dir("/dev/shm")?.flatten();
    let files = files.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let files = files.filter(|name| name.starts_with(bench.system.domain.shared_memory_prefix()));
    Ok(files.chain(paths_below(&bench.system.domain.bus_directory())).collect())
}

/// The paths of all files below a directory; there are none when it is gone, because it was just removed.
fn paths_below(directory: &Path) -> Vec<String> {
    let paths = std::fs::read_dir(directory).into_iter().flatten().flatten().map(|entry| entry.path());
    paths.flat_map(|path| [vec![path.display().to_string()], paths_below(&path)].concat()).collect()
}
