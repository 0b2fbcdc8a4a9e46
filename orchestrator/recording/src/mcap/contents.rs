//! What a file holds beside its messages.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

use super::damage::Fault;
use super::fields::Fields;
use super::{Channel, Damage, Schema, opcode};

/// Schemas, channels, attached files and texts of a file may take so much memory [bytes]: recordings of this program take
/// half a megabyte.
pub const MAX_HELD: u64 = 128 << 20;
/// A definition, a name or a text may have so many bytes.
pub(crate) const MAX_TEXT: u64 = 4 << 20;
/// A map of empty texts, or of numbers, takes so much more memory than bytes of the file.
const MAP_FACTOR: u64 = 6;
/// A repair leaves so much of [`MAX_HELD`] for what it adds: definitions, and a text about what is missing [bytes].
const REPAIR_BYTES: u64 = 4 << 20;

/// The memory that is taken by what a file holds beside its messages. It is counted once, from the walk over the records to
/// the last message.
#[derive(Debug, Clone, Copy)]
pub(super) struct Memory {
    bytes: u64,
    limit: u64,
}

impl Memory {
    pub(super) fn new(is_salvage: bool) -> Self {
        Self { bytes: 0, limit: if is_salvage { MAX_HELD - REPAIR_BYTES } else { MAX_HELD } }
    }

    /// Counts a record, with what stands around its texts.
    fn hold_record(&mut self, bytes: u64) -> Result<(), Fault> {
        self.hold(256 + bytes)
    }

    /// Counts some memory.
    pub(super) fn hold(&mut self, bytes: u64) -> Result<(), Fault> {
        let (bytes, limit) = (self.bytes + bytes, self.limit);
        if bytes > limit {
            return Err(Fault::TooLarge { what: "definitions, attached files and texts", bytes, limit });
        }
        self.bytes = bytes;
        Ok(())
    }

    /// Counts the memory of a definition that is new.
    fn hold_new<T: PartialEq>(
        &mut self,
        known: Option<&T>,
        new: &T,
        (bytes, replaces): (u64, bool),
    ) -> Result<(), Fault> {
        match known {
            Some(old) if old == new => Ok(()),
            Some(_) if !replaces => Err(Damage::Misplaced.into()),
            _ => self.hold_record(bytes),
        }
    }
}

/// A message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct McapMessage<'a> {
    /// Number of its channel.
    pub channel: u16,
    /// Number of the message.
    pub sequence: u32,
    /// When it was recorded [ns].
    pub log_ns: u64,
    /// When it was published, as its writer says [ns].
    pub publish_ns: u64,
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
    /// When it was attached [ns].
    pub log_ns: u64,
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

/// What the summary of a file tells about its messages.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Number of messages.
    pub messages: u64,
    /// Messages by the number of their channel.
    pub channels: BTreeMap<u16, u64>,
    /// First and last log time [ns].
    pub times: [u64; 2],
    /// Number of attached files, and of texts.
    pub attached: [u32; 2],
}

/// What was read beside the messages until now.
#[derive(Debug, Clone, Default)]
pub struct Contents {
    /// How the messages of the file are to be understood.
    pub profile: String,
    /// Program that wrote the file.
    pub library: String,
    /// Schemas by number.
    pub schemas: BTreeMap<u16, Arc<Schema>>,
    /// Channels by number; `schema` is the number of their schema.
    pub channels: BTreeMap<u16, Channel>,
    /// Attached files.
    pub attachments: Vec<Attachment>,
    /// Texts.
    pub metadata: Vec<Metadata>,
    /// What the summary counts.
    pub statistics: Option<Statistics>,
    /// Whether the file was ended; false for one that was cut off.
    pub is_complete: bool,
    /// Parts with messages that were read: chunks, or pieces of a file without chunks.
    pub chunks: u64,
}

impl Contents {
    /// Whether nothing was read.
    pub(super) fn is_empty(&self) -> bool {
        let Self { schemas, channels, attachments, metadata, .. } = self;
        let is_headed = !self.profile.is_empty() || !self.library.is_empty() || self.statistics.is_some();
        !is_headed
            && schemas.is_empty()
            && channels.is_empty()
            && attachments.is_empty()
            && metadata.is_empty()
    }

