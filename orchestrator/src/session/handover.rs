//! What a process of a run leaves to the one that takes its place.

use runtime::HandoverData;
use shared_types::{Role, Topic};

use super::Session;

impl Session {
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
