//! What must not be used: samples without authority, repeated, old or broken ones, and halves of a pair.
//!
//! A bad sample is followed by a good one of the same scan or of the next one, which must be answered once. So a
//! process that uses the bad one is found by its answer, however late that comes.

use shared_types::{Authority, Fault, Heartbeat, Topic};

use super::case::{Play, Trouble, Verdict, failed, observed, require};
use super::message::Message;
use super::suite::Suite;
use super::test_bench::{ANSWER_NS, FOREIGN, TestBench, incarnation_of, inputs_of};

/// The first scan of the cases: the robot drives, the box is in view.
const FIRST_SCAN: u64 = 20;
/// Bad samples of a burst: more than twice what fits into the queue of a subscriber.
const BURST: usize = 40;

/// The cases of estimator, obstacles, controller and actuator.
pub(crate) const CASES: [(&str, Play); 6] = [
    ("authority", authority),
    ("exchange", swap),
    ("repeated", repeated),
    ("stale", stale),
    ("garbage", garbage),
    ("counts", counts),
];

fn authority(suite: &Suite) -> Verdict {
    let mut bench = mid_drive(suite)?;
    let inputs = inputs_of(suite.role);
    for topic in inputs {
        let what = "a sample without authority";
        let scan_id = bench.wait_until_due()?;
        for mut message in bench.inputs(scan_id)? {
            if message.topic() == *topic {
                message.header_mut().incarnation = FOREIGN;
            }
            bench.publish(&mut message)?;
        }
        bench.receive_for(0.5)?;
        bench.require_no_answer(scan_id, what)?;
        publish_sample(&mut bench, *topic, scan_id, |_| {})?;
        bench.scan_id += 1;
        bench.finish()?;
        bench.receive_for(1.0)?;
        let count = bench.answers(scan_id).count();
        require(count == 1, || format!("{count} answers to scan {scan_id} after {what} and a good one"))?;
    }
    Ok(format!("{} samples without authority", inputs.len()))
}

fn swap(suite: &Suite) -> Verdict {
    let mut bench = mid_drive(suite)?;
    let (from_scan, new) = (bench.scan_id + 4, FOREIGN + 1);
    bench.direct(|directive| {
        for writer in inputs_of(suite.role).iter().filter_map(|topic| topic.writer()) {
            let authority = &mut directive.authority[writer.index()];
            *authority = Authority { incarnation: new, previous: authority.incarnation, from_scan };
        }
    })?;
    bench.receive_for(1.0)?;
    bench.begin();
    bench.received.clear();
    for _ in 0..8 {
        let scan_id = bench.wait_until_due()?;
        let (old, new) = (None, Some(new));
        // First the one that does not count: a process that uses it answers too early.
        let (other, counts) = if scan_id < from_scan { (new, old) } else { (old, new) };
        publish_all(&mut bench, scan_id, other)?;
        bench.receive_for(0.3)?;
        bench.require_no_answer(scan_id, "the sample of the producer that does not count")?;
        publish_all(&mut bench, scan_id, counts)?;
        bench.scan_id += 1;
        bench.finish()?;
    }
    bench.receive_for(2.0)?;
    for scan_id in from_scan - 4..from_scan + 4 {
        let count = bench.answers(scan_id).count();
        require(count == 1, || {
            format!("{count} answers to scan {scan_id}; authority changed at scan {from_scan}")
        })?;
    }
    Ok(format!("8 scans, authority changed at scan {from_scan}"))
}

/// Publishes all inputs of a scan as another incarnation, or as the usual one.
fn publish_all(bench: &mut TestBench<'_>, scan_id: u64, incarnation: Option<u32>) -> Result<(), Trouble> {
    for mut message in bench.inputs(scan_id)? {
        let writer = message.topic().writer();
        message.header_mut().incarnation = incarnation.or(writer.map(incarnation_of)).unwrap_or(0);
        bench.publish(&mut message)?;
    }
    Ok(())
}

