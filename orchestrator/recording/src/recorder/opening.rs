//! What stands at the start of each recording of a run: scenario, system, settings, layouts and the machine.

use std::io::{self, Write};
use std::path::PathBuf;

use runtime::{Domain, LAYOUTS_FILE, settings_file};
use serde::Deserialize;
use shared_types::Role;

use crate::mcap::Writer;
use crate::read::{RECORDING, RUN, VERSION};
use crate::tape::{LIBRARY, media_type, writer};

/// Of the files that list the processes of the run, a ring keeps so many.
const MAX_FILES: usize = 64;

/// Files and texts of a run.
#[derive(Debug, Default)]
pub(super) struct Opening {
    files: Vec<(String, Vec<u8>)>,
    /// Files that were added while the run drives.
    later: Vec<(String, Vec<u8>)>,
    entries: Vec<(String, String)>,
    /// The folder of its results.
    pub(super) out: PathBuf,
    /// Whether time is simulated.
    pub(super) lockstep: bool,
    /// Scan period [ns].
    pub(super) period_ns: u64,
}

impl Opening {
    /// From the files in the directory of the system.
    ///
    /// # Errors
    /// A file that is missing.
    pub(super) fn of(domain: &Domain) -> anyhow::Result<Self> {
        #[derive(Deserialize)]
        struct Run {
            out: PathBuf,
            lockstep: bool,
        }
        #[derive(Deserialize)]
        struct Settings {
            run: runtime::RunSettings,
        }
        let text = domain.folder().read_text(RUN)?;
        let Run { out, lockstep } = toml::from_str(&text)?;
        let robot: Settings = toml::from_str(&domain.folder().read_text(&settings_file(Role::Robot))?)?;
        let mut files = vec![(RUN.to_owned(), text.into_bytes())];
        for name in Role::ALL.iter().map(|role| settings_file(*role)).chain([LAYOUTS_FILE.to_owned()]) {
            let text = domain.folder().read_text(&name)?;
            files.push((name, text.into_bytes()));
        }
        let kernel = std::fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
        let machine = format!("{} {} {}", std::env::consts::OS, kernel.trim(), std::env::consts::ARCH);
        let executable = std::fs::read("/proc/self/exe").map_or(0, |bytes| crc32fast::hash(&bytes));
        let period_ns = robot.run.period_ns;
        let entries = [
            ("version", VERSION.to_owned()),
            ("program", LIBRARY.to_owned()),
            ("executable_crc32", format!("{executable:08x}")),
            ("machine", machine),
            ("run_id", domain.run_id().to_owned()),
            ("system_id", domain.system_id().to_owned()),
            ("lockstep", lockstep.to_string()),
            ("period_ns", period_ns.to_string()),
        ];
        let entries = entries.map(|(key, value)| (key.to_owned(), value)).to_vec();
        Ok(Self { files, later: Vec::new(), entries, out, lockstep, period_ns })
    }

    /// Begins a recording with it.
    ///
    /// # Errors
    /// Those of `out`.
    pub(super) fn begin<W: Write>(&self, out: W) -> io::Result<Writer<W>> {
        let mut writer = writer(out)?;
        for (name, data) in self.files.iter().chain(&self.later) {
            writer.attach(name, media_type(name), data, 0)?;
        }
        writer.metadata(RECORDING, &self.entries)?;
        Ok(writer)
    }

    /// Adds a file for recordings that begin later; the oldest of too many is dropped.
    pub(super) fn add(&mut self, name: &str, data: &[u8]) {
        self.later.push((name.to_owned(), data.to_owned()));
        let surplus = self.later.len().saturating_sub(MAX_FILES);
        self.later.drain(..surplus);
    }
}
