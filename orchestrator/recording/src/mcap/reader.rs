//! Reads MCAP files from their start to their end, or to where they were cut off.

use std::collections::BTreeMap;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;

use lz4_flex::frame::FrameDecoder;

use super::fields::Fields;
use super::{Channel, Damage, MAGIC, ReadError, Schema, opcode};

/// A longer record is taken for damage [bytes]: chunks of this program have some hundred kilobytes.
const MAX_RECORD: u64 = 1 << 30;

/// A message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Message<'a> {
    /// Number of its channel.
    pub channel: u16,
    /// Number of the message.
    pub sequence: u32,
    /// When it was recorded [ns].
    pub log_ns: u64,
    /// Its content.
    pub data: &'a [u8],
}

/// An attached file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Attachment {
    /// Its name.
    pub name: String,
    /// Its type.
    pub media_type: String,
    /// Its content.
    pub data: Vec<u8>,
}

/// Texts by texts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Metadata {
    /// What they are about.
    pub name: String,
    /// The texts.
    pub map: Vec<(String, String)>,
}

/// What was read beside the messages until now.
#[derive(Debug, Clone, Default)]
pub struct Contents {
    /// Program that wrote the file.
    pub library: String,
    /// Schemas by number.
    pub schemas: BTreeMap<u16, Schema>,
    /// Channels by number; `schema` is the number of their schema.
    pub channels: BTreeMap<u16, Channel>,
    /// Attached files.
    pub attachments: Vec<Attachment>,
    /// Texts.
    pub metadata: Vec<Metadata>,
    /// Whether the file was ended; false for one that was cut off.
    pub is_complete: bool,
    /// Whole chunks with messages that were read.
    pub chunks: u64,
    /// Bytes up to the end of the last whole record of the data.
    pub whole_bytes: u64,
}

/// Reads a file message by message.
#[derive(Debug)]
pub struct Reader<R: Read> {
    input: R,
    at: u64,
    contents: Contents,
    /// Where the open chunk begins in the file.
    chunk_at: u64,
    chunk: Vec<u8>,
    place: usize,
    /// Whether the open chunk is counted.
    is_counted: bool,
    record: Vec<u8>,
}

impl<R: Read> Reader<R> {
    /// A reader at the start of a file.
    ///
    /// # Errors
    /// [`ReadError::Foreign`] for other files.
    pub fn new(mut input: R) -> Result<Self, ReadError> {
        let mut magic = Vec::new();
        input.by_ref().take(MAGIC.len() as u64).read_to_end(&mut magic)?;
        if magic != MAGIC {
            return Err(ReadError::Foreign);
        }
        let contents = Contents { whole_bytes: MAGIC.len() as u64, ..Contents::default() };
        let (chunk, record) = (Vec::new(), Vec::new());
        Ok(Self {
            input,
            at: MAGIC.len() as u64,
            contents,
            chunk_at: 0,
            chunk,
            place: 0,
            is_counted: false,
            record,
        })
    }

    /// What was read beside the messages until now.
    pub fn contents(&self) -> &Contents {
        &self.contents
    }

    /// The same at the end.
    pub fn into_contents(self) -> Contents {
        self.contents
    }

