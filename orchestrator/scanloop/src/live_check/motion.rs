//! Checks in which the robot moves: rolled by hand, or driven slowly, and stopped.

mod body;
mod deceleration;
mod halt;
mod verdict;

use console::{answer, note};
use plan::System;
use supervision::private_system::Order;
use vehicle::Description;

use super::LiveArguments;
use super::bench::Bench;
use super::feed::{Point, free_ahead_m};
use super::finding::{Finding, Outcome};
use body::{Stop, Track};
use deceleration::Deceleration;

/// Names of these checks.
pub(super) const NAMES: [&str; 3] = ["ahead", "left", "stop"];
/// A distance that the odometry of any robot resolves [m].
const MIN_AHEAD_M: f64 = 0.2;
/// A turn by hand [rad].
const MIN_LEFT_RAD: f64 = 0.2;
/// A turn within the second leg of a drive: on the tightest circle the robot turns by four times this [rad].
const MIN_DRIVEN_LEFT_RAD: f64 = 0.03;
/// Length of both legs [m].
const LEGS_M: [f64; 2] = [0.5, 0.4];
/// Curvature of the second leg, 0.08 rad of the SUMMIT's steering, or less where `vehicle.bounds` allow no more to be sent [1/m].
const LEFT_PER_M: f64 = 0.433;
/// Beyond both legs and the way to stop this must be free in front of the body at the start [m].
const RESERVE_M: f64 = 0.2;
/// The drive ends when the newest scan with ranges is older than this many periods.
const MAX_SCAN_PERIODS: u64 = 3;
/// A way by the odometry against the order that is no noise [m].
const MIN_BACK_M: f64 = 0.05;
/// Why the drive ended early.
const NOT_FREE: &str = "something is near, or the scanner does not see: the wheels are blocked";
/// See [`near_m`] [m].
const NEAR_M: f64 = 0.4;
/// Part of [`near_m`] that stays free [m].
const NEAR_RESERVE_M: f64 = 0.1;
/// A body that comes into view is in a scan after a period, which is published within another one, and the block is obeyed
/// within a third.
const BLIND_PERIODS: f64 = 3.0;
/// Blocked wheels rest within this time [ns].
const REST_NS: u64 = 3_000_000_000;
/// Run-up to each further stop: the robot reaches its speed, and then keeps it for half a second [s].
const RUN_UP_S: f64 = 1.2;
/// A way to stop that is free beyond each run-up [m].
const STOP_M: f64 = 0.3;
/// Scans that are waited for when the odometry rests: locked wheels may slide on [count].
const SETTLING_SCANS: usize = 8;
/// The odometry shows another motion than the scans, if theirs is less than this share of it.
const SEEN_SHARE: f64 = 0.5;
/// Time between the warning and the drive [ns].
const WARNING_NS: u64 = 3_000_000_000;

/// What the motion has shown.
pub(super) struct Moved {
    pub(super) findings: Vec<Finding>,
    /// What the stops have shown.
    pub(super) deceleration: Option<Deceleration>,
    /// Whether standard output is for JSON.
    is_json: bool,
}

/// Moves the robot as the arguments allow; `before` are the findings of scanner and odometry.
///
/// # Errors
/// Those of [`Bench::until`].
pub(super) fn findings(
    bench: &mut Bench,
    system: &System,
    arguments: &LiveArguments,
    before: &[Finding],
) -> anyhow::Result<Moved> {
    let mut moved = Moved { findings: Vec::new(), deceleration: None, is_json: arguments.json };
    let obstacle = before.iter().find(|finding| finding.outcome == Outcome::Failed);
    if arguments.drive {
        match obstacle
            .map(|finding| format!("`{}` failed", finding.name))
            .or_else(|| blocked(bench, system, arguments.speed))
        {
            Some(reason) => moved.skip(&reason),
            None => drive(bench, system, arguments, &mut moved)?,
        }
    } else if bench.feed.newest.is_none() {
        moved.skip("no odometry");
    } else if arguments.by_hand > 0.0 {
        by_hand(bench, arguments.by_hand, &mut moved)?;
        moved.skip("needs --drive");
    } else {
        moved.skip("needs --by-hand above 0, or --drive");
    }
    Ok(moved)
}

