//! The state that a process saves for its successor.

use shared_types::{Actuation, Checkpoint, Described, Header, JournalKind, KnownScan, Topic};

use super::waiting::Need;
use super::{CHECKPOINT_AGE_NS, HANDOVER_AGE_NS, JOIN_NS, Process};
use crate::handover::{self, Handover};
use crate::{Observer, RuntimeError, environment, monotonic_ns};

impl Process {
    /// Publishes the state of this process after a scan, for its successor.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn save<T: bytemuck::Pod + Described>(&self, header: &Header, state: &T) -> Result<(), RuntimeError> {
        self.save_checkpoint(header, Checkpoint::of(self.shared.role, state))
    }

    /// [`Process::save`] of a state in bytes.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn save_checkpoint(&self, header: &Header, mut checkpoint: Checkpoint) -> Result<(), RuntimeError> {
        checkpoint.header = header.answer();
        checkpoint.issued_ns = monotonic_ns();
        checkpoint.saved_ns = checkpoint.issued_ns;
        self.checkpoint.publish_silently(&mut checkpoint)?;
        self.note(JournalKind::Saved, checkpoint.header.sequence);
        Ok(())
    }

    /// The state of the process before this one, if it was saved less than half a second before that process ended.
    ///
    /// # Errors
    /// [`RuntimeError::File`] when the hand-over can't be read.
    pub fn resume<T: bytemuck::Pod + Described>(&self) -> Result<Handover<T>, RuntimeError> {
        Ok(match self.resume_checkpoint()? {
            Handover::FirstStart => Handover::FirstStart,
            Handover::Lost => Handover::Lost,
            Handover::State(checkpoint) => {
                checkpoint.state_here().map(Handover::State).unwrap_or_else(|error| {
                    tracing::warn!(%error, "the state of the process before this one can't be used");
                    Handover::Lost
                })
            }
        })
    }

    /// [`Process::resume`] without a check of the type of the state.
    ///
    /// # Errors
    /// [`RuntimeError::File`] when the hand-over can't be read.
    pub fn resume_checkpoint(&self) -> Result<Handover<Checkpoint>, RuntimeError> {
        if !environment::is_restart() {
            return Ok(Handover::FirstStart);
        }
        let Some(data) = handover::read(&self.domain, self.shared.role)? else {
            tracing::warn!("the process before this one left no state");
            return Ok(Handover::Lost);
        };
        // In lock-step the loop waits while a process starts: its state does not age, and contains all actuations.
        if !self.shared.clock.is_simulated() {
            let now_ns = monotonic_ns();
            let (age_ns, waited_ns) = (data.age_ns(now_ns), now_ns.saturating_sub(data.checkpoint.issued_ns));
            if age_ns > CHECKPOINT_AGE_NS || waited_ns > HANDOVER_AGE_NS {
                let (age_ms, waited_ms) = (age_ns / 1_000_000, waited_ns / 1_000_000);
                tracing::warn!(age_ms, waited_ms, "the state of the process before this one is too old");
                return Ok(Handover::Lost);
            }
            self.handed_actuations.replace((data.actuations, data.moved_ns));
        }
        let header = &data.checkpoint.header;
        self.handed_scan.set(header.scan_id);
        self.shared.known_scan.set(KnownScan::of(header, header.acquired_ns));
        self.note_resumed(&data.checkpoint);
        Ok(Handover::State(data.checkpoint))
    }

    /// The newest actuations sent before this process was started, oldest first: for a role that reads them and got a
    /// state from [`Process::resume`]. The process before this one may not have received the last of them.
    pub(crate) fn handed_actuations(&self) -> impl Iterator<Item = Actuation> {
        let notes = &self.shared.notes;
        let (handed, moved_ns) = self.handed_actuations.take();
        handed.into_iter().inspect(move |actuation| {
            notes.note(JournalKind::Moved, moved_ns.cast_unsigned());
            notes.note_sample(JournalKind::Taken, Topic::Actuation, &actuation.header);
        })
    }

    fn note_resumed(&self, checkpoint: &Checkpoint) {
        if checkpoint.moved_ns() != 0 {
            self.note(JournalKind::Moved, checkpoint.moved_ns().cast_unsigned());
        }
        self.shared.notes.note_sample(JournalKind::Resumed, Topic::Checkpoint, &checkpoint.header);
    }

    /// The scan after which the state from [`Process::resume`] was saved; 0 without one.
    pub(crate) fn handed_scan(&self) -> u64 {
        self.handed_scan.get()
    }

    /// For a candidate: the newest state of the running process, and the scan after which it was saved. Call it after
    /// [`Process::start`], because the state handed over before has aged since.
    ///
    /// `None` when this process is no candidate, when the running process publishes no state of this type for two and
    /// a half periods, and in lock-step, where the loop waits while a process starts.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn join<T: bytemuck::Pod + Described>(&mut self) -> Result<Option<(u64, T)>, RuntimeError> {
        let mut newest = None;
        self.join_checkpoint(&mut |checkpoint| {
            newest = checkpoint.state_here().ok().map(|state| (checkpoint.header.scan_id, state));
            newest.is_some()
        })?;
        Ok(newest)
    }

    /// Hands fresh checkpoints of the running process to `accept`, until it accepts the newest of a poll or the time
    /// has passed.
    pub(crate) fn join_checkpoint(
        &mut self,
        accept: &mut dyn FnMut(&Checkpoint) -> bool,
    ) -> Result<(), RuntimeError> {
        let Some(incumbent) = environment::incumbent() else { return Ok(()) };
        if self.shared.clock.is_simulated() {
            return Ok(());
        }
        let states = Observer::<Checkpoint>::new(&self.bus)?;
        let begun_ns = monotonic_ns();
        let until_ns = begun_ns + JOIN_NS + self.run.period_ns / 2 * 5;
        let mut is_accepted = false;
        while !is_accepted
            && monotonic_ns() < until_ns
            && self.sleep(self.run.period_ns / 20, Need::Any, &mut |_| {})?
        {
            states.poll(|checkpoint| {
                let is_fresh = checkpoint.header.incarnation == incumbent && checkpoint.issued_ns >= begun_ns;
                if is_fresh && checkpoint.role == self.shared.role.wire() {
                    is_accepted = accept(checkpoint);
                    if is_accepted {
                        self.note_resumed(checkpoint);
                    }
                }
            })?;
        }
        Ok(())
    }
}
