//! What the answers of the four roles behind the robot have in common: one per scan, in time, with the header of what
//! they answer.

use shared_types::{CHECKPOINT_BYTES, Checkpoint, Header, Role};

use super::case::{Tried, Trouble, Verdict, failed, passed_if, require};
use super::drive::Course;
use super::message::Message;
use super::ranges::valid;
use super::suite::{Setup, Suite};
use super::test_bench::{ANSWER_NS, TestBench};

/// Scans of a case that counts answers.
const SCANS: usize = 20;
/// Scans of two runs that are compared to the last bit.
const SAME_SCANS: usize = 40;
/// After this scan a successor takes over.
const HANDOVER: usize = 20;

pub(crate) fn every_scan(bench: &mut TestBench<'_>) -> Verdict {
    bench.rounds(SCANS)?;
    bench.receive_for(3.0)?;
    let answers = bench.received.iter().filter(|received| received.is_answer());
    let ids: Vec<u64> = answers.map(|received| received.scan_id()).collect();
    let expected: Vec<u64> = (1..=SCANS as u64).collect();
    require(ids == expected, || format!("{} answers to {SCANS} scans: {}", ids.len(), ranges(&ids)))?;
    for (index, received) in bench.received.iter().enumerate() {
        let sequence = received.header().sequence;
        require(sequence == index as u64 + 1, || format!("sequence {sequence} on sample {}", index + 1))?;
    }
    Ok(format!("{SCANS} scans, {SCANS} answers"))
}

pub(crate) fn in_time(bench: &mut TestBench<'_>) -> Verdict {
    // The first answer may take longer: caches are cold, libraries are loaded.
    bench.round()?;
    bench.begin();
    let (mut late, mut slowest_ns) = (0, 0);
    for _ in 0..SCANS {
        bench.ask()?;
        let asked_ns = runtime::monotonic_ns();
        let took_ns = published_ns(&bench.finish()?, bench.suite.role).saturating_sub(asked_ns);
        slowest_ns = slowest_ns.max(took_ns);
        late += usize::from(took_ns > bench.suite.period_ns);
    }
    let slowest_ms = slowest_ns as f64 * 1e-6;
    let measured = format!("{late} of {SCANS} answers late; the slowest took {slowest_ms:.1} ms");
    passed_if(late <= SCANS / 10, measured)
}

pub(crate) fn header(bench: &mut TestBench<'_>) -> Verdict {
    for _ in 0..10 {
        let inputs = bench.ask_with(|_| {})?;
        let answer = bench.finish()?;
        let first = inputs[0].header().answer();
        let expected = inputs[1..].iter().fold(first, |header, input| header.answer_both(input.header()));
        extends(bench.suite.role, answer.header(), &expected, bench.incarnation())?;
    }
    Ok("10 headers".to_owned())
}

/// Requires that a header is that of an answer to `expected`.
fn extends(role: Role, header: &Header, expected: &Header, incarnation: u32) -> Tried {
    let found = header.incarnation;
    require(found == incarnation, || format!("incarnation {found} instead of {incarnation}"))?;
    let (found, expected_ns) = (header.acquired_ns, expected.acquired_ns);
    require(found == expected_ns, || format!("acquired_ns {found} instead of {expected_ns}"))?;
    for stage in Role::ALL.iter().filter(|stage| stage.index() < role.index()) {
        let (theirs, ours) = (header.stage(*stage), expected.stage(*stage));
        let changed = || format!("stamps of stage {stage} changed: {theirs:?} instead of {ours:?}");
        require(theirs == ours, changed)?;
    }
    let asked_ns = expected.chain.iter().map(|stamps| stamps.published_ns).max().unwrap_or(0);
    own_stamps(role, header, asked_ns)
}

/// Requires that the stamps of the stage itself are in order and not before `asked_ns`.
pub(crate) fn own_stamps(role: Role, header: &Header, asked_ns: u64) -> Tried {
    let own = header.stage(role);
    let order = [own.woken_ns, own.taken_ns, own.computed_ns, own.published_ns];
    require(own.woken_ns > 0 && order.is_sorted(), || format!("its own stamps are not in order: {own:?}"))?;
    let (now, published_ns) = (runtime::monotonic_ns(), own.published_ns);
    let wrong =
        || format!("published_ns {published_ns} is not between the input ({asked_ns}) and now ({now})");
    require((asked_ns..=now).contains(&published_ns), wrong)
}

pub(crate) fn valid_values(suite: &Suite) -> Verdict {
    // The box is in view, then next to the robot, then behind it.
    let mut bench = suite.started_on(Course::Corridor, suite.drive(Course::Corridor)?.scan_at(3.2))?;
    bench.rounds(SCANS)?;
    valid(&bench.received, &suite.vehicle.description.bounds)
}

pub(crate) fn repeatable(suite: &Suite) -> Verdict {
    same_twice(suite, |bench| bench.rounds(SAME_SCANS))?;
    Ok(format!("{SAME_SCANS} scans twice, same bits"))
}

