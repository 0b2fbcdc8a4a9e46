//! A recorded drive in memory: its samples by process and by scan, its settings, and who was in charge.

mod clocks;
mod keys;
mod lane;
mod near;
#[cfg(test)]
pub(crate) mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use console::exit::Failure;
use recording::mcap::Contents;
use recording::read::{attachment, metadata, settings_of};
use recording::{LogLine, Recording};
use runtime::{monotonic_ns, settings_file, wait_for};

use shared_types::{
    Actuation, Authority, Checkpoint, ClockOffset, Command, Directive, Header, Journal, JournalEntry,
    JournalKind, Obstacles, Odometry, Pose, ROLES, Role, Sample, Scan, Topic, Truth, topics_of,
};
use supervision::entry::{ProcessEntry, ProcessRow, recorded_processes};
use toml::Table;

pub(crate) use self::clocks::{Clocks, moved};
pub(crate) use self::keys::DriveSettings;
pub(crate) use self::lane::Lane;
pub use self::near::NearDrive;
use crate::NotReplayed;

/// A recorded drive.
#[derive(Debug, Default)]
pub struct ReplayDrive {
    pub(crate) scans: Lane<Scan>,
    pub(crate) odometries: Lane<Odometry>,
    pub(crate) truths: Lane<Truth>,
    pub(crate) poses: Lane<Pose>,
    pub(crate) obstacles: Lane<Obstacles>,
    pub(crate) commands: Lane<Command>,
    pub(crate) actuations: Lane<Actuation>,
    pub(crate) checkpoints: Lane<Checkpoint>,
    /// Those with a goal that was given while driving.
    pub(crate) directives: Lane<Directive>,
    has_orders: bool,
    pub(crate) clocks: Clocks,
    /// The journals of each process, by number.
    journals: BTreeMap<u32, BTreeMap<u64, Journal>>,
    /// Samples that an injected fault has changed: topic, incarnation, sequence number.
    injected: BTreeSet<(u16, u32, u64)>,
    /// Whether an injected fault alters the robot, from scans on.
    altered: BTreeMap<u64, bool>,
    /// What orchestrator and processes have logged.
    pub(crate) lines: Vec<LogLine>,
    /// Changes of authority per role in their order, and when each was announced [ns].
    authority: [Vec<(u64, Authority)>; ROLES],
    pub(crate) simulated: bool,
    pub(crate) period_ns: u64,
    /// The last scan of the run in lock-step.
    pub(crate) last_scan: Option<u64>,
    pub(crate) settings: DriveSettings,
    /// Keys were changed: outputs are expected to differ.
    pub(crate) is_changed: bool,
    /// Processes that are no implementation of this program, and what they are.
    foreign: BTreeMap<u32, String>,
    /// Fields of samples whose layouts differ from those of this program.
    other_layouts: Vec<shared_types::Difference>,
    /// When the first scan was replayed, and when it was acquired, in a replay in real time [ns].
    pace_ns: Option<[u64; 2]>,
    /// The file.
    pub(crate) path: PathBuf,
}

impl ReplayDrive {
    /// Reads a recording: one drive, or as many as recordings were joined to one file.
    ///
    /// # Errors
    /// A file that can't be read, samples of another layout, or more of them than memory is given to; exit code 2.
    pub fn read(path: &Path) -> anyhow::Result<Vec<Self>> {
        Self::read_opened(path, Recording::open(path)?)
    }

    fn read_opened(path: &Path, mut recording: Recording) -> anyhow::Result<Vec<Self>> {
        let refuse = |reason: String| Failure::bad_input(format!("{}: {reason}", path.display()));
        let mut drives: Vec<Self> =
            recording.files().iter().map(|_| Self { path: path.to_owned(), ..Self::default() }).collect();
        recording.samples(|_, sample| {
            drives[sample.file].add(sample.topic, sample.log_ns, sample.bytes);
            Ok(())
        })?;
        if let [drive] = &mut drives[..] {
            drive.lines = recording.take_lines();
        }
        for (drive, contents) in drives.iter_mut().zip(recording.files()) {
            drive.note_contents(contents, &refuse)?;
        }
        Ok(drives)
    }

    /// Reads a recording of one drive.
    ///
    /// # Errors
    /// As [`Self::read`], and several drives that were joined.
    pub fn read_one(path: &Path) -> anyhow::Result<Self> {
        Self::only_one(path, Self::read(path)?)
    }

