//! Parts of a recording as new recordings: what can be read of a damaged one, or some seconds of it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, BufWriter, IntoInnerError};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use console::exit::Failure;
use console::new_file::{Existing, NewFile};

use crate::mcap::{Channel, Contents, Gap, MAX_TEXT, MESSAGE_BYTES, Reader, Schema, Writer};
use crate::read::{RECORDING, metadata, refusal};
use crate::tape::{LIBRARY, PREFIX, definitions};

/// Chunks end with this many bytes.
const CHUNK_BYTES: usize = 1 << 18;
/// A definition has at most so many bytes, with the head of its record.
const DEFINITION_BYTES: usize = 9 + MAX_TEXT as usize;
/// Name of the metadata about what a repair could not read.
pub(crate) const REPAIRED: &str = "repaired";
/// Between the last message of a recording and the first of one that is joined to it [ns].
const JOINT_NS: u64 = 1_000_000;

/// What was copied.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Copied {
    /// The new files: one for each run.
    pub files: Vec<PathBuf>,
    /// Messages in them.
    pub messages: u64,
    /// Their length [bytes].
    pub bytes: u64,
    /// Damaged places, and what is missing there.
    pub gaps: Vec<Missing>,
    /// Attached files and texts that could not be read; `None` when that is not known.
    pub missing_attachments: Option<u64>,
    /// Whether something of the drive, or of what is attached, is missing.
    pub is_loss: bool,
}

/// What is missing at a damaged place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Missing {
    /// The place.
    pub gap: Gap,
    /// Time of the last message before it, counted from the first of the recording [s]; `None` if that is not known.
    pub from_s: Option<f64>,
    /// Time of the first one behind it [s]; `None` when nothing follows and the end is not known.
    pub to_s: Option<f64>,
}

impl std::fmt::Display for Missing {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { gap, from_s, to_s } = self;
        write!(formatter, "byte {}, {}: ", gap.at, gap.what)?;
        if !gap.is_data {
            return write!(formatter, "nothing of the drive");
        }
        match (from_s, to_s) {
            (Some(from_s), Some(to_s)) => {
                write!(formatter, "up to {:.2} s, between {from_s:.2} s and {to_s:.2} s", to_s - from_s)
            }
            (Some(from_s), None) => write!(formatter, "what followed {from_s:.2} s"),
            (None, _) => write!(formatter, "what came before the first message that is left"),
        }
    }
}

/// Makes a new recording of all that can be read of `from`.
///
/// # Errors
/// A file of which nothing can be read, and a new file that can't be written; exit code 2.
pub fn repair(from: &Path, to: &Path, force: bool) -> anyhow::Result<Copied> {
    let input = File::open(from).map_err(|error| refuse(from, &error))?;
    let mut reader = Reader::salvage(BufReader::new(input)).map_err(|error| refusal(from, &error))?;
    if reader.contents().library.is_empty() || reader.contents().library == LIBRARY {
        let (schemas, channels) = definitions();
        reader.assume(&schemas, &channels);
    }
    write(reader, from, to, force, 0..=u64::MAX)
}

/// Copies the messages of `from` that were recorded in `times` [ns] since its first, with all attachments.
///
/// # Errors
/// A file that can't be read, one without a message in that time, and a new file that can't be written; exit code 2.
pub fn copy(from: &Path, to: &Path, force: bool, times: RangeInclusive<u64>) -> anyhow::Result<Copied> {
    // What is damaged is found before anything is written.
    read(open(from)?, from)?;
    write(open(from)?, from, to, force, times)
}

/// Passes when all of a file can be read; its memory is free afterwards.
fn read(mut reader: Reader<BufReader<File>>, path: &Path) -> anyhow::Result<()> {
    while reader.next_message().map_err(|error| refusal(path, &error))?.is_some() {}
    Ok(())
}

fn open(path: &Path) -> anyhow::Result<Reader<BufReader<File>>> {
    let input = File::open(path).map_err(|error| refuse(path, &error))?;
    Reader::new(BufReader::new(input)).map_err(|error| refusal(path, &error))
}

fn refuse(path: &Path, reason: &dyn std::fmt::Display) -> anyhow::Error {
    Failure::bad_input(format!("{}: {reason}", path.display()))
}

