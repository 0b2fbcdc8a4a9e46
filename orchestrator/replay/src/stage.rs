//! One stage: what is found in the outputs of its processes.

mod journal;
mod lead;
mod robot;

use std::collections::BTreeMap;

use actuation::ActuatorStage;
use estimator::EstimatorStage;
use handover::shadow::Study;
use handover::swap::agreement::{OutputSummary, disagreement};
use handover::swap::{Meant, Party, SwapOutput};
use nmpc::ControllerStage;
use obstacles::DetectorStage;
use shared_types::{Actuation, Command, Header, Obstacles, Pose, Role, Sample, Topic};

pub(crate) use self::journal::Recomputed;
pub(crate) use self::lead::{Led, lead};
pub(crate) use self::robot::Robot;
use crate::compare::{FieldDifference, difference, take_over};
use crate::{
    MAX_DIFFERENCES, NotCompared, ReplayDrive, ReplayOptions, ReplayReport, Skipped, StageStatistics,
};

/// What was found in the outputs of one role.
#[derive(Debug)]
pub(crate) struct Findings {
    role: Role,
    report: ReplayReport,
    reasons: BTreeMap<(&'static str, u32, &'static str), u64>,
    /// Compares what the loop sees of the outputs, where they are expected to differ.
    study: Option<Study>,
}

impl Findings {
    /// Nothing yet.
    pub(crate) fn new(role: Role, drive: &ReplayDrive) -> Self {
        let scans = drive.scans(None, None);
        let study = drive.is_changed.then(|| Study::new(role, drive.period_ns, scans));
        Self { role, report: ReplayReport::default(), reasons: BTreeMap::new(), study }
    }

    /// Compares an output with the recorded one.
    pub(crate) fn compare<S: Sample>(
        &mut self,
        recorded: &S,
        mut replayed: S,
        role: Role,
        drive: &ReplayDrive,
        options: &ReplayOptions,
    ) {
        self.report.samples += 1;
        if drive.is_injected(S::TOPIC, recorded.header()) {
            self.report.injected += 1;
            return;
        }
        self.report.compared += 1;
        take_over(recorded, &mut replayed, role);
        drive.keep_pace(recorded.header());
        self.study(recorded, &replayed);
        match difference(recorded, &replayed) {
            None => self.report.identical += 1,
            Some(difference) => {
                if drive.is_changed && is_beyond(recorded, &replayed, options.tolerance) {
                    self.report.beyond += 1;
                }
                self.note(difference);
            }
        }
    }

    /// Counts an output whose place the program left empty, or filled with one that readers drop.
    pub(crate) fn refuse<S: Sample>(&mut self, recorded: &S, what: &str) {
        self.report.samples += 1;
        self.report.compared += 1;
        self.report.beyond += 1;
        self.note(FieldDifference {
            topic: S::TOPIC.name(),
            scan: recorded.header().scan_id,
            field: "sample".to_owned(),
            recorded: "valid".to_owned(),
            replayed: what.to_owned(),
        });
    }

    fn study<S: Sample>(&mut self, recorded: &S, replayed: &S) {
        let Some(study) = self.study.as_mut().filter(|_| recorded.is_answer()) else { return };
        if let Some(pair) = summary(recorded).zip(summary(replayed)) {
            let header = recorded.header();
            for (party, content) in [(Party::Old, pair.0), (Party::New, pair.1)] {
                let output = SwapOutput {
                    scan: header.scan_id,
                    sequence: header.sequence,
                    scan_published_ns: 0,
                    published_ns: 0,
                    compute_ns: 0,
                    stamps_ns: [0; 2],
                    content: Ok(content),
                };
                study.output(0, party, output);
            }
        }
    }

    fn note(&mut self, difference: FieldDifference) {
        if self.report.differences.len() < MAX_DIFFERENCES {
            self.report.differences.push(difference);
        }
    }

    /// Counts an output that can't be recomputed.
    pub(crate) fn skip<S: Sample>(&mut self, recorded: &S, reason: &'static str) {
        self.report.samples += 1;
        self.report.skipped += 1;
        *self.reasons.entry((S::TOPIC.name(), recorded.header().incarnation, reason)).or_default() += 1;
    }

    /// Counts an output of a robot that an injected fault has altered.
    pub(crate) fn injected(&mut self) {
        self.report.samples += 1;
        self.report.injected += 1;
    }

