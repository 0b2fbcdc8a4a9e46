//! Whether a record of a damaged file is believed, and where the next one begins.

use std::io::{self, Read, Seek};

use super::Walk;
use crate::mcap::damage::Fault;
use crate::mcap::input::Head;
use crate::mcap::unpack::{self, ChunkHead, MAX_CHUNK};
use crate::mcap::{Damage, ReadError, opcode, sound};

impl<R: Read + Seek> Walk<'_, R> {
    /// In a salvage, a record behind which none follows is believed only if none begins within it.
    pub(super) fn check_end(&mut self, head: &Head) -> Result<(), Fault> {
        if !self.is_salvage || head.end() == self.input.length() || self.is_record(head.end())? {
            return Ok(());
        }
        match head.opcode {
            opcode::CHUNK if head.length <= MAX_CHUNK + unpack::FIELDS && !self.input.is_exhausted() => {
                self.input.read(head.body(), head.length, &mut self.record)?;
                let fields = self.record.len().min(unpack::FIELDS as usize);
                let chunk = ChunkHead::read(head, &self.record[..fields])?;
                let mut content = Vec::new();
                let unpacked = chunk.unpack(&self.record, &mut content);
                self.input.spend(content.len());
                Ok(unpacked?)
            }
            // These have a checksum.
            opcode::ATTACHMENT => Ok(()),
            _ if self.input.is_exhausted() => Err(Damage::Length.into()),
            _ => match self.next_record(head.at + 1)? {
                Some(next) if next < head.end() => Err(Damage::Length.into()),
                _ => Ok(()),
            },
        }
    }

    /// Whether no record follows one that reaches behind the end of the file, but for those within a chunk.
    pub(super) fn is_last(&mut self, head: &Head) -> io::Result<bool> {
        let is_chunk = self.has_chunk_fields(head)?;
        let mut at = head.at + 1;
        while let Some(next) =
            sound::next_record(self.input, at, !is_chunk && (self.has_loose || !self.has_chunks))?
        {
            let within = self
                .input
                .head(next)?
                .filter(|found| is_chunk && matches!(found.opcode, opcode::SCHEMA | opcode::CHANNEL));
            let Some(within) = within else { return Ok(false) };
            at = within.end();
        }
        Ok(true)
    }

    /// Whether a record is a chunk by its first bytes; its length may reach behind the end of the file.
    pub(super) fn has_chunk_fields(&mut self, head: &Head) -> io::Result<bool> {
        Ok(head.opcode == opcode::CHUNK && sound::has_fields(self.input, head)?)
    }

    /// The last time that the head of a damaged chunk names [ns].
    pub(super) fn claimed_ns(&mut self, head: Head) -> Result<Option<u64>, ReadError> {
        if head.opcode != opcode::CHUNK {
            return Ok(None);
        }
        self.input.read(head.body(), 16, &mut self.record)?;
        Ok(unpack::last_ns(&self.record))
    }

    /// Where a record ends that is wrong in itself but whose length is right: a sound one follows.
    ///
    /// What lies within it must not be taken for records: an attached file may be a recording.
    pub(super) fn trusted_end(&mut self, head: Head) -> Result<Option<u64>, ReadError> {
        let is_one = sound::is_known(head.opcode) && head.end() < self.input.length();
        Ok((is_one && self.is_record(head.end())?).then_some(head.end()))
    }

    /// Whether a record begins at a place that another one names.
    pub(super) fn is_record(&mut self, at: u64) -> io::Result<bool> {
        sound::is_record(self.input, at, true)
    }

    /// The first place from `at` on at which a record begins.
    pub(super) fn next_record(&mut self, at: u64) -> io::Result<Option<u64>> {
        sound::next_record(self.input, at, self.has_loose || !self.has_chunks)
    }
}
