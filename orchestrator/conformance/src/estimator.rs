//! What an estimator must know: where the robot is, and where it will be when the command acts.

use shared_types::{Odometry, Pose, Truth};
use vehicle::frame::wrap_angle;

use super::case::{Verdict, passed_if, require};
use super::suite::Suite;
use super::test_bench::TestBench;

/// Scans of a case: some metres of driving.
const SCANS: usize = 25;
/// A quarter of the distance that is kept to obstacles [m].
const POSITION_M: f64 = 0.05;
/// After the 2.5 m that a controller plans ahead this is 0.05 m again [rad].
const YAW_RAD: f64 = 0.02;
/// How far an outlier of one metre may move the estimate [m].
const OUTLIER_M: f64 = 0.3;

/// Compares poses with the truth, from the start of the drive.
pub(crate) fn follow(bench: &mut TestBench<'_>) -> Verdict {
    let (mut position_m, mut yaw_rad) = (0.0_f64, 0.0_f64);
    for pose in bench.samples::<Pose>(SCANS * scale(bench.suite))? {
        let truth = bench.drive.step(pose.header.scan_id).truth;
        position_m = position_m.max(distance_m(&pose, &truth));
        yaw_rad = yaw_rad.max(wrap_angle(pose.yaw_rad - truth.yaw_rad).abs());
    }
    let measured = format!("largest error {position_m:.3} m, {yaw_rad:.4} rad");
    let is_near = position_m <= POSITION_M && yaw_rad <= YAW_RAD;
    passed_if(is_near, format!("{measured}; {POSITION_M} m, {YAW_RAD} rad are allowed"))
}

pub(crate) fn looks_ahead(bench: &mut TestBench<'_>) -> Verdict {
    let period_ns = bench.suite.period_ns as f64;
    let (mut worst_m, mut max_lead_ms) = (0.0_f64, 0.0_f64);
    for pose in bench.samples::<Pose>(SCANS * scale(bench.suite))? {
        let scan_id = pose.header.scan_id;
        let lead_ns = pose.predicted_ns as f64 - pose.header.scan_published_ns() as f64;
        let lead_ms = lead_ns * 1e-6;
        max_lead_ms = max_lead_ms.max(lead_ms);
        let other = || format!("scan {scan_id} predicted for {lead_ms:.1} ms after its publication");
        require((-1e3..=1.5 * period_ns).contains(&lead_ns), other)?;
        let periods = pose.predicted_ns.saturating_sub(pose.header.acquired_ns) as f64 / period_ns;
        let (x_m, y_m) = true_position(|ahead| bench.drive.step(scan_id + ahead).truth, periods);
        worst_m = worst_m.max((pose.predicted_x_m - x_m).hypot(pose.predicted_y_m - y_m));
    }
    let measured = format!("up to {max_lead_ms:.1} ms ahead of the scan; largest error {worst_m:.3} m");
    passed_if(worst_m <= POSITION_M, format!("{measured}, {POSITION_M} m are allowed"))
}

/// The true position some periods after a scan, interpolated between the truths of the scans after it.
fn true_position(later: impl Fn(u64) -> Truth, periods: f64) -> (f64, f64) {
    let (before, after) = (later(periods as u64), later(periods as u64 + 1));
    let share = periods.fract();
    (before.x_m + share * (after.x_m - before.x_m), before.y_m + share * (after.y_m - before.y_m))
}

pub(crate) fn outlier(bench: &mut TestBench<'_>) -> Verdict {
    bench.rounds(10)?;
    let answer = bench.round_with(|message| {
        message.change(|odometry: &mut Odometry| {
            odometry.y_m += 1.0;
            odometry.dy_m += 1.0;
        });
    })?;
    let pose = answer.sample::<Pose>()?;
    let off_m = distance_m(pose, &bench.drive.step(pose.header.scan_id).truth);
    passed_if(off_m < OUTLIER_M, format!("the estimate moved by {off_m:.3} m; {OUTLIER_M} m are allowed"))
}

fn distance_m(pose: &Pose, truth: &Truth) -> f64 {
    (pose.x_m - truth.x_m).hypot(pose.y_m - truth.y_m)
}

pub(crate) fn covariance(bench: &mut TestBench<'_>) -> Verdict {
    for Pose { header, covariance: all, .. } in bench.samples(10)? {
        let positive = [all[0], all[4], all[8]].iter().all(|variance| *variance > 0.0);
        let symmetric =
            [(1, 3), (2, 6), (5, 7)].iter().all(|(one, other)| (all[*one] - all[*other]).abs() <= 1e-9);
        require(positive && symmetric, || format!("covariance of scan {}: {all:?}", header.scan_id))?;
    }
    Ok("10 covariances".to_owned())
}

/// Scans per scan at 10 Hz, so that the distance is the same at any rate; at most four.
fn scale(suite: &Suite) -> usize {
    (100_000_000 / suite.period_ns).clamp(1, 4) as usize
}