    /// Names a process whose outputs are not compared.
    pub(crate) fn leave_out(&mut self, incarnation: u32, drive: &ReplayDrive) {
        let (role, program) = (self.role, drive.foreign(incarnation));
        self.report.not_compared.push(NotCompared {
            role: role.name(),
            incarnation,
            program: program.map(str::to_owned),
            has_journals: drive.journals(incarnation).next().is_some(),
            with: program
                .filter(|_| role != Role::Robot)
                .map(|program| format!("--with {}", shell_word(&format!("{role}={program}")))),
        });
    }

    /// Counts an output that does not belong to the run.
    pub(crate) fn after_end(&mut self) {
        self.report.after_end += 1;
    }

    /// Adds it to the report of all roles.
    pub(crate) fn add_to(self, report: &mut ReplayReport) {
        let ReplayReport {
            samples,
            compared,
            skipped,
            identical,
            beyond,
            differences,
            after_end,
            not_compared,
            injected,
            ..
        } = self.report;
        report.not_compared.extend(not_compared);
        report.samples += samples;
        report.compared += compared;
        report.skipped += skipped;
        report.injected += injected;
        report.identical += identical;
        report.beyond += beyond;
        report.after_end += after_end;
        let compared = self.study.map(Study::report).filter(|study| study.compared > 0);
        report.statistics.extend(compared.map(|study| StageStatistics {
            role: self.role.name(),
            compared: study.compared,
            kind_differs: study.kind_differs,
            differences: study.differences,
        }));
        report.differences.extend(differences);
        report.reasons.extend(self.reasons.into_iter().map(|((topic, incarnation, reason), samples)| {
            Skipped { topic, incarnation, reason: reason.to_owned(), samples }
        }));
    }
}

/// What the loop sees of an output; none of a robot's, which has several.
fn summary<S: Sample>(sample: &S) -> Option<OutputSummary> {
    let bytes = bytemuck::bytes_of(sample);
    Some(match S::TOPIC {
        Topic::Pose => bytemuck::from_bytes::<Pose>(bytes).into(),
        Topic::Obstacles => bytemuck::from_bytes::<Obstacles>(bytes).into(),
        Topic::Command => bytemuck::from_bytes::<Command>(bytes).into(),
        Topic::Actuation => bytemuck::from_bytes::<Actuation>(bytes).into(),
        _ => return None,
    })
}

/// Whether two outputs of one scan differ more than two processes of one role may.
fn is_beyond<S: Sample>(recorded: &S, replayed: &S, tolerance: f64) -> bool {
    match (summary(recorded), summary(replayed)) {
        (Some(recorded), Some(replayed)) => {
            disagreement(&recorded, &replayed, tolerance, &Meant::default()).is_some()
        }
        _ => true,
    }
}

/// Replays one role.
pub(crate) fn replay(role: Role, drive: &ReplayDrive, options: &ReplayOptions) -> anyhow::Result<Findings> {
    let mut findings = Findings::new(role, drive);
    match role {
        Role::Robot => journal::replay::<Robot>(&drive.scans, drive, options, &mut findings)?,
        Role::Estimator => journal::replay::<EstimatorStage>(&drive.poses, drive, options, &mut findings)?,
        Role::Obstacles => journal::replay::<DetectorStage>(&drive.obstacles, drive, options, &mut findings)?,
        Role::Controller => {
            journal::replay::<ControllerStage>(&drive.commands, drive, options, &mut findings)?
        }
        Role::Actuator => journal::replay::<ActuatorStage>(&drive.actuations, drive, options, &mut findings)?,
    }
    Ok(findings)
}

/// Which outputs of a process are recomputed.
pub(crate) struct Window {
    /// From this scan on.
    pub(crate) from: u64,
    /// Up to this scan.
    pub(crate) to: u64,
    last_scan: u64,
}

impl Window {
    /// The window of the options.
    pub(crate) fn of(drive: &ReplayDrive, options: &ReplayOptions) -> Self {
        let (from, to) = (options.from.unwrap_or(0), options.to.unwrap_or(u64::MAX));
        Self { from, to, last_scan: drive.last_scan.unwrap_or(u64::MAX) }
    }

    /// Whether an output is compared; it is counted if it does not belong to the run.
    pub(crate) fn holds(&self, header: &Header, findings: &mut Findings) -> bool {
        let holds = (self.from..=self.to).contains(&header.scan_id);
        if holds && header.scan_id > self.last_scan {
            findings.after_end();
            return false;
        }
        holds
    }
}

/// A text as one word of a shell.
fn shell_word(text: &str) -> String {
    format!("'{}'", text.replace('\'', r"'\''"))
}
