//! A recording read from its file: samples in the order in which they were recorded, and the files inside.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use console::exit::Failure;
use shared_types::{Difference, Layouts, NotALayout, TOPICS, Topic};

use crate::foxglove::{CHANNELS, LOG, LogLine, log_line};
use crate::mcap::{Contents, ReadError, Reader};
use crate::schema::ENCAPSULATION;
use crate::tape::PREFIX;

/// Name of the attached table of layouts.
pub(crate) const LAYOUTS: &str = runtime::LAYOUTS_FILE;
/// Name of the metadata about program, machine and run.
pub(crate) const RECORDING: &str = "recording";
/// What recordings of this program hold, and how; it changes when older programs could not read them.
pub(crate) const VERSION: &str = "1";
/// Name of the attached run: scenario, system and options.
pub const RUN: &str = "run.toml";

/// A recording that is open for reading.
pub struct Recording {
    path: PathBuf,
    reader: Reader<BufReader<File>>,
    /// The content of the last sample at its start: samples begin at multiples of eight bytes.
    aligned: Vec<u64>,
    /// Topics whose samples have another layout, once they are known.
    others: Option<BTreeSet<String>>,
    /// Channels that only viewers read, as far as they are known.
    drawn: BTreeSet<u16>,
    /// Lines of logs that were read.
    lines: Vec<LogLine>,
}

