//! What has become of a recording that was copied: new files, and what is missing.

use std::collections::BTreeMap;
use std::path::PathBuf;

use crate::mcap::{Damage, Gap};

/// What was copied.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Copied {
    /// The new files: one for each run.
    pub files: Vec<PathBuf>,
    /// What each of them holds.
    pub(crate) summaries: Vec<Summary>,
    /// Messages in them.
    pub messages: u64,
    /// Their length [bytes].
    pub bytes: u64,
    /// Damaged places, and what is missing there.
    pub gaps: Vec<Missing>,
    /// Messages that are missing by what the summary counts; `None` when that is not known.
    pub missing_messages: Option<u64>,
    /// Attached files and texts that could not be read; `None` when that is not known.
    pub missing_attachments: Option<u64>,
    /// Whether something of the drive, or of what is attached, is missing.
    pub is_loss: bool,
}

impl Copied {
    /// What is missing, a line each.
    pub fn missing(&self) -> Vec<String> {
        missing(&self.gaps, self.missing_messages, self.missing_attachments)
    }
}

/// What is missing, a line each: damaged places, messages, and attached files.
pub(super) fn missing(gaps: &[Missing], messages: Option<u64>, attachments: Option<u64>) -> Vec<String> {
    let mut lines: Vec<String> = gaps.iter().map(ToString::to_string).collect();
    lines.extend(
        messages
            .filter(|messages| *messages > 0)
            .map(|messages| format!("{messages} of the messages that the summary counts are missing")),
    );
    lines.extend(
        attachments
            .filter(|attachments| *attachments > 0)
            .map(|attachments| format!("{attachments} attached files or texts can't be read")),
    );
    lines
}

/// What a new file holds.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Summary {
    /// First and last log time of its messages [ns].
    pub(crate) times_ns: [u64; 2],
    pub(crate) messages: u64,
    /// Type and number of messages by topic.
    pub(crate) topics: BTreeMap<String, (String, u64)>,
}

/// What is missing at a damaged place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Missing {
    /// The place.
    pub gap: Gap,
    /// Time of the last message before it, counted from the first of the recording [s]; `None` if that is not known.
    pub from_s: Option<f64>,
    /// Time of the first one behind it [s]; `None` when nothing follows and the end is not known.
    pub to_s: Option<f64>,
}

impl std::fmt::Display for Missing {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { gap, from_s, to_s } = self;
        write!(formatter, "byte {}, {}: ", gap.at, gap.what)?;
        if !gap.is_data {
            return write!(formatter, "nothing of the drive");
        }
        match (from_s, to_s) {
            (Some(from_s), Some(to_s)) => {
                write!(formatter, "up to {:.2} s, between {from_s:.2} s and {to_s:.2} s", to_s - from_s)
            }
            (Some(from_s), None) => write!(formatter, "what followed {from_s:.2} s"),
            (None, Some(to_s)) if *to_s > 0.0 => write!(formatter, "something in front of {to_s:.2} s"),
            (None, None) if gap.what == Damage::Count => write!(formatter, "at a time that is not known"),
            (None, _) => write!(formatter, "what came before the first message that is left"),
        }
    }
}
