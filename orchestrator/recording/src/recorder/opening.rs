//! What stands at the start of each recording of a run: scenario, system, settings, layouts and the machine.

use std::io::{self, Write};
use std::path::PathBuf;

use runtime::{Domain, LAYOUTS_FILE, OwnTopics, TOPICS_FILE, settings_file, started_settings_file};
use serde::Deserialize;
use shared_types::Role;

use crate::mcap::Writer;
use crate::own::OwnTopic;
use crate::read::{RECORDING, RUN, VERSION, settings_of};
use crate::tape::{LIBRARY, media_type, writer_with};

/// Of the files about single processes, a ring keeps so many.
const MAX_FILES: usize = 64;

/// Files and texts of a run.
#[derive(Debug, Default)]
pub(super) struct Opening {
    files: Vec<(String, Vec<u8>)>,
    /// Files that were added while the run drives.
    later: Vec<(String, Vec<u8>)>,
    entries: Vec<(String, String)>,
    /// Topics that the system adds to those of the loop.
    pub(super) own: Vec<OwnTopic>,
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
        let table = OwnTopics::of(domain)?;
        if table.is_some() {
            files.push((TOPICS_FILE.to_owned(), domain.folder().read(TOPICS_FILE)?));
        }
        let own = table.as_ref().map_or_else(Vec::new, OwnTopic::all);
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
        Ok(Self { files, later: Vec::new(), entries, own, out, lockstep, period_ns })
    }

    /// Contents of the files of settings that the recording begins with.
    pub(super) fn settings_at_start(&self) -> Vec<Vec<u8>> {
        let is_settings = |name: &str| Role::ALL.iter().any(|role| settings_file(*role) == name);
        self.files.iter().filter(|(name, _)| is_settings(name)).map(|(_, data)| data.clone()).collect()
    }

    /// Begins a recording with it.
    ///
    /// # Errors
    /// Those of `out`.
    pub(super) fn begin<W: Write>(&self, out: W) -> io::Result<Writer<W>> {
        let mut writer = writer_with(out, &self.own)?;
        for (name, data) in self.files.iter().chain(&self.later) {
            writer.attach(name, media_type(name), data, 0)?;
        }
        writer.metadata(RECORDING, &self.entries)?;
        Ok(writer)
    }

    /// Adds a file for recordings that begin later; the oldest of too many is dropped.
    pub(super) fn add(&mut self, name: &str, data: &[u8]) {
        self.later.push((name.to_owned(), data.to_owned()));
        if self.later.len() > MAX_FILES {
            // A process may drive for days with the settings that it was started with.
            let is_newest = |index: usize| {
                let role = |name: &str| Some(name.rsplit_once('-')?.0.to_owned());
                let of = role(&self.later[index].0).filter(|of| of != "processes");
                of.is_some() && self.later[index + 1..].iter().all(|(name, _)| role(name) != of)
            };
            let oldest = (0..self.later.len()).find(|index| !is_newest(*index)).unwrap_or_default();
            self.later.remove(oldest);
        }
    }

    /// The settings of a process, if they are not those that the recording begins with: name and content of a file.
    pub(super) fn settings(domain: &Domain, role: Role, incarnation: u32) -> Option<(String, Vec<u8>)> {
        let folder = domain.folder();
        let text = folder.read(&started_settings_file(incarnation));
        let text = text.or_else(|_| folder.read(&settings_file(role)));
        Some((settings_of(role, incarnation), text.ok()?))
    }
}
