//! Writes MCAP files.

use std::collections::BTreeMap;
use std::io::{self, Write};

use super::{Chunk, MAGIC, MAX_CHUNK, OpenChunk, Put, append, opcode};

/// The type of the messages of a channel.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Schema {
    /// Name of the type.
    pub name: String,
    /// Language of `text`.
    pub encoding: String,
    /// Its fields.
    pub text: String,
}

/// A stream of messages of one type.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Channel {
    /// Its name.
    pub topic: String,
    /// Number of its schema: the first has 1, and 0 is none.
    pub schema: u16,
    /// How its messages are encoded.
    pub encoding: String,
    /// What else is to be known about it.
    pub metadata: Vec<(String, String)>,
}

/// Encoding of the messages of this program.
pub(crate) const CDR: &str = "cdr";
/// What files of this program are to be understood as.
const PROFILE: &str = "ros2";

/// A file that is being written. Each record reaches the file whole; a chunk with [`Writer::end_chunk`].
#[derive(Debug)]
pub struct Writer<W: Write> {
    out: W,
    written: u64,
    /// Records of schemas and channels, which the summary repeats.
    definitions: [Vec<u8>; 2],
    counts: [usize; 2],
    open: OpenChunk,
    /// First and last log time.
    times: Option<[u64; 2]>,
    messages: BTreeMap<u16, u64>,
    chunks: Vec<Vec<u8>>,
    attachments: Vec<Vec<u8>>,
    metadata: Vec<Vec<u8>>,
}

