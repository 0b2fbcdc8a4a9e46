//! Collects what the report, the picture and the progress line need from the samples of one run.
//!
//! Samples may come in any order between topics and may be missing. Rows of the drive are kept one per scan, at most
//! [`MAX_ROWS`] (5.5 hours at 10 Hz, about 40 MB); the figures cover the whole run. Of a robot that publishes no truth
//! the drive is the estimated one, and what only the truth knows is left out.
//!
//! The caller passes only samples that count: those of the incarnation with authority over its role.

mod estimated;
mod margins;
mod reporting;
mod rows;
mod run;
mod scanner;
mod tally;

use std::collections::{BTreeMap, VecDeque};
use std::ops::RangeInclusive;

use vehicle::Goal;

use crate::report::{DriverChange, GoalChange};
use crate::ride::RideRecording;
use audit::ledger::Ledger;
use emulator::JudgedBy;
use shared_types::{
    Actuation, BlockReason, Blocking, Command, DrivenBy, Header, Obstacles, Pose, Role, Rule, ScannerHealth,
    StopReason, Truth,
};

use self::estimated::Estimated;
use self::margins::Margins;
use self::rows::{Estimate, Rows};
use self::scanner::Scanner;
use self::tally::Tally;
use crate::latency::{self, Latencies};
use crate::picture::{Ellipse, Moment, PictureDrive};

pub use self::rows::MAX_ROWS;
pub use self::run::{RunInfo, RunResult};

/// Maximum number of ellipses for the picture; the oldest are dropped first.
pub const MAX_ELLIPSES: usize = 10_000;

/// The progress line shows the reaction times of this long before the newest answer [ns].
const RECENT_NS: u64 = 1_000_000_000;

/// What is recorded of one run.
#[derive(Debug, Clone)]
pub struct Recorder {
    info: RunInfo,
    ledger: Ledger,
    /// Scans without ranges.
    missing: u64,
    latencies: Latencies,
    rows: Rows,
    ride: RideRecording,
    tally: Tally,
    margins: Margins,
    scanner: Scanner,
    /// The obstacle of the last stop, and whether the newest command is that stop.
    blocking: Option<(Blocking, bool)>,
    slowed: Option<Blocking>,
    truth: Option<Truth>,
    /// The drive by the estimate, of a robot that publishes no truth.
    estimated: Option<Estimated>,
    pose: Option<Pose>,
    actuation: Option<Actuation>,
    goal_changes: Vec<GoalChange>,
    driver_changes: Vec<DriverChange>,
    ellipses: BTreeMap<u32, Ellipse>,
    recent: VecDeque<(u64, u64)>,
    first_acquired_ns: Option<u64>,
    newest_acquired_ns: u64,
}

impl Recorder {
    /// An empty recorder.
    pub fn new(info: RunInfo) -> Self {
        Self {
            ledger: Ledger::new(info.first_scan, info.period_ns),
            missing: 0,
            latencies: Latencies::new(info.lockstep),
            tally: Tally::new(info.lockstep),
            info,
            rows: Rows::default(),
            ride: RideRecording::default(),
            margins: Margins::default(),
            scanner: Scanner::default(),
            blocking: None,
            slowed: None,
            truth: None,
            estimated: None,
            pose: None,
            actuation: None,
            goal_changes: Vec::new(),
            driver_changes: Vec::new(),
            ellipses: BTreeMap::new(),
            recent: VecDeque::new(),
            first_acquired_ns: None,
            newest_acquired_ns: 0,
        }
    }

    /// Scans may stay without an answer, for that reason.
    pub fn scans_excused(&mut self, scans: RangeInclusive<u64>, reason: &'static str) {
        self.ledger.excused(scans, reason);
    }

    /// A sample of a scan failed that rule and was dropped: the reason if the scan stays without an answer.
    pub fn sample_refused(&mut self, scan_id: u64, rule: Rule) {
        self.ledger.refused(scan_id, rule.name());
    }

    /// A sample of a scan was lost between two hosts: the reason if the scan stays without an answer.
    pub fn sample_lost(&mut self, scan_id: u64, reason: &'static str) {
        self.ledger.refused(scan_id, reason);
    }

