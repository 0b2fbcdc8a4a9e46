//! The folder of an option `--out`: a command replaces what it wrote there before, and nothing else unasked.
//!
//! The file `.scanloop` of the folder has a line for each file that was written: checksum, length, name. A file whose
//! content is in none of the lines is of the user, also one that the user has changed since.

use std::collections::BTreeSet;
use std::fmt::Display;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::Write;
use std::path::{Path, PathBuf};

use crate::exit::{Failure, Unwritable};
use crate::new_file::{self, leads_to_device, make_folder, open_log, require_apart, resolved};
use crate::user_file::{self, TEXT_BYTES};

/// The list of what was written.
const LIST: &str = ".scanloop";
/// A list that is longer is written anew, with the lines of files that are there [bytes].
const MAX_LIST_BYTES: usize = 1 << 16;
/// A name in so many of the last lines may be that of a file which is about to be made.
const NEWEST_LINES: usize = 64;
/// A recording has this name, in front of a version, in its first so many bytes.
const PROGRAM: &[u8] = b"scanloop ";
const HEADER_BYTES: u64 = 64;
/// A file that is larger is none that a command writes whole [bytes].
const MAX_RESULT_BYTES: u64 = 1 << 30;

/// A folder of results.
#[derive(Debug, Clone)]
pub struct OutFolder {
    folder: PathBuf,
    names: Vec<String>,
    force: bool,
}

impl OutFolder {
    /// The folder of a command that will write files of these names.
    ///
    /// # Errors
    /// A file of one of the names that is not a result of an earlier command, unless `force`; exit code 2.
    pub fn claim(folder: &Path, names: &[&str], force: bool) -> anyhow::Result<Self> {
        let names_kept = names.iter().map(ToString::to_string).collect();
        let results = Self { folder: folder.to_owned(), names: names_kept, force };
        names.iter().try_for_each(|name| results.require_own(name))?;
        Ok(results)
    }

    /// Writes a file; makes its folder.
    ///
    /// # Errors
    /// As [`OutFolder::claim`], and the first error of the file system; exit code 2.
    pub fn write(&self, name: &str, content: &[u8]) -> anyhow::Result<PathBuf> {
        let path = self.folder.join(name);
        let refuse = |error: std::io::Error| Unwritable::wrap(&path, error);
        self.require_own(name)?;
        path.parent().map_or(Ok(()), make_folder).map_err(refuse)?;
        // First the line, then the file: after a power failure between them the old file is still known.
        self.note(&line(name, content)).map_err(refuse)?;
        new_file::write(&path, content)?;
        Ok(path)
    }

    /// Passes when none of the files is one that the command reads.
    ///
    /// # Errors
    /// Both names; exit code 2.
    pub fn require_apart(&self, inputs: &[&Path]) -> anyhow::Result<()> {
        self.names.iter().try_for_each(|name| require_apart(&self.folder.join(name), inputs))
    }

    /// Passes when a file may be made here that is none of the results, of the logs, and not the list.
    ///
    /// # Errors
    /// The name of the file; exit code 2.
    pub fn require_other(&self, path: &Path) -> anyhow::Result<()> {
        let refuse = |error: std::io::Error| Failure::bad_input(format!("{}: {error}", path.display()));
        let list = resolved(&self.folder.join(LIST)).map_err(refuse)?;
        let path = resolved(path).map_err(refuse)?;
        let name = list.parent().and_then(|folder| path.strip_prefix(folder).ok()).unwrap_or(Path::new(""));
        let is_ours = name.starts_with("logs")
            || name == Path::new(LIST)
            || self.names.iter().any(|own| name == Path::new(own));
        match is_ours {
            true => Err(Failure::bad_input(format!("{}: the run writes this file itself", path.display()))),
            false => Ok(()),
        }
    }

    /// Holds the folder as long as what is returned lives: two runs would write into each other's files.
    ///
    /// # Errors
    /// Another run that writes there, and a folder that can't be made; exit code 2.
    pub fn hold(&self) -> anyhow::Result<File> {
        let refuse =
            |reason: &dyn Display| Failure::bad_input(format!("{}: {reason}", self.folder.display()));
        make_folder(&self.folder).map_err(|error| refuse(&error))?;
        let folder = File::open(&self.folder).map_err(|error| refuse(&error))?;
        match folder.try_lock() {
            Err(TryLockError::WouldBlock) => {
                Err(refuse(&"another run writes there; name another folder by --out"))
            }
            // A file system without locks can't tell.
            Ok(()) | Err(TryLockError::Error(_)) => Ok(folder),
        }
    }

