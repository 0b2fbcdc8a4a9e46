//! Collects what the report, the picture and the progress line need from the samples of one run.
//!
//! Samples may come in any order between topics and may be missing. Rows of the drive are kept one per scan, at most
//! [`MAX_ROWS`] (5.5 hours at 10 Hz, about 40 MB); the figures cover the whole run. Of a robot that publishes no truth
//! the drive is the estimated one, and what only the truth knows is left out.
//!
//! The caller passes only samples that count: those of the incarnation with authority over its role.

mod estimated;
mod margins;
mod rows;
mod scanner;
mod tally;

use std::collections::{BTreeMap, VecDeque};

use audit::ledger::{DelayRow, Ledger, ScanReport};
use console::progress::View;
use emulator::JudgedBy;
use handover::swap::Certificate;
use ride::{Recording, measure};
use shared_types::{
    Actuation, BlockReason, Blocking, Command, Header, Obstacles, Pose, Role, Rule, ScannerHealth,
    StopReason, Truth,
};
use vehicle::{Goal, Surroundings};

use self::estimated::Estimated;
use self::margins::Margins;
use self::rows::{Estimate, Rows};
use self::scanner::Scanner;
use self::tally::Tally;
use crate::latency::{self, Latencies};
use crate::picture::{Drive, Ellipse, Moment};
use crate::report::{
    DriveReport, LatencyReport, LedgerReport, Outcome, ProcessReport, RecordingReport, Report, SCHEMA,
    TrueDrive,
};

pub use self::rows::MAX_ROWS;

/// Maximum number of ellipses for the picture; the oldest are dropped first.
pub const MAX_ELLIPSES: usize = 10_000;

/// The progress line shows the reaction times of this long before the newest answer [ns].
const RECENT_NS: u64 = 1_000_000_000;

