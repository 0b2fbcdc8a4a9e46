//! Outputs that nothing can be renamed to: devices, pipes and files that a process has open.

use std::fs::{File, Metadata, OpenOptions};
use std::io;
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

/// Whether a path is a device of characters or a pipe, or a link to one that this user or root has made, or such a link to a
/// file that a process has open. All these are written to, never replaced.
pub(crate) fn leads_to_device(path: &Path) -> bool {
    let Ok(own) = path.symlink_metadata() else { return false };
    let is_device = |found: Metadata| found.file_type().is_char_device() || is_trusted_pipe(&found);
    let is_open = || own.is_symlink() && leads_to_open_file(path);
    (!own.is_symlink() || is_trusted(&own)) && (path.metadata().is_ok_and(is_device) || is_open())
}

/// Whether this user or root has made it.
pub(super) fn is_trusted(found: &Metadata) -> bool {
    [0, rustix::process::geteuid().as_raw()].contains(&found.uid())
}

/// A pipe of another user would take what is written to that user.
fn is_trusted_pipe(found: &Metadata) -> bool {
    found.file_type().is_fifo() && is_trusted(found)
}

/// Whether a link stands in `/dev`, or leads to a file that a process has open: `/dev/stdout` may be any kind of file, or none.
fn leads_to_open_file(link: &Path) -> bool {
    let folder = |path: &Path| path.parent().and_then(|parent| parent.canonicalize().ok());
    let is_open = |found: &PathBuf| found.starts_with("/proc") && found.ends_with("fd");
    let target = link.read_link().ok().map(|target| link.parent().unwrap_or(Path::new("")).join(target));
    folder(link).is_some_and(|found| found == Path::new("/dev") || is_open(&found))
        || target.and_then(|target| folder(&target)).is_some_and(|found| is_open(&found))
}

/// Opens what [`leads_to_device`] has found. Standard output and standard error are not opened anew when they are regular
/// files: a later line would be written over the start of this one.
pub(super) fn open_device(path: &Path) -> io::Result<File> {
    let found = path.metadata()?;
    if found.file_type().is_block_device() {
        return Err(io::Error::other("it is no regular file"));
    }
    let inode = |found: &Metadata| (found.dev(), found.ino());
    let is_it = |file: &File| file.metadata().is_ok_and(|own| inode(&own) == inode(&found));
    for stream in [io::stdout().as_fd(), io::stderr().as_fd()] {
        let file = File::from(stream.try_clone_to_owned()?);
        if found.is_file() && is_it(&file) {
            return Ok(file);
        }
    }
    let file = OpenOptions::new().append(true).open(path)?;
    let opened = file.metadata()?;
    if opened.file_type().is_fifo() && !is_trusted_pipe(&opened) {
        return Err(io::Error::other("it is a pipe of another user"));
    }
    Ok(file)
}