fn write(
    mut reader: Reader<BufReader<File>>,
    from: &Path,
    to: &Path,
    force: bool,
    times: RangeInclusive<u64>,
) -> anyhow::Result<Copied> {
    let mut copied = Copied::default();
    let mut copy: Option<NewRecording> = None;
    let mut axis = Axis { start_ns: start_ns(reader.contents()), ..Axis::default() };
    let mut data = Vec::new();
    loop {
        let message = match reader.next_message() {
            Ok(Some(message)) => message,
            Ok(None) => break,
            Err(error) => return Err(refusal(from, &error)),
        };
        let (channel, sequence, times_ns) =
            (message.channel, message.sequence, [message.log_ns, message.publish_ns]);
        data.clear();
        data.extend_from_slice(message.data);
        if !times.contains(&axis.since_start_ns(reader.file(), times_ns[0])) {
            continue;
        }
        let file = reader.file();
        if copy.as_ref().is_none_or(|copy| !is_one_run(reader.files(), copy.file, file)) {
            if let Some(copy) = copy.take() {
                copy.finish(&reader, &mut copied)?;
            }
            let path = numbered(to, copied.files.len() + 1);
            let output = NewFile::create(&path, Existing::forced(force), &[from])?;
            copied.files.push(path);
            copy = Some(NewRecording::begin(output, reader.files(), file)?);
        }
        if let Some(copy) = &mut copy {
            copy.message(reader.contents(), file, channel, sequence, times_ns, &data)?;
            copied.messages += 1;
        }
    }
    copied.gaps = reader.gaps().iter().map(|gap| axis.missing(*gap)).collect();
    copied.missing_attachments = reader.missing_attachments();
    let is_all = reader.missing(|_| true) == Some(0) && copied.missing_attachments == Some(0);
    copied.is_loss = copied.gaps.iter().any(|missing| missing.gap.is_data) && !is_all;
    match copy {
        Some(copy) => copy.finish(&reader, &mut copied)?,
        None => return Err(refuse(from, &"no whole second of this time is in the recording")),
    }
    Ok(copied)
}

/// The time of the first message by the summary, if there is one [ns].
fn start_ns(contents: &Contents) -> Option<u64> {
    let counted = contents.statistics.as_ref().filter(|counted| counted.messages > 0);
    counted.map(|counted| counted.times[0])
}