    /// Reads the recording of one drive as far as it is written, without a warning that its end is missing.
    ///
    /// # Errors
    /// As [`Self::read_one`].
    pub fn read_growing(path: &Path) -> anyhow::Result<Self> {
        Self::only_one(path, Self::read_opened(path, Recording::open(path)?.growing())?)
    }

    fn only_one(path: &Path, drives: Vec<Self>) -> anyhow::Result<Self> {
        let mut drives = drives.into_iter();
        match (drives.next(), drives.next()) {
            (Some(drive), None) => Ok(drive),
            _ => Err(Self::joined(path)),
        }
    }

    fn joined(path: &Path) -> anyhow::Error {
        let reason = "several drives were joined in it; `scanloop recording cut` takes one out";
        Failure::bad_input(format!("{}: {reason}", path.display()))
    }

    /// Takes in what stands beside the samples.
    fn note_contents(
        &mut self,
        contents: &Contents,
        refuse: &dyn Fn(String) -> anyhow::Error,
    ) -> anyhow::Result<()> {
        let drive = self;
        drive.other_layouts = Recording::layout_differences(contents)?;
        for role in Role::ALL {
            let name = settings_file(*role);
            let of_another = || match contents.library.starts_with("scanloop ") {
                true => refuse(format!("{name} is missing")),
                false => refuse(format!(
                    "{name} is missing: the file of {:?} is no recording of a drive",
                    contents.library
                )),
            };
            let text = attachment(contents, &name).ok_or_else(of_another)?;
            let table: Table = text.parse().map_err(|error| refuse(format!("{name}: {error}")))?;
            drive.settings.roles.insert(*role, table);
        }
        for ((role, incarnation), attached) in
            contents.attachments.iter().filter_map(|attached| Some((process_of(&attached.name)?, attached)))
        {
            let table = toml::from_slice::<Table>(&attached.data)
                .map_err(|error| refuse(format!("{}: {error}", attached.name)))?;
            drive.settings.processes.insert(incarnation, (role, table));
        }
        let run: runtime::RunSettings = drive.settings.table(Role::Robot, "run")?;
        drive.period_ns = run.period_ns;
        drive.simulated = run.clock == runtime::ClockKind::Simulated;
        let last_scan = metadata(contents, "end", "last_scan").and_then(|scan| scan.parse().ok());
        drive.last_scan = last_scan.filter(|scan| drive.simulated && *scan > 0);
        for attached in contents.attachments.iter().filter(|attached| attached.name.starts_with("processes-"))
        {
            let processes = recorded_processes(&attached.data)
                .map_err(|error| refuse(format!("{}: {error}", attached.name)))?;
            drive.note_processes(processes);
        }
        Ok(())
    }

    /// Changes keys of the stages.
    ///
    /// # Errors
    /// What is wrong with a text that is no `ROLE.KEY=VALUE`.
    pub fn set(&mut self, texts: &[String]) -> Result<(), String> {
        self.is_changed |= !texts.is_empty();
        texts.iter().try_for_each(|text| self.settings.set(text))
    }

    /// Of these roles, those whose samples have the layouts of this program, and why the others can't be replayed.
    ///
    /// # Errors
    /// None is left: the fields that differ; exit code 2.
    pub(crate) fn replayable(
        &self,
        wanted: &[Role],
        path: &Path,
    ) -> anyhow::Result<(Vec<Role>, Vec<NotReplayed>)> {
        let (mut stages, mut others) = (Vec::new(), Vec::new());
        for role in Role::ALL.iter().filter(|role| wanted.contains(role)) {
            let needed: Vec<&str> = topics_of(*role).map(Topic::name).collect();
            let differing = self.other_layouts.iter().filter(|found| needed.contains(&found.topic.as_str()));
            let fields: Vec<String> = differing.map(ToString::to_string).collect();
            match fields.is_empty() {
                true => stages.push(*role),
                false => others.push(NotReplayed { role: role.name(), fields }),
            }
        }
        if stages.is_empty() {
            let fields: Vec<String> = self.other_layouts.iter().map(ToString::to_string).collect();
            let (path, fields) = (path.display(), fields.join("; "));
            return Err(Failure::bad_input(format!("{path}: another layout: {fields}")));
        }
        Ok((stages, others))
    }

