//! How a robot obeys actuations: which move it, and what it does without one.

use shared_types::{Actuation, Odometry};

use super::{SCANS, next, odometry};
use crate::case::{Trouble, Verdict, failed, passed_if, require};
use crate::suite::{Setup, Suite};
use crate::test_bench::{FOREIGN, Order, TestBench};

/// Below this speed the robot is at rest [m/s].
const STANDSTILL_MPS: f64 = 1e-3;
/// Blocked wheels are at rest after this time: 1 m/s at a deceleration of 5 m/s^2 takes 0.2 s [ns].
const STOPPING_NS: u64 = 500_000_000;
/// Straight on.
pub(super) const FORWARD: Order = Order::Drive(0.7, 0.0);

pub(super) fn drives(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    bench.order = Order::Drive(0.7, 0.05);
    let all = odometry(&mut bench, 2 * SCANS)?;
    let (first, last) = (&all[0], &all[all.len() - 1]);
    let (x_m, yaw_rad) = (last.x_m - first.x_m, last.yaw_rad - first.yaw_rad);
    passed_if(
        last.speed_mps > 0.1 && x_m > 0.0 && yaw_rad > 0.0,
        format!("{:.2} m/s, {x_m:.2} m forward, {yaw_rad:.3} rad to the left", last.speed_mps),
    )
}

pub(super) fn blocks(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    bench.order = Order::Block;
    let speeds = speeds_for(&mut bench, STOPPING_NS, next)?;
    let rising = speeds.windows(2).any(|pair| pair[1] > pair[0] + STANDSTILL_MPS);
    require(!rising, || format!("its speed rises with blocked wheels: {speeds:?}"))?;
    is_at_rest(&speeds, "after blocking the wheels")
}

pub(super) fn dead_man(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    stops_without_orders(&mut bench, "after two periods without an actuation", next)
}

pub(super) fn authority(suite: &Suite) -> Verdict {
    let mut bench = standing(suite)?;
    for _ in 0..8 {
        publish_changed(&mut bench, |actuation| actuation.header.incarnation = FOREIGN)?;
    }
    has_not_moved(&mut bench, "an actuation without authority")?;
    moves_when_told(&mut bench)
}

pub(super) fn nonsense(suite: &Suite) -> Verdict {
    let mut bench = standing(suite)?;
    let kinds: [fn(&mut Actuation); 5] = [
        |actuation| actuation.sent_velocity_mps = f64::NAN,
        |actuation| actuation.sent_velocity_mps = 50.0,
        |actuation| actuation.sent_velocity_mps = -1.0,
        |actuation| actuation.sent_steering_rad = 3.0,
        |actuation| actuation.kind = 77,
    ];
    for kind in kinds {
        publish_changed(&mut bench, kind)?;
        publish_changed(&mut bench, kind)?;
    }
    has_not_moved(&mut bench, "nonsense")?;
    moves_when_told(&mut bench)?;
    let mut kinds = kinds.iter().cycle();
    stops_without_orders(&mut bench, "with nothing but nonsense for two periods", |bench| {
        kinds.next().map_or_else(|| failed("no nonsense"), |kind| publish_changed(bench, kind))
    })
}

pub(super) fn repeated(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    let again = bench.last_actuation.clone();
    stops_without_orders(&mut bench, "with nothing but the same actuation for two periods", |bench| {
        let odometry = next(bench)?;
        again.iter().try_for_each(|again| bench.publish_exactly(again))?;
        Ok(odometry)
    })?;
    let old_ns = 5 * suite.period_ns;
    for _ in 0..5 {
        publish_changed(&mut bench, |actuation| actuation.header.acquired_ns -= old_ns)?;
    }
    has_not_moved(&mut bench, "an actuation five periods old")?;
    moves_when_told(&mut bench)
}

/// A robot that drives.
pub(super) fn driving(suite: &Suite) -> Result<TestBench<'_>, Trouble> {
    let mut bench = suite.started(Setup::default())?;
    moves_when_told(&mut bench)?;
    Ok(bench)
}

/// A robot that has not received any actuation yet.
fn standing(suite: &Suite) -> Result<TestBench<'_>, Trouble> {
    let mut bench = suite.started(Setup::default())?;
    bench.order = Order::Silence;
    bench.round()?;
    Ok(bench)
}

/// Passes when the robot drives as it is told to.
fn moves_when_told(bench: &mut TestBench<'_>) -> Verdict {
    bench.order = FORWARD;
    let speed = odometry(bench, 8)?[7].speed_mps;
    require(speed > 0.1, || format!("{speed:.3} m/s after eight actuations to drive"))?;
    Ok(format!("{speed:.2} m/s"))
}

/// Requires that the robot has not moved.
fn has_not_moved(bench: &mut TestBench<'_>, what: &str) -> Result<(), Trouble> {
    bench.order = Order::Silence;
    let speed = odometry(bench, 2)?[1].speed_mps;
    require(speed.abs() <= STANDSTILL_MPS, || format!("{speed:.3} m/s after {what}"))
}

/// Passes when the robot, without an actuation that counts, blocks its wheels after two periods.
fn stops_without_orders(
    bench: &mut TestBench<'_>,
    when: &str,
    round: impl FnMut(&mut TestBench<'_>) -> Result<Odometry, Trouble>,
) -> Verdict {
    bench.order = Order::Silence;
    let after_ns = 2 * bench.suite.period_ns + STOPPING_NS;
    is_at_rest(&speeds_for(bench, after_ns, round)?, when)
}

/// Speeds of rounds until `duration_ns` after the next scan [m/s].
fn speeds_for(
    bench: &mut TestBench<'_>,
    duration_ns: u64,
    mut round: impl FnMut(&mut TestBench<'_>) -> Result<Odometry, Trouble>,
) -> Result<Vec<f64>, Trouble> {
    let until_ns = bench.round()?.at_ns + duration_ns;
    let mut speeds = Vec::new();
    loop {
        let odometry = round(bench)?;
        speeds.push(odometry.speed_mps);
        if odometry.header.acquired_ns > until_ns {
            return Ok(speeds);
        }
    }
}

/// Passes when the last of the speeds is standstill.
fn is_at_rest(speeds: &[f64], when: &str) -> Verdict {
    let (first, last) = (speeds[0], speeds[speeds.len() - 1]);
    passed_if(last.abs() <= STANDSTILL_MPS, format!("{last:.3} m/s {when}, {first:.2} m/s before"))
}

/// One scan, answered by a changed actuation to drive.
fn publish_changed(bench: &mut TestBench<'_>, change: impl Fn(&mut Actuation)) -> Result<Odometry, Trouble> {
    bench.order = Order::Silence;
    let received = bench.round()?;
    if let Some(mut message) = bench.actuation(&received.message, FORWARD) {
        message.change(change);
        bench.publish(&mut message)?;
    }
    received.message.sample().copied()
}
