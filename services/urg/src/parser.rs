//! Reads the replies of a scanner from a stream of bytes.
//!
//! A reply is an echo of the command, a status, lines with data, and an empty line. The parser takes one byte at a
//! time, so the bytes may come in any pieces. Its memory is fixed, whatever comes. Scans are read strictly: a wrong
//! checksum drops the scan, and only that one. Other replies are read leniently, because scanners with wrong checksums
//! in them are in use.

use crate::coding::{append, decode, verified};
use crate::command::Measurement;
use crate::status::ScipStatus;

/// Most ranges of a scan.
pub const MAX_RANGES: usize = 4096;
/// Longest line of a reply; lines of a scan have 65 bytes.
const MAX_LINE: usize = 160;
/// Longest text of a reply.
const MAX_TEXT: usize = 2048;

/// Why a reply was dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ReplyFault {
    /// The checksum of a line is wrong.
    #[error("wrong checksum")]
    Checksum,
    /// A line or a reply is longer than any of a scanner.
    #[error("too long")]
    TooLong,
    /// A reply ended early.
    #[error("incomplete")]
    Incomplete,
    /// A scan has more or fewer ranges than its echo announces.
    #[error("wrong number of ranges")]
    Count,
    /// The echo of a scan names another measurement.
    #[error("wrong echo")]
    Echo,
}

/// What a byte has completed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Completed {
    /// A reply without ranges: see [`Parser::echo`], [`Parser::status`], [`Parser::text`].
    Answer,
    /// A scan: see [`Parser::measurement`], [`Parser::stamp`], [`Parser::ranges`].
    Scan,
    /// A scan that was dropped. If its first lines are in order, [`Parser::stamp`] has its time.
    BrokenScan(ReplyFault),
    /// Bytes that are no reply.
    Garbage(ReplyFault),
}

/// Which line is expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Expected {
    Echo,
    Status,
    Text,
    Stamp,
    Ranges,
    /// The end of a reply that is dropped.
    End,
}

/// A text of bounded length.
#[derive(Debug, Clone)]
struct Bounded<const N: usize> {
    bytes: [u8; N],
    length: usize,
    is_cut: bool,
}

impl<const N: usize> Bounded<N> {
    const EMPTY: Self = Self { bytes: [0; N], length: 0, is_cut: false };

    fn clear(&mut self) {
        (self.length, self.is_cut) = (0, false);
    }

    fn push(&mut self, byte: u8) {
        match self.bytes.get_mut(self.length) {
            Some(place) => (*place, self.length) = (byte, self.length + 1),
            None => self.is_cut = true,
        }
    }

