//! Writes MCAP files.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::ops::Range;

use lz4_flex::frame::FrameEncoder;

use super::{MAGIC, Put, opcode};

/// The type of the messages of a channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Schema {
    /// Name of the type.
    pub name: String,
    /// Language of `text`.
    pub encoding: String,
    /// Its fields.
    pub text: String,
}

/// A stream of messages of one type, encoded as CDR.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Its name.
    pub topic: String,
    /// Index of its schema.
    pub schema: u16,
    /// What else is to be known about it.
    pub metadata: Vec<(String, String)>,
}

/// Encoding of all messages.
const MESSAGE_ENCODING: &str = "cdr";

/// A file that is being written. Each record reaches the file whole; a chunk with [`Writer::end_chunk`].
#[derive(Debug)]
pub struct Writer<W: Write> {
    out: W,
    written: u64,
    /// Records of schemas and channels, which the summary repeats.
    definitions: [Vec<u8>; 2],
    counts: [usize; 2],
    chunk: Vec<u8>,
    compressed: Vec<u8>,
    record: Vec<u8>,
    /// Time range of the open chunk, and of all before.
    times: [Option<[u64; 2]>; 2],
    /// Per channel: log time, and place of each message in the open chunk.
    index: BTreeMap<u16, Vec<(u64, Range<usize>)>>,
    /// The open chunk channel by channel, which compresses better.
    sorted: Vec<u8>,
    messages: BTreeMap<u16, u64>,
    chunks: Vec<Vec<u8>>,
    attachments: Vec<Vec<u8>>,
    metadata: Vec<Vec<u8>>,
}

