//! What drivers of real robots get wrong: clocks, jitter, gaps, restarts and broken sweeps of their devices.
//!
//! The robot is driven straight ahead, and what it publishes is checked. The test bench cannot disturb a device; a case
//! shows what a driver makes of a device that fails by itself while the case lasts.

use shared_types::{BEAMS, Header, MIN_RANGE_MM, Odometry, Scan, Topic};

use super::motion::FORWARD;
use crate::case::{Play, Trouble, Verdict, failed, observed, passed_if, require};
use crate::suite::{Setup, Suite};

/// Scans of a case.
const SCANS: usize = 50;
/// Share of a sweep that follows its front beam, with room for rounding.
const AFTER_FRONT: f64 = 0.45;
/// A scan with fewer returns is not compared, nor half of one with half as many.
const RETURNS: usize = 50;
/// With fewer pairs of scans that show what a case is about, it proves nothing.
const MIN_OBSERVED: usize = SCANS / 5;
/// A robot that moves less between two scans may see the same twice [m].
const MOVED_M: f64 = 0.005;
/// Way after which a base that counts from zero again would be seen [m].
const MIN_WAY_M: f64 = 0.2;
/// Below this speed way and time are not compared [m/s].
const DRIVING_MPS: f64 = 0.2;
/// How much the way between two stamps may differ from speed times time.
const WAY_ERROR: f64 = 0.25;
/// No robot turns by more between two scans [rad].
const TURN_RAD: f64 = 0.5;

/// The cases of drivers.
pub(crate) const CASES: [(&str, Play); 6] = [
    ("foreign-clock", foreign_clock),
    ("jitter", jitter),
    ("gaps", gaps),
    ("device-restart", device_restart),
    ("half-a-scan", half_a_scan),
    ("counts-up", counts_up),
];

/// What a robot that drives straight ahead publishes per scan.
fn measured(suite: &Suite) -> Result<Vec<(Scan, Odometry)>, Trouble> {
    let mut bench = suite.started(Setup::default())?;
    bench.order = FORWARD;
    let rounds = bench.rounds(SCANS)?;
    bench.turn()?;
    let mut measured = Vec::with_capacity(SCANS);
    for odometry in rounds {
        let scan_id = odometry.message.scan_id();
        let is_its = |topic, id| topic == Topic::Scan && id == scan_id;
        let mut received = bench.received.iter();
        let scan = received.find(|received| is_its(received.message.topic(), received.message.scan_id()));
        let Some(scan) = scan else { return failed(format!("no scan with the odometry of scan {scan_id}")) };
        measured.push((*scan.message.sample::<Scan>()?, *odometry.message.sample::<Odometry>()?));
    }
    Ok(measured)
}

fn foreign_clock(suite: &Suite) -> Verdict {
    let measured = measured(suite)?;
    let period_ms = suite.period_ns as f64 * 1e-6;
    let mut ages_ms = Vec::new();
    for (scan, odometry) in &measured {
        let least_ms = scan.sweep_ns as f64 * 1e-6 * AFTER_FRONT;
        for header in [&scan.header, &odometry.header] {
            let age_ms = age_ms(header);
            require((least_ms..=2.0 * period_ms).contains(&age_ms), || {
                format!("the front beam of scan {} was {age_ms:.1} ms before its publication", header.scan_id)
            })?;
        }
        ages_ms.push(age_ms(&scan.header));
    }
    let least = |ages: &[f64]| ages.iter().copied().fold(f64::INFINITY, f64::min);
    let (first, last) = (least(&ages_ms[..SCANS / 3]), least(&ages_ms[SCANS - SCANS / 3..]));
    passed_if(
        (last - first).abs() <= period_ms / 4.0,
        format!("the youngest scans are {first:.1} ms old at first and {last:.1} ms at last"),
    )
}

/// Time from the front beam to the publication [ms].
fn age_ms(header: &Header) -> f64 {
    (header.scan_published_ns() as f64 - header.acquired_ns as f64) * 1e-6
}

fn jitter(suite: &Suite) -> Verdict {
    let (mut count, mut off) = (0, 0);
    for pair in measured(suite)?.windows(2) {
        let ((_, before), (_, now)) = (&pair[0], &pair[1]);
        if before.speed_mps.min(now.speed_mps) < DRIVING_MPS {
            continue;
        }
        let expected_m = (before.speed_mps + now.speed_mps) / 2.0 * seconds(before, now);
        count += 1;
        off += usize::from((way_m(before, now) - expected_m).abs() > WAY_ERROR * expected_m.abs());
    }
    observed(count >= MIN_OBSERVED, || format!("it drove in {count} of {SCANS} scans"))?;
    passed_if(off <= count / 10, format!("way and time contradict the speed in {off} of {count} scans"))
}

/// Time between two stamps [s].
fn seconds(before: &Odometry, now: &Odometry) -> f64 {
    (now.header.acquired_ns as f64 - before.header.acquired_ns as f64) * 1e-9
}

/// Distance between two poses [m].
fn way_m(before: &Odometry, now: &Odometry) -> f64 {
    (now.x_m - before.x_m).hypot(now.y_m - before.y_m)
}

