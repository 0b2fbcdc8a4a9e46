//! What a robot must measure and obey, whether it is emulated or a driver of a real one.
//!
//! Its motion is judged by its own odometry and its own stamps, so nothing depends on when the test bench polls.

pub(crate) mod device;
pub(crate) mod motion;

use shared_types::{Odometry, Phase, Scan, ScanGeometry, Topic};

use super::answers::{own_stamps, same_twice};
use super::case::{Verdict, observed, passed_if, require};
use super::ranges::valid;
use super::suite::Suite;
use super::test_bench::{ANSWER_NS, TestBench};

/// Scans of a case.
const SCANS: usize = 15;

pub(crate) fn scans(bench: &mut TestBench<'_>) -> Verdict {
    let odometry = bench.rounds(SCANS)?;
    bench.receive_for(0.5)?;
    let (scans, odometries) = (ids(bench, Topic::Scan), ids(bench, Topic::Odometry));
    require(scans == odometries, || format!("scans {scans:?}, but odometry {odometries:?}"))?;
    let in_order = scans.first() == Some(&1) && scans.is_sorted_by(|one, next| one < next);
    require(in_order, || format!("ids {scans:?}"))?;
    let (first, last) = (odometry[0].header(), odometry[SCANS - 1].header());
    let periods = (last.acquired_ns - first.acquired_ns) as f64 / bench.suite.period_ns as f64;
    let expected = (last.scan_id - first.scan_id) as f64;
    let measured = format!("ids {} to {} within {periods:.2} periods", first.scan_id, last.scan_id);
    passed_if((periods - expected).abs() <= 0.2 * expected, measured)
}

/// Scan ids of the samples of a topic.
fn ids(bench: &TestBench<'_>, topic: Topic) -> Vec<u64> {
    let of_topic = bench.received.iter().filter(|received| received.topic() == topic);
    of_topic.map(|received| received.scan_id()).collect()
}

pub(crate) fn header(bench: &mut TestBench<'_>) -> Verdict {
    bench.rounds(SCANS)?;
    let mut max_age_ms = 0.0_f64;
    for received in bench.received.iter().filter(|received| received.topic() != Topic::Truth) {
        let header = received.header();
        require(header.incarnation == bench.incarnation(), || format!("incarnation {}", header.incarnation))?;
        own_stamps(bench.suite.role, header, header.acquired_ns)?;
        let later = header.chain.iter().skip(1).any(|stamps| stamps.published_ns != 0);
        require(!later, || format!("scan {} carries stamps of stages behind it", header.scan_id))?;
        let age_ns = header.scan_published_ns() - header.acquired_ns;
        let age_ms = age_ns as f64 * 1e-6;
        max_age_ms = max_age_ms.max(age_ms);
        let (scan_id, is_new) = (header.scan_id, age_ns <= 2 * bench.suite.period_ns);
        let late = || format!("scan {scan_id} was {age_ms:.1} ms old when it was published");
        require(header.acquired_ns > 0 && is_new, late)?;
    }
    Ok(format!("at most {max_age_ms:.1} ms old"))
}

pub(crate) fn valid_values(bench: &mut TestBench<'_>) -> Verdict {
    bench.rounds(SCANS)?;
    let described = bench.suite.vehicle.description.scanner.geometry();
    for scan in bench.received.iter().filter_map(|received| received.get::<Scan>()) {
        let ScanGeometry { count, first_rad, increment_rad } = scan.geometry();
        let (first_off, increment_off) =
            (first_rad - described.first_rad, increment_rad - described.increment_rad);
        let is_described = count == described.count && first_off.abs().max(increment_off.abs()) <= 1e-6;
        let its = format!("{count} beams from {first_rad:.4} rad on, {increment_rad:.5} rad apart");
        require(is_described, || format!("a scan has {its}; `vehicle.scanner` describes {described:?}"))?;
    }
    valid(&bench.received, &bench.suite.vehicle.description.bounds)
}

pub(crate) fn increments(bench: &mut TestBench<'_>) -> Verdict {
    let all: Vec<Odometry> = bench.samples(SCANS)?;
    let (count, mut moved) = (all.len() - 1, 0);
    for [before, now] in all.array_windows() {
        let dt_s = (now.header.acquired_ns - before.header.acquired_ns) as f64 * 1e-9;
        let off = [now.dx_m - (now.x_m - before.x_m), now.dy_m - (now.y_m - before.y_m), now.dt_s - dt_s];
        let (scan_id, is_right) = (now.header.scan_id, off.iter().all(|off| off.abs() <= 1e-6));
        require(is_right, || format!("scan {scan_id}: dx, dy and dt are off by {off:?}"))?;
        moved += usize::from((now.x_m, now.y_m) != (before.x_m, before.y_m));
    }
    observed(moved >= SCANS / 3, || format!("the reported pose changed in {moved} of {count} scans"))?;
    Ok(format!("{count} increments, {moved} of them with a motion"))
}

pub(crate) fn stopping(bench: &mut TestBench<'_>) -> Verdict {
    bench.announce(Phase::Stopping)?;
    bench.receive_for(1.5)?;
    bench.received.clear();
    bench.receive_for(4.0)?;
    let scans = ids(bench, Topic::Scan).len();
    require(scans == 0, || format!("{scans} scans in the phase `stopping`"))?;
    Ok("no scan in four periods".to_owned())
}

pub(crate) fn truth(bench: &mut TestBench<'_>) -> Verdict {
    for received in bench.rounds(SCANS)? {
        let scan_id = received.scan_id();
        let has_truth = bench.until(ANSWER_NS / 5, |bench| ids(bench, Topic::Truth).contains(&scan_id))?;
        require(has_truth, || format!("no truth of scan {scan_id}"))?;
    }
    Ok(format!("{SCANS} truths"))
}

pub(crate) fn grants(bench: &mut TestBench<'_>) -> Verdict {
    let newest = |bench: &TestBench<'_>| ids(bench, Topic::Scan).into_iter().max().unwrap_or(0);
    bench.receive_for(2.0)?;
    require(newest(bench) == 0, || "a scan that was not granted")?;
    bench.round()?;
    bench.receive_for(2.0)?;
    require(newest(bench) == 1, || format!("scan {} after scan 1 alone was granted", newest(bench)))?;
    // The second scan is granted, and its answer is withheld.
    bench.order = None;
    bench.round()?;
    bench.direct(|directive| directive.granted_scan = 10)?;
    bench.receive_for(2.0)?;
    require(newest(bench) == 2, || format!("scan {} before scan 2 was answered", newest(bench)))?;
    Ok("2 scans granted, 2 published".to_owned())
}

pub(crate) fn repeatable(suite: &Suite) -> Verdict {
    same_twice(suite, |bench| {
        let last = bench.rounds(2 * SCANS)?.len() as u64;
        let mut received = std::mem::take(&mut bench.received);
        received.retain(|message| message.topic() != Topic::Truth && message.scan_id() <= last);
        received.sort_by_key(|message| (message.scan_id(), message.topic().name()));
        Ok(received)
    })?;
    Ok(format!("{} scans twice, same bits", 2 * SCANS))
}
