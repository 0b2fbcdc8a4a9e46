//! Recomputes commands.

use std::cell::Cell;

use nmpc::{Budget, Config, ControllerState};
use shared_types::{Command, JournalEntry, JournalKind, Obstacles, Pose, Role, Topic};

use super::journal::{Missing, Stage};
use crate::Drive;

/// The process of a controller.
pub(super) struct Controller<'d> {
    controller: nmpc::Controller,
    pose: Option<&'d Pose>,
    obstacles: Option<&'d Obstacles>,
    /// In simulated time, the budget of a solution.
    iterations: Option<u32>,
    /// After how many readings of the clock the budget of this scan ends.
    readings: Option<u64>,
    /// With other settings a solution takes another time, and its budget does not end.
    is_changed: bool,
}

impl<'d> Stage<'d> for Controller<'d> {
    type Output = Command;
    type State = ControllerState;
    const ROLE: Role = Role::Controller;

    fn begin(drive: &'d Drive) -> anyhow::Result<Self> {
        let config: Config = drive.table(Role::Controller, "controller")?;
        let iterations = drive.simulated.then_some(config.budget_iterations);
        let controller = nmpc::Controller::new(config)?;
        let is_changed = drive.is_changed;
        Ok(Self { controller, pose: None, obstacles: None, iterations, readings: None, is_changed })
    }

    fn resume(&mut self, state: &ControllerState) -> bool {
        self.controller.resume(state);
        true
    }

    fn take(&mut self, entry: &JournalEntry, drive: &'d Drive) {
        if entry.topic == Topic::Pose as u16 {
            self.pose = drive.poses.of_number(entry.incarnation, entry.value);
        } else {
            self.obstacles = drive.obstacles.of_number(entry.incarnation, entry.value);
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
        let (pose, obstacles) = self.pose.zip(self.obstacles).ok_or(Missing)?;
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
