//! The journal of a process: what it has taken, which times it was told, and what else its outputs follow from.
//!
//! Entries gather in memory. The writer of the first output of the role publishes them before that output, so there
//! is no output without its journal.

use std::cell::RefCell;
use std::rc::{Rc, Weak};

use shared_types::{Header, Journal, JournalEntry, JournalKind, Role, Topic};

/// An output for journals.
pub(crate) trait Publish {
    /// Publishes a journal. One that can't be published is missing in the sequence: the output that follows matters more.
    fn publish(&self, journal: &mut Journal);
    /// Takes the place of the next journal.
    fn take_next_place(&self);
}

/// What a process did since its last output.
#[derive(Default)]
pub(crate) struct Notes {
    open: RefCell<Journal>,
    /// The output shares this with the process, so it is not kept alive from here.
    output: RefCell<Option<Weak<dyn Publish>>>,
}

impl Notes {
    /// Publishes by this output from now on.
    pub(crate) fn publish_by(&self, role: Role, output: &Rc<dyn Publish>) {
        self.open.borrow_mut().role = role.wire();
        *self.output.borrow_mut() = Some(Rc::downgrade(output));
    }

    /// Notes a number.
    pub(crate) fn note(&self, kind: JournalKind, value: u64) {
        self.add(JournalEntry { kind: kind.wire() as u16, value, ..JournalEntry::default() });
    }

    /// Notes a sample.
    pub(crate) fn note_sample(&self, kind: JournalKind, topic: Topic, header: &Header) {
        let Header { incarnation, sequence, .. } = *header;
        let (kind, topic) = (kind.wire() as u16, topic as u16);
        self.add(JournalEntry { kind, topic, incarnation, value: sequence });
    }

    fn add(&self, entry: JournalEntry) {
        if self.open.borrow_mut().push(entry) {
            return;
        }
        self.publish(0, 0);
        self.open.borrow_mut().push(entry);
    }

    /// Publishes what was noted, before the output of a scan with this sequence number, or before more entries (0).
    pub(crate) fn publish(&self, scan_id: u64, output: u64) {
        let mut open = self.open.borrow_mut();
        (open.header.scan_id, open.output) = (scan_id, output);
        if let Some(output) = self.output() {
            output.publish(&mut open);
        }
        let used = (open.length as usize).min(open.entries.len());
        open.entries[..used].fill(JournalEntry::default());
        open.length = 0;
    }

    /// Takes the place of the next journal, while no process waits for this one.
    pub(crate) fn take_next_place(&self) {
        if let Some(output) = self.output() {
            output.take_next_place();
        }
    }

    fn output(&self) -> Option<Rc<dyn Publish>> {
        self.output.borrow().as_ref().and_then(Weak::upgrade)
    }
}
