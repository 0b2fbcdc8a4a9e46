//! `scanloop swap --watch`: swaps again each time the program changes.
//!
//! The folders of its files are watched. A change is taken when nothing has happened for a while, no file is being
//! written, and all are whole; then the contents decide whether there is a change at all.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use console::exit::{Exit, Failure};
use console::{answer, note};
use runtime::{Domain, RuntimeError, Shutdown, wait_for};
use rustix::fs::inotify::{self, CreateFlags, ReadFlags, WatchFlags};
use rustix::io::Errno;
use rustix::process::geteuid;
use session::control::{Reply, Request, SwapRequest, ask};
use supervision::replaceable;

use super::{certificate, program};
use crate::print_json;
use crate::successor::begin;

/// A change is taken this long after the last event: editors and linkers write in several steps.
const QUIET: Duration = Duration::from_millis(300);
/// Longest sleep: then it is checked whether the system still runs, and a request that was refused is repeated [ns].
const POLL_NS: u64 = 1_000_000_000;

/// Swaps to the program now and after each change, until a signal comes or the system ends.
///
/// # Errors
/// A command without a file to watch, a first swap that can't begin (exit code 2), and errors of inotify.
pub(super) fn watch(domain: &Domain, request: &SwapRequest, json: bool) -> anyhow::Result<Exit> {
    let shutdown = Shutdown::on_signals()?;
    let command = request.successor.command.clone().unwrap_or_default();
    let program = PathBuf::from(command.first().cloned().unwrap_or_default());
    let mut folders = Folders::new()?;
    let mut files = program::files(&command);
    if files.is_empty() {
        return Err(Failure::bad_input(
            "--watch: the command names no file; name the program by a path, as in ./my-controller",
        ));
    }
    require_own(&files)?;
    folders.follow(&files)?;
    let mut tried = program::fingerprint(&files, &program);
    let mut number = Some(begin(domain, &Request::Swap(request.clone()))?);
    note!("watching {}; Ctrl-C ends this command", names(&files));
    let mut refused = String::new();
    loop {
        if let Some(number) = number.take() {
            let Some(certificate) = certificate(domain, number, || shutdown.requested())? else {
                return Ok(Exit::Done);
            };
            print_json(json, &certificate)?;
            answer!(json, "{certificate}")?;
        }
        let wait_ns = if folders.is_pending() { QUIET.as_nanos() as u64 / 4 } else { POLL_NS };
        wait_for(&[shutdown.descriptor(), folders.descriptor.as_fd()], wait_ns);
        if shutdown.requested() {
            return Ok(Exit::Done);
        }
        if let Err(error) = supervision::runs::existing(domain.system_id()) {
            note!("{error}");
            return Ok(Exit::Done);
        }
        folders.take(&files)?;
        if !folders.is_settled() {
            continue;
        }
        files = program::files(&command);
        require_own(&files)?;
        folders.follow(&files)?;
        match program::fingerprint(&files, &program) {
            // What is missing or not whole comes with another event.
            None => folders.forget(),
            now if now == tried => folders.forget(),
            now => match ask(domain, &Request::Swap(request.clone())) {
                Ok(Reply::Accepted(accepted)) => {
                    note!("{} changed", names(&folders.changed(&files)));
                    folders.forget();
                    (tried, number) = (now, Some(accepted));
                }
                // Another swap is in progress, or the system does not drive yet: it is asked again.
                Ok(Reply::Refused(reason)) if reason != refused => {
                    note!("not swapped yet: {reason}");
                    refused = reason;
                    folders.defer();
                }
                Ok(_) => folders.defer(),
                Err(error) if matches!(error.downcast_ref(), Some(RuntimeError::NotRunning(_))) => {
                    folders.defer();
                }
                Err(error) => return Err(error),
            },
        }
    }
}

/// Passes when no other user can replace one of the files: their changes are run without a question.
///
/// # Errors
/// The file, and what makes it possible; exit code 2.
fn require_own(files: &BTreeSet<PathBuf>) -> anyhow::Result<()> {
    match files.iter().find_map(|file| replaceable::path(file)) {
        Some(reason) => Err(Failure::bad_input(format!(
            "--watch: {reason}; a changed file runs at once with the rights of user {}",
            geteuid().as_raw()
        ))),
        None => Ok(()),
    }
}

