//! What the answers of the four roles behind the robot have in common: one per scan, in time, with the header of what
//! they answer.

use shared_types::{CHECKPOINT_BYTES, Checkpoint, Header, Role};

use super::case::{Case, LIVE, LOCKSTEP, Level, Trouble, Verdict, failed, require, skipped};
use super::drive::Course;
use super::ranges::valid;
use super::suite::{Setup, Suite};
use super::test_bench::{ANSWER_NS, Received, TestBench, asking};

/// Scans of a case that counts answers.
const SCANS: usize = 20;
/// Scans of two runs that are compared to the last bit.
const SAME_SCANS: usize = 40;
/// Where the second half of a drive begins, for a successor.
const HANDOVER: usize = 20;

/// The cases of estimator, obstacles, controller and actuator.
pub(crate) const CASES: [Case; 7] = [
    Case {
        name: "every-scan",
        level: Level::Required,
        requirement: "It answers every scan once, in order, with sequence numbers from 1 without a gap.",
        why: "A scan that is not answered is lost, one that is answered twice is driven twice.",
        tries: LIVE,
        play: every_scan,
    },
    Case {
        name: "in-time",
        level: Level::Required,
        requirement: "It publishes its answer before the next scan is due; one scan in ten may be late.",
        why: "The loop closes within one scan, and the actuator blocks the wheels after one and a half.",
        tries: LIVE,
        play: in_time,
    },
    Case {
        name: "header",
        level: Level::Required,
        requirement: "The answer carries scan id, time of the front beam and the stamps of all stages before it \
                      unchanged, and its own four stamps in order.",
        why: "Age and latency of a command are computed from nothing else.",
        tries: LIVE,
        play: header,
    },
    Case {
        name: "valid-values",
        level: Level::Required,
        requirement: "All numbers of all answers are finite and within what the field can mean.",
        why: "A sample with a bad number is dropped by every reader, so the scan is lost.",
        tries: LIVE,
        play: valid_values,
    },
    Case {
        name: "repeatable",
        level: Level::Recommended,
        requirement: "In lock-step the same inputs give the same answers to the last bit.",
        why: "Otherwise a drive cannot be repeated to look for a mistake.",
        tries: LOCKSTEP,
        play: repeatable,
    },
    Case {
        name: "state",
        level: Level::Recommended,
        requirement: "It publishes its state after each scan.",
        why: "One that takes its place goes on from there.",
        tries: LIVE,
        play: state,
    },
    Case {
        name: "resume",
        level: Level::Recommended,
        requirement: "In lock-step one that goes on from the state of another answers as that one would have, to the \
                      last bit.",
        why: "An exchange is then not felt by the robot.",
        tries: LIVE,
        play: resume,
    },
];

/// The case of roles that must not guess after a loss of memory.
pub(crate) const LOST_STATE: Case = Case {
    name: "lost-state",
    level: Level::Required,
    requirement: "One that has a state, and takes the place of another without getting it, publishes nothing.",
    why: "It would go on from a guess; with no answer the wheels are blocked.",
    tries: LIVE,
    play: lost_state,
};

fn every_scan(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    bench.rounds(SCANS)?;
    bench.receive_for(3.0)?;
    let answers: Vec<_> = bench.received.iter().filter(|received| received.message.is_answer()).collect();
    let ids: Vec<u64> = answers.iter().map(|received| received.message.scan_id()).collect();
    let expected: Vec<u64> = (1..=SCANS as u64).collect();
    require(ids == expected, || format!("{} answers to {SCANS} scans: {}", ids.len(), runs(&ids)))?;
    for (index, received) in bench.received.iter().enumerate() {
        let sequence = received.message.header().sequence;
        require(sequence == index as u64 + 1, || format!("sequence {sequence} on sample {}", index + 1))?;
    }
    Ok(format!("{SCANS} scans, {SCANS} answers"))
}

