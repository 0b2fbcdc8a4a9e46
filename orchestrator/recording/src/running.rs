//! Where a running system is recorded: the recordings that recorders write of it, and the last seconds of its incidents.

use std::path::{Path, PathBuf};

use runtime::{Domain, RuntimeError};
use serde::Deserialize;

use crate::read::RUN;

/// Name of the list of recordings in the directory of a system, one path a line.
const LIST: &str = "recordings.txt";
/// Name of the file in the folder of the results with the last seconds that were asked for; each replaces the one before.
pub const ASKED: &str = "asked.mcap";

/// Notes that a recording of the system is written.
///
/// # Errors
/// Those of the file system.
pub(crate) fn note(domain: &Domain, file: &Path) -> Result<(), RuntimeError> {
    let Ok(file) = std::path::absolute(file) else { return Ok(()) };
    let known = domain.folder().read_text(LIST).unwrap_or_default();
    domain.folder().write(LIST, format!("{known}{}\n", file.display()).as_bytes())
}

/// The recordings that are or were written of the system, the newest first.
pub fn recordings(domain: &Domain) -> Vec<PathBuf> {
    let list = domain.folder().read_text(LIST).unwrap_or_default();
    list.lines().rev().map(PathBuf::from).collect()
}

/// The files with the last seconds before incidents, and before somebody asked, the newest first. They may be of an earlier
/// run that wrote to the same folder.
pub fn kept(domain: &Domain) -> Vec<PathBuf> {
    #[derive(Deserialize)]
    struct Run {
        out: PathBuf,
    }
    let run: Option<Run> = domain.folder().read_text(RUN).ok().and_then(|text| toml::from_str(&text).ok());
    let entries = run.and_then(|run| std::fs::read_dir(run.out).ok());
    let is_kept = |name: &str| name == ASKED || name.starts_with("incident-") && name.ends_with(".mcap");
    let mut kept: Vec<_> = entries
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| entry.file_name().to_str().is_some_and(is_kept))
        .filter_map(|entry| Some((entry.metadata().ok()?.modified().ok()?, entry.path())))
        .collect();
    kept.sort();
    kept.into_iter().rev().map(|(_, path)| path).collect()
}
