//! The content of a chunk.

use std::io::{self, ErrorKind, Read};

use lz4_flex::frame::FrameDecoder;
use ruzstd::decoding::{FrameDecoder as ZstdDecoder, StreamingDecoder};

use super::Damage;
use super::damage::Fault;
use super::fields::Fields;
use super::input::Head;

/// A chunk may hold so much [bytes]: those of this program have at most four megabytes.
pub const MAX_CHUNK: u64 = 64 << 20;
/// Names of compressions are not longer [bytes].
const MAX_NAME: u32 = 32;
/// Fields in front of the content of a chunk have at most so many bytes.
pub(super) const FIELDS: u64 = 8 + 8 + 8 + 4 + 4 + MAX_NAME as u64 + 8;

/// What stands in front of the content of a chunk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ChunkHead {
    /// Length of its content [bytes].
    length: u64,
    checksum: u32,
    compression: String,
    /// Where the compressed content begins in the record.
    stored_at: usize,
}

/// The last log time of a chunk, from the first bytes of its record [ns].
pub(super) fn last_ns(record: &[u8]) -> Option<u64> {
    Some(u64::from_le_bytes(record.get(8..16)?.try_into().ok()?))
}

impl ChunkHead {
    /// From the first bytes of the record.
    ///
    /// # Errors
    /// Fields that do not fit to the length of the record, more content than [`MAX_CHUNK`], another compression.
    pub(super) fn read(head: &Head, bytes: &[u8]) -> Result<Self, Fault> {
        let mut fields = Fields(bytes);
        fields.take(16)?;
        let (length, checksum, name) = (fields.u64()?, fields.u32()?, fields.u32()?);
        if name > MAX_NAME {
            return Err(Damage::Length.into());
        }
        let compression = String::from_utf8_lossy(fields.take(name as usize)?).into_owned();
        let stored = fields.u64()?;
        let stored_at = bytes.len() - fields.0.len();
        if (stored_at as u64).checked_add(stored) != Some(head.length) {
            return Err(Damage::Length.into());
        }
        if length.max(stored) > MAX_CHUNK {
            let bytes = length.max(stored);
            return Err(Fault::TooLarge { what: "a chunk", bytes, limit: MAX_CHUNK });
        }
        match compression.as_str() {
            "" | "lz4" | "zstd" => Ok(Self { length, checksum, compression, stored_at }),
            other if other.bytes().all(|byte| byte.is_ascii_alphanumeric()) => {
                Err(Fault::Unsupported(format!("compression {other}; lz4, zstd and none are")))
            }
            _ => Err(Damage::Compression.into()),
        }
    }

    /// Replaces `content` by that of the chunk, whose record this is.
    ///
    /// # Errors
    /// Content that can't be decompressed, or has another length or checksum, and too little memory.
    pub(super) fn unpack(&self, record: &[u8], content: &mut Vec<u8>) -> Result<(), Fault> {
        self.decompress(record, content)?;
        if content.len() as u64 != self.length {
            return Err(Damage::Compression.into());
        }
        match self.checksum != 0 && crc32fast::hash(content) != self.checksum {
            true => Err(Damage::Checksum.into()),
            false => Ok(()),
        }
    }

    /// The same of a record that was cut off: what was compressed in front of that place.
    pub(super) fn unpack_start(&self, record: &[u8], content: &mut Vec<u8>) {
        // The end is missing, which is an error of every compression.
        let _ = self.decompress(record, content);
    }

    fn decompress(&self, record: &[u8], content: &mut Vec<u8>) -> Result<(), Fault> {
        content.clear();
        let mut stored = record.get(self.stored_at..).ok_or(Damage::Short)?;
        // One byte more shows that there is more.
        let limit = self.length + 1;
        match self.compression.as_str() {
            "lz4" => {
                let read = FrameDecoder::new(stored).take(limit).read_to_end(content);
                read.map_err(undone)?;
            }
            "zstd" => {
                while !stored.is_empty() && content.len() as u64 <= self.length {
                    let left = limit - content.len() as u64;
                    let mut decoder = ZstdDecoder::new();
                    decoder.set_max_window_size(MAX_CHUNK);
                    let decoder = StreamingDecoder::new_with_decoder(&mut stored, decoder);
                    let decoder = decoder.map_err(|_| Damage::Compression)?;
                    decoder.take(left).read_to_end(content).map_err(undone)?;
                }
            }
            _ => content.extend_from_slice(stored),
        }
        Ok(())
    }
}

/// What keeps content from being decompressed: its damage, unless it is a lack of memory.
fn undone(error: io::Error) -> Fault {
    match error.kind() {
        ErrorKind::OutOfMemory => io::Error::from(rustix::io::Errno::NOMEM).into(),
        _ => Damage::Compression.into(),
    }
}