impl Moved {
    fn add(&mut self, finding: Finding) {
        // The robot may move: an output that is closed does not end the check.
        let _ = answer!(self.is_json, "{finding}");
        self.findings.push(finding);
    }

    /// Judges all stops.
    fn judge_stops(&mut self, stops: &[Stop], vehicle: &Description) {
        let (finding, deceleration) = verdict::judge(stops, vehicle);
        self.add(finding);
        self.deceleration = deceleration;
    }

    /// Skips all checks that were not made.
    fn skip(&mut self, reason: &str) {
        for name in &NAMES[self.findings.len()..] {
            self.add(Finding::skipped(name, reason));
        }
    }
}

/// Asks the operator to move the robot.
fn by_hand(bench: &mut Bench, limit_s: f64, moved: &mut Moved) -> anyhow::Result<()> {
    let limit_ns = (limit_s * 1e9) as u64;
    note!("roll the robot ahead by hand, half a metre (within {limit_s} s)");
    let start = place(bench);
    bench.until(limit_ns, |bench| (place(bench).ahead_m - start.ahead_m).abs() >= MIN_AHEAD_M)?;
    moved.add(ahead(place(bench).ahead_m - start.ahead_m, None));
    note!("turn the robot to the left by hand, 30 degrees (within {limit_s} s)");
    let start = place(bench);
    bench.until(limit_ns, |bench| (place(bench).left_rad - start.left_rad).abs() >= MIN_LEFT_RAD)?;
    moved.add(left(place(bench).left_rad - start.left_rad, MIN_LEFT_RAD, None));
    Ok(())
}

/// Steering angle of the second leg [rad].
fn left_rad(vehicle: &Description) -> f64 {
    vehicle.parameters().steering_of(LEFT_PER_M).min(vehicle.bounds.sent_steering_max_rad)
}

/// Drives straight on, then to the left, and blocks the wheels; then straight on to each further stop.
fn drive(
    bench: &mut Bench,
    system: &System,
    arguments: &LiveArguments,
    moved: &mut Moved,
) -> anyhow::Result<()> {
    let speed_mps = arguments.speed;
    let [straight_m, left_m] = LEGS_M;
    note!(
        "the robot drives {:.1} m at {speed_mps} m/s in {} s, as far as its way is free; Ctrl-C blocks its wheels",
        straight_m + left_m + run_ups_m(arguments),
        WARNING_NS / 1_000_000_000
    );
    bench.until(WARNING_NS, |_| false)?;
    if !is_seen_free(bench, system, speed_mps) {
        moved.skip(NOT_FREE);
        return Ok(());
    }
    let start = place(bench);
    let mut track = Track::begin(&bench.feed, &system.vehicle);
    let is_free = leg(bench, system, Order::Drive(speed_mps, 0.0), straight_m)?;
    let (moved_m, straight_ns) = (place(bench).ahead_m - start.ahead_m, newest_ns(bench));
    if !is_free || moved_m < MIN_AHEAD_M {
        bench.order(Order::Block);
        bench.until(REST_NS, |bench| halt::rests(&bench.feed.observed.way))?;
        // The way of a robot that was stopped early is too short to be judged, but its direction is not.
        if is_free || moved_m < -MIN_BACK_M {
            moved.add(ahead(moved_m, None));
        }
        moved.skip(if is_free { "`ahead` failed" } else { NOT_FREE });
        return Ok(());
    }
    let start = place(bench);
    let steering_rad = left_rad(&system.vehicle);
    let is_free = leg(bench, system, Order::Drive(speed_mps, steering_rad), left_m)?;
    let (turned_rad, left_ns) = (place(bench).left_rad - start.left_rad, newest_ns(bench));
    let first = stop(bench, &system.vehicle)?;
    let straight = track.follow(&bench.feed, straight_ns, speed_mps, &system.vehicle);
    moved.add(ahead(moved_m, straight.map(|body| body.ahead_m)));
    if is_free {
        let turned = track.follow(&bench.feed, left_ns, speed_mps, &system.vehicle);
        let seen_rad = straight.zip(turned).map(|(before, after)| after.left_rad - before.left_rad);
        moved.add(left(turned_rad, MIN_DRIVEN_LEFT_RAD, seen_rad));
    } else {
        moved.add(Finding::skipped("left", NOT_FREE));
    }
    stops(bench, system, arguments, first, moved)
}

