//! What an estimator must know: where the robot is, and where it will be when the command acts.

use shared_types::{Odometry, Pose, Truth};
use vehicle::frame::wrap_angle;

use super::case::{Case, LIVE, Level, Trouble, Verdict, failed, require};
use super::drive::Course;
use super::message::Message;
use super::suite::{Setup, Suite};

/// Scans of a case: some metres of driving.
const SCANS: usize = 25;
/// A quarter of the distance that is kept to obstacles [m].
const POSITION_M: f64 = 0.05;
/// At the end of the 2.5 m that a controller looks ahead this is 0.05 m again [rad].
const YAW_RAD: f64 = 0.02;
/// How far an outlier of one metre may move the estimate [m].
const OUTLIER_M: f64 = 0.3;

/// The cases of estimators alone.
pub(crate) const CASES: [Case; 5] = [
    Case {
        name: "near-the-truth",
        level: Level::Required,
        requirement: "With an odometer without error, the pose at the scan is within 0.05 m and 0.02 rad of the true one.",
        why: "Obstacles are placed on the track from it.",
        tries: LIVE,
        play: near_the_truth,
    },
    Case {
        name: "looks-ahead",
        level: Level::Required,
        requirement: "The predicted state is for a time between the publication of the scan and one and a half periods \
                      later, and within 0.05 m of where the robot then is.",
        why: "The plan starts there; from where the robot was it would be late by the whole reaction time.",
        tries: LIVE,
        play: looks_ahead,
    },
    Case {
        name: "corrects-odometry",
        level: Level::Recommended,
        requirement: "An odometer that misses a tenth of the way, as the settings say, is corrected: within 0.05 m.",
        why: "The calibration of the robot is in the settings.",
        tries: LIVE,
        play: corrects_odometry,
    },
    Case {
        name: "outlier",
        level: Level::Recommended,
        requirement: "A single report that is off by one metre moves the estimate by less than 0.3 m.",
        why: "The robot would swerve for one bad sample.",
        tries: LIVE,
        play: outlier,
    },
    Case {
        name: "covariance",
        level: Level::Recommended,
        requirement: "The covariance of yaw, x and y is symmetric and positive.",
        why: "Whoever uses the pose has to know how good it is.",
        tries: LIVE,
        play: covariance,
    },
];

fn near_the_truth(suite: &Suite) -> Verdict {
    follow(suite, Course::Exact)
}

fn corrects_odometry(suite: &Suite) -> Verdict {
    follow(suite, Course::Drifting)
}

/// Poses beside the truth, from the start of the drive.
fn follow(suite: &Suite, course: Course) -> Verdict {
    let mut bench = suite.started(Setup { course, ..Setup::default() })?;
    let (mut position_m, mut yaw_rad) = (0.0_f64, 0.0_f64);
    for received in bench.rounds(SCANS * scale(suite))? {
        let (pose, truth) = (pose(&received.message)?, bench.drive.step(received.message.scan_id()).truth);
        position_m = position_m.max((pose.x_m - truth.x_m).hypot(pose.y_m - truth.y_m));
        yaw_rad = yaw_rad.max(wrap_angle(pose.yaw_rad - truth.yaw_rad).abs());
    }
    let text = format!(
        "largest error {position_m:.3} m, {yaw_rad:.4} rad; {POSITION_M} m, {YAW_RAD} rad are allowed"
    );
    if position_m <= POSITION_M && yaw_rad <= YAW_RAD { Ok(text) } else { failed(text) }
}

fn looks_ahead(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { course: Course::Exact, ..Setup::default() })?;
    let mut worst_m = 0.0_f64;
    let mut lead_ms = 0.0_f64;
    for received in bench.rounds(SCANS * scale(suite))? {
        let pose = pose(&received.message)?;
        let scan_ns = pose.header.scan_published_ns();
        let lead_ns = pose.predicted_ns as f64 - scan_ns as f64;
        lead_ms = lead_ms.max(lead_ns * 1e-6);
        let longest = 1.5 * suite.period_ns as f64;
        require((-1e3..=longest).contains(&lead_ns), || {
            format!(
                "scan {} predicted for {:.1} ms after its publication",
                pose.header.scan_id,
                lead_ns * 1e-6
            )
        })?;
        let periods =
            pose.predicted_ns.saturating_sub(pose.header.acquired_ns) as f64 / suite.period_ns as f64;
        let (x_m, y_m) = truth_at(
            &bench.drive.step(pose.header.scan_id).truth,
            |ahead| bench.drive.step(pose.header.scan_id + ahead).truth,
            periods,
        );
        worst_m = worst_m.max((pose.predicted_x_m - x_m).hypot(pose.predicted_y_m - y_m));
    }
    let text = format!(
        "up to {lead_ms:.1} ms ahead of the scan; largest error {worst_m:.3} m, {POSITION_M} m are allowed"
    );
    if worst_m <= POSITION_M { Ok(text) } else { failed(text) }
}

/// The true place some periods after a scan, between the truths around it.
fn truth_at(now: &Truth, later: impl Fn(u64) -> Truth, periods: f64) -> (f64, f64) {
    let whole = periods.floor();
    let before = if whole == 0.0 { *now } else { later(whole as u64) };
    let after = later(whole as u64 + 1);
    let share = periods - whole;
    (before.x_m + share * (after.x_m - before.x_m), before.y_m + share * (after.y_m - before.y_m))
}

fn outlier(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { course: Course::Exact, ..Setup::default() })?;
    bench.rounds(10)?;
    let scan_id = bench.scan_id;
    bench.wait_until_due(scan_id)?;
    let mut message = bench.message(shared_types::Topic::Odometry, scan_id)?;
    if let Message::Odometry(odometry) = &mut message {
        let Odometry { y_m, dy_m, .. } = &mut **odometry;
        *y_m += 1.0;
        *dy_m += 1.0;
    }
    bench.publish(&mut message)?;
    let answer = bench.answer(scan_id)?;
    let (pose, truth) = (pose(&answer.message)?, bench.drive.step(scan_id).truth);
    let off_m = (pose.x_m - truth.x_m).hypot(pose.y_m - truth.y_m);
    let text = format!("the estimate moved by {off_m:.3} m; {OUTLIER_M} m are allowed");
    if off_m < OUTLIER_M { Ok(text) } else { failed(text) }
}

fn covariance(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    let received = bench.rounds(10)?;
    for received in &received {
        let all = pose(&received.message)?.covariance;
        let positive = [all[0], all[4], all[8]].iter().all(|variance| *variance > 0.0);
        let symmetric =
            [(1, 3), (2, 6), (5, 7)].iter().all(|(one, other)| (all[*one] - all[*other]).abs() <= 1e-9);
        require(positive && symmetric, || {
            format!("covariance of scan {}: {all:?}", received.message.scan_id())
        })?;
    }
    Ok("10 covariances".to_owned())
}

/// Scans per scan at 10 Hz, so that the way is the same at any rate; at most four.
fn scale(suite: &Suite) -> usize {
    (100_000_000 / suite.period_ns).clamp(1, 4) as usize
}

fn pose(message: &Message) -> Result<Pose, Trouble> {
    match message {
        Message::Pose(pose) => Ok(**pose),
        other => failed(format!("{} where a pose was expected", other.topic())),
    }
}
