//! From start to end: what any process of any role has to do to be started, watched, restarted and ended.

use std::time::Duration;

use rustix::process::{Pid, Signal, getpgid, kill_process_group};
use shared_types::{Phase, ProcessState, Role};

use super::case::{Case, LIVE, Level, Verdict, failed, require};
use super::suite::{Setup, Suite};
use super::test_bench::{ANSWER_NS, TestBench};

/// Time between the request to end and the kill, the default of `grace_ms` in a system file [ms].
const GRACE_MS: u64 = 1000;
/// How long a process without directives goes on in the case about it [ns].
const ORPHAN_NS: u64 = 1_000_000_000;
/// How long a process is stopped [s].
const PAUSE_S: f64 = 1.0;
/// A process with nothing to do says ten times a second that it lives; half of that is heard at least.
const BEATS: usize = 10;

/// The cases of all roles.
pub(crate) const CASES: [Case; 8] = [
    Case {
        name: "states",
        level: Level::Required,
        requirement: "It says `attached`, `connected` when the phase is `connecting`, and `ready` after its first \
                      output, in this order, with its role, incarnation and process id; it publishes nothing before \
                      the phase `driving`.",
        why: "Samples that are sent before all connections are made are lost without an error.",
        tries: LIVE,
        play: states,
    },
    Case {
        name: "heartbeats",
        level: Level::Required,
        requirement: "Without any input it publishes ten heartbeats a second, each with more activations than the one \
                      before.",
        why: "A process whose activations stand still is taken for hung and killed.",
        tries: LIVE,
        play: heartbeats,
    },
    Case {
        name: "joins-late",
        level: Level::Required,
        requirement: "Started while the loop runs, it connects by itself and takes part from the next scan on.",
        why: "This is how a process that died or was exchanged comes back.",
        tries: LIVE,
        play: joins_late,
    },
    Case {
        name: "pause",
        level: Level::Required,
        requirement: "Stopped for one second (SIGSTOP) and let go on, it takes part again with the scans that are \
                      there; what it says about scans older than three periods moves nothing.",
        why: "Old samples that look fresh drive the robot by where it was.",
        tries: LIVE,
        play: pause,
    },
    Case {
        name: "ends-on-request",
        level: Level::Required,
        requirement: "It ends by itself within one second after SIGTERM.",
        why: "After that time it is killed, and an actuator that is killed has no last word.",
        tries: LIVE,
        play: ends_on_request,
    },
    Case {
        name: "ends-as-orphan",
        level: Level::Required,
        requirement: "It ends by itself when there has been no directive for the time in the settings, and not before.",
        why: "No process may be left when nobody is there to end it.",
        tries: LIVE,
        play: ends_as_orphan,
    },
    Case {
        name: "survives-a-new-orchestrator",
        level: Level::Required,
        requirement: "A pause of directives shorter than that time, with another orchestrator after it, changes nothing.",
        why: "The loop drives on when its orchestrator dies, until another one takes it over.",
        tries: LIVE,
        play: survives_a_new_orchestrator,
    },
    Case {
        name: "leaves-nothing",
        level: Level::Required,
        requirement: "Killed (SIGKILL) in the middle of the drive, it leaves no process behind, and after the clean-up \
                      no file in shared memory.",
        why: "What is left adds up until the memory is full.",
        tries: LIVE,
        play: leaves_nothing,
    },
];

fn states(suite: &Suite) -> Verdict {
    let mut bench = suite.bench(Setup::default())?;
    bench.spawn(false, None)?;
    bench.attach()?;
    // Time enough to run ahead of the barrier.
    bench.receive_for(2.0)?;
    let early = bench.heartbeats.iter().find(|beat| beat.state != ProcessState::Attached.wire());
    require(early.is_none(), || "it said more than `attached` in the phase `starting`".to_owned())?;
    bench.announce(Phase::Connecting)?;
    bench.wait_for_state(ProcessState::Connected)?;
    bench.receive_for(1.0)?;
    require(bench.received.is_empty(), || {
        format!("it published {} samples before the phase `driving`", bench.received.len())
    })?;
    let ready =
        |bench: &TestBench<'_>| bench.heartbeats.iter().any(|beat| beat.state == ProcessState::Ready.wire());
    require(!ready(&bench), || "it said `ready` before its first output".to_owned())?;
    bench.announce(Phase::Driving)?;
    bench.round()?;
    if !bench.until(ANSWER_NS, ready)? {
        return failed("it did not say `ready` after its first output");
    }
    let backwards = bench.heartbeats.windows(2).find(|pair| pair[1].state < pair[0].state);
    require(backwards.is_none(), || "its state went back".to_owned())?;
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
    require(beats.len() >= BEATS, || {
        format!("{} heartbeats in 2 s without input, {BEATS} are the least", beats.len())
    })?;
    for pair in beats.windows(2) {
        require(pair[1].activations > pair[0].activations, || {
            let [(before, was_ns), (after, now_ns)] =
                [pair[0], pair[1]].map(|beat| (beat.state, beat.issued_ns));
            let apart_us = now_ns.saturating_sub(was_ns) / 1000;
            format!(
                "activations stand at {}, states {before} and {after}, {apart_us} us apart",
                pair[0].activations
            )
        })?;
        require(pair[1].header.sequence == pair[0].header.sequence + 1, || {
            format!("sequence {} after {}", pair[1].header.sequence, pair[0].header.sequence)
        })?;
        require(pair[1].issued_ns > pair[0].issued_ns, || "time of issue goes back".to_owned())?;
    }
    Ok(format!("{} heartbeats without input", beats.len()))
}

