//! What all plans of one scan start from: the state when the command acts, the margin, and how fast the robot may be.

use shared_types::{Alarm, Obstacles, Pose, ScannerHealth, ScannerState, StopReason};
use vehicle::State;

use crate::braking::{STOP_MARGIN_M, Stopping};
use crate::config::ControllerConfig;
use crate::margin::MarginModel;
use crate::predicted_obstacle::{self, OnCourse, PredictedObstacle};
use crate::scene::Scene;
use crate::smoothing::moved;
use crate::state::ControllerState;

/// Longest time from the scan to the start of the plan [s]: an older pose is contradictory.
const MAX_LEAD_S: f64 = 1.0;
/// How far outside of its bounds a robot may start [m]. Further out, track and pose contradict each other.
const FAR_OUTSIDE_M: f64 = 1.0;
/// How much further than its speed allows the robot may be predicted from where it is [m]: turns and lags are not exact.
const LEAD_SLACK_M: f64 = 0.3;
/// A speed beyond this many times the largest velocity is no speed of this robot.
const MAX_SPEED_RATIO: f64 = 2.0;
/// How deep the body may overlap the box of an obstacle [m]: more is a contradiction, as the robot is not inside.
pub(crate) const OVERLAP_M: f64 = 0.03;
/// Share of the drive's largest deceleration with which the robot slows down for the velocities of a course.
const BRAKING_SHARE: f64 = 0.35;

/// What all plans of one scan start from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Start {
    /// State when the command acts.
    pub(crate) initial: State,
    /// Speed then [m/s].
    pub(crate) speed: f64,
    /// Clearance to obstacles.
    pub(crate) margin: MarginModel,
    /// What a stop takes.
    pub(crate) stopping: Stopping,
    /// Largest velocity to plan with [m/s].
    pub(crate) limit_mps: f64,
    /// Whether the robot drives backwards.
    pub(crate) is_reverse: bool,
}

impl Start {
    /// The start from `initial`, with the period between the last two scans. What the scanner shows ahead does not limit a
    /// robot that drives backwards; where a body moves, more is kept.
    ///
    /// # Errors
    /// [`StopReason::Scanner`] or [`StopReason::NoSafeSpeed`] when the robot can't stop in time at any speed.
    pub(crate) fn new(
        config: &ControllerConfig,
        pose: &Pose,
        scanner: &ScannerHealth,
        initial: State,
        period_s: f64,
        [is_reverse, something_moves]: [bool; 2],
    ) -> Result<Self, StopReason> {
        let margin = MarginModel::of(config, pose);
        let is_doubtful = scanner.state != ScannerState::Healthy.wire() || pose.alarm != Alarm::None.wire();
        let margin = if something_moves || is_doubtful { margin.whole() } else { margin };
        let stopping = Stopping::new(config, period_s, margin.age_s());
        let [safe_mps, seen_mps] = speeds(config, pose, scanner, &stopping, is_reverse);
        let slowest_mps = config.vehicle.bounds.velocity_min_mps;
        if safe_mps < slowest_mps {
            return Err(StopReason::NoSafeSpeed);
        }
        let limit_mps = safe_mps.min(seen_mps);
        if limit_mps < slowest_mps {
            return Err(StopReason::Scanner);
        }
        let braking_mps2 = BRAKING_SHARE * config.vehicle.deceleration_max_mps2;
        let limit_mps = limit_mps.min(config.course.speed_mps(initial.x, braking_mps2).max(slowest_mps));
        Ok(Self { initial, speed: pose.predicted_speed_mps.abs(), margin, stopping, limit_mps, is_reverse })
    }

    /// What plans from here must respect.
    pub(crate) fn scene<'a>(
        &self,
        config: &'a ControllerConfig,
        predicted: &'a [PredictedObstacle],
    ) -> Scene<'a> {
        let scene = Scene::new(config, predicted, self.initial).keeping(self.margin, self.speed);
        Scene { limit_mps: self.limit_mps, ..scene }
    }

    /// Distance of the body to an obstacle at which the robot must begin to stop [m].
    pub(crate) fn stop_m(&self) -> f64 {
        self.stopping.distance(self.speed) + self.margin.base() + STOP_MARGIN_M
    }
}

/// The largest speed at which the robot can stop in time, and the largest for what the scanner shows [m/s].
pub(crate) fn speeds(
    config: &ControllerConfig,
    pose: &Pose,
    scanner: &ScannerHealth,
    stopping: &Stopping,
    is_reverse: bool,
) -> [f64; 2] {
    let fastest_mps = if pose.alarm == Alarm::None.wire() { f64::INFINITY } else { config.careful_mps };
    let safe_mps = stopping.limit(&config.vehicle).min(fastest_mps);
    [safe_mps, seen_mps(config, stopping, scanner, is_reverse)]
}

