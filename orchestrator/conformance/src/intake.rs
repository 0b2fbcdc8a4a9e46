//! What must not be used: samples without authority, repeated, old or broken ones, and halves of a pair.
//!
//! A bad sample is followed by a good one of the same scan or of the next one, which must be answered once. So a
//! process that uses the bad one is found by its answer, however late that comes.

use shared_types::{Authority, Fault, Topic};

use super::case::{Tried, Verdict, failed, observed, require};
use super::message::Message;
use super::test_bench::{ANSWER_NS, FOREIGN, TestBench, incarnation_of, inputs_of};

/// Bad samples of a burst: more than twice what fits into the queue of a subscriber.
const BURST: usize = 40;

/// Why samples are dropped, by the names of the counters in a heartbeat.
const DROPPED: [&str; 5] = ["foreign", "duplicate", "reordered", "stale", "invalid"];

pub(crate) fn authority(bench: &mut TestBench<'_>) -> Verdict {
    let inputs = inputs_of(bench.suite.role);
    for topic in inputs {
        let (what, is_foreign) = ("a sample without authority", |other| other == *topic);
        let scan_id = bench.wait_until_due()?;
        publish_as(bench, scan_id, |other| Some(if is_foreign(other) { FOREIGN } else { usual(other) }))?;
        bench.receive_for(0.5)?;
        bench.require_no_answer(scan_id, what)?;
        publish_as(bench, scan_id, |other| is_foreign(other).then(|| usual(other)))?;
        bench.scan_id += 1;
        bench.finish()?;
        bench.receive_for(1.0)?;
        require_one_answer(bench, scan_id, &format!(" after {what} and a good one"))?;
    }
    Ok(format!("{} samples without authority", inputs.len()))
}

pub(crate) fn swap(bench: &mut TestBench<'_>) -> Verdict {
    let (from_scan, new) = (bench.scan_id + 4, FOREIGN + 1);
    bench.direct(|directive| {
        for writer in inputs_of(bench.suite.role).iter().filter_map(|topic| topic.writer()) {
            let authority = &mut directive.authority[writer.index()];
            *authority = Authority { incarnation: new, previous: authority.incarnation, from_scan };
        }
    })?;
    bench.receive_for(1.0)?;
    bench.begin();
    bench.received.clear();
    for scan_id in from_scan - 4..from_scan + 4 {
        bench.wait_until_due()?;
        let is_new = scan_id >= from_scan;
        // First the one that does not count: a process that uses it answers too early.
        publish_as(bench, scan_id, |topic| Some(if is_new { usual(topic) } else { new }))?;
        bench.receive_for(0.3)?;
        bench.require_no_answer(scan_id, "the sample of the producer that does not count")?;
        publish_as(bench, scan_id, |topic| Some(if is_new { new } else { usual(topic) }))?;
        bench.scan_id += 1;
        bench.finish()?;
    }
    bench.receive_for(2.0)?;
    for scan_id in from_scan - 4..from_scan + 4 {
        require_one_answer(bench, scan_id, &format!("; authority changed at scan {from_scan}"))?;
    }
    Ok(format!("8 scans, authority changed at scan {from_scan}"))
}

/// Publishes the inputs of a scan, each as the incarnation that its topic has, if it has one.
fn publish_as(bench: &mut TestBench<'_>, scan_id: u64, incarnation: impl Fn(Topic) -> Option<u32>) -> Tried {
    for mut message in bench.inputs(scan_id)? {
        if let Some(incarnation) = incarnation(message.topic()) {
            message.header_mut().incarnation = incarnation;
            bench.publish(&mut message)?;
        }
    }
    Ok(())
}

/// The incarnation as which the test bench publishes on a topic.
fn usual(topic: Topic) -> u32 {
    topic.writer().map_or(0, incarnation_of)
}

fn require_one_answer(bench: &TestBench<'_>, scan_id: u64, why: &str) -> Tried {
    let count = bench.answers(scan_id).count();
    require(count == 1, || format!("{count} answers to scan {scan_id}{why}"))
}

pub(crate) fn repeated(bench: &mut TestBench<'_>) -> Verdict {
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
    let first = bench.round()?.scan_id() - 3;
    bench.receive_for(2.0)?;
    for scan_id in first..first + 4 {
        let count = bench.answers(scan_id).filter(|received| !received.is_harmless()).count();
        require(count <= 1, || format!("{count} answers to scan {scan_id} after its samples came again"))?;
    }
    Ok("2 scans repeated".to_owned())
}

pub(crate) fn stale(bench: &mut TestBench<'_>) -> Verdict {
    bench.ask_with(|message| message.header_mut().acquired_ns -= 4 * bench.suite.period_ns)?;
    require_unused(bench, 1.0, 2, "samples four periods old")?;
    Ok("1 scan four periods old".to_owned())
}

/// Requires that what was published for the newest scan is not used, for some periods and some good scans.
fn require_unused(bench: &mut TestBench<'_>, periods: f64, good: usize, what: &str) -> Tried {
    let scan_id = bench.scan_id - 1;
    bench.receive_for(periods)?;
    bench.require_no_answer(scan_id, what)?;
    bench.begin();
    bench.rounds(good)?;
    bench.require_no_answer(scan_id, what)
}

