//! A recording that is made of messages of others.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, BufWriter, IntoInnerError};
use std::ops::Range;
use std::sync::Arc;

use console::new_file::NewFile;

use super::copied::missing;
use super::{Axis, Copied, Missing, REPAIRED, Summary, is_loss, is_one_run};
use crate::mcap::{CDR, Channel, Contents, MAX_TEXT, MESSAGE_BYTES, McapReader, Schema, Writer};
use crate::ros2;
use crate::tape::PREFIX;

/// Chunks end with this many bytes.
const CHUNK_BYTES: usize = 1 << 18;
/// A new file names so many damaged places of the old one.
const MAX_LINES: usize = 1000;
/// A definition has at most so many bytes, with the head of its record.
const DEFINITION_BYTES: usize = 9 + MAX_TEXT as usize;
/// A new recording.
pub(super) struct NewRecording {
    writer: Writer<BufWriter<NewFile>>,
    /// The joined file with which it begins, and those whose attachments it has.
    pub(super) file: usize,
    taken: usize,
    /// Numbers in the new file, of schemas and channels by their definition. Schemas are shared with the input: a single one
    /// may have megabytes.
    schemas: BTreeMap<Arc<Schema>, u16>,
    known: BTreeMap<Channel, u16>,
    /// The same of channels by joined file and number.
    channels: BTreeMap<(usize, u16), u16>,
    /// Numbers of the channels of [`ros2::topics`], if they are added, and the limits of the scanner [m].
    ros2: Option<([u16; 2], [f32; 2])>,
}

impl NewRecording {
    /// Begins a new file with the attachments of a joined one; see [`super::prepare`] for `adds_ros2`.
    pub(super) fn begin(
        output: NewFile,
        files: &[Contents],
        file: usize,
        adds_ros2: bool,
    ) -> anyhow::Result<Self> {
        let Contents { profile, library, .. } = &files[file];
        let writer = Writer::empty(BufWriter::new(output), profile, library)?;
        let (schemas, known, channels) = Default::default();
        let mut copy = Self { writer, file, taken: file, schemas, known, channels, ros2: None };
        copy.attach(&files[file], None)?;
        // Also those without messages.
        for channel in files[file].channels.keys() {
            copy.define(&files[file], (file, *channel))?;
        }
        // A bag that was exported before has them.
        let is_taken =
            |name: &str| files.iter().any(|contents| contents.channels.values().any(|of| of.topic == name));
        if adds_ros2 && !ros2::topics().iter().any(|(name, _)| is_taken(name)) {
            let numbers = ros2::topics().map(|(topic, schema)| {
                let number = copy.writer.add_schema(&schema);
                copy.schemas.insert(Arc::new(schema), number);
                let (topic, encoding) = (topic.to_owned(), CDR.to_owned());
                let channel = Channel { topic, schema: number, encoding, metadata: Vec::new() };
                let number = copy.writer.add_channel(&channel);
                copy.known.insert(channel, number);
                number
            });
            copy.ros2 = Some((numbers, ros2::limits_m(&files[file])));
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

    /// Adds a message, and what is made of it for ROS 2; returns how many were added.
    pub(super) fn message(
        &mut self,
        contents: &Contents,
        file: usize,
        channel: u16,
        sequence: u32,
        times_ns: [u64; 2],
        data: &[u8],
    ) -> anyhow::Result<u64> {
        let number = match self.channels.get(&(file, channel)) {
            Some(number) => *number,
            None => self.define(contents, (file, channel))?,
        };
        self.put(number, sequence, times_ns, data)?;
        let Some((numbers, limits_m)) = self.ros2 else { return Ok(1) };
        let topic = &contents.channels[&channel].topic;
        let Some((index, data)) = ros2::message(topic, data, limits_m) else { return Ok(1) };
        self.put(numbers[index], sequence, times_ns, &data)?;
        Ok(2)
    }

    fn put(&mut self, number: u16, sequence: u32, times_ns: [u64; 2], data: &[u8]) -> std::io::Result<()> {
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

    /// Ends the file with what later joined files of its run have attached, and with what is missing of the joined files `of`
    /// which it is.
    pub(super) fn finish(
        mut self,
        reader: &McapReader<BufReader<File>>,
        of: Range<usize>,
        axis: &Axis,
        copied: &mut Copied,
    ) -> anyhow::Result<NewFile> {
        let files = reader.files();
        for file in self.file + 1..files.len() {
            if is_one_run(files, self.file, file) {
                self.attach(&files[file], Some(&files[self.taken]))?;
                self.taken = file;
            }
        }
        if reader.is_salvage() {
            self.tell_missing(reader, of, axis)?;
        }
        self.writer.end_chunk()?;
        copied.summaries.push(self.summary());
        let (output, bytes) = self.writer.finish()?;
        copied.bytes += bytes;
        Ok(output.into_inner().map_err(IntoInnerError::into_error)?)
    }

    /// Adds what is missing of the joined files from which it is.
    fn tell_missing(
        &mut self,
        reader: &McapReader<BufReader<File>>,
        of: Range<usize>,
        axis: &Axis,
    ) -> std::io::Result<()> {
        let gaps = reader.gaps().iter().filter(|gap| of.contains(&gap.file));
        let gaps: Vec<Missing> = gaps.map(|gap| axis.missing(*gap)).collect();
        let messages = reader.missing(of.clone(), |_| true);
        let attachments = reader.missing_attachments(of.clone());
        if !is_loss(&gaps, messages, attachments) {
            return Ok(());
        }
        let lost = reader.missing(of, |topic| topic.starts_with(PREFIX));
        let lost = lost.map_or("unknown".to_owned(), |lost| lost.to_string());
        let mut lines = missing(&gaps[..gaps.len().min(MAX_LINES)], messages, attachments);
        if gaps.len() > MAX_LINES {
            lines.push(format!("{} more places", gaps.len() - MAX_LINES));
        }
        let texts = [("lost", lost), ("missing", lines.join("; "))];
        self.writer.metadata(REPAIRED, &texts.map(|(key, text)| (key.to_owned(), text)))
    }

    /// What was written.
    fn summary(&self) -> Summary {
        let counts = self.writer.messages();
        let kinds: BTreeMap<u16, &str> =
            self.schemas.iter().map(|(schema, number)| (*number, schema.name.as_str())).collect();
        let mut topics = BTreeMap::<String, (String, u64)>::new();
        for (channel, number) in &self.known {
            let kind = kinds.get(&channel.schema).copied().unwrap_or_default();
            let (_, count) = topics.entry(channel.topic.clone()).or_insert((kind.to_owned(), 0));
            *count += counts.get(number).copied().unwrap_or_default();
        }
        let times_ns = self.writer.times().unwrap_or_default();
        Summary { times_ns, messages: counts.values().sum(), topics }
    }
}