impl<W: Write> Writer<W> {
    /// Begins a file with these schemas and channels; channels are known by their index.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn new(out: W, library: &str, schemas: &[Schema], channels: &[Channel]) -> io::Result<Self> {
        let mut writer = Self::empty(out, PROFILE, library)?;
        schemas.iter().for_each(|schema| _ = writer.add_schema(schema));
        channels.iter().for_each(|channel| _ = writer.add_channel(channel));
        Ok(writer)
    }

    /// Begins a file without channels.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn empty(out: W, profile: &str, library: &str) -> io::Result<Self> {
        let mut writer = Self {
            out,
            written: 0,
            definitions: [Vec::new(), Vec::new()],
            counts: [0; 2],
            open: OpenChunk::default(),
            times: None,
            messages: BTreeMap::new(),
            chunks: Vec::new(),
            attachments: Vec::new(),
            metadata: Vec::new(),
        };
        writer.put(&MAGIC)?;
        let mut header = Vec::new();
        header.text(profile).text(library);
        writer.record(opcode::HEADER, &[&header])?;
        Ok(writer)
    }

    /// Adds a schema to the open chunk and the summary; returns its number.
    pub fn add_schema(&mut self, schema: &Schema) -> u16 {
        self.counts[0] += 1;
        let number = self.counts[0] as u16;
        let mut body = Vec::new();
        body.u16(number).text(&schema.name).text(&schema.encoding).text(&schema.text);
        self.define(0, opcode::SCHEMA, &body);
        number
    }

    /// Adds a channel to the open chunk and the summary, in front of its messages; returns its number.
    pub fn add_channel(&mut self, channel: &Channel) -> u16 {
        let number = self.counts[1] as u16;
        self.counts[1] += 1;
        let mut body = Vec::new();
        body.u16(number).u16(channel.schema).text(&channel.topic).text(&channel.encoding);
        body.map(&channel.metadata);
        self.define(1, opcode::CHANNEL, &body);
        number
    }

    /// In a chunk it is compressed, and where all readers look for it.
    fn define(&mut self, group: usize, opcode: u8, body: &[u8]) {
        let mut record = Vec::new();
        append(&mut record, opcode, body);
        self.definitions[group].extend_from_slice(&record);
        self.open.begin_with(&record);
    }

    /// Bytes written until now.
    pub fn bytes(&self) -> u64 {
        self.written
    }

    /// Messages in the chunks that were written, by channel.
    pub(crate) fn messages(&self) -> &BTreeMap<u16, u64> {
        &self.messages
    }

    /// First and last log time of the same [ns].
    pub(crate) fn times(&self) -> Option<[u64; 2]> {
        self.times
    }

    /// Bytes of the open chunk, uncompressed.
    pub fn open_bytes(&self) -> usize {
        self.open.bytes()
    }

    /// Adds a file as an attachment.
    ///
    /// # Errors
    /// Those of the output.
    pub fn attach(&mut self, name: &str, media_type: &str, data: &[u8], log_ns: u64) -> io::Result<()> {
        let mut fields = Vec::new();
        fields.u64(log_ns).u64(0).text(name).text(media_type).u64(data.len() as u64);
        let mut crc = crc32fast::Hasher::new();
        [&fields, data].iter().for_each(|part| crc.update(part));
        let crc = crc.finalize().to_le_bytes();
        let (start, length) = self.record(opcode::ATTACHMENT, &[&fields, data, &crc])?;
        let mut index = Vec::new();
        index.u64(start).u64(length).u64(log_ns).u64(0).u64(data.len() as u64).text(name).text(media_type);
        self.attachments.push(index);
        Ok(())
    }

    /// Adds texts by texts, outside of the chunks.
    ///
    /// # Errors
    /// Those of the output.
    pub fn metadata(&mut self, name: &str, map: &[(String, String)]) -> io::Result<()> {
        let mut body = Vec::new();
        body.text(name).map(map);
        let (start, length) = self.record(opcode::METADATA, &[&body])?;
        let mut index = Vec::new();
        index.u64(start).u64(length).text(name);
        self.metadata.push(index);
        Ok(())
    }

    /// Adds a message of data in parts to the open chunk. A chunk holds its messages channel by channel.
    pub fn message(&mut self, channel: u16, sequence: u32, log_ns: u64, data: &[&[u8]]) {
        self.open.message(channel, sequence, [log_ns; 2], data);
    }

    /// The same with the times at which it was recorded and published [ns].
    pub fn message_of(&mut self, channel: u16, sequence: u32, times_ns: [u64; 2], data: &[u8]) {
        self.open.message(channel, sequence, times_ns, &[data]);
    }

    /// Writes the open chunk, if it has messages: they are safe from here on.
    ///
    /// # Errors
    /// Those of the output.
    pub fn end_chunk(&mut self) -> io::Result<()> {
        if self.open.bytes() > 0 {
            self.seal()?;
        }
        self.out.flush()
    }

    /// Adds a chunk that was sealed elsewhere, with messages of the channels of this file.
    ///
    /// # Errors
    /// Those of the output.
    pub fn chunk(&mut self, chunk: &Chunk) -> io::Result<()> {
        self.seal()?;
        self.put_chunk(chunk)
    }

    /// Ends the open chunk if it would be larger than any reader allows with so many more bytes.
    ///
    /// # Errors
    /// Those of the output.
    pub(crate) fn make_room(&mut self, bytes: usize) -> io::Result<()> {
        match (self.open.full_bytes() + bytes) as u64 > MAX_CHUNK {
            true => self.seal(),
            false => Ok(()),
        }
    }

    /// Writes the open chunk, also if it has definitions alone.
    fn seal(&mut self) -> io::Result<()> {
        if self.open.full_bytes() == 0 {
            return Ok(());
        }
        let chunk = self.open.seal()?;
        self.put_chunk(&chunk)
    }

    fn put_chunk(&mut self, chunk: &Chunk) -> io::Result<()> {
        let start = self.written;
        self.put(&chunk.records)?;
        let mut offsets: Vec<u8> = Vec::new();
        for (channel, place, messages) in &chunk.channels {
            offsets.u16(*channel).u64(start + place);
            *self.messages.entry(*channel).or_default() += messages;
        }
        let [first, last] = chunk.times.unwrap_or_default();
        let mut index = Vec::new();
        index
            .u64(first)
            .u64(last)
            .u64(start)
            .u64(chunk.chunk_bytes)
            .u32(offsets.len() as u32)
            .extend(&offsets);
        index.u64(chunk.records.len() as u64 - chunk.chunk_bytes).text(chunk.compression);
        index.u64(chunk.stored_bytes).u64(chunk.full_bytes);
        self.chunks.push(index);
        if chunk.times.is_some() {
            let [begin, end] = self.times.unwrap_or([first, last]);
            self.times = Some([begin.min(first), end.max(last)]);
        }
        Ok(())
    }

    /// Ends the file with its summary; returns the output and the length of the file.
    ///
    /// # Errors
    /// Those of the output.
    pub fn finish(mut self) -> io::Result<(W, u64)> {
        self.end_chunk()?;
        self.record(opcode::DATA_END, &[&0_u32.to_le_bytes()])?;
        let summary_start = self.written;
        let mut summary = Vec::new();
        let mut offsets = Vec::new();
        let mut group = |opcode: u8, records: &[u8]| {
            if !records.is_empty() {
                let mut offset = vec![opcode];
                offset.u64(summary_start + summary.len() as u64).u64(records.len() as u64);
                append(&mut offsets, opcode::SUMMARY_OFFSET, &offset);
                summary.extend_from_slice(records);
            }
        };
        group(opcode::SCHEMA, &self.definitions[0]);
        group(opcode::CHANNEL, &self.definitions[1]);
        group(opcode::STATISTICS, &self.statistics());
        let groups = [
            (opcode::CHUNK_INDEX, &self.chunks),
            (opcode::ATTACHMENT_INDEX, &self.attachments),
            (opcode::METADATA_INDEX, &self.metadata),
        ];
        for (opcode, bodies) in groups {
            let mut records = Vec::new();
            bodies.iter().for_each(|body| append(&mut records, opcode, body));
            group(opcode, &records);
        }
        let offsets_start = summary_start + summary.len() as u64;
        summary.extend(offsets);
        summary.push(opcode::FOOTER);
        summary.u64(20).u64(summary_start).u64(offsets_start);
        let crc = crc32fast::hash(&summary);
        summary.u32(crc);
        self.put(&summary)?;
        self.put(&MAGIC)?;
        self.out.flush()?;
        Ok((self.out, self.written))
    }

    fn statistics(&self) -> Vec<u8> {
        let [first, last] = self.times.unwrap_or_default();
        let mut body = Vec::new();
        body.u64(self.messages.values().sum()).u16(self.counts[0] as u16).u32(self.counts[1] as u32);
        body.u32(self.attachments.len() as u32).u32(self.metadata.len() as u32);
        body.u32(self.chunks.len() as u32).u64(first).u64(last).u32(10 * self.messages.len() as u32);
        self.messages.iter().for_each(|(channel, count)| _ = body.u16(*channel).u64(*count));
        let mut record = Vec::new();
        append(&mut record, opcode::STATISTICS, &body);
        record
    }

    /// Writes a record of fields in parts; returns where it begins and its whole length.
    fn record(&mut self, opcode: u8, body: &[&[u8]]) -> io::Result<(u64, u64)> {
        let start = self.written;
        let mut head = vec![opcode];
        head.u64(body.iter().map(|part| part.len() as u64).sum());
        self.put(&head)?;
        body.iter().try_for_each(|part| self.put(part))?;
        Ok((start, self.written - start))
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.written += bytes.len() as u64;
        Ok(())
    }
}
