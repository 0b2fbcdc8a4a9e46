//! A directory that only its owner can enter: verified when it is opened, and used by descriptor from then on.
//!
//! No other user can plant, replace or read a file in it. Every access starts at the open descriptor, so neither a
//! link nor a renamed parent leads elsewhere. Files are made with mode 0600 whatever the umask.
//!
//! Limit: there is no protection from processes of the same user and from root.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustix::fs::{AtFlags, CWD, FileType, FlockOperation, Mode, OFlags, Stat, flock};
use rustix::io::Errno;

use crate::RuntimeError;
use crate::error::is_shortage;

/// Readable, writable and searchable by the owner alone.
const PRIVATE: Mode = Mode::RWXU;
/// How often a directory is emptied before it is given up: a process that ends may still write.
const DELETIONS: usize = 3;
/// Readable and writable by the owner alone.
const FILE_MODE: Mode = Mode::RUSR.union(Mode::WUSR);

/// A private directory of this user.
#[derive(Debug, Clone)]
pub struct Folder {
    descriptor: Arc<OwnedFd>,
    path: PathBuf,
}

impl PartialEq for Folder {
    fn eq(&self, other: &Self) -> bool {
        self.path == other.path
    }
}

impl Eq for Folder {}

impl Folder {
    /// Opens a directory; `None` when there is none of that name.
    ///
    /// # Errors
    /// [`RuntimeError::NotPrivate`] when it is a link, belongs to another user, or others may enter it; [`RuntimeError::File`]
    /// when the kernel allows no more open files.
    pub fn open(path: &Path) -> Result<Option<Self>, RuntimeError> {
        Self::open_at(CWD, path, path.to_path_buf())
    }

    /// Makes a directory that must not exist yet.
    ///
    /// # Errors
    /// [`RuntimeError::File`], of kind `AlreadyExists` when the name is taken.
    pub fn make(path: &Path) -> Result<Self, RuntimeError> {
        Self::make_at(CWD, path, path.to_path_buf())
    }

    /// Opens a directory in this one; `None` when there is none of that name.
    ///
    /// # Errors
    /// As [`Folder::open`].
    pub fn folder(&self, name: &str) -> Result<Option<Self>, RuntimeError> {
        Self::open_at(self.descriptor.as_fd(), Path::new(name), self.path.join(name))
    }

    /// Makes a directory in this one, which must not exist yet.
    ///
    /// # Errors
    /// As [`Folder::make`].
    pub fn make_folder(&self, name: &str) -> Result<Self, RuntimeError> {
        Self::make_at(self.descriptor.as_fd(), Path::new(name), self.path.join(name))
    }

    /// Its path, for messages and for processes that open it again.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A path to an entry that starts at the descriptor: for sockets, which are reached by path only.
    pub fn by_descriptor(&self, name: &str) -> PathBuf {
        PathBuf::from(format!("/proc/self/fd/{}/{name}", self.descriptor.as_raw_fd()))
    }

    /// Whether it has an entry of that name.
    pub fn contains(&self, name: &str) -> bool {
        rustix::fs::statat(&self.descriptor, name, AtFlags::SYMLINK_NOFOLLOW).is_ok()
    }

    /// The content of a file.
    ///
    /// # Errors
    /// [`RuntimeError::File`].
    pub fn read(&self, name: &str) -> Result<Vec<u8>, RuntimeError> {
        let mut bytes = Vec::new();
        let read = self.open_file(name, OFlags::RDONLY).and_then(|mut file| file.read_to_end(&mut bytes));
        read.map(|_| bytes).map_err(|source| self.error(name, source))
    }

    /// The content of a file of text.
    ///
    /// # Errors
    /// [`RuntimeError::File`].
    pub fn read_text(&self, name: &str) -> Result<String, RuntimeError> {
        let text = String::from_utf8(self.read(name)?);
        text.map_err(|error| self.error(name, io::Error::new(io::ErrorKind::InvalidData, error)))
    }

