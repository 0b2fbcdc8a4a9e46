//! The way of the samples of one topic from its writer to its readers, which may have a fault.

use std::ops::Deref;
use std::sync::Arc;

use faults::{Change, Changed};
use shared_types::{Header, SampleType};

/// A sample on its way, in bytes.
#[derive(Debug, Clone)]
pub(crate) struct SampleBytes(Arc<[u64]>);

impl SampleBytes {
    /// A copy of a sample. Each begins with a header, so length and place are those of 64-bit numbers.
    pub(crate) fn of(sample: &[u8]) -> Self {
        Self(Arc::from(bytemuck::cast_slice::<u8, u64>(sample)))
    }
}

impl Deref for SampleBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        bytemuck::cast_slice(&self.0)
    }
}

/// A fault on the way, from one time to another.
#[derive(Debug, Clone)]
pub struct ActiveChange {
    /// What it does.
    pub change: Change,
    /// Since when [ns].
    pub from_ns: u64,
    /// Until when [ns].
    pub until_ns: u64,
    /// The incarnation whose samples are wrong; `None` for all.
    pub of: Option<u32>,
}

/// Samples on their way.
#[derive(Debug, Clone)]
pub struct Wire {
    of: &'static SampleType,
    pending: Vec<(u64, SampleBytes)>,
    held: Option<SampleBytes>,
    /// The last good sample.
    last: Option<SampleBytes>,
    fault: Option<ActiveChange>,
}

impl Wire {
    /// A way without a fault.
    pub(crate) fn new(of: &'static SampleType) -> Self {
        Self { of, pending: Vec::new(), held: None, last: None, fault: None }
    }

    /// Puts a fault on the way.
    pub fn break_with(&mut self, mut fault: ActiveChange) {
        if let Some(last) = &self.last {
            fault.change.keep(last);
        }
        self.fault = Some(fault);
    }

    /// Sends a complete sample; a fault may change, delay, lose or multiply it. `complete` numbers what is added.
    pub(crate) fn send(&mut self, sample: &mut [u8], now_ns: u64, mut complete: impl FnMut(&mut [u8])) {
        let header: &Header = (self.of.header)(sample);
        let is_wrong = |fault: &&mut ActiveChange| {
            now_ns >= fault.from_ns
                && now_ns < fault.until_ns
                && fault.of.is_none_or(|incarnation| incarnation == header.incarnation)
        };
        let Some(fault) = self.fault.as_mut().filter(is_wrong) else {
            let sample = SampleBytes::of(sample);
            self.last = Some(sample.clone());
            return self.pending.push((now_ns, sample));
        };
        let changed = fault.change.apply(self.of, sample);
        let arrives = SampleBytes::of(sample);
        match changed {
            Changed::Nothing => {}
            Changed::Once(delay_ns) => self.pending.push((now_ns + delay_ns, arrives)),
            Changed::Twice => self.pending.extend([(now_ns, arrives.clone()), (now_ns, arrives)]),
            Changed::AfterNext => return self.held = Some(arrives),
            Changed::Flood(more) => {
                self.pending.push((now_ns, arrives));
                for _ in 0..more {
                    complete(sample);
                    self.pending.push((now_ns, SampleBytes::of(sample)));
                }
            }
        }
        if let Some(held) = self.held.take() {
            self.pending.push((now_ns, held));
        }
    }

    /// When the next sample arrives [ns].
    pub(crate) fn next_ns(&self) -> Option<u64> {
        self.pending.iter().map(|(due_ns, _)| *due_ns).min()
    }

    /// The next sample that has arrived.
    pub(crate) fn receive(&mut self, now_ns: u64) -> Option<SampleBytes> {
        let due = self.pending.iter().enumerate().filter(|(_, (due_ns, _))| *due_ns <= now_ns);
        let (first, _) = due.min_by_key(|(_, (due_ns, _))| *due_ns)?;
        Some(self.pending.remove(first).1)
    }
}
