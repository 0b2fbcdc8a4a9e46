//! Files that a command writes: each is made without a name, synced, and only then gets the name it was asked for.
//!
//! So a file of that name is whole, before and after; an output never destroys its input, because what is read stays open;
//! and nothing is left of a command that is ended. Where a file system keeps no files without a name, it is a random one in
//! the same folder, made with `O_EXCL`: no link that another user has put there is followed, nor one on the way to the folder. A
//! link of the wanted name is replaced itself, not what it leads to.
//!
//! Three kinds of files are written in another way: logs and live recordings, which are read while they grow, and devices,
//! pipes and open files such as `/dev/stdout`, which nothing can be renamed to.

mod device;
mod folder;
mod place;

use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use anyhow::Context;
use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;

use crate::exit::{Failure, Unwritable};
pub(crate) use device::leads_to_device;
use device::{is_trusted, open_device};
pub use folder::make_folder;
use folder::open_folder;
pub(crate) use folder::resolved;
pub(crate) use place::probe;
use place::{Place, begin, random};

/// What happens to a file that has the name already.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Existing {
    /// It stays; the new one is refused.
    Keep,
    /// The new one takes its place and its mode, and as far as the kernel allows its owner and group.
    Replace,
}

impl Existing {
    /// The choice of an option `--force`.
    pub fn forced(force: bool) -> Self {
        if force { Self::Replace } else { Self::Keep }
    }
}

/// A file that does not have its name yet; without [`NewFile::finish`] it is removed.
#[derive(Debug)]
pub struct NewFile {
    file: File,
    path: PathBuf,
    existing: Existing,
    /// `None` for a device.
    place: Option<Place>,
}

impl NewFile {
    /// Begins a file that gets the name `path`; `inputs` are the files that its content comes from.
    ///
    /// # Errors
    /// A path that is one of the inputs, that has a file which is to be kept, or where none can be made; exit code 2.
    pub fn create(path: &Path, existing: Existing, inputs: &[&Path]) -> anyhow::Result<Self> {
        require_apart(path, inputs)?;
        let is_device = leads_to_device(path);
        let there = path.symlink_metadata().ok().filter(|_| !is_device);
        if existing == Existing::Keep && there.is_some() {
            return Err(refusal(path, TAKEN));
        }
        if there.as_ref().is_some_and(Metadata::is_file) {
            require_at_rest(path)?;
        }
        let made = match is_device {
            true => open_device(path).map(|file| (file, None)),
            false => begin(path, there.as_ref()),
        };
        let (file, place) = made.map_err(|error| failure(path, error))?;
        Ok(Self { file, path: path.to_owned(), existing, place })
    }

    /// Syncs the file and gives it its name.
    ///
    /// # Errors
    /// The first error of the file system, with the file; exit code 2. What had the name before is still there then.
    pub fn finish(self) -> anyhow::Result<()> {
        finish_all(vec![self])
    }

    /// Passes when the file is on the disk, and its name can still be given to it.
    fn sync(&self) -> anyhow::Result<()> {
        if self.place.is_none() {
            return Ok(());
        }
        self.file.sync_all().map_err(|error| failure(&self.path, error))?;
        self.require_name()
    }

    /// Passes when no file has the name that is to be kept, also one that has begun to grow meanwhile.
    fn require_name(&self) -> anyhow::Result<()> {
        match (self.existing, self.path.symlink_metadata()) {
            (Existing::Keep, Ok(_)) => Err(refusal(&self.path, TAKEN)),
            (Existing::Replace, Ok(there)) if there.is_file() => require_at_rest(&self.path),
            _ => Ok(()),
        }
    }

    /// Gives the file its name before it is whole: for one that is read while it grows. Until it is closed, or its process
    /// ends, no other command replaces it.
    ///
    /// # Errors
    /// As [`NewFile::finish`].
    pub fn publish(mut self) -> anyhow::Result<File> {
        if self.place.is_some() {
            // Where the file system knows no locks, it is as before.
            let _ = flock(&self.file, FlockOperation::NonBlockingLockExclusive);
            self.require_name()?;
        }
        if let Some(place) = &mut self.place {
            place.name(&self.file, self.existing).map_err(|error| match error {
                Errno::EXIST => refusal(&self.path, TAKEN),
                error => failure(&self.path, error.into()),
            })?;
            self.place = None;
        }
        self.file.try_clone().map_err(|error| failure(&self.path, error))
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        let _ = self.place.as_ref().map(Place::remove);
    }
}