/// Requires that two runs in lock-step give the same samples.
pub(crate) fn same_twice(suite: &Suite, run: impl Fn(&mut TestBench<'_>) -> Tried<Vec<Message>>) -> Tried {
    let run = || run(&mut suite.started(Setup { lockstep: true, ..Setup::default() })?);
    same(&run()?, &run()?)
}

/// Requires that two runs gave the same samples.
fn same(one: &[Message], other: &[Message]) -> Tried {
    let different = one.iter().zip(other).find(|(one, other)| one.content() != other.content());
    let scan = different.map_or(0, |(one, _)| one.scan_id());
    let is_same = different.is_none() && one.len() == other.len();
    require(is_same, || format!("the answers to scan {scan} differ"))
}

pub(crate) fn state(bench: &mut TestBench<'_>) -> Verdict {
    let scans = bench.rounds(10)?;
    let last = bench.scan_id - 1;
    bench.until(ANSWER_NS / 5, |bench| state_after(bench, last).is_some())?;
    for received in &scans {
        let scan_id = received.scan_id();
        let Some(checkpoint) = state_after(bench, scan_id) else {
            return failed(format!("no state after scan {scan_id}"));
        };
        sound(bench, &checkpoint)?;
    }
    let length = bench.checkpoints.last().map_or(0, |checkpoint| checkpoint.length);
    Ok(format!("10 states of {length} bytes"))
}

fn sound(bench: &TestBench<'_>, checkpoint: &Checkpoint) -> Tried {
    let Checkpoint { header, role, length, state_layout, .. } = checkpoint;
    let incarnation = header.incarnation;
    let is_its = *role == bench.suite.role.wire() && incarnation == bench.incarnation();
    require(is_its, || format!("state of role {role}, incarnation {incarnation}"))?;
    let is_whole = (1..=CHECKPOINT_BYTES as u32).contains(length) && *state_layout != 0;
    require(is_whole, || format!("state of {length} bytes and layout {state_layout:#x}"))
}

pub(crate) fn resume(suite: &Suite) -> Verdict {
    let setup = Setup { lockstep: true, ..Setup::default() };
    let whole = suite.started(setup)?.rounds(HANDOVER + 10)?;
    let mut bench = suite.started(setup)?;
    bench.rounds(HANDOVER)?;
    let checkpoint = wait_for_state_after(&mut bench, HANDOVER as u64)?;
    bench.replace(true, Some(&checkpoint))?;
    // The successor gets what was published after the state was taken.
    bench.conclude(HANDOVER as u64)?;
    same(&whole[HANDOVER..], &bench.rounds(10)?)?;
    Ok(format!("{} bytes of state, 10 scans with the same bits", checkpoint.length))
}

/// The state after a scan, if it was published.
fn state_after(bench: &TestBench<'_>, scan_id: u64) -> Option<Checkpoint> {
    bench.checkpoints.iter().rev().find(|checkpoint| checkpoint.header.scan_id == scan_id).copied()
}

/// The state after a scan; skips the case without one.
fn wait_for_state_after(bench: &mut TestBench<'_>, scan_id: u64) -> Tried<Checkpoint> {
    let state = bench.find(ANSWER_NS / 5, |bench| state_after(bench, scan_id))?;
    state.ok_or_else(|| Trouble::Skipped("it publishes no state".to_owned()))
}

pub(crate) fn lost_state(bench: &mut TestBench<'_>) -> Verdict {
    bench.rounds(3)?;
    let scan_id = bench.scan_id - 1;
    wait_for_state_after(bench, scan_id)?;
    bench.replace(true, None)?;
    for _ in 0..5 {
        let scan_id = bench.ask()?;
        bench.conclude(scan_id)?;
    }
    bench.receive_for(3.0)?;
    let count = bench.received.len();
    require(count == 0, || format!("{count} answers to 5 scans after its state was lost"))?;
    Ok("no answer to 5 scans".to_owned())
}

/// When a sample was published; a stamp after its reception is not believed [ns].
fn published_ns(received: &Message, role: Role) -> u64 {
    let stamp = received.header().stage(role).published_ns;
    if stamp == 0 { received.received_ns } else { stamp.min(received.received_ns) }
}

/// Numbers as ranges: `1-4 6 6 7`.
fn ranges(numbers: &[u64]) -> String {
    let mut texts = Vec::new();
    let mut rest = numbers;
    while let Some(first) = rest.first() {
        let length = rest.iter().zip(*first..).take_while(|(number, expected)| **number == *expected).count();
        let last = first + length as u64 - 1;
        texts.push(if length > 1 { format!("{first}-{last}") } else { first.to_string() });
        rest = &rest[length..];
    }
    texts.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_shown_as_ranges() {
        assert_eq!(ranges(&[1, 2, 3, 4, 6, 6, 7]), "1-4 6 6-7");
        assert_eq!(ranges(&[]), "");
    }
}