    fn get(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

/// The parser with the reply that it reads.
#[derive(Debug, Clone)]
pub struct Parser {
    expected: Expected,
    line: Bounded<MAX_LINE>,
    echo: Bounded<MAX_LINE>,
    text: Bounded<MAX_TEXT>,
    status: ScipStatus,
    /// Of a reply with ranges.
    measurement: Option<Measurement>,
    stamp: Option<u32>,
    /// Measurement and stamp of a scan that the echo of the next one has cut short, until the next line.
    cut: Option<(Option<Measurement>, Option<u32>)>,
    ranges: Vec<u32>,
    /// A range of which only the first characters have come, and their number.
    partial: (u32, u8),
    fault: Option<ReplyFault>,
}

impl Default for Parser {
    fn default() -> Self {
        Self {
            expected: Expected::Echo,
            line: Bounded::EMPTY,
            echo: Bounded::EMPTY,
            text: Bounded::EMPTY,
            status: ScipStatus::default(),
            measurement: None,
            stamp: None,
            cut: None,
            ranges: Vec::with_capacity(MAX_RANGES),
            partial: (0, 0),
            fault: None,
        }
    }
}

impl Parser {
    /// Drops what was read of a reply.
    pub fn reset(&mut self) {
        self.line.clear();
        self.expected = Expected::Echo;
    }

    /// Echo of the reply.
    pub fn echo(&self) -> &[u8] {
        self.echo.get()
    }

    /// Status of the reply.
    pub fn status(&self) -> ScipStatus {
        self.status
    }

    /// Lines of the reply, each with its checksum and a line feed.
    pub fn text(&self) -> &[u8] {
        self.text.get()
    }

    /// What the scan is, with the number of scans that are left.
    pub fn measurement(&self) -> Option<Measurement> {
        self.cut.map_or(self.measurement, |(measurement, _)| measurement)
    }

    /// Time stamp of the scan [ms, 24 bits].
    pub fn stamp(&self) -> Option<u32> {
        self.cut.map_or(self.stamp, |(_, stamp)| stamp)
    }

    /// Ranges of the scan; small ones are error codes [mm].
    pub fn ranges(&self) -> &[u32] {
        &self.ranges
    }

    /// Takes the next byte.
    #[inline]
    pub fn push(&mut self, byte: u8) -> Option<Completed> {
        if byte != b'\n' {
            self.line.push(byte);
            return None;
        }
        let completed = self.end_line();
        self.line.clear();
        completed
    }

    fn end_line(&mut self) -> Option<Completed> {
        self.cut = None;
        if self.line.get().is_empty() {
            return self.end_reply();
        }
        if self.line.is_cut {
            return self.refuse(ReplyFault::TooLong);
        }
        if self.expected != Expected::Echo && self.is_next_echo() {
            let (completed, cut) = (self.end_early(), (self.measurement, self.stamp));
            self.begin();
            self.cut = Some(cut);
            return completed;
        }
        match self.expected {
            Expected::Echo => self.begin(),
            Expected::Status => self.take_status(),
            Expected::Text => self.take_text(),
            Expected::Stamp => self.take_stamp(),
            Expected::Ranges => self.take_ranges(),
            Expected::End => {}
        }
        None
    }

    /// Whether the line is the echo of a scan although the previous reply has not ended: some of it was lost.
    fn is_next_echo(&self) -> bool {
        let line = self.line.get();
        line[0] == b'M' && Measurement::of_echo(line).is_some() && verified(line).is_none()
    }

    fn begin(&mut self) {
        self.echo.clone_from(&self.line);
        self.text.clear();
        self.measurement = None;
        self.stamp = None;
        self.ranges.clear();
        self.partial = (0, 0);
        self.fault = None;
        self.status = ScipStatus::default();
        self.expected = Expected::Status;
    }

    fn take_status(&mut self) {
        let line = self.line.get();
        self.status = match (line, verified(line)) {
            (_, Some(&[tens, ones])) => ScipStatus([tens, ones]),
            (&[only], _) => ScipStatus([only, 0]),
            _ => return self.spoil(ReplyFault::Checksum),
        };
        let measurement = Measurement::of_echo(self.echo.get());
        let has_ranges = |measurement: &Measurement| {
            self.status == if measurement.single { ScipStatus::DONE } else { ScipStatus::SCAN }
        };
        self.measurement = measurement.filter(has_ranges);
        self.expected = if self.measurement.is_some() { Expected::Stamp } else { Expected::Text };
    }

    fn take_text(&mut self) {
        let Self { line, text, .. } = self;
        line.get().iter().chain(b"\n").for_each(|byte| text.push(*byte));
        if self.text.is_cut {
            self.spoil(ReplyFault::TooLong);
        }
    }

    fn take_stamp(&mut self) {
        let text = verified(self.line.get()).filter(|text| text.len() == 4);
        self.stamp = text.and_then(decode);
        match self.stamp {
            Some(_) => self.expected = Expected::Ranges,
            None => self.spoil(ReplyFault::Checksum),
        }
    }

    fn take_ranges(&mut self) {
        let Self { line, measurement, ranges, partial, .. } = self;
        let Some(text) = verified(line.get()) else { return self.spoil(ReplyFault::Checksum) };
        let characters = measurement.map_or(3, |measurement| measurement.coding.characters());
        for character in text {
            let Some(value) = append(partial.0, *character) else { return self.spoil(ReplyFault::Checksum) };
            *partial = (value, partial.1 + 1);
            if partial.1 == characters {
                if ranges.len() == MAX_RANGES {
                    return self.spoil(ReplyFault::TooLong);
                }
                ranges.push(value);
                *partial = (0, 0);
            }
        }
    }

    /// Drops the reply, whose rest is read until its end.
    fn spoil(&mut self, fault: ReplyFault) {
        self.fault = Some(fault);
        self.expected = Expected::End;
    }

    fn refuse(&mut self, fault: ReplyFault) -> Option<Completed> {
        self.spoil(fault);
        None
    }

    /// An empty line.
    fn end_reply(&mut self) -> Option<Completed> {
        let expected = std::mem::replace(&mut self.expected, Expected::Echo);
        match expected {
            // Some scanners send an additional empty line.
            Expected::Echo => None,
            Expected::Text => Some(Completed::Answer),
            Expected::Ranges if self.is_complete() => Some(Completed::Scan),
            Expected::Ranges => Some(Completed::BrokenScan(ReplyFault::Count)),
            Expected::Stamp | Expected::Status => self.dropped(ReplyFault::Incomplete),
            Expected::End => self.dropped(self.fault.unwrap_or(ReplyFault::Incomplete)),
        }
    }

    /// The next reply has begun before this one ended.
    fn end_early(&mut self) -> Option<Completed> {
        self.dropped(self.fault.unwrap_or(ReplyFault::Incomplete))
    }

    fn dropped(&self, fault: ReplyFault) -> Option<Completed> {
        Some(if self.measurement.is_some() {
            Completed::BrokenScan(fault)
        } else {
            Completed::Garbage(fault)
        })
    }

    fn is_complete(&self) -> bool {
        let expected = self.measurement.map(|measurement| measurement.ranges());
        self.partial.1 == 0 && expected == Some(self.ranges.len())
    }
}