/// The names of files, the first three of them.
fn names(files: &BTreeSet<PathBuf>) -> String {
    let name = |path: &PathBuf| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let names: BTreeSet<String> = files.iter().filter_map(name).collect();
    let shown: Vec<String> = names.iter().take(3).cloned().collect();
    let more = if names.len() > 3 { format!(" and {} more", names.len() - 3) } else { String::new() };
    shown.join(", ") + &more
}

/// The folders of the files, as inotify watches them.
struct Folders {
    descriptor: OwnedFd,
    /// Folders by the number of their watch.
    watched: BTreeMap<i32, PathBuf>,
    /// Files with events, and whether each is being written.
    pending: BTreeMap<PathBuf, bool>,
    last_event: Instant,
}

impl Folders {
    fn new() -> anyhow::Result<Self> {
        let descriptor = inotify::init(CreateFlags::CLOEXEC | CreateFlags::NONBLOCK)?;
        let (watched, pending) = (BTreeMap::new(), BTreeMap::new());
        Ok(Self { descriptor, watched, pending, last_event: Instant::now() })
    }

    /// Watches the folders of these files; a folder that was replaced is watched anew.
    fn follow(&mut self, files: &BTreeSet<PathBuf>) -> anyhow::Result<()> {
        let events = WatchFlags::MODIFY
            | WatchFlags::CLOSE_WRITE
            | WatchFlags::ATTRIB
            | WatchFlags::CREATE
            | WatchFlags::DELETE
            | WatchFlags::MOVED_FROM
            | WatchFlags::MOVED_TO;
        let folders: BTreeSet<&Path> = files.iter().filter_map(|file| file.parent()).collect();
        for folder in folders {
            match inotify::add_watch(&self.descriptor, folder, events | WatchFlags::ONLYDIR) {
                Ok(number) => _ = self.watched.insert(number, folder.to_owned()),
                Err(Errno::NOENT) => {}
                Err(error) => return Err(anyhow::anyhow!("{} can't be watched: {error}", folder.display())),
            }
        }
        Ok(())
    }

    /// Takes the events that wait; those of other files in the same folders do not count.
    fn take(&mut self, files: &BTreeSet<PathBuf>) -> anyhow::Result<()> {
        let mut buffer = [MaybeUninit::uninit(); 4096];
        let mut reader = inotify::Reader::new(&self.descriptor, &mut buffer);
        loop {
            let event = match reader.next() {
                Ok(event) => event,
                Err(Errno::AGAIN) => return Ok(()),
                Err(Errno::INTR) => continue,
                Err(error) => return Err(error.into()),
            };
            if event.events().contains(ReadFlags::QUEUE_OVERFLOW) {
                // Events were lost: the contents decide.
                self.pending.extend(files.iter().map(|file| (file.clone(), false)));
                self.last_event = Instant::now();
            }
            let Some(folder) = self.watched.get(&event.wd()) else { continue };
            let Some(name) = event.file_name() else { continue };
            let path = folder.join(OsString::from_vec(name.to_bytes().to_vec()));
            // A new Python file may be one that an import was waiting for.
            let is_new_module = path.extension().is_some_and(|extension| extension == "py");
            if files.contains(&path) || is_new_module {
                let is_written = self.pending.entry(path).or_insert(false);
                if event.events().contains(ReadFlags::MODIFY) {
                    *is_written = true;
                } else if !event.events().intersects(ReadFlags::ATTRIB | ReadFlags::CREATE) {
                    *is_written = false;
                }
                self.last_event = Instant::now();
            }
        }
    }

    fn is_pending(&self) -> bool {
        !self.pending.is_empty()
    }

    /// Whether something has happened, all that was written is closed, and nothing has happened for a while.
    fn is_settled(&self) -> bool {
        let is_written = self.pending.values().any(|is_written| *is_written);
        self.is_pending() && !is_written && self.last_event.elapsed() >= QUIET
    }

    /// The files of the program that have events.
    fn changed(&self, files: &BTreeSet<PathBuf>) -> BTreeSet<PathBuf> {
        self.pending.keys().filter(|path| files.contains(*path)).cloned().collect()
    }

    fn forget(&mut self) {
        self.pending.clear();
    }

    /// The change is taken again after a while.
    fn defer(&mut self) {
        self.last_event = Instant::now();
    }
}
