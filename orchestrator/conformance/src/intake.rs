//! What must not be used: samples without authority, repeated, old or broken ones, and halves of a pair.
//!
//! A bad sample is followed by a good one of the same scan or of the next one, which must be answered once. So a
//! process that takes the bad one is found by its answer, however late that comes.

use shared_types::{Authority, Fault, Heartbeat, Topic};

use super::answers::joins;
use super::case::{Case, LIVE, Level, Trouble, Verdict, failed, require};
use super::message::Message;
use super::stand::{ANSWER_NS, STRANGER, Stand, asking, speaker};
use super::suite::{Setup, Suite};

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
    let mut stand = mid_drive(suite)?;
    for topic in asking(suite.role) {
        with_one_bad(&mut stand, *topic, "a sample without authority", |stand, message| {
            message.header_mut().incarnation = STRANGER;
            stand.say(message)
        })?;
    }
    Ok(format!("{} samples without authority", asking(suite.role).len()))
}

fn exchange(suite: &Suite) -> Verdict {
    let mut stand = mid_drive(suite)?;
    let change = stand.scan_id + 4;
    for topic in asking(suite.role) {
        let writer = topic.writer().map_or(0, |writer| writer.index());
        let previous = stand.directive.authority[writer].incarnation;
        stand.directive.authority[writer] =
            Authority { incarnation: STRANGER + 1, previous, from_scan: change };
    }
    stand.direct(|_| {})?;
    stand.listen(1.0)?;
    stand.begin();
    stand.heard.clear();
    for _ in 0..8 {
        let scan_id = stand.scan_id;
        stand.wait_until_due(scan_id)?;
        let (new, old) = (STRANGER + 1, None);
        // First the one that does not count: who takes it has answered too early.
        let counts = if scan_id < change { old } else { Some(new) };
        let other = if scan_id < change { Some(new) } else { old };
        say_all(&mut stand, scan_id, other)?;
        stand.listen(0.3)?;
        stand.require_no_answer(scan_id, "the sample of the producer that does not count")?;
        say_all(&mut stand, scan_id, counts)?;
        stand.answer(scan_id)?;
        stand.conclude(scan_id)?;
        stand.scan_id += 1;
    }
    stand.listen(2.0)?;
    for scan_id in change - 4..change + 4 {
        let count = stand.answers(scan_id).count();
        require(count == 1, || {
            format!("{count} answers to scan {scan_id}; authority changed at scan {change}")
        })?;
    }
    Ok(format!("8 scans, authority changed at scan {change}"))
}

fn repeated(suite: &Suite) -> Verdict {
    let mut stand = mid_drive(suite)?;
    let mut said = Vec::new();
    for _ in 0..3 {
        let scan_id = stand.scan_id;
        stand.wait_until_due(scan_id)?;
        let mut messages = stand.inputs(scan_id)?;
        for message in &mut messages {
            stand.say(message)?;
        }
        stand.answer(scan_id)?;
        stand.conclude(scan_id)?;
        stand.scan_id += 1;
        said.push(messages);
    }
    // The last one again, then the one before it: repeated and reordered.
    for messages in said.iter().skip(1).rev() {
        for message in messages {
            stand.say_exactly(message)?;
        }
        stand.listen(0.3)?;
    }
    let first = stand.round()?.message.scan_id() - 3;
    stand.listen(2.0)?;
    for scan_id in first..first + 4 {
        let count = stand.answers(scan_id).filter(|heard| !heard.message.is_harmless()).count();
        require(count <= 1, || format!("{count} answers to scan {scan_id} after its samples came again"))?;
    }
    Ok("2 scans repeated".to_owned())
}

fn stale(suite: &Suite) -> Verdict {
    let mut stand = mid_drive(suite)?;
    let scan_id = stand.scan_id;
    stand.wait_until_due(scan_id)?;
    for mut message in stand.inputs(scan_id)? {
        message.header_mut().acquired_ns -= 4 * suite.period_ns;
        stand.say(&mut message)?;
    }
    stand.listen(1.0)?;
    stand.require_no_answer(scan_id, "samples four periods old")?;
    stand.scan_id += 1;
    stand.begin();
    stand.rounds(2)?;
    stand.require_no_answer(scan_id, "samples four periods old")?;
    Ok("1 scan four periods old".to_owned())
}

fn garbage(suite: &Suite) -> Verdict {
    let mut stand = mid_drive(suite)?;
    let mut count = 0;
    for topic in asking(suite.role) {
        let scan_id = stand.scan_id;
        stand.wait_until_due(scan_id)?;
        let good = stand.inputs(scan_id)?;
        for message in good.iter().filter(|message| message.topic() != *topic) {
            stand.say(&mut message.clone())?;
        }
        let kinds = stand.message(*topic, scan_id)?.spoilt();
        for mut message in kinds.into_iter().cycle().take(BURST) {
            say_spoilt(&mut stand, &mut message)?;
            count += 1;
        }
        stand.listen(0.5)?;
        stand.require_no_answer(scan_id, "broken samples")?;
        stand.scan_id += 1;
        stand.begin();
        let scan_id = stand.round()?.message.scan_id();
        stand.require_no_answer(scan_id - 1, "broken samples")?;
    }
    // Valid again, not just alive.
    let answer = stand.round()?;
    if let Err(fault) = answer.message.check() {
        return failed(format!("the answer after the burst: {fault}"));
    }
    Ok(format!("{count} broken samples"))
}

