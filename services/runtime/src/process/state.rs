//! The state that a process leaves for the one that goes on from it.

use shared_types::{Actuation, Checkpoint, Described};

use super::waiting::Need;
use super::{CHECKPOINT_AGE_NS, HANDOVER_AGE_NS, JOIN_NS, Process};
use crate::handover::{self, Handover};
use crate::{Observer, RuntimeError, environment, monotonic_ns};

impl Process {
    /// Publishes the state of this process after a scan, for the one that may have to go on from it.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn save<T: bytemuck::Pod + Described>(
        &self,
        header: &shared_types::Header,
        state: &T,
    ) -> Result<(), RuntimeError> {
        self.save_checkpoint(header, Checkpoint::of(self.shared.role, state))
    }

    /// [`Process::save`] of a state that is bytes already.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn save_checkpoint(
        &self,
        header: &shared_types::Header,
        mut checkpoint: Checkpoint,
    ) -> Result<(), RuntimeError> {
        checkpoint.header = header.answer();
        checkpoint.issued_ns = monotonic_ns();
        self.checkpoint.publish_silently(&mut checkpoint)
    }

    /// The state that the process before this one left less than half a second before its end.
    ///
    /// # Errors
    /// [`RuntimeError::File`] when the hand-over can't be read.
    pub fn resume<T: bytemuck::Pod + Described>(&self) -> Result<Handover<T>, RuntimeError> {
        Ok(match self.resume_checkpoint()? {
            Handover::FirstStart => Handover::FirstStart,
            Handover::Lost => Handover::Lost,
            Handover::State(checkpoint) => checkpoint.state().map(Handover::State).unwrap_or_else(|error| {
                tracing::warn!(%error, "the state of the process before this one can't be used");
                Handover::Lost
            }),
        })
    }

    /// [`Process::resume`] without a look at what the state is.
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
        // In lock-step the loop rests while a process starts: its state does not age, and contains all actuations.
        if !self.shared.clock.is_simulated() {
            let now_ns = monotonic_ns();
            let (age_ns, waited_ns) = (data.age_ns(now_ns), now_ns.saturating_sub(data.checkpoint.issued_ns));
            if age_ns > CHECKPOINT_AGE_NS || waited_ns > HANDOVER_AGE_NS {
                let (age_ms, waited_ms) = (age_ns / 1_000_000, waited_ns / 1_000_000);
                tracing::warn!(age_ms, waited_ms, "the state of the process before this one is too old");
                return Ok(Handover::Lost);
            }
            *self.handed_actuations.borrow_mut() = data.actuations;
        }
        self.handed_scan.set(data.checkpoint.header.scan_id);
        Ok(Handover::State(data.checkpoint))
    }

    /// The newest actuations that were sent before this process was started, oldest first: for a role that reads them
    /// and has found a state with [`Process::resume`]. The process before this one may not have seen the last of them.
    pub fn handed_actuations(&self) -> Vec<Actuation> {
        self.handed_actuations.take()
    }

    /// The scan after which the state was taken that [`Process::resume`] has found; 0 without one.
    pub fn handed_scan(&self) -> u64 {
        self.handed_scan.get()
    }

    /// The newest state of the running process that this one was started beside, and the scan after which it was
    /// taken: to be called after [`Process::start`], because what was handed over at the start has aged since.
    ///
    /// `None` when this process was not started beside another, when that one publishes no state of this type
    /// for two and a half periods, and in lock-step, where the loop rests while a process starts.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn join<T: bytemuck::Pod + Described>(&mut self) -> Result<Option<(u64, T)>, RuntimeError> {
        let mut newest = None;
        self.join_checkpoint(&mut |checkpoint| {
            newest = checkpoint.state().ok().map(|state| (checkpoint.header.scan_id, state));
            newest.is_some()
        })?;
        Ok(newest)
    }

    /// Hands fresh checkpoints of the running process to `accept`, until the newest of one poll was accepted or the time is
    /// over.
    fn join_checkpoint(&mut self, accept: &mut dyn FnMut(&Checkpoint) -> bool) -> Result<(), RuntimeError> {
        let Some(beside) = environment::beside() else { return Ok(()) };
        if self.shared.clock.is_simulated() {
            return Ok(());
        }
        let states = Observer::<Checkpoint>::new(&self.bus)?;
        let begun_ns = monotonic_ns();
        let until_ns = begun_ns + JOIN_NS + self.run.period_ns / 2 * 5;
        let mut is_accepted = false;
        while !is_accepted && monotonic_ns() < until_ns && self.sleep(self.run.period_ns / 20, Need::Any)? {
            states.poll(|checkpoint| {
                let is_fresh = checkpoint.header.incarnation == beside && checkpoint.issued_ns >= begun_ns;
                if is_fresh && checkpoint.role == self.shared.role.wire() {
                    is_accepted = accept(checkpoint);
                }
            })?;
        }
        Ok(())
    }
}
