//! The start of a process beside the one that fills its role: complete, or not at all.

use handover::swap::watch::Watch;
use runtime::HandoverData;
use shared_types::{Role, Topic};
use supervision::entry::ProcessEntry;
use supervision::supervisor::VisibleState;

use super::Session;

impl Session {
    /// Starts a process beside the one that fills `role`, writes it down and watches its output.
    ///
    /// # Errors
    /// When shared memory or a file system is full, or the command can't be started; then no such process runs.
    pub(super) fn start_candidate(
        &mut self,
        role: Role,
        entry: ProcessEntry,
        incarnation: u32,
    ) -> anyhow::Result<Watch> {
        let handover = self.hand_over(role);
        self.fleet.spawn_candidate(role, entry, incarnation, handover.as_ref())?;
        // After the start: until then the reserve holds the memory of what is watched with.
        let watch = Watch::new(&self.bus, role).map_err(anyhow::Error::from);
        let begun = watch.and_then(|watch| self.write_registry().map(|()| watch));
        if begun.is_err() {
            self.fleet.dismiss(incarnation);
        }
        begun
    }

    /// Holds shared memory for the next process, while none is on its way.
    pub(super) fn keep_room(&mut self) {
        let starts = self.supervisor.processes().any(|view| view.state == VisibleState::Starting);
        if let Some(shortage) = self.fleet.keep_room(&self.bus, starts) {
            self.progress.warn(&format!("no reserve for a swap or a restart: {shortage}"));
        }
    }

    /// What the process of a role that has ended, or was killed because it hung, leaves to its successor.
    pub(super) fn left_behind(&self, role: Role) -> Option<HandoverData> {
        let data = self.hand_over(role)?;
        let ended_ns = self.vitals.last_beat_ns(data.checkpoint.header.incarnation);
        Some(HandoverData { ended_ns, ..data })
    }

    /// What the running process of a role hands to one that starts while it drives.
    pub(super) fn hand_over(&self, role: Role) -> Option<HandoverData> {
        let checkpoint = *self.vitals.checkpoint(role)?;
        let reads_actuations = role.reads().contains(&Topic::Actuation);
        let actuations = self.samples.recent_actuations().filter(|_| reads_actuations).copied().collect();
        Some(HandoverData { checkpoint, ended_ns: 0, actuations })
    }
}
