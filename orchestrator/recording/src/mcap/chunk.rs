//! One chunk of a file: messages that are collected, and then compressed and stored together.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::ops::Range;

use lz4_flex::frame::FrameEncoder;

use super::{Put, append, opcode};

/// Name of the compression of chunks that become smaller by it.
const LZ4: &str = "lz4";
/// A message has so many bytes in front of its data.
pub(crate) const MESSAGE_BYTES: usize = 9 + 22;

/// Messages that are being collected.
#[derive(Debug, Default)]
pub struct OpenChunk {
    messages: Vec<u8>,
    times: Option<[u64; 2]>,
    /// Per channel: log time, and place of each message.
    index: BTreeMap<u16, Vec<(u64, Range<usize>)>>,
    /// Records in front of the messages; behind them the messages channel by channel, which compresses better.
    sorted: Vec<u8>,
    compressed: Vec<u8>,
}

/// A compressed chunk with the index of its messages: its records as they stand in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Chunk {
    /// First and last log time; `None` without messages.
    pub(crate) times: Option<[u64; 2]>,
    pub(crate) records: Vec<u8>,
    /// Length of the first record, the chunk itself; the others are its index.
    pub(crate) chunk_bytes: u64,
    /// Per channel the place of its index in `records`, and its messages.
    pub(crate) channels: Vec<(u16, u64, u64)>,
    pub(crate) compression: &'static str,
    pub(crate) stored_bytes: u64,
    pub(crate) full_bytes: u64,
}

impl OpenChunk {
    /// Adds records in front of the messages.
    pub(crate) fn begin_with(&mut self, records: &[u8]) {
        self.sorted.extend_from_slice(records);
    }

    /// Adds a message of data in parts, with the times at which it was recorded and published [ns].
    pub fn message(&mut self, channel: u16, sequence: u32, times_ns: [u64; 2], data: &[&[u8]]) {
        let (place, [log_ns, publish_ns]) = (self.messages.len(), times_ns);
        let length = 22 + data.iter().map(|part| part.len() as u64).sum::<u64>();
        self.messages.push(opcode::MESSAGE);
        self.messages.u64(length).u16(channel).u32(sequence).u64(log_ns).u64(publish_ns);
        data.iter().for_each(|part| self.messages.extend_from_slice(part));
        let [first, last] = self.times.unwrap_or([log_ns; 2]);
        self.times = Some([first.min(log_ns), last.max(log_ns)]);
        self.index.entry(channel).or_default().push((log_ns, place..self.messages.len()));
    }

    /// Its messages, uncompressed [bytes].
    pub fn bytes(&self) -> usize {
        self.messages.len()
    }

    /// The same with the records in front of them, which are in no chunk yet.
    pub(crate) fn full_bytes(&self) -> usize {
        self.sorted.len() + self.messages.len()
    }

    /// Compresses what was collected, and begins the next chunk.
    ///
    /// # Errors
    /// Those of the compression.
    pub fn seal(&mut self) -> io::Result<Chunk> {
        let times = self.times.take();
        let index = self.sort();
        let mut encoder = FrameEncoder::new(std::mem::take(&mut self.compressed));
        encoder.write_all(&self.sorted)?;
        self.compressed = encoder.finish().map_err(io::Error::other)?;
        // What does not become smaller is stored as it is, so that no chunk is larger than its content.
        let (compression, stored) = match self.compressed.len() < self.sorted.len() {
            true => (LZ4, &self.compressed),
            false => ("", &self.sorted),
        };
        let (stored_bytes, full_bytes) = (stored.len() as u64, self.sorted.len() as u64);
        let [first, last] = times.unwrap_or_default();
        let mut fields = Vec::with_capacity(64);
        fields.u64(first).u64(last).u64(full_bytes).u32(crc32fast::hash(&self.sorted));
        fields.text(compression).u64(stored_bytes);
        let index_bytes: usize = index.iter().map(|(_, entries)| 15 + entries.len()).sum();
        let mut records = Vec::with_capacity(9 + fields.len() + stored.len() + index_bytes);
        records.push(opcode::CHUNK);
        records.u64((fields.len() + stored.len()) as u64).extend_from_slice(&fields);
        records.extend_from_slice(stored);
        let chunk_bytes = records.len() as u64;
        let mut channels = Vec::with_capacity(index.len());
        for (channel, entries) in index {
            let mut body = Vec::with_capacity(6 + entries.len());
            body.u16(channel).u32(entries.len() as u32).extend_from_slice(&entries);
            channels.push((channel, records.len() as u64, entries.len() as u64 / 16));
            append(&mut records, opcode::MESSAGE_INDEX, &body);
        }
        self.messages.clear();
        self.sorted.clear();
        self.compressed.clear();
        Ok(Chunk { times, records, chunk_bytes, channels, compression, stored_bytes, full_bytes })
    }

    /// Sorts the messages by channel; returns the entries of the index of each: log time and new place.
    fn sort(&mut self) -> Vec<(u16, Vec<u8>)> {
        let mut index = Vec::new();
        for (channel, messages) in std::mem::take(&mut self.index) {
            let mut entries = Vec::with_capacity(16 * messages.len());
            for (log_ns, place) in messages {
                entries.u64(log_ns).u64(self.sorted.len() as u64);
                self.sorted.extend_from_slice(&self.messages[place]);
            }
            index.push((channel, entries));
        }
        index
    }
}

impl Chunk {
    /// Memory that it takes [bytes].
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.records.capacity() + self.channels.capacity() * size_of::<(u16, u64, u64)>()
    }

    /// Number of its messages.
    pub fn messages(&self) -> u64 {
        self.channels.iter().map(|(_, _, messages)| messages).sum()
    }

    /// Log time of its last message [ns].
    pub fn last_ns(&self) -> u64 {
        self.times.map_or(0, |[_, last]| last)
    }
}
