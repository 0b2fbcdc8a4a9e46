//! What an estimator must know: where the robot is, and where it will be when the command acts.

use shared_types::{Odometry, Pose, Truth};
use vehicle::frame::wrap_angle;

use super::case::{Play, Verdict, passed_if, require};
use super::drive::Course;
use super::suite::{Setup, Suite};

/// Scans of a case: some metres of driving.
const SCANS: usize = 25;
/// A quarter of the distance that is kept to obstacles [m].
const POSITION_M: f64 = 0.05;
/// After the 2.5 m that a controller plans ahead this is 0.05 m again [rad].
const YAW_RAD: f64 = 0.02;
/// How far an outlier of one metre may move the estimate [m].
const OUTLIER_M: f64 = 0.3;

/// The cases of estimators alone.
pub(crate) const CASES: [(&str, Play); 5] = [
    ("near-the-truth", near_the_truth),
    ("looks-ahead", looks_ahead),
    ("corrects-odometry", corrects_odometry),
    ("outlier", outlier),
    ("covariance", covariance),
];

fn near_the_truth(suite: &Suite) -> Verdict {
    follow(suite, Course::Exact)
}

fn corrects_odometry(suite: &Suite) -> Verdict {
    follow(suite, Course::Drifting)
}

/// Compares poses with the truth, from the start of the drive.
fn follow(suite: &Suite, course: Course) -> Verdict {
    let mut bench = suite.started(Setup { course, ..Setup::default() })?;
    let (mut position_m, mut yaw_rad) = (0.0_f64, 0.0_f64);
    for received in bench.rounds(SCANS * scale(suite))? {
        let pose = received.message.sample::<Pose>()?;
        let truth = bench.drive.step(pose.header.scan_id).truth;
        position_m = position_m.max(distance_m(pose, &truth));
        yaw_rad = yaw_rad.max(wrap_angle(pose.yaw_rad - truth.yaw_rad).abs());
    }
    passed_if(
        position_m <= POSITION_M && yaw_rad <= YAW_RAD,
        format!(
            "largest error {position_m:.3} m, {yaw_rad:.4} rad; {POSITION_M} m, {YAW_RAD} rad are allowed"
        ),
    )
}

fn looks_ahead(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { course: Course::Exact, ..Setup::default() })?;
    let period_ns = suite.period_ns as f64;
    let (mut worst_m, mut max_lead_ms) = (0.0_f64, 0.0_f64);
    for received in bench.rounds(SCANS * scale(suite))? {
        let pose = received.message.sample::<Pose>()?;
        let scan_id = pose.header.scan_id;
        let lead_ns = pose.predicted_ns as f64 - pose.header.scan_published_ns() as f64;
        let lead_ms = lead_ns * 1e-6;
        max_lead_ms = max_lead_ms.max(lead_ms);
        require((-1e3..=1.5 * period_ns).contains(&lead_ns), || {
            format!("scan {scan_id} predicted for {lead_ms:.1} ms after its publication")
        })?;
        let periods = pose.predicted_ns.saturating_sub(pose.header.acquired_ns) as f64 / period_ns;
        let (x_m, y_m) = true_position(|ahead| bench.drive.step(scan_id + ahead).truth, periods);
        worst_m = worst_m.max((pose.predicted_x_m - x_m).hypot(pose.predicted_y_m - y_m));
    }
    passed_if(
        worst_m <= POSITION_M,
        format!(
            "up to {max_lead_ms:.1} ms ahead of the scan; largest error {worst_m:.3} m, {POSITION_M} m are allowed"
        ),
    )
}

/// The true position some periods after a scan, interpolated between the truths of the scans after it.
fn true_position(later: impl Fn(u64) -> Truth, periods: f64) -> (f64, f64) {
    let (before, after) = (later(periods as u64), later(periods as u64 + 1));
    let share = periods.fract();
    (before.x_m + share * (after.x_m - before.x_m), before.y_m + share * (after.y_m - before.y_m))
}

fn outlier(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { course: Course::Exact, ..Setup::default() })?;
    bench.rounds(10)?;
    let answer = bench.round_with(|message| {
        message.change(|odometry: &mut Odometry| {
            odometry.y_m += 1.0;
            odometry.dy_m += 1.0;
        });
    })?;
    let pose = answer.message.sample::<Pose>()?;
    let off_m = distance_m(pose, &bench.drive.step(pose.header.scan_id).truth);
    passed_if(off_m < OUTLIER_M, format!("the estimate moved by {off_m:.3} m; {OUTLIER_M} m are allowed"))
}

fn distance_m(pose: &Pose, truth: &Truth) -> f64 {
    (pose.x_m - truth.x_m).hypot(pose.y_m - truth.y_m)
}

fn covariance(suite: &Suite) -> Verdict {
    for received in suite.started(Setup::default())?.rounds(10)? {
        let Pose { header, covariance: all, .. } = received.message.sample()?;
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
