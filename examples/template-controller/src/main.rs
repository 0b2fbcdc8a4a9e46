//! A controller of your own, ready to be copied and changed.
//!
//! Once per scan it receives the pose of the robot and the obstacles, and publishes one command. The orders of the system tell
//! who drives: a person, `scanloop teleop`, gets what it asks for if that passes the same check. They also have the goal that
//! `scanloop set` has changed.
//!
//! * `main.rs` says what the stage reads, writes and saves. It stays as it is.
//! * `controller.rs` is the order of decisions for one scan: stop, land, or drive a verified plan.
//! * `planner.rs` proposes plans. **Replace this file by your own idea.**
//! * `verify.rs` checks a plan. Keep it: a command may have `verified = 1` only when its plan has passed.
//! * `settings.rs` names the settings that are read.

mod controller;
mod planner;
mod settings;
mod verify;

use std::process::ExitCode;

use shared_types::{
    AnySample, Command, Directive, Obstacles, Pose, Role, Sample, SampleType, Stage, Stopwatch,
};

use crate::controller::{Controller, Memory};
use crate::settings::Settings;

fn main() -> ExitCode {
    runtime::stage::main::<MyController>()
}

/// The stage: the controller and the samples that it has taken.
#[derive(Clone)]
struct MyController {
    controller: Controller,
    pose: Option<Pose>,
    obstacles: Option<Obstacles>,
}

impl Stage for MyController {
    type Settings = Settings;
    type Invalid = &'static str;
    type Output = Command;
    type State = Memory;

    const ROLE: Role = Role::Controller;
    const ANSWERS: &'static [&'static SampleType] = &[Pose::TYPE, Obstacles::TYPE];
    const TAKES_ORDERS: bool = true;

    fn begin(settings: Settings, period_ns: u64) -> Result<Self, &'static str> {
        if !settings.course.waypoints.is_empty() {
            return Err("this controller follows the line along x only, no [course]");
        }
        Ok(Self { controller: Controller::new(settings, period_ns), pose: None, obstacles: None })
    }

    fn resume(&mut self, memory: &Memory) -> bool {
        self.controller.memory = *memory;
        true
    }

    fn state(&self) -> Option<Memory> {
        Some(self.controller.memory)
    }

    fn take(&mut self, sample: AnySample<'_>, _now_ns: u64) {
        if let Some(pose) = sample.get() {
            self.pose = Some(*pose);
        } else if let Some(obstacles) = sample.get() {
            self.obstacles = Some(*obstacles);
        } else if let Some(Directive { driven_by, person, goal, .. }) = sample.get() {
            self.controller.give(goal);
            (self.controller.memory.driven_by, self.controller.memory.person) = (*driven_by, *person);
        }
    }

    fn output(&mut self, _scan_id: u64, _: &Stopwatch<'_>) -> Option<Command> {
        Some(self.controller.step(self.pose.as_ref()?, self.obstacles.as_ref()?))
    }
}