/// The properties of a run that are known before it starts.
#[derive(Debug, Clone, PartialEq)]
pub struct RunInfo {
    /// The random id of the run.
    pub run_id: String,
    /// Name of the scenario.
    pub scenario: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// What the scanner sees outside of the track.
    pub surroundings: Surroundings,
    /// Whether time is simulated, so that stamps are not times of this computer.
    pub lockstep: bool,
    /// Number of the first scan of the ledger: 1 for a whole run, 0 for the first one that is seen.
    pub first_scan: u64,
    /// Scan period [ns].
    pub period_ns: u64,
    /// Position of the goal [m].
    pub goal_m: [f64; 2],
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RunResult {
    /// How it ended.
    pub outcome: Outcome,
    /// Why; empty when the outcome is reason enough.
    pub reason: String,
    /// The processes that filled the roles.
    pub processes: Vec<ProcessReport>,
    /// The processes beside the loop.
    pub companions: Vec<crate::report::CompanionReport>,
    /// Swaps of processes.
    pub swaps: Vec<Certificate>,
    /// What became of every sample.
    pub ledger: LedgerReport,
    /// Delays at the ends of topics beside the loop.
    pub companion_delays: Vec<DelayRow>,
    /// The recording; `None` when the run was not recorded.
    pub recording: Option<RecordingReport>,
    /// Files with the last seconds before an incident.
    pub incidents: Vec<std::path::PathBuf>,
}

/// What is recorded of one run.
#[derive(Debug, Clone)]
pub struct Recorder {
    info: RunInfo,
    ledger: Ledger,
    /// Scans without ranges.
    missing: u64,
    latencies: Latencies,
    rows: Rows,
    ride: Recording,
    tally: Tally,
    margins: Margins,
    scanner: Scanner,
    /// The obstacle of the last stop, and whether the newest command is that stop.
    blocking: Option<(Blocking, bool)>,
    truth: Option<Truth>,
    /// The drive by the estimate, of a robot that publishes no truth.
    estimated: Option<Estimated>,
    pose: Option<Pose>,
    actuation: Option<Actuation>,
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
            ride: Recording::default(),
            margins: Margins::default(),
            scanner: Scanner::default(),
            blocking: None,
            truth: None,
            estimated: None,
            pose: None,
            actuation: None,
            ellipses: BTreeMap::new(),
            recent: VecDeque::new(),
            first_acquired_ns: None,
            newest_acquired_ns: 0,
        }
    }

    /// A scan may stay without an answer, for that reason.
    pub fn scan_excused(&mut self, scan_id: u64, reason: &'static str) {
        self.ledger.excused(scan_id, reason);
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
        self.estimated = Some(Estimated::default());
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
    }

    /// The obstacle that the newest command blocks the wheels for.
    pub fn stopped_for(&self) -> Option<Blocking> {
        self.blocking.and_then(|(blocking, is_now)| is_now.then_some(blocking))
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

    /// What the progress line shows of the loop.
    pub fn view(&self) -> View {
        let mut recent: Vec<u64> = self.recent.iter().map(|&(_, reaction_ns)| reaction_ns).collect();
        recent.sort_unstable();
        let reaction_ms = (!self.info.lockstep && !recent.is_empty()).then(|| {
            [recent[(recent.len() - 1) / 2], recent[recent.len() - 1]].map(|time| time as f64 * 1e-6)
        });
        let sent = self.actuation.as_ref().map_or(0.0, |actuation| actuation.desired_steering_rad);
        View {
            time_s: self.duration_s(),
            goal_distance_m: self.goal_distance_m(),
            speed_mps: match (&self.truth, &self.pose) {
                (Some(truth), _) => truth.speed_mps,
                (None, Some(pose)) => pose.speed_mps,
                (None, None) => 0.0,
            },
            steering_rad: self.truth.as_ref().map_or(sent, |truth| truth.steering_rad),
            reaction_ms,
            lockstep: self.info.lockstep,
            blocking: self.stopped_for(),
            scanner: self.stopped_for_scanner(),
        }
    }

    /// The drive for the picture.
    pub fn drive(&self) -> Drive {
        Drive {
            moments: self.rows.moments().collect(),
            estimates: self.rows.estimates().collect(),
            ellipses: self.ellipses.values().copied().collect(),
            judged_by: self.judged_by(),
        }
    }

    /// The report of the run.
    pub fn report(&self, result: &RunResult) -> Report {
        Report {
            schema: SCHEMA,
            run_id: self.info.run_id.clone(),
            scenario: self.info.scenario.clone(),
            seed: self.info.seed,
            surroundings: self.info.surroundings,
            outcome: result.outcome,
            judged_by: self.judged_by(),
            reason: result.reason.clone(),
            lockstep: self.info.lockstep,
            adopted: self.info.first_scan == 0,
            adopted_from_scan: (self.info.first_scan == 0).then(|| self.ledger.first()),
            duration_s: self.duration_s(),
            scans: ScanReport { missing: self.missing, ..self.ledger.report() },
            ledger: result.ledger.clone(),
            latency_us: LatencyReport {
                companions: result.companion_delays.clone(),
                ..self.latencies.report()
            },
            drive: self.drive_report(),
            margin_m: self.margins.means(),
            ride: self.estimated.is_none().then(|| measure(&self.ride.drive(), &self.goal())),
            scanner: self.scanner.report(),
            blocking: self.blocking.map(|(blocking, _)| blocking.into()),
            differences: Vec::new(),
            controller: self.tally.controller(),
            stop_reasons: self.tally.stops(),
            self_check: self.tally.self_check(),
            processes: result.processes.clone(),
            companions: result.companions.clone(),
            swaps: result.swaps.clone(),
            recording: result.recording.clone(),
            incidents: result.incidents.clone(),
            digests: BTreeMap::new(),
            trajectory_rows_dropped: self.rows.dropped(),
            trajectory: self.trajectory(),
        }
    }

    fn trajectory(&self) -> Vec<[f64; 4]> {
        self.rows.moments().map(|moment| [moment.time_s, moment.x_m, moment.y_m, moment.yaw_rad]).collect()
    }

    fn drive_report(&self) -> DriveReport {
        let report = DriveReport {
            final_distance_m: self.goal_distance_m().unwrap_or(0.0),
            speed_limit_mps: self.margins.speed_limit_mps(),
            ..DriveReport::default()
        };
        if let Some(estimated) = &self.estimated {
            return estimated.report(report);
        }
        let error = self.rows.error();
        let only_true = TrueDrive {
            estimate_error_max_m: error.max_m(),
            estimate_error_rms_m: error.rms_m(),
            covariance_coverage: error.coverage(),
            ..TrueDrive::default()
        };
        let Some(truth) = &self.truth else { return DriveReport { truth: Some(only_true), ..report } };
        DriveReport {
            final_speed_mps: truth.speed_mps,
            path_length_m: truth.path_length_m,
            max_abs_lateral_m: truth.max_abs_lateral_m,
            truth: Some(TrueDrive {
                min_clearance_m: truth.min_clearance_m,
                longest_blind_s: truth.longest_blind_s,
                collided: truth.collided == 1,
                struck: truth.struck == 1,
                ..only_true
            }),
            ..report
        }
    }

    fn goal(&self) -> Goal {
        let [x_m, y_m] = self.info.goal_m;
        Goal { x_m, y_m, ..Goal::default() }
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

    fn goal_distance_m(&self) -> Option<f64> {
        if let Some(truth) = &self.truth {
            return Some(truth.goal_distance_m);
        }
        let [x_m, y_m] = self.info.goal_m;
        self.pose.as_ref().map(|pose| (pose.x_m - x_m).hypot(pose.y_m - y_m))
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
mod tests {
    use super::*;
    use crate::latency::tests::chain;
    use shared_types::{Header, Obstacle, ScannerState};

    fn info(lockstep: bool) -> RunInfo {
        RunInfo {
            run_id: String::new(),
            scenario: "corridor".to_owned(),
            seed: 1,
            surroundings: Surroundings::Open,
            lockstep,
            first_scan: 1,
            period_ns: 100_000_000,
            goal_m: [10.0, 0.0],
        }
    }

    fn truth(scan_id: u64, x_m: f64) -> Truth {
        let header = chain(scan_id, scan_id * 100_000_000);
        Truth {
            header,
            time_s: (scan_id - 1) as f64 * 0.1,
            x_m,
            goal_distance_m: 10.0 - x_m,
            min_clearance_m: 0.35,
            path_length_m: x_m,
            speed_mps: 0.8,
            ..Truth::default()
        }
    }

    fn pose(scan_id: u64, x_m: f64, y_m: f64) -> Pose {
        Pose { header: Header { scan_id, ..Header::default() }, x_m, y_m, ..Pose::default() }
    }

    fn answer(scan_id: u64) -> Actuation {
        Actuation {
            header: chain(scan_id, scan_id * 100_000_000),
            answers: 1,
            kind: 1,
            ..Actuation::default()
        }
    }

    fn drive(lockstep: bool) -> Recorder {
        let mut recorder = Recorder::new(info(lockstep));
        for scan_id in 1..=5 {
            recorder.pose(&pose(scan_id, scan_id as f64, 0.3));
            recorder.truth(&truth(scan_id, scan_id as f64 + 0.4));
            recorder.actuation(&answer(scan_id));
        }
        recorder
    }

    #[test]
    fn the_report_holds_the_figures_of_the_samples() {
        let report = drive(false).report(&RunResult { outcome: Outcome::Timeout, ..RunResult::default() });
        assert_eq!(report.surroundings, Surroundings::Open);
        assert_eq!(
            (report.outcome, report.scenario.as_str(), report.duration_s),
            (Outcome::Timeout, "corridor", 0.4)
        );
        assert_eq!((report.scans.published, report.scans.commanded, report.scans.unaccounted), (5, 5, 0));
        assert_eq!(report.latency_us.scan_to_actuation.max, 2.55);
        assert_eq!(report.trajectory[4], [0.4, 5.4, 0.0, 0.0]);
        assert_eq!((report.drive.truth.unwrap().min_clearance_m, report.drive.path_length_m), (0.35, 5.4));
        assert!((report.drive.final_distance_m - 4.6).abs() < 1e-12);
    }

    #[test]
    fn equal_runs_give_equal_bytes() {
        let report = |recorder: &Recorder| recorder.report(&RunResult::default()).to_json().unwrap();
        assert_eq!(report(&drive(true)), report(&drive(true)));
    }

    #[test]
    fn in_lockstep_the_report_has_no_times_of_this_computer() {
        let mut recorder = drive(true);
        recorder.command(&Command { status: 1, iterations: 4, solve_ns: 5000, ..Command::default() });
        let report = recorder.report(&RunResult::default());
        assert_eq!((report.latency_us.scan_to_actuation.count, report.controller.solve_us.count), (0, 0));
        assert_eq!((report.controller.iterations.p50, report.scans.commanded), (4.0, 5));
        assert_eq!(recorder.view().reaction_ms, None);
    }

    #[test]
    fn a_refused_command_is_the_reason_of_its_lost_scan() {
        let mut recorder = drive(false);
        recorder.truth(&truth(6, 6.4));
        let mut block = Actuation { reason: BlockReason::InvalidCommand.wire(), ..Actuation::default() };
        block.header.scan_id = 6;
        recorder.actuation(&block);
        let scans = recorder.report(&RunResult::default()).scans;
        assert_eq!((scans.lost, scans.lost_reasons["invalid_command"]), (1, 1));
    }

    #[test]
    fn the_view_shows_the_median_and_the_worst_of_the_last_second() {
        let mut recorder = Recorder::new(info(false));
        for (scan_id, actuator_ns) in [(1, 900_000_000), (20, 3_000_000), (21, 2_000_000), (22, 9_000_000)] {
            let mut actuation = answer(scan_id);
            actuation.header.stage_mut(Role::Actuator).published_ns = scan_id * 100_000_000 + actuator_ns;
            recorder.actuation(&actuation);
        }
        assert_eq!(recorder.view().reaction_ms, Some([3.0, 9.0]), "the first answer is older than a second");
    }

    #[test]
    fn without_truth_the_distance_to_the_goal_is_the_estimated_one() {
        let mut recorder = Recorder::new(info(false));
        recorder.pose(&pose(1, 7.0, 4.0));
        assert_eq!(recorder.view().goal_distance_m, Some(5.0));
        let drive = recorder.report(&RunResult::default()).drive;
        let clearance_m = drive.truth.map(|truth| truth.min_clearance_m);
        assert_eq!((drive.final_distance_m, clearance_m), (5.0, Some(crate::report::NO_OBSTACLE_M)));
    }

    #[test]
    fn a_robot_without_a_truth_has_the_drive_of_its_estimate() {
        let mut recorder = Recorder::new(RunInfo { first_scan: 0, ..info(false) });
        recorder.expect_no_truth();
        // The first scan that is seen is the 21st of the run.
        for scan_id in 21..=25 {
            let header = chain(scan_id, scan_id * 100_000_000);
            recorder.scan(&header);
            let x_m = 0.08 * scan_id as f64;
            recorder.pose(&Pose { header, x_m, y_m: 0.1 * x_m, speed_mps: 0.8, ..Pose::default() });
            recorder.actuation(&answer(scan_id));
        }
        let report = recorder.report(&RunResult::default());
        assert_eq!((report.judged_by, report.drive.truth, report.ride), (JudgedBy::Estimate, None, None));
        assert_eq!((report.scans.published, report.scans.commanded, report.scans.unaccounted), (5, 5, 0));
        let DriveReport { final_distance_m, final_speed_mps, path_length_m, max_abs_lateral_m, .. } =
            report.drive;
        // The front beam is a microsecond before the time of the scan.
        let figures = [report.duration_s, final_distance_m, path_length_m, max_abs_lateral_m];
        for (figure, expected) in figures.into_iter().zip([2.5, 8.002_499, 0.32, 0.032]) {
            assert!((figure - expected).abs() < 2e-6, "{figures:?}");
        }
        assert_eq!((final_speed_mps, recorder.view().speed_mps), (0.8, 0.8));
        let [time_s, x_m, y_m, _] = report.trajectory[0];
        assert!((time_s - 2.1).abs() < 2e-6 && (x_m, y_m) == (1.68, 0.168), "{:?}", report.trajectory);
    }

    #[test]
    fn the_obstacle_of_the_last_stop_is_reported_and_shown_while_it_lasts() {
        let mut recorder = drive(true);
        let blocking = Blocking { x_m: 6.0, y_m: 0.1, gap_m: 0.12, needed_m: 0.62, id: 17, reserved: 0 };
        let stop = Command { reason: StopReason::Blocked.wire(), blocking, ..Command::default() };
        recorder.command(&stop);
        assert_eq!((recorder.stopped_for(), recorder.view().blocking), (Some(blocking), Some(blocking)));
        recorder.command(&Command { reason: StopReason::SelfCheck.wire(), ..Command::default() });
        assert_eq!((recorder.stopped_for(), recorder.view().blocking), (None, None));
        let report = recorder.report(&RunResult::default());
        assert_eq!(report.blocking, Some(blocking.into()));
        assert_eq!(drive(true).report(&RunResult::default()).blocking, None);
    }

    #[test]
    fn a_stop_for_the_scanner_is_shown_with_its_state_while_it_lasts() {
        let mut recorder = drive(true);
        let scanner = ScannerHealth { state: ScannerState::Stuck.wire(), ..ScannerHealth::healthy(0.0) };
        let obstacles = Obstacles { scanner, ..Obstacles::default() };
        recorder.obstacles(&obstacles);
        assert_eq!((recorder.stopped_for_scanner(), recorder.view().scanner), (None, None));
        recorder.command(&Command { reason: StopReason::Scanner.wire(), ..Command::default() });
        assert_eq!(recorder.stopped_for_scanner(), Some(obstacles.scanner));
        assert_eq!(recorder.view().scanner, Some(obstacles.scanner));
        recorder.command(&Command { reason: StopReason::Blocked.wire(), ..Command::default() });
        assert_eq!((recorder.stopped_for_scanner(), recorder.scanner()), (None, Some(obstacles.scanner)));
        assert_eq!(recorder.report(&RunResult::default()).scanner.stuck_scans, 1);
    }

    #[test]
    fn the_last_version_of_each_ellipse_is_drawn() {
        let mut recorder = Recorder::new(info(false));
        let mut obstacles = Obstacles { count: 2, ..Obstacles::default() };
        for (x_m, count) in [(5.0, 2), (5.1, 1)] {
            obstacles.items[0] = Obstacle { id: 7, x_m, a_m: 1.2, b_m: 0.8, ..Obstacle::default() };
            obstacles.items[1] = Obstacle { id: 9, x_m: 8.0, a_m: 1.2, b_m: 0.8, ..Obstacle::default() };
            obstacles.count = count;
            recorder.obstacles(&obstacles);
        }
        let centres: Vec<f64> = recorder.drive().ellipses.iter().map(|ellipse| ellipse.x_m).collect();
        assert_eq!(centres, [5.1, 8.0]);
    }
}
