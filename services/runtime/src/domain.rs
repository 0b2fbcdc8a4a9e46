//! Where one system lives on the machine: its directory and its names in shared memory.
//!
//! The directory lies in the first usable place of [`crate::place`] and carries the id of the system. The names in
//! shared memory carry a random run id instead, so that no other user can take them beforehand. The orchestrator
//! writes the id into the directory and hands it to its processes.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::folder::Folder;
use crate::shared_memory::{self, SHARED_MEMORY};
use crate::{
    DIRECTORY_VARIABLE, INCARNATION_VARIABLE, RUN_ID_VARIABLE, RuntimeError, SYSTEM_ID_VARIABLE, place,
};

/// Name of the file that holds the run id.
const RUN_ID_FILE: &str = "run-id";
/// Name of the file in the directory of the bus that holds the system id.
const SYSTEM_ID_FILE: &str = "system-id";
/// Letters of a run id: 50 random bits.
const RUN_ID_LETTERS: usize = 10;

/// One system on this machine, told from all others by its directory and its run id.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Domain {
    system_id: String,
    run_id: String,
    folder: Folder,
    prefix: String,
}

impl Domain {
    /// Makes the directory of a new system, the directory of its bus and its run id.
    ///
    /// # Errors
    /// [`RuntimeError::SystemId`] when the id is not 1 to 16 letters, digits or `-`; [`RuntimeError::NotPrivate`] when
    /// others can enter the place; [`RuntimeError::File`], of kind `AlreadyExists` when there is such a system.
    pub fn create(system_id: &str) -> Result<Self, RuntimeError> {
        check_id(system_id)?;
        let folder = make_folder(system_id)?;
        let run_id = random_id();
        let domain = Self::assemble(system_id, run_id, folder);
        // The file is for people; where shared memory is full it is left out.
        let made = Folder::make(&domain.bus_directory())
            .map(|bus| _ = bus.write(SYSTEM_ID_FILE, system_id.as_bytes()))
            .and_then(|()| domain.folder.write(RUN_ID_FILE, domain.run_id.as_bytes()));
        if let Err(error) = made {
            let _ = domain.remove();
            return Err(error);
        }
        Ok(domain)
    }

    /// The system of that id, if it has a directory in one of the places; its processes may all have ended.
    ///
    /// # Errors
    /// [`RuntimeError::SystemId`], and [`RuntimeError::NotPrivate`] for a directory that others can enter.
    pub fn find(system_id: &str) -> Result<Option<Self>, RuntimeError> {
        check_id(system_id)?;
        for place in place::all()? {
            if let Some(folder) = place.folder(system_id)? {
                return Ok(Some(Self::of_folder(system_id, folder)));
            }
        }
        Ok(None)
    }

    /// [`Domain::find`] where the system must exist.
    ///
    /// # Errors
    /// [`RuntimeError::NotRunning`] when there is none, and as [`Domain::find`].
    pub fn existing(system_id: &str) -> Result<Self, RuntimeError> {
        Self::find(system_id)?.ok_or_else(|| RuntimeError::NotRunning(system_id.to_owned()))
    }

    /// Leaves a mark that a system was stopped, for its next start by a service manager.
    ///
    /// # Errors
    /// As [`Domain::create`].
    pub fn mark_stopped(system_id: &str) -> Result<(), RuntimeError> {
        place::make()?.write(&mark(system_id)?, b"")
    }

    /// Removes the mark of [`Domain::mark_stopped`]; returns whether there was one.
    ///
    /// # Errors
    /// [`RuntimeError::SystemId`], and [`RuntimeError::File`].
    pub fn take_stopped_mark(system_id: &str) -> Result<bool, RuntimeError> {
        let name = mark(system_id)?;
        let marked: Vec<Folder> = place::all()?.into_iter().filter(|place| place.contains(&name)).collect();
        marked.iter().try_for_each(|place| place.remove(&name))?;
        Ok(!marked.is_empty())
    }