fn gaps(suite: &Suite) -> Verdict {
    let measured = measured(suite)?;
    let mut shown = 0;
    for pair in measured.windows(2) {
        let ((earlier, before), (scan, now)) = (&pair[0], &pair[1]);
        if returns(&scan.ranges_mm) < RETURNS || way_m(before, now) < MOVED_M {
            continue;
        }
        shown += 1;
        require(scan.ranges_mm != earlier.ranges_mm, || {
            format!("scan {} repeats the ranges of the scan before", scan.header.scan_id)
        })?;
    }
    let missing = measured.iter().filter(|(scan, _)| scan.missing.is_set()).count();
    if missing <= SCANS / 2 {
        observed(shown >= MIN_OBSERVED, || {
            format!("it moved and saw something in {shown} of {SCANS} scans")
        })?;
    }
    passed_if(
        missing <= SCANS / 2,
        format!("{missing} of {SCANS} scans are marked as missing, no ranges repeat"),
    )
}

/// How many beams have a return.
fn returns(ranges_mm: &[u16]) -> usize {
    ranges_mm.iter().filter(|range| **range >= MIN_RANGE_MM).count()
}

fn device_restart(suite: &Suite) -> Verdict {
    let measured = measured(suite)?;
    let mut farthest_m = 0.0_f64;
    for pair in measured.windows(2) {
        let ((_, before), (_, now)) = (&pair[0], &pair[1]);
        let (way_m, turn_rad) = (way_m(before, now), (now.yaw_rad - before.yaw_rad).sin().abs());
        let allowed_m = 2.0 * before.speed_mps.abs().max(now.speed_mps.abs()) * seconds(before, now) + 0.05;
        require(way_m <= allowed_m && turn_rad <= TURN_RAD, || {
            format!(
                "it jumps by {way_m:.2} m and {turn_rad:.2} rad at scan {}, {allowed_m:.2} m are possible",
                now.header.scan_id
            )
        })?;
        farthest_m = farthest_m.max(way_m);
    }
    let moved_m = way_m(&measured[0].1, &measured[SCANS - 1].1);
    observed(moved_m >= MIN_WAY_M, || format!("its pose moved by {moved_m:.3} m: a restart would not show"))?;
    Ok(format!("at most {farthest_m:.3} m between two scans"))
}

fn half_a_scan(suite: &Suite) -> Verdict {
    let mut scans = measured(suite)?;
    scans.retain(|(scan, _)| !scan.missing.is_set());
    let (mut shown, mut most) = (0, 0);
    for pair in scans.windows(2) {
        let ((earlier, before), (scan, now)) = (&pair[0], &pair[1]);
        let halves = [0..BEAMS / 2, BEAMS / 2..BEAMS];
        let sees = halves.each_ref().map(|half| returns(&scan.ranges_mm[half.clone()]) >= RETURNS / 2);
        let [first, second] = [0, 1].map(|index| {
            let half = halves[index].clone();
            sees[index] && earlier.ranges_mm[half.clone()] == scan.ranges_mm[half]
        });
        require(first == second, || {
            format!("half of scan {} is that of the scan before", scan.header.scan_id)
        })?;
        shown += usize::from(sees.contains(&true) && way_m(before, now) >= MOVED_M);
        most = most.max(empty_end(scan).abs_diff(empty_end(earlier)));
    }
    // A robot that turns sees less and less at an end; half of a sweep is away at once.
    if most <= BEAMS / 4 {
        observed(shown >= MIN_OBSERVED, || {
            format!("it moved and saw something in {shown} of {SCANS} scans")
        })?;
    }
    passed_if(
        !scans.is_empty() && most <= BEAMS / 4,
        format!(
            "{} scans; at most {most} beams at an end are zero that were not in the scan before",
            scans.len()
        ),
    )
}

/// Beams of zeros at the end of a scan that has more of them.
fn empty_end(scan: &Scan) -> usize {
    let zeros = |beams: &mut dyn Iterator<Item = &u16>| beams.take_while(|range| **range == 0).count();
    zeros(&mut scan.ranges_mm.iter()).max(zeros(&mut scan.ranges_mm.iter().rev()))
}

fn counts_up(suite: &Suite) -> Verdict {
    let measured = measured(suite)?;
    for (scan, odometry) in &measured {
        let (one, other) = (scan.header.acquired_ns, odometry.header.acquired_ns);
        require(one == other, || {
            format!("scan {} is stamped {one}, its odometry {other}", scan.header.scan_id)
        })?;
    }
    for headers in [
        measured.iter().map(|(scan, _)| scan.header).collect::<Vec<_>>(),
        measured.iter().map(|(_, odometry)| odometry.header).collect(),
    ] {
        headers.windows(2).try_for_each(|pair| ascends(&pair[0], &pair[1]))?;
    }
    Ok(format!("{SCANS} scans"))
}

/// Requires that one header may follow another.
fn ascends(before: &Header, now: &Header) -> Result<(), Trouble> {
    require(
        now.sequence > before.sequence && now.sequence - before.sequence <= now.scan_id - before.scan_id,
        || format!("sequence {} of scan {} follows {}", now.sequence, now.scan_id, before.sequence),
    )?;
    require(now.scan_id > before.scan_id && now.acquired_ns > before.acquired_ns, || {
        let back_ms = (before.acquired_ns as f64 - now.acquired_ns as f64) * 1e-6;
        format!("the stamp of scan {} is {back_ms:.1} ms before that of scan {}", now.scan_id, before.scan_id)
    })
}
