//! State handed to a process that takes the place of another: a file, written before it is started.
//!
//! The checkpoints themselves travel on the bus. Their publisher's memory dies with it, so the orchestrator
//! keeps the newest of each role and hands it over here.

use shared_types::{Checkpoint, Role, Sample};

use crate::{Domain, RuntimeError};

/// What a starting process finds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Handover<T> {
    /// Nothing ran before it.
    FirstStart,
    /// The state of the process before it.
    State(T),
    /// A process ran before it, and its state is too old, of another type, or was never published.
    ///
    /// Going on would mean driving on a guess: the process must not produce output, so the wheels get blocked.
    Lost,
}

/// Writes the newest checkpoint of a role for the process that is about to be started.
///
/// # Errors
/// [`RuntimeError::File`].
pub fn write(domain: &Domain, role: Role, checkpoint: Option<&Checkpoint>) -> Result<(), RuntimeError> {
    match checkpoint {
        Some(checkpoint) => domain.folder().write(&file(role), bytemuck::bytes_of(checkpoint)),
        None => domain.folder().remove(&file(role)),
    }
}

/// The checkpoint handed to a role, if it is there and whole.
pub(crate) fn read(domain: &Domain, role: Role) -> Result<Option<Checkpoint>, RuntimeError> {
    match domain.folder().read(&file(role)) {
        Ok(bytes) if bytes.len() == size_of::<Checkpoint>() => {
            let checkpoint: Checkpoint = bytemuck::pod_read_unaligned(&bytes);
            Ok(Some(checkpoint)
                .filter(|checkpoint| checkpoint.check().is_ok() && checkpoint.role == role.wire()))
        }
        Ok(_) => Ok(None),
        Err(RuntimeError::File { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

fn file(role: Role) -> String {
    format!("{role}.checkpoint")
}