impl<W: Write> Writer<W> {
    /// Begins a file with these schemas and channels, which are known by their index.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn new(out: W, library: &str, schemas: &[Schema], channels: &[Channel]) -> io::Result<Self> {
        let mut writer = Self {
            out,
            written: 0,
            definitions: [Vec::new(), Vec::new()],
            counts: [schemas.len(), channels.len()],
            chunk: Vec::new(),
            compressed: Vec::new(),
            sorted: Vec::new(),
            record: Vec::new(),
            times: [None; 2],
            index: BTreeMap::new(),
            messages: BTreeMap::new(),
            chunks: Vec::new(),
            attachments: Vec::new(),
            metadata: Vec::new(),
        };
        writer.put(&MAGIC)?;
        let mut header = Vec::new();
        header.text("ros2").text(library);
        writer.record(opcode::HEADER, &header)?;
        for (index, schema) in schemas.iter().enumerate() {
            let mut body = Vec::new();
            // Number 0 means that there is no schema.
            body.u16(index as u16 + 1).text(&schema.name).text(&schema.encoding).text(&schema.text);
            append(&mut writer.definitions[0], opcode::SCHEMA, &body);
        }
        for (index, channel) in channels.iter().enumerate() {
            let mut body = Vec::new();
            body.u16(index as u16).u16(channel.schema + 1).text(&channel.topic).text(MESSAGE_ENCODING);
            body.map(&channel.metadata);
            append(&mut writer.definitions[1], opcode::CHANNEL, &body);
        }
        // In the first chunk too: some readers look for them only there.
        let definitions = writer.definitions.concat();
        writer.put(&definitions)?;
        writer.sorted = definitions;
        Ok(writer)
    }

    /// Bytes written until now.
    pub fn bytes(&self) -> u64 {
        self.written
    }

    /// Bytes of the open chunk, uncompressed.
    pub fn open_bytes(&self) -> usize {
        self.chunk.len()
    }

    /// Adds a file as an attachment.
    ///
    /// # Errors
    /// Those of the output.
    pub fn attach(&mut self, name: &str, media_type: &str, data: &[u8], log_ns: u64) -> io::Result<()> {
        let mut body = Vec::new();
        body.u64(log_ns).u64(0).text(name).text(media_type).u64(data.len() as u64).extend(data);
        let crc = crc32fast::hash(&body);
        body.u32(crc);
        let (start, length) = self.record(opcode::ATTACHMENT, &body)?;
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
        let (start, length) = self.record(opcode::METADATA, &body)?;
        let mut index = Vec::new();
        index.u64(start).u64(length).text(name);
        self.metadata.push(index);
        Ok(())
    }

    /// Adds a message to the open chunk. A chunk holds its messages channel by channel.
    ///
    /// # Errors
    /// None today; an output may have some.
    pub fn message(&mut self, channel: u16, sequence: u32, log_ns: u64, data: &[u8]) -> io::Result<()> {
        self.message_parts(channel, sequence, log_ns, &[data])
    }

    /// [`Writer::message`] of data in parts.
    ///
    /// # Errors
    /// As [`Writer::message`].
    pub fn message_parts(
        &mut self,
        channel: u16,
        sequence: u32,
        log_ns: u64,
        data: &[&[u8]],
    ) -> io::Result<()> {
        let place = self.chunk.len();
        let length = 22 + data.iter().map(|part| part.len() as u64).sum::<u64>();
        self.chunk.push(opcode::MESSAGE);
        self.chunk.u64(length).u16(channel).u32(sequence).u64(log_ns).u64(log_ns);
        data.iter().for_each(|part| self.chunk.extend_from_slice(part));
        for times in &mut self.times {
            let [first, last] = times.unwrap_or([log_ns; 2]);
            *times = Some([first.min(log_ns), last.max(log_ns)]);
        }
        self.index.entry(channel).or_default().push((log_ns, place..self.chunk.len()));
        *self.messages.entry(channel).or_default() += 1;
        Ok(())
    }

    /// Writes the open chunk, if it has messages: they are safe from here on.
    ///
    /// # Errors
    /// Those of the output.
    pub fn end_chunk(&mut self) -> io::Result<()> {
        let Some([first, last]) = self.times[0].take() else { return Ok(()) };
        let index = self.sort();
        let mut encoder = FrameEncoder::new(std::mem::take(&mut self.compressed));
        encoder.write_all(&self.sorted)?;
        self.compressed = encoder.finish().map_err(io::Error::other)?;
        let mut record = std::mem::take(&mut self.record);
        record.clear();
        record.u64(first).u64(last).u64(self.sorted.len() as u64).u32(crc32fast::hash(&self.sorted));
        record.text("lz4").u64(self.compressed.len() as u64).extend_from_slice(&self.compressed);
        let (start, length) = self.record(opcode::CHUNK, &record)?;
        self.record = record;
        let index_start = self.written;
        let mut offsets: Vec<u8> = Vec::new();
        for (channel, entries) in index {
            let mut body = Vec::with_capacity(6 + entries.len());
            body.u16(channel).u32(entries.len() as u32).extend(entries);
            let (place, _) = self.record(opcode::MESSAGE_INDEX, &body)?;
            offsets.u16(channel).u64(place);
        }
        let mut index = Vec::new();
        index.u64(first).u64(last).u64(start).u64(length).u32(offsets.len() as u32).extend(&offsets);
        index.u64(self.written - index_start).text("lz4");
        index.u64(self.compressed.len() as u64).u64(self.sorted.len() as u64);
        self.chunks.push(index);
        self.chunk.clear();
        self.sorted.clear();
        self.compressed.clear();
        self.out.flush()
    }

    /// Sorts the open chunk by channel; returns the entries of the index of each: log time and new place.
    fn sort(&mut self) -> Vec<(u16, Vec<u8>)> {
        let mut index = Vec::new();
        for (channel, messages) in std::mem::take(&mut self.index) {
            let mut entries = Vec::with_capacity(16 * messages.len());
            for (log_ns, place) in messages {
                entries.u64(log_ns).u64(self.sorted.len() as u64);
                self.sorted.extend_from_slice(&self.chunk[place]);
            }
            index.push((channel, entries));
        }
        index
    }

    /// Ends the file with its summary; returns the output and the length of the file.
    ///
    /// # Errors
    /// Those of the output.
    pub fn finish(mut self) -> io::Result<(W, u64)> {
        self.end_chunk()?;
        self.record(opcode::DATA_END, &0_u32.to_le_bytes())?;
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
        let [first, last] = self.times[1].unwrap_or_default();
        let mut body = Vec::new();
        body.u64(self.messages.values().sum()).u16(self.counts[0] as u16).u32(self.counts[1] as u32);
        body.u32(self.attachments.len() as u32).u32(self.metadata.len() as u32);
        body.u32(self.chunks.len() as u32).u64(first).u64(last).u32(10 * self.messages.len() as u32);
        self.messages.iter().for_each(|(channel, count)| _ = body.u16(*channel).u64(*count));
        let mut record = Vec::new();
        append(&mut record, opcode::STATISTICS, &body);
        record
    }

    /// Writes a record in one piece; returns where it begins and its whole length.
    fn record(&mut self, opcode: u8, body: &[u8]) -> io::Result<(u64, u64)> {
        let start = self.written;
        let mut head = vec![opcode];
        head.u64(body.len() as u64);
        self.put(&head)?;
        self.put(body)?;
        Ok((start, self.written - start))
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.written += bytes.len() as u64;
        Ok(())
    }
}

fn append(records: &mut Vec<u8>, opcode: u8, body: &[u8]) {
    records.push(opcode);
    records.u64(body.len() as u64).extend_from_slice(body);
}
