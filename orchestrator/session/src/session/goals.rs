//! Goals that change while the system drives: for the controller by the directive, for referee and report from the same
//! scan on, and in the files from which a process starts again or another orchestrator adopts the run.

use audit::samples::Samples;
use console::exit::Failure;
use plan::change;
use plan::goal::{ChangedGoal, DriveSoFar};
use report::GoalChange;
use runtime::settings_file;
use shared_types::{GivenGoal, Role};
use supervision::directives::Directives;
use vehicle::Goal;

use super::Run;
use super::recording::{AwaitedGoal, Recording};
use crate::process_registry::{RUN_FILE, RunFile};

/// So many scans after the newest one a goal counts: all processes have the directive by then.
const NOTICE_SCANS: u64 = 2;
/// The same as a time, where scans follow each other faster [ns].
const NOTICE_NS: u64 = 20_000_000;

/// The parts of a session that a goal concerns.
pub(super) struct GoalParts<'s> {
    pub(super) run: &'s Run,
    pub(super) recording: &'s mut Recording,
    pub(super) samples: &'s Samples,
    pub(super) directives: &'s mut Directives,
}

impl GoalParts<'_> {
    /// Changes keys of one goal; returns the first scan for which it counts, and what the user is told.
    ///
    /// # Errors
    /// Why it does not change.
    pub(super) fn change(&mut self, overrides: &[String]) -> anyhow::Result<(u64, String)> {
        if self.recording.awaits_goal() {
            return Err(Failure::bad_input("the goal that was set before does not count yet: try again"));
        }
        let pose = &self.recording.recorder.last_pose().copied();
        let pose = pose.as_ref().ok_or_else(|| Failure::bad_input("the robot has no pose yet: try again"))?;
        let Run { domain, period_ns, lockstep, .. } = self.run;
        let notice = NOTICE_SCANS.max(NOTICE_NS.div_ceil(*period_ns));
        let notice_s = (notice * period_ns) as f64 * 1e-9;
        let (mut run, plan) = RunFile::read(domain)?;
        let (reached, along_m) = (self.recording.reached(), self.recording.along_m());
        let drive = DriveSoFar { reached, along_m, pose, notice_s };
        let changed = plan::goal::change(&plan, overrides, &drive)?;
        // In lock-step no scan after the granted one is published before the next directive.
        let newest = self.samples.newest_scan().max(self.directives.current.granted_scan);
        let from_scan = newest + if *lockstep { 1 } else { notice };
        // A controller that starts again has the goal among its settings.
        let (folder, name) = (domain.folder(), settings_file(Role::Controller));
        let settings = change::with_goal(&folder.read_text(&name)?, changed.index, &changed.on_course)?;
        run.scenario = changed.scenario.clone();
        let run = run.text()?;
        folder.write_all(&[(&name, settings.as_bytes()), (RUN_FILE, run.as_bytes())])?;
        Ok((from_scan, self.announce(&changed, from_scan)))
    }

    fn announce(&mut self, changed: &ChangedGoal, from_scan: u64) -> String {
        let (goal, index) = (changed.in_plane(), changed.index);
        let change = GoalChange { from_scan, goal: index, x_m: goal.x_m, y_m: goal.y_m };
        self.recording.change_goal(AwaitedGoal { change, goal, along_m: changed.on_course.x_m });
        self.directives.current.goal = given(&changed.on_course, index, from_scan);
        self.directives.changed = true;
        let is_one_of_several = changed.scenario.goal.all().len() > 1;
        let which = if is_one_of_several { format!(" {}", index + 1) } else { String::new() };
        format!("goal{which} is at ({}, {}) m from scan {from_scan} on", goal.x_m, goal.y_m)
    }
}

/// A goal along and across the course, for the directive.
fn given(goal: &Goal, index: usize, from_scan: u64) -> GivenGoal {
    GivenGoal {
        from_scan,
        index: index as u32,
        has_yaw: u32::from(goal.yaw_rad.is_some()),
        x_m: goal.x_m,
        y_m: goal.y_m,
        tolerance_m: goal.tolerance_m,
        yaw_rad: goal.yaw_rad.unwrap_or_default(),
        yaw_tolerance_rad: goal.yaw_tolerance_rad,
        stay_s: goal.stay_s,
    }
}
