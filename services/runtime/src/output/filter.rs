//! What a sample passes on its way out: an injected fault, and the guard of the wheels after it.

use std::cell::RefCell;
use std::rc::Rc;

use shared_types::{JournalKind, SampleType};

use crate::shared::Shared;

/// The filter of one writer.
pub(super) struct Filter {
    of: &'static SampleType,
    shared: Rc<Shared>,
    /// A sample as it was before an injected fault could change it.
    unchanged: RefCell<Vec<u8>>,
}

impl Filter {
    pub(super) fn new(of: &'static SampleType, shared: Rc<Shared>) -> Self {
        Self { of, shared, unchanged: RefCell::default() }
    }

    /// A sample that is about to be completed: an injected fault may delay it, and the guard holds it back.
    pub(super) fn enter(&self, sample: &mut [u8]) {
        if let Some(tamper) = self.shared.tamper.borrow_mut().as_mut() {
            tamper.delay(self.of.topic);
        }
        if self.shared.guard.hold_back(self.of, sample) {
            self.shared.notes.note(JournalKind::HeldBack, 0);
        }
    }

    /// Lets an injected fault change a complete sample; whether it is sent. The guard of the wheels checks it last. The
    /// next journal tells what was changed.
    pub(super) fn leave(&self, sample: &mut [u8]) -> bool {
        let (is_sent, is_changed) = {
            let mut tamper = self.shared.tamper.borrow_mut();
            let Some(tamper) = tamper.as_mut() else { return true };
            let mut unchanged = self.unchanged.borrow_mut();
            unchanged.clear();
            unchanged.extend_from_slice(sample);
            (tamper.change(self.of, sample), **unchanged != *sample)
        };
        if is_sent && is_changed && self.of.topic.writer().is_some() {
            let header = (self.of.header)(sample);
            self.shared.notes.note_sample(JournalKind::Injected, self.of.topic, header);
        }
        self.shared.guard.hold_back(self.of, sample);
        is_sent
    }

    /// A sample was sent: what the wheels do now is written into the page of the stop word.
    pub(super) fn sent(&self) {
        if self.shared.guard.concerns(self.of) && self.shared.is_in_charge() {
            self.shared.guard.publish_wheels();
        }
    }
}
