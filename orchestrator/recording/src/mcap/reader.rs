//! Reads the messages of MCAP files, also of several files that were joined.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Seek};
use std::ops::Range;

use super::contents::message;
use super::damage::Fault;
use super::fields::Fields;
use super::gaps::{Counted, Gap, Gaps};
use super::index::{Index, Part, Place};
use super::input::{Head, Input};
use super::unpack::{self, ChunkHead};
use super::walk::index;
use super::{Channel, Contents, Damage, McapMessage, ReadError, Schema, opcode, sound};

/// What a part holds.
#[derive(Debug)]
struct Loaded {
    /// First and last log time of its messages [ns]; `None` for schemas and channels alone, and what was read before.
    times_ns: Option<[u64; 2]>,
    /// In a salvage, what is wrong with it, and whether messages may be missing.
    damage: Option<(Damage, bool)>,
}

/// Reads a file message by message.
#[derive(Debug)]
pub struct McapReader<R> {
    input: Input<R>,
    index: Index,
    is_salvage: bool,
    /// The part that is read next.
    next: usize,
    current: Option<Part>,
    content: Vec<u8>,
    place: usize,
    record: Vec<u8>,
    /// Messages that were read of each joined file, by channel; `None` after a jump.
    counts: Option<Vec<BTreeMap<u16, u64>>>,
    /// The file that is read, whose damaged places are noted.
    noted: usize,
    gaps: Gaps,
    /// The first damaged place that was not passed.
    place_ahead: usize,
    /// The chunks that were read of files whose summary names chunks: file, times and checksum.
    chunks: BTreeSet<(usize, [u64; 2], u32)>,
    /// Definitions that are assumed where a damaged file has none.
    assumed: (BTreeMap<u16, Schema>, BTreeMap<u16, Channel>),
}

impl<R: Read + Seek> McapReader<R> {
    /// A reader at the start of a file.
    ///
    /// # Errors
    /// [`ReadError::Foreign`] for other files, and all that is wrong with the records around the messages.
    pub fn new(input: R) -> Result<Self, ReadError> {
        Self::with(input, false)
    }

    /// A reader that skips what is damaged; [`McapReader::gaps`] tells what was skipped.
    ///
    /// # Errors
    /// [`ReadError::Foreign`] for other files.
    pub fn salvage(input: R) -> Result<Self, ReadError> {
        Self::with(input, true)
    }

    fn with(input: R, is_salvage: bool) -> Result<Self, ReadError> {
        let mut input = Input::new(input)?;
        let index = index(&mut input, is_salvage)?;
        let counts = Some(vec![BTreeMap::new(); index.files.len()]);
        Ok(Self {
            input,
            index,
            is_salvage,
            next: 0,
            current: None,
            content: Vec::new(),
            place: 0,
            record: Vec::new(),
            counts,
            noted: 0,
            gaps: Gaps::default(),
            place_ahead: 0,
            chunks: BTreeSet::new(),
            assumed: Default::default(),
        })
    }

    /// Whether it skips what is damaged.
    pub(crate) fn is_salvage(&self) -> bool {
        self.is_salvage
    }

    /// What the file holds beside the messages, from which the last message is; of joined files the first at the start.
    pub fn contents(&self) -> &Contents {
        &self.index.files[self.file()]
    }

    /// The files that were joined to this one; mostly one.
    pub fn files(&self) -> &[Contents] {
        &self.index.files
    }

    /// Which of the joined files the last message is from.
    pub fn file(&self) -> usize {
        self.current.map_or(0, |part| part.file)
    }

    /// The same at the end.
    pub fn into_contents(mut self) -> Contents {
        self.index.files.swap_remove(self.current.map_or(0, |part| part.file))
    }

    /// In a salvage, messages of channels that the file does not define are taken for these.
    pub fn assume(&mut self, schemas: &[Schema], channels: &[Channel]) {
        self.assumed.0 = (1..).zip(schemas.iter().cloned()).collect();
        self.assumed.1 = (0..).zip(channels.iter().cloned()).collect();
    }

