//! What drivers of real robots get wrong: clocks, jitter, gaps, restarts and broken sweeps of their devices.
//!
//! The robot is driven straight ahead, and what it publishes is checked. The test bench cannot disturb a device; a case
//! shows what a driver makes of a device that fails by itself while the case lasts.

use shared_types::{Header, MIN_RANGE_MM, Odometry, Scan};

use crate::case::{Tried, Verdict, failed, observed, passed_if, require};
use crate::test_bench::TestBench;

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

/// What a robot that drives straight ahead publishes per scan.
fn measured(bench: &mut TestBench<'_>) -> Tried<Vec<(Scan, Odometry)>> {
    bench.order = Some(bench.forward());
    let rounds: Vec<Odometry> = bench.samples(SCANS)?;
    bench.turn()?;
    let scans = bench.received.iter().filter_map(|received| received.get::<Scan>());
    let with_scan = |odometry: Odometry| {
        let scan_id = odometry.header.scan_id;
        let scan = scans.clone().find(|scan| scan.header.scan_id == scan_id);
        let Some(scan) = scan else { return failed(format!("no scan with the odometry of scan {scan_id}")) };
        Ok((*scan, odometry))
    };
    rounds.into_iter().map(with_scan).collect()
}

pub(crate) fn foreign_clock(bench: &mut TestBench<'_>) -> Verdict {
    let period_ms = bench.suite.period_ns as f64 * 1e-6;
    let mut ages_ms = Vec::new();
    for (scan, odometry) in measured(bench)? {
        let least_ms = scan.sweep_ns as f64 * 1e-6 * AFTER_FRONT;
        for header in [&scan.header, &odometry.header] {
            let (scan_id, age_ms) = (header.scan_id, age_ms(header));
            let other =
                || format!("the front beam of scan {scan_id} was {age_ms:.1} ms before its publication");
            require((least_ms..=2.0 * period_ms).contains(&age_ms), other)?;
        }
        ages_ms.push(age_ms(&scan.header));
    }
    let least = |ages: &[f64]| ages.iter().copied().fold(f64::INFINITY, f64::min);
    let (first, last) = (least(&ages_ms[..SCANS / 3]), least(&ages_ms[SCANS - SCANS / 3..]));
    let measured = format!("the youngest scans are {first:.1} ms old at first and {last:.1} ms at last");
    passed_if((last - first).abs() <= period_ms / 4.0, measured)
}

/// Time from the front beam to the publication [ms].
fn age_ms(header: &Header) -> f64 {
    (header.scan_published_ns() as f64 - header.acquired_ns as f64) * 1e-6
}

