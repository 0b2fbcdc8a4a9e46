//! What becomes of the recorded scans of a run: its report, its digests, its outcome.

use audit::digest::Digests;
use audit::samples::ScanRecord;
use emulator::referee::Landing;
use emulator::{DriveProgress, EstimatedScan, Referee, Scenario};
use report::recorder::{Recorder, RunInfo};
use report::{GoalChange, Outcome};
use vehicle::Goal;

use crate::startup::RunOptions;

/// How far the robot drives until its place on the course is noted again [m].
const NOTED_M: f64 = 0.5;

/// Receives every scan that was recorded.
pub(crate) type ScanObserver = Box<dyn FnMut(&ScanRecord)>;

/// Report, digests and referee of a run.
pub(crate) struct Recording {
    pub(crate) recorder: Recorder,
    pub(crate) digests: Digests,
    referee: Referee,
    /// What was noted of it last; nothing where no other orchestrator needs it.
    noted: Option<DriveProgress>,
    lockstep: bool,
    duration_s: Option<f64>,
    period_ns: u64,
    /// A goal that counts from its scan on.
    awaited: Option<AwaitedGoal>,
    /// Receives every recorded scan: for benches.
    pub(crate) observer: Option<ScanObserver>,
}

/// A goal that counts from its scan on.
#[derive(Debug, Clone, Copy)]
pub(super) struct AwaitedGoal {
    pub(super) change: GoalChange,
    pub(super) goal: Goal,
    /// Where it is on the course [m].
    pub(super) along_m: f64,
}

impl Recording {
    pub(super) fn new(
        run_id: &str,
        scenario: &Scenario,
        options: &RunOptions,
        first_scan: u64,
        period_ns: u64,
    ) -> Self {
        let info = RunInfo {
            run_id: run_id.to_owned(),
            scenario: scenario.name.clone(),
            seed: scenario.seed,
            surroundings: scenario.surroundings(),
            course: scenario.course.clone(),
            lockstep: options.lockstep,
            first_scan,
            period_ns,
            goals: scenario.goal.clone(),
        };
        let laps = scenario.course.as_ref().map_or(1, |course| course.keys().laps);
        // A run in lock-step ends with its orchestrator.
        let is_noted = !options.lockstep && (laps > 1 || scenario.goal.all().len() > 1);
        Self {
            recorder: Recorder::new(info),
            digests: Digests::default(),
            referee: Referee::new(scenario),
            noted: is_noted.then(DriveProgress::default),
            lockstep: options.lockstep,
            duration_s: options.duration_s,
            period_ns,
            awaited: None,
            observer: None,
        }
    }

    /// Whether a goal was given that does not count yet.
    pub(super) fn awaits_goal(&self) -> bool {
        self.awaited.is_some()
    }

    /// From a scan on another goal counts.
    pub(super) fn change_goal(&mut self, goal: AwaitedGoal) {
        self.awaited = Some(goal);
    }

    /// Number of goals that were reached.
    pub(super) fn reached(&self) -> usize {
        self.referee.reached()
    }

    /// How far the robot has come along the course [m].
    pub(super) fn along_m(&self) -> f64 {
        self.referee.along_m()
    }

    /// Continues with a drive that another orchestrator has begun.
    pub(super) fn resume(&mut self, progress: DriveProgress) {
        self.referee.resume(progress);
    }

    /// How far the drive has come, where another orchestrator would need it and it is not what was noted last.
    pub(super) fn newly_driven(&mut self) -> Option<&DriveProgress> {
        let (noted, progress) = (self.noted.as_mut()?, self.referee.progress());
        let is_new = progress.landings.len() != noted.landings.len()
            || (progress.along_m - noted.along_m).abs() > NOTED_M;
        if !is_new {
            return None;
        }
        *noted = progress;
        Some(noted)
    }

    /// What became of each goal.
    pub(super) fn landings(&self) -> Vec<Landing> {
        self.referee.landings()
    }