/// A sample as it was recorded.
#[derive(Debug, Clone, Copy)]
pub struct Recorded<'a> {
    /// Its topic.
    pub topic: Topic,
    /// When it was recorded, on the clock of the loop [ns].
    pub log_ns: u64,
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
        let file = File::open(path).map_err(|error| refuse(&error))?;
        if file.metadata().is_ok_and(|metadata| metadata.len() == 0) {
            return Err(refuse(&"the file is empty"));
        }
        let reader = Reader::new(BufReader::with_capacity(1 << 18, file)).map_err(|error| refuse(&error))?;
        Ok(Self {
            path: path.to_owned(),
            reader,
            aligned: Vec::new(),
            others: None,
            drawn: BTreeSet::new(),
            lines: Vec::new(),
        })
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What was read beside the samples until now.
    pub fn contents(&self) -> &Contents {
        self.reader.contents()
    }

    /// Hands all samples to `each`, in the order in which they were recorded; other messages and samples of another layout
    /// are left out.
    ///
    /// # Errors
    /// A damaged file, or one whose samples have another size; exit code 2. Errors of `each`.
    pub fn samples(
        &mut self,
        mut each: impl FnMut(&Contents, Recorded<'_>) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        while let Some((topic, log_ns)) = self.advance(None)? {
            let chunk_at = self.reader.chunk_at();
            let bytes = &bytemuck::cast_slice::<u64, u8>(&self.aligned)[..topic.size()];
            each(self.reader.contents(), Recorded { topic, log_ns, chunk_at, bytes })?;
        }
        self.require_a_second()?;
        if !self.contents().is_complete {
            let path = self.path.display();
            let text =
                format!("warning: {path}: the recording was cut off; read up to its last whole second");
            runtime::print(runtime::Priority::Warning, &text);
        }
        Ok(())
    }

    /// Hands the samples of one chunk, about a second, to `each`; [`Recorded::chunk_at`] named it before.
    ///
    /// # Errors
    /// A file that was damaged or replaced meanwhile.
    pub fn chunk(&mut self, chunk_at: u64, mut each: impl FnMut(Recorded<'_>)) -> anyhow::Result<()> {
        self.reader.seek_to_chunk(chunk_at)?;
        while let Some((topic, log_ns)) = self.advance(Some(chunk_at))? {
            let bytes = &bytemuck::cast_slice::<u64, u8>(&self.aligned)[..topic.size()];
            each(Recorded { topic, log_ns, chunk_at, bytes });
        }
        Ok(())
    }

    /// Copies the next sample to `self.aligned`; returns its topic, and when it was recorded [ns].
    ///
    /// `None` at the end, or at the end of the chunk that begins at `within`.
    fn advance(&mut self, within: Option<u64>) -> anyhow::Result<Option<(Topic, u64)>> {
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
            if within.is_none() && self.drawn.contains(&channel) {
                continue;
            }
            let words = message.data.get(ENCAPSULATION.len()..).unwrap_or_default();
            let length = words.len();
            let places = length.div_ceil(8).max(self.aligned.len());
            self.aligned.resize(places, 0);
            bytemuck::cast_slice_mut::<u64, u8>(&mut self.aligned)[..length].copy_from_slice(words);
            if self.others.is_none() {
                self.others = Some(self.other_topics()?);
            }
            if within.is_some_and(|at| at != self.reader.chunk_at()) {
                let path = self.path.display();
                return Err(Failure::bad_input(format!("{path}: the file was changed while it was open")));
            }
            let channels = &self.reader.contents().channels;
            let name = channels.get(&channel).map_or("", |channel| channel.topic.as_str());
            let Some(topic) = topic_of(name) else {
                if name != CHANNELS[LOG].0 {
                    self.drawn.insert(channel);
                } else if within.is_none() {
                    let content = &bytemuck::cast_slice::<u64, u8>(&self.aligned)[..length];
                    self.lines.extend(log_line(log_ns, content));
                }
                continue;
            };
            if self.others.as_ref().is_some_and(|others| others.contains(topic.name())) {
                continue;
            }
            if length != topic.size() {
                let (path, size) = (self.path.display(), topic.size());
                return Err(Failure::bad_input(format!(
                    "{path}: topic {topic}: a sample has {length} bytes instead of {size}"
                )));
            }
            return Ok(Some((topic, log_ns)));
        }
    }

    /// The lines of logs that [`Recording::samples`] has passed since the last call.
    pub fn take_lines(&mut self) -> Vec<LogLine> {
        std::mem::take(&mut self.lines)
    }

    /// Its reader.
    pub(crate) fn reader(&mut self) -> &mut Reader<BufReader<File>> {
        &mut self.reader
    }

    /// Passes when it was read and held at least one chunk.
    pub(crate) fn require_a_second(&self) -> anyhow::Result<()> {
        match self.contents().chunks {
            0 => Err(Failure::bad_input(format!(
                "{}: the recording holds not one whole second",
                self.path.display()
            ))),
            _ => Ok(()),
        }
    }

    /// The fields in which the layouts of its samples differ from those of this program; a topic that the recording does not
    /// know has no samples.
    ///
    /// # Errors
    /// A table of layouts that can't be read.
    pub fn layout_differences(contents: &Contents) -> Result<Vec<Difference>, NotALayout> {
        let Some(text) = attachment(contents, LAYOUTS) else { return Ok(Vec::new()) };
        let (built_in, recorded): (_, Layouts) = (Layouts::built_in(), text.parse()?);
        let is_known = |topic: &&Topic| recorded.rows.iter().any(|row| row.topic == topic.name());
        let of_topic = |topic: &Topic| shared_types::differences(&built_in, &recorded, topic.name());
        Ok(TOPICS.iter().filter(is_known).flat_map(of_topic).collect())
    }

    /// Topics whose samples have another layout.
    fn other_topics(&self) -> anyhow::Result<BTreeSet<String>> {
        let refuse = |reason: String| Failure::bad_input(format!("{}: {reason}", self.path.display()));
        let version = metadata(self.contents(), RECORDING, "version").unwrap_or(VERSION);
        if version != VERSION {
            return Err(refuse(format!(
                "version {version} of the recording is not {VERSION}, the one that this program reads"
            )));
        }
        let found = Self::layout_differences(self.contents());
        let found = found.map_err(|error| refuse(format!("{LAYOUTS}: {error}")))?;
        Ok(found.into_iter().map(|found| found.topic).collect())
    }
}

/// The error about a file that can't be read.
pub(crate) fn refusal(path: &Path, error: &ReadError) -> anyhow::Error {
    Failure::bad_input(format!("{}: {error}", path.display()))
}

/// The topic of a channel; `None` for one that only viewers read.
pub(crate) fn topic_of(channel: &str) -> Option<Topic> {
    channel.strip_prefix(PREFIX)?.parse().ok()
}

/// The text of an attached file.
pub fn attachment<'a>(contents: &'a Contents, name: &str) -> Option<&'a str> {
    let found = contents.attachments.iter().find(|attachment| attachment.name == name)?;
    std::str::from_utf8(&found.data).ok()
}

/// The value of a key in the metadata of that name.
pub fn metadata<'a>(contents: &'a Contents, name: &str, key: &str) -> Option<&'a str> {
    let found = contents.metadata.iter().rfind(|metadata| metadata.name == name)?;
    found.map.iter().find(|(known, _)| known == key).map(|(_, value)| value.as_str())
}

#[cfg(test)]
mod tests {
    use super::*;

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