/// Its errors name the file, and end a command with exit code 2, or 4 where the disk is full or a limit is reached.
impl Write for NewFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes).map_err(|error| Unwritable::wrap(&self.path, error))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush().map_err(|error| Unwritable::wrap(&self.path, error))
    }
}

/// Passes when no process is writing a file that has its name already.
fn require_at_rest(path: &Path) -> anyhow::Result<()> {
    let flags = (OFlags::NONBLOCK | OFlags::NOFOLLOW).bits().cast_signed();
    let opened = OpenOptions::new().read(true).custom_flags(flags).open(path);
    let locked = opened.map(|file| flock(&file, FlockOperation::NonBlockingLockShared));
    match locked {
        Ok(Err(Errno::WOULDBLOCK)) => {
            Err(refusal(path, "another process is writing this file; name another one"))
        }
        _ => Ok(()),
    }
}

/// Gives the files of one command their names: none of them before all are on the disk and all names are free.
///
/// # Errors
/// The first error of the file system, with the file; exit code 2. What had the names before is still there then, unless a name
/// was taken between the last check and its use.
pub fn finish_all(files: Vec<NewFile>) -> anyhow::Result<()> {
    files.iter().try_for_each(NewFile::sync)?;
    files.into_iter().try_for_each(|file| file.publish().map(drop))
}

/// Why a file is not made: its name is taken.
const TAKEN: &str = "the file exists; name another one, or replace it with --force";

/// Writes a whole file in place of one of its name.
///
/// # Errors
/// The first error of the file system, with the file; exit code 2.
pub fn write(path: &Path, content: &[u8]) -> anyhow::Result<()> {
    let mut file = NewFile::create(path, Existing::Replace, &[])?;
    file.write_all(content)?;
    file.finish()
}

/// The file that a link leads to: for a file of the user that is changed, as an editor does it, and not made anew.
///
/// # Errors
/// A link that leads to no file, or that another user has placed; exit code 2.
pub fn behind_link(path: &Path) -> anyhow::Result<PathBuf> {
    match path.symlink_metadata() {
        Ok(found) if found.is_symlink() && !leads_to_device(path) => {
            if !is_trusted(&found) {
                return Err(refusal(path, format!("a link of user {}, which is not followed", found.uid())));
            }
            path.canonicalize().map_err(|error| refusal(path, format!("the link leads to no file: {error}")))
        }
        _ => Ok(path.to_owned()),
    }
}

/// Passes when an output is none of the inputs, also not by a link or a second name.
///
/// # Errors
/// Both names; exit code 2.
pub fn require_apart(output: &Path, inputs: &[&Path]) -> anyhow::Result<()> {
    let inode = |path: &Path| path.metadata().ok().map(|found| (found.dev(), found.ino()));
    let Some(own) = inode(output) else { return Ok(()) };
    match inputs.iter().find(|input| inode(input) == Some(own)) {
        Some(input) => {
            let reason = format!("it is the same file as the input {}; name another one", input.display());
            Err(refusal(output, reason))
        }
        None => Ok(()),
    }
}

/// Opens a log, which grows under its name; never through a link, except to a device, nor in a folder behind a link of another
/// user.
///
/// # Errors
/// Those of the file system.
pub fn open_log(path: &Path, options: &mut OpenOptions) -> io::Result<File> {
    if leads_to_device(path) {
        return options.custom_flags(0).open(path);
    }
    let name = path.file_name().ok_or(io::ErrorKind::IsADirectory)?;
    let folder = open_folder(path.parent().unwrap_or(Path::new("")))?;
    let path = PathBuf::from(format!("/proc/self/fd/{}", folder.as_raw_fd())).join(name);
    options.custom_flags(OFlags::NOFOLLOW.bits().cast_signed()).open(path)
}