    /// The error that something is not possible with this recording; exit code 2.
    pub(crate) fn refuse(&self, reason: &str) -> anyhow::Error {
        Failure::bad_input(format!("{}: {reason}", self.path.display()))
    }

    /// From now on, [`ReplayDrive::keep_pace`] waits for the time of each scan, counted from the scan `from`.
    pub(crate) fn set_pace(&mut self, from: Option<u64>) {
        let first = self.scans.samples.iter().find(|scan| scan.header.scan_id >= from.unwrap_or(0));
        self.pace_ns = first.map(|first| [monotonic_ns(), first.header.acquired_ns]);
    }

    /// In a replay in real time, waits until as much time has passed since the first scan as in the drive.
    pub(crate) fn keep_pace(&self, header: &Header) {
        let Some([started_ns, first_ns]) = self.pace_ns else { return };
        let due_ns = started_ns.saturating_add(header.acquired_ns.saturating_sub(first_ns));
        while let Some(left_ns) = due_ns.checked_sub(monotonic_ns()).filter(|left_ns| *left_ns > 0) {
            wait_for(&[], left_ns);
        }
    }

    /// The settings of each role.
    pub(crate) fn settings(&self) -> impl Iterator<Item = (Role, &Table)> {
        self.settings.roles.iter().map(|(role, table)| (*role, table))
    }

    /// Scans between two limits.
    pub(crate) fn scans(&self, from: Option<u64>, to: Option<u64>) -> u64 {
        let ids: BTreeSet<u64> = self.scans.samples.iter().map(|scan| scan.header.scan_id).collect();
        let wanted = from.unwrap_or(0)..=to.unwrap_or(u64::MAX);
        ids.iter().filter(|id| wanted.contains(id)).count() as u64
    }

