//! The bytes of a file by their place.

use std::io::{self, BufReader, Read, Seek, SeekFrom};

use super::MAGIC;

/// The buffer has so many bytes.
const BUFFER: u64 = 1 << 18;
/// So many bytes are read for each byte of a file, and on top, before it counts as exhausted [bytes]. A whole file takes less than
/// three. A damaged one takes more where many places look like the begin of a record, because each is tried.
const MAX_TRIES: u64 = 16;
const MIN_TRIES: u64 = 64 << 20;
/// Reads of so many bytes are done past the buffer when a file is exhausted [bytes].
const PEEK: u64 = 128;

/// A file whose length is known.
#[derive(Debug)]
pub(super) struct Input<R> {
    reader: BufReader<R>,
    at: u64,
    length: u64,
    /// Bytes that were read until now, with those that only went to the buffer.
    read: u64,
}

/// The first bytes of a record: what it is, and how long.
#[derive(Debug, Clone, Copy)]
pub(super) struct Head {
    /// Where it begins.
    pub(super) at: u64,
    pub(super) opcode: u8,
    /// Length of what follows the head [bytes].
    pub(super) length: u64,
}

impl Head {
    /// Bytes of a head.
    pub(super) const BYTES: u64 = 9;

    /// Where the fields of the record begin.
    pub(super) fn body(&self) -> u64 {
        self.at + Self::BYTES
    }

    /// Where the next record begins.
    pub(super) fn end(&self) -> u64 {
        self.body().saturating_add(self.length)
    }
}

impl<R: Read + Seek> Input<R> {
    pub(super) fn new(mut reader: R) -> io::Result<Self> {
        let length = reader.seek(SeekFrom::End(0))?;
        reader.rewind()?;
        Ok(Self { reader: BufReader::with_capacity(BUFFER as usize, reader), at: 0, length, read: 0 })
    }

    /// Length of the file [bytes].
    pub(super) fn length(&self) -> u64 {
        self.length
    }

    /// Replaces `bytes` by the file's from a place on; they are fewer at its end.
    pub(super) fn read(&mut self, at: u64, length: u64, bytes: &mut Vec<u8>) -> io::Result<()> {
        bytes.clear();
        let length = length.min(self.length.saturating_sub(at));
        let is_far = at.abs_diff(self.at) > self.reader.buffer().len() as u64;
        if is_far && length <= PEEK && self.is_exhausted() {
            return self.peek(at, length, bytes);
        }
        self.read += length + if is_far { BUFFER } else { 0 };
        self.reader.seek_relative(at as i64 - self.at as i64)?;
        self.at = at;
        self.at += self.reader.by_ref().take(length).read_to_end(bytes)? as u64;
        Ok(())
    }

    /// The same without the buffer, which stays where it is.
    fn peek(&mut self, at: u64, length: u64, bytes: &mut Vec<u8>) -> io::Result<()> {
        let reader = self.reader.get_mut();
        let buffered_to = reader.stream_position()?;
        reader.seek(SeekFrom::Start(at))?;
        let read = reader.take(length).read_to_end(bytes);
        reader.seek(SeekFrom::Start(buffered_to))?;
        read.map(drop)
    }

    /// Counts what was unpacked of what was read.
    pub(super) fn spend(&mut self, bytes: usize) {
        self.read += bytes as u64;
    }

    /// Whether so much was read that no place is tried at length any more.
    pub(super) fn is_exhausted(&self) -> bool {
        self.read > self.length.saturating_mul(MAX_TRIES).saturating_add(MIN_TRIES)
    }

    /// The head at a place; `None` where the file ends within it.
    pub(super) fn head(&mut self, at: u64) -> io::Result<Option<Head>> {
        let mut bytes = Vec::with_capacity(Head::BYTES as usize);
        self.read(at, Head::BYTES, &mut bytes)?;
        let Ok([opcode, length @ ..]) = <[u8; Head::BYTES as usize]>::try_from(bytes) else {
            return Ok(None);
        };
        Ok(Some(Head { at, opcode, length: u64::from_le_bytes(length) }))
    }

    /// Whether the bytes of the format stand at a place.
    pub(super) fn has_magic(&mut self, at: u64) -> io::Result<bool> {
        let mut bytes = Vec::with_capacity(MAGIC.len());
        self.read(at, MAGIC.len() as u64, &mut bytes)?;
        Ok(bytes == MAGIC)
    }

    /// The checksum of the bytes between two places.
    pub(super) fn checksum(&mut self, from: u64, to: u64) -> io::Result<u32> {
        let (mut hasher, mut bytes, mut at) = (crc32fast::Hasher::new(), Vec::new(), from);
        while at < to {
            self.read(at, (to - at).min(1 << 16), &mut bytes)?;
            if bytes.is_empty() {
                break;
            }
            hasher.update(&bytes);
            at += bytes.len() as u64;
        }
        Ok(hasher.finalize())
    }
}
