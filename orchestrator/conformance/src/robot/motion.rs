//! How a robot obeys actuations: which move it, and what it does without one.

use std::iter::repeat_n;

use shared_types::{Actuation, Odometry};
use supervision::private_system::Order;
use vehicle::frame::wrap_angle;

use super::SCANS;
use crate::case::{Tried, Verdict, passed_if, require};
use crate::test_bench::{FOREIGN, TestBench};

/// Below this speed the robot is at rest [m/s].
const STANDSTILL_MPS: f64 = 1e-3;
/// Blocked wheels are at rest after so many times of what it takes.
const STOPPING: f64 = 2.5;
/// Plays a scan.
type Round<'a> = dyn FnMut(&mut TestBench<'_>) -> Tried<Odometry> + 'a;

/// Changes that make nonsense of an actuation.
const NONSENSE: [fn(&mut Actuation); 5] = [
    |actuation| actuation.sent_velocity_mps = f64::NAN,
    |actuation| actuation.sent_velocity_mps = 50.0,
    |actuation| actuation.sent_velocity_mps = -50.0,
    |actuation| actuation.sent_steering_rad = 3.0,
    |actuation| actuation.kind = 77,
];

pub(crate) fn drives(bench: &mut TestBench<'_>) -> Verdict {
    let vehicle = &bench.suite.vehicle;
    let forwards = drives_by(bench, vehicle.mps(0.7))?;
    if vehicle.description.bounds.mirrored().is_none() {
        return Ok(forwards);
    }
    bench.order = Some(Order::Block);
    is_at_rest(
        &speeds_for(bench, vehicle.stopping_ns(STOPPING), &mut next)?,
        "before it is told to drive backwards",
    )?;
    Ok(format!("{forwards}; {}", drives_by(bench, vehicle.back_mps(0.3))?))
}

/// Passes when it moves in the direction of a velocity [m/s], steered to the left.
fn drives_by(bench: &mut TestBench<'_>, velocity_mps: f64) -> Verdict {
    let steering_rad = bench.suite.vehicle.description.bounds.steering_max_rad.min(0.05);
    bench.order = Some(Order::Drive(velocity_mps, steering_rad));
    let all: Vec<Odometry> = bench.samples(2 * SCANS)?;
    let (first, last) = (&all[0], &all[all.len() - 1]);
    let (sin, cos) = first.yaw_rad.sin_cos();
    let ahead_m = (last.x_m - first.x_m) * cos + (last.y_m - first.y_m) * sin;
    let turned_rad = wrap_angle(last.yaw_rad - first.yaw_rad);
    let way = format!("{ahead_m:.2} m forward, {turned_rad:.3} rad to the left");
    let side = velocity_mps.signum();
    let is_right = last.speed_mps * side > (velocity_mps * side / 3.0).min(0.1)
        && ahead_m * side > 0.0
        && turned_rad * side > 0.0;
    passed_if(is_right, format!("{:.2} m/s, {way}", last.speed_mps))
}

pub(crate) fn blocks(bench: &mut TestBench<'_>) -> Verdict {
    bench.order = Some(Order::Block);
    let speeds = speeds_for(bench, bench.suite.vehicle.stopping_ns(STOPPING), &mut next)?;
    let rising = speeds.array_windows().any(|[before, now]| *now > before + STANDSTILL_MPS);
    require(!rising, || format!("its speed rises with blocked wheels: {speeds:?}"))?;
    is_at_rest(&speeds, "after blocking the wheels")
}

pub(crate) fn dead_man(bench: &mut TestBench<'_>) -> Verdict {
    stops_without_orders(bench, "after two periods without an actuation", &mut next)
}

pub(crate) fn authority(bench: &mut TestBench<'_>) -> Verdict {
    let disown = |actuation: &mut Actuation| actuation.header.incarnation = FOREIGN;
    ignores(bench, "an actuation without authority", 8, &[disown])
}

