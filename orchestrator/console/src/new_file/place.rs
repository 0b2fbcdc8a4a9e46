//! Where a file is until it is whole, and how it gets its name.

use std::ffi::OsString;
use std::fs::{File, Metadata};
use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use rustix::fs::{AtFlags, CWD, Gid, Mode, OFlags, RenameFlags, Uid};
use rustix::io::Errno;

use super::Existing;
use super::folder::open_folder;

/// Mode of a new file, from which the mask of the process takes what it takes from every file.
const MODE: Mode = Mode::from_raw_mode(0o666);

/// Where a file is until it is whole. All names are looked up in the open folder.
#[derive(Debug)]
pub(super) struct Place {
    folder: OwnedFd,
    name: OsString,
    /// The name that it has there meanwhile; `None` where the file system keeps files without one, of which nothing is left
    /// however the process ends.
    temporary: Option<String>,
}

impl Place {
    /// Removes the name that the file has meanwhile.
    pub(super) fn remove(&self) -> rustix::io::Result<()> {
        let remove = |name| rustix::fs::unlinkat(&self.folder, name, AtFlags::empty());
        self.temporary.as_deref().map_or(Ok(()), remove)
    }

    /// Gives `file` its name.
    pub(super) fn name(&mut self, file: &File, existing: Existing) -> rustix::io::Result<()> {
        match (existing, &self.temporary) {
            (Existing::Keep, None) => link(file, &self.folder, &self.name)?,
            // Only a name takes the place of another one.
            (Existing::Replace, None) => {
                let temporary = temporary()?;
                link(file, &self.folder, &temporary)?;
                let temporary = self.temporary.insert(temporary);
                rustix::fs::renameat(&self.folder, &**temporary, &self.folder, &self.name)?;
            }
            (Existing::Replace, Some(from)) => {
                rustix::fs::renameat(&self.folder, from, &self.folder, &self.name)?;
            }
            // A file may have come since the first check. Some file systems know no such rename, but links.
            (Existing::Keep, Some(from)) => {
                let (folder, to) = (&self.folder, &self.name);
                match rustix::fs::renameat_with(folder, from, folder, to, RenameFlags::NOREPLACE) {
                    Err(Errno::INVAL | Errno::NOSYS) => {
                        rustix::fs::linkat(folder, from, folder, to, AtFlags::empty())?;
                        rustix::fs::unlinkat(folder, from, AtFlags::empty())?;
                    }
                    renamed => renamed?,
                }
            }
        }
        // The name lasts when the power fails. Not every folder can be read, or synced.
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC;
        let _ = rustix::fs::openat(&self.folder, ".", flags, Mode::empty()).and_then(rustix::fs::fsync);
        Ok(())
    }
}

/// Where the kernel shows an open file, so that it can be given a name.
fn shown(file: &File) -> String {
    format!("/proc/self/fd/{}", file.as_raw_fd())
}

/// Gives a file without a name one that is free.
fn link(file: &File, folder: &OwnedFd, name: impl rustix::path::Arg) -> rustix::io::Result<()> {
    rustix::fs::linkat(CWD, shown(file), folder, name, AtFlags::SYMLINK_FOLLOW)
}

/// A name for a file that is not whole.
fn temporary() -> rustix::io::Result<String> {
    Ok(format!(".scanloop-{}", random()?))
}

/// Makes the file in the folder of `path`, without a name where that is possible, with mode, owner and group of the one that it replaces.
pub(super) fn begin(path: &Path, replaced: Option<&Metadata>) -> io::Result<(File, Option<Place>)> {
    let name = path.file_name().ok_or(io::ErrorKind::IsADirectory)?.to_owned();
    if replaced.is_some_and(|found| !found.is_file() && !found.is_symlink()) {
        return Err(io::Error::other("it is no regular file"));
    }
    let folder = open_folder(path.parent().unwrap_or(Path::new("")))?;
    let (file, temporary) = match unnamed(&folder) {
        Some(file) => (file, None),
        None => named(&folder).map(|(file, name)| (file, Some(name)))?,
    };
    if let Some(replaced) = replaced.filter(|found| found.is_file()) {
        let own = file.metadata()?;
        if (own.uid(), own.gid()) != (replaced.uid(), replaced.gid()) {
            let (owner, group) = (Uid::from_raw(replaced.uid()), Gid::from_raw(replaced.gid()));
            // Only root can give a file to another user.
            let _ = rustix::fs::fchown(&file, Some(owner), Some(group));
        }
        // On a file system without modes all files have the same.
        let _ = rustix::fs::fchmod(&file, Mode::from_raw_mode(replaced.mode() & 0o777));
    }
    Ok((file, Some(Place { folder, name, temporary })))
}

/// A file without a name, where the file system knows such files and the kernel shows them.
fn unnamed(folder: &OwnedFd) -> Option<File> {
    let flags = OFlags::WRONLY | OFlags::TMPFILE | OFlags::CLOEXEC;
    let file = File::from(rustix::fs::openat(folder, ".", flags, MODE).ok()?);
    Path::new(&shown(&file)).symlink_metadata().is_ok().then_some(file)
}

/// A file with a random name.
fn named(folder: &OwnedFd) -> io::Result<(File, String)> {
    let name = temporary()?;
    let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL | OFlags::NOFOLLOW | OFlags::CLOEXEC;
    Ok((File::from(rustix::fs::openat(folder, &name, flags, MODE)?), name))
}

/// Passes when a file can be made in a folder.
pub(crate) fn probe(folder: &Path) -> io::Result<()> {
    let (_, place) = begin(&folder.join("file"), None)?;
    place.map_or(Ok(()), |place| place.remove()).map_err(io::Error::from)
}

/// A name that no other user can foresee.
pub(super) fn random() -> rustix::io::Result<String> {
    let mut bytes = [0; 16];
    rustix::rand::getrandom(&mut bytes, rustix::rand::GetRandomFlags::empty())?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;
    use crate::new_file::Scratch;

    fn names(folder: &Path) -> usize {
        std::fs::read_dir(folder).unwrap().count()
    }

    #[test]
    fn a_file_without_a_name_and_one_with_a_random_one_get_theirs_in_the_same_way() {
        let scratch = Scratch::new().unwrap();
        let path = scratch.path().join("file");
        for existing in [Existing::Keep, Existing::Replace] {
            for has_name in [false, true] {
                let (mut file, place) = begin(&path, None).unwrap();
                let mut place = place.unwrap();
                assert_eq!(
                    place.temporary.is_none(),
                    unnamed(&place.folder).is_some(),
                    "none where it can be"
                );
                if has_name && place.temporary.is_none() {
                    let (other, name) = named(&place.folder).unwrap();
                    (file, place.temporary) = (other, Some(name));
                }
                // Nothing of a file without a name is left when its process is killed.
                assert_eq!(names(scratch.path()), usize::from(place.temporary.is_some()));
                file.write_all(b"new").unwrap();
                place.name(&file, existing).unwrap();
                assert_eq!((std::fs::read(&path).unwrap(), names(scratch.path())), (b"new".to_vec(), 1));
                std::fs::remove_file(&path).unwrap();
                std::fs::write(&path, "own").unwrap();
                let (file, place) = begin(&path, None).unwrap();
                let mut place = place.unwrap();
                let given = place.name(&file, existing);
                assert_eq!(given.is_err(), existing == Existing::Keep);
                place.remove().unwrap_or_default();
                assert_eq!(names(scratch.path()), 1);
                std::fs::remove_file(&path).unwrap();
            }
        }
    }
}
