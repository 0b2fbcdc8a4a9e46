//! What must not be used: samples without authority, repeated, old or broken ones, and halves of a pair.
//!
//! A bad sample is followed by a good one of the same scan or of the next one, which must be answered once. So a
//! process that takes the bad one is found by its answer, however late that comes.

use shared_types::{Authority, Fault, Heartbeat, Topic};

use super::answers::joins;
use super::case::{Case, LIVE, Level, Trouble, Verdict, failed, require};
use super::message::Message;
use super::suite::{Setup, Suite};
use super::test_bench::{ANSWER_NS, STRANGER, TestBench, asking, speaker};

/// Where in the drive the cases begin: the robot drives, the box is in view.
const FIRST_SCAN: u64 = 20;
/// Bad samples of a burst: more than twice what waits at a reader.
const BURST: usize = 40;

/// The cases of estimator, obstacles, controller and actuator.
pub(crate) const CASES: [Case; 6] = [
    Case {
        name: "authority",
        level: Level::Required,
        requirement: "Samples of an incarnation that the directive does not name are not used.",
        why: "A candidate in the shadow and a process that was replaced go on publishing.",
        tries: LIVE,
        play: authority,
    },
    Case {
        name: "exchange",
        level: Level::Required,
        requirement: "When authority over an input changes at a scan, it takes the old producer's samples before that scan \
                      and the new one's from it on, and answers each scan once.",
        why: "An exchange of the process before it would lose or repeat a scan.",
        tries: LIVE,
        play: exchange,
    },
    Case {
        name: "repeated",
        level: Level::Required,
        requirement: "Samples with a sequence number that was seen, or that is lower, are not used.",
        why: "The same scan would be driven twice.",
        tries: LIVE,
        play: repeated,
    },
    Case {
        name: "stale",
        level: Level::Required,
        requirement: "Samples of a scan older than three periods move nothing.",
        why: "They tell where the robot was.",
        tries: LIVE,
        play: stale,
    },
    Case {
        name: "garbage",
        level: Level::Required,
        requirement: "A burst of samples of another layout, with NaN, infinities, unknown kinds or impossible counts is not \
                      used and not fatal; the next good scan is answered.",
        why: "One broken process must not break the next.",
        tries: LIVE,
        play: garbage,
    },
    Case {
        name: "counts",
        level: Level::Recommended,
        requirement: "The heartbeat counts what was dropped: foreign, duplicate, reordered, stale and invalid samples.",
        why: "Without it nobody sees why a scan was lost.",
        tries: LIVE,
        play: counts,
    },
];

/// The case of roles that answer nothing when an input is missing.
pub(crate) const MISSING_INPUT: Case = Case {
    name: "missing-input",
    level: Level::Required,
    requirement: "Without one of its inputs, or with inputs of different scans, it publishes nothing that moves the robot.",
    why: "Nothing published is safe, the wheels get blocked; something invented is not.",
    tries: LIVE,
    play: missing_input,
};

fn authority(suite: &Suite) -> Verdict {
    let mut bench = mid_drive(suite)?;
    for topic in asking(suite.role) {
        with_one_bad(&mut bench, *topic, "a sample without authority", |bench, message| {
            message.header_mut().incarnation = STRANGER;
            bench.publish(message)
        })?;
    }
    Ok(format!("{} samples without authority", asking(suite.role).len()))
}

fn exchange(suite: &Suite) -> Verdict {
    let mut bench = mid_drive(suite)?;
    let change = bench.scan_id + 4;
    for topic in asking(suite.role) {
        let writer = topic.writer().map_or(0, |writer| writer.index());
        let previous = bench.directive.authority[writer].incarnation;
        bench.directive.authority[writer] =
            Authority { incarnation: STRANGER + 1, previous, from_scan: change };
    }
    bench.direct(|_| {})?;
    bench.receive_for(1.0)?;
    bench.begin();
    bench.received.clear();
    for _ in 0..8 {
        let scan_id = bench.scan_id;
        bench.wait_until_due(scan_id)?;
        let (new, old) = (STRANGER + 1, None);
        // First the one that does not count: who takes it has answered too early.
        let counts = if scan_id < change { old } else { Some(new) };
        let other = if scan_id < change { Some(new) } else { old };
        publish_all(&mut bench, scan_id, other)?;
        bench.receive_for(0.3)?;
        bench.require_no_answer(scan_id, "the sample of the producer that does not count")?;
        publish_all(&mut bench, scan_id, counts)?;
        bench.answer(scan_id)?;
        bench.conclude(scan_id)?;
        bench.scan_id += 1;
    }
    bench.receive_for(2.0)?;
    for scan_id in change - 4..change + 4 {
        let count = bench.answers(scan_id).count();
        require(count == 1, || {
            format!("{count} answers to scan {scan_id}; authority changed at scan {change}")
        })?;
    }
    Ok(format!("8 scans, authority changed at scan {change}"))
}

