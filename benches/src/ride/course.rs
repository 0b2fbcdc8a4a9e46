//! One course: its drive, and its optimum.

use courses::course::{Family, of_campaign};
use courses::feasible;
use emulator::scene::Scene;
use emulator::{Outcome, Scenario};
use pipeline::PipelineSettings;
use plan::{Choice, Plan};
use report::ride::{RideFigures, RideRecording, RideTrace, measure};
use shared_types::Level;

use crate::optimum::{Course as Task, Optimum, Sightings, optimum};

use super::RideArguments;
use super::results::{Goals, Row};

/// Shipped scenarios that are not driven to their goal, that never end, or whose system is another one.
const LEFT_OUT: [&str; 4] = ["endless", "blocked", "sudden", "thesis"];

/// What is driven.
pub(super) struct Course {
    plan: Plan,
    /// Family of a random course.
    family: Option<Family>,
}

/// What was driven.
struct Driven {
    outcome: Outcome,
    reason: String,
    drive: RideTrace,
    sightings: Sightings,
    plans: usize,
    active_ellipse_plans: usize,
}

/// The chosen courses.
///
/// # Errors
/// A scenario or a setting that is not allowed; exit code 2.
pub(super) fn all(arguments: &RideArguments) -> anyhow::Result<Vec<Course>> {
    let preset = format!("robot.preset={}", arguments.robot.name());
    let overrides = std::iter::once(preset).chain(arguments.choice.overrides.iter().cloned()).collect();
    let choice = Choice { overrides, ..arguments.choice.clone() };
    if let Some(count) = arguments.random {
        return random(count, &choice);
    }
    let bends = |name: &str| Scenario::shipped(name).is_some_and(|text| text.contains("[course]"));
    let is_driven = |name: &&str| !LEFT_OUT.contains(name) && !bends(name);
    let shipped = || Scenario::names().filter(is_driven).map(str::to_owned).collect();
    let names: Vec<String> =
        if arguments.scenarios.is_empty() { shipped() } else { arguments.scenarios.clone() };
    let course = |name: &String| {
        let plan = Plan::read(Some(name), &choice)?;
        if plan.scenario.goal.all().len() > 1 {
            let allowed = "one with one goal; a ride has no stays";
            anyhow::bail!("scenario = {name} is not allowed: {allowed}");
        }
        Ok(Course { plan, family: None })
    };
    names.iter().map(course).collect()
}

/// The first `count` courses of a campaign, from the seed on, that are passable and not blocked.
fn random(count: u64, choice: &Choice) -> anyhow::Result<Vec<Course>> {
    let first = choice.seed.unwrap_or(1);
    let choice = Choice { seed: None, ..choice.clone() };
    let courses = (0..).map(|index| of_campaign(first.wrapping_add(index)));
    courses
        .filter(|(family, scenario)| *family != Family::Blocked && feasible::passable(scenario))
        .take(usize::try_from(count)?)
        .map(|(family, scenario)| Ok(Course { plan: Plan::of(&scenario, &choice)?, family: Some(family) }))
        .collect()
}

impl Course {
    /// The seed of a random course.
    pub(super) fn seed(&self) -> Option<u64> {
        self.family.map(|_| self.plan.scenario.seed)
    }

    /// Drives the course and computes its optimum.
    pub(super) fn measure(&self) -> anyhow::Result<(Row, Option<Optimum>)> {
        let scenario = &self.plan.scenario;
        let Driven { outcome, reason, drive, sightings, plans, active_ellipse_plans } = self.drive()?;
        let mut row = Row {
            name: scenario.name.clone(),
            family: self.family.map(Family::name),
            outcome,
            plans,
            active_ellipse_plans,
            note: reason,
            ..Row::default()
        };
        let goal = scenario.goals_on_course()[0];
        let drive = match &scenario.course {
            Some(course) => drive.along(course),
            None => drive,
        };
        let driven = if outcome == Outcome::Reached { measure(&drive, &goal) } else { None };
        let Some(driven) = driven else { return Ok((row, None)) };
        (row.driven, row.goals) = (Some(driven), Goals::of(&driven, None));
        if scenario.course.is_some() {
            row.note = "this optimum knows no [course]".to_owned();
            return Ok((row, None));
        }
        let Some(task) = self.task(&drive, &sightings) else { return Ok((row, None)) };
        match optimum(&task) {
            Ok(best) => {
                row.compare(driven, self.figures(&best.drive));
                Ok((row, Some(best)))
            }
            Err(missing) => {
                row.note = missing.to_string();
                Ok((row, None))
            }
        }
    }

    fn drive(&self) -> anyhow::Result<Driven> {
        let Plan { scenario, system, .. } = &self.plan;
        let settings = PipelineSettings {
            scenario: scenario.clone(),
            tuning: system.tuning(),
            period_ns: system.period_ns(),
        };
        let (mut recording, mut sightings) = (RideRecording::default(), Sightings::default());
        let (mut plans, mut active_ellipse_plans) = (0, 0);
        let end = pipeline::drive(&settings, |step| {
            recording.truth(&step.truth);
            if let Some(actuation) = &step.actuation {
                recording.actuation(actuation);
            }
            if let Some(obstacles) = &step.obstacles {
                sightings.add(&step.truth, obstacles, step.command.as_ref());
            }
            if step.command.is_some_and(|command| command.level == Level::Converged.wire()) {
                plans += 1;
                active_ellipse_plans += usize::from(step.active_ellipses > 0);
            }
        })?;
        Ok(Driven {
            outcome: end.outcome,
            reason: end.reason,
            drive: recording.drive(),
            sightings,
            plans,
            active_ellipse_plans,
        })
    }

    /// What the optimum drives.
    fn task(&self, drive: &RideTrace, sightings: &Sightings) -> Option<Task> {
        let Plan { scenario, system, .. } = &self.plan;
        let config = system.tuning().for_scenario(scenario).controller;
        let start_s = drive.start_s()?;
        let before_s = drive.moments.iter().rev().find(|moment| moment.time_s <= start_s)?.time_s;
        Some(Task {
            parameters: config.vehicle.parameters(),
            bounds: config.vehicle.bounds,
            x_range: config.track.x_m,
            y_range: config.y_range(),
            goal: scenario.goal.last(),
            start_s,
            start: drive.advanced_to(start_s)?.state,
            ellipses: sightings.ellipses(config.ellipse_margin_m, start_s - before_s),
        })
    }

    /// The figures of an optimum, with its clearance in the true scene.
    fn figures(&self, drive: &RideTrace) -> Option<RideFigures> {
        let scenario = &self.plan.scenario;
        let mut scene = Scene::new(scenario);
        let mut drive = drive.clone();
        for moment in &mut drive.moments {
            let body = scenario.body(moment.state.x, moment.state.y, moment.state.yaw);
            scene.trigger(&body, moment.time_s);
            moment.clearance_m = scene.clearance(&body, moment.time_s);
        }
        measure(&drive, &scenario.goal.last())
    }
}