/// Largest speed at which the robot stops within what the scanner shows [m/s]; zero when it shows nothing.
fn seen_mps(
    config: &ControllerConfig,
    stopping: &Stopping,
    scanner: &ScannerHealth,
    is_reverse: bool,
) -> f64 {
    let seen_m = if is_reverse { f64::INFINITY } else { scanner.seen_ahead_m };
    let seen_m = seen_m - config.vehicle.nose_m() - STOP_MARGIN_M;
    if seen_m.is_nan() {
        return 0.0;
    }
    match scanner.state() {
        ScannerState::Healthy => stopping.speed(seen_m),
        ScannerState::Degraded => stopping.speed(seen_m).min(config.vehicle.careful_mps),
        ScannerState::Blind | ScannerState::Stuck | ScannerState::Contradictory => 0.0,
    }
}

/// The state at the start of the plan on the course; the obstacles are read into `predicted`, where `last` is the state
/// after the scan before.
///
/// # Errors
/// [`StopReason::BadInput`] when a number is impossible or the inputs contradict each other, [`StopReason::Covered`] when an
/// obstacle is where the robot is.
pub(crate) fn read(
    config: &ControllerConfig,
    pose: &Pose,
    obstacles: &Obstacles,
    last: &ControllerState,
    predicted: &mut Vec<PredictedObstacle>,
) -> Result<State, StopReason> {
    let initial = place(config, pose, last);
    let lead_s = (pose.predicted_ns as f64 - pose.header.acquired_ns as f64) * 1e-9;
    let sound = is_inside(config, &initial)
        && initial.sideslip.abs() < 1.0
        && initial.yaw.abs() < 10.0
        && initial.yaw_rate.abs() < 10.0
        && (0.0..=MAX_LEAD_S).contains(&lead_s)
        && is_near(config, pose, lead_s)
        && pose.local_covariance.iter().all(|value| value.is_finite())
        && pose.header.scan_id == obstacles.header.scan_id;
    let (known, place) = (&last.ellipses, OnCourse { course: &config.course, near_m: initial.x });
    if !sound || !predicted_obstacle::read(obstacles, place, lead_s, |id| moved(known, id), predicted) {
        return Err(StopReason::BadInput);
    }
    match deepest(config, predicted, initial) {
        Some((_, overlap_m)) if overlap_m > OVERLAP_M => Err(StopReason::Covered),
        _ => Ok(initial),
    }
}

/// Where the robot is predicted on the course, near where it was after the scan before.
pub(crate) fn place(config: &ControllerConfig, pose: &Pose, last: &ControllerState) -> State {
    let driven = State {
        sideslip: pose.predicted_sideslip_rad,
        yaw: pose.predicted_yaw_rad,
        yaw_rate: pose.predicted_yaw_rate_radps,
        x: pose.predicted_x_m,
        y: pose.predicted_y_m,
    };
    let near = last.along().map(|along| config.course.on_course(&driven, along));
    // A robot that was put elsewhere is looked for on the whole course.
    let anywhere = || config.course.on_course(&driven, config.course.find(&driven));
    near.filter(|near| is_inside(config, near)).unwrap_or_else(anywhere)
}

/// The obstacle that the body overlaps most, and how deep [m]; `None` where it overlaps none.
pub(crate) fn deepest(
    config: &ControllerConfig,
    predicted: &[PredictedObstacle],
    initial: State,
) -> Option<(u32, f64)> {
    let scene = Scene::new(config, predicted, initial);
    let body = scene.body_at(&initial);
    let reach = body.length + body.width;
    let overlaps = predicted.iter().filter_map(|obstacle| {
        let other = scene.in_plane(obstacle, 0.0);
        let distance = (other.centre - body.centre).norm();
        let is_near = distance < reach + other.length + other.width;
        let overlap_m = if is_near { -body.distance_to_rectangle(&other) } else { 0.0 };
        (overlap_m > 0.0).then_some((obstacle.id, overlap_m))
    });
    overlaps.max_by(|one, other| one.1.total_cmp(&other.1))
}

/// Whether the robot can get from its place to the predicted one in `lead_s`, at a speed that it can have.
fn is_near(config: &ControllerConfig, pose: &Pose, lead_s: f64) -> bool {
    let speed = speed(pose);
    let way = (pose.predicted_x_m - pose.x_m).hypot(pose.predicted_y_m - pose.y_m);
    // NaN is in no range.
    (0.0..=fastest(config)).contains(&speed)
        && pose.predicted_speed_mps.is_finite()
        && (0.0..=speed * lead_s + LEAD_SLACK_M).contains(&way)
}

/// The speed that a pose states, now or where the command acts [m/s].
pub(crate) fn speed(pose: &Pose) -> f64 {
    pose.speed_mps.abs().max(pose.predicted_speed_mps.abs())
}

/// The fastest that a robot may be said to be [m/s].
pub(crate) fn fastest(config: &ControllerConfig) -> f64 {
    MAX_SPEED_RATIO * config.vehicle.bounds.velocity_max_mps
}

/// Whether a state is finite and not far outside of the bounds.
fn is_inside(config: &ControllerConfig, state: &State) -> bool {
    let [low, high] = config.y_range();
    let within =
        |value: f64, [low, high]: [f64; 2]| value > low - FAR_OUTSIDE_M && value < high + FAR_OUTSIDE_M;
    state.is_finite() && within(state.x, config.track.x_m) && within(state.y, [low, high])
}