/// Time of the newest scan [ns].
fn newest_ns(bench: &Bench) -> u64 {
    bench.feed.newest_scan().map_or(0, |scan| scan.header.acquired_ns)
}

/// Length of the run-ups to all stops but the first [m].
fn run_ups_m(arguments: &LiveArguments) -> f64 {
    let further = arguments.stops.saturating_sub(1);
    RUN_UP_S * arguments.speed * (further.div_ceil(2) as f64 / 2.0 + (further / 2) as f64)
}

/// Drives until the distance is covered, in whichever direction; false when the way is not free any more.
fn leg(bench: &mut Bench, system: &System, order: Order, length_m: f64) -> anyhow::Result<bool> {
    let Order::Drive(speed_mps, _) = order else { return Ok(true) };
    let start_m = place(bench).ahead_m;
    // Three times as long as at this speed, and the time to accelerate: a robot may be slower before its calibration.
    let limit_ns = ((3.0 * length_m / speed_mps + 1.0) * 1e9) as u64;
    let mut is_free = true;
    bench.order(order);
    bench.until(limit_ns, |bench| {
        is_free = is_seen_free(bench, system, speed_mps);
        !is_free || (place(bench).ahead_m - start_m).abs() >= length_m
    })?;
    Ok(is_free)
}

/// The drive ends when something is nearer than this to the front of the body: the way until the newest scan has blocked
/// the wheels, and to rest as described, or [`NEAR_M`] [m].
fn near_m(system: &System, speed_mps: f64) -> f64 {
    let blind_s = BLIND_PERIODS * system.period_ns() as f64 * 1e-9 + system.vehicle.command_delay_s;
    let slide_m = speed_mps * speed_mps / (2.0 * system.vehicle.blocked_deceleration_mps2);
    NEAR_M.max(speed_mps * blind_s + slide_m + NEAR_RESERVE_M)
}

/// Whether a scanner that works sees nothing near in the way of the robot.
fn is_seen_free(bench: &Bench, system: &System, speed_mps: f64) -> bool {
    let feed = &bench.feed;
    let oldest_ns = place(bench).at_ns.saturating_sub(MAX_SCAN_PERIODS * system.period_ns());
    let is_stop = feed.observed.health.is_some_and(|health| health.state().is_stop());
    let scan = feed.newest_scan().filter(|scan| scan.header.acquired_ns >= oldest_ns);
    !is_stop && scan.is_some_and(|scan| free_ahead_m(scan, &system.vehicle) >= near_m(system, speed_mps))
}

/// After the first stop stops from half of the speed, and from all of it in turn, as long as the way is free; compares the
/// stops with the description.
fn stops(
    bench: &mut Bench,
    system: &System,
    arguments: &LiveArguments,
    first: Option<Stop>,
    moved: &mut Moved,
) -> anyhow::Result<()> {
    let vehicle = &system.vehicle;
    let (mut halts, mut newest) = (Vec::new(), first);
    while let Some(halt) = newest {
        halts.push(halt);
        let speed_mps = if halts.len() % 2 == 1 { arguments.speed / 2.0 } else { arguments.speed };
        let length_m = RUN_UP_S * speed_mps;
        let has_room = bench
            .feed
            .newest_scan()
            .is_some_and(|scan| free_ahead_m(scan, vehicle) >= length_m + near_m(system, speed_mps) + STOP_M);
        if halts.len() >= arguments.stops || !has_room {
            moved.judge_stops(&halts, vehicle);
            return Ok(());
        }
        if !leg(bench, system, Order::Drive(speed_mps, 0.0), length_m)? {
            // It stops for what came near, and the stops before count.
            stop(bench, vehicle)?;
            moved.judge_stops(&halts, vehicle);
            return Ok(());
        }
        newest = stop(bench, vehicle)?;
    }
    moved.add(Finding::of(
        "stop",
        false,
        format!("the robot does not rest {} s after the block", REST_NS / 1_000_000_000),
        "at rest",
    ));
    Ok(())
}