fn in_time(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    // The first answer may take longer: caches are cold, libraries are loaded.
    bench.round()?;
    bench.begin();
    let (mut late, mut longest_ns) = (0, 0);
    for _ in 0..SCANS {
        let scan_id = bench.ask()?;
        let asked_ns = runtime::monotonic_ns();
        let answer = bench.answer(scan_id)?;
        let took_ns = published(&answer, suite.role).saturating_sub(asked_ns);
        longest_ns = longest_ns.max(took_ns);
        late += usize::from(took_ns > suite.period_ns);
        bench.conclude(scan_id)?;
    }
    require(late <= SCANS / 10, || {
        format!("{late} of {SCANS} answers late; the slowest took {:.1} ms", longest_ns as f64 * 1e-6)
    })?;
    Ok(format!("{late} of {SCANS} answers late; the slowest took {:.1} ms", longest_ns as f64 * 1e-6))
}

fn header(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { first_scan: 20, ..Setup::default() })?;
    for _ in 0..10 {
        let scan_id = bench.scan_id;
        bench.wait_until_due(scan_id)?;
        let mut inputs = bench.inputs(scan_id)?;
        for message in &mut inputs {
            bench.publish(message)?;
        }
        bench.scan_id += 1;
        let answer = bench.answer(scan_id)?;
        bench.conclude(scan_id)?;
        let expected = inputs
            .iter()
            .skip(1)
            .fold(inputs[0].header().answer(), |header, input| header.answer_both(input.header()));
        carries_on(suite.role, answer.message.header(), &expected, bench.incarnation)?;
    }
    Ok("10 headers".to_owned())
}

/// That a header is that of an answer to `expected`.
fn carries_on(role: Role, header: &Header, expected: &Header, incarnation: u32) -> Result<(), Trouble> {
    require(header.incarnation == incarnation, || {
        format!("incarnation {} instead of {incarnation}", header.incarnation)
    })?;
    require(header.acquired_ns == expected.acquired_ns, || {
        format!("acquired_ns {} instead of {}", header.acquired_ns, expected.acquired_ns)
    })?;
    for stage in Role::ALL {
        let (theirs, ours) = (header.stage(*stage), expected.stage(*stage));
        let before = stage.index() < role.index();
        require(!before || theirs == ours, || {
            format!("stamps of stage {stage} changed: {theirs:?} instead of {ours:?}")
        })?;
    }
    let asked_ns = expected.chain.iter().map(|stamps| stamps.published_ns).max().unwrap_or(0);
    own_stamps(role, header, asked_ns)
}

/// That the stamps of the stage itself are in order and not before `asked_ns`.
pub(crate) fn own_stamps(role: Role, header: &Header, asked_ns: u64) -> Result<(), Trouble> {
    let own = header.stage(role);
    let order = [own.woken_ns, own.taken_ns, own.computed_ns, own.published_ns];
    require(own.woken_ns > 0 && order.is_sorted(), || format!("its own stamps are not in order: {own:?}"))?;
    let now = runtime::monotonic_ns();
    require((asked_ns..=now).contains(&own.published_ns), || {
        format!("published_ns {} is not between the input ({asked_ns}) and now ({now})", own.published_ns)
    })
}

fn valid_values(suite: &Suite) -> Verdict {
    // With a box in view, beside and behind.
    let first_scan = suite.drive(Course::Corridor)?.scan_at(3.2);
    let mut bench = suite.started(Setup { first_scan, ..Setup::default() })?;
    bench.rounds(SCANS)?;
    valid(&bench.received)?;
    Ok(format!("{} samples", bench.received.len()))
}

fn repeatable(suite: &Suite) -> Verdict {
    let mut runs = Vec::new();
    for _ in 0..2 {
        let mut bench = suite.started(Setup { lockstep: true, ..Setup::default() })?;
        runs.push(bench.rounds(SAME_SCANS)?);
    }
    same(&runs[0], &runs[1])?;
    Ok(format!("{SAME_SCANS} scans twice, same bits"))
}

/// That two runs gave the same answers.
pub(crate) fn same(one: &[Received], other: &[Received]) -> Result<(), Trouble> {
    let different =
        one.iter().zip(other).find(|(one, other)| one.message.content() != other.message.content());
    require(different.is_none() && one.len() == other.len(), || {
        let scan = different.map_or(0, |(one, _)| one.message.scan_id());
        format!("the answers to scan {scan} differ")
    })
}

