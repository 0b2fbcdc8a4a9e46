//! The container format MCAP, version 0: <https://mcap.dev/spec>.
//!
//! A file is a sequence of records: one byte says what it is, eight its length. Messages stand in compressed chunks,
//! each with a checksum; behind the data is a summary, from which readers find the chunks of a time. A file that was
//! cut off has no summary, and is read from its start up to the last whole chunk. Files of other programs may have
//! messages outside of chunks, and several files may be joined to one.
//!
//! Written here instead of used from a crate, because of the cost in the build
//! ([decision 46](../../../docs/decisions/0046-recordings-are-mcap.md)).

mod chunk;
mod contents;
mod damage;
mod fields;
mod gaps;
mod index;
mod input;
mod named;
mod reader;
mod sound;
mod unpack;
mod walk;
mod writer;

pub(crate) use chunk::MESSAGE_BYTES;
pub use chunk::{Chunk, OpenChunk};
pub(crate) use contents::MAX_TEXT;
pub use contents::{Attachment, Contents, MAX_HELD, McapMessage, Metadata, Statistics};
pub use damage::{Damage, ReadError};
pub use gaps::Gap;
pub use reader::McapReader;
pub use unpack::MAX_CHUNK;
pub(crate) use writer::CDR;
pub use writer::{Channel, Schema, Writer};

/// First and last bytes of a file.
pub const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// Kinds of records.
pub(crate) mod opcode {
    pub(crate) const HEADER: u8 = 0x01;
    pub(crate) const FOOTER: u8 = 0x02;
    pub(crate) const SCHEMA: u8 = 0x03;
    pub(crate) const CHANNEL: u8 = 0x04;
    pub(crate) const MESSAGE: u8 = 0x05;
    pub(crate) const CHUNK: u8 = 0x06;
    pub(crate) const MESSAGE_INDEX: u8 = 0x07;
    pub(crate) const CHUNK_INDEX: u8 = 0x08;
    pub(crate) const ATTACHMENT: u8 = 0x09;
    pub(crate) const ATTACHMENT_INDEX: u8 = 0x0a;
    pub(crate) const STATISTICS: u8 = 0x0b;
    pub(crate) const METADATA: u8 = 0x0c;
    pub(crate) const METADATA_INDEX: u8 = 0x0d;
    pub(crate) const SUMMARY_OFFSET: u8 = 0x0e;
    pub(crate) const DATA_END: u8 = 0x0f;
}

/// Writes fields of a record.
pub(crate) trait Put {
    /// A number of two bytes.
    fn u16(&mut self, value: u16) -> &mut Self;
    /// A number of four bytes.
    fn u32(&mut self, value: u32) -> &mut Self;
    /// A number of eight bytes.
    fn u64(&mut self, value: u64) -> &mut Self;
    /// A text with its length.
    fn text(&mut self, text: &str) -> &mut Self;
    /// Texts by texts.
    fn map(&mut self, map: &[(String, String)]) -> &mut Self;
}

impl Put for Vec<u8> {
    fn u16(&mut self, value: u16) -> &mut Self {
        self.extend(value.to_le_bytes());
        self
    }

    fn u32(&mut self, value: u32) -> &mut Self {
        self.extend(value.to_le_bytes());
        self
    }

    fn u64(&mut self, value: u64) -> &mut Self {
        self.extend(value.to_le_bytes());
        self
    }

    fn text(&mut self, text: &str) -> &mut Self {
        self.u32(text.len() as u32).extend(text.as_bytes());
        self
    }

    fn map(&mut self, map: &[(String, String)]) -> &mut Self {
        let bytes: usize = map.iter().map(|(key, value)| 8 + key.len() + value.len()).sum();
        self.u32(bytes as u32);
        for (key, value) in map {
            self.text(key).text(value);
        }
        self
    }
}

/// Adds a whole record.
pub(crate) fn append(records: &mut Vec<u8>, opcode: u8, body: &[u8]) {
    records.push(opcode);
    records.u64(body.len() as u64).extend_from_slice(body);
}

#[cfg(test)]
pub(crate) mod handmade;
#[cfg(test)]
mod tests;
