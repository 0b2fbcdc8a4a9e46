//! Recomputes actuations.

use actuation::{ActuatorConfig, ActuatorState};
use shared_types::{Actuation, Command, JournalEntry, JournalKind, Role};

use super::journal::{Missing, Stage, Taking};
use crate::ReplayDrive;

/// The process of an actuator.
pub(super) struct Actuator {
    actuator: actuation::Actuator,
    command: Result<Command, Missing>,
    output: Option<Actuation>,
    /// The port makes the next output a block.
    is_held_back: bool,
}

impl Stage for Actuator {
    type Output = Actuation;
    type State = ActuatorState;
    const ROLE: Role = Role::Actuator;

    fn begin(drive: &ReplayDrive, incarnation: u32) -> anyhow::Result<Self> {
        let config: ActuatorConfig = drive.table_of(incarnation, Role::Actuator, "actuator")?;
        let actuator = actuation::Actuator::new(config, drive.period_ns)?;
        Ok(Self { actuator, command: Err(Missing::Input), output: None, is_held_back: false })
    }

    fn resume(&mut self, state: &ActuatorState) -> bool {
        self.actuator.resume(state).is_ok()
    }

    fn take(&mut self, entry: &JournalEntry, taking: &Taking<'_>) {
        self.command = taking.sample(&taking.drive.commands, entry);
    }

    fn follow(&mut self, kind: JournalKind, value: u64) -> Result<(), Missing> {
        match kind {
            JournalKind::Used => {
                let command = self.command.as_ref().map_err(|missing| *missing)?;
                self.output = Some(self.actuator.answer(command, value));
            }
            JournalKind::Timer => self.output = self.actuator.tick(value),
            JournalKind::Stopped => self.output = Some(self.actuator.stop(value)),
            JournalKind::Released => self.actuator.release(),
            JournalKind::Dropped => self.actuator.note_dropped(),
            JournalKind::HeldBack => self.is_held_back = true,
            _ => {}
        }
        Ok(())
    }

    fn output(&mut self, _: u64) -> Result<Actuation, Missing> {
        let mut output = self.output.take().ok_or(Missing::Input)?;
        if std::mem::take(&mut self.is_held_back) && output.drives() {
            output.hold_back();
        }
        Ok(output)
    }
}