    /// Writes a file atomically: a reader finds the old content or the new.
    ///
    /// # Errors
    /// [`RuntimeError::File`].
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), RuntimeError> {
        self.write_all(&[(name, bytes)])
    }

    /// Writes several files, or none of them where the disk has no room for all.
    ///
    /// # Errors
    /// [`RuntimeError::File`].
    pub fn write_all(&self, files: &[(&str, &[u8])]) -> Result<(), RuntimeError> {
        let unfinished = |name: &str| format!("{name}.tmp");
        let write = |(name, bytes): &(&str, &[u8])| {
            let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::TRUNC;
            let written = self.open_file(&unfinished(name), flags).and_then(|mut file| file.write_all(bytes));
            written.map_err(|source| self.error(name, source))
        };
        // What takes room comes first; a name in place of another takes none.
        let written = files.iter().try_for_each(write);
        let renamed = written
            .and_then(|()| files.iter().try_for_each(|(name, _)| self.rename(&unfinished(name), name)));
        if renamed.is_err() {
            files.iter().for_each(|(name, _)| _ = self.remove(&unfinished(name)));
        }
        renamed
    }

    /// Puts a file in the place of another.
    ///
    /// # Errors
    /// [`RuntimeError::File`].
    pub fn rename(&self, from: &str, to: &str) -> Result<(), RuntimeError> {
        let renamed = rustix::fs::renameat(&self.descriptor, from, &self.descriptor, to);
        renamed.map_err(|error| self.error(to, error.into()))
    }

    /// Opens a file of this directory, never through a link; a new one gets mode 0600.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn open_file(&self, name: &str, flags: OFlags) -> io::Result<File> {
        let flags = flags | OFlags::NOFOLLOW | OFlags::CLOEXEC | OFlags::NONBLOCK;
        let file = rustix::fs::openat(&self.descriptor, name, flags, FILE_MODE)?;
        if flags.contains(OFlags::CREATE) {
            // A umask may have removed the owner's rights as well.
            rustix::fs::fchmod(&file, FILE_MODE)?;
        }
        Ok(File::from(file))
    }

    /// Removes a file; a missing one is no error.
    ///
    /// # Errors
    /// [`RuntimeError::File`].
    pub fn remove(&self, name: &str) -> Result<(), RuntimeError> {
        match rustix::fs::unlinkat(&self.descriptor, name, AtFlags::empty()) {
            Ok(()) | Err(Errno::NOENT) => Ok(()),
            Err(error) => Err(self.error(name, error.into())),
        }
    }

    /// The names of its entries.
    pub fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.by_descriptor("."));
        let entries = entries.into_iter().flatten().flatten();
        entries.filter_map(|entry| entry.file_name().into_string().ok()).collect()
    }

    /// Removes the directory and all that is in it, the entry `last` at the end: while anything else is left, it is there.
    ///
    /// # Errors
    /// [`RuntimeError::File`] for what could not be removed.
    pub fn delete(&self, last: &str) -> Result<(), RuntimeError> {
        for _ in 1..DELETIONS {
            if self.delete_once(last).is_ok() {
                return Ok(());
            }
        }
        self.delete_once(last)
    }

    fn delete_once(&self, last: &str) -> Result<(), RuntimeError> {
        let names = self.names().into_iter().filter(|name| name != last);
        for name in names.chain([last.to_owned()]) {
            let path = self.by_descriptor(&name);
            let is_folder = path.symlink_metadata().is_ok_and(|found| found.is_dir());
            let removed =
                if is_folder { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
            match removed {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(self.error(&name, error));
                }
                _ => {}
            }
        }
        self.delete_empty()
    }

    /// Removes the directory when it holds nothing but files of these names, of which no process holds one locked;
    /// returns whether it is gone.
    pub(crate) fn delete_remains(&self, allowed: &[&str]) -> bool {
        let names = self.names();
        let is_remains = |name: &String| {
            let file = self.open_file(name, OFlags::RDONLY);
            let is_free = |file: File| {
                file.metadata().is_ok_and(|found| found.is_file())
                    && flock(&file, FlockOperation::NonBlockingLockExclusive).is_ok()
            };
            allowed.contains(&name.as_str()) && file.is_ok_and(is_free)
        };
        names.iter().all(is_remains)
            && names.iter().all(|name| self.remove(name).is_ok())
            && self.delete_empty().is_ok()
    }

    /// Removes the directory, but only when the name still leads to it.
    fn delete_empty(&self) -> Result<(), RuntimeError> {
        let same =
            rustix::fs::statat(CWD, &self.path, AtFlags::SYMLINK_NOFOLLOW).is_ok_and(|there| self.is(&there));
        if !same {
            return Ok(());
        }
        match rustix::fs::unlinkat(CWD, &self.path, AtFlags::REMOVEDIR) {
            Ok(()) | Err(Errno::NOENT) => Ok(()),
            Err(error) => Err(RuntimeError::file(&self.path, error)),
        }
    }

    fn is(&self, there: &Stat) -> bool {
        rustix::fs::fstat(&self.descriptor)
            .is_ok_and(|here| (here.st_dev, here.st_ino) == (there.st_dev, there.st_ino))
    }

    fn error(&self, name: &str, source: io::Error) -> RuntimeError {
        RuntimeError::file(self.path.join(name), source)
    }

    fn make_at(at: impl AsFd + Copy, name: &Path, path: PathBuf) -> Result<Self, RuntimeError> {
        let error = |source: Errno| RuntimeError::file(&path, source);
        rustix::fs::mkdirat(at, name, PRIVATE).map_err(error)?;
        let flags = OFlags::PATH | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        let made = rustix::fs::openat(at, name, flags, Mode::empty()).map_err(error)?;
        // A umask may have removed the owner's rights as well; a bare path descriptor needs the way through /proc.
        let link = format!("/proc/self/fd/{}", made.as_raw_fd());
        rustix::fs::chmodat(CWD, link, PRIVATE, AtFlags::empty()).map_err(error)?;
        let missing = || error(Errno::NOENT);
        Self::open_at(at, name, path.clone())?.ok_or_else(missing)
    }

    fn open_at(at: impl AsFd, name: &Path, path: PathBuf) -> Result<Option<Self>, RuntimeError> {
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        let descriptor = match rustix::fs::openat(&at, name, flags, Mode::empty()) {
            Ok(descriptor) => descriptor,
            Err(Errno::NOENT) => return Ok(None),
            Err(error) if is_shortage(error) => return Err(RuntimeError::file(path, error)),
            Err(error) => {
                let reason = match rustix::fs::statat(&at, name, AtFlags::SYMLINK_NOFOLLOW) {
                    Ok(found) => fault_of(&found).unwrap_or_else(|| error.to_string()),
                    Err(_) => error.to_string(),
                };
                return Err(RuntimeError::NotPrivate { path, reason });
            }
        };
        let found = rustix::fs::fstat(&descriptor).map_err(|error| RuntimeError::file(&path, error))?;
        match fault_of(&found) {
            Some(reason) => Err(RuntimeError::NotPrivate { path, reason }),
            None => Ok(Some(Self { descriptor: Arc::new(descriptor), path })),
        }
    }
}

