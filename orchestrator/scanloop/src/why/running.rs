//! The drive of a running system, as far as it is recorded or kept in memory.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use console::exit::Failure;
use recording::running::{ASKED, kept, recordings};
use replay::NearDrive;
use runtime::{Domain, Priority, print, wait_for};
use session::control::{Reply, Request, SystemStatus, ask};
use session::orphaned::current_status;
use supervision::runs::existing;

/// A recording is written about once a second, and what is kept when it is asked for: a scan is waited for so long.
const WAIT: Duration = Duration::from_secs(4);
/// Time between two looks at the files [ns].
const LOOK_NS: u64 = 10_000_000;
/// A scan that is so far ahead of the newest one is not waited for.
const MAX_AHEAD: u64 = 10;

/// The drive of a running system, with all of a scan in it, or as far as it is written.
///
/// # Errors
/// A system that does not run or is not recorded, and a scan that is not driven yet or no longer kept; exit code 2.
pub(super) fn drive(system_id: &str, scan: Option<u64>) -> anyhow::Result<NearDrive> {
    let domain = existing(system_id)?;
    let status = current_status(&domain).ok();
    let newest = status.as_ref().map_or(0, |status| status.scan);
    if let Some(scan) = scan.filter(|scan| newest > 0 && *scan > newest.saturating_add(MAX_AHEAD)) {
        let reason = format!("scan {scan} is not driven yet: the newest of system `{system_id}` is {newest}");
        return Err(Failure::bad_input(reason));
    }
    let until = Instant::now() + WAIT;
    let run_id = domain.run_id().to_owned();
    let mut search = Search { run_id, scan, read: HashMap::new(), best: None, unwritten: None };
    let recordings = recordings(&domain);
    loop {
        search.read(&recordings);
        // A recording that began before the scan will have it.
        let began_later = recordings.is_empty() || search.first().is_some_and(|first| scan < Some(first));
        if began_later && !search.is_found() {
            // An overview is of all that is kept until now.
            if search.scan.is_some() {
                search.read(&kept(&domain));
            }
            if !search.is_found() && !search.ask(&domain, until) {
                search.read(&kept(&domain));
                break;
            }
        }
        if search.is_found() || Instant::now() > until {
            break;
        }
        wait_for(&[], LOOK_NS);
    }
    search.answer(&domain, status.as_ref(), recordings.is_empty())
}

/// Length and time of a file.
fn state_of(file: &Path) -> Option<(u64, SystemTime)> {
    let state = file.metadata().ok()?;
    Some((state.len(), state.modified().ok()?))
}

/// What was read in search of a scan.
struct Search {
    run_id: String,
    scan: Option<u64>,
    /// Length and time of what was read.
    read: HashMap<PathBuf, (u64, SystemTime)>,
    /// The drive that has the scan, else the one that reaches farthest.
    best: Option<NearDrive>,
    /// Why what is kept in memory was not written, although there may be some.
    unwritten: Option<anyhow::Error>,
}

impl Search {
    /// Reads files of the run that are new or have changed.
    fn read(&mut self, files: &[PathBuf]) {
        for file in files {
            let Some(state) = state_of(file) else { continue };
            if self.read.insert(file.clone(), state) == Some(state) || self.scan.is_some() && self.is_found()
            {
                continue;
            }
            // A recording holds nothing in its first second.
            let Ok(drive) = NearDrive::open(file, true) else { continue };
            let is_better = self.best.as_ref().is_none_or(|best| self.rank(&drive) >= self.rank(best));
            if drive.run_id() == self.run_id && is_better {
                self.best = Some(drive);
            }
        }
    }

    fn rank(&self, drive: &NearDrive) -> (bool, bool, u64) {
        let (begun, whole) = match self.scan {
            Some(scan) => (drive.has_scan(scan), drive.has_all_of(scan)),
            None => (true, true),
        };
        (begun, whole, drive.span().map_or(0, |(_, last)| last))
    }

    /// The answer to a scan needs all of it.
    fn is_found(&self) -> bool {
        self.best.as_ref().is_some_and(|best| self.rank(best).1)
    }

    fn first(&self) -> Option<u64> {
        Some(self.best.as_ref()?.span()?.0)
    }

    /// Has what is kept in memory written to a file, and reads it; false when nothing is kept.
    fn ask(&mut self, domain: &Domain, until: Instant) -> bool {
        let asked =
            || kept(domain).iter().filter(|file| file.ends_with(ASKED)).find_map(|file| state_of(file));
        let before = asked();
        match ask(domain, &Request::Keep) {
            Ok(Reply::Done) => {}
            Ok(_) => return false,
            Err(error) => {
                self.unwritten = Some(error);
                return false;
            }
        }
        while asked() == before && Instant::now() < until {
            wait_for(&[], LOOK_NS);
        }
        if asked() == before {
            let limit_s = WAIT.as_secs();
            self.unwritten = Some(anyhow::anyhow!("its recorder does not write it within {limit_s} s"));
        }
        self.read(&kept(domain));
        true
    }

    fn answer(
        self,
        domain: &Domain,
        status: Option<&SystemStatus>,
        is_unrecorded: bool,
    ) -> anyhow::Result<NearDrive> {
        let name = domain.system_id();
        let unwritten = self.unwritten.map(|error| {
            format!("what system `{name}` keeps of its drive in memory can't be read: {error:#}")
        });
        let blocking = status.and_then(|status| status.blocking);
        let stopped =
            blocking.map_or_else(String::new, |blocking| format!("; stopped: blocked by {blocking}"));
        let more = "`scanloop record FILE` records from now on, `run --record` from the start";
        let reason = match (self.best, self.scan) {
            (Some(drive), None) => {
                unwritten.iter().for_each(|text| print(Priority::Warning, text));
                return Ok(drive);
            }
            (Some(drive), Some(scan)) if drive.has_scan(scan) => return Ok(drive),
            _ if unwritten.is_some() => return Err(Failure::process(unwritten.unwrap_or_default())),
            (Some(drive), Some(scan)) => {
                let (first, last) = drive.span().unwrap_or_default();
                format!("scan {scan} of system `{name}` is not recorded: {first} to {last} are; {more}")
            }
            (None, _) if is_unrecorded => {
                format!("system `{name}` is not recorded, and keeps nothing in memory: {more}{stopped}")
            }
            (None, _) => format!("the recording of system `{name}` holds not one whole second yet{stopped}"),
        };
        Err(Failure::bad_input(reason))
    }
}
