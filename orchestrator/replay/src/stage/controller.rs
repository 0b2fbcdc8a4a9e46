//! Recomputes commands.

use std::cell::Cell;

use nmpc::{Budget, ControllerConfig, ControllerState};
use shared_types::{Command, JournalEntry, JournalKind, Obstacles, Pose, Role, Topic};

use super::journal::{Missing, Stage, Taking};
use crate::ReplayDrive;

/// The process of a controller.
pub(super) struct Controller {
    controller: nmpc::Controller,
    pose: Result<Pose, Missing>,
    obstacles: Result<Obstacles, Missing>,
    /// In simulated time, the budget of a solution.
    iterations: Option<u32>,
    /// After how many readings of the clock the budget of this scan ends.
    readings: Option<u64>,
    /// With other settings a solution takes another time, and its budget does not end.
    is_changed: bool,
}

impl Stage for Controller {
    type Output = Command;
    type State = ControllerState;
    const ROLE: Role = Role::Controller;

    fn begin(drive: &ReplayDrive, incarnation: u32) -> anyhow::Result<Self> {
        let config: ControllerConfig = drive.table_of(incarnation, Role::Controller, "controller")?;
        let iterations = drive.simulated.then_some(config.budget_iterations);
        let controller = nmpc::Controller::new(config)?;
        let is_changed = drive.is_changed;
        let (pose, obstacles) = (Err(Missing::Input), Err(Missing::Input));
        Ok(Self { controller, pose, obstacles, iterations, readings: None, is_changed })
    }

    fn resume(&mut self, state: &ControllerState) -> bool {
        self.controller.resume(state);
        true
    }

    fn take(&mut self, entry: &JournalEntry, taking: &Taking<'_>) {
        if entry.topic == Topic::Pose as u16 {
            self.pose = taking.sample(&taking.drive.poses, entry);
        } else {
            self.obstacles = taking.sample(&taking.drive.obstacles, entry);
        }
    }

    fn follow(&mut self, kind: JournalKind, value: u64) -> Result<(), Missing> {
        match kind {
            JournalKind::Budget => self.readings = Some(value),
            JournalKind::BegunInStop => self.controller.start_in_stop(),
            _ => {}
        }
        Ok(())
    }

    fn output(&mut self, _: u64) -> Result<Command, Missing> {
        let pose = self.pose.as_ref().map_err(|missing| *missing)?;
        let obstacles = self.obstacles.as_ref().map_err(|missing| *missing)?;
        let (ends_after, read) = (self.readings.take().filter(|_| !self.is_changed), Cell::new(0));
        let now_ns = || {
            let is_over = ends_after.is_some_and(|readings| read.get() >= readings);
            read.set(read.get() + 1);
            u64::from(is_over)
        };
        let budget = match self.iterations {
            Some(iterations) => Budget::Iterations(iterations),
            None => Budget::Deadline { deadline_ns: 1, now_ns: &now_ns },
        };
        Ok(self.controller.step(pose, obstacles, &budget))
    }
}
