//! What a process knew when it computed its outputs: what a replay needs beside the samples themselves.

use crate::describe::layout;
use crate::named::wire_enum;
use crate::sample::sample;
use crate::{Fault, Header, Role};

/// How many entries a journal can hold; more continue in the next one.
pub const JOURNAL_ENTRIES: usize = 20;

wire_enum! {
    /// What an entry of a journal states.
    pub enum JournalKind {
        /// Nothing.
        None = 0 "none",
        /// The process took a sample: `topic`, `incarnation`, and its sequence number in `value`.
        Taken = 1 "taken",
        /// What was taken last is used; `value` is the time that the stage is told [ns].
        Used = 2 "used",
        /// A timeout did something, at the time `value` [ns].
        Timer = 3 "timer",
        /// The time budget ended a solution, which had read the clock `value` times before.
        Budget = 4 "budget",
        /// The wheels are blocked for a stop, at the time `value` [ns].
        Stopped = 5 "stopped",
        /// A stop has ended.
        Released = 6 "released",
        /// Commands were dropped before the process saw them.
        Dropped = 7 "dropped",
        /// The output that follows would have driven: the port made it a block.
        HeldBack = 8 "held_back",
        /// The process begins, at the time `value` [ns].
        Begun = 9 "begun",
        /// The process begins in stop, because the state of the one before it is lost.
        BegunInStop = 10 "begun_in_stop",
        /// The process continues from a checkpoint: `incarnation` has published it, with the sequence number `value`.
        Resumed = 11 "resumed",
        /// The process has published its checkpoint with the sequence number `value`.
        Saved = 12 "saved",
        /// An injected fault has changed a sample behind the process: `topic`, `incarnation`, and its sequence number in `value`.
        Injected = 13 "injected",
        /// An injected fault alters the emulated robot from now on (`value` 1), or no longer (0).
        Altered = 14 "altered",
        /// The sample or state of the next entry was handed over with its times moved by `value` [ns], in two's complement.
        Moved = 15 "moved",
        /// The wheels are blocked for an emergency stop, at the time `value` [ns].
        EmergencyStop = 16 "emergency_stop",
        /// A sample of a topic of your own was read, of the scan `value`; its fields follow.
        Own = 17 "own",
        /// The next field of that sample: the bits of an f64 in `value`.
        Number = 18 "number",
    }
}

layout! {
    /// One entry of a journal.
    pub struct JournalEntry(16) {
        /// What it states, `JournalKind`
        pub kind: u16,
        /// Topic of the sample, by its place in the table of topics
        pub topic: u16,
        /// Incarnation that has published the sample
        pub incarnation: u32,
        /// A sequence number, a time [ns] or a count
        pub value: u64,
    }
}

sample! {
    /// What one process did since its last output, in order. It comes before the output.
    pub struct Journal(624, Journal, 0xe7bc_8cba, "scanloop.Journal.v2", check) {
        /// Identity, without stamps: the scan of the output that follows
        pub header: Header,
        /// Slot of the process; the first five are those of a `Role`
        pub role: u32,
        /// How many of `entries` are used
        pub length: u32,
        /// Sequence number of the output that follows on the first topic of the role; 0 when only more entries follow
        pub output: u64,
        /// What happened
        pub entries: [JournalEntry; JOURNAL_ENTRIES],
    }
}

impl Journal {
    /// What happened, in order.
    pub fn used(&self) -> &[JournalEntry] {
        &self.entries[..(self.length as usize).min(JOURNAL_ENTRIES)]
    }

    /// Adds an entry; false when it is full.
    pub fn push(&mut self, entry: JournalEntry) -> bool {
        let Some(place) = self.entries.get_mut(self.length as usize) else { return false };
        *place = entry;
        self.length += 1;
        true
    }
}

fn check(journal: &Journal) -> Result<(), Fault> {
    journal.header.check::<Journal>()?;
    Role::try_from(journal.role)?;
    if journal.length as usize > JOURNAL_ENTRIES {
        return Err(Fault::OutOfRange { field: "length", value: f64::from(journal.length) });
    }
    journal.used().iter().try_for_each(|entry| JournalKind::try_from(u32::from(entry.kind)).map(|_| ()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sample;

    #[test]
    fn a_full_journal_takes_no_entry_and_an_unknown_one_is_refused() {
        let mut journal = Journal::default();
        journal.header.layout = Journal::LAYOUT;
        let entry = JournalEntry { kind: JournalKind::Taken.wire() as u16, ..JournalEntry::default() };
        for _ in 0..JOURNAL_ENTRIES {
            assert!(journal.push(entry));
        }
        assert!(!journal.push(entry) && journal.used().len() == JOURNAL_ENTRIES);
        assert!(journal.check().is_ok());
        journal.entries[3].kind = 99;
        assert!(journal.check().is_err());
        journal.length = 3;
        assert!(journal.check().is_ok());
        journal.length = 21;
        assert!(journal.check().is_err());
    }
}
