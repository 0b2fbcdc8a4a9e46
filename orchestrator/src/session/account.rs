//! The part of a session that writes down what another orchestrator would have to know, before it is told to anyone.

use emulator::Outcome;
use shared_types::{Authority, ROLES, Role};

use super::{End, Session};
use crate::roster::{Right, RoleRow, Roster};

/// What is compared to see whether something new has to be written down: phase, stop, authority, how the run ends.
pub(crate) type Word = (u32, u32, [Authority; ROLES], bool);

impl Session {
    /// Writes the roster when processes have come or gone, or everyone is to be told something new.
    pub(super) fn keep_account(&mut self) {
        let directive = &self.directive;
        let word = (directive.phase, directive.stop, directive.authority, self.end != End::NotYet);
        let has_changed = self.fleet.has_changed();
        if !has_changed && self.written == Some(word) {
            return;
        }
        self.written = Some(word);
        if let Err(error) = self.roster().write(&self.domain) {
            tracing::warn!("who runs could not be written down, so nobody could adopt the run: {error:#}");
        }
    }

    fn roster(&self) -> Roster {
        let directive = &self.directive;
        let (outcome, reason) = match &self.end {
            End::NotYet => (None, String::new()),
            End::Resting(outcome, reason, _)
            | End::Draining(outcome, reason, _)
            | End::Ending(outcome, reason) => (Some(*outcome), reason.clone()),
        };
        let row = |role: &Role| {
            let view = self.supervisor.process(*role)?;
            let entry = self.fleet.entry(*role)?.clone();
            // The last one that was really started: the supervisor gives numbers to all before the first exists.
            let (incarnation, restarts) = (self.fleet.incarnation(*role), view.restarts);
            Some(RoleRow { role: role.name().to_owned(), incarnation, restarts, entry })
        };
        Roster {
            generation: directive.header.incarnation,
            last_incarnation: self.supervisor.last_incarnation(),
            phase: directive.phase,
            stop: directive.stop,
            outcome,
            reason,
            authority: directive.authority.iter().map(Right::from).collect(),
            role: Role::ALL.iter().filter_map(row).collect(),
            process: self.fleet.rows(),
        }
    }

    /// Goes on with an end that the orchestrator before had decided.
    pub(crate) fn resume_end(&mut self, outcome: Option<Outcome>, reason: String) {
        if let Some(outcome) = outcome {
            self.decide(outcome, &reason);
        }
    }
}