fn state(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    let scans = bench.rounds(10)?;
    let of = |bench: &TestBench<'_>, scan_id: u64| {
        bench.checkpoints.iter().find(|checkpoint| checkpoint.header.scan_id == scan_id).copied()
    };
    let last = scans.last().map_or(0, |received| received.message.scan_id());
    bench.until(ANSWER_NS / 5, |bench| of(bench, last).is_some())?;
    for received in &scans {
        let scan_id = received.message.scan_id();
        let Some(checkpoint) = of(&bench, scan_id) else {
            return failed(format!("no state after scan {scan_id}"));
        };
        sound(&bench, &checkpoint)?;
    }
    let length = bench.checkpoints.last().map_or(0, |checkpoint| checkpoint.length);
    Ok(format!("10 states of {length} bytes"))
}

fn sound(bench: &TestBench<'_>, checkpoint: &Checkpoint) -> Result<(), Trouble> {
    let Checkpoint { header, role, length, state_layout, .. } = checkpoint;
    let whose = (*role, header.incarnation);
    require(whose == (bench.suite.role.wire(), bench.incarnation), || {
        format!("state of role {role}, incarnation {}", header.incarnation)
    })?;
    require((1..=CHECKPOINT_BYTES as u32).contains(length) && *state_layout != 0, || {
        format!("state of {length} bytes and layout {state_layout:#x}")
    })
}

fn resume(suite: &Suite) -> Verdict {
    let setup = Setup { lockstep: true, ..Setup::default() };
    let mut bench = suite.started(setup)?;
    let whole = bench.rounds(HANDOVER + 10)?;
    drop(bench);
    let mut bench = suite.started(setup)?;
    bench.rounds(HANDOVER)?;
    let checkpoint = newest_state(&mut bench, HANDOVER as u64)?;
    bench.replace()?;
    bench.spawn(true, Some(&checkpoint))?;
    bench.wait_for_state(shared_types::ProcessState::Connected)?;
    // What was said after the state was taken is said again to the successor.
    bench.conclude(HANDOVER as u64)?;
    let rest = bench.rounds(10)?;
    same(&whole[HANDOVER..], &rest)?;
    Ok(format!("{} bytes of state, 10 scans with the same bits", checkpoint.length))
}

/// The state after a scan.
fn newest_state(bench: &mut TestBench<'_>, scan_id: u64) -> Result<Checkpoint, Trouble> {
    let of = |bench: &TestBench<'_>| {
        bench.checkpoints.iter().rev().find(|checkpoint| checkpoint.header.scan_id == scan_id).copied()
    };
    bench.until(ANSWER_NS / 5, |bench| of(bench).is_some())?;
    of(bench).map_or_else(|| skipped("it publishes no state"), Ok)
}

fn lost_state(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { first_scan: 30, ..Setup::default() })?;
    bench.rounds(3)?;
    let scan_id = bench.scan_id - 1;
    newest_state(&mut bench, scan_id)?;
    bench.replace()?;
    bench.spawn(true, None)?;
    bench.wait_for_state(shared_types::ProcessState::Connected)?;
    bench.begin();
    bench.received.clear();
    for _ in 0..5 {
        let scan_id = bench.ask()?;
        bench.conclude(scan_id)?;
    }
    bench.receive_for(3.0)?;
    require(bench.received.is_empty(), || {
        format!("{} answers to 5 scans after its state was lost", bench.received.len())
    })?;
    Ok("no answer to 5 scans".to_owned())
}

fn published(received: &Received, role: Role) -> u64 {
    // A stamp that lies ahead of when it was heard is not believed.
    let stamp = received.message.header().stage(role).published_ns;
    if stamp == 0 { received.at_ns } else { stamp.min(received.at_ns) }
}

/// Numbers as ranges: `1-4 6 6 7`.
fn runs(numbers: &[u64]) -> String {
    let mut text = String::new();
    let mut rest = numbers;
    while let Some(first) = rest.first() {
        let length = rest.iter().zip(*first..).take_while(|(number, expected)| **number == *expected).count();
        let run =
            if length > 1 { format!("{first}-{}", first + length as u64 - 1) } else { first.to_string() };
        text = if text.is_empty() { run } else { format!("{text} {run}") };
        rest = &rest[length..];
    }
    text
}

/// Whether a role is asked by more than one topic.
pub(crate) fn joins(role: Role) -> bool {
    asking(role).len() > 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_shown_as_ranges() {
        assert_eq!(runs(&[1, 2, 3, 4, 6, 6, 7]), "1-4 6 6-7");
        assert_eq!(runs(&[]), "");
    }
}