fn joins_late(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { first_scan: 30, ..Setup::default() })?;
    bench.rounds(3)?;
    bench.replace()?;
    bench.received.clear();
    bench.spawn(false, None)?;
    bench.wait_for_state(ProcessState::Connected)?;
    if suite.role == Role::Robot {
        // A robot that comes back begins with scan 1 again.
        bench.scan_id = 1;
    } else {
        bench.begin();
    }
    let first = bench.scan_id;
    bench.rounds(5)?;
    Ok(format!("took part from scan {first} on"))
}

fn pause(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { first_scan: 30, ..Setup::default() })?;
    bench.rounds(5)?;
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
                format!(
                    "it said something about scan {} that was {:.2} s old",
                    header.scan_id,
                    age_ns as f64 * 1e-9
                )
            })?;
        }
    }
    Ok(format!(
        "oldest scan it spoke of: {:.0} ms; {} are allowed",
        oldest_ns as f64 * 1e-6,
        limit_ns / 1_000_000
    ))
}

fn ends_on_request(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    bench.rounds(3)?;
    bench.may_end = true;
    let took = end(&mut bench)?;
    Ok(format!("ended after {} ms", took.as_millis()))
}

/// Asks the candidate to end and waits for it.
pub(crate) fn end(bench: &mut TestBench<'_>) -> Result<Duration, super::case::Trouble> {
    let started = std::time::Instant::now();
    if let Some(child) = &bench.child {
        child.terminate()?;
    }
    loop {
        bench.turn()?;
        if let Some(exit) = bench.exit()? {
            // What it said last may be on its way.
            bench.turn()?;
            return match exit {
                supervision::supervisor::Exit::Code(_) => Ok(started.elapsed()),
                other => failed(format!("it did not end by itself: {other}{}", bench.words())),
            };
        }
        if started.elapsed() > Duration::from_millis(GRACE_MS) {
            return failed(format!("it still ran {GRACE_MS} ms after SIGTERM"));
        }
        runtime::wait_for(&[], 1_000_000);
    }
}

fn ends_as_orphan(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { orphan_ns: ORPHAN_NS, ..Setup::default() })?;
    bench.rounds(3)?;
    bench.mute = true;
    bench.may_end = true;
    let started = std::time::Instant::now();
    while bench.exit()?.is_none() {
        bench.turn()?;
        if started.elapsed() > Duration::from_nanos(ORPHAN_NS + ANSWER_NS) {
            return failed(format!(
                "it still ran {} s after the last directive",
                started.elapsed().as_secs()
            ));
        }
        runtime::wait_for(&[], 5_000_000);
    }
    let took = started.elapsed();
    // The last directive is at most a tenth of a second old when the silence begins.
    let least = Duration::from_nanos(ORPHAN_NS - 300_000_000);
    require(took >= least, || format!("it ended {} ms after the last directive", took.as_millis()))?;
    Ok(format!(
        "ended {} ms after the last directive; {} ms were set",
        took.as_millis(),
        ORPHAN_NS / 1_000_000
    ))
}

fn survives_a_new_orchestrator(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { orphan_ns: 10 * ORPHAN_NS, ..Setup::default() })?;
    bench.rounds(3)?;
    bench.mute = true;
    bench.rounds(5)?;
    bench.mute = false;
    bench.renew_publisher()?;
    bench.rounds(5)?;
    Ok("13 scans, 5 of them without an orchestrator".to_owned())
}

fn leaves_nothing(suite: &Suite) -> Verdict {
    let mut bench = suite.bench(Setup::default())?;
    let before = bench.shared_memory()?;
    bench.start()?;
    bench.rounds(3)?;
    let group = bench.child.as_ref().and_then(|child| Pid::from_raw(child.pid().cast_signed()));
    bench.kill()?;
    let started = std::time::Instant::now();
    let left = loop {
        // Whoever spoke to it gives its end of a connection back when he speaks again.
        for topic in suite.role.reads() {
            let mut message = bench.message(*topic, bench.scan_id)?;
            bench.publish(&mut message)?;
        }
        bench.bus.clean_up_dead_processes();
        bench.receive_for(0.2)?;
        let left: Vec<_> = bench.shared_memory()?.difference(&before).cloned().collect();
        if left.is_empty() || started.elapsed() > Duration::from_nanos(ANSWER_NS / 2) {
            break left;
        }
    };
    require(left.is_empty(), || format!("{} files left in shared memory: {}", left.len(), left.join(", ")))?;
    let alive = group.is_some_and(|group| rustix::process::test_kill_process_group(group).is_ok());
    require(!alive, || "processes of its group are left".to_owned())?;
    Ok("nothing left".to_owned())
}

fn send(bench: &TestBench<'_>, signal: Signal) -> Result<(), super::case::Trouble> {
    let group = bench.child.as_ref().and_then(|child| Pid::from_raw(child.pid().cast_signed()));
    if let Some(group) = group {
        kill_process_group(group, signal).map_err(std::io::Error::from)?;
    }
    Ok(())
}