    /// Whether a folder has the list of what was written there.
    pub fn has_list(folder: &Path) -> bool {
        folder.join(LIST).symlink_metadata().is_ok()
    }

    /// Where it is.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Removes a file if it is a result; one of the user stays, also with `force`.
    pub fn remove(&self, name: &str) {
        if self.is_own(name) {
            // A file that stays is as it was.
            let _ = std::fs::remove_file(self.folder.join(name));
        }
    }

    /// Claims a recording, which grows under its name: it is known by its name, and by the program that it names as its own.
    ///
    /// # Errors
    /// As [`OutFolder::claim`], and the first error of the file system; exit code 2.
    pub fn claim_growing(&self, name: &str) -> anyhow::Result<()> {
        let path = self.folder.join(name);
        if !self.force && path.symlink_metadata().is_ok() && !leads_to_device(&path) && !self.has_grown(name)
        {
            return Err(foreign(&path));
        }
        let noted = make_folder(&self.folder).and_then(|()| self.note(&line(name, b"")));
        Ok(noted.map_err(|error| Unwritable::wrap(&path, error))?)
    }

    /// Whether a file of this name was claimed by [`OutFolder::claim_growing`], and is no other one meanwhile.
    pub fn has_grown(&self, name: &str) -> bool {
        let is_ours =
            |start: Vec<u8>| start.is_empty() || start.windows(PROGRAM.len()).any(|bytes| bytes == PROGRAM);
        let path = self.folder.join(name);
        let is_there = || path.symlink_metadata().is_ok();
        self.may_grow(name) && (!is_there() || user_file::read_start(&path, HEADER_BYTES).is_ok_and(is_ours))
    }

    fn may_grow(&self, name: &str) -> bool {
        self.has(&line(name, b""))
    }

    fn require_own(&self, name: &str) -> anyhow::Result<()> {
        let path = self.folder.join(name);
        if self.force || path.symlink_metadata().is_err() || self.is_own(name) {
            return Ok(());
        }
        Err(foreign(&path))
    }

    fn is_own(&self, name: &str) -> bool {
        self.content(name).is_some_and(|content| self.has(&line(name, &content)))
    }

    fn content(&self, name: &str) -> Option<Vec<u8>> {
        user_file::read_bytes(&self.folder.join(name), MAX_RESULT_BYTES).ok()
    }

    fn has(&self, line: &str) -> bool {
        self.list().lines().any(|known| known == line.trim_end())
    }

    fn list(&self) -> String {
        user_file::read(&self.folder.join(LIST), TEXT_BYTES).unwrap_or_default()
    }

    fn note(&self, line: &str) -> std::io::Result<()> {
        if self.has(line) {
            return Ok(());
        }
        let list = self.list();
        let path = self.folder.join(LIST);
        if list.len() > MAX_LIST_BYTES {
            let name = |line: &str| line.splitn(3, ' ').nth(2).map(str::to_owned);
            let newest: BTreeSet<String> = list.lines().rev().take(NEWEST_LINES).filter_map(name).collect();
            let names: BTreeSet<String> = list.lines().filter_map(name).collect();
            let kept = |name: &String| {
                let there = || self.content(name).map(|content| self::line(name, &content));
                if !self.may_grow(name) {
                    return there();
                }
                // A file of this name that comes later may be of the user.
                let is_needed = newest.contains(name) || self.folder.join(name).symlink_metadata().is_ok();
                is_needed.then(|| self::line(name, b""))
            };
            let kept: String = names.iter().filter_map(kept).collect();
            return new_file::write(&path, (kept + line).as_bytes()).map_err(std::io::Error::other);
        }
        // Appended whole, so that commands at the same time do not lose each other's lines.
        open_log(&path, OpenOptions::new().create(true).append(true))?.write_all(line.as_bytes())
    }
}

fn foreign(path: &Path) -> anyhow::Error {
    Failure::bad_input(format!(
        "{}: the file exists and is not as a command of this program left it; name another folder, or replace it with \
         --force",
        path.display()
    ))
}