/// An error of the file system about a new file: exit code 4 where the disk is full or a limit is reached, else 2.
fn failure(path: &Path, error: io::Error) -> anyhow::Error {
    Unwritable::wrap(path, error).into()
}

fn refusal(path: &Path, reason: impl std::fmt::Display) -> anyhow::Error {
    Failure::bad_input(format!("{}: {reason}", path.display()))
}

/// A new folder for the files of one command, which only this user can enter; removed when dropped.
#[derive(Debug)]
pub struct Scratch(PathBuf);

impl Scratch {
    /// Makes it among the temporary files of the machine.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn new() -> anyhow::Result<Self> {
        let path = std::env::temp_dir().join(format!("scanloop-{}", random()?));
        runtime::Folder::make(&path).with_context(|| path.display().to_string())?;
        Ok(Self(path))
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;
    use crate::exit::{Exit, exit_of};

    fn names(folder: &Path) -> usize {
        std::fs::read_dir(folder).unwrap().count()
    }

    #[test]
    fn a_file_has_its_name_when_it_is_whole_and_what_is_left_unfinished_is_gone() {
        let folder = Scratch::new().unwrap();
        let path = folder.path().join("report.json");
        std::fs::write(&path, "old").unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
        let mut file = NewFile::create(&path, Existing::Replace, &[]).unwrap();
        file.write_all(b"new").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "old");
        drop(file);
        assert_eq!((std::fs::read_to_string(&path).unwrap().as_str(), names(folder.path())), ("old", 1));
        write(&path, b"new").unwrap();
        assert_eq!((std::fs::read_to_string(&path).unwrap().as_str(), names(folder.path())), ("new", 1));
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o600);
        let message = NewFile::create(&path, Existing::Keep, &[]).unwrap_err().to_string();
        assert!(message.ends_with(TAKEN), "{message}");
    }

    #[test]
    fn a_file_that_came_meanwhile_is_kept() {
        let folder = Scratch::new().unwrap();
        let path = folder.path().join("cut.mcap");
        let file = NewFile::create(&path, Existing::Keep, &[]).unwrap();
        std::fs::write(&path, "own").unwrap();
        let message = file.finish().unwrap_err().to_string();
        assert!(message.ends_with(TAKEN), "{message}");
        assert_eq!((std::fs::read_to_string(&path).unwrap().as_str(), names(folder.path())), ("own", 1));
    }

    #[test]
    fn a_file_that_another_process_is_writing_is_not_replaced() {
        let folder = Scratch::new().unwrap();
        let path = folder.path().join("drive.mcap");
        let mut growing = NewFile::create(&path, Existing::Keep, &[]).unwrap().publish().unwrap();
        growing.write_all(b"half").unwrap();
        let message = write(&path, b"other").unwrap_err().to_string();
        assert!(message.ends_with("another process is writing this file; name another one"), "{message}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "half");
        drop(growing);
        write(&path, b"other").unwrap();
    }

    #[test]
    fn a_file_that_began_to_grow_meanwhile_is_not_replaced() {
        let folder = Scratch::new().unwrap();
        let path = folder.path().join("drive.mcap");
        let create = || NewFile::create(&path, Existing::Replace, &[]).unwrap();
        let [late, later] = [create(), create()];
        let mut growing = create().publish().unwrap();
        growing.write_all(b"half").unwrap();
        for message in
            [late.finish().unwrap_err(), later.publish().unwrap_err()].map(|error| error.to_string())
        {
            assert!(message.ends_with("another process is writing this file; name another one"), "{message}");
        }
        assert_eq!((std::fs::read_to_string(&path).unwrap().as_str(), names(folder.path())), ("half", 1));
    }

    #[test]
    fn of_files_that_belong_together_none_appears_when_one_name_was_taken_meanwhile() {
        let folder = Scratch::new().unwrap();
        let paths = ["one", "two"].map(|name| folder.path().join(name));
        let files = paths.iter().map(|path| NewFile::create(path, Existing::Keep, &[]).unwrap()).collect();
        std::fs::write(&paths[1], "own").unwrap();
        assert!(finish_all(files).unwrap_err().to_string().ends_with(TAKEN));
        assert_eq!((paths[0].exists(), names(folder.path())), (false, 1));
        let create = |path| NewFile::create(path, Existing::Replace, &[]).unwrap();
        finish_all(paths.iter().map(|path| create(path)).collect()).unwrap();
        assert_eq!((std::fs::read(&paths[1]).unwrap().len(), names(folder.path())), (0, 2));
    }

    #[test]
    fn an_output_that_is_an_input_by_any_name_is_refused_with_both() {
        let folder = Scratch::new().unwrap();
        let [input, soft, hard] = ["input", "soft", "hard"].map(|name| folder.path().join(name));
        std::fs::write(&input, "content").unwrap();
        symlink("input", &soft).unwrap();
        std::fs::hard_link(&input, &hard).unwrap();
        for output in [&input, &soft, &hard] {
            let message = NewFile::create(output, Existing::Replace, &[&input]).unwrap_err().to_string();
            let names = [output, &input].map(|path| path.display().to_string());
            assert!(names.iter().all(|name| message.contains(name)), "{message}");
            assert!(!message.contains("--force"), "{message}");
        }
    }

    #[test]
    fn a_link_to_an_open_file_is_written_to() {
        let folder = Scratch::new().unwrap();
        let (link, target) = (folder.path().join("stdout"), folder.path().join("target"));
        let mut open = File::create(&target).unwrap();
        open.write_all(b"first").unwrap();
        symlink(format!("/proc/self/fd/{}", open.as_raw_fd()), &link).unwrap();
        write(&link, b" second").unwrap();
        assert!(link.is_symlink());
        assert_eq!(std::fs::read_to_string(&target).unwrap(), "first second");
        // The same link under its own name.
        write(&Path::new("/dev/fd").join(open.as_raw_fd().to_string()), b" third").unwrap();
        assert_eq!(std::fs::read_to_string(&target).unwrap(), "first second third");
        assert_eq!(names(folder.path()), 2);
    }

    #[test]
    fn a_link_is_replaced_and_what_it_leads_to_stays() {
        let folder = Scratch::new().unwrap();
        let (link, target) = (folder.path().join("link"), folder.path().join("target"));
        std::fs::write(&target, "untouched").unwrap();
        symlink("target", &link).unwrap();
        write(&link, b"new").unwrap();
        assert_eq!(std::fs::read_to_string(&target).unwrap(), "untouched");
        assert!(!link.is_symlink());
        // But not where the command changes what is there.
        std::fs::remove_file(&link).unwrap();
        symlink("target", &link).unwrap();
        let followed = behind_link(&link).unwrap();
        assert_eq!(followed, target.canonicalize().unwrap());
        assert_eq!(behind_link(&folder.path().join("new")).unwrap(), folder.path().join("new"));
        symlink("missing", folder.path().join("dangling")).unwrap();
        assert!(behind_link(&folder.path().join("dangling")).is_err());
        symlink("target", folder.path().join("log")).unwrap();
        let opened = open_log(&folder.path().join("log"), OpenOptions::new().append(true));
        assert!(opened.is_err());
        symlink("/dev/full", folder.path().join("full")).unwrap();
        let full = folder.path().join("full");
        let expected = format!("{}: No space left on device (os error 28)", full.display());
        let error = write(&full, b"lost").unwrap_err();
        assert_eq!(
            (crate::limits::text_of(&error), exit_of(&error)),
            (expected.clone(), Exit::ProcessFailed)
        );
        let mut file = std::io::BufWriter::new(NewFile::create(&full, Existing::Replace, &[]).unwrap());
        let error = file.write_all(b"lost").and_then(|()| file.flush()).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        let error = anyhow::Error::from(error);
        assert_eq!((crate::limits::text_of(&error), exit_of(&error)), (expected, Exit::ProcessFailed));
        assert!(folder.path().join("full").is_symlink(), "a device is written to, not replaced");
    }
}
