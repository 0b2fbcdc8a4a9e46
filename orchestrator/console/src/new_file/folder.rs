//! Folders by their paths, on which no link is followed that another user has placed.
//!
//! The kernel protects only folders with the sticky bit in this way (`fs.protected_symlinks`), and not where that is off.

use std::collections::VecDeque;
use std::ffi::{OsStr, OsString};
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStringExt;
use std::path::{Component, Path, PathBuf};

use rustix::fs::{CWD, FileType, Mode, OFlags, PROC_SUPER_MAGIC, Stat};
use rustix::io::Errno;

use crate::exit::Unwritable;

/// So many links the kernel follows on one path.
const MAX_LINKS: usize = 40;
/// An entry itself, also a link.
const ENTRY: OFlags = OFlags::PATH.union(OFlags::NOFOLLOW).union(OFlags::CLOEXEC);
/// What a link of the kernel leads to.
const FOLDER: OFlags = OFlags::PATH.union(OFlags::DIRECTORY).union(OFlags::CLOEXEC);
/// Mode of a new folder, from which the mask of the process takes what it takes from every folder.
const MODE: Mode = Mode::from_raw_mode(0o777);

/// Makes a folder, and those around it, where they are missing.
///
/// # Errors
/// A link on the way that another user has placed, and errors of the file system.
pub fn make_folder(path: &Path) -> io::Result<()> {
    walk(path, true).map(drop)
}

/// Opens a folder.
///
/// # Errors
/// As [`make_folder`].
pub(super) fn open_folder(path: &Path) -> io::Result<OwnedFd> {
    walk(path, false)
}

fn walk(path: &Path, makes: bool) -> io::Result<OwnedFd> {
    let open = |name: &str| rustix::fs::openat(CWD, name, FOLDER, Mode::empty());
    let mut folder = open(if path.is_absolute() { "/" } else { "." })?;
    let mut shown = PathBuf::from(if path.is_absolute() { "/" } else { "" });
    let (mut rest, mut links) = (names(path), 0);
    while let Some(name) = rest.pop_front() {
        let entry = match rustix::fs::openat(&folder, &name, ENTRY, Mode::empty()) {
            Err(Errno::NOENT) if makes => {
                match rustix::fs::mkdirat(&folder, &name, MODE) {
                    Ok(()) | Err(Errno::EXIST) => {}
                    Err(error) => return Err(error.into()),
                }
                rustix::fs::openat(&folder, &name, ENTRY, Mode::empty())?
            }
            opened => opened?,
        };
        shown.push(&name);
        let found = rustix::fs::fstat(&entry)?;
        match FileType::from_raw_mode(found.st_mode) {
            FileType::Directory => folder = entry,
            FileType::Symlink => {
                links += 1;
                if links > MAX_LINKS {
                    return Err(Errno::LOOP.into());
                }
                if !is_trusted(&found, &rustix::fs::fstat(&folder)?) {
                    let user = found.st_uid;
                    let reason =
                        format!("a link of user {user}, which is not followed: name the folder itself");
                    return Err(Unwritable::wrap(&shown, io::Error::other(reason)));
                }
                // Those of the kernel lead to what a process has open, whatever their text.
                if rustix::fs::fstatfs(&entry)?.f_type == PROC_SUPER_MAGIC {
                    folder = rustix::fs::openat(&folder, &name, FOLDER, Mode::empty())?;
                    continue;
                }
                let target = rustix::fs::readlinkat(&entry, "", Vec::new())?;
                let target = PathBuf::from(OsString::from_vec(target.into_bytes()));
                if target.is_absolute() {
                    (folder, shown) = (open("/")?, PathBuf::from("/"));
                }
                let mut names = names(&target);
                names.append(&mut rest);
                rest = names;
            }
            _ => return Err(Errno::NOTDIR.into()),
        }
    }
    Ok(folder)
}

/// The path of a file without a link or `..` on the way to it, as [`make_folder`] would go to its folder.
pub(crate) fn resolved(path: &Path) -> io::Result<PathBuf> {
    let path = std::path::absolute(path)?;
    let (mut rest, mut links) = (names(path.parent().unwrap_or(Path::new(""))), 0);
    let mut found = PathBuf::from("/");
    while let Some(name) = rest.pop_front() {
        if name == ".." {
            found.pop();
            continue;
        }
        found.push(name);
        let Ok(target) = found.read_link() else { continue };
        links += 1;
        if links > MAX_LINKS {
            return Err(Errno::LOOP.into());
        }
        found.pop();
        if target.is_absolute() {
            found = PathBuf::from("/");
        }
        let mut names = names(&target);
        names.append(&mut rest);
        rest = names;
    }
    found.extend(path.file_name());
    Ok(found)
}

