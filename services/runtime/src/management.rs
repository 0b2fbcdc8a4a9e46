//! The one file of the bus that iceoryx2 0.10 makes writable for everyone, made here for its owner alone.
//!
//! Nodes of the bus count themselves in a small segment whose name ends with `.global_mgmt`; iceoryx2 gives it mode 0666
//! whatever the umask. It is made once under another random name, which no process of the run ever uses and which no other
//! user can take beforehand (the bus waits for ever for a file that is never finished), and its content
//! is put under the right name with mode 0600; the bus opens what it finds there.
//!
//! Where this fails: in the milliseconds before the copy another user may change the counter in the first one, which
//! makes the run fail at its start.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use crate::domain::{SHARED_MEMORY, random_id};
use crate::{Domain, RuntimeError, bus};

/// End of the segment's name.
const SUFFIX: &str = ".global_mgmt";
/// Larger than any segment of that kind [bytes].
const MAX_BYTES: u64 = 4096;

/// Makes the management segment of a new domain, readable and writable by its owner alone.
///
/// # Errors
/// [`RuntimeError::Bus`] when iceoryx2 refuses, and [`RuntimeError::File`].
pub(crate) fn create(domain: &Domain) -> Result<(), RuntimeError> {
    let original = format!("{}seed{}_", domain.shared_memory_prefix(), random_id());
    let made = bus::node("seed", &domain.config_with(&original)?).and_then(|node| {
        // While the node lives its segment certainly does.
        let copied = copy(&original, domain.shared_memory_prefix());
        drop(node);
        copied
    });
    remove_all(&original);
    made
}

/// Copies the segment whose name begins with `original` to the same name that begins with `prefix`.
fn copy(original: &str, prefix: &str) -> Result<(), RuntimeError> {
    let shared = Path::new(SHARED_MEMORY);
    let Some(name) = names().into_iter().find(|name| name.starts_with(original) && name.ends_with(SUFFIX))
    else {
        return Err(RuntimeError::bus("find the management segment", "it is not there"));
    };
    let target = shared.join(name.replacen(original, prefix, 1));
    let error = |source| RuntimeError::File { path: target.clone(), source };
    let mut bytes = Vec::new();
    let read = File::open(shared.join(&name)).and_then(|file| file.take(MAX_BYTES).read_to_end(&mut bytes));
    read.map_err(error)?;
    let unfinished = shared.join(format!("{original}copy"));
    let mut options = OpenOptions::new();
    let options = options.write(true).create_new(true).mode(0o600);
    let written = options.open(&unfinished).and_then(|mut file| file.write_all(&bytes));
    written.and_then(|()| std::fs::rename(&unfinished, &target)).map_err(error)
}

fn remove_all(prefix: &str) {
    for name in names().into_iter().filter(|name| name.starts_with(prefix)) {
        let removed = std::fs::remove_file(Path::new(SHARED_MEMORY).join(&name));
        if let Err(error) = removed
            && error.kind() != ErrorKind::NotFound
        {
            tracing::warn!(%error, name, "not removed");
        }
    }
}

fn names() -> Vec<String> {
    let entries = std::fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().into_string().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::MetadataExt;

    #[test]
    fn no_file_of_a_bus_can_be_written_by_another_user() {
        let domain = Domain::create(&format!("mg{}", std::process::id())).unwrap();
        let bus = crate::Bus::create(&domain).unwrap();
        let mine: Vec<String> =
            names().into_iter().filter(|name| name.starts_with(domain.shared_memory_prefix())).collect();
        assert!(mine.iter().any(|name| name.ends_with(SUFFIX)), "{mine:?}");
        for name in &mine {
            let mode = std::fs::metadata(Path::new(SHARED_MEMORY).join(name)).unwrap().mode();
            assert_eq!(mode & 0o077, 0, "{name}: {mode:o}");
        }
        assert!(!mine.iter().any(|name| name.contains("seed")), "{mine:?}");
        drop(bus);
        domain.remove().unwrap();
    }
}
