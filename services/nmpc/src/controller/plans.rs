//! A plan that may be driven, or the reason why there is none: along the path, along the last plan, out of the way of a body, and
//! for a person.

use ocp::Budget;
use shared_types::{Blocking, Command, Level, Pose, StopReason};

use super::Controller;
use crate::blocking::blocking;
use crate::by_person;
use crate::escape::struck_at_rest;
use crate::margin::MarginModel;
use crate::planner::{Choice, Task};
use crate::query::Query;
use crate::side;
use crate::start::Start;
use crate::stop_rule::blocked_by;
use crate::warm;

/// A plan that the search does not agree with may have this slack.
const CONTINUED_SLACK: f64 = 0.01;
/// Blocked wheels that slide further than this are worth a slower plan [m].
const SLIDE_M: f64 = 0.2;

impl Controller {
    /// What a person asks for as a plan of one interval, which is verified as any other; slower where that is not refused.
    pub(super) fn follow_person(
        &mut self,
        start: &Start,
        pose: &Pose,
        command: &mut Command,
    ) -> Result<Choice, StopReason> {
        let Self { config, predicted, planner, state, .. } = self;
        let scene = start.scene(config, predicted);
        let period_ns = (config.period_s * 1e9) as u64;
        let asked = by_person::asked(&scene, &state.person, pose.header.acquired_ns, period_ns);
        let (choice, index) = by_person::follow(&scene, asked.ok_or(StopReason::Released)?, planner);
        command.blocking = index.map(|index| blocking(&scene, index)).unwrap_or_default();
        choice.ok_or(StopReason::Blocked)
    }

    /// A plan that may be driven, unless the path is blocked, or was until lately.
    pub(super) fn wait_or_plan(
        &mut self,
        start: &Start,
        pose: &Pose,
        budget: &Budget,
        command: &mut Command,
    ) -> Result<Choice, StopReason> {
        self.wait_until_clear().inspect_err(|_| {
            let scene = start.scene(&self.config, &self.predicted);
            let index = blocked_by(&scene, &[], start.stop_m(), f64::INFINITY);
            command.blocking = index.map(|index| blocking(&scene, index)).unwrap_or_default();
        })?;
        self.plan(start, pose, budget, command)
    }

    /// A plan out of the way of a body that would strike the robot if it stopped: past the obstacles with little clearance,
    /// or a turn that keeps the largest; with the margin that it keeps.
    pub(super) fn escape(
        &mut self,
        start: &Start,
        pose: &Pose,
        budget: &Budget,
        command: &mut Command,
    ) -> Option<(Choice, MarginModel)> {
        let Self { config, search, predicted, reference_path, state, planner, .. } = self;
        let scene = start.scene(config, predicted);
        let stopped_m = struck_at_rest(&scene, &start.stopping)?;
        let (speed, sides) = (config.cruise_mps.min(start.limit_mps), &state.sides);
        let bare = scene.keeping(start.margin.bare(), start.speed);
        search.find(&Query { scene: bare, speed, narrow: true, sides, forced: None }, reference_path);
        let task = Task::new(bare, reference_path, state, pose, start);
        let planned = if reference_path.clear { planner.plan(&task, budget, command) } else { None };
        if planned.is_some() {
            side::renew(&mut state.sides, predicted, |obstacle| reference_path.side_of(obstacle));
        }
        let task = Task::new(scene, reference_path, state, pose, start);
        let escape = match planned {
            Some(choice) => (choice, bare.margin),
            None => (planner.escape(&task, stopped_m)?, start.margin.none()),
        };
        command.blocking = Blocking::default();
        Some(escape)
    }

    /// The last plan, corrected, where it leads past the obstacles although the search found no path: the search is
    /// coarser than a plan that drives along an ellipse.
    pub(super) fn continue_plan(
        &mut self,
        start: &Start,
        pose: &Pose,
        budget: &Budget,
        command: &mut Command,
    ) -> Option<Choice> {
        let Self { config, predicted, alternative, state, planner, .. } = self;
        alternative.set_line(start.initial.x, config.goal.y_m, config.cruise_mps.min(start.limit_mps));
        let scene = start.scene(config, predicted);
        let task = Task::new(scene, alternative, state, pose, start);
        let choice = planner.continue_plan(&task, budget, &mut 0, command)?;
        let is_open = choice.level == Level::Converged
            && command.slack < CONTINUED_SLACK
            && planner.is_fast()
            && blocked_by(&scene, &planner.rollout.samples, start.stop_m(), f64::NEG_INFINITY).is_none();
        is_open.then_some(choice)
    }

