//! A recording read from its file: samples in the order in which they were recorded, and the files inside.

use std::collections::BTreeSet;
use std::fs::{File, Metadata};
use std::io::{self, BufReader};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use console::exit::Failure;
use console::user_file;
use runtime::OwnTopics;
use rustix::io::Errno;
use shared_types::{Difference, Field, Layouts, NotALayout, Role, TOPICS, Topic};

use crate::earlier::{self, EarlierLayout, is_earlier, widen_header};
use crate::foxglove::{CHANNELS, LOG, LogLine, log_line};
use crate::mcap::{CDR, Contents, McapReader, ReadError};
use crate::own::OwnTopic;
use crate::schema::ENCAPSULATION;
use crate::tape::PREFIX;

/// Name of the attached table of layouts.
pub(crate) const LAYOUTS: &str = runtime::LAYOUTS_FILE;
/// Name of the metadata about program, machine and run.
pub const RECORDING: &str = "recording";
/// What recordings of this program hold, and how; it changes when older programs could not read them.
pub(crate) const VERSION: &str = "1";
/// Name of the attached run: scenario, system and options.
pub const RUN: &str = "run.toml";

/// Samples are read up to so many bytes, or to [`MAX_RATIO`] times what the file takes on the disk if that is more: replays hold
/// them in memory. A recording unpacks to five times its length.
const MAX_SAMPLES: u64 = 256 << 20;
const MAX_RATIO: u64 = 32;
/// A larger attached text is none of ours [bytes]: a parser takes a hundred times as much.
const MAX_TEXT: usize = 2 << 20;
/// Lines of logs take at most so much memory [bytes]; later ones are left out.
const MAX_LINES: usize = 16 << 20;

/// Name of the attached settings of a process, if they are not those of its role at the start of the recording.
pub fn settings_of(role: Role, incarnation: u32) -> String {
    format!("settings-{role}-{incarnation}.toml")
}

/// A recording that is open for reading.
pub struct Recording {
    path: PathBuf,
    reader: McapReader<BufReader<File>>,
    /// The content of the last sample at its start: samples begin at multiples of eight bytes.
    aligned: Vec<u64>,
    /// Of each joined file, topics whose samples have another layout, once they are known.
    others: Option<Vec<BTreeSet<String>>>,
    /// Of each joined file, how samples of version 0.1 become those of today.
    earlier: Vec<Vec<EarlierLayout>>,
    /// Such a sample as it was recorded.
    recorded: Vec<u64>,
    /// Channels of joined files that only viewers read, as far as they are known.
    drawn: BTreeSet<(usize, u16)>,
    /// Lines of logs that were read, and their memory [bytes].
    lines: Vec<LogLine>,
    line_bytes: usize,
    /// It is still written.
    is_growing: bool,
}

/// A sample as it was recorded.
#[derive(Debug, Clone, Copy)]
pub struct RecordedSample<'a> {
    /// Its topic.
    pub topic: Topic,
    /// When it was recorded, on the clock of the loop [ns].
    pub log_ns: u64,
    /// Which of the joined files it is from; mostly the only one.
    pub file: usize,
    /// Where its chunk begins in the file, see [`Recording::chunk`].
    pub chunk_at: u64,
    /// The sample.
    pub bytes: &'a [u8],
}