    /// The next message; `None` at the end of the data, or where the file was cut off.
    ///
    /// # Errors
    /// [`ReadError::Damaged`] and errors of the file system; in a salvage only the latter, and at the end the reason if not
    /// one message could be read.
    pub fn next_message(&mut self) -> Result<Option<McapMessage<'_>>, ReadError> {
        loop {
            let mut fields = Fields(self.content.get(self.place..).unwrap_or_default());
            if fields.0.is_empty() {
                if !self.open_part()? {
                    self.end()?;
                    return Ok(None);
                }
                continue;
            }
            // All records of a part were walked over when it was opened.
            let start = self.place + Head::BYTES as usize;
            let (opcode, length) =
                (fields.u8().unwrap_or_default(), fields.u64().unwrap_or_default() as usize);
            self.place = start + length;
            if opcode != opcode::MESSAGE {
                continue;
            }
            let file = self.file();
            let at = self.chunk_at();
            let Ok(found) = message(&self.content[start..start + length]) else { continue };
            let channel = found.channel;
            if !self.index.files[file].channels.contains_key(&channel) && !self.define_assumed(channel) {
                if !self.is_salvage {
                    return Err(ReadError::Damaged { at, what: Damage::Channel });
                }
                self.gaps.note(file, at, Damage::Channel, true, None);
                continue;
            }
            if let Some(counts) = &mut self.counts {
                *counts[file].entry(channel).or_default() += 1;
            }
            let body = start..start + length;
            return message(&self.content[body]).map(Some).map_err(|what| ReadError::Damaged { at, what });
        }
    }

    /// Byte of the file at which the chunk of the last message begins.
    pub fn chunk_at(&self) -> u64 {
        self.current.map_or(0, |part| part.at)
    }

    /// Whether all messages of the open chunk were read.
    pub fn is_chunk_over(&self) -> bool {
        self.place >= self.content.len()
    }

    /// Continues with the chunk that begins at a byte of the file, see [`McapReader::chunk_at`]; false if there is
    /// none.
    pub fn seek_to_chunk(&mut self, at: u64) -> bool {
        let found = self.index.parts.binary_search_by_key(&at, |part| part.at);
        (self.content, self.place, self.current, self.counts) = (Vec::new(), 0, None, None);
        self.next = found.unwrap_or(self.index.parts.len());
        found.is_ok()
    }

    /// The damaged places that were passed until now.
    pub fn gaps(&self) -> &[Gap] {
        self.gaps.found()
    }

    /// Messages of these files that are missing by what the summaries count, of the channels that `counts`; `None` when a
    /// summary is missing.
    pub fn missing(&self, mut files: Range<usize>, counts: impl Fn(&str) -> bool) -> Option<u64> {
        files.try_fold(0_u64, |sum, file| Some(sum.saturating_add(self.missing_in(file, &counts)?)))
    }

    fn missing_in(&self, file: usize, counts: impl Fn(&str) -> bool) -> Option<u64> {
        let contents = self.index.files.get(file)?;
        let (counted, found) = (contents.statistics.as_ref()?, self.counts.as_ref()?.get(file)?);
        // Counts by channel may be left out.
        if counted.channels.is_empty() {
            return Some(counted.messages.saturating_sub(found.values().sum()));
        }
        let topic = |channel| contents.channels.get(channel).map_or("", |channel| channel.topic.as_str());
        let is_counted = |channel| topic(channel).is_empty() || counts(topic(channel));
        let missing = |(channel, expected): (&u16, &u64)| {
            expected.saturating_sub(found.get(channel).copied().unwrap_or_default())
        };
        let counted = counted.channels.iter().filter(|(channel, _)| is_counted(channel));
        Some(counted.map(missing).fold(0, u64::saturating_add))
    }

    /// Attached files and texts of these files that are missing by what the summaries count; `None` when a summary is missing.
    pub fn missing_attachments(&self, files: Range<usize>) -> Option<u64> {
        let of = |contents: &Contents| {
            let counted = contents.statistics.as_ref()?.attached.map(u64::from);
            let found = [contents.attachments.len() as u64, contents.metadata.len() as u64];
            Some(counted[0].saturating_sub(found[0]) + counted[1].saturating_sub(found[1]))
        };
        self.index.files.get(files)?.iter().map(of).sum()
    }

    /// Opens the next part; false at the end.
    fn open_part(&mut self) -> Result<bool, ReadError> {
        loop {
            self.take_places(self.next);
            let Some(part) = self.index.parts.get(self.next).copied() else { return Ok(false) };
            self.next += 1;
            self.end_files(part.file);
            self.current = Some(part);
            self.place = 0;
            match self.load(part) {
                Ok(Loaded { times_ns, damage }) => {
                    // What was cut off lies behind the messages, all else between them.
                    let is_cut_off = matches!(damage, Some((Damage::CutOff, _)));
                    if let Some((what, is_data)) = damage.filter(|_| !is_cut_off) {
                        let last_ns = times_ns.map(|[_, last_ns]| last_ns);
                        self.gaps.note(part.file, part.at, what, is_data, last_ns);
                    }
                    if let Some(times_ns) = times_ns {
                        let counted = self.contents().statistics.as_ref();
                        self.gaps.end_at(times_ns, counted.map(|counted| counted.times[0]));
                        self.index.files[part.file].chunks += u64::from(self.counts.is_some());
                    }
                    if is_cut_off {
                        self.gaps.note(part.file, part.at, Damage::CutOff, true, None);
                    }
                    if times_ns.is_some() {
                        return Ok(true);
                    }
                    self.content.clear();
                }
                Err(Fault::Io(error)) => return Err(error.into()),
                Err(fault) if !self.is_salvage => return Err(fault.at(part.at)),
                Err(fault) => {
                    self.content.clear();
                    let what = if let Fault::Damage(what) = fault { what } else { Damage::Refused };
                    if !matches!(fault, Fault::Damage(_)) {
                        self.index.refusal.get_or_insert(fault.at(part.at));
                    }
                    self.gaps.note(part.file, part.at, what, true, self.claimed_ns());
                }
            }
        }
    }

    /// Reads a part and walks over its records.
    fn load(&mut self, part: Part) -> Result<Loaded, Fault> {
        let content = if part.is_chunk { &mut self.record } else { &mut self.content };
        self.input.read(part.at, part.end - part.at, content)?;
        if content.len() as u64 != part.end - part.at {
            return Err(Damage::CutOff.into());
        }
        let mut damage = None;
        if part.is_chunk {
            let mut fields = Fields(&self.record);
            fields.take(1)?;
            let (length, record) = (fields.u64()?, fields.0);
            let head = Head { at: part.at, opcode: opcode::CHUNK, length };
            let chunk = ChunkHead::read(&head, &record[..record.len().min(unpack::FIELDS as usize)])?;
            let is_cut_off = head.end() > part.end;
            match is_cut_off {
                true => chunk.unpack_start(record, &mut self.content),
                false => chunk.unpack(record, &mut self.content)?,
            }
            if self.is_salvage {
                damage = keep_records(&mut self.content, is_cut_off).map(|what| (what, true));
            }
        }
        let mut times: Option<[u64; 2]> = None;
        let mut fields = Fields(&self.content);
        while !fields.0.is_empty() {
            let (opcode, body) = next_record(&mut fields)?;
            match opcode {
                opcode::MESSAGE => {
                    let log_ns = message(body)?.log_ns;
                    let [first, last] = times.unwrap_or([log_ns; 2]);
                    times = Some([first.min(log_ns), last.max(log_ns)]);
                }
                opcode::SCHEMA | opcode::CHANNEL => {
                    let Index { files, memory, .. } = &mut self.index;
                    match files[part.file].define(opcode, body, memory, false) {
                        Err(Fault::Damage(what)) if self.is_salvage => {
                            damage.get_or_insert((what, false));
                            // A chunk has a checksum, a damaged summary may have none.
                            if what == Damage::Misplaced {
                                files[part.file].define(opcode, body, memory, true)?;
                            }
                        }
                        defined => defined?,
                    }
                }
                // Those of other programs.
                _ if !sound::is_known(opcode) => {}
                // Nothing else may stand in a chunk; an attached file would be unpacked with it.
                _ if !self.is_salvage => return Err(Damage::Misplaced.into()),
                _ => _ = damage.get_or_insert((Damage::Misplaced, true)),
            }
        }
        if part.is_chunk && self.index.named.has(part.file) {
            let times_ns = times.unwrap_or_default();
            let is_named = self.index.named.read(part.file, times_ns);
            let is_new = self.chunks.insert((part.file, times_ns, crc32fast::hash(&self.record)));
            if !is_named && !is_new && self.index.files[part.file].is_complete {
                return Ok(Loaded { times_ns: None, damage: Some((Damage::Repeated, false)) });
            }
        }
        Ok(Loaded { times_ns: times, damage })
    }

    /// The last time that the head of the chunk names which could not be read [ns].
    fn claimed_ns(&self) -> Option<u64> {
        let record = self.record.get(Head::BYTES as usize..)?;
        self.current.filter(|part| part.is_chunk).and_then(|_| unpack::last_ns(record))
    }

    /// Takes in the damaged places in front of a part.
    fn take_places(&mut self, part: usize) {
        while let Some(place) = self.index.places.get(self.place_ahead).copied() {
            let Place { file, at, what, is_data, until_ns, .. } = place;
            if place.part > part {
                break;
            }
            self.place_ahead += 1;
            self.end_files(file);
            self.gaps.note(file, at, what, is_data, until_ns);
        }
    }

    /// No further message of the files in front of one is read.
    fn end_files(&mut self, next: usize) {
        while self.noted < next {
            let file = self.noted;
            let counted = self.counted(file);
            self.gaps.end_file(file, self.chunk_at(), counted, &self.index.named.unread(file));
            self.noted += 1;
        }
    }

    /// What was counted of a file; `None` without a summary.
    fn counted(&self, file: usize) -> Option<Counted> {
        let counted = self.index.files[file].statistics.as_ref()?;
        let found: u64 = self.counts.as_ref()?.get(file)?.values().sum();
        let missing = self.missing_in(file, |_| true)?;
        Some(Counted { missing, differs: counted.messages != found, times_ns: counted.times })
    }

    /// All parts were read: the summaries must count as many messages.
    fn end(&mut self) -> Result<(), ReadError> {
        self.end_files(self.index.files.len());
        let read: u64 = self.counts.iter().flatten().flat_map(BTreeMap::values).sum();
        if self.is_salvage {
            return match self.index.refusal.take_if(|_| read == 0 && self.counts.is_some()) {
                Some(refusal) => Err(refusal),
                None => Ok(()),
            };
        }
        for (contents, found) in self.index.files.iter().zip(self.counts.iter().flatten()) {
            let counted = contents.statistics.as_ref().map(|statistics| statistics.messages);
            if contents.is_complete && counted.is_some_and(|counted| counted != found.values().sum::<u64>()) {
                return Err(ReadError::Damaged { at: self.chunk_at(), what: Damage::Count });
            }
        }
        // Where a damaged first byte makes a record one of another program.
        match self.missing_attachments(0..self.index.files.len()) {
            Some(1..) => Err(ReadError::Damaged { at: self.chunk_at(), what: Damage::Attached }),
            _ => Ok(()),
        }
    }

    /// Takes a channel for the assumed one of its number; false if there is none.
    fn define_assumed(&mut self, number: u16) -> bool {
        let (schemas, channels) = &self.assumed;
        let Some(channel) = channels.get(&number) else { return false };
        let file = self.current.map_or(0, |part| part.file);
        let contents = &mut self.index.files[file];
        if let Some(schema) = schemas.get(&channel.schema) {
            contents.schemas.entry(channel.schema).or_insert_with(|| schema.clone().into());
        }
        contents.channels.insert(number, channel.clone());
        true
    }
}