/// Why a file is not a private directory of this user; `None` when it is.
fn fault_of(found: &Stat) -> Option<String> {
    let owner = found.st_uid;
    let mode = found.st_mode & 0o777;
    match FileType::from_raw_mode(found.st_mode) {
        FileType::Symlink => Some(format!("is a symbolic link of user {owner}")),
        FileType::Directory if owner != rustix::process::geteuid().as_raw() => {
            Some(format!("belongs to user {owner}"))
        }
        FileType::Directory if mode != 0o700 => Some(format!("has mode {mode:04o} instead of 0700")),
        FileType::Directory => None,
        _ => Some(format!("is no directory, and belongs to user {owner}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{PermissionsExt, symlink};

    /// A path of its own for a test, removed at its end.
    struct Scratch(PathBuf);

    impl Scratch {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("scanloop-folder-{name}-{}", std::process::id()));
            std::fs::create_dir_all(&path).unwrap();
            Self(path)
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn what_others_could_enter_or_lead_elsewhere_is_refused_with_the_reason() {
        let scratch = Scratch::new("refused");
        let (target, link, open) = (scratch.0.join("target"), scratch.0.join("link"), scratch.0.join("open"));
        Folder::make(&target).unwrap();
        symlink(&target, &link).unwrap();
        std::fs::create_dir(&open).unwrap();
        std::fs::set_permissions(&open, PermissionsExt::from_mode(0o755)).unwrap();
        std::fs::write(scratch.0.join("file"), "").unwrap();
        let reason = |name: &str| Folder::open(&scratch.0.join(name)).unwrap_err().to_string();
        assert!(reason("link").contains("is a symbolic link of user"), "{}", reason("link"));
        assert!(reason("open").contains("has mode 0755 instead of 0700"), "{}", reason("open"));
        assert!(reason("file").contains("is no directory"), "{}", reason("file"));
        assert!(Folder::open(&scratch.0.join("none")).unwrap().is_none());
        assert!(Folder::make(&target).is_err(), "it is there already");
    }

    #[test]
    fn a_link_in_it_is_neither_followed_nor_written_through() {
        let scratch = Scratch::new("links");
        let victim = scratch.0.join("victim");
        std::fs::write(&victim, "untouched").unwrap();
        let folder = Folder::make(&scratch.0.join("private")).unwrap();
        symlink(&victim, folder.path().join("settings")).unwrap();
        assert!(folder.read("settings").is_err());
        assert!(folder.open_file("settings", OFlags::WRONLY | OFlags::CREATE).is_err());
        folder.write("settings", b"mine").unwrap();
        assert_eq!(std::fs::read_to_string(&victim).unwrap(), "untouched");
        assert_eq!(folder.read_text("settings").unwrap(), "mine");
        let mode = std::fs::metadata(folder.path().join("settings")).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }

    #[test]
    fn of_several_files_all_are_written_or_none() {
        let scratch = Scratch::new("several");
        let folder = Folder::make(&scratch.0.join("private")).unwrap();
        folder.write_all(&[("one", b"old"), ("two", b"old")]).unwrap();
        // The unfinished second file can't be made: its name is taken by a directory.
        folder.make_folder("two.tmp").unwrap();
        assert!(folder.write_all(&[("one", b"new"), ("two", b"new")]).is_err());
        let texts = ["one", "two"].map(|name| folder.read_text(name).unwrap());
        assert_eq!(texts, ["old", "old"]);
        assert!(!folder.contains("one.tmp"), "nothing is left");
    }

    #[test]
    fn deleting_it_leaves_the_targets_of_links_alone() {
        let scratch = Scratch::new("delete");
        let outside = scratch.0.join("outside");
        std::fs::create_dir(&outside).unwrap();
        std::fs::write(outside.join("file"), "stays").unwrap();
        let folder = Folder::make(&scratch.0.join("private")).unwrap();
        symlink(&outside, folder.path().join("link")).unwrap();
        std::fs::create_dir(folder.path().join("logs")).unwrap();
        std::fs::write(folder.path().join("logs/one"), "").unwrap();
        folder.delete("link").unwrap();
        assert!(!folder.path().exists() && outside.join("file").exists());
    }

    #[test]
    fn a_directory_that_was_moved_away_is_still_the_one_that_is_used() {
        let scratch = Scratch::new("moved");
        let folder = Folder::make(&scratch.0.join("private")).unwrap();
        let moved = scratch.0.join("moved");
        std::fs::rename(folder.path(), &moved).unwrap();
        std::fs::create_dir(folder.path()).unwrap();
        folder.write("lock", b"7").unwrap();
        assert!(moved.join("lock").exists() && !folder.path().join("lock").exists());
        folder.delete("lock").unwrap();
        assert!(folder.path().exists(), "what stands there now is not ours");
    }
}