impl Recording {
    /// Opens a recording.
    ///
    /// # Errors
    /// A file that can't be read or is no recording of this program; exit code 2.
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        let refuse =
            |reason: &dyn std::fmt::Display| Failure::bad_input(format!("{}: {reason}", path.display()));
        let file = user_file::open(path).map_err(|error| refuse(&error))?;
        if file.metadata().is_ok_and(|metadata| metadata.len() == 0) {
            return Err(refuse(&"the file is empty"));
        }
        let reader = McapReader::new(BufReader::new(file)).map_err(|error| refusal(path, &error))?;
        Ok(Self {
            path: path.to_owned(),
            reader,
            aligned: Vec::new(),
            others: None,
            earlier: Vec::new(),
            recorded: Vec::new(),
            drawn: BTreeSet::new(),
            lines: Vec::new(),
            line_bytes: 0,
            is_growing: false,
        })
    }

    /// The same of a file that is still written: that it has no end yet is no news.
    #[must_use]
    pub fn growing(self) -> Self {
        Self { is_growing: true, ..self }
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What the file holds beside the samples; of joined files, the one that is read.
    pub fn contents(&self) -> &Contents {
        self.reader.contents()
    }

    /// The same of each of the joined files; mostly one.
    pub fn files(&self) -> &[Contents] {
        self.reader.files()
    }

    /// Hands all samples to `each`, in the order in which they were recorded; other messages and samples of another layout
    /// are left out.
    ///
    /// # Errors
    /// A damaged file, one whose samples have another size, and one that unpacks to too many; exit code 2. Errors of `each`.
    pub fn samples(
        &mut self,
        mut each: impl FnMut(&Contents, RecordedSample<'_>) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let limit = self.path.metadata().map_or(MAX_SAMPLES, |found| max_samples(&found));
        let mut bytes = 0;
        while let Some((topic, log_ns)) = self.advance(None)? {
            bytes += topic.size() as u64;
            if bytes > limit {
                return Err(Failure::bad_input(format!(
                    "{}: its samples have more than {limit} bytes; `scanloop recording cut` makes a shorter recording",
                    self.path.display()
                )));
            }
            let chunk_at = self.reader.chunk_at();
            let file = self.reader.file();
            let bytes = &bytemuck::cast_slice::<u64, u8>(&self.aligned)[..topic.size()];
            each(self.reader.contents(), RecordedSample { topic, log_ns, file, chunk_at, bytes })?;
        }
        self.require_a_second()?;
        if !self.is_growing && !self.files().iter().all(|contents| contents.is_complete) {
            let path = self.path.display();
            let text =
                format!("warning: {path}: the recording was cut off; read up to its last whole second");
            runtime::print(runtime::Priority::Warning, &text);
        }
        Ok(())
    }

    /// Hands the samples of one chunk, about a second, to `each`; [`RecordedSample::chunk_at`] named it before.
    ///
    /// # Errors
    /// A file that was damaged or replaced meanwhile.
    pub fn chunk(&mut self, chunk_at: u64, mut each: impl FnMut(RecordedSample<'_>)) -> anyhow::Result<()> {
        if !self.reader.seek_to_chunk(chunk_at) {
            let path = self.path.display();
            return Err(Failure::bad_input(format!("{path}: the file was changed while it was open")));
        }
        while let Some((topic, log_ns)) = self.advance(Some(chunk_at))? {
            let file = self.reader.file();
            let bytes = &bytemuck::cast_slice::<u64, u8>(&self.aligned)[..topic.size()];
            each(RecordedSample { topic, log_ns, file, chunk_at, bytes });
        }
        Ok(())
    }

    /// Copies the next sample to `self.aligned`; returns its topic, and when it was recorded [ns].
    ///
    /// `None` at the end, or at the end of the chunk that begins at `within`.
    fn advance(&mut self, within: Option<u64>) -> anyhow::Result<Option<(Topic, u64)>> {
        if self.others.is_none() {
            let others = self.files().iter().map(|contents| other_topics(&self.path, contents));
            self.others = Some(others.collect::<Result<_, _>>()?);
            self.earlier = self.files().iter().map(earlier_topics).collect();
        }
        loop {
            if within == Some(self.reader.chunk_at()) && self.reader.is_chunk_over() {
                return Ok(None);
            }
            let message = match self.reader.next_message() {
                Ok(Some(message)) => message,
                Ok(None) => return Ok(None),
                Err(error) => return Err(refusal(&self.path, &error)),
            };
            let (channel, log_ns) = (message.channel, message.log_ns);
            let encapsulation = message.data.get(..ENCAPSULATION.len()).unwrap_or_default();
            let is_encapsulated = encapsulation == ENCAPSULATION;
            let words = message.data.get(ENCAPSULATION.len()..).unwrap_or_default();
            let length = words.len();
            let places = length.div_ceil(8).max(self.aligned.len());
            self.aligned.resize(places, 0);
            bytemuck::cast_slice_mut::<u64, u8>(&mut self.aligned)[..length].copy_from_slice(words);
            let file = self.reader.file();
            if within.is_none() && self.drawn.contains(&(file, channel)) {
                continue;
            }
            let channels = &self.reader.contents().channels;
            let Some(known) = channels.get(&channel) else { continue };
            let name = known.topic.as_str();
            let Some(topic) = topic_of(name) else {
                if name != CHANNELS[LOG].0 {
                    self.drawn.insert((file, channel));
                } else if within.is_none() && self.line_bytes < MAX_LINES {
                    let content = &bytemuck::cast_slice::<u64, u8>(&self.aligned)[..length];
                    self.line_bytes += size_of::<LogLine>() + length;
                    self.lines.extend(log_line(log_ns, content));
                }
                continue;
            };
            if self.others.as_ref().is_some_and(|others| others[file].contains(topic.name())) {
                continue;
            }
            let refuse = |reason: String| {
                Err(Failure::bad_input(format!("{}: topic {topic}: {reason}", self.path.display())))
            };
            if known.encoding != CDR || !is_encapsulated {
                return refuse(format!(
                    "encoding {} is not supported: cdr, little endian, is",
                    known.encoding
                ));
            }
            let earlier = self.earlier[file].get(topic as usize);
            let size = earlier.map_or(topic.size(), |earlier| earlier.size);
            if length != size {
                return refuse(format!("a sample has {length} bytes instead of {size}"));
            }
            if let Some(earlier) = earlier {
                std::mem::swap(&mut self.aligned, &mut self.recorded);
                self.aligned.resize(topic.size().div_ceil(8).max(self.aligned.len()), 0);
                let recorded = &bytemuck::cast_slice::<u64, u8>(&self.recorded)[..length];
                let sample = &mut bytemuck::cast_slice_mut::<u64, u8>(&mut self.aligned)[..topic.size()];
                earlier.convert(recorded, sample);
            }
            return Ok(Some((topic, log_ns)));
        }
    }

    /// Hands the samples of topics that the system has added to `each`: name, fields, log time [ns], bytes.
    ///
    /// # Errors
    /// A damaged file; exit code 2. Errors of `each`.
    pub(crate) fn own_samples(
        &self,
        mut each: impl FnMut(&str, &'static [Field], u64, &[u8]) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let own: Vec<Vec<OwnTopic>> = self.files().iter().map(own_topics).collect();
        if own.iter().all(Vec::is_empty) {
            return Ok(());
        }
        let file = user_file::open(&self.path).map_err(|error| refusal(&self.path, &error.into()))?;
        let mut reader =
            McapReader::new(BufReader::new(file)).map_err(|error| refusal(&self.path, &error))?;
        let is_earlier: Vec<bool> =
            self.files().iter().map(|contents| !earlier_topics(contents).is_empty()).collect();
        let mut data = Vec::new();
        loop {
            let message = match reader.next_message() {
                Ok(Some(message)) => message,
                Ok(None) => return Ok(()),
                Err(error) => return Err(refusal(&self.path, &error)),
            };
            let (channel, log_ns) = (message.channel, message.log_ns);
            data.clear();
            data.extend_from_slice(message.data.get(ENCAPSULATION.len()..).unwrap_or_default());
            if is_earlier[reader.file()] {
                widen_header(&mut data);
            }
            let channel = reader.contents().channels.get(&channel);
            let name = channel.and_then(|channel| channel.topic.strip_prefix(PREFIX)).unwrap_or_default();
            let topic = own[reader.file()].iter().find(|topic| topic.name() == name);
            if let Some(topic) = topic.filter(|topic| topic.size() == data.len()) {
                each(name, topic.fields(), log_ns, &data)?;
            }
        }
    }

    /// The lines of logs that [`Recording::samples`] has passed since the last call.
    pub fn take_lines(&mut self) -> Vec<LogLine> {
        std::mem::take(&mut self.lines)
    }

    /// Its reader.
    pub(crate) fn reader(&mut self) -> &mut McapReader<BufReader<File>> {
        &mut self.reader
    }

    /// Passes when it was read and held at least one chunk.
    pub(crate) fn require_a_second(&self) -> anyhow::Result<()> {
        match self.files().iter().map(|contents| contents.chunks).sum() {
            0_u64 => Err(Failure::bad_input(format!(
                "{}: the recording holds not one whole second",
                self.path.display()
            ))),
            _ => Ok(()),
        }
    }

    /// The fields in which the layouts of its samples differ from those of this program; a topic that the recording does not
    /// know has no samples, and those of version 0.1 are read as they are today.
    ///
    /// # Errors
    /// A table of layouts that can't be read.
    pub fn layout_differences(contents: &Contents) -> Result<Vec<Difference>, NotALayout> {
        let Some(text) = attachment(contents, LAYOUTS) else { return Ok(Vec::new()) };
        let (built_in, recorded): (_, Layouts) = (Layouts::built_in(), text.parse()?);
        if is_earlier(&recorded) {
            return Ok(Vec::new());
        }
        let is_known = |topic: &&Topic| earlier::has(&recorded, **topic);
        let of_topic = |topic: &Topic| shared_types::differences(&built_in, &recorded, topic.name());
        Ok(TOPICS.iter().filter(is_known).flat_map(of_topic).collect())
    }
}

/// The topics that the recorded system has added to those of the loop.
fn own_topics(contents: &Contents) -> Vec<OwnTopic> {
    let table = attachment(contents, runtime::TOPICS_FILE).and_then(OwnTopics::recorded);
    table.as_ref().map_or_else(Vec::new, OwnTopic::all)
}

/// How its samples become those of today, by topic; empty where they are.
fn earlier_topics(contents: &Contents) -> Vec<EarlierLayout> {
    let recorded: Option<Layouts> = attachment(contents, LAYOUTS).and_then(|text| text.parse().ok());
    let recorded = recorded.filter(is_earlier);
    recorded.map_or_else(Vec::new, |recorded| TOPICS.map(|topic| EarlierLayout::new(&recorded, topic)).into())
}

/// Samples of a file are read up to so many bytes.
fn max_samples(found: &Metadata) -> u64 {
    // A hole of the file is no content.
    MAX_SAMPLES.max(MAX_RATIO.saturating_mul(found.len().min(512 * found.blocks())))
}

/// Topics whose samples have another layout.
fn other_topics(path: &Path, contents: &Contents) -> anyhow::Result<BTreeSet<String>> {
    let refuse = |reason: String| Failure::bad_input(format!("{}: {reason}", path.display()));
    let version = metadata(contents, RECORDING, "version").unwrap_or(VERSION);
    if version != VERSION {
        return Err(refuse(format!(
            "version {version} of the recording is not {VERSION}, the one that this program reads"
        )));
    }
    let found = Recording::layout_differences(contents);
    let found = found.map_err(|error| refuse(format!("{LAYOUTS}: {error}")))?;
    Ok(found.into_iter().map(|found| found.topic).collect())
}

/// The error about a file that can't be read; exit code 2, but 4 where memory does not suffice.
pub fn refusal(path: &Path, error: &ReadError) -> anyhow::Error {
    if let ReadError::Io(source) = error
        && Errno::from_io_error(source) == Some(Errno::NOMEM)
    {
        return anyhow::Error::from(io::Error::from(Errno::NOMEM)).context(path.display().to_string());
    }
    let advice = match error {
        ReadError::Damaged { .. } => {
            format!("; `scanloop recording repair {}` keeps what is readable", path.display())
        }
        // The name of a compression, or a length, may be what is damaged.
        ReadError::Unsupported { .. } | ReadError::TooLarge { .. } => {
            "; if the file is damaged, `scanloop recording repair` keeps what is readable".to_owned()
        }
        ReadError::Foreign | ReadError::Io(_) => String::new(),
    };
    Failure::bad_input(format!("{}: {error}{advice}", path.display()))
}

/// The topic of a channel; `None` for one that only viewers read.
pub(crate) fn topic_of(channel: &str) -> Option<Topic> {
    channel.strip_prefix(PREFIX)?.parse().ok()
}

/// The text of an attached file; none of those that a run attaches is larger than 2 MiB.
pub fn attachment<'a>(contents: &'a Contents, name: &str) -> Option<&'a str> {
    let found = contents.attachments.iter().find(|attachment| attachment.name == name)?;
    let data = Some(&found.data[..]).filter(|data| data.len() <= MAX_TEXT)?;
    std::str::from_utf8(data).ok()
}

/// The value of a key in the metadata of that name.
pub fn metadata<'a>(contents: &'a Contents, name: &str, key: &str) -> Option<&'a str> {
    let found = contents.metadata.iter().rfind(|metadata| metadata.name == name)?;
    found.map.iter().find(|(known, _)| known == key).map(|(_, value)| value.as_str())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mcap::Attachment;

    #[test]
    fn an_attached_text_that_is_larger_than_a_run_attaches_is_none() {
        for (length, is_read) in [(MAX_TEXT, true), (MAX_TEXT + 1, false)] {
            let (name, media_type) = ("system.toml".to_owned(), "text/plain".to_owned());
            let text = Attachment { name, media_type, log_ns: 0, data: vec![b'#'; length] };
            let contents = Contents { attachments: vec![text], ..Contents::default() };
            assert_eq!(attachment(&contents, "system.toml").is_some(), is_read, "{length}");
        }
    }

    #[test]
    fn a_hole_of_a_file_gives_it_no_more_memory() {
        let path = std::env::temp_dir().join(format!("scanloop-hole-{}.mcap", std::process::id()));
        let file = File::create(&path).unwrap();
        file.set_len(1 << 34).unwrap();
        assert_eq!(max_samples(&file.metadata().unwrap()), MAX_SAMPLES);
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn a_newer_recording_and_one_with_another_table_of_layouts_are_refused() {
        let path = std::env::temp_dir().join(format!("scanloop-read-{}.mcap", std::process::id()));
        for (version, layouts, reason) in [
            ("2", String::new(), "version 2 of the recording is not 1"),
            (VERSION, "other".to_owned(), "layouts.txt: line 1"),
            (VERSION, Layouts::built_in().to_string(), ""),
        ] {
            let mut writer = crate::tape::writer(File::create(&path).unwrap()).unwrap();
            writer.attach(LAYOUTS, "text/plain", layouts.as_bytes(), 0).unwrap();
            writer.metadata(RECORDING, &[("version".to_owned(), version.to_owned())]).unwrap();
            let sample = vec![0_u8; TOPICS[0].size()];
            writer.message(0, 1, 1, &[&ENCAPSULATION[..], &sample[..]]);
            writer.finish().unwrap();
            let mut samples = 0;
            let read = Recording::open(&path).unwrap().samples(|_, _| {
                samples += 1;
                Ok(())
            });
            match read {
                Ok(()) => assert_eq!((reason, samples), ("", 1)),
                Err(error) => assert!(!reason.is_empty() && error.to_string().contains(reason), "{error}"),
            }
        }
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn only_channels_of_the_system_are_topics() {
        assert_eq!(topic_of("/scanloop/pose"), Some(Topic::Pose));
        assert_eq!(topic_of("/foxglove/pose"), None);
    }
}
