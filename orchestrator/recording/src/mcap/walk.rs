//! Walks over the records of a file, also of several files that were joined, and notes where their messages are.
//!
//! Only heads are read of chunks. In a salvage, what is no record is skipped up to the next place at which one begins.

mod trust;

use std::io::{Read, Seek};

use super::contents::{Contents, MAX_HELD, MAX_TEXT};
use super::damage::Fault;
use super::index::{Index, Part, Place};
use super::input::{Head, Input};
use super::named::NamedChunks;
use super::unpack::{self, ChunkHead, MAX_CHUNK};
use super::{Damage, MAGIC, ReadError, opcode, sound};

/// Messages outside of chunks are read in parts of about this size [bytes].
const LOOSE_BYTES: u64 = 1 << 18;
/// So many files may be joined to one.
const MAX_FILES: usize = 1024;

/// Walks over a file.
///
/// # Errors
/// Another file; damage, unless it is a salvage.
pub(super) fn index<R: Read + Seek>(input: &mut Input<R>, is_salvage: bool) -> Result<Index, ReadError> {
    let mut walk = Walk {
        input,
        is_salvage,
        index: Index::new(is_salvage),
        record: Vec::new(),
        is_open: false,
        begin: 0,
        is_guessed: false,
        data_end: None,
        has_chunks: false,
        has_loose: false,
    };
    let mut at = walk.begin()?;
    while at < walk.input.length() {
        at = walk.step(at)?;
    }
    walk.end_open();
    walk.index.named.sort();
    Ok(walk.index)
}

struct Walk<'a, R> {
    input: &'a mut Input<R>,
    is_salvage: bool,
    index: Index,
    record: Vec<u8>,
    /// Whether the end of the file that was begun is still to come.
    is_open: bool,
    /// Where this file begins.
    begin: u64,
    /// Whether this file was begun because something follows the end of another one.
    is_guessed: bool,
    /// Where the data of this file have ended.
    data_end: Option<u64>,
    /// Whether this file has chunks, and messages outside of them. The latter have no checksum, and are searched behind
    /// damage only in files that have them, or no chunk.
    has_chunks: bool,
    has_loose: bool,
}

