//! Drives cells in simulated time: from the place where a phase begins, once without a fault and once with each.

use audit::digest::Digests;
use emulator::Outcome;
use faults::{DrivePhase, InjectedFault};
use pipeline::PipelineSettings;
use shared_types::{AnyStage, Role};
use vehicle::Invalid;

use crate::cell::{Cell, DetectionLimits, DrivenWay, Observed, Passed, judge};
use crate::course::{BY_HAND, HANDS_BACK, OUTLASTS, SHADOWED, begins};
use crate::finding::{Finding, Findings};
use crate::piped::PipedStage;
use crate::rig::Rig;

/// The drives at the beginning of all phases.
pub struct Simulation {
    limits: DetectionLimits,
    phases: Vec<(DrivePhase, Rig, Twin)>,
    /// Stages in programs of their own.
    programs: Vec<PipedStage>,
}

/// A drive that continues without a fault.
#[derive(Debug)]
struct Twin {
    course: DrivenWay,
    findings: Findings,
}

impl Simulation {
    /// Drives the course of each phase, whose lengths are `scale` times as large, once without a fault, with these stages in the
    /// place of those of their roles. A course that the robot does not drive to its end has no cells.
    ///
    /// # Errors
    /// The first setting that is not allowed.
    pub fn new(
        programs: Vec<PipedStage>,
        courses: &[(DrivePhase, PipelineSettings)],
        scale: f64,
    ) -> Result<Self, Invalid> {
        let limits = DetectionLimits::of(&courses[0].1, scale);
        let mut phases = Vec::new();
        for (phase, settings) in courses {
            // A program was given the settings of one course.
            if phase.has_own_course() && !programs.is_empty() {
                continue;
            }
            let (phase, mut rig) = (*phase, Rig::new(settings)?);
            for program in &programs {
                rig = rig.with(program.copy());
            }
            lead_to(phase, &mut rig, settings, scale);
            let mut without = rig.clone();
            let (course, outcome, _) = finish(&mut without);
            if outcome != Outcome::Reached {
                continue;
            }
            phases.push((phase, rig, Twin { course, findings: without.findings().clone() }));
        }
        Ok(Self { limits, phases, programs })
    }

    /// Why a program of a stage has failed, with its role: then cells do not count.
    pub fn failure(&self) -> Option<(Role, String)> {
        self.programs.iter().find_map(|program| Some((program.shape().role, program.failure()?)))
    }

    /// The way of a robot on a course without a fault, from its start on, or from where a person takes over.
    ///
    /// # Errors
    /// The first setting that is not allowed.
    pub fn unaffected(settings: &PipelineSettings, phase: DrivePhase) -> Result<DrivenWay, Invalid> {
        let mut rig = Rig::new(settings)?;
        if phase == DrivePhase::Person {
            while rig.scan().is_none() && !begins(phase, settings, 1.0, rig.truth()) {}
            rig.take_over(OUTLASTS);
        }
        Ok(finish(&mut rig).0)
    }

    /// Drives one cell; `None` for a fault that needs real processes or that the course does not allow, for a program of
    /// its own in a bend, and on a course that the robot does not drive to its end.
    pub fn cell(&self, fault: &InjectedFault, phase: DrivePhase) -> Option<Cell> {
        let (_, start, twin) = self.phases.iter().find(|(of, ..)| *of == phase)?;
        let mut rig = start.clone();
        let from_ns = rig.inject(&fault.inject)?;
        let (course, outcome, digest) = finish(&mut rig);
        if outcome == Outcome::Stopped {
            let place = rig.place();
            rig.findings().note("orchestrator", "stopped", place);
        }
        let is_new = |finding: &Finding| !twin.findings.has(finding);
        let truth = *rig.truth();
        let observed = Observed {
            from_ns,
            findings: rig.findings().list().into_iter().filter(is_new).collect(),
            course,
            unaffected: twin.course.clone(),
            outcome: outcome.name().to_owned(),
            digest,
            ended: true,
            touched: truth.collided == 1,
            min_clearance_m: truth.min_clearance_m,
        };
        Some(judge(fault, phase, &observed, &self.limits))
    }
}

/// Drives to the beginning of a phase.
fn lead_to(phase: DrivePhase, rig: &mut Rig, settings: &PipelineSettings, scale: f64) {
    if phase == DrivePhase::Start {
        return;
    }
    while rig.scan().is_none() && !begins(phase, settings, scale, rig.truth()) {}
    let scans = match phase {
        DrivePhase::Swap => {
            rig.begin_swap();
            SHADOWED
        }
        DrivePhase::Person => {
            rig.take_over(HANDS_BACK);
            BY_HAND
        }
        _ => 0,
    };
    (0..scans).for_each(|_| _ = rig.scan());
}

/// Drives to the end: where the robot was at each scan, how the drive ended, and the digest of the truth.
fn finish(rig: &mut Rig) -> (DrivenWay, Outcome, String) {
    let (mut course, mut digests) = (DrivenWay(vec![passed(rig)]), Digests::default());
    loop {
        let outcome = rig.scan();
        course.0.push(passed(rig));
        digests.add(rig.truth());
        if let Some(outcome) = outcome {
            return (course, outcome, digests.whole());
        }
    }
}

fn passed(rig: &Rig) -> Passed {
    let (truth, place) = (rig.truth(), rig.place());
    let at_m = [truth.x_m, truth.y_m];
    Passed { at_ns: place.at_ns, at_m, way_m: place.way_m, speed_mps: truth.speed_mps.abs() }
}
