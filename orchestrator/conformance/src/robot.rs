//! What a robot must measure and obey, whether it is emulated or a driver of a real one.
//!
//! Its motion is judged by its own odometry and its own stamps, so nothing depends on when the test bench polls.

pub(crate) mod device;
mod motion;

use shared_types::{Odometry, Phase, Topic};

use super::answers::{own_stamps, same_twice};
use super::case::{Play, Trouble, Verdict, failed, observed, passed_if, require};
use super::ranges::valid;
use super::suite::{Setup, Suite};
use super::test_bench::{ANSWER_NS, Order, TestBench};

/// Scans of a case.
const SCANS: usize = 15;
/// The cases of robots.
pub(crate) const CASES: [(&str, Play); 14] = [
    ("scans", scans),
    ("header", header),
    ("valid-values", valid_values),
    ("increments", increments),
    ("drives", motion::drives),
    ("blocks", motion::blocks),
    ("dead-man", motion::dead_man),
    ("authority", motion::authority),
    ("nonsense", motion::nonsense),
    ("repeated", motion::repeated),
    ("stopping", stopping),
    ("truth", truth),
    ("grants", grants),
    ("repeatable", repeatable),
];

fn scans(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    let odometry = bench.rounds(SCANS)?;
    bench.receive_for(0.5)?;
    let (scans, odometries) = (ids(&bench, Topic::Scan), ids(&bench, Topic::Odometry));
    require(scans == odometries, || format!("scans {scans:?}, but odometry {odometries:?}"))?;
    require(scans.first() == Some(&1) && scans.is_sorted_by(|one, next| one < next), || {
        format!("ids {scans:?}")
    })?;
    let (first, last) = (odometry[0].message.header(), odometry[SCANS - 1].message.header());
    let periods = (last.acquired_ns - first.acquired_ns) as f64 / suite.period_ns as f64;
    let expected = (last.scan_id - first.scan_id) as f64;
    passed_if(
        (periods - expected).abs() <= 0.2 * expected,
        format!("ids {} to {} within {periods:.2} periods", first.scan_id, last.scan_id),
    )
}

/// Scan ids of the samples of a topic.
fn ids(bench: &TestBench<'_>, topic: Topic) -> Vec<u64> {
    let of_topic = bench.received.iter().filter(|received| received.message.topic() == topic);
    of_topic.map(|received| received.message.scan_id()).collect()
}

fn header(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    bench.rounds(SCANS)?;
    let mut max_age_ms = 0.0_f64;
    for received in bench.received.iter().filter(|received| received.message.topic() != Topic::Truth) {
        let header = received.message.header();
        require(header.incarnation == bench.incarnation, || format!("incarnation {}", header.incarnation))?;
        own_stamps(suite.role, header, header.acquired_ns)?;
        let later = header.chain.iter().skip(1).any(|stamps| stamps.published_ns != 0);
        require(!later, || format!("scan {} carries stamps of stages behind it", header.scan_id))?;
        let age_ns = header.scan_published_ns() - header.acquired_ns;
        let age_ms = age_ns as f64 * 1e-6;
        max_age_ms = max_age_ms.max(age_ms);
        require(header.acquired_ns > 0 && age_ns <= 2 * suite.period_ns, || {
            format!("scan {} was {age_ms:.1} ms old when it was published", header.scan_id)
        })?;
    }
    Ok(format!("at most {max_age_ms:.1} ms old"))
}

fn valid_values(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    bench.rounds(SCANS)?;
    valid(&bench.received)
}

fn increments(suite: &Suite) -> Verdict {
    let all = odometry(&mut suite.started(Setup::default())?, SCANS)?;
    for pair in all.windows(2) {
        let (before, now) = (&pair[0], &pair[1]);
        let dt_s = (now.header.acquired_ns - before.header.acquired_ns) as f64 * 1e-9;
        let off = [now.dx_m - (now.x_m - before.x_m), now.dy_m - (now.y_m - before.y_m), now.dt_s - dt_s];
        require(off.iter().all(|off| off.abs() <= 1e-6), || {
            format!("scan {}: dx, dy and dt are off by {off:?}", now.header.scan_id)
        })?;
    }
    let moved =
        all.windows(2).filter(|pair| (pair[1].x_m, pair[1].y_m) != (pair[0].x_m, pair[0].y_m)).count();
    observed(moved >= SCANS / 3, || {
        format!("the reported pose changed in {moved} of {} scans", all.len() - 1)
    })?;
    Ok(format!("{} increments, {moved} of them with a motion", all.len() - 1))
}

fn stopping(suite: &Suite) -> Verdict {
    let mut bench = motion::driving(suite)?;
    bench.announce(Phase::Stopping)?;
    bench.receive_for(1.5)?;
    bench.received.clear();
    bench.receive_for(4.0)?;
    let scans = ids(&bench, Topic::Scan).len();
    require(scans == 0, || format!("{scans} scans in the phase `stopping`"))?;
    Ok("no scan in four periods".to_owned())
}

fn truth(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    for received in bench.rounds(SCANS)? {
        let scan_id = received.message.scan_id();
        if !bench.until(ANSWER_NS / 5, |bench| ids(bench, Topic::Truth).contains(&scan_id))? {
            return failed(format!("no truth of scan {scan_id}"));
        }
    }
    Ok(format!("{SCANS} truths"))
}

fn grants(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { lockstep: true, ..Setup::default() })?;
    let newest = |bench: &TestBench<'_>| ids(bench, Topic::Scan).into_iter().max().unwrap_or(0);
    bench.receive_for(2.0)?;
    require(newest(&bench) == 0, || "a scan that was not granted".to_owned())?;
    bench.round()?;
    bench.receive_for(2.0)?;
    require(newest(&bench) == 1, || format!("scan {} after scan 1 alone was granted", newest(&bench)))?;
    // The second scan is granted, and its answer is withheld.
    bench.order = Order::Silence;
    bench.round()?;
    bench.direct(|directive| directive.granted_scan = 10)?;
    bench.receive_for(2.0)?;
    require(newest(&bench) == 2, || format!("scan {} before scan 2 was answered", newest(&bench)))?;
    Ok("2 scans granted, 2 published".to_owned())
}

fn repeatable(suite: &Suite) -> Verdict {
    same_twice(suite, |bench| {
        let last = bench.rounds(2 * SCANS)?.len() as u64;
        let mut received = std::mem::take(&mut bench.received);
        received.retain(|received| {
            received.message.topic() != Topic::Truth && received.message.scan_id() <= last
        });
        received.sort_by_key(|received| (received.message.scan_id(), received.message.topic().name()));
        Ok(received)
    })?;
    Ok(format!("{} scans twice, same bits", 2 * SCANS))
}

/// The odometry of the next round.
fn next(bench: &mut TestBench<'_>) -> Result<Odometry, Trouble> {
    bench.round()?.message.sample().copied()
}

/// The odometry of some rounds.
fn odometry(bench: &mut TestBench<'_>, count: usize) -> Result<Vec<Odometry>, Trouble> {
    (0..count).map(|_| next(bench)).collect()
}