/// The next record of a chunk.
fn next_record<'a>(fields: &mut Fields<'a>) -> Result<(u8, &'a [u8]), Damage> {
    let (opcode, length) = (fields.u8()?, fields.u64()?);
    if opcode == 0 {
        return Err(Damage::Misplaced);
    }
    let body = fields.take(usize::try_from(length).map_err(|_| Damage::Short)?)?;
    if opcode == opcode::MESSAGE {
        message(body)?;
    }
    Ok((opcode, body))
}

/// Keeps the whole records of a chunk, whatever stands between or behind them; returns what is wrong there.
fn keep_records(content: &mut Vec<u8>, is_cut_off: bool) -> Option<Damage> {
    let is_inner = |opcode| matches!(opcode, opcode::SCHEMA | opcode::CHANNEL | opcode::MESSAGE);
    let (mut kept, mut at, mut damage) = (0, 0, is_cut_off.then_some(Damage::CutOff));
    while at < content.len() {
        let mut fields = Fields(&content[at..]);
        let found = next_record(&mut fields);
        let (is_followed, end) =
            (fields.0.first().is_none_or(|next| is_inner(*next)), content.len() - fields.0.len());
        match found {
            // In front of anything, or behind something wrong if another one follows.
            Ok((opcode, _)) if damage.is_none() || is_cut_off || is_inner(opcode) && is_followed => {
                content.copy_within(at..end, kept);
                (kept, at) = (kept + end - at, end);
            }
            _ if is_cut_off => break,
            found => {
                damage.get_or_insert(found.err().unwrap_or(Damage::Misplaced));
                at += 1;
            }
        }
    }
    content.truncate(kept);
    damage
}
