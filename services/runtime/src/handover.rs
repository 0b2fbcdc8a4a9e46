//! State handed to a process that takes the place of another: a file, written before it is started.
//!
//! The checkpoints themselves travel on the bus. Their publisher's memory dies with it, so the orchestrator
//! keeps the newest of each role and hands it over here.

use std::path::PathBuf;

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
    let path = file(domain, role);
    let written = match checkpoint {
        Some(checkpoint) => std::fs::write(&path, bytemuck::bytes_of(checkpoint)).inspect_err(|_| {
            // Half of it is worth nothing.
            let _ = std::fs::remove_file(&path);
        }),
        None => match std::fs::remove_file(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
            result => result,
        },
    };
    written.map_err(|source| RuntimeError::File { path, source })
}

/// The checkpoint handed to a role, if it is there and whole.
pub(crate) fn read(domain: &Domain, role: Role) -> Result<Option<Checkpoint>, RuntimeError> {
    let path = file(domain, role);
    match std::fs::read(&path) {
        Ok(bytes) if bytes.len() == size_of::<Checkpoint>() => {
            let checkpoint: Checkpoint = bytemuck::pod_read_unaligned(&bytes);
            Ok(Some(checkpoint)
                .filter(|checkpoint| checkpoint.check().is_ok() && checkpoint.role == role.wire()))
        }
        Ok(_) => Ok(None),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(RuntimeError::File { path, source }),
    }
}

fn file(domain: &Domain, role: Role) -> PathBuf {
    domain.directory().join(format!("{role}.checkpoint"))
}
