//! Parts of a recording as a new recording: what was read of one that was cut off, or some seconds of it.

use std::fs::File;
use std::io::{BufReader, BufWriter};
use std::ops::RangeInclusive;
use std::path::Path;

use console::exit::Failure;
use console::new_file::{Existing, NewFile};

use crate::mcap::{Channel, Contents, Reader, Schema, Writer};
use crate::read::refusal;

/// Chunks end with this many bytes.
const CHUNK_BYTES: usize = 1 << 18;

/// What was copied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Copied {
    /// Messages in the new file.
    pub messages: u64,
    /// Its length [bytes].
    pub bytes: u64,
    /// Whether the old file had its end.
    pub was_complete: bool,
}

/// Copies the messages of `from` that were recorded in `times` [ns] since its first, with all attachments.
///
/// # Errors
/// A file that can't be read, one without a message in that time, and a new file that can't be written; exit code 2.
pub fn copy(from: &Path, to: &Path, force: bool, times: RangeInclusive<u64>) -> anyhow::Result<Copied> {
    let refuse = |path: &Path, reason: &dyn std::fmt::Display| {
        Failure::bad_input(format!("{}: {reason}", path.display()))
    };
    let input = File::open(from).map_err(|error| refuse(from, &error))?;
    let mut reader = Reader::new(BufReader::new(input)).map_err(|error| refusal(from, &error))?;
    let mut output = Some(NewFile::create(to, Existing::forced(force), &[from])?);
    let mut copy: Option<(Writer<BufWriter<NewFile>>, usize, usize)> = None;
    let (mut first_ns, mut copied) = (None, Copied::default());
    let mut damage = None;
    loop {
        let message = match reader.next_message() {
            Ok(Some(message)) => message,
            Ok(None) => break,
            Err(error) if copy.is_none() => return Err(refusal(from, &error)),
            Err(error) => {
                damage = Some(error);
                break;
            }
        };
        let (channel, sequence, log_ns) = (message.channel, message.sequence, message.log_ns);
        let data = message.data.to_vec();
        let first_ns = *first_ns.get_or_insert(log_ns);
        if !times.contains(&log_ns.saturating_sub(first_ns)) {
            continue;
        }
        let contents = reader.contents();
        if let Some(file) = output.take() {
            copy = Some((begin(file, contents)?, contents.attachments.len(), contents.metadata.len()));
        }
        if let Some((writer, ..)) = &mut copy {
            let index = contents.channels.keys().position(|number| *number == channel).unwrap_or_default();
            writer.message(index as u16, sequence, log_ns, &[&data]);
            if writer.open_bytes() >= CHUNK_BYTES {
                writer.end_chunk()?;
            }
            copied.messages += 1;
        }
    }
    let contents = reader.into_contents();
    let Some((mut writer, attachments, metadata)) = copy else {
        return Err(refuse(from, &"no whole second of this time is in the recording"));
    };
    for attachment in &contents.attachments[attachments..] {
        writer.attach(&attachment.name, &attachment.media_type, &attachment.data, 0)?;
    }
    for known in &contents.metadata[metadata..] {
        writer.metadata(&known.name, &known.map)?;
    }
    copied.was_complete = contents.is_complete && damage.is_none();
    let (output, bytes) = writer.finish()?;
    copied.bytes = bytes;
    output.into_inner().map_err(|error| refuse(to, &error))?.finish()?;
    Ok(copied)
}

/// A new file with the definitions and attachments that were read until now.
fn begin(file: NewFile, contents: &Contents) -> anyhow::Result<Writer<BufWriter<NewFile>>> {
    let schemas: Vec<Schema> = contents.schemas.values().cloned().collect();
    let place =
        |schema: u16| contents.schemas.keys().position(|number| *number == schema).unwrap_or_default();
    let renumbered = |channel: &Channel| Channel { schema: place(channel.schema) as u16, ..channel.clone() };
    let channels: Vec<Channel> = contents.channels.values().map(renumbered).collect();
    let mut writer = Writer::new(BufWriter::new(file), &contents.library, &schemas, &channels)?;
    for attachment in &contents.attachments {
        writer.attach(&attachment.name, &attachment.media_type, &attachment.data, 0)?;
    }
    for known in &contents.metadata {
        writer.metadata(&known.name, &known.map)?;
    }
    Ok(writer)
}