    /// All systems of this user that have a directory.
    ///
    /// # Errors
    /// [`RuntimeError::NotPrivate`] when `SCANLOOP_RUNTIME_DIR` is no absolute path.
    pub fn all() -> Result<Vec<Self>, RuntimeError> {
        let mut found: Vec<Self> = Vec::new();
        for place in place::all()? {
            let names = place.names().into_iter().filter(|name| check_id(name).is_ok());
            for name in names {
                if let Ok(Some(folder)) = place.folder(&name) {
                    found.push(Self::of_folder(&name, folder));
                }
            }
        }
        found.sort_by(|one, other| one.system_id.cmp(&other.system_id));
        Ok(found)
    }

    /// The system whose orchestrator started this process.
    ///
    /// # Errors
    /// [`RuntimeError::NotInASystem`] when the process was started by hand, [`RuntimeError::NotPrivate`] and
    /// [`RuntimeError::File`] when the directory it was given is not what it should be.
    pub fn of_this_process() -> Result<Self, RuntimeError> {
        let (system_id, _) = identity()?;
        let (run_id, path) = (variable(RUN_ID_VARIABLE)?, PathBuf::from(variable(DIRECTORY_VARIABLE)?));
        Self::at(&system_id, &run_id, &path)
    }

    /// The system of that id and run in the directory `path`.
    ///
    /// # Errors
    /// [`RuntimeError::NotPrivate`] and [`RuntimeError::File`] when the directory is not what it should be.
    pub fn at(system_id: &str, run_id: &str, path: &Path) -> Result<Self, RuntimeError> {
        check_id(system_id)?;
        let missing = || RuntimeError::file(path, ErrorKind::NotFound);
        let folder = Folder::open(path)?.ok_or_else(missing)?;
        Ok(Self::assemble(system_id, run_id.to_owned(), folder))
    }

    /// The id.
    pub fn system_id(&self) -> &str {
        &self.system_id
    }

    /// The random id of this run; empty when its directory was left unfinished.
    pub fn run_id(&self) -> &str {
        &self.run_id
    }

    /// The directory of the system: settings, lock, control socket.
    pub fn folder(&self) -> &Folder {
        &self.folder
    }

    /// Path of [`Domain::folder`].
    pub fn directory(&self) -> &Path {
        self.folder.path()
    }

    /// Whether a text can be the id of a run.
    pub fn is_run_id(text: &str) -> bool {
        is_run_id(text)
    }

    /// Whether a text can be the id of a system.
    pub fn is_system_id(text: &str) -> bool {
        check_id(text).is_ok()
    }

    /// Whether the directory is still that of this run.
    pub fn is_current(&self) -> bool {
        self.folder.read_text(RUN_ID_FILE).is_ok_and(|run_id| run_id == self.run_id)
    }

    /// Whether the directory is still there.
    pub fn exists(&self) -> bool {
        self.folder.path().exists()
    }

    /// Prefix of the names of all files that the system has in shared memory.
    pub fn shared_memory_prefix(&self) -> &str {
        &self.prefix
    }

    /// Directory in which the bus keeps its nodes, services and sockets. It lies in shared memory, because the bus
    /// syncs each of these files: on a busy disk, opening a port would take seconds. Its name is short, because
    /// sockets lie in it. It does not begin with the prefix, because the bus takes such files for its own.
    pub fn bus_directory(&self) -> PathBuf {
        PathBuf::from(format!("{SHARED_MEMORY}/{}", self.prefix.trim_end_matches('_')))
    }

    /// Opens [`Domain::bus_directory`].
    ///
    /// # Errors
    /// [`RuntimeError::NotPrivate`], and [`RuntimeError::File`] when it is not there.
    pub(crate) fn bus_folder(&self) -> Result<Folder, RuntimeError> {
        let path = self.bus_directory();
        let missing = || RuntimeError::file(&path, ErrorKind::NotFound);
        Folder::open(&path)?.ok_or_else(missing)
    }

