//! The part of a session that writes down what another orchestrator would have to know, before it is told to anyone.

use emulator::Outcome;
use runtime::monotonic_ns;
use shared_types::{Authority, ROLES, Role};

use super::Session;
use crate::process_registry::{ProcessRegistry, Right, RoleRow};

/// Time until what could not be written is tried again [ns].
const REWRITE_NS: u64 = 1_000_000_000;

/// What is compared to see whether something new has to be written down: phase, stop, authority, how the run ends.
type Content = (u32, u32, [Authority; ROLES], bool);

/// What was written down last.
#[derive(Default)]
pub(crate) struct RegistryFile {
    written: Option<Content>,
    /// When to write again what could not be written; 0 when all is written [ns].
    rewrite_ns: u64,
}

impl Session {
    /// [`Session::write_registry`], again every second while it fails.
    pub(super) fn update_registry(&mut self) {
        let (now_ns, failed) = (monotonic_ns(), self.registry_file.rewrite_ns > 0);
        if now_ns < self.registry_file.rewrite_ns {
            return;
        }
        self.registry_file.rewrite_ns = 0;
        if let Err(error) = self.write_registry() {
            self.registry_file.rewrite_ns = now_ns + REWRITE_NS;
            if !failed {
                self.progress.warn(&format!(
                    "the run can't be adopted, as its processes can't be written down: {error:#}"
                ));
            }
        }
    }

    /// Writes the roster when processes have come or gone, or everyone is to be told something new.
    ///
    /// # Errors
    /// Those of the file system; what could not be written is written by the next call.
    pub(super) fn write_registry(&mut self) -> anyhow::Result<()> {
        let directive = &self.directives.current;
        let word = (directive.phase, directive.stop, directive.authority, !self.conclusion.is_open());
        let has_changed = self.fleet.has_changed();
        if !has_changed && self.registry_file.written == Some(word) {
            return Ok(());
        }
        self.registry_file.written = None;
        self.process_registry().write(&self.domain)?;
        self.registry_file.written = Some(word);
        Ok(())
    }

    fn process_registry(&self) -> ProcessRegistry {
        let directive = &self.directives.current;
        let decided = self.conclusion.decided();
        let (outcome, reason) =
            (decided.map(|(outcome, _)| outcome), decided.map_or("", |(_, reason)| reason));
        let row = |role: &Role| {
            let view = self.supervisor.process(*role)?;
            let entry = self.fleet.entry(*role)?.clone();
            // The last one that was really started: the supervisor gives numbers to all before the first exists.
            let (incarnation, restarts) = (self.fleet.incarnation(*role), view.restarts);
            Some(RoleRow { role: role.name().to_owned(), incarnation, restarts, entry })
        };
        ProcessRegistry {
            generation: directive.header.incarnation,
            last_incarnation: self.supervisor.last_incarnation(),
            phase: directive.phase,
            stop: directive.stop,
            outcome,
            reason: reason.to_owned(),
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