    /// The robot publishes no truth; for the time before the first scan.
    pub fn expect_no_truth(&mut self) {
        self.estimated = Some(Estimated::on(self.info.course.clone().unwrap_or_default()));
    }

    /// What decides the outcome.
    pub fn judged_by(&self) -> JudgedBy {
        if self.estimated.is_some() { JudgedBy::Estimate } else { JudgedBy::Truth }
    }

    /// A scan was published.
    pub fn scan(&mut self, header: &Header) {
        if self.ledger.first() == 0 {
            self.ledger.begin_at(header.scan_id);
        }
        self.ledger.published(header.scan_id, header.scan_published_ns());
        self.acquired(header.acquired_ns);
        if let Some(estimated) = &mut self.estimated {
            estimated.scan(header, self.info.period_ns);
        }
    }

    /// The true state of the robot at a scan; shows also that the scan was published.
    pub fn truth(&mut self, truth: &Truth) {
        let scan_id = truth.header.scan_id;
        self.scan(&truth.header);
        let moment = Moment {
            time_s: truth.time_s,
            x_m: truth.x_m,
            y_m: truth.y_m,
            yaw_rad: truth.yaw_rad,
            speed_mps: truth.speed_mps,
            steering_rad: truth.steering_rad,
        };
        self.rows.put_moment(scan_id, moment);
        self.ride.truth(truth);
        if self.truth.is_none_or(|newest| newest.header.scan_id <= scan_id) {
            self.truth = Some(*truth);
        }
    }

    /// The scanner gave no ranges for a scan.
    pub fn scan_missing(&mut self) {
        self.missing += 1;
    }

    /// The estimate for a scan.
    pub fn pose(&mut self, pose: &Pose) {
        self.acquired(pose.header.acquired_ns);
        self.tally.pose(pose);
        self.rows.put_estimate(pose.header.scan_id, Estimate::of(pose));
        if let Some(estimated) = &mut self.estimated {
            let steering_rad = self.actuation.map_or(0.0, |actuation| actuation.desired_steering_rad);
            self.rows.put_moment(pose.header.scan_id, estimated.pose(pose, steering_rad));
        }
        self.pose = Some(*pose);
    }

    /// The obstacles described for a scan.
    pub fn obstacles(&mut self, obstacles: &Obstacles) {
        self.scanner.add(obstacles.scanner);
        for item in obstacles.list() {
            let ellipse = Ellipse { x_m: item.x_m, y_m: item.y_m, a_m: item.a_m, b_m: item.b_m };
            self.ellipses.insert(item.id, ellipse);
        }
        while self.ellipses.len() > MAX_ELLIPSES {
            self.ellipses.pop_first();
        }
    }

    /// A command of the controller.
    pub fn command(&mut self, command: &Command) {
        self.tally.command(command);
        self.margins.command(command);
        self.scanner.stops = command.reason == StopReason::Scanner.wire();
        let last = self.blocking.map(|(blocking, _)| (blocking, false));
        self.blocking = command.stopped_for().map(|blocking| (blocking, true)).or(last);
        self.slowed = command.slowed_for();
    }

    /// The obstacle that the newest command blocks the wheels for.
    pub fn stopped_for(&self) -> Option<Blocking> {
        self.blocking.and_then(|(blocking, is_now)| is_now.then_some(blocking))
    }

    /// The obstacle that the newest command blocks the wheels for, or for which a person drives slower than it asks.
    pub fn hindered_by(&self) -> Option<Blocking> {
        self.stopped_for().or(self.slowed)
    }

    /// The newest state of the scanner, if any.
    pub fn scanner(&self) -> Option<ScannerHealth> {
        self.scanner.newest
    }

    /// The scanner that the newest command blocks the wheels for.
    pub fn stopped_for_scanner(&self) -> Option<ScannerHealth> {
        self.scanner.newest.filter(|_| self.scanner.stops)
    }