    /// A plan that may be driven, unless the path is blocked.
    fn plan(
        &mut self,
        start: &Start,
        pose: &Pose,
        budget: &Budget,
        command: &mut Command,
    ) -> Result<Choice, StopReason> {
        let other = self.cost_of_alternative(start, pose, budget, command);
        let Self { config, predicted, reference_path, alternative, contest, state, planner, .. } = self;
        let scene = start.scene(config, predicted);
        let task = Task::new(scene, reference_path, state, pose, start);
        let mut choice = planner.plan(&task, budget, command);
        let own = choice.filter(|choice| choice.level == Level::Converged).map(|_| command.objective);
        if let Some(contest) = contest {
            command.sides = contest.compare(own, other);
        }
        if let (Some(contest), Some(other)) = (contest, other)
            && own.is_none_or(|own| contest.share * own > other)
        {
            std::mem::swap(reference_path, alternative);
            side::renew(&mut state.sides, predicted, |obstacle| reference_path.side_of(obstacle));
            let task = Task::new(scene, reference_path, state, pose, start);
            choice = planner.plan(&task, budget, command);
        }
        let mut task = Task::new(scene, reference_path, state, pose, start);
        // Where blocked wheels slide far, a slower plan may keep clear although the fast one does not.
        let slowest = config.vehicle.bounds.velocity_min_mps;
        while choice.is_none()
            && start.stopping.slide(task.fastest_mps) > SLIDE_M
            && task.fastest_mps > slowest
        {
            task.fastest_mps = (task.fastest_mps / 2.0).max(slowest);
            choice = planner.plan(&task, budget, command);
        }
        let plan = if choice.is_some() { planner.rollout.samples.as_slice() } else { &[] };
        let follows_reference =
            choice.is_some() && reference_path.clear && warm::agrees(&scene, reference_path, plan);
        // Without a plan the robot stops at once, so no slack is accepted.
        let slack = if choice.is_some() { command.slack - config.stop.slack } else { f64::INFINITY };
        let is_open = follows_reference || (choice.is_none() && reference_path.clear);
        let refused_for = planner.refused_for;
        if !is_open && let Some(index) = blocked_by(&scene, plan, start.stop_m(), slack) {
            command.blocking = blocking(&scene, index);
            return Err(StopReason::Blocked);
        }
        choice.ok_or_else(|| {
            command.blocking = refused_for.map(|index| blocking(&scene, index)).unwrap_or_default();
            if planner.comes_unseen { StopReason::Unseen } else { StopReason::Unverified }
        })
    }

    /// Objective of a plan along the alternative; `None` without one that can be driven.
    fn cost_of_alternative(
        &mut self,
        start: &Start,
        pose: &Pose,
        budget: &Budget,
        command: &mut Command,
    ) -> Option<f64> {
        self.contest?;
        let Self { config, predicted, alternative, state, planner, .. } = self;
        let task = Task::new(start.scene(config, predicted), alternative, state, pose, start);
        let choice = planner.plan(&task, budget, command)?;
        (choice.level == Level::Converged).then_some(command.objective)
    }

    /// After a stop in front of a blocked path: waits until the path was clear for several scans.
    fn wait_until_clear(&mut self) -> Result<(), StopReason> {
        if self.state.blocked_scans == 0 {
            return Ok(());
        }
        self.state.clear_scans =
            if self.reference_path.clear { self.state.clear_scans.saturating_add(1) } else { 0 };
        let stop = &self.config.stop;
        if self.state.blocked_scans < stop.hold_scans || self.state.clear_scans < stop.resume_scans {
            return Err(StopReason::Blocked);
        }
        Ok(())
    }
}
