//! What a file holds beside its messages.

use std::collections::BTreeMap;

use super::damage::Fault;
use super::fields::Fields;
use super::{Channel, Damage, Schema, opcode};

/// Schemas, channels, attached files and texts of a file may take so much memory [bytes]: recordings of this program take
/// half a megabyte.
pub const MAX_HELD: u64 = 128 << 20;
/// A map of empty texts takes so much more memory than bytes of the file.
const MAP_FACTOR: u64 = 6;

/// A message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Message<'a> {
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
    pub schemas: BTreeMap<u16, Schema>,
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
    /// Takes in a record; `held` is the memory that definitions, files and texts take until now [bytes]. A definition that
    /// contradicts an earlier one is damage, or `replaces` it.
    ///
    /// # Errors
    /// A record that is damaged, one that contradicts an earlier one, and more than [`MAX_HELD`].
    pub(super) fn define(
        &mut self,
        opcode: u8,
        body: &[u8],
        held: &mut u64,
        replaces: bool,
    ) -> Result<(), Fault> {
        let mut fields = Fields(body);
        match opcode {
            opcode::HEADER => (self.profile, self.library) = (fields.text()?, fields.text()?),
            opcode::SCHEMA => {
                let number = fields.u16()?;
                let schema = Schema { name: fields.text()?, encoding: fields.text()?, text: fields.text()? };
                hold_new(&self.schemas, number, &schema, (body.len() as u64, replaces), held)?;
                self.schemas.insert(number, schema);
            }
            opcode::CHANNEL => {
                let (number, schema, topic) = (fields.u16()?, fields.u16()?, fields.text()?);
                let channel = Channel { topic, schema, encoding: fields.text()?, metadata: fields.map()? };
                let bytes = MAP_FACTOR * body.len() as u64;
                hold_new(&self.channels, number, &channel, (bytes, replaces), held)?;
                self.channels.insert(number, channel);
            }
            opcode::ATTACHMENT => {
                let content = body.len().checked_sub(4).ok_or(Damage::Short)?;
                let crc = u32::from_le_bytes(body[content..].try_into().unwrap_or_default());
                if crc != 0 && crc32fast::hash(&body[..content]) != crc {
                    return Err(Damage::Checksum.into());
                }
                let (log_ns, _, name, media_type) =
                    (fields.u64()?, fields.u64()?, fields.text()?, fields.text()?);
                let length = fields.u64()?;
                let data = fields.take(length as usize)?;
                if fields.0.len() != 4 {
                    return Err(Damage::Length.into());
                }
                hold(length, held)?;
                self.attachments.push(Attachment { name, media_type, log_ns, data: data.to_vec() });
            }
            opcode::METADATA => {
                let (name, map) = (fields.text()?, fields.map()?);
                hold(MAP_FACTOR * body.len() as u64, held)?;
                self.metadata.push(Metadata { name, map });
            }
            opcode::STATISTICS => {
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
                self.statistics = Some(Statistics { messages, channels, times, attached });
            }
            _ => {}
        }
        Ok(())
    }
}

/// Counts the memory of a definition that is new.
fn hold_new<T: PartialEq>(
    known: &BTreeMap<u16, T>,
    number: u16,
    new: &T,
    (bytes, replaces): (u64, bool),
    held: &mut u64,
) -> Result<(), Fault> {
    match known.get(&number) {
        Some(old) if old == new => Ok(()),
        Some(_) if !replaces => Err(Damage::Misplaced.into()),
        _ => hold(bytes, held),
    }
}

/// Counts the memory of a record.
fn hold(bytes: u64, held: &mut u64) -> Result<(), Fault> {
    // What stands around its texts.
    *held += 256 + bytes;
    match *held > MAX_HELD {
        true => Err(Fault::TooLarge {
            what: "definitions, attached files and texts",
            bytes: *held,
            limit: MAX_HELD,
        }),
        false => Ok(()),
    }
}

/// The message in the fields of a record.
pub(super) fn message(body: &[u8]) -> Result<Message<'_>, Damage> {
    let mut fields = Fields(body);
    let (channel, sequence, log_ns) = (fields.u16()?, fields.u32()?, fields.u64()?);
    let publish_ns = fields.u64()?;
    Ok(Message { channel, sequence, log_ns, publish_ns, data: fields.0 })
}