fn line(name: &str, content: &[u8]) -> String {
    format!("{:08x} {} {name}\n", crc32fast::hash(content), content.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::new_file::Scratch;

    #[test]
    fn results_are_replaced_and_files_of_the_user_are_not() {
        let folder = Scratch::new().unwrap();
        let claim = |force: bool| OutFolder::claim(folder.path(), &["velocity.csv"], force);
        let path = folder.path().join("velocity.csv");
        for content in ["one", "two"] {
            claim(false).unwrap().write("velocity.csv", content.as_bytes()).unwrap();
        }
        std::fs::write(&path, "own").unwrap();
        let message = claim(false).unwrap_err().to_string();
        assert!(message.contains("velocity.csv: the file exists"), "{message}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "own");
        claim(true).unwrap().remove("velocity.csv");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "own");
        claim(true).unwrap().write("velocity.csv", b"three").unwrap();
        claim(false).unwrap();
        std::fs::write(&path, "one").unwrap();
        claim(false).unwrap();
        let grown = folder.path().join("recording.mcap");
        std::fs::write(&grown, "own").unwrap();
        assert!(claim(false).unwrap().claim_growing("recording.mcap").is_err());
        std::fs::remove_file(&grown).unwrap();
        claim(false).unwrap().claim_growing("recording.mcap").unwrap();
        std::fs::write(&grown, "\u{89}MCAP ros2 scanloop 0.1.0 and more").unwrap();
        claim(false).unwrap().claim_growing("recording.mcap").unwrap();
        std::fs::write(&grown, "\u{89}MCAP ros2 other and more").unwrap();
        assert!(claim(false).unwrap().claim_growing("recording.mcap").is_err());
        assert!(!claim(false).unwrap().has_grown("recording.mcap"));
        claim(true).unwrap().claim_growing("recording.mcap").unwrap();
    }

    #[test]
    fn one_run_at_a_time_writes_to_a_folder_and_a_recording_is_none_of_its_files() {
        let folder = Scratch::new().unwrap();
        let results = OutFolder::claim(&folder.path().join("out"), &["report.json"], true).unwrap();
        let held = results.hold().unwrap();
        let message = results.hold().unwrap_err().to_string();
        assert!(message.contains("another run writes there"), "{message}");
        drop(held);
        results.hold().unwrap();
        for own in ["report.json", ".scanloop", "logs/robot.log", "./logs/../logs/x", "new/../report.json"] {
            results.require_other(&results.folder().join(own)).unwrap_err();
        }
        std::os::unix::fs::symlink("other/../out", folder.path().join("link")).unwrap();
        results.require_other(&folder.path().join("link/report.json")).unwrap_err();
        let by_link = OutFolder::claim(&folder.path().join("link"), &["report.json"], true).unwrap();
        by_link.require_other(&folder.path().join("out/report.json")).unwrap_err();
        for other in ["out/drive.mcap", "report.json", "outer/report.json"] {
            results.require_other(&folder.path().join(other)).unwrap();
        }
    }

    #[test]
    fn the_list_of_results_stays_small() {
        let folder = Scratch::new().unwrap();
        let results = OutFolder::claim(folder.path(), &[], false).unwrap();
        results.write("other", b"stays").unwrap();
        std::fs::write(folder.path().join(LIST), results.list() + &"0 0 gone\n".repeat(10_000)).unwrap();
        for scan in ["1", "2"] {
            results.claim_growing(&format!("incident-{scan}.mcap")).unwrap();
            std::fs::write(folder.path().join(format!("incident-{scan}.mcap")), "scanloop 0.1.0").unwrap();
        }
        std::fs::write(folder.path().join(LIST), results.list() + &"0 0 gone\n".repeat(10_000)).unwrap();
        std::fs::remove_file(folder.path().join("incident-1.mcap")).unwrap();
        results.claim_growing("recording.mcap").unwrap();
        results.write("a", b"new").unwrap();
        assert!(results.has_grown("recording.mcap"), "it is about to be made");
        assert!(results.list().len() < 100, "{}", results.list());
        assert_eq!(["1", "2"].map(|scan| results.has_grown(&format!("incident-{scan}.mcap"))), [false, true]);
        OutFolder::claim(folder.path(), &["a", "other"], false).unwrap();
    }
}
