//! A goal that changes while the system drives: `goal.x_m=8`, or `goal.0.x_m=8` of several.

use console::exit::Failure;
use emulator::Scenario;
use emulator::scenario::Start;
use shared_types::Pose;
use vehicle::{Goal, Goals, Invalid, State};

use crate::Plan;
use crate::overrides::{parse_override, set};
use crate::possible::require_goals;

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
    let Some(on_course) = scenario.goals_on_course().get(index).copied() else {
        return Err(Failure::bad_input(format!("goal {index} is no goal of the scenario")));
    };
    if index < drive.reached {
        return Err(Failure::bad_input(format!(
            "goal {} of {} was reached before",
            index + 1,
            scenario.goal.all().len()
        )));
    }
    let changed = ChangedGoal { scenario, index, on_course };
    changed.require_reachable(plan, drive).map_err(Failure::bad_input)?;
    Ok(changed)
}

impl ChangedGoal {
    /// Passes when the robot can land at each goal that is left, from where it is, on an empty track.
    fn require_reachable(&self, plan: &Plan, drive: &DriveSoFar<'_>) -> Result<(), Invalid> {
        let Self { scenario, index, on_course } = self;
        let tuning = plan.system.tuning().for_scenario(scenario);
        let (goals, pose) = (&scenario.goal, drive.pose);
        if *index == drive.reached {
            let here = scenario.course.as_ref().map_or([pose.x_m, pose.y_m, pose.yaw_rad], |course| {
                let state = State { x: pose.x_m, y: pose.y_m, yaw: pose.yaw_rad, ..State::default() };
                let on = course.on_course(&state, course.find(&state));
                [on.x, on.y, on.yaw]
            });
            let speed_mps = pose.speed_mps.abs();
            let vehicle = &tuning.controller.vehicle;
            let stop_m =
                speed_mps * drive.notice_s + speed_mps * speed_mps / (2.0 * vehicle.deceleration_max_mps2);
            let ahead_m = on_course.x_m - here[0];
            if ahead_m + on_course.tolerance_m < stop_m {
                let allowed = format!(
                    "at least {:.2} m further on than the robot, which drives {speed_mps:.2} m/s at ({:.2}, {:.2}): this goal \
                     is {ahead_m:.2} m further on",
                    stop_m - on_course.tolerance_m,
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
        let left = Scenario { start, goal: goals.left(drive.reached), ..scenario.clone() };
        require_goals(&left, &tuning.controller).map_err(|invalid| renamed(invalid, goals, drive.reached))
    }
}

/// A refusal of the goals that are left, with the number of the goal among all.
fn renamed(invalid: Invalid, goals: &Goals, reached: usize) -> Invalid {
    let named = (0..goals.all().len()).find_map(|index| {
        let rest = invalid.key.strip_prefix(&goals.key(index))?;
        Some(format!("{}{rest}", goals.key(index + reached)))
    });
    Invalid { key: named.unwrap_or_else(|| invalid.key.clone()), ..invalid }
}