fn repeated(suite: &Suite) -> Verdict {
    let mut bench = mid_drive(suite)?;
    let mut said = Vec::new();
    for _ in 0..3 {
        let scan_id = bench.scan_id;
        bench.wait_until_due(scan_id)?;
        let mut messages = bench.inputs(scan_id)?;
        for message in &mut messages {
            bench.publish(message)?;
        }
        bench.answer(scan_id)?;
        bench.conclude(scan_id)?;
        bench.scan_id += 1;
        said.push(messages);
    }
    // The last one again, then the one before it: repeated and reordered.
    for messages in said.iter().skip(1).rev() {
        for message in messages {
            bench.publish_exactly(message)?;
        }
        bench.receive_for(0.3)?;
    }
    let first = bench.round()?.message.scan_id() - 3;
    bench.receive_for(2.0)?;
    for scan_id in first..first + 4 {
        let count = bench.answers(scan_id).filter(|received| !received.message.is_harmless()).count();
        require(count <= 1, || format!("{count} answers to scan {scan_id} after its samples came again"))?;
    }
    Ok("2 scans repeated".to_owned())
}

fn stale(suite: &Suite) -> Verdict {
    let mut bench = mid_drive(suite)?;
    let scan_id = bench.scan_id;
    bench.wait_until_due(scan_id)?;
    for mut message in bench.inputs(scan_id)? {
        message.header_mut().acquired_ns -= 4 * suite.period_ns;
        bench.publish(&mut message)?;
    }
    bench.receive_for(1.0)?;
    bench.require_no_answer(scan_id, "samples four periods old")?;
    bench.scan_id += 1;
    bench.begin();
    bench.rounds(2)?;
    bench.require_no_answer(scan_id, "samples four periods old")?;
    Ok("1 scan four periods old".to_owned())
}

fn garbage(suite: &Suite) -> Verdict {
    let mut bench = mid_drive(suite)?;
    let mut count = 0;
    for topic in asking(suite.role) {
        let scan_id = bench.scan_id;
        bench.wait_until_due(scan_id)?;
        let good = bench.inputs(scan_id)?;
        for message in good.iter().filter(|message| message.topic() != *topic) {
            bench.publish(&mut message.clone())?;
        }
        let kinds = bench.message(*topic, scan_id)?.spoilt();
        for mut message in kinds.into_iter().cycle().take(BURST) {
            publish_spoilt(&mut bench, &mut message)?;
            count += 1;
        }
        bench.receive_for(0.5)?;
        bench.require_no_answer(scan_id, "broken samples")?;
        bench.scan_id += 1;
        bench.begin();
        let scan_id = bench.round()?.message.scan_id();
        bench.require_no_answer(scan_id - 1, "broken samples")?;
    }
    // Valid again, not just alive.
    let answer = bench.round()?;
    if let Err(fault) = answer.message.check() {
        return failed(format!("the answer after the burst: {fault}"));
    }
    Ok(format!("{count} broken samples"))
}

fn counts(suite: &Suite) -> Verdict {
    let mut bench = mid_drive(suite)?;
    bench.receive_for(2.0)?;
    let before = bench.heartbeats.last().copied().unwrap_or_default();
    let topic = asking(suite.role)[0];
    let scan_id = bench.scan_id;
    bench.wait_until_due(scan_id)?;
    let mut foreign = bench.message(topic, scan_id)?;
    foreign.header_mut().incarnation = STRANGER;
    bench.publish(&mut foreign)?;
    let mut messages = bench.inputs(scan_id)?;
    for message in &mut messages {
        bench.publish(message)?;
    }
    bench.answer(scan_id)?;
    bench.conclude(scan_id)?;
    bench.scan_id += 1;
    bench.round()?;
    let mut again = bench.message(topic, scan_id + 2)?;
    bench.publish(&mut again)?;
    bench.publish_exactly(&again)?;
    // Two that change places, and the number that was used ahead of time once more.
    let mut ahead = again.clone();
    ahead.header_mut().sequence += 2;
    bench.publish_exactly(&ahead)?;
    let mut late = bench.message(topic, scan_id + 2)?;
    bench.publish(&mut late)?;
    bench.publish(&mut late)?;
    let mut old = bench.message(topic, scan_id + 3)?;
    old.header_mut().acquired_ns -= 5 * suite.period_ns;
    bench.publish(&mut old)?;
    let mut broken = bench.message(topic, scan_id + 3)?.spoilt().swap_remove(1);
    bench.publish(&mut broken)?;
    let missing = |bench: &TestBench<'_>| -> Vec<&str> {
        let now = dropped(&bench.heartbeats.last().copied().unwrap_or_default());
        let both = now.into_iter().zip(dropped(&before));
        both.filter(|((_, now), (_, before))| now <= before).map(|((kind, _), _)| kind).collect()
    };
    bench.until(ANSWER_NS / 5, |bench| missing(bench).is_empty())?;
    let missing = missing(&bench);
    require(missing.is_empty(), || format!("not counted: {}", missing.join(", ")))?;
    Ok("one of each kind counted".to_owned())
}

