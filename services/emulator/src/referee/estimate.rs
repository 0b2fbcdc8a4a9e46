//! What the referee knows of a robot that publishes no truth: its estimated pose, and what was sent to it.
//!
//! Assumptions, and where they fail: the wheels do what was sent, and the robot blocks them by itself when nothing was
//! sent for two periods, as every driver must. Actuations that are lost on their way do not show here. Contact with an
//! obstacle never shows.

use shared_types::{Actuation, ActuationKind, Header, Pose, Role};

use super::Sight;

/// Below this estimated speed a robot with blocked wheels stands: at rest the estimate has the noise of the odometry. A
/// robot at this speed slides for less than a millimetre [m/s].
const STANDING_MPS: f64 = 0.05;
/// After this long blocked wheels have stopped any robot, whatever its estimate shows [s].
const REST_S: f64 = 1.5;
/// The dead man of a robot blocks the wheels after this many periods without an actuation.
const DEAD_MAN_PERIODS: u64 = 2;

/// One scan of a robot that publishes no truth.
#[derive(Debug, Clone, Copy)]
pub struct EstimatedScan<'a> {
    /// Identity of the scan, and the time of its front beam.
    pub header: &'a Header,
    /// That time since the start of the run [s].
    pub time_s: f64,
    /// Scan period [ns].
    pub period_ns: u64,
    /// The estimate for the scan; `None` when the estimator has none.
    pub pose: Option<&'a Pose>,
    /// What was sent since the answer to the scan before, up to the answer to this one.
    pub actuations: &'a [Actuation],
}

/// What the wheels do by what was sent to the robot.
#[derive(Debug, Clone, Default)]
pub(super) struct Wheels {
    /// Whether the newest actuation drives.
    turn: bool,
    /// Whether an actuation since the last scan drives: wheels that turned until a gap between scans blocked them were not
    /// blocked without a break.
    turned: bool,
    /// When the newest actuation was sent [ns].
    sent_ns: u64,
    blocked_since_s: Option<f64>,
    place: Option<[f64; 3]>,
}

impl Wheels {
    /// Notes what was sent.
    pub(super) fn note(&mut self, actuation: &Actuation) {
        self.turn = actuation.kind == ActuationKind::Drive.wire();
        self.turned |= self.turn;
        self.sent_ns = actuation.header.stage(Role::Actuator).published_ns;
    }

    /// The robot at the front beam of a scan, from what was sent before it.
    pub(super) fn at(&mut self, scan: &EstimatedScan<'_>) -> Sight {
        let silent_ns = scan.header.acquired_ns.saturating_sub(self.sent_ns);
        let dead_man = self.turn && silent_ns > DEAD_MAN_PERIODS * scan.period_ns;
        let turned = std::mem::take(&mut self.turned);
        let blocked = !turned && (!self.turn || dead_man);
        let since_s = blocked.then(|| self.blocked_since_s.unwrap_or(scan.time_s));
        self.blocked_since_s = since_s;
        self.place = scan.pose.map(|pose| [pose.x_m, pose.y_m, pose.yaw_rad]).or(self.place);
        let is_slow = scan.pose.is_some_and(|pose| pose.speed_mps.abs() <= STANDING_MPS);
        Sight {
            time_s: scan.time_s,
            place: self.place.unwrap_or([f64::NAN; 3]),
            blocked,
            stands: since_s.is_some_and(|since_s| is_slow || scan.time_s - since_s >= REST_S),
            dead_man,
        }
    }
}