    /// The sample that an output with this header was made from: same scan, same stamps of the role that wrote it.
    pub(crate) fn input<'a, S: Sample>(
        &self,
        lane: &'a Lane<S>,
        writer: Role,
        output: &Header,
    ) -> Option<&'a S> {
        let stamps = output.stage(writer);
        let fits = |sample: &&S| sample.header().stage(writer) == stamps;
        let found: Vec<&S> = lane.of_scan(output.scan_id).filter(fits).collect();
        // In lock-step two processes of a swap have the same stamps.
        let counts = |sample: &&&S| self.counts(writer, sample.header());
        found.iter().find(counts).or(found.first()).copied()
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether a sample of a role counts for its scan.
    pub(crate) fn counts(&self, role: Role, header: &Header) -> bool {
        let (changes, time_ns) = (&self.authority[role.index()], header.stage(role).published_ns);
        let in_force = changes.iter().rfind(|(announced_ns, _)| *announced_ns <= time_ns).or(changes.first());
        in_force.is_some_and(|(_, authority)| authority.accepts(header.incarnation, header.scan_id))
    }

    /// The sample of a scan that counts.
    pub(crate) fn counted<'a, S: Sample>(&self, lane: &'a Lane<S>, scan_id: u64) -> Option<&'a S> {
        let role = S::TOPIC.writer()?;
        lane.of_scan(scan_id).find(|sample| sample.is_answer() && self.counts(role, sample.header()))
    }

    /// The process of a role that counts for a scan: of its outputs, or of the one before where it has none.
    pub(crate) fn in_charge<S: Sample>(&self, lane: &Lane<S>, scan_id: u64) -> Option<u32> {
        let counted = |scan| self.counted(lane, scan).map(|sample| sample.header().incarnation);
        lane.scans_down_from(scan_id).find_map(counted)
    }

    /// Whether a process ran on another host than the recorder.
    pub(crate) fn is_elsewhere(&self, incarnation: u32) -> bool {
        self.clocks.is_elsewhere(incarnation)
    }

    /// Whether an injected fault has changed a sample.
    pub(crate) fn is_injected(&self, topic: Topic, header: &Header) -> bool {
        self.injected.contains(&(topic as u16, header.incarnation, header.sequence))
    }

    /// The scan since which an injected fault alters the robot, if one does in this scan.
    pub(crate) fn altered_since(&self, scan_id: u64) -> Option<u64> {
        let (since, _) = self.altered.range(..=scan_id).next_back().filter(|(_, is_altered)| **is_altered)?;
        Some(*since)
    }

    /// Whether authority over a role ever passed from one process to another while both computed.
    pub(crate) fn was_handed_over(&self, role: Role, from: u32, to: u32) -> bool {
        self.authority[role.index()]
            .iter()
            .any(|(_, change)| (change.previous, change.incarnation) == (from, to))
    }

    /// The journals of all processes.
    pub(crate) fn all_journals(&self) -> impl Iterator<Item = &Journal> {
        self.journals.values().flat_map(BTreeMap::values)
    }

    /// The journals of a process in their order.
    pub(crate) fn journals(&self, incarnation: u32) -> impl Iterator<Item = &Journal> {
        self.journals.get(&incarnation).into_iter().flat_map(BTreeMap::values)
    }

    /// The same, and whether each follows the one before, or is the first of its process. None follows the largest number.
    pub(crate) fn numbered_journals(&self, incarnation: u32) -> impl Iterator<Item = (&Journal, bool)> {
        let mut next = Some(1);
        self.journals(incarnation).map(move |journal| {
            let follows = next == Some(journal.header.sequence);
            next = journal.header.sequence.checked_add(1);
            (journal, follows)
        })
    }

    /// What a process is, if it is no implementation of this program.
    pub(crate) fn foreign(&self, incarnation: u32) -> Option<&str> {
        self.foreign.get(&incarnation).map(String::as_str)
    }

    fn note_processes(&mut self, rows: Vec<ProcessRow>) {
        const BUILT_IN: [&str; 5] = ["emulator", "ekf", "ellipses", "nmpc", "actuation"];
        for row in rows {
            self.clocks.note(&row);
            let implementation = row.entry.implementation.as_deref().unwrap_or_default();
            if row.entry.command.is_some() || !BUILT_IN.contains(&implementation) {
                self.foreign.insert(row.identity.incarnation, typed(&row.entry));
            }
        }
    }

    fn add(&mut self, topic: Topic, log_ns: u64, bytes: &[u8]) {
        match topic {
            Topic::Scan => self.scans.add(bytes),
            Topic::Odometry => self.odometries.add(bytes),
            Topic::Truth => self.truths.add(bytes),
            Topic::Pose => self.poses.add(bytes),
            Topic::Obstacles => self.obstacles.add(bytes),
            Topic::Command => self.commands.add(bytes),
            Topic::Actuation => self.actuations.add(bytes),
            Topic::Checkpoint => self.checkpoints.add(bytes),
            Topic::Directive => {
                let directive: &Directive = bytemuck::from_bytes(bytes);
                for (known, authority) in self.authority.iter_mut().zip(directive.authority) {
                    if known.last().map(|(_, newest)| newest) != Some(&authority) {
                        known.push((log_ns, authority));
                    }
                }
                // A stage takes one from the first on that orders something.
                self.has_orders |= directive.orders() != Directive::default().orders();
                if self.has_orders {
                    self.directives.add(bytes);
                }
            }
            Topic::Journal => {
                let journal: &Journal = bytemuck::from_bytes(bytes);
                let Header { incarnation, sequence, .. } = journal.header;
                let is_change = |entry: &&JournalEntry| entry.kind == JournalKind::Injected.wire() as u16;
                let changed = journal.used().iter().filter(is_change);
                self.injected.extend(changed.map(|entry| (entry.topic, entry.incarnation, entry.value)));
                let is_altered = |entry: &&JournalEntry| entry.kind == JournalKind::Altered.wire() as u16;
                let altered = journal.used().iter().filter(is_altered);
                self.altered.extend(altered.map(|entry| (journal.header.scan_id, entry.value == 1)));
                self.journals.entry(incarnation).or_default().insert(sequence, *journal);
            }
            Topic::Clock => self.clocks.add(bytemuck::from_bytes::<ClockOffset>(bytes)),
            Topic::Heartbeat => {}
        }
    }
}

/// Role and number of the process whose settings have this name.
fn process_of(name: &str) -> Option<(Role, u32)> {
    let (role, incarnation) = name.strip_prefix("settings-")?.strip_suffix(".toml")?.split_once('-')?;
    let found = (role.parse().ok()?, incarnation.parse().ok()?);
    (settings_of(found.0, found.1) == name).then_some(found)
}

/// An implementation, or a command as `--with` reads it.
fn typed(entry: &ProcessEntry) -> String {
    let Some(command) = &entry.command else { return entry.label() };
    let quoted =
        |word: &String| if word.contains(char::is_whitespace) { format!("\"{word}\"") } else { word.clone() };
    command.iter().map(quoted).collect::<Vec<_>>().join(" ")
}
