//! State handed to a process that replaces another: a file, written before the process is started.
//!
//! Checkpoints travel on the bus, and are lost with their publisher's memory. So the orchestrator keeps the newest of
//! each role and hands it over here. With it go the actuations sent since: a process that hung has not seen that the
//! wheels were blocked.

use shared_types::{Actuation, Checkpoint, Role, Sample, shift_times};

use crate::{Domain, RuntimeError};

/// The state that a starting process finds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Handover<T> {
    /// Nothing ran before it.
    FirstStart,
    /// The state of the process before it.
    State(T),
    /// A process ran before it, and its state is too old, of another type, or was never published.
    ///
    /// The process must not produce output, because it would drive on a guess. Then the wheels are blocked.
    Lost,
}

/// The content of the file for the process that replaces another.
#[derive(Debug, Clone, PartialEq)]
pub struct HandoverData {
    /// The newest state of the process before it.
    pub checkpoint: Checkpoint,
    /// When the process before it was last known to work [ns]; 0 while it still does.
    ///
    /// The age of the state counts up to this time. So it does not age while a hung process is detected and while its
    /// successor starts.
    pub ended_ns: u64,
    /// The newest actuations, oldest first and without repetitions, for a role that reads them; the state contains
    /// some of them.
    pub actuations: Vec<Actuation>,
    /// By how much their times were moved, to the clock of this host [ns].
    pub moved_ns: i64,
}

impl HandoverData {
    /// Age of the state when its process ended, or now while that process runs [ns].
    pub(crate) fn age_ns(&self, now_ns: u64) -> u64 {
        let until_ns = if self.ended_ns == 0 { now_ns } else { self.ended_ns.min(now_ns) };
        until_ns.saturating_sub(self.checkpoint.issued_ns)
    }

    /// The same with all times moved by `by_ns`, for the clock of another host. The state itself is bytes, and stays.
    #[must_use]
    pub fn shifted(mut self, by_ns: i64) -> Self {
        shift_times(Checkpoint::TYPE, bytemuck::bytes_of_mut(&mut self.checkpoint), by_ns);
        for actuation in &mut self.actuations {
            shift_times(Actuation::TYPE, bytemuck::bytes_of_mut(actuation), by_ns);
        }
        if self.ended_ns != 0 {
            self.ended_ns = self.ended_ns.saturating_add_signed(by_ns).max(1);
        }
        self.moved_ns = self.moved_ns.saturating_add(by_ns);
        self
    }

    /// The checkpoint, the time, the actuations, then by how much they were moved.
    pub fn to_bytes(&self) -> Vec<u8> {
        let parts: [&[u8]; 4] = [
            bytemuck::bytes_of(&self.checkpoint),
            &self.ended_ns.to_le_bytes(),
            bytemuck::cast_slice(&self.actuations),
            &self.moved_ns.to_le_bytes(),
        ];
        parts.concat()
    }

    /// `None` where the bytes are damaged; damaged actuations are left out.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (checkpoint, rest) = bytes.split_at_checked(size_of::<Checkpoint>())?;
        let (ended_ns, rest) = rest.split_first_chunk::<8>()?;
        let chunks = rest.chunks_exact(size_of::<Actuation>());
        let moved_ns = chunks.remainder().first_chunk().map_or(0, |bytes| i64::from_le_bytes(*bytes));
        let actuations = chunks.map(bytemuck::pod_read_unaligned);
        Some(Self {
            checkpoint: bytemuck::pod_read_unaligned(checkpoint),
            ended_ns: u64::from_le_bytes(*ended_ns),
            actuations: actuations.filter(|actuation: &Actuation| actuation.check().is_ok()).collect(),
            moved_ns,
        })
    }
}

/// Writes the file for the process that is about to be started; without data, removes it.
///
/// # Errors
/// [`RuntimeError::File`].
pub fn write(domain: &Domain, role: Role, data: Option<&HandoverData>) -> Result<(), RuntimeError> {
    match data {
        Some(data) => domain.folder().write(&file(role), &data.to_bytes()),
        None => domain.folder().remove(&file(role)),
    }
}

/// The data handed to a role, if the file exists and is whole.
///
/// # Errors
/// [`RuntimeError::File`].
pub fn read(domain: &Domain, role: Role) -> Result<Option<HandoverData>, RuntimeError> {
    match domain.folder().read(&file(role)) {
        Ok(bytes) => Ok(HandoverData::from_bytes(&bytes)
            .filter(|data| data.checkpoint.check().is_ok() && data.checkpoint.role == role.wire())),
        Err(RuntimeError::File { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

fn file(role: Role) -> String {
    format!("{role}.checkpoint")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_ages_until_the_process_that_left_it_ended() {
        let checkpoint = Checkpoint { issued_ns: 1_000, ..Checkpoint::default() };
        let data = |ended_ns| HandoverData { checkpoint, ended_ns, actuations: Vec::new(), moved_ns: 0 };
        assert_eq!(data(0).age_ns(5_000), 4_000, "it still runs");
        assert_eq!(data(1_200).age_ns(5_000), 200);
        assert_eq!(data(900).age_ns(5_000), 0, "the state is newer than the last heartbeat");
    }

    #[test]
    fn what_is_handed_over_is_read_back_and_a_damaged_file_is_nothing() {
        let mut actuation = Actuation { desired_velocity_mps: 0.5, ..Actuation::default() };
        actuation.header.layout = Actuation::LAYOUT;
        let damaged = Actuation { desired_velocity_mps: f64::NAN, ..actuation };
        let checkpoint = Checkpoint::default();
        let data = HandoverData { checkpoint, ended_ns: 7, actuations: vec![actuation; 3], moved_ns: -5 };
        let with_damage =
            HandoverData { actuations: vec![actuation, damaged, actuation, actuation], ..data.clone() };
        assert_eq!(HandoverData::from_bytes(&data.to_bytes()).as_ref(), Some(&data));
        assert_eq!(HandoverData::from_bytes(&with_damage.to_bytes()).as_ref(), Some(&data));
        assert_eq!(HandoverData::from_bytes(&data.to_bytes()[..size_of::<Checkpoint>() + 7]), None);
    }
}