    /// Removes everything that the run has in shared memory, the directory of its bus included.
    ///
    /// # Errors
    /// [`RuntimeError::File`] for the first file that could not be removed; all others are.
    pub fn remove_bus_files(&self) -> Result<(), RuntimeError> {
        remove_bus_files_of(&self.run_id)
    }

    /// Removes all files of the system: those of the bus, then its directory. The directory stays while a file of the
    /// bus cannot be removed, because it names the run for the next attempt.
    ///
    /// # Errors
    /// [`RuntimeError::File`] for a file that could not be removed.
    pub fn remove(&self) -> Result<(), RuntimeError> {
        self.remove_bus_files()?;
        self.folder.delete()?;
        if let Some(parent) = self.folder.path().parent().filter(|_| self.is_in_a_default_place()) {
            // Stays while other systems of this user run.
            let _ = std::fs::remove_dir(parent);
        }
        Ok(())
    }

    /// Whether the place is not one that the user named: that is not removed with the last system.
    fn is_in_a_default_place(&self) -> bool {
        let named = std::env::var_os(crate::RUNTIME_DIR_VARIABLE).map(PathBuf::from);
        self.folder.path().parent() != named.as_deref()
    }

    fn of_folder(system_id: &str, folder: Folder) -> Self {
        let run_id = folder.read_text(RUN_ID_FILE).unwrap_or_default();
        let run_id = if is_run_id(&run_id) { run_id } else { String::new() };
        Self::assemble(system_id, run_id, folder)
    }

    fn assemble(system_id: &str, run_id: String, folder: Folder) -> Self {
        Self { system_id: system_id.to_owned(), prefix: prefix(&run_id), run_id, folder }
    }
}

/// System id and incarnation that the orchestrator gave to this process.
pub(crate) fn identity() -> Result<(String, u32), RuntimeError> {
    let incarnation = variable(INCARNATION_VARIABLE)?;
    match incarnation.parse() {
        Ok(number) if number > 0 => Ok((variable(SYSTEM_ID_VARIABLE)?, number)),
        _ => Err(RuntimeError::Environment { variable: INCARNATION_VARIABLE, value: incarnation }),
    }
}

pub(crate) fn variable(name: &'static str) -> Result<String, RuntimeError> {
    std::env::var(name).map_err(|_| RuntimeError::NotInASystem(name))
}

/// Makes the directory of a system in the first usable place. Retries, because another system that ends may remove it.
fn make_folder(system_id: &str) -> Result<Folder, RuntimeError> {
    let mut tries = 100;
    loop {
        match place::make().and_then(|place| place.make_folder(system_id)) {
            Err(RuntimeError::File { source, .. }) if source.kind() == ErrorKind::NotFound && tries > 0 => {
                tries -= 1
            }
            made => return made,
        }
    }
}

/// Removes everything that the run of this id has in shared memory.
///
/// # Errors
/// [`RuntimeError::File`] for the first file that could not be removed; all others are.
pub fn remove_bus_files_of(run_id: &str) -> Result<(), RuntimeError> {
    if !is_run_id(run_id) {
        return Ok(());
    }
    let mut result = Ok(());
    let mut note = |path: &Path, removed: std::io::Result<()>| {
        let failed = removed.err().filter(|error| error.kind() != ErrorKind::NotFound);
        if let (Some(error), Ok(())) = (failed, &result) {
            result = Err(RuntimeError::file(path, error));
        }
    };
    let (shared, prefix) = (Path::new(SHARED_MEMORY), prefix(run_id));
    for entry in shared_memory::files(&prefix).map_err(|error| RuntimeError::file(shared, error))? {
        note(&entry.path(), std::fs::remove_file(entry.path()));
    }
    let bus = shared.join(prefix.trim_end_matches('_'));
    note(&bus, std::fs::remove_dir_all(&bus));
    result
}

/// `_` ends the run id in file names, so that no prefix is a prefix of another.
fn prefix(run_id: &str) -> String {
    format!("scanloop-{run_id}_")
}