impl<R: Read + Seek> Walk<'_, R> {
    /// Begins the first file; returns where its records begin.
    fn begin(&mut self) -> Result<u64, ReadError> {
        let magic = MAGIC.len() as u64;
        if self.input.has_magic(0)? {
            self.open(0)?;
            return Ok(magic);
        }
        // The first bytes may be the ones that are damaged.
        let length = self.input.length();
        let has_end = length > 2 * magic && self.input.has_magic(length - magic)?;
        let has_start = self.is_record(magic)?;
        let searched = has_end || self.is_salvage;
        let next = match has_start {
            true => Some(magic),
            false if searched => self.next_record(1)?,
            false => None,
        };
        let Some(next) = next else { return Err(ReadError::Foreign) };
        self.open(0)?;
        self.note(0, Damage::Magic, None)?;
        Ok(next)
    }

    fn open(&mut self, at: u64) -> Result<(), ReadError> {
        if self.index.files.len() == MAX_FILES {
            let what = format!("more than {MAX_FILES} joined files");
            return Err(ReadError::Unsupported { at, what });
        }
        self.index.files.push(Contents::default());
        (self.is_open, self.is_guessed, self.data_end) = (true, false, None);
        (self.begin, self.has_chunks, self.has_loose) = (at, false, false);
        Ok(())
    }

    /// No further record of the file follows, which may have no end.
    fn end_open(&mut self) {
        if !self.drop_guessed() && self.is_open {
            self.end_cut_off();
        }
    }

    /// What followed the end of a file was none if it has not one record; its damaged place belongs to the file before. False
    /// if it was one.
    fn drop_guessed(&mut self) -> bool {
        let Index { files, parts, places, .. } = &mut self.index;
        let file = files.len() - 1;
        let has_parts = parts.last().is_some_and(|part| part.file == file);
        let is_none = self.is_guessed && !has_parts && files[file].is_empty();
        if is_none {
            files.pop();
            // The file before has its end.
            for place in places.iter_mut().rev().take_while(|place| place.file == file) {
                (place.file, place.is_data) = (file - 1, false);
            }
        }
        is_none
    }

    /// The file that was begun has no end.
    fn end_cut_off(&mut self) {
        self.is_open = false;
        if self.is_salvage && self.data_end.is_none() {
            let (at, part, file) = (self.input.length(), self.index.parts.len(), self.index.files.len() - 1);
            let what = Damage::CutOff;
            self.index.places.push(Place { file, at, what, is_data: true, part, until_ns: None });
        }
    }

    /// Takes in the record at a place; returns where the next one begins.
    fn step(&mut self, at: u64) -> Result<u64, ReadError> {
        if self.input.has_magic(at)? {
            let next = at + MAGIC.len() as u64;
            let is_end = self.is_open && (next == self.input.length() || self.input.has_magic(next)?);
            self.end_open();
            // The end of a file may follow a damaged footer.
            match is_end {
                true => self.is_open = false,
                false => self.open(at)?,
            }
            return Ok(next);
        }
        if !self.is_open {
            // Behind an end only another file may follow, whose first bytes may be damaged.
            if !self.is_salvage {
                return Err(ReadError::Damaged { at, what: Damage::Magic });
            }
            self.open(at)?;
            self.is_guessed = true;
            let (file, part) = (self.index.files.len() - 1, self.index.parts.len());
            let what = Damage::Magic;
            self.index.places.push(Place { file, at, what, is_data: false, part, until_ns: None });
        }
        let length = self.input.length();
        let Some(head) = self.input.head(at)? else { return Ok(length) };
        let fault = match self.record(head) {
            Ok(next) => return Ok(next),
            Err(Fault::Io(error)) => return Err(error.into()),
            Err(fault) => fault,
        };
        // No record is longer than what is held at most: its length is damaged.
        let is_cut_off = head.end() > length && head.length <= MAX_HELD && sound::is_known(head.opcode);
        if is_cut_off && self.is_last(&head)? {
            if self.is_salvage && !self.add_cut_chunk(&head)? {
                // How much followed is not known.
                self.note(at, Damage::CutOff, None)?;
            }
            return Ok(length);
        }
        if !self.is_salvage {
            return Err(fault.at(at));
        }
        let (end, until_ns) = (self.trusted_end(head)?, self.claimed_ns(head)?);
        let what = match &fault {
            Fault::Damage(what) => *what,
            _ => Damage::Refused,
        };
        if !matches!(fault, Fault::Damage(_)) {
            self.index.refusal.get_or_insert(fault.at(at));
        }
        self.note(at, what, until_ns)?;
        match end {
            Some(end) => Ok(end),
            None => Ok(self.next_record(at + 1)?.unwrap_or(length)),
        }
    }

    /// Notes a damaged place, or returns it as the error.
    fn note(&mut self, at: u64, what: Damage, until_ns: Option<u64>) -> Result<(), ReadError> {
        match self.is_salvage {
            true => self.note_place(at, what, self.data_end.is_none(), until_ns),
            false => return Err(ReadError::Damaged { at, what }),
        }
        Ok(())
    }

    fn note_place(&mut self, at: u64, what: Damage, is_data: bool, until_ns: Option<u64>) {
        let (part, file) = (self.index.parts.len(), self.index.files.len() - 1);
        match self.index.places.last_mut().filter(|last| (last.part, last.file) == (part, file)) {
            Some(last) => {
                last.until_ns = last.until_ns.max(until_ns);
                last.is_data |= is_data;
            }
            None => self.index.places.push(Place { file, at, what, is_data, part, until_ns }),
        }
    }

    fn record(&mut self, mut head: Head) -> Result<u64, Fault> {
        let chunk = Head { opcode: opcode::CHUNK, ..head };
        // Its length stands there twice.
        let is_hidden_chunk = head.opcode != opcode::CHUNK
            && head.end() <= self.input.length()
            && sound::has_fields(self.input, &chunk)?;
        if is_hidden_chunk && self.is_salvage {
            self.note_place(head.at, Damage::Opcode, false, None);
            head = chunk;
        } else if is_hidden_chunk || head.opcode == 0 {
            return Err(Damage::Opcode.into());
        }
        if head.end() > self.input.length() {
            return Err(Damage::Length.into());
        }
        self.check_end(&head)?;
        let file = self.index.files.len() - 1;
        match head.opcode {
            opcode::CHUNK => {
                self.require_data(head.at)?;
                self.input.read(head.body(), head.length.min(unpack::FIELDS), &mut self.record)?;
                ChunkHead::read(&head, &self.record)?;
                self.has_chunks = true;
                self.index.parts.push(Part { at: head.at, end: head.end(), file, is_chunk: true });
            }
            opcode::MESSAGE => {
                // Indices and channels are repeated in a file with chunks, and some have a damaged first byte.
                if self.is_salvage && self.has_chunks && sound::is_other_record(self.input, &head)? {
                    return Err(Damage::Opcode.into());
                }
                self.require_data(head.at)?;
                // A copy of it stands in a chunk.
                let (bytes, limit) = (head.length.saturating_add(Head::BYTES), MAX_CHUNK);
                if bytes > limit {
                    return Err(Fault::TooLarge { what: "a message", bytes, limit });
                }
                self.input.read(head.body(), head.length.min(22), &mut self.record)?;
                super::contents::message(&self.record)?;
                self.has_loose = true;
                match self.index.parts.last_mut() {
                    Some(part)
                        if !part.is_chunk
                            && part.end == head.at
                            && head.end() - part.at <= LOOSE_BYTES
                            && self.index.places.last().is_none_or(|place| place.at < part.at) =>
                    {
                        part.end = head.end();
                    }
                    _ => self.index.parts.push(Part { at: head.at, end: head.end(), file, is_chunk: false }),
                }
            }
            opcode::DATA_END if head.length == 4 => {
                self.require_data(head.at)?;
                self.data_end = Some(head.end());
            }
            opcode::DATA_END => return Err(Damage::Length.into()),
            opcode::HEADER if self.has_chunks || self.has_loose || !self.index.files[file].is_empty() => {
                return Err(Damage::Misplaced.into());
            }
            opcode::FOOTER => return self.footer(head),
            opcode if sound::is_loaded(opcode) => {
                let limit = if opcode == opcode::ATTACHMENT { MAX_HELD } else { MAX_TEXT };
                if head.length > limit {
                    let bytes = head.length;
                    return Err(Fault::TooLarge { what: "an attached file or a text", bytes, limit });
                }
                let mut record = std::mem::take(&mut self.record);
                self.input.read(head.body(), head.length, &mut record)?;
                let Index { files, memory, .. } = &mut self.index;
                let defined = files[file].define(opcode, &record, memory, false);
                self.record = record;
                defined?;
            }
            opcode if sound::is_known(opcode) => {
                if !sound::has_fields(self.input, &head)? {
                    return Err(Damage::Length.into());
                }
                if opcode == opcode::CHUNK_INDEX && self.is_salvage {
                    self.input.read(head.body(), head.length.min(24), &mut self.record)?;
                    self.index.memory.hold(NamedChunks::BYTES)?;
                    self.index.named.add(file, self.begin, &self.record)?;
                }
            }
            // Records of other programs are skipped.
            _ => {}
        }
        Ok(head.end())
    }

    /// Adds what is there of the last chunk; false where too little is.
    fn add_cut_chunk(&mut self, head: &Head) -> Result<bool, ReadError> {
        let is_chunk = self.has_chunk_fields(head)?;
        if is_chunk {
            let (file, end) = (self.index.files.len() - 1, self.input.length());
            self.index.parts.push(Part { at: head.at, end, file, is_chunk });
        }
        Ok(is_chunk)
    }

    /// Messages stand in front of the end of the data; behind a damaged place that end may be a wrong one.
    fn require_data(&mut self, at: u64) -> Result<(), Fault> {
        if self.data_end.is_some() {
            if !self.is_salvage {
                return Err(Damage::Misplaced.into());
            }
            self.note_place(at, Damage::Misplaced, false, None);
            self.data_end = None;
        }
        Ok(())
    }

    /// The end of a file: checks the summary, and that the bytes of the format follow.
    fn footer(&mut self, head: Head) -> Result<u64, Fault> {
        if head.length != 20 {
            return Err(Damage::Length.into());
        }
        let Some(data_end) = self.data_end else { return Err(Damage::Misplaced.into()) };
        self.input.read(head.body() + 16, 4, &mut self.record)?;
        let expected = u32::from_le_bytes(self.record[..].try_into().map_err(|_| Damage::Short)?);
        if expected != 0 && self.input.checksum(data_end, head.body() + 16)? != expected {
            if let Some(contents) = self.index.files.last_mut() {
                contents.statistics = None;
            }
            self.index.named.forget(self.index.files.len() - 1);
            return Err(Damage::Checksum.into());
        }
        if self.input.length() - head.end() < MAGIC.len() as u64 {
            // Cut off within the last bytes.
            return Ok(self.input.length());
        }
        if !self.input.has_magic(head.end())? {
            return Err(Damage::Magic.into());
        }
        if let Some(contents) = self.index.files.last_mut() {
            contents.is_complete = true;
        }
        self.is_open = false;
        Ok(head.end() + MAGIC.len() as u64)
    }
}