    /// Adds a complete scan; scans come in order.
    pub(super) fn add(&mut self, scan: &ScanRecord) {
        if self.lockstep {
            self.digest(scan);
        }
        if let Some(observer) = &mut self.observer {
            observer(scan);
        }
        if scan.truth.is_none() {
            self.recorder.scan(&scan.header);
        }
        scan.poses.iter().for_each(|pose| self.recorder.pose(pose));
        scan.obstacles.iter().for_each(|obstacles| self.recorder.obstacles(obstacles));
        scan.commands.iter().for_each(|command| self.recorder.command(command));
        scan.truth.iter().for_each(|truth| self.recorder.truth(truth));
        if scan.missing {
            self.recorder.scan_missing();
        }
        scan.actuations.iter().for_each(|actuation| self.recorder.actuation(actuation));
    }

    /// In lock-step equal runs have equal samples; in real time stamps differ.
    fn digest(&mut self, scan: &ScanRecord) {
        scan.truth.iter().for_each(|sample| self.digests.add(sample));
        scan.poses.iter().for_each(|sample| self.digests.add(sample));
        scan.obstacles.iter().for_each(|sample| self.digests.add(sample));
        scan.commands.iter().for_each(|sample| self.digests.add(sample));
        scan.actuations.iter().for_each(|sample| self.digests.add(sample));
    }

    /// Whether the wheels have been blocked without a break until the scan that was judged last.
    pub(super) fn wheels_are_blocked(&self) -> bool {
        self.referee.wheels_are_blocked()
    }

    /// How the run ends and why, if this scan, which was added, decides it.
    pub(super) fn judge(&mut self, scan: &ScanRecord) -> Option<(Outcome, String)> {
        if let Some(AwaitedGoal { change, goal, along_m }) =
            self.awaited.take_if(|awaited| scan.header.scan_id >= awaited.change.from_scan)
        {
            self.referee.change_goal(change.goal, goal, along_m);
            self.recorder.change_goal(change, goal);
        }
        let time_s = self.recorder.duration_s();
        let decided = match &scan.truth {
            Some(truth) => self.referee.observe(truth, self.recorder.last_actuation()),
            None => self.referee.observe_estimate(&EstimatedScan {
                header: &scan.header,
                time_s,
                period_ns: self.period_ns,
                pose: scan.poses.last(),
                actuations: &scan.actuations,
            }),
        };
        if let Some(outcome) = decided {
            return Some((outcome, self.referee.reason().to_owned()));
        }
        let is_over = self.duration_s.is_some_and(|duration_s| time_s >= duration_s);
        is_over.then(|| (Outcome::Timeout, "the duration asked for is over".to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use shared_types::{Header, Truth};

    use super::*;

    fn recording() -> Recording {
        let scenario: Scenario = toml::from_str("").unwrap();
        let options =
            RunOptions { lockstep: true, duration_s: Some(2.0), quiet: true, out: PathBuf::from("/") };
        Recording::new("run", &scenario, &options, 1, 100_000_000)
    }

    /// A scan without a truth and without an answer.
    fn record(scan_id: u64) -> ScanRecord {
        let acquired_ns = scan_id * 100_000_000;
        ScanRecord {
            header: Header { scan_id, acquired_ns, ..Header::default() },
            truth: None,
            poses: Vec::new(),
            obstacles: Vec::new(),
            commands: Vec::new(),
            actuations: Vec::new(),
            missing: false,
        }
    }

    #[test]
    fn a_run_of_limited_duration_ends_with_the_first_scan_after_it() {
        let mut recording = recording();
        let mut judge = |scan: ScanRecord| {
            recording.add(&scan);
            recording.judge(&scan)
        };
        let with = |scan_id, time_s| {
            let header = Header { scan_id, ..Header::default() };
            ScanRecord { truth: Some(Truth { header, time_s, ..Truth::default() }), ..record(scan_id) }
        };
        assert_eq!(judge(with(20, 1.9)), None);
        let expected = Some((Outcome::Timeout, "the duration asked for is over".to_owned()));
        assert_eq!(judge(with(21, 2.0)), expected);
        let mut recording = self::recording();
        recording.recorder.expect_no_truth();
        let ended = (1..100).map(record).find(|scan| {
            recording.add(scan);
            recording.judge(scan) == expected
        });
        assert_eq!(ended.map(|scan| scan.header.scan_id), Some(20), "2 s after the start");
    }
}
