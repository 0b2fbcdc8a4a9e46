//! The way of the samples of one topic from its writer to its readers, with the fault on it.

use faults::{Change, Changed};
use shared_types::{Header, Role, Sample, StageStamps};

/// The writer's end: numbers samples and completes their headers as the runtime does.
#[derive(Debug, Clone)]
pub(crate) struct Writer {
    role: Role,
    pub(crate) incarnation: u32,
    sequence: u64,
}

impl Writer {
    pub(crate) fn new(role: Role, incarnation: u32) -> Self {
        Self { role, incarnation, sequence: 0 }
    }

    /// Completes the header: layout, incarnation, number and stamps of the stage.
    pub(crate) fn complete<S: Sample>(&mut self, sample: &mut S, now_ns: u64) {
        self.sequence += 1;
        let header: &mut Header = sample.header_mut();
        (header.layout, header.incarnation, header.sequence) = (S::LAYOUT, self.incarnation, self.sequence);
        let stamps =
            StageStamps { woken_ns: now_ns, taken_ns: now_ns, computed_ns: now_ns, published_ns: now_ns };
        *header.stage_mut(self.role) = stamps;
    }
}

/// A fault on the way, from one time to another.
#[derive(Debug, Clone)]
pub(crate) struct ActiveChange {
    pub(crate) change: Change,
    pub(crate) from_ns: u64,
    pub(crate) until_ns: u64,
    /// The incarnation whose samples are wrong; `None` for all.
    pub(crate) of: Option<u32>,
}

/// Samples on their way.
#[derive(Debug, Clone)]
pub(crate) struct Wire<S> {
    pending: Vec<(u64, S)>,
    held: Option<S>,
    /// The last good sample.
    last: Option<S>,
    fault: Option<ActiveChange>,
}

impl<S> Default for Wire<S> {
    fn default() -> Self {
        Self { pending: Vec::new(), held: None, last: None, fault: None }
    }
}

impl<S: Sample> Wire<S> {
    /// Puts a fault on the way.
    pub(crate) fn break_with(&mut self, mut fault: ActiveChange) {
        if let Some(last) = &self.last {
            fault.change.keep(bytemuck::bytes_of(last));
        }
        self.fault = Some(fault);
    }

    /// Sends a complete sample; a fault may change, delay, lose or multiply it. `writer` numbers what is added.
    pub(crate) fn send(&mut self, mut sample: S, now_ns: u64, writer: &mut Writer) {
        let is_wrong = |fault: &&mut ActiveChange| {
            now_ns >= fault.from_ns
                && now_ns < fault.until_ns
                && fault.of.is_none_or(|incarnation| incarnation == sample.header().incarnation)
        };
        let Some(fault) = self.fault.as_mut().filter(is_wrong) else {
            self.last = Some(sample);
            return self.pending.push((now_ns, sample));
        };
        match fault.change.apply(S::TYPE, bytemuck::bytes_of_mut(&mut sample)) {
            Changed::Nothing => {}
            Changed::Once(delay_ns) => self.pending.push((now_ns + delay_ns, sample)),
            Changed::Twice => self.pending.extend([(now_ns, sample); 2]),
            Changed::AfterNext => return self.held = Some(sample),
            Changed::Flood(more) => {
                self.pending.push((now_ns, sample));
                for _ in 0..more {
                    writer.complete(&mut sample, now_ns);
                    self.pending.push((now_ns, sample));
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
    pub(crate) fn receive(&mut self, now_ns: u64) -> Option<S> {
        let due = self.pending.iter().enumerate().filter(|(_, (due_ns, _))| *due_ns <= now_ns);
        let (first, _) = due.min_by_key(|(_, (due_ns, _))| *due_ns)?;
        Some(self.pending.remove(first).1)
    }
}