pub(crate) fn garbage(bench: &mut TestBench<'_>) -> Verdict {
    for topic in inputs_of(bench.suite.role) {
        let scan_id = ask_without(bench, *topic)?;
        let kinds = bench.message(*topic, scan_id)?.spoilt();
        for mut message in kinds.into_iter().cycle().take(BURST) {
            // One of another layout keeps that, which an ordinary publication would repair.
            let is_foreign = matches!(message.check(), Err(Fault::Layout { .. }));
            if is_foreign { bench.publish_exactly(&message) } else { bench.publish(&mut message) }?;
        }
        require_unused(bench, 0.5, 1, "broken samples")?;
    }
    // Valid again, not just alive.
    if let Err(fault) = bench.round()?.check() {
        return failed(format!("the answer after the burst: {fault}"));
    }
    Ok(format!("{} broken samples", BURST * inputs_of(bench.suite.role).len()))
}

pub(crate) fn counts(bench: &mut TestBench<'_>) -> Verdict {
    bench.receive_for(2.0)?;
    let before = dropped(bench);
    let topic = inputs_of(bench.suite.role)[0];
    let scan_id = bench.wait_until_due()?;
    publish_sample(bench, topic, scan_id, |message| message.header_mut().incarnation = FOREIGN)?;
    bench.rounds(2)?;
    let again = publish_sample(bench, topic, scan_id + 2, |_| {})?;
    bench.publish_exactly(&again)?;
    // Two that change places, and the number that was used ahead of time once more.
    let mut ahead = again.clone();
    ahead.header_mut().sequence += 2;
    bench.publish_exactly(&ahead)?;
    let mut late = publish_sample(bench, topic, scan_id + 2, |_| {})?;
    bench.publish(&mut late)?;
    let old_ns = 5 * bench.suite.period_ns;
    publish_sample(bench, topic, scan_id + 3, |message| message.header_mut().acquired_ns -= old_ns)?;
    publish_sample(bench, topic, scan_id + 3, |message| *message = message.spoilt().swap_remove(1))?;
    let missing = |bench: &TestBench<'_>| -> Vec<&str> {
        let counts = dropped(bench).into_iter().zip(before);
        DROPPED
            .into_iter()
            .zip(counts)
            .filter(|(_, (now, before))| now <= before)
            .map(|(kind, _)| kind)
            .collect()
    };
    bench.until(ANSWER_NS / 5, |bench| missing(bench).is_empty())?;
    let missing = missing(bench);
    require(missing.is_empty(), || format!("not counted: {}", missing.join(", ")))?;
    Ok("one of each kind counted".to_owned())
}

/// The newest counters of dropped samples, of each kind in [`DROPPED`].
fn dropped(bench: &TestBench<'_>) -> [u64; 5] {
    let beat = bench.heartbeats.last().copied().unwrap_or_default();
    [beat.foreign, beat.duplicate, beat.reordered, beat.stale, beat.invalid]
}

pub(crate) fn missing_input(bench: &mut TestBench<'_>) -> Verdict {
    let mut incomplete = Vec::new();
    for topic in inputs_of(bench.suite.role) {
        for _ in 0..3 {
            incomplete.push(ask_without(bench, *topic)?);
        }
        bench.begin();
        bench.round()?;
    }
    if inputs_of(bench.suite.role).len() > 1 {
        incomplete.extend(contradiction(bench)?);
    }
    let newest = bench.scan_id;
    bench.receive_for(2.0)?;
    for scan_id in &incomplete {
        bench.require_no_answer(*scan_id, "one of its inputs was withheld")?;
    }
    let ahead = bench.received.iter().any(|received| received.scan_id() >= newest);
    require(!ahead, || format!("an answer to scan {newest}, which was not published"))?;
    Ok(format!("{} scans without one of the inputs", incomplete.len()))
}

/// Publishes two inputs of different scans: no scan is complete.
fn contradiction(bench: &mut TestBench<'_>) -> Tried<[u64; 2]> {
    let second = inputs_of(bench.suite.role)[1];
    let scan_id = bench.scan_id;
    bench.ask_with(|message| message.header_mut().scan_id += u64::from(message.topic() == second))?;
    bench.scan_id += 1;
    bench.begin();
    bench.round()?;
    Ok([scan_id, scan_id + 1])
}

/// Lets the candidate answer some scans of the drive.
pub(crate) fn mid_drive(bench: &mut TestBench<'_>) -> Tried {
    // A process that always blocks the wheels would never show that it uses what it must not.
    let drives = bench.rounds(3)?.iter().any(|answer| !answer.is_harmless());
    observed(drives, || "it does not drive with good samples either")
}

/// Publishes the inputs of the next scan except of one topic; returns its id.
fn ask_without(bench: &mut TestBench<'_>, topic: Topic) -> Tried<u64> {
    let scan_id = bench.wait_until_due()?;
    publish_as(bench, scan_id, |other| (other != topic).then(|| usual(other)))?;
    bench.scan_id += 1;
    Ok(scan_id)
}

/// Publishes one sample of a scan, changed, and returns it.
fn publish_sample(
    bench: &mut TestBench<'_>,
    topic: Topic,
    scan_id: u64,
    change: impl Fn(&mut Message),
) -> Tried<Message> {
    let mut message = bench.message(topic, scan_id)?;
    change(&mut message);
    bench.publish(&mut message)?;
    Ok(message)
}