/// The names on a path, one after the other.
fn names(path: &Path) -> VecDeque<OsString> {
    let is_name = |part: &Component<'_>| matches!(part, Component::Normal(_) | Component::ParentDir);
    path.components().filter(is_name).map(|part| OsStr::to_owned(part.as_os_str())).collect()
}

/// Whether a link is of this user or of root, or of the owner of its folder, in which no other user can place one.
fn is_trusted(link: &Stat, folder: &Stat) -> bool {
    let is_own = [0, rustix::process::geteuid().as_raw()].contains(&link.st_uid);
    is_own || link.st_uid == folder.st_uid && folder.st_mode & 0o022 == 0
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{MetadataExt, PermissionsExt, lchown, symlink};

    use super::*;
    use crate::new_file::{Existing, NewFile, Scratch, open_log};

    fn inode(path: &Path) -> u64 {
        path.metadata().unwrap().ino()
    }

    fn inode_of(folder: &OwnedFd) -> u64 {
        rustix::fs::fstat(folder).unwrap().st_ino
    }

    #[test]
    fn folders_are_made_and_links_of_this_user_are_followed() {
        let scratch = Scratch::new().unwrap();
        let [target, link] = ["target/inner", "link"].map(|name| scratch.path().join(name));
        make_folder(&target).unwrap();
        make_folder(&target).unwrap();
        symlink("target/../target/./inner", &link).unwrap();
        assert_eq!(inode_of(&open_folder(&link).unwrap()), inode(&target));
        let by_link = link.join("more");
        make_folder(&by_link).unwrap();
        assert!(target.join("more").is_dir());
        symlink(scratch.path(), scratch.path().join("absolute")).unwrap();
        let by_absolute = scratch.path().join("absolute/link/more/..");
        assert_eq!(inode_of(&open_folder(&by_absolute).unwrap()), inode(&target));
        assert_eq!(inode_of(&open_folder(Path::new("/proc/self/cwd")).unwrap()), inode(Path::new(".")));
        assert_eq!(inode_of(&open_folder(Path::new("")).unwrap()), inode(Path::new(".")));
        symlink("loop", scratch.path().join("loop")).unwrap();
        assert!(open_folder(&scratch.path().join("loop")).is_err());
        std::fs::write(scratch.path().join("file"), "").unwrap();
        assert!(make_folder(&scratch.path().join("file/inner")).is_err());
        assert!(open_folder(&scratch.path().join("missing")).is_err());
    }

    #[test]
    fn a_link_that_another_user_has_placed_is_not_followed() {
        if !rustix::process::geteuid().is_root() {
            return;
        }
        let scratch = Scratch::new().unwrap();
        let [open, target] = ["open", "target"].map(|name| scratch.path().join(name));
        make_folder(&open).unwrap();
        make_folder(&target).unwrap();
        std::fs::set_permissions(&open, PermissionsExt::from_mode(0o777)).unwrap();
        let link = open.join("logs");
        symlink(&target, &link).unwrap();
        lchown(&link, Some(1234), None).unwrap();
        let inner = link.join("inner");
        let message = make_folder(&inner).unwrap_err().to_string();
        assert!(message.contains("logs: a link of user 1234"), "{message}");
        let file = link.join("report.json");
        assert!(NewFile::create(&file, Existing::Replace, &[]).is_err());
        assert!(open_log(&file, std::fs::OpenOptions::new().create(true).append(true)).is_err());
        // Nor by a link of this user that leads over it.
        symlink("open/logs", scratch.path().join("way")).unwrap();
        assert!(make_folder(&scratch.path().join("way/inner")).is_err());
        assert_eq!(std::fs::read_dir(&target).unwrap().count(), 0);
        // In a folder of its own, in which no other user places links.
        lchown(&open, Some(1234), None).unwrap();
        std::fs::set_permissions(&open, PermissionsExt::from_mode(0o755)).unwrap();
        assert_eq!(inode_of(&open_folder(&link).unwrap()), inode(&target));
    }
}