/// Name of the mark of a system that was stopped and whose orchestrator had to be killed; no id has a dot.
fn mark(system_id: &str) -> Result<String, RuntimeError> {
    check_id(system_id).map(|()| format!("{system_id}.stopped"))
}

/// The limit keeps lists readable; the letters keep an id one component of a path.
fn check_id(system_id: &str) -> Result<(), RuntimeError> {
    let allowed = |letter: char| letter.is_ascii_alphanumeric() || letter == '-';
    if system_id.is_empty() || system_id.len() > 16 || !system_id.chars().all(allowed) {
        return Err(RuntimeError::SystemId(system_id.to_owned()));
    }
    Ok(())
}

fn is_run_id(text: &str) -> bool {
    text.len() == RUN_ID_LETTERS
        && text.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit())
}

pub(crate) fn random_id() -> String {
    let mut bytes = [0; RUN_ID_LETTERS];
    let flags = rustix::rand::GetRandomFlags::empty();
    // So few bytes are filled in one call, or the kernel has no random numbers at all.
    let filled = rustix::rand::getrandom(&mut bytes, flags).unwrap_or(0);
    assert_eq!(filled, bytes.len(), "the kernel gives no random numbers");
    bytes.iter().map(|byte| char::from(b"abcdefghijklmnopqrstuvwxyz234567"[usize::from(byte % 32)])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn domain(name: &str) -> Domain {
        Domain::create(&format!("{name}{}", std::process::id())).unwrap()
    }

    #[test]
    fn ids_that_could_leave_the_directory_are_refused() {
        for id in ["", "../x", "a_b", "a b", "12345678901234567", "ä"] {
            assert!(matches!(Domain::find(id), Err(RuntimeError::SystemId(_))), "{id}");
            assert!(matches!(Domain::create(id), Err(RuntimeError::SystemId(_))), "{id}");
        }
    }

    #[test]
    fn a_system_is_made_once_and_found_by_its_id_with_the_same_run_id() {
        let made = domain("dm");
        assert_eq!(Domain::find(made.system_id()).unwrap().as_ref(), Some(&made));
        assert!(Domain::all().unwrap().contains(&made));
        let again = Domain::create(made.system_id()).unwrap_err();
        assert!(
            matches!(&again, RuntimeError::File { source, .. } if source.kind() == ErrorKind::AlreadyExists)
        );
        made.remove().unwrap();
        assert_eq!(Domain::find(made.system_id()).unwrap(), None);
        let next = domain("dm");
        assert_ne!(next.run_id(), made.run_id());
        next.remove().unwrap();
    }

    #[test]
    fn a_run_id_leaves_room_for_the_sockets_of_the_bus() {
        let prefix = prefix("abcdefghij");
        let socket =
            format!("{SHARED_MEMORY}/{}/{prefix}{}.event", prefix.trim_end_matches('_'), "9".repeat(30));
        assert!(socket.len() <= 108);
    }

    #[test]
    fn all_that_the_bus_has_in_shared_memory_is_removed() {
        let domain = domain("db");
        let file = format!("{SHARED_MEMORY}/{}file", domain.shared_memory_prefix());
        std::fs::create_dir_all(domain.bus_directory().join("nodes/1")).unwrap();
        std::fs::write(domain.bus_directory().join("nodes/1/tag"), "").unwrap();
        std::fs::write(&file, "").unwrap();
        domain.remove_bus_files().unwrap();
        assert!(!domain.bus_directory().exists() && !Path::new(&file).exists());
        domain.remove().unwrap();
        assert!(!domain.exists());
    }

    #[test]
    fn a_directory_without_a_run_id_owns_nothing_in_shared_memory() {
        let made = domain("dn");
        made.folder().write(RUN_ID_FILE, b"../../etc").unwrap();
        let found = Domain::existing(made.system_id()).unwrap();
        assert_eq!(found.run_id(), "");
        found.remove().unwrap();
        assert!(made.bus_directory().exists(), "another run's files are left alone");
        made.remove_bus_files().unwrap();
    }
}
