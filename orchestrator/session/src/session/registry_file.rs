//! Keeps the process registry up to date: what another orchestrator needs for an adoption is recorded before any
//! process receives it.

use emulator::Outcome;
use runtime::monotonic_ns;
use shared_types::{Authority, Role, SLOTS};

use super::Session;
use crate::process_registry::{ProcessRegistry, Right, RoleRow, noted_progress};

/// Pause before a registry that could not be written is written again [ns].
const REWRITE_NS: u64 = 1_000_000_000;

/// The registry is written when one of these changes: phase, stop, who drives, authority, whether the run ends.
type Content = (u32, u32, u32, [Authority; SLOTS], bool);

/// The content that was written last.
#[derive(Default)]
pub(crate) struct RegistryFile {
    written: Option<Content>,
    /// When to try again after a failure; 0 when all is written [ns].
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
                self.warn(&format!(
                    "the run can't be adopted, as its process registry can't be written: {error:#}"
                ));
            }
        }
    }

    /// Writes the registry when a process has started or ended, or the directive has changed.
    ///
    /// # Errors
    /// Those of the file system; what could not be written is written by the next call.
    pub(super) fn write_registry(&mut self) -> anyhow::Result<()> {
        let directive = &self.directives.current;
        let is_decided = !self.conclusion.is_open();
        let content = (directive.phase, directive.stop, directive.driven_by, directive.authority, is_decided);
        let has_changed = self.fleet.has_changed();
        if !has_changed && self.registry_file.written == Some(content) {
            return Ok(());
        }
        self.registry_file.written = None;
        self.process_registry().write(&self.run.domain)?;
        self.registry_file.written = Some(content);
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
            // The last one that was started: the supervisor numbers all of them before the first exists.
            let (incarnation, restarts) = (self.fleet.incarnation(*role), view.restarts);
            Some(RoleRow { role: *role, incarnation, restarts, entry })
        };
        ProcessRegistry {
            generation: directive.header.incarnation,
            last_incarnation: self.supervisor.last_incarnation(),
            phase: directive.phase,
            stop: directive.stop,
            driven_by: directive.driven_by,
            judged_by: self.judged_by,
            outcome,
            reason: reason.to_owned(),
            authority: directive.authority.iter().map(Right::from).collect(),
            role: Role::ALL.iter().filter_map(row).collect(),
            process: self.fleet.rows(),
        }
    }

    /// Continues at the goal and in the lap that the orchestrator before has noted.
    pub(crate) fn resume_progress(&mut self) {
        noted_progress(&self.run.domain).into_iter().for_each(|progress| self.recording.resume(progress));
    }

    /// Continues the end of a run that the orchestrator before has decided.
    pub(crate) fn resume_end(&mut self, outcome: Option<Outcome>, reason: String) {
        if let Some(outcome) = outcome {
            self.decide(outcome, &reason);
        }
    }
}