pub(crate) fn jitter(bench: &mut TestBench<'_>) -> Verdict {
    let (mut count, mut off) = (0, 0);
    for [(_, before), (_, now)] in measured(bench)?.array_windows() {
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

pub(crate) fn gaps(bench: &mut TestBench<'_>) -> Verdict {
    let measured = measured(bench)?;
    let mut shown = 0;
    for [(earlier, before), (scan, now)] in measured.array_windows() {
        if returns(scan.ranges()) < RETURNS || way_m(before, now) < MOVED_M {
            continue;
        }
        shown += 1;
        let (scan_id, is_new) = (scan.header.scan_id, scan.ranges() != earlier.ranges());
        require(is_new, || format!("scan {scan_id} repeats the ranges of the scan before"))?;
    }
    let missing = measured.iter().filter(|(scan, _)| scan.missing.is_set()).count();
    let found = format!("{missing} of {SCANS} scans are marked as missing, no ranges repeat");
    passed_if_shown(missing <= SCANS / 2, shown, found)
}

/// Passes with what was measured if the requirement `holds`, and enough scans have `shown` what it is about.
fn passed_if_shown(holds: bool, shown: usize, measured: String) -> Verdict {
    let is_shown = !holds || shown >= MIN_OBSERVED;
    observed(is_shown, || format!("it moved and saw something in {shown} of {SCANS} scans"))?;
    passed_if(holds, measured)
}

/// How many beams have a return.
fn returns(ranges_mm: &[u32]) -> usize {
    ranges_mm.iter().filter(|range| **range >= MIN_RANGE_MM).count()
}

pub(crate) fn device_restart(bench: &mut TestBench<'_>) -> Verdict {
    let measured = measured(bench)?;
    let mut farthest_m = 0.0_f64;
    for [(_, before), (_, now)] in measured.array_windows() {
        let (way_m, turn_rad) = (way_m(before, now), (now.yaw_rad - before.yaw_rad).sin().abs());
        let allowed_m = 2.0 * before.speed_mps.abs().max(now.speed_mps.abs()) * seconds(before, now) + 0.05;
        let (scan_id, jump) = (now.header.scan_id, format!("{way_m:.2} m and {turn_rad:.2} rad"));
        let jumps = || format!("it jumps by {jump} at scan {scan_id}, {allowed_m:.2} m are possible");
        require(way_m <= allowed_m && turn_rad <= TURN_RAD, jumps)?;
        farthest_m = farthest_m.max(way_m);
    }
    let moved_m = way_m(&measured[0].1, &measured[SCANS - 1].1);
    observed(moved_m >= MIN_WAY_M, || format!("its pose moved by {moved_m:.3} m: a restart would not show"))?;
    Ok(format!("at most {farthest_m:.3} m between two scans"))
}

pub(crate) fn half_a_scan(bench: &mut TestBench<'_>) -> Verdict {
    let mut scans = measured(bench)?;
    scans.retain(|(scan, _)| !scan.missing.is_set());
    let (mut shown, mut most) = (0, 0);
    for [(earlier, before), (scan, now)] in scans.array_windows() {
        let beams = scan.ranges().len().min(earlier.ranges().len());
        let halves = [0..beams / 2, beams / 2..beams];
        let sees = halves.each_ref().map(|half| returns(&scan.ranges_mm[half.clone()]) >= RETURNS / 2);
        let [first, second] = [0, 1].map(|index| {
            let half = halves[index].clone();
            sees[index] && earlier.ranges_mm[half.clone()] == scan.ranges_mm[half]
        });
        let scan_id = scan.header.scan_id;
        require(first == second, || format!("half of scan {scan_id} is that of the scan before"))?;
        // A body that the robot passed, or turned away from.
        let at_once = (beams / 8).max((TURN_RAD / scan.increment_rad.abs().max(1e-3)) as usize);
        let sees_enough = halves.iter().any(|half| returns(&earlier.ranges_mm[half.clone()]) > at_once);
        shown += usize::from(sees_enough && way_m(before, now) >= MOVED_M);
        let gone = gone_at_an_end(earlier, scan);
        require(gone <= at_once, || format!("{gone} returns at an end of scan {scan_id} are gone at once"))?;
        most = most.max(gone);
    }
    let found = format!("at most {most} returns at an end are gone at once");
    passed_if_shown(true, shown, format!("{} scans; {found}", scans.len()))
}

/// Beams of zeros at the end of a scan, of the end where more of them had a return in the scan before: how many had.
fn gone_at_an_end(earlier: &Scan, scan: &Scan) -> usize {
    let had = |beams: &mut dyn Iterator<Item = (&u32, &u32)>| {
        let zeros = beams.take_while(|(_, range)| **range == 0);
        zeros.filter(|(before, _)| **before >= MIN_RANGE_MM).count()
    };
    let pairs = || earlier.ranges().iter().zip(scan.ranges());
    had(&mut pairs()).max(had(&mut pairs().rev()))
}

pub(crate) fn counts_up(bench: &mut TestBench<'_>) -> Verdict {
    let measured = measured(bench)?;
    for (scan, odometry) in &measured {
        let (one, other, scan_id) =
            (scan.header.acquired_ns, odometry.header.acquired_ns, scan.header.scan_id);
        require(one == other, || format!("scan {scan_id} is stamped {one}, its odometry {other}"))?;
    }
    let (scans, rounds): (Vec<_>, Vec<_>) =
        measured.iter().map(|(scan, odometry)| (scan.header, odometry.header)).unzip();
    for [before, now] in scans.array_windows().chain(rounds.array_windows()) {
        ascends(before, now)?;
    }
    Ok(format!("{SCANS} scans"))
}

/// Requires that one header may follow another.
fn ascends(before: &Header, now: &Header) -> Tried {
    let (sequence, scan_id) = (now.sequence, now.scan_id);
    let counts = sequence > before.sequence && sequence - before.sequence <= scan_id - before.scan_id;
    require(counts, || format!("sequence {sequence} of scan {scan_id} follows {}", before.sequence))?;
    let (other, back_ms) = (before.scan_id, (before.acquired_ns as f64 - now.acquired_ns as f64) * 1e-6);
    let goes_back = || format!("the stamp of scan {scan_id} is {back_ms:.1} ms before that of scan {other}");
    require(scan_id > before.scan_id && now.acquired_ns > before.acquired_ns, goes_back)
}
