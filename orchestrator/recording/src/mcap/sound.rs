//! Whether a record begins at a place of a damaged file.

use std::io::{self, Read, Seek};

use super::contents::{self, Contents, MAX_HELD, MAX_TEXT, Memory};
use super::damage::Fault;
use super::fields::Fields;
use super::input::{Head, Input};
use super::unpack::{self, ChunkHead, MAX_CHUNK};
use super::{Damage, MAGIC, opcode};

/// So much is searched at a time: at first, and at most [bytes].
const WINDOWS: [u64; 2] = [1 << 10, 1 << 16];
/// In a file that is exhausted, so much of a record is read to find out whether it is one [bytes].
const MAX_TRIED: u64 = 1 << 10;

/// Whether the format has such a record.
pub(super) fn is_known(opcode: u8) -> bool {
    (opcode::HEADER..=opcode::DATA_END).contains(&opcode)
}

/// Whether the content of such a record is read when a file is opened.
pub(super) fn is_loaded(opcode: u8) -> bool {
    use super::opcode::{ATTACHMENT, CHANNEL, HEADER, METADATA, SCHEMA, STATISTICS};
    matches!(opcode, HEADER | SCHEMA | CHANNEL | ATTACHMENT | METADATA | STATISTICS)
}

/// The first place from `at` on at which a record begins, or a file; `None` if there is none.
pub(super) fn next_record<R: Read + Seek>(
    input: &mut Input<R>,
    mut at: u64,
    knows_loose: bool,
) -> io::Result<Option<u64>> {
    let mut window = Vec::new();
    let [mut length, max_length] = WINDOWS;
    while at < input.length() {
        input.read(at, length + Head::BYTES - 1, &mut window)?;
        if window.is_empty() {
            break;
        }
        let starts = window.len().min(length as usize);
        for start in 0..starts {
            let rest = &window[start..];
            // Lengths of a terabyte and more are none.
            let is_head = is_known(rest[0]) && rest.get(6..9).is_some_and(|high| high == [0; 3]);
            if (is_head || rest[0] == MAGIC[0]) && is_record(input, at + start as u64, knows_loose)? {
                return Ok(Some(at + start as u64));
            }
        }
        at += starts as u64;
        length = (2 * length).min(max_length);
    }
    Ok(None)
}

/// Whether a record begins at a place whose fields fit to its length, with another one or the end behind it.
pub(super) fn is_record<R: Read + Seek>(
    input: &mut Input<R>,
    at: u64,
    knows_loose: bool,
) -> io::Result<bool> {
    if input.has_magic(at)? {
        return Ok(true);
    }
    let Some(head) = input.head(at)? else { return Ok(false) };
    if !is_known(head.opcode) || head.end() > input.length() {
        return Ok(false);
    }
    let is_followed = match input.head(head.end())? {
        Some(next) => next.opcode != 0 && next.end() <= input.length() || input.has_magic(head.end())?,
        None => true,
    };
    // What has a checksum or several lengths is believed also in front of a damaged place.
    let is_strong = matches!(head.opcode, opcode::CHUNK | opcode::ATTACHMENT) && !input.is_exhausted();
    Ok((is_followed || is_strong)
        && (head.opcode != opcode::MESSAGE || knows_loose)
        && has_fields(input, &head)?)
}

/// Whether the fields of a record fit to its length.
pub(super) fn has_fields<R: Read + Seek>(input: &mut Input<R>, head: &Head) -> io::Result<bool> {
    let mut bytes = Vec::new();
    let lengths = |allowed: &[u64]| Ok(allowed.contains(&head.length));
    match head.opcode {
        opcode::DATA_END => lengths(&[4]),
        opcode::FOOTER => lengths(&[20]),
        opcode::SUMMARY_OFFSET => lengths(&[17]),
        opcode::CHUNK => {
            input.read(head.body(), head.length.min(unpack::FIELDS), &mut bytes)?;
            Ok(ChunkHead::read(head, &bytes).is_ok())
        }
        opcode::MESSAGE => Ok(head.length >= 22),
        opcode::MESSAGE_INDEX => {
            input.read(head.body(), 6, &mut bytes)?;
            Ok(check_message_index(head, &bytes).is_ok())
        }
        _ if head.length > if input.is_exhausted() { MAX_TRIED } else { MAX_HELD } => Ok(false),
        opcode => {
            input.read(head.body(), head.length, &mut bytes)?;
            let memory = &mut Memory::new(false);
            Ok(match opcode {
                opcode::ATTACHMENT => contents::attached(&bytes).is_ok(),
                // One that is too large is refused for that, and its fields fit.
                opcode if is_loaded(opcode) => {
                    let defined = Contents::default().define(opcode, &bytes, memory, false);
                    matches!(defined, Ok(()) | Err(Fault::TooLarge { .. }))
                }
                opcode => has_index_fields(opcode, &bytes).is_ok(),
            })
        }
    }
}

/// Whether what claims to be a message is an index of messages, a channel or a schema: all its fields fit to its length.
pub(super) fn is_other_record<R: Read + Seek>(input: &mut Input<R>, head: &Head) -> io::Result<bool> {
    let mut bytes = Vec::new();
    input.read(head.body(), 6, &mut bytes)?;
    if check_message_index(head, &bytes).is_ok() {
        input.read(head.body(), head.length.min(MAX_CHUNK), &mut bytes)?;
        let places = bytes[6..].chunks_exact(16).map(|entry| entry[8..].try_into().map(u64::from_le_bytes));
        return Ok(places.into_iter().all(|place| place.is_ok_and(|place| place < MAX_CHUNK)));
    }
    if head.length > MAX_TEXT {
        return Ok(false);
    }
    input.read(head.body(), head.length, &mut bytes)?;
    let channel = |fields: &mut Fields<'_>| {
        fields.take(4)?;
        fields.str()?;
        fields.str()?;
        fields.map().map(drop)
    };
    let schema = |fields: &mut Fields<'_>| {
        fields.take(2)?;
        (0..3).try_for_each(|_| fields.str().map(drop))
    };
    let is = |read: &dyn Fn(&mut Fields<'_>) -> Result<(), Damage>| {
        let mut fields = Fields(&bytes);
        read(&mut fields).is_ok() && fields.0.is_empty()
    };
    Ok(is(&channel) || is(&schema))
}

/// Reads the fields of an index in the summary.
fn has_index_fields(opcode: u8, bytes: &[u8]) -> Result<(), Damage> {
    let mut fields = Fields(bytes);
    match opcode {
        opcode::CHUNK_INDEX => {
            fields.take(32)?;
            let offsets = fields.u32()?;
            fields.take(offsets as usize + 8)?;
            fields.text()?;
            fields.take(16)?;
        }
        opcode::ATTACHMENT_INDEX => {
            fields.take(40)?;
            fields.text()?;
            fields.text()?;
        }
        _ => {
            fields.take(16)?;
            fields.text()?;
        }
    }
    if fields.0.is_empty() { Ok(()) } else { Err(Damage::Length) }
}

/// Checks the length of the index of the messages of a channel against its first six bytes.
fn check_message_index(head: &Head, bytes: &[u8]) -> Result<(), Damage> {
    let mut fields = Fields(bytes);
    fields.u16()?;
    let entries = u64::from(fields.u32()?);
    if head.length == 6 + entries && entries.is_multiple_of(16) { Ok(()) } else { Err(Damage::Length) }
}