/// What a heartbeat says of dropped samples, by kind.
fn dropped(beat: &Heartbeat) -> [(&'static str, u64); 5] {
    [
        ("foreign", beat.foreign),
        ("duplicate", beat.duplicate),
        ("reordered", beat.reordered),
        ("stale", beat.stale),
        ("invalid", beat.invalid),
    ]
}

fn missing_input(suite: &Suite) -> Verdict {
    let mut bench = mid_drive(suite)?;
    let mut incomplete = Vec::new();
    for topic in asking(suite.role) {
        for _ in 0..3 {
            let scan_id = bench.scan_id;
            bench.wait_until_due(scan_id)?;
            for mut message in bench.inputs(scan_id)? {
                if message.topic() != *topic {
                    bench.publish(&mut message)?;
                }
            }
            incomplete.push(scan_id);
            bench.scan_id += 1;
        }
        bench.begin();
        bench.round()?;
    }
    if joins(suite.role) {
        incomplete.extend(contradiction(&mut bench)?);
    }
    let newest = bench.scan_id;
    bench.receive_for(2.0)?;
    for scan_id in &incomplete {
        bench.require_no_answer(*scan_id, "one of its inputs was kept back")?;
    }
    let ahead = bench.received.iter().find(|received| received.message.scan_id() >= newest);
    require(ahead.is_none(), || format!("an answer to scan {newest}, which nobody has published"))?;
    Ok(format!("{} scans without one of the inputs", incomplete.len()))
}

/// Two inputs of different scans: no scan is complete.
fn contradiction(bench: &mut TestBench<'_>) -> Result<[u64; 2], Trouble> {
    let scan_id = bench.scan_id;
    bench.wait_until_due(scan_id)?;
    for (index, mut message) in bench.inputs(scan_id)?.into_iter().enumerate() {
        message.header_mut().scan_id = scan_id + index as u64;
        bench.publish(&mut message)?;
    }
    bench.scan_id += 2;
    bench.begin();
    bench.round()?;
    Ok([scan_id, scan_id + 1])
}

/// A candidate that has answered some scans of the drive.
fn mid_drive(suite: &Suite) -> Result<TestBench<'_>, Trouble> {
    let mut bench = suite.started(Setup { first_scan: FIRST_SCAN, ..Setup::default() })?;
    bench.rounds(3)?;
    Ok(bench)
}

/// One scan with a bad sample of one topic, which must not be answered, and then with a good one, which must.
fn with_one_bad(
    bench: &mut TestBench<'_>,
    topic: Topic,
    what: &str,
    bad: impl Fn(&mut TestBench<'_>, &mut Message) -> Result<(), Trouble>,
) -> Result<(), Trouble> {
    let scan_id = bench.scan_id;
    bench.wait_until_due(scan_id)?;
    for mut message in bench.inputs(scan_id)? {
        if message.topic() == topic { bad(bench, &mut message)? } else { bench.publish(&mut message)? }
    }
    bench.receive_for(0.5)?;
    bench.require_no_answer(scan_id, what)?;
    let mut good = bench.message(topic, scan_id)?;
    bench.publish(&mut good)?;
    bench.answer(scan_id)?;
    bench.conclude(scan_id)?;
    bench.scan_id += 1;
    bench.receive_for(1.0)?;
    let count = bench.answers(scan_id).count();
    require(count == 1, || format!("{count} answers to scan {scan_id} after {what} and a good one"))
}

/// Says all inputs of a scan as another incarnation, or as the usual one.
fn publish_all(bench: &mut TestBench<'_>, scan_id: u64, incarnation: Option<u32>) -> Result<(), Trouble> {
    for mut message in bench.inputs(scan_id)? {
        let writer = message.topic().writer();
        message.header_mut().incarnation = incarnation.or(writer.map(speaker)).unwrap_or(0);
        bench.publish(&mut message)?;
    }
    Ok(())
}

/// Says a broken sample; one of another layout keeps that, which an ordinary publication would mend.
fn publish_spoilt(bench: &mut TestBench<'_>, message: &mut Message) -> Result<(), Trouble> {
    let foreign_layout = matches!(message.check(), Err(Fault::Layout { .. }));
    if foreign_layout { bench.publish_exactly(message) } else { bench.publish(message) }
}