/// The path of one of several new files: `new.mcap`, `new-2.mcap`.
fn numbered(path: &Path, number: usize) -> PathBuf {
    if number == 1 {
        return path.to_owned();
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map_or(String::new(), |name| format!(".{}", name.to_string_lossy()));
    path.with_file_name(format!("{stem}-{number}{extension}"))
}

/// Whether two of the joined files are of one run, so that they can be one file.
fn is_one_run(files: &[Contents], one: usize, other: usize) -> bool {
    let run = |file: usize| metadata(&files[file], RECORDING, "run_id");
    one == other || run(one) == run(other)
}

/// Times of joined files on one axis: one that does not follow in time is set behind the one before.
#[derive(Debug, Default)]
struct Axis {
    /// The first message of all [ns].
    start_ns: Option<u64>,
    newest_ns: u64,
    file: usize,
    /// Added to the times of the file that is read [ns].
    shift_ns: u64,
}

impl Axis {
    fn since_start_ns(&mut self, file: usize, log_ns: u64) -> u64 {
        if file != self.file {
            self.file = file;
            self.shift_ns = (self.newest_ns + JOINT_NS).saturating_sub(log_ns);
        }
        let start_ns = *self.start_ns.get_or_insert(log_ns);
        let time_ns = log_ns + self.shift_ns;
        self.newest_ns = self.newest_ns.max(time_ns);
        time_ns.saturating_sub(start_ns)
    }

    fn missing(&self, gap: Gap) -> Missing {
        let start_ns = self.start_ns.unwrap_or_default();
        let since_s = |time_ns: u64| time_ns.saturating_sub(start_ns) as f64 * 1e-9;
        Missing { gap, from_s: gap.from_ns.map(since_s), to_s: gap.to_ns.map(since_s) }
    }
}

/// A new file.
struct NewRecording {
    writer: Writer<BufWriter<NewFile>>,
    /// The joined file with which it begins, and those whose attachments it has.
    file: usize,
    taken: usize,
    /// Numbers in the new file, of schemas and channels by their definition. Schemas are shared with the input: a single one
    /// may have megabytes.
    schemas: BTreeMap<Arc<Schema>, u16>,
    known: BTreeMap<Channel, u16>,
    /// The same of channels by joined file and number.
    channels: BTreeMap<(usize, u16), u16>,
}

impl NewRecording {
    /// Begins a new file with the attachments of a joined one.
    fn begin(output: NewFile, files: &[Contents], file: usize) -> anyhow::Result<Self> {
        let Contents { profile, library, .. } = &files[file];
        let writer = Writer::empty(BufWriter::new(output), profile, library)?;
        let (schemas, known, channels) = Default::default();
        let mut copy = Self { writer, file, taken: file, schemas, known, channels };
        copy.attach(&files[file], None)?;
        // Also those without messages.
        for channel in files[file].channels.keys() {
            copy.define(&files[file], (file, *channel))?;
        }
        Ok(copy)
    }

    /// Adds attachments and texts, but those which an earlier file of the same run had.
    fn attach(&mut self, contents: &Contents, before: Option<&Contents>) -> anyhow::Result<()> {
        for attached in &contents.attachments {
            if before.is_none_or(|before| !before.attachments.iter().any(|old| old.data == attached.data)) {
                let (name, log_ns) = (&attached.name, attached.log_ns);
                self.writer.attach(name, &attached.media_type, &attached.data, log_ns)?;
            }
        }
        for text in &contents.metadata {
            if before.is_none_or(|before| !before.metadata.contains(text)) {
                self.writer.metadata(&text.name, &text.map)?;
            }
        }
        Ok(())
    }

    fn message(
        &mut self,
        contents: &Contents,
        file: usize,
        channel: u16,
        sequence: u32,
        times_ns: [u64; 2],
        data: &[u8],
    ) -> anyhow::Result<()> {
        let number = match self.channels.get(&(file, channel)) {
            Some(number) => *number,
            None => self.define(contents, (file, channel))?,
        };
        self.writer.make_room(MESSAGE_BYTES + data.len())?;
        self.writer.message_of(number, sequence, times_ns, data);
        if self.writer.open_bytes() >= CHUNK_BYTES {
            self.writer.end_chunk()?;
        }
        Ok(())
    }

    /// Defines a channel in the new file, or finds the same one.
    fn define(&mut self, contents: &Contents, of: (usize, u16)) -> std::io::Result<u16> {
        let channel = contents.channels[&of.1].clone();
        let schema = match contents.schemas.get(&channel.schema) {
            None => 0,
            Some(schema) => match self.schemas.get(schema) {
                Some(number) => *number,
                None => {
                    self.writer.make_room(DEFINITION_BYTES)?;
                    let number = self.writer.add_schema(schema);
                    self.schemas.insert(schema.clone(), number);
                    number
                }
            },
        };
        let channel = Channel { schema, ..channel };
        let number = match self.known.get(&channel) {
            Some(number) => *number,
            None => {
                self.writer.make_room(DEFINITION_BYTES)?;
                let number = self.writer.add_channel(&channel);
                self.known.insert(channel, number);
                number
            }
        };
        self.channels.insert(of, number);
        Ok(number)
    }

    /// Ends the file with what later joined files of its run have attached, and with what is missing.
    fn finish(mut self, reader: &Reader<BufReader<File>>, copied: &mut Copied) -> anyhow::Result<()> {
        let files = reader.files();
        for file in self.file + 1..files.len() {
            if is_one_run(files, self.file, file) {
                self.attach(&files[file], Some(&files[self.taken]))?;
                self.taken = file;
            }
        }
        if !copied.gaps.is_empty() && copied.is_loss {
            let lost = reader.missing(|topic| topic.starts_with(PREFIX));
            let gaps: Vec<String> = copied.gaps.iter().map(ToString::to_string).collect();
            let lost = lost.map_or("unknown".to_owned(), |lost| lost.to_string());
            let texts = [("lost", lost), ("missing", gaps.join("; "))];
            self.writer.metadata(REPAIRED, &texts.map(|(key, text)| (key.to_owned(), text)))?;
        }
        let (output, bytes) = self.writer.finish()?;
        copied.bytes += bytes;
        output.into_inner().map_err(IntoInnerError::into_error)?.finish()
    }
}

#[cfg(test)]
mod tests;
