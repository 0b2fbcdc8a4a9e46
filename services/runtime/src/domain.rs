//! Where one system lives on the machine: its directory and its names in shared memory.
//!
//! The directory lies in the first usable place of [`crate::place`] and carries the id of the system. The names in
//! shared memory carry a random run id instead, so that no other user can take them beforehand. The orchestrator
//! writes the id into the directory and hands it to its processes.
//!
//! The file with the run id marks the directory as one of ours: it is the first file that is written and the last that is
//! removed. A directory without it belongs to somebody else, whatever its name: it is refused and left as it is.

use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rustix::fs::OFlags;

use crate::folder::Folder;
use crate::shared_memory::{self, SHARED_MEMORY};
use crate::{
    DIRECTORY_VARIABLE, INCARNATION_VARIABLE, RUN_ID_VARIABLE, RuntimeError, SYSTEM_ID_VARIABLE, place,
};

/// Name of the file that holds the run id.
const RUN_ID_FILE: &str = "run-id";
/// Name of the file in the directory of the system that an orchestrator holds locked.
pub const LOCK_FILE: &str = "lock";
/// Name of the file in the directory of the bus that holds the system id.
const SYSTEM_ID_FILE: &str = "system-id";
/// Letters of a run id: 50 random bits.
const RUN_ID_LETTERS: usize = 10;
/// The letters.
const ALPHABET: &[u8; 32] = b"abcdefghijklmnopqrstuvwxyz234567";
/// A directory is without its run id for microseconds, while it is made or removed; on a busy machine for longer.
const UNMARKED: Duration = Duration::from_millis(500);
/// Time between two looks at such a directory.
const UNMARKED_POLL: Duration = Duration::from_millis(5);
/// Name of the file in which the link to other hosts writes how it is, once a second.
pub(crate) const LINK_STATUS_FILE: &str = "link-status.toml";
/// What a directory without its run id may hold when the process that made or removed it was killed, or when a link wrote
/// while it was removed.
const UNMARKED_FILES: [&str; 3] = ["run-id.tmp", LOCK_FILE, LINK_STATUS_FILE];
/// Content of the mark of a system that was stopped.
const STOPPED_MARK: &[u8] = b"stopped by scanloop\n";

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
        // The file in the directory of the bus is for people; where shared memory is full it is left out.
        let marked = domain.folder.write(RUN_ID_FILE, domain.run_id.as_bytes());
        let made = marked
            .and_then(|()| Folder::make(&domain.bus_directory()))
            .map(|bus| _ = bus.write(SYSTEM_ID_FILE, system_id.as_bytes()));
        if let Err(error) = made {
            let _ = domain.remove();
            return Err(error);
        }
        Ok(domain)
    }

    /// The system of that id, if it has a directory in one of the places; its processes may all have ended.
    ///
    /// # Errors
    /// [`RuntimeError::SystemId`], [`RuntimeError::NotPrivate`] for a directory that others can enter, and
    /// [`RuntimeError::NotOurs`] for one that was not made for a system.
    pub fn find(system_id: &str) -> Result<Option<Self>, RuntimeError> {
        check_id(system_id)?;
        for place in place::all()? {
            if let Some(found) = Self::marked(&place, system_id)? {
                return Ok(Some(found));
            }
        }
        Ok(None)
    }

    /// The system in the directory of that name, once it has its run id or is gone.
    fn marked(place: &Folder, system_id: &str) -> Result<Option<Self>, RuntimeError> {
        let since = Instant::now();
        loop {
            let Some(folder) = place.folder(system_id)? else { return Ok(None) };
            let path = folder.path().to_path_buf();
            if let Some(found) = Self::of_folder(system_id, folder.clone())? {
                return Ok(Some(found));
            }
            // Files tell nothing: a run may remove the last ones, or make the first ones, between two reads of them.
            if since.elapsed() > UNMARKED {
                // A process that was killed while it made or removed the directory leaves it so. In a folder that the
                // user has named, it may be one of the user.
                let is_removed = !place::is_named(place) && folder.delete_remains(&UNMARKED_FILES);
                return if is_removed { Ok(None) } else { Err(RuntimeError::NotOurs { path }) };
            }
            std::thread::sleep(UNMARKED_POLL);
        }
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
        let (place, name) = (place::make()?, mark(system_id)?);
        match is_taken_by_another(&place, &name) {
            true => Err(RuntimeError::file(place.path().join(name), ErrorKind::AlreadyExists)),
            false => place.write(&name, STOPPED_MARK),
        }
    }

    /// Removes the mark of [`Domain::mark_stopped`]; returns whether there was one.
    ///
    /// # Errors
    /// [`RuntimeError::SystemId`], and [`RuntimeError::File`].
    pub fn take_stopped_mark(system_id: &str) -> Result<bool, RuntimeError> {
        let name = mark(system_id)?;
        let marked: Vec<Folder> =
            place::all()?.into_iter().filter(|place| is_stop_mark(place, &name)).collect();
        marked.iter().try_for_each(|place| place.remove(&name))?;
        Ok(!marked.is_empty())
    }

    /// All systems of this user that have a directory.
    ///
    /// # Errors
    /// [`RuntimeError::NotPrivate`] when `SCANLOOP_RUNTIME_DIR` is no absolute path, and [`RuntimeError::File`] when the kernel
    /// allows no more open files.
    pub fn all() -> Result<Vec<Self>, RuntimeError> {
        let (found, refused) = Self::all_found();
        refused.map_or(Ok(found), Err)
    }

    /// The systems of [`Domain::all`] that can be found, also where a place can't be used; and the first error.
    pub fn all_found() -> (Vec<Self>, Option<RuntimeError>) {
        let (places, mut refused) = place::usable();
        let mut found: Vec<Self> = Vec::new();
        for place in places {
            let names = place.names().into_iter().filter(|name| check_id(name).is_ok());
            for name in names {
                let opened = place.folder(&name);
                match opened
                    .and_then(|folder| folder.map_or(Ok(None), |folder| Self::of_folder(&name, folder)))
                {
                    Ok(domain) => found.extend(domain),
                    Err(error) if error.is_shortage() => _ = refused.get_or_insert(error),
                    Err(_) => {}
                }
            }
        }
        found.sort_by(|one, other| one.system_id.cmp(&other.system_id));
        (found, refused)
    }

    /// Passes when the directory of a new system can be made; nothing is made or changed.
    ///
    /// # Errors
    /// [`RuntimeError::NotPrivate`] when `SCANLOOP_RUNTIME_DIR`, or the last place, can't be used, and errors of the file
    /// system.
    pub fn examine_place() -> Result<(), RuntimeError> {
        place::examine()
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
    /// [`RuntimeError::NotPrivate`], [`RuntimeError::NotOurs`] and [`RuntimeError::File`] when the directory is not what it
    /// should be.
    pub fn at(system_id: &str, run_id: &str, path: &Path) -> Result<Self, RuntimeError> {
        check_id(system_id)?;
        let missing = || RuntimeError::file(path, ErrorKind::NotFound);
        let folder = Folder::open(path)?.ok_or_else(missing)?;
        let domain = Self::assemble(system_id, run_id.to_owned(), folder);
        match domain.folder.read_text(RUN_ID_FILE) {
            Ok(found) if found == domain.run_id => Ok(domain),
            Err(error) if error.is_shortage() => Err(error),
            _ => Err(RuntimeError::NotOurs { path: path.to_path_buf() }),
        }
    }

    /// The id.
    pub fn system_id(&self) -> &str {
        &self.system_id
    }

    /// The random id of this run.
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
        let missing = || {
            let reason = "it is not there: the system has ended, or has its shared memory in another mount namespace, in which \
                          this command has to run";
            RuntimeError::file(&path, io::Error::new(ErrorKind::NotFound, reason))
        };
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
        self.folder.delete(RUN_ID_FILE)?;
        if let Some(parent) = self.folder.path().parent().filter(|parent| place::is_default(parent)) {
            // Stays while other systems of this user run.
            let _ = std::fs::remove_dir(parent);
        }
        Ok(())
    }

    /// `None` for a directory that does not name a run.
    ///
    /// # Errors
    /// [`RuntimeError::File`] when the kernel allows no more open files.
    fn of_folder(system_id: &str, folder: Folder) -> Result<Option<Self>, RuntimeError> {
        match folder.read_text(RUN_ID_FILE) {
            Ok(run_id) if is_run_id(&run_id) => Ok(Some(Self::assemble(system_id, run_id, folder))),
            Err(error) if error.is_shortage() => Err(error),
            _ => Ok(None),
        }
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

/// Whether a file of that name exists which is no mark of a stop.
fn is_taken_by_another(place: &Folder, name: &str) -> bool {
    place.contains(name) && !is_stop_mark(place, name)
}

/// Whether a file is the mark of a stop: also an empty file of this user, as an earlier version has left it.
fn is_stop_mark(place: &Folder, name: &str) -> bool {
    let Ok(file) = place.open_file(name, OFlags::RDONLY) else { return false };
    let user = rustix::process::geteuid().as_raw();
    let is_own = file.metadata().is_ok_and(|found| found.is_file() && found.uid() == user);
    let mut content = Vec::new();
    let is_read = file.take(STOPPED_MARK.len() as u64 + 1).read_to_end(&mut content).is_ok();
    is_own && is_read && (content.is_empty() || content == STOPPED_MARK)
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
    text.len() == RUN_ID_LETTERS && text.bytes().all(|byte| ALPHABET.contains(&byte))
}

pub(crate) fn random_id() -> String {
    let mut bytes = [0; RUN_ID_LETTERS];
    let flags = rustix::rand::GetRandomFlags::empty();
    // So few bytes are filled in one call, or the kernel has no random numbers at all.
    let filled = rustix::rand::getrandom(&mut bytes, flags).unwrap_or(0);
    assert_eq!(filled, bytes.len(), "the kernel gives no random numbers");
    bytes.iter().map(|byte| char::from(ALPHABET[usize::from(byte % 32)])).collect()
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
    fn shared_memory_that_is_not_there_may_be_in_another_namespace() {
        let made = domain("ns");
        std::fs::remove_dir_all(made.bus_directory()).unwrap();
        let error = crate::Bus::open(&made, "observer").unwrap_err();
        assert!(matches!(&error, RuntimeError::File { source, .. } if source.kind() == ErrorKind::NotFound));
        assert!(error.to_string().contains("in another mount namespace"), "{error}");
        made.remove().unwrap();
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
    fn a_directory_without_a_run_id_is_refused_and_left_as_it_is() {
        let made = domain("dn");
        for content in ["../../etc", "", "4e0b6df189", "abcdefghij\n"] {
            made.folder().write(RUN_ID_FILE, content.as_bytes()).unwrap();
            let path = made.directory().to_path_buf();
            let refused = Domain::find(made.system_id()).unwrap_err();
            assert!(
                matches!(&refused, RuntimeError::NotOurs { path: named } if *named == path),
                "{content}: {refused}"
            );
            assert!(Domain::at(made.system_id(), made.run_id(), &path).is_err());
            assert!(Domain::all().unwrap().iter().all(|found| found.system_id() != made.system_id()));
        }
        assert!(made.bus_directory().exists() && made.exists(), "nothing is removed");
        made.folder().write(RUN_ID_FILE, made.run_id().as_bytes()).unwrap();
        Domain::existing(made.system_id()).unwrap().remove().unwrap();
    }

    #[test]
    fn a_directory_that_is_being_removed_is_waited_for_whatever_it_still_holds() {
        let made = domain("dw");
        made.folder().write("settings", b"").unwrap();
        made.folder().remove(RUN_ID_FILE).unwrap();
        let id = made.system_id().to_owned();
        let found = std::thread::spawn(move || Domain::find(&id));
        std::thread::sleep(4 * UNMARKED_POLL);
        made.remove().unwrap();
        assert_eq!(found.join().unwrap().unwrap(), None);
    }

    #[test]
    fn a_directory_that_a_killed_process_left_without_its_run_id_blocks_no_system() {
        for names in [&[][..], &UNMARKED_FILES[..1], &UNMARKED_FILES] {
            let made = domain("de");
            made.remove_bus_files().unwrap();
            made.folder().remove(RUN_ID_FILE).unwrap();
            names.iter().for_each(|name| std::fs::write(made.directory().join(name), "").unwrap());
            assert_eq!(Domain::find(made.system_id()).unwrap(), None, "{names:?}");
            assert!(!made.exists());
        }
        let made = domain("de");
        made.folder().remove(RUN_ID_FILE).unwrap();
        UNMARKED_FILES.iter().for_each(|name| made.folder().write(name, b"").unwrap());
        made.folder().write("mine", b"").unwrap();
        assert!(Domain::find(made.system_id()).is_err());
        assert_eq!(
            made.folder().names().len(),
            UNMARKED_FILES.len() + 1,
            "nothing is removed beside a file of somebody else"
        );
        made.remove().unwrap();
    }

    #[test]
    fn a_file_with_the_name_of_a_mark_is_neither_taken_nor_replaced() {
        let id = format!("dk{}", std::process::id());
        let made = Domain::create(&id).unwrap();
        let place = Folder::open(made.directory().parent().unwrap()).unwrap().unwrap();
        place.write(&mark(&id).unwrap(), b"mine").unwrap();
        assert!(!Domain::take_stopped_mark(&id).unwrap());
        assert!(Domain::mark_stopped(&id).is_err());
        assert_eq!(place.read(&mark(&id).unwrap()).unwrap(), b"mine");
        place.remove(&mark(&id).unwrap()).unwrap();
        // The mark of an earlier version.
        std::fs::write(place.path().join(mark(&id).unwrap()), "").unwrap();
        Domain::mark_stopped(&id).unwrap();
        std::fs::write(place.path().join(mark(&id).unwrap()), "").unwrap();
        assert!(Domain::take_stopped_mark(&id).unwrap());
        Domain::mark_stopped(&id).unwrap();
        assert!(Domain::take_stopped_mark(&id).unwrap() && !Domain::take_stopped_mark(&id).unwrap());
        made.remove().unwrap();
    }
}
