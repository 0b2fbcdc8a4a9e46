//! New lines in the logs of the processes.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use shared_types::Role;

/// At most this much is read of a log at a time [bytes].
const MAX_READ: u64 = 1 << 16;

/// The logs of all roles, and how far each was read.
pub(super) struct Logs(BTreeMap<&'static str, (PathBuf, u64, String)>);

impl Logs {
    /// Logs in a folder: from their start, or from what they hold now.
    pub(super) fn new(folder: &Path, from_start: bool) -> Self {
        let log = |role: &Role| {
            let path = folder.join(format!("{role}.log"));
            let read = if from_start { 0 } else { length(&path) };
            (role.name(), (path, read, String::new()))
        };
        Self(Role::ALL.iter().map(log).collect())
    }

    /// Hands each new line to `each`, with the name of the role.
    pub(super) fn read(&mut self, mut each: impl FnMut(&str, &str)) {
        for (role, (path, read, rest)) in &mut self.0 {
            let length = length(path);
            // A log that grew too long was cut at its front.
            *read = if length < *read { length } else { *read };
            if length == *read {
                continue;
            }
            let mut bytes = Vec::new();
            let opened = File::open(&path).and_then(|mut file| {
                file.seek(SeekFrom::Start(*read))?;
                file.take(MAX_READ).read_to_end(&mut bytes)
            });
            if opened.is_err() {
                continue;
            }
            *read += bytes.len() as u64;
            rest.push_str(&String::from_utf8_lossy(&bytes));
            while let Some(end) = rest.find('\n') {
                each(role, &rest[..end]);
                rest.drain(..=end);
            }
        }
    }
}

fn length(path: &Path) -> u64 {
    path.metadata().map_or(0, |metadata| metadata.len())
}