    /// Takes in a record, and counts its memory. A definition that contradicts an earlier one is damage, or `replaces` it.
    ///
    /// # Errors
    /// A record that is damaged, one that contradicts an earlier one, and more than [`MAX_TEXT`] or the `memory` allow.
    pub(super) fn define(
        &mut self,
        opcode: u8,
        body: &[u8],
        memory: &mut Memory,
        replaces: bool,
    ) -> Result<(), Fault> {
        let mut fields = Fields(body);
        match opcode {
            opcode::HEADER => {
                let (profile, library) = (fields.text()?, fields.text()?);
                memory.hold_record(text_bytes(body, &[&profile, &library])?)?;
                (self.profile, self.library) = (profile, library);
            }
            opcode::SCHEMA => {
                let number = fields.u16()?;
                let schema = Schema { name: fields.text()?, encoding: fields.text()?, text: fields.text()? };
                let bytes = text_bytes(body, &[&schema.name, &schema.encoding, &schema.text])?;
                let known = self.schemas.get(&number).map(Arc::as_ref);
                memory.hold_new(known, &schema, (bytes, replaces))?;
                self.schemas.insert(number, schema.into());
            }
            opcode::CHANNEL => {
                let (number, schema, topic) = (fields.u16()?, fields.u16()?, fields.text()?);
                let channel = Channel { topic, schema, encoding: fields.text()?, metadata: fields.map()? };
                let mut texts = vec![channel.topic.as_str(), &channel.encoding];
                texts.extend(channel.metadata.iter().flat_map(|(key, value)| [key.as_str(), value]));
                let bytes = MAP_FACTOR * text_bytes(body, &texts)?;
                memory.hold_new(self.channels.get(&number), &channel, (bytes, replaces))?;
                self.channels.insert(number, channel);
            }
            opcode::ATTACHMENT => {
                let Attached { name, media_type, log_ns, data } = attached(body)?;
                memory.hold_record(text_bytes(&[], &[&name, &media_type])? + data.len() as u64)?;
                let (name, media_type) = (name.into_owned(), media_type.into_owned());
                self.attachments.push(Attachment { name, media_type, log_ns, data: data.to_vec() });
            }
            opcode::METADATA => {
                let (name, map) = (fields.text()?, fields.map()?);
                let mut texts = vec![name.as_str()];
                texts.extend(map.iter().flat_map(|(key, value)| [key.as_str(), value]));
                memory.hold_record(MAP_FACTOR * text_bytes(body, &texts)?)?;
                self.metadata.push(Metadata { name, map });
            }
            opcode::STATISTICS => {
                memory.hold_record(MAP_FACTOR * body.len() as u64)?;
                self.statistics = Some(statistics(fields)?);
            }
            _ => {}
        }
        Ok(())
    }
}

/// The bytes of a record with these texts: where they were no UTF-8, they have become longer.
///
/// # Errors
/// More than [`MAX_TEXT`], so that what is written anew can be read.
fn text_bytes(body: &[u8], texts: &[&str]) -> Result<u64, Fault> {
    let texts_bytes: usize = 8 + texts.iter().map(|text| 4 + text.len()).sum::<usize>();
    let bytes = body.len().max(texts_bytes) as u64;
    match bytes > MAX_TEXT {
        true => Err(Fault::TooLarge { what: "a definition, a name or a text", bytes, limit: MAX_TEXT }),
        false => Ok(bytes),
    }
}

/// The fields of an attached file.
pub(super) struct Attached<'a> {
    name: Cow<'a, str>,
    media_type: Cow<'a, str>,
    log_ns: u64,
    data: &'a [u8],
}

/// The attached file in the fields of a record, whose checksum is checked.
pub(super) fn attached(body: &[u8]) -> Result<Attached<'_>, Damage> {
    let content = body.len().checked_sub(4).ok_or(Damage::Short)?;
    let crc = u32::from_le_bytes(body[content..].try_into().unwrap_or_default());
    if crc != 0 && crc32fast::hash(&body[..content]) != crc {
        return Err(Damage::Checksum);
    }
    let mut fields = Fields(body);
    let (log_ns, _, name, media_type) = (fields.u64()?, fields.u64()?, fields.str()?, fields.str()?);
    let length = fields.u64()?;
    let data = fields.take(length as usize)?;
    if fields.0.len() != 4 {
        return Err(Damage::Length);
    }
    Ok(Attached { name, media_type, log_ns, data })
}

/// What the summary counts.
fn statistics(mut fields: Fields<'_>) -> Result<Statistics, Damage> {
    let messages = fields.u64()?;
    fields.take(2 + 4)?;
    let attached = [fields.u32()?, fields.u32()?];
    fields.u32()?;
    let (times, bytes) = ([fields.u64()?, fields.u64()?], fields.u32()?);
    let mut counts = Fields(fields.take(bytes as usize)?);
    let mut channels = BTreeMap::new();
    while !counts.0.is_empty() {
        channels.insert(counts.u16()?, counts.u64()?);
    }
    Ok(Statistics { messages, channels, times, attached })
}

/// The message in the fields of a record.
pub(super) fn message(body: &[u8]) -> Result<McapMessage<'_>, Damage> {
    let mut fields = Fields(body);
    let (channel, sequence, log_ns) = (fields.u16()?, fields.u32()?, fields.u64()?);
    let publish_ns = fields.u64()?;
    Ok(McapMessage { channel, sequence, log_ns, publish_ns, data: fields.0 })
}
