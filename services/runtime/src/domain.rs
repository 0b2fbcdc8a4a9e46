//! Where one system lives on the machine: its names in shared memory and its directory.

use std::path::{Path, PathBuf};

use iceoryx2::prelude::{Config, FileName, Path as BusPath, SemanticString};

use crate::RuntimeError;

/// Where the kernel shows shared memory as files.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";

/// One system on this machine, apart from all others by its id and user.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Domain {
    system_id: String,
    directory: PathBuf,
    prefix: String,
}

impl Domain {
    /// The domain of a system id: 1 to 16 letters, digits or `-`.
    ///
    /// The limit keeps socket names below the 108 bytes that the kernel allows; `_` is refused because it ends
    /// the id in file names, so that no id is the beginning of another.
    ///
    /// # Errors
    /// [`RuntimeError::SystemId`].
    pub fn new(system_id: &str) -> Result<Self, RuntimeError> {
        let allowed = |letter: char| letter.is_ascii_alphanumeric() || letter == '-';
        if system_id.is_empty() || system_id.len() > 16 || !system_id.chars().all(allowed) {
            return Err(RuntimeError::SystemId(system_id.to_owned()));
        }
        let user = rustix::process::getuid().as_raw();
        Ok(Self {
            system_id: system_id.to_owned(),
            directory: PathBuf::from(format!("/tmp/scanloop-{user}/{system_id}")),
            prefix: format!("scanloop{user}_{system_id}_"),
        })
    }

    /// The id.
    pub fn system_id(&self) -> &str {
        &self.system_id
    }

    /// Directory of the system: settings, logs, lock, control socket.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// Beginning of the names of all files that the system has in shared memory.
    pub fn shared_memory_prefix(&self) -> &str {
        &self.prefix
    }

    /// Directory in which the bus keeps its nodes, services and sockets. In shared memory, because the bus syncs each of
    /// these files: on a disk that is busy, who opens a port would wait for it, seconds long. Its name is short, because
    /// sockets lie in it, and does not begin with the prefix, because the bus takes what does for files of its own.
    pub fn bus_directory(&self) -> PathBuf {
        PathBuf::from(format!("{SHARED_MEMORY}/{}", self.prefix.trim_end_matches('_')))
    }

    /// Removes everything that the system has in shared memory, the directory of its bus included.
    ///
    /// Only for the one who holds the lock of the system, while no process of it is alive.
    ///
    /// # Errors
    /// [`RuntimeError::File`] for the first file that could not be removed; all others are.
    pub fn remove_bus_files(&self) -> Result<(), RuntimeError> {
        let file = |path: &Path| {
            let path = path.to_path_buf();
            move |source| RuntimeError::File { path, source }
        };
        let shared = Path::new(SHARED_MEMORY);
        let mut result = Ok(());
        let mut note = |path: &Path, removed: std::io::Result<()>| {
            let failed = removed.err().filter(|error| error.kind() != std::io::ErrorKind::NotFound);
            if let (Some(error), Ok(())) = (failed, &result) {
                result = Err(file(path)(error));
            }
        };
        for entry in std::fs::read_dir(shared).map_err(file(shared))?.flatten() {
            if entry.file_name().to_string_lossy().starts_with(&self.prefix) {
                note(&entry.path(), std::fs::remove_file(entry.path()));
            }
        }
        let bus = self.bus_directory();
        note(&bus, std::fs::remove_dir_all(&bus));
        result
    }

    /// Removes all files of the system: those of the bus and its directory.
    ///
    /// Only for the one who holds the lock of the system, while no process of it is alive.
    ///
    /// # Errors
    /// [`RuntimeError::File`] for a file that could not be removed.
    pub fn remove(&self) -> Result<(), RuntimeError> {
        self.remove_bus_files()?;
        match std::fs::remove_dir_all(&self.directory) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                return Err(RuntimeError::File { path: self.directory.clone(), source });
            }
            _ => {}
        }
        if let Some(parent) = self.directory.parent() {
            // Stays while other systems of this user run.
            let _ = std::fs::remove_dir(parent);
        }
        Ok(())
    }

    /// Settings of the bus for this domain; files in the user's or the machine's configuration are not read.
    pub(crate) fn config(&self) -> Result<Config, RuntimeError> {
        let mut config = Config::default();
        config.global.prefix = FileName::new(self.prefix.as_bytes())
            .map_err(|reason| RuntimeError::bus("set the prefix of the bus", reason))?;
        let root = self.bus_directory();
        let root = BusPath::new(root.as_os_str().as_encoded_bytes())
            .map_err(|reason| RuntimeError::bus("set the root directory of the bus", reason))?;
        config.global.set_root_path(&root);
        Ok(config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_that_could_leave_the_directory_or_meet_another_id_are_refused() {
        for id in ["", "../x", "a_b", "a b", "12345678901234567", "ä"] {
            assert!(matches!(Domain::new(id), Err(RuntimeError::SystemId(_))), "{id}");
        }
        assert!(Domain::new("lab-2").is_ok());
    }

    #[test]
    fn the_longest_id_leaves_room_for_the_sockets_of_the_bus() {
        let domain = Domain::new("1234567890123456").unwrap();
        let socket = format!("{}{}.event", domain.shared_memory_prefix(), "9".repeat(30));
        assert!(domain.bus_directory().join(socket).as_os_str().len() <= 108);
    }

    #[test]
    fn all_that_the_bus_has_in_shared_memory_is_removed() {
        let domain = Domain::new(&format!("d{}", std::process::id())).unwrap();
        let file = format!("{SHARED_MEMORY}/{}file", domain.shared_memory_prefix());
        std::fs::create_dir_all(domain.bus_directory().join("nodes/1")).unwrap();
        std::fs::write(domain.bus_directory().join("nodes/1/tag"), "").unwrap();
        std::fs::write(&file, "").unwrap();
        domain.remove_bus_files().unwrap();
        assert!(!domain.bus_directory().exists() && !Path::new(&file).exists());
        domain.remove_bus_files().unwrap();
    }

    #[test]
    fn no_prefix_is_the_beginning_of_another() {
        let (one, other) = (Domain::new("a").unwrap(), Domain::new("a-b").unwrap());
        assert!(!other.shared_memory_prefix().starts_with(one.shared_memory_prefix()));
    }
}
