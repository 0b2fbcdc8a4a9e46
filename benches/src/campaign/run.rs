//! One course, driven and judged.

use audit::digest::Digests;
use courses::WayToRest;
use courses::judge::{Judge, Judgement};
use emulator::{Outcome, Scenario};
use pipeline::Step;
use report::NO_OBSTACLE_M;

use super::arguments::CampaignArguments;
use super::course::{Course, Drive};

/// How one course ended.
#[derive(Debug, Clone)]
pub(super) struct CourseRun {
    pub(super) course: Course,
    /// Before any override.
    pub(super) scenario: Scenario,
    /// Name of its family or scenario.
    pub(super) family: String,
    pub(super) gap_m: Option<f64>,
    pub(super) outcome: Outcome,
    pub(super) reason: String,
    pub(super) judgement: Judgement,
    pub(super) time_s: f64,
    pub(super) min_clearance_m: f64,
    /// Smallest clearance on a way to rest.
    pub(super) min_rest_clearance_m: f64,
    /// Scans without a way to rest that keeps clear.
    pub(super) without_rest: u64,
    /// Digest of all samples.
    pub(super) digest: String,
}

impl CourseRun {
    /// Drives a course to its end.
    ///
    /// # Errors
    /// A setting that is not allowed; exit code 2.
    pub(super) fn of(course: Course, arguments: &CampaignArguments) -> anyhow::Result<Self> {
        let Drive { plan, scenario, gap_m } = course.drive(arguments)?;
        let settings = plan.simulated();
        let (vehicle, period_ns) = (settings.tuning.vehicle, settings.period_ns);
        let mut digests = Digests::default();
        let mut judge = Judge::new(&settings.scenario, vehicle.bounds.steering_max_rad, period_ns);
        let (mut time_s, mut min_clearance_m) = (0.0, NO_OBSTACLE_M);
        let (mut rest, mut min_rest_clearance_m, mut without_rest) =
            (WayToRest::new(&settings.scenario, vehicle, period_ns), NO_OBSTACLE_M, 0);
        let drive = pipeline::drive(&settings, |step| {
            (time_s, min_clearance_m) = (step.truth.time_s, step.truth.min_clearance_m);
            let clearance_m = rest.clearance(&step.truth);
            min_rest_clearance_m = min_rest_clearance_m.min(clearance_m);
            without_rest += u64::from(clearance_m <= 0.0);
            let Step { truth, pose, obstacles, command, actuation, .. } = step;
            digests.add(truth);
            pose.iter().for_each(|sample| digests.add(sample));
            obstacles.iter().for_each(|sample| digests.add(sample));
            command.iter().for_each(|sample| digests.add(sample));
            actuation.iter().for_each(|sample| digests.add(sample));
            judge.observe(truth, pose.as_ref(), actuation.as_ref());
        })?;
        let judgement = judge.judge(drive.outcome, &drive.reason);
        let (outcome, reason) = (drive.outcome, drive.reason);
        Ok(Self {
            course,
            scenario,
            family: course.family(arguments).to_owned(),
            gap_m,
            outcome,
            reason,
            judgement,
            time_s,
            min_clearance_m,
            min_rest_clearance_m,
            without_rest,
            digest: digests.whole(),
        })
    }

    /// Whether the robot got to the other side of all obstacles.
    pub(super) fn passed(&self) -> bool {
        matches!(self.outcome, Outcome::Reached | Outcome::Missed)
    }
}