    /// What was sent to the robot.
    pub fn actuation(&mut self, actuation: &Actuation) {
        let header = &actuation.header;
        if actuation.answers == 1 {
            let answered_ns = header.stage(Role::Actuator).published_ns;
            self.ledger.published(header.scan_id, header.scan_published_ns());
            self.ledger.answered(header.scan_id, answered_ns);
            self.latencies.record(header);
            self.remember_reaction(answered_ns, latency::reaction_ns(header));
        } else if let Ok(reason @ (BlockReason::InvalidCommand | BlockReason::StaleCommand)) =
            BlockReason::try_from(actuation.reason)
        {
            self.ledger.refused(header.scan_id, reason.name());
        }
        let drove = self.actuation.map_or(DrivenBy::Controller.wire(), |before| before.driven_by);
        if actuation.driven_by != drove {
            let driven_by = DrivenBy::try_from(actuation.driven_by).map_or("unknown", DrivenBy::name);
            self.driver_changes.push(DriverChange {
                from_scan: header.scan_id,
                from_s: self.duration_s(),
                driven_by: driven_by.to_owned(),
            });
        }
        self.tally.actuation(actuation);
        self.ride.actuation(actuation);
        self.actuation = Some(*actuation);
    }

    /// The process of a role is gone; scans may be lost for that until the role is filled again.
    pub fn outage_began(&mut self, role: Role, reason: &str) {
        self.ledger.outage_began(role, reason);
    }

    /// The role is filled again.
    pub fn outage_ended(&mut self, role: Role) {
        self.ledger.outage_ended(role);
    }

    /// The end of the run was decided: scans in flight need no answer. Samples that still arrive are recorded.
    pub fn run_ended(&mut self) {
        self.ledger.run_ended();
    }

    /// The newest truth, if any.
    pub fn last_truth(&self) -> Option<&Truth> {
        self.truth.as_ref()
    }

    /// The newest actuation, if any.
    pub fn last_actuation(&self) -> Option<&Actuation> {
        self.actuation.as_ref()
    }

    /// The drive for the picture.
    pub fn drive(&self) -> PictureDrive {
        PictureDrive {
            moments: self.rows.moments().collect(),
            estimates: self.rows.estimates().collect(),
            ellipses: self.ellipses.values().copied().collect(),
            judged_by: self.judged_by(),
        }
    }

    /// Driven time until the newest scan [s].
    pub fn duration_s(&self) -> f64 {
        if let Some(estimated) = &self.estimated {
            return estimated.time_s();
        }
        let acquired = || {
            let first = self.first_acquired_ns.unwrap_or(self.newest_acquired_ns);
            self.newest_acquired_ns.saturating_sub(first) as f64 * 1e-9
        };
        self.truth.as_ref().map_or_else(acquired, |truth| truth.time_s)
    }

    /// From a scan on another goal is the one with this index.
    pub fn change_goal(&mut self, change: GoalChange, goal: Goal) {
        if let Some(place) = self.info.goals.all_mut().get_mut(change.goal) {
            *place = goal;
        }
        self.goal_changes.push(change);
    }

    /// The goals as they are now.
    pub fn goals(&self) -> &[Goal] {
        self.info.goals.all()
    }

    /// The newest estimate, if any.
    pub fn last_pose(&self) -> Option<&Pose> {
        self.pose.as_ref()
    }

    fn goal_distance_m(&self) -> Option<f64> {
        let truth = self.truth.as_ref().map(|truth| [truth.x_m, truth.y_m]);
        let place = truth.or(self.pose.as_ref().map(|pose| [pose.x_m, pose.y_m]));
        place.map(|[x_m, y_m]| self.info.goals.last().distance_m(x_m, y_m))
    }

    fn acquired(&mut self, acquired_ns: u64) {
        let first = self.first_acquired_ns.get_or_insert(acquired_ns);
        *first = acquired_ns.min(*first);
        self.newest_acquired_ns = self.newest_acquired_ns.max(acquired_ns);
    }

    fn remember_reaction(&mut self, answered_ns: u64, reaction_ns: Option<u64>) {
        if let Some(reaction_ns) = reaction_ns {
            self.recent.push_back((answered_ns, reaction_ns));
        }
        while self.recent.front().is_some_and(|&(then_ns, _)| then_ns.saturating_add(RECENT_NS) < answered_ns)
        {
            self.recent.pop_front();
        }
    }
}

#[cfg(test)]
mod tests;
