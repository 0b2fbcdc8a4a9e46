//! Nodes: what a process joins the bus of a system with.
//!
//! The nodes of a bus share a small segment whose name ends with `.global_mgmt`. iceoryx2 0.10 makes it writable for
//! everyone, with mode 0666 whatever the umask; here only the owner gets access. The segment is first made under
//! another random name, which no process of the run uses and no other user can take beforehand. (The bus waits for
//! ever for a file that is never finished.) Its content is then copied to the right name with mode 0600, where the
//! bus opens it.
//!
//! Limit: in the milliseconds before the copy another user may change the counter in the first segment, which makes
//! the start fail.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use iceoryx2::prelude::{
    Config, FileName, LogLevel, Node, NodeBuilder, NodeName, Path as BusPath, SemanticString,
    SignalHandlingMode, ipc, set_log_level_from_env_or,
};

use crate::domain::random_id;
use crate::shared_memory::{self, SHARED_MEMORY};
use crate::{Domain, RuntimeError};

/// End of the segment's name.
const SUFFIX: &str = ".global_mgmt";
/// Larger than any segment of that kind [bytes].
const MAX_BYTES: u64 = 4096;

/// Joins the bus of a system as `name`.
pub(crate) fn join(domain: &Domain, name: &str) -> Result<Node<ipc::Service>, RuntimeError> {
    join_as(domain, domain.shared_memory_prefix(), name)
}

/// [`join`] with another prefix of the names of its files.
fn join_as(domain: &Domain, prefix: &str, name: &str) -> Result<Node<ipc::Service>, RuntimeError> {
    set_log_level_from_env_or(LogLevel::Fatal);
    let name = NodeName::new(name).map_err(|reason| RuntimeError::bus("name a node", reason))?;
    let node = NodeBuilder::new()
        .name(&name)
        .config(&config(domain, prefix)?)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>();
    node.map_err(|reason| RuntimeError::bus("join the bus", reason))
}

/// Settings of the bus; files in the user's or the machine's configuration are not read.
fn config(domain: &Domain, prefix: &str) -> Result<Config, RuntimeError> {
    let mut config = Config::default();
    config.global.prefix = FileName::new(prefix.as_bytes())
        .map_err(|reason| RuntimeError::bus("set the prefix of the bus", reason))?;
    let root = domain.bus_directory();
    let root = BusPath::new(root.as_os_str().as_encoded_bytes())
        .map_err(|reason| RuntimeError::bus("set the root directory of the bus", reason))?;
    config.global.set_root_path(&root);
    Ok(config)
}

/// Makes the management segment of a new domain, accessible to its owner alone.
///
/// # Errors
/// [`RuntimeError::Bus`] when iceoryx2 refuses, and [`RuntimeError::File`].
pub(crate) fn create_management(domain: &Domain) -> Result<(), RuntimeError> {
    let original = format!("{}seed{}_", domain.shared_memory_prefix(), random_id());
    let made = join_as(domain, &original, "seed").and_then(|node| {
        // The segment exists as long as the node.
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
    let Some(name) = names(original).into_iter().find(|name| name.ends_with(SUFFIX)) else {
        return Err(RuntimeError::bus("find the management segment", "it is not there"));
    };
    let target = shared.join(name.replacen(original, prefix, 1));
    let error = |source| RuntimeError::file(&target, source);
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
    for name in names(prefix) {
        let removed = std::fs::remove_file(Path::new(SHARED_MEMORY).join(&name));
        if let Err(error) = removed
            && error.kind() != ErrorKind::NotFound
        {
            tracing::warn!(%error, name, "not removed");
        }
    }
}

fn names(prefix: &str) -> Vec<String> {
    let files = shared_memory::files(prefix).into_iter().flatten();
    files.filter_map(|file| file.file_name().into_string().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::MetadataExt;

    #[test]
    fn no_file_of_a_bus_can_be_written_by_another_user() {
        let domain = Domain::create(&format!("mg{}", std::process::id())).unwrap();
        let bus = crate::Bus::create(&domain, 100_000_000).unwrap();
        let mine = names(domain.shared_memory_prefix());
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