    /// The next message; `None` at the end of the data, or where the file was cut off.
    ///
    /// # Errors
    /// [`ReadError::Damaged`], and errors of the file system.
    pub fn next_message(&mut self) -> Result<Option<Message<'_>>, ReadError> {
        match self.advance()? {
            Some(body) => {
                let at = self.at;
                message(&self.chunk[body]).map(Some).map_err(|what| ReadError::Damaged { at, what })
            }
            None => Ok(None),
        }
    }

    /// Byte of the file at which the chunk of the last message begins.
    pub fn chunk_at(&self) -> u64 {
        self.chunk_at
    }

    /// Whether all messages of the open chunk were read.
    pub fn is_chunk_over(&self) -> bool {
        self.place >= self.chunk.len()
    }

    /// Advances to the next message; returns where it stands in the open chunk.
    fn advance(&mut self) -> Result<Option<Range<usize>>, ReadError> {
        loop {
            while self.place < self.chunk.len() {
                if let Some(body) =
                    self.next_in_chunk().map_err(|what| ReadError::Damaged { at: self.at, what })?
                {
                    self.contents.chunks += u64::from(!std::mem::replace(&mut self.is_counted, true));
                    return Ok(Some(body));
                }
            }
            let start = self.at;
            let damaged = |what| ReadError::Damaged { at: start, what };
            let Some(opcode) = self.read_record()? else { return Ok(None) };
            let record = std::mem::take(&mut self.record);
            match opcode {
                opcode::DATA_END => {
                    self.contents.is_complete = self.ends_well()?;
                    return Ok(None);
                }
                opcode::CHUNK => {
                    self.open_chunk(&record).map_err(damaged)?;
                    self.chunk_at = start;
                    self.is_counted = false;
                }
                _ => self.define(opcode, &record).map_err(damaged)?,
            }
            self.contents.whole_bytes = self.at;
            self.record = record;
        }
    }

    /// Reads the next record of the open chunk; returns where it stands if it is a message.
    fn next_in_chunk(&mut self) -> Result<Option<Range<usize>>, Damage> {
        let mut fields = Fields(&self.chunk[self.place..]);
        let (opcode, length) = (fields.u8()?, fields.u64()?);
        let body = fields.take(length as usize)?;
        let range = self.place + 9..self.place + 9 + body.len();
        self.place = range.end;
        if opcode != opcode::MESSAGE {
            let body = body.to_vec();
            self.define(opcode, &body)?;
            return Ok(None);
        }
        let channel = message(&self.chunk[range.clone()])?.channel;
        if self.contents.channels.contains_key(&channel) { Ok(Some(range)) } else { Err(Damage::Channel) }
    }

    /// Reads a record into `self.record`; `None` where the file is cut off.
    fn read_record(&mut self) -> Result<Option<u8>, ReadError> {
        let mut head = [0; 9];
        if !fill(&mut self.input, &mut head)? {
            return Ok(None);
        }
        let length = u64::from_le_bytes(head[1..].try_into().unwrap_or_default());
        if length > MAX_RECORD {
            return Err(ReadError::Damaged { at: self.at, what: Damage::Long });
        }
        self.record.clear();
        let read = self.input.by_ref().take(length).read_to_end(&mut self.record)?;
        if read as u64 != length {
            return Ok(None);
        }
        self.at += 9 + length;
        Ok(Some(head[0]))
    }

    /// Whether summary and end of the file are there.
    fn ends_well(&mut self) -> Result<bool, ReadError> {
        let mut rest = Vec::new();
        self.input.read_to_end(&mut rest)?;
        Ok(rest.ends_with(&MAGIC))
    }

    fn define(&mut self, opcode: u8, body: &[u8]) -> Result<(), Damage> {
        let mut fields = Fields(body);
        match opcode {
            opcode::HEADER => {
                fields.text()?;
                self.contents.library = fields.text()?;
            }
            opcode::SCHEMA => {
                let number = fields.u16()?;
                let schema = Schema { name: fields.text()?, encoding: fields.text()?, text: fields.text()? };
                self.contents.schemas.insert(number, schema);
            }
            opcode::CHANNEL => {
                let (number, schema, topic) = (fields.u16()?, fields.u16()?, fields.text()?);
                fields.text()?;
                let channel = Channel { topic, schema, metadata: fields.map()? };
                self.contents.channels.insert(number, channel);
            }
            opcode::ATTACHMENT => {
                let content = body.len().checked_sub(4).ok_or(Damage::Short)?;
                let crc = u32::from_le_bytes(body[content..].try_into().unwrap_or_default());
                if crc != 0 && crc32fast::hash(&body[..content]) != crc {
                    return Err(Damage::Checksum);
                }
                fields.take(16)?;
                let (name, media_type, length) = (fields.text()?, fields.text()?, fields.u64()?);
                let data = fields.take(length as usize)?.to_vec();
                self.contents.attachments.push(Attachment { name, media_type, data });
            }
            opcode::METADATA => {
                let (name, map) = (fields.text()?, fields.map()?);
                self.contents.metadata.push(Metadata { name, map });
            }
            _ => {}
        }
        Ok(())
    }

    fn open_chunk(&mut self, record: &[u8]) -> Result<(), Damage> {
        let mut fields = Fields(record);
        fields.take(16)?;
        let (length, crc, compression) = (fields.u64()?, fields.u32()?, fields.text()?);
        let stored = fields.u64()?;
        let stored = fields.take(stored as usize)?;
        self.chunk.clear();
        self.place = 0;
        match compression.as_str() {
            "" => self.chunk.extend_from_slice(stored),
            "lz4" => {
                let limit = FrameDecoder::new(stored).take(length.min(MAX_RECORD) + 1);
                let read = { limit }.read_to_end(&mut self.chunk);
                if read.ok() != Some(length as usize) {
                    return Err(Damage::Compression);
                }
            }
            _ => return Err(Damage::Compression),
        }
        if crc != 0 && crc32fast::hash(&self.chunk) != crc {
            return Err(Damage::Checksum);
        }
        Ok(())
    }
}

impl<R: Read + Seek> Reader<R> {
    /// Continues with the chunk that begins at a byte of the file, see [`Reader::chunk_at`].
    ///
    /// # Errors
    /// Those of the file system.
    pub fn seek_to_chunk(&mut self, at: u64) -> io::Result<()> {
        self.input.seek(SeekFrom::Start(at))?;
        self.chunk.clear();
        // No chunk is open: none begins at the first byte.
        (self.at, self.place, self.chunk_at) = (at, 0, 0);
        Ok(())
    }
}

fn message(body: &[u8]) -> Result<Message<'_>, Damage> {
    let mut fields = Fields(body);
    let (channel, sequence, log_ns) = (fields.u16()?, fields.u32()?, fields.u64()?);
    fields.u64()?;
    Ok(Message { channel, sequence, log_ns, data: fields.0 })
}

/// Fills `bytes`; false when the input ends before.
fn fill(input: &mut impl Read, bytes: &mut [u8]) -> io::Result<bool> {
    match input.read_exact(bytes) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
        result => result.map(|()| true),
    }
}
