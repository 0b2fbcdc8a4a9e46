//! A goal that changes while the system drives: `goal.x_m=8`, or `goal.0.x_m=8` of several.

use console::exit::Failure;
use emulator::Scenario;
use emulator::scenario::Start;
use shared_types::Pose;
use vehicle::{Goal, Goals, Invalid, State};

use crate::Plan;
use crate::overrides::{parse_override, set};
use crate::possible::{legs, require_legs};

/// A goal that takes the place of another.
#[derive(Debug, Clone)]
pub struct ChangedGoal {
    /// The scenario with it.
    pub scenario: Scenario,
    /// Which goal it is, from 0.
    pub index: usize,
    /// The same goal along and across the course, as the controller has it.
    pub on_course: Goal,
}

impl ChangedGoal {
    /// The goal in the plane.
    pub fn in_plane(&self) -> Goal {
        self.scenario.goal.all()[self.index]
    }
}

/// How far a drive has come.
#[derive(Debug, Clone, Copy)]
pub struct DriveSoFar<'p> {
    /// How many goals were reached.
    pub reached: usize,
    /// How far it has come along the course, in its lap [m].
    pub along_m: f64,
    /// Where the robot is.
    pub pose: &'p Pose,
    /// How long it drives on before a new goal counts [s].
    pub notice_s: f64,
}

/// Whether a text `KEY=VALUE` sets a part of a goal.
pub fn is_of_goal(text: &str) -> bool {
    text.split_once('=').is_some_and(|(key, _)| key.trim().starts_with("goal."))
}

/// Changes keys of one goal of a system that drives.
///
/// # Errors
/// Keys of several goals, a value that is not allowed, a goal that was reached before, and one that the robot does not get
/// to from where it is; exit code 2.
pub fn change(plan: &Plan, overrides: &[String], drive: &DriveSoFar<'_>) -> anyhow::Result<ChangedGoal> {
    let mut table = plan.scenario.to_table();
    let mut index = None;
    for text in overrides {
        let (key, value) = parse_override(text)?;
        let key = key_among(&key, &plan.scenario.goal, drive.reached);
        let part = key.split('.').nth(1).unwrap_or_default();
        let of = part.parse().unwrap_or(0_usize);
        if index.is_some_and(|index| index != of) {
            return Err(Failure::bad_input(format!("{key} is of another goal: change one goal at a time")));
        }
        index = Some(of);
        set(&mut table, &key, value)?;
    }
    let index = index.ok_or_else(|| Failure::bad_input("expected KEY=VALUE"))?;
    let is_drawn_through =
        plan.scenario.course.as_ref().is_some_and(|course| course.keys().waypoints.is_empty());
    if is_drawn_through {
        return Err(Failure::bad_input(
            "goal can't be set while the system drives: the [course] of the scenario has no waypoints and leads through \
             its goals",
        ));
    }
    let scenario = Scenario::checked(table).map_err(Failure::bad_input)?;
    let Some(later) = index.checked_sub(drive.reached) else {
        return Err(Failure::bad_input(format!(
            "goal {} of {} was reached before",
            index + 1,
            scenario.goal.all().len()
        )));
    };
    let ahead = scenario.goals_ahead(drive.reached, drive.along_m);
    let Some(on_course) = ahead.get(later).copied() else {
        return Err(Failure::bad_input(format!("goal {index} is no goal of the scenario")));
    };
    let changed = ChangedGoal { scenario, index, on_course };
    changed.require_reachable(plan, drive, &ahead).map_err(Failure::bad_input)?;
    Ok(changed)
}

/// The key with the number of its goal where the scenario has `[[goal]]`, and without where it has `[goal]`. A key without
/// a number is of the goal that is next.
fn key_among(key: &str, goals: &Goals, reached: usize) -> String {
    let Some(rest) = key.strip_prefix("goal.") else { return key.to_owned() };
    let (first, after) = rest.split_once('.').unwrap_or((rest, ""));
    match (goals.is_list(), first.parse::<usize>()) {
        (true, Err(_)) => format!("goal.{}.{rest}", reached.min(goals.all().len() - 1)),
        (false, Ok(0)) if !after.is_empty() => format!("goal.{after}"),
        _ => key.to_owned(),
    }
}

impl ChangedGoal {
    /// Passes when the robot can land at each goal that is left, those of `ahead`, from where it is, on an empty track.
    fn require_reachable(&self, plan: &Plan, drive: &DriveSoFar<'_>, ahead: &[Goal]) -> Result<(), Invalid> {
        let Self { scenario, index, on_course: goal } = self;
        let tuning = plan.system.tuning().for_scenario(scenario);
        let (goals, pose) = (&scenario.goal, drive.pose);
        let on_course = |start: &Start| {
            let state = State { x: start.x_m, y: start.y_m, yaw: start.yaw_rad, ..State::default() };
            let course = scenario.course.as_ref();
            let State { x, y, yaw, .. } =
                course.map_or(state, |course| course.on_course(&state, drive.along_m));
            Start { x_m: x, y_m: y, yaw_rad: yaw }
        };
        if *index == drive.reached {
            let here = on_course(&Start { x_m: pose.x_m, y_m: pose.y_m, yaw_rad: pose.yaw_rad });
            let speed_mps = pose.speed_mps.abs();
            let vehicle = &tuning.controller.vehicle;
            let stop_m =
                speed_mps * drive.notice_s + speed_mps * speed_mps / (2.0 * vehicle.deceleration_max_mps2);
            let ahead_m = goal.x_m - here.x_m;
            if ahead_m + goal.tolerance_m < stop_m {
                let allowed = format!(
                    "at least {:.2} m further on than the robot, which drives {speed_mps:.2} m/s at ({:.2}, {:.2}): this goal \
                     is {ahead_m:.2} m further on; it turns round only for the goals that a drive starts with, by \
                     `course.turn_radius_m`",
                    stop_m - goal.tolerance_m,
                    pose.x_m,
                    pose.y_m
                );
                let goal = self.in_plane();
                return Err(Invalid::new(
                    &goals.key(*index),
                    format!("({}, {})", goal.x_m, goal.y_m),
                    allowed,
                ));
            }
        }
        // Until the goal counts the robot drives on.
        let (on_m, (sin, cos)) = (pose.speed_mps * drive.notice_s, pose.yaw_rad.sin_cos());
        let (x_m, y_m) = (pose.x_m + on_m * cos, pose.y_m + on_m * sin);
        let start = Start { x_m, y_m, yaw_rad: pose.yaw_rad };
        let left = legs(on_course(&start), (drive.reached..).zip(ahead.iter().copied()), goals);
        require_legs(&Scenario { start, ..scenario.clone() }, &tuning.controller, &left)
    }
}