pub(crate) fn nonsense(bench: &mut TestBench<'_>) -> Verdict {
    ignores(bench, "nonsense", 2, &NONSENSE)?;
    let mut scans = 0;
    stops_without_orders(bench, "with nothing but nonsense for two periods", &mut |bench| {
        scans += 1;
        publish_changed(bench, NONSENSE[(scans - 1) % NONSENSE.len()])
    })
}

pub(crate) fn repeated(bench: &mut TestBench<'_>) -> Verdict {
    let again = bench.last_actuation.clone();
    stops_without_orders(bench, "with nothing but the same actuation for two periods", &mut |bench| {
        let odometry = next(bench)?;
        again.iter().try_for_each(|again| bench.publish_exactly(again))?;
        Ok(odometry)
    })?;
    let age = |actuation: &mut Actuation| actuation.header.acquired_ns -= 5 * bench.suite.period_ns;
    ignores(bench, "an actuation five periods old", 5, &[age])
}

/// Requires that the robot drives as it is told to.
pub(crate) fn driving(bench: &mut TestBench<'_>) -> Tried {
    moves_when_told(bench).map(|_| ())
}

/// Waits for the first scan of a robot that has not received any actuation yet.
pub(crate) fn standing(bench: &mut TestBench<'_>) -> Tried {
    bench.order = None;
    bench.round().map(|_| ())
}

/// Passes when a robot at rest does not move because of changed actuations to drive, but because of good ones.
fn ignores(bench: &mut TestBench<'_>, what: &str, times: usize, bad: &[impl Fn(&mut Actuation)]) -> Verdict {
    for change in bad.iter().flat_map(|change| repeat_n(change, times)) {
        publish_changed(bench, change)?;
    }
    bench.order = None;
    let speed = bench.samples::<Odometry>(2)?[1].speed_mps;
    require(speed.abs() <= STANDSTILL_MPS, || format!("{speed:.3} m/s after {what}"))?;
    moves_when_told(bench)
}

/// Passes when the robot drives as it is told to.
fn moves_when_told(bench: &mut TestBench<'_>) -> Verdict {
    bench.order = Some(bench.forward());
    let speed = bench.samples::<Odometry>(8)?[7].speed_mps;
    require(speed > 0.1, || format!("{speed:.3} m/s after eight actuations to drive"))?;
    Ok(format!("{speed:.2} m/s"))
}

/// Passes when the robot, without an actuation that counts, blocks its wheels after two periods.
fn stops_without_orders(bench: &mut TestBench<'_>, when: &str, round: &mut Round<'_>) -> Verdict {
    bench.order = None;
    let after_ns = 2 * bench.suite.period_ns + bench.suite.vehicle.stopping_ns(STOPPING);
    is_at_rest(&speeds_for(bench, after_ns, round)?, when)
}

/// Speeds of rounds until `duration_ns` after the next scan [m/s].
fn speeds_for(bench: &mut TestBench<'_>, duration_ns: u64, round: &mut Round<'_>) -> Tried<Vec<f64>> {
    let until_ns = bench.round()?.received_ns + duration_ns;
    let mut speeds = Vec::new();
    loop {
        let odometry = round(bench)?;
        speeds.push(odometry.speed_mps);
        if odometry.header.acquired_ns > until_ns {
            return Ok(speeds);
        }
    }
}

/// The odometry of the next round.
fn next(bench: &mut TestBench<'_>) -> Tried<Odometry> {
    bench.round()?.sample().copied()
}

/// Passes when the last of the speeds is standstill.
fn is_at_rest(speeds: &[f64], when: &str) -> Verdict {
    let (first, last) = (speeds[0], speeds[speeds.len() - 1]);
    passed_if(last.abs() <= STANDSTILL_MPS, format!("{last:.3} m/s {when}, {first:.2} m/s before"))
}

/// One scan, answered by a changed actuation to drive.
fn publish_changed(bench: &mut TestBench<'_>, change: impl Fn(&mut Actuation)) -> Tried<Odometry> {
    bench.order = None;
    let received = bench.round()?;
    let mut message = bench.actuation(&received, bench.forward());
    message.change(change);
    bench.publish(&mut message)?;
    received.sample().copied()
}