fn repeated(suite: &Suite) -> Verdict {
    let mut bench = mid_drive(suite)?;
    let mut published = Vec::new();
    for _ in 0..3 {
        published.push(bench.ask_with(|_| {})?);
        bench.finish()?;
    }
    // The last one again, then the one before it: repeated and reordered.
    for messages in published[1..].iter().rev() {
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
    bench.ask_with(|message| message.header_mut().acquired_ns -= 4 * suite.period_ns)?;
    bench.receive_for(1.0)?;
    bench.require_no_answer(scan_id, "samples four periods old")?;
    bench.begin();
    bench.rounds(2)?;
    bench.require_no_answer(scan_id, "samples four periods old")?;
    Ok("1 scan four periods old".to_owned())
}

fn garbage(suite: &Suite) -> Verdict {
    let mut bench = mid_drive(suite)?;
    for topic in inputs_of(suite.role) {
        let scan_id = ask_without(&mut bench, *topic)?;
        let kinds = bench.message(*topic, scan_id)?.spoilt();
        for mut message in kinds.into_iter().cycle().take(BURST) {
            publish_spoilt(&mut bench, &mut message)?;
        }
        bench.receive_for(0.5)?;
        bench.require_no_answer(scan_id, "broken samples")?;
        bench.begin();
        bench.round()?;
        bench.require_no_answer(scan_id, "broken samples")?;
    }
    // Valid again, not just alive.
    if let Err(fault) = bench.round()?.message.check() {
        return failed(format!("the answer after the burst: {fault}"));
    }
    Ok(format!("{} broken samples", BURST * inputs_of(suite.role).len()))
}

/// Publishes a broken sample; one of another layout keeps that, which an ordinary publication would repair.
fn publish_spoilt(bench: &mut TestBench<'_>, message: &mut Message) -> Result<(), Trouble> {
    let foreign_layout = matches!(message.check(), Err(Fault::Layout { .. }));
    if foreign_layout { bench.publish_exactly(message) } else { bench.publish(message) }
}

fn counts(suite: &Suite) -> Verdict {
    let mut bench = mid_drive(suite)?;
    bench.receive_for(2.0)?;
    let before = bench.heartbeats.last().copied().unwrap_or_default();
    let topic = inputs_of(suite.role)[0];
    let scan_id = bench.wait_until_due()?;
    publish_sample(&mut bench, topic, scan_id, |message| message.header_mut().incarnation = FOREIGN)?;
    bench.rounds(2)?;
    let again = publish_sample(&mut bench, topic, scan_id + 2, |_| {})?;
    bench.publish_exactly(&again)?;
    // Two that change places, and the number that was used ahead of time once more.
    let mut ahead = again.clone();
    ahead.header_mut().sequence += 2;
    bench.publish_exactly(&ahead)?;
    let mut late = publish_sample(&mut bench, topic, scan_id + 2, |_| {})?;
    bench.publish(&mut late)?;
    publish_sample(&mut bench, topic, scan_id + 3, |message| {
        message.header_mut().acquired_ns -= 5 * suite.period_ns;
    })?;
    publish_sample(&mut bench, topic, scan_id + 3, |message| *message = message.spoilt().swap_remove(1))?;
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

/// The counters of dropped samples in a heartbeat, by kind.
fn dropped(beat: &Heartbeat) -> [(&'static str, u64); 5] {
    [
        ("foreign", beat.foreign),
        ("duplicate", beat.duplicate),
        ("reordered", beat.reordered),
        ("stale", beat.stale),
        ("invalid", beat.invalid),
    ]
}

pub(crate) fn missing_input(suite: &Suite) -> Verdict {
    let mut bench = mid_drive(suite)?;
    let mut incomplete = Vec::new();
    for topic in inputs_of(suite.role) {
        for _ in 0..3 {
            incomplete.push(ask_without(&mut bench, *topic)?);
        }
        bench.begin();
        bench.round()?;
    }
    if inputs_of(suite.role).len() > 1 {
        incomplete.extend(contradiction(&mut bench)?);
    }
    let newest = bench.scan_id;
    bench.receive_for(2.0)?;
    for scan_id in &incomplete {
        bench.require_no_answer(*scan_id, "one of its inputs was withheld")?;
    }
    let ahead = bench.received.iter().any(|received| received.message.scan_id() >= newest);
    require(!ahead, || format!("an answer to scan {newest}, which was not published"))?;
    Ok(format!("{} scans without one of the inputs", incomplete.len()))
}

/// Publishes two inputs of different scans: no scan is complete.
fn contradiction(bench: &mut TestBench<'_>) -> Result<[u64; 2], Trouble> {
    let scan_id = bench.wait_until_due()?;
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
    let mut bench = suite.started_at(FIRST_SCAN)?;
    let answers = bench.rounds(3)?;
    // A process that always blocks the wheels would never show that it uses what it must not.
    observed(answers.iter().any(|answer| !answer.message.is_harmless()), || {
        "it does not drive with good samples either".to_owned()
    })?;
    Ok(bench)
}

/// Publishes the inputs of the next scan except of one topic; returns its id.
fn ask_without(bench: &mut TestBench<'_>, topic: Topic) -> Result<u64, Trouble> {
    let scan_id = bench.wait_until_due()?;
    for mut message in bench.inputs(scan_id)?.into_iter().filter(|message| message.topic() != topic) {
        bench.publish(&mut message)?;
    }
    bench.scan_id += 1;
    Ok(scan_id)
}

/// Publishes one sample of a scan, changed, and returns it.
fn publish_sample(
    bench: &mut TestBench<'_>,
    topic: Topic,
    scan_id: u64,
    change: impl Fn(&mut Message),
) -> Result<Message, Trouble> {
    let mut message = bench.message(topic, scan_id)?;
    change(&mut message);
    bench.publish(&mut message)?;
    Ok(message)
}