fn counts(suite: &Suite) -> Verdict {
    let mut stand = mid_drive(suite)?;
    stand.listen(2.0)?;
    let before = stand.heartbeats.last().copied().unwrap_or_default();
    let topic = asking(suite.role)[0];
    let scan_id = stand.scan_id;
    stand.wait_until_due(scan_id)?;
    let mut foreign = stand.message(topic, scan_id)?;
    foreign.header_mut().incarnation = STRANGER;
    stand.say(&mut foreign)?;
    let mut messages = stand.inputs(scan_id)?;
    for message in &mut messages {
        stand.say(message)?;
    }
    stand.answer(scan_id)?;
    stand.conclude(scan_id)?;
    stand.scan_id += 1;
    stand.round()?;
    let mut again = stand.message(topic, scan_id + 2)?;
    stand.say(&mut again)?;
    stand.say_exactly(&again)?;
    // Two that change places, and the number that was used ahead of time once more.
    let mut ahead = again.clone();
    ahead.header_mut().sequence += 2;
    stand.say_exactly(&ahead)?;
    let mut late = stand.message(topic, scan_id + 2)?;
    stand.say(&mut late)?;
    stand.say(&mut late)?;
    let mut old = stand.message(topic, scan_id + 3)?;
    old.header_mut().acquired_ns -= 5 * suite.period_ns;
    stand.say(&mut old)?;
    let mut broken = stand.message(topic, scan_id + 3)?.spoilt().swap_remove(1);
    stand.say(&mut broken)?;
    let missing = |stand: &Stand<'_>| -> Vec<&str> {
        let now = dropped(&stand.heartbeats.last().copied().unwrap_or_default());
        let both = now.into_iter().zip(dropped(&before));
        both.filter(|((_, now), (_, before))| now <= before).map(|((kind, _), _)| kind).collect()
    };
    stand.until(ANSWER_NS / 5, |stand| missing(stand).is_empty())?;
    let missing = missing(&stand);
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
    let mut stand = mid_drive(suite)?;
    let mut incomplete = Vec::new();
    for topic in asking(suite.role) {
        for _ in 0..3 {
            let scan_id = stand.scan_id;
            stand.wait_until_due(scan_id)?;
            for mut message in stand.inputs(scan_id)? {
                if message.topic() != *topic {
                    stand.say(&mut message)?;
                }
            }
            incomplete.push(scan_id);
            stand.scan_id += 1;
        }
        stand.begin();
        stand.round()?;
    }
    if joins(suite.role) {
        incomplete.extend(contradiction(&mut stand)?);
    }
    let newest = stand.scan_id;
    stand.listen(2.0)?;
    for scan_id in &incomplete {
        stand.require_no_answer(*scan_id, "one of its inputs was kept back")?;
    }
    let ahead = stand.heard.iter().find(|heard| heard.message.scan_id() >= newest);
    require(ahead.is_none(), || format!("an answer to scan {newest}, which nobody has published"))?;
    Ok(format!("{} scans without one of the inputs", incomplete.len()))
}

/// Two inputs of different scans: no scan is complete.
fn contradiction(stand: &mut Stand<'_>) -> Result<[u64; 2], Trouble> {
    let scan_id = stand.scan_id;
    stand.wait_until_due(scan_id)?;
    for (index, mut message) in stand.inputs(scan_id)?.into_iter().enumerate() {
        message.header_mut().scan_id = scan_id + index as u64;
        stand.say(&mut message)?;
    }
    stand.scan_id += 2;
    stand.begin();
    stand.round()?;
    Ok([scan_id, scan_id + 1])
}

/// A candidate that has answered some scans of the drive.
fn mid_drive(suite: &Suite) -> Result<Stand<'_>, Trouble> {
    let mut stand = suite.started(Setup { first_scan: FIRST_SCAN, ..Setup::default() })?;
    stand.rounds(3)?;
    Ok(stand)
}

/// One scan with a bad sample of one topic, which must not be answered, and then with a good one, which must.
fn with_one_bad(
    stand: &mut Stand<'_>,
    topic: Topic,
    what: &str,
    bad: impl Fn(&mut Stand<'_>, &mut Message) -> Result<(), Trouble>,
) -> Result<(), Trouble> {
    let scan_id = stand.scan_id;
    stand.wait_until_due(scan_id)?;
    for mut message in stand.inputs(scan_id)? {
        if message.topic() == topic { bad(stand, &mut message)? } else { stand.say(&mut message)? }
    }
    stand.listen(0.5)?;
    stand.require_no_answer(scan_id, what)?;
    let mut good = stand.message(topic, scan_id)?;
    stand.say(&mut good)?;
    stand.answer(scan_id)?;
    stand.conclude(scan_id)?;
    stand.scan_id += 1;
    stand.listen(1.0)?;
    let count = stand.answers(scan_id).count();
    require(count == 1, || format!("{count} answers to scan {scan_id} after {what} and a good one"))
}

/// Says all inputs of a scan as another incarnation, or as the usual one.
fn say_all(stand: &mut Stand<'_>, scan_id: u64, incarnation: Option<u32>) -> Result<(), Trouble> {
    for mut message in stand.inputs(scan_id)? {
        let writer = message.topic().writer();
        message.header_mut().incarnation = incarnation.or(writer.map(speaker)).unwrap_or(0);
        stand.say(&mut message)?;
    }
    Ok(())
}

/// Says a broken sample; one of another layout keeps that, which an ordinary publication would mend.
fn say_spoilt(stand: &mut Stand<'_>, message: &mut Message) -> Result<(), Trouble> {
    let foreign_layout = matches!(message.check(), Err(Fault::Layout { .. }));
    if foreign_layout { stand.say_exactly(message) } else { stand.say(message) }
}