/// Blocks the wheels and measures how the robot comes to rest; `None` when it does not.
fn stop(bench: &mut Bench, vehicle: &Description) -> anyhow::Result<Option<Stop>> {
    bench.order(Order::Block);
    bench.until(REST_NS, |bench| bench.ordered_ns().is_some())?;
    let blocked_ns = bench.ordered_ns().unwrap_or(u64::MAX);
    let has_rested = bench.until(REST_NS, |bench| {
        let way = &bench.feed.observed.way;
        halt::rests(way) && way.last().is_some_and(|point| point.at_ns > blocked_ns)
    })?;
    let settled = bench.feed.observed.way.len() + SETTLING_SCANS;
    bench.until(REST_NS, |bench| bench.feed.observed.way.len() >= settled)?;
    let counted = halt::measure(&bench.feed.observed.way, blocked_ns, vehicle.command_delay_s);
    let seen = body::stop(&bench.feed, blocked_ns, vehicle);
    Ok(counted.filter(|_| has_rested).map(|counted| Stop { counted, seen }))
}

/// Why the robot must not be driven; `None` when its way is free.
fn blocked(bench: &Bench, system: &System, speed_mps: f64) -> Option<String> {
    let Some(scan) = bench.feed.newest_scan() else { return Some("no scan has ranges".to_owned()) };
    let free_m = free_ahead_m(scan, &system.vehicle);
    let needed_m = LEGS_M.iter().sum::<f64>() + near_m(system, speed_mps) + RESERVE_M;
    (free_m < needed_m).then(|| format!("{free_m:.2} m are free ahead, the drive needs {needed_m:.2} m"))
}

fn place(bench: &Bench) -> Point {
    bench.feed.observed.way.last().copied().unwrap_or_default()
}

/// Judges the way by the odometry, and by the scans where they show one.
fn ahead(moved_m: f64, seen_m: Option<f64>) -> Finding {
    let (measured, allowed) =
        (format!("odometry moved by {moved_m:+.2} m"), format!("at least {MIN_AHEAD_M:+} m"));
    match seen_m.filter(|seen_m| *seen_m < SEEN_SHARE * moved_m) {
        Some(seen_m) if moved_m >= MIN_AHEAD_M => {
            let measured = format!("{measured}, the body by {seen_m:+.2} m by the scans");
            Finding::of("ahead", false, measured, format!("{allowed}, of both"))
        }
        _ => Finding::of("ahead", moved_m >= MIN_AHEAD_M, measured, allowed),
    }
}

/// The same for the turn.
fn left(turned_rad: f64, min_rad: f64, seen_rad: Option<f64>) -> Finding {
    let (measured, allowed) =
        (format!("odometry turned by {turned_rad:+.2} rad"), format!("at least {min_rad:+} rad"));
    match seen_rad.filter(|seen_rad| *seen_rad < SEEN_SHARE * turned_rad) {
        Some(seen_rad) if turned_rad >= min_rad => {
            let measured = format!("{measured}, the body by {seen_rad:+.2} rad by the scans");
            Finding::of("left", false, measured, format!("{allowed}, of both"))
        }
        _ => Finding::of("left", turned_rad >= min_rad, measured, allowed),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_car_turns_in_the_second_leg_as_the_summit_does() {
        let summit = Description::default();
        assert!((left_rad(&summit) - 0.08).abs() < 1e-3);
        let bounds = vehicle::Bounds { sent_steering_max_rad: 0.55, ..summit.bounds };
        let (model, front_m, rear_m) = (vehicle::VehicleModel::Bicycle, 0.84, 0.85);
        let car = Description { model, front_m, rear_m, bounds, ..summit };
        let turned_rad = car.parameters().curvature_of(left_rad(&car)) * LEGS_M[1];
        assert!(turned_rad > 3.0 * MIN_DRIVEN_LEFT_RAD, "{turned_rad}");
    }
}
