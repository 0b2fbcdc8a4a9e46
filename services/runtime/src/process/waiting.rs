//! How a process sleeps, and what it does when it wakes.
//!
//! One way for all: sleep on the doorbell or, while a writer that does not ring is there, on the events of the bus, never without a
//! time-out; look at the bell; take the directive; then take all inputs.

use std::os::fd::BorrowedFd;

use shared_types::{ProcessState, StageStamps, Topic};

use super::{MAX_WAIT_NS, Process};
use crate::bell::bit;
use crate::counters::count;
use crate::waiter::Waiter;
use crate::wake::wait_for;
use crate::{RuntimeError, monotonic_ns, orphan};

/// A heartbeat that is due waits for this long at most for a moment in which nobody is kept from running by it.
const HEARTBEAT_TIMEOUT_NS: u64 = 30_000_000;
/// Sleeps that are longer than this leave caches cold [ns].
const COLD_NS: u64 = 5_000_000;
/// Who gave its processor away while it polled and got it back later than this shares it with others [ns].
const AWAY_NS: u64 = 500_000;
/// How long a process that shares its processor does not poll [ns].
const CROWDED_NS: u64 = 10_000_000_000;
/// How long nothing must have happened for that [ns].
const QUIET_NS: u64 = 2_000_000;

/// What a process sleeps for.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Need {
    /// An input, whichever.
    Any,
    /// All inputs: one that does not complete them need not wake.
    All,
    /// A time, as exactly as the settings allow, or an input before it.
    Time,
}

impl Process {
    /// Sleeps until an input has something, the deadline of the clock has passed, or a tenth of a second has;
    /// then takes what has come. False when the process is to end.
    ///
    /// Simulated time has no deadlines: it only moves with samples.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn wait(&mut self, deadline_ns: Option<u64>) -> Result<bool, RuntimeError> {
        self.wait_until(deadline_ns, Need::Any)
    }

    /// [`Process::wait`] for a process that [`crate::join`]s its inputs: while several are missing, only the one declared last
    /// wakes it, and then the next that is missing.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn wait_joined(&mut self) -> Result<bool, RuntimeError> {
        self.wait_until(None, Need::All)
    }

    /// [`Process::wait`] for a process whose work begins at a time, not with an input: with `realtime.poll_us` it is
    /// awake before that time, so that it need not be woken.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn wait_for_time(&mut self, due_ns: u64) -> Result<bool, RuntimeError> {
        self.due_ns = due_ns;
        self.wait_until(Some(due_ns), Need::Time)
    }

    fn wait_until(&mut self, deadline_ns: Option<u64>, need: Need) -> Result<bool, RuntimeError> {
        if self.shared.produced.get() && self.state == ProcessState::Connected {
            self.enter(ProcessState::Ready)?;
        }
        let remaining = match deadline_ns {
            Some(deadline) if !self.shared.clock.is_simulated() => {
                deadline.saturating_sub(monotonic_ns()).min(MAX_WAIT_NS)
            }
            _ => MAX_WAIT_NS,
        };
        // Only the time itself is met exactly, not the end of a sleep before it.
        let need = if need == Need::Time && remaining == MAX_WAIT_NS { Need::Any } else { need };
        self.sleep(remaining, need)
    }

    pub(super) fn sleep(&mut self, longest_ns: u64, need: Need) -> Result<bool, RuntimeError> {
        let now = monotonic_ns();
        let beats = self.shared.counters.news.get() || now >= self.next_heartbeat_ns;
        // Who was just woken by an output may be waiting for this processor: words can wait until it is quiet.
        let rests = beats && self.shared.worked.take() && now < self.next_heartbeat_ns + HEARTBEAT_TIMEOUT_NS;
        let (longest_ns, need) =
            if rests { (longest_ns.min(QUIET_NS), Need::Any) } else { (longest_ns, need) };
        let beats = beats && !rests;
        if beats {
            self.beat()?;
        }
        let until_ns = now + longest_ns;
        let timed_out = if self.listens {
            !self.sleep_on_events(longest_ns)
        } else {
            while let Some(early_ns) = self.early_ns(monotonic_ns(), until_ns, need) {
                let is_rung = self.bells.role(self.shared.role).sleep(self.rung, early_ns, self.topics);
                let goes_on = self.poll(beats, !is_rung)?;
                // A writer that does not ring may have come: the next sleep is on its events.
                if is_rung || !goes_on || self.listens || self.inputs.iter().any(|input| !input.is_empty()) {
                    return Ok(goes_on);
                }
                if monotonic_ns() >= self.next_heartbeat_ns {
                    self.beat()?;
                }
                self.outputs.iter().for_each(|output| output.rehearse());
            }
            !self.sleep_on_bell(now, until_ns, need)
        };
        count(&self.shared.counters.timeouts, u64::from(timed_out));
        self.poll(beats, timed_out)
    }

    /// When to wake next although nothing is expected: shortly before something is, to warm up.
    ///
    /// After some milliseconds of sleep most of the time that a hop takes is spent on waiting for memory. So a process
    /// looks at its inputs and takes its next place in shared memory when that keeps nobody waiting.
    fn early_ns(&self, now: u64, until_ns: u64, need: Need) -> Option<u64> {
        let due_ns = match need {
            _ if self.shared.clock.is_simulated() => return None,
            Need::Time => until_ns,
            Need::Any | Need::All => self.shared.taken_ns.get() + self.run.period_ns,
        };
        let early_ns = due_ns.saturating_sub(1000 * self.realtime.warm_up_us);
        (early_ns < due_ns && early_ns > now + COLD_NS && early_ns < until_ns).then_some(early_ns)
    }

    /// Sets the alarm for the end of the sleep that will follow, when work begins that [`Process::wait_for_time`] waited for.
    pub(super) fn set_alarm(&self) {
        if self.due_ns > 0 && !self.shared.clock.is_simulated() {
            let now = monotonic_ns();
            let periods = now.saturating_sub(self.due_ns) / self.run.period_ns + 1;
            let next_ns = self.due_ns + periods * self.run.period_ns;
            let early_ns = self.early_ns(now, next_ns, Need::Time);
            self.alarm.set(early_ns.unwrap_or(next_ns - 1000 * self.realtime.poll_us));
        }
    }

    /// What follows every sleep: takes what has come, the directive first. Topics that nobody rang for are left out unless
    /// the process `beats` or nothing has woken it. False when the process is to end.
    fn poll(&mut self, beats: bool, timed_out: bool) -> Result<bool, RuntimeError> {
        self.looked_ns = monotonic_ns();
        let woken_ns =
            if self.shared.clock.is_simulated() { self.shared.clock.now_ns() } else { self.looked_ns };
        self.shared.counters.wake();
        self.shared.stamps.set(StageStamps { woken_ns, ..StageStamps::default() });
        // Before anything is emptied: what comes later rings again.
        self.rung = self.bells.role(self.shared.role).poll();
        // A writer may have died between its sample and its ring; and who does not ring is heard otherwise.
        let everywhere = beats || timed_out || self.listens;
        if everywhere || self.directive.reader().is_rung() {
            self.directive.reader().drain()?;
            self.look_around(beats);
        }
        if let Some(directive) = self.directive.take_newest() {
            *self.shared.directive.borrow_mut() = *directive;
            self.directive_seen_ns = self.looked_ns;
            // Before anything newer is taken: what was kept aside comes first.
            self.inputs.iter().for_each(|input| input.review());
        }
        for input in &self.inputs {
            if everywhere || self.listens || input.is_rung() {
                input.drain()?;
            }
        }
        let alone_ns = self.looked_ns.saturating_sub(self.directive_seen_ns);
        // In lock-step the robot waits for grants, so silence stops it anyway.
        let simulated = self.shared.clock.is_simulated();
        self.shared.guard.set_silent(!simulated && alone_ns > self.run.orphan_stop_ns);
        self.tell_wheels();
        // A run that was stopped can't be adopted, so it is not waited for.
        let timeout_ns = match self.shared.guard.is_latched() {
            true => self.run.orphan_timeout_ns.min(self.run.orphan_stop_ns),
            false => self.run.orphan_timeout_ns,
        };
        let orphaned = alone_ns > orphan::limit_ns(self.shared.role, timeout_ns);
        if orphaned {
            tracing::error!("no orchestrator for {} s: ending", alone_ns / 1_000_000_000);
            self.janitor.is_orphaned();
        }
        let goes_on = !self.shutdown.requested() && !orphaned;
        if !goes_on {
            self.realtime.give_way();
        }
        Ok(goes_on)
    }

    /// Sleeps on the doorbell; false after a time-out.
    fn sleep_on_bell(&self, now: u64, until_ns: u64, need: Need) -> bool {
        let bell = self.bells.role(self.shared.role);
        let polls = !self.shared.clock.is_simulated() && now >= self.crowded_until_ns.get();
        let poll_ns = if polls { 1000 * self.realtime.poll_us } else { 0 };
        if poll_ns == 0 {
            let bits = if need == Need::All { self.missing() } else { self.topics };
            return bell.sleep(self.rung, until_ns, bits);
        }
        let (from_ns, to_ns) = match need {
            Need::Time => (until_ns.saturating_sub(poll_ns), until_ns),
            // The others are at work on what is missing.
            Need::All if self.inputs.iter().any(|input| !input.is_empty()) => (now, now + poll_ns),
            Need::All => (until_ns, until_ns),
            Need::Any => {
                let expected_ns = self.shared.taken_ns.get() + self.run.period_ns;
                (expected_ns.saturating_sub(poll_ns), expected_ns + poll_ns)
            }
        };
        let (from_ns, to_ns) = (from_ns.min(until_ns), to_ns.min(until_ns));
        if now < from_ns && bell.sleep(self.rung, from_ns, self.topics) {
            return true;
        }
        let mut now = monotonic_ns();
        while now < to_ns {
            if bell.poll() != self.rung {
                return true;
            }
            // The one it waits for may need this processor.
            std::thread::yield_now();
            let back_ns = monotonic_ns();
            if back_ns > now + AWAY_NS {
                self.crowded_until_ns.set(back_ns + CROWDED_NS);
                break;
            }
            now = back_ns;
        }
        now < until_ns && bell.sleep(self.rung, until_ns, self.topics)
    }

    /// What a process that joins its inputs waits for: the last of those that are missing.
    fn missing(&self) -> u32 {
        let missing = self.inputs.iter().rev().find(|input| input.is_empty());
        missing.map_or(self.topics, |input| bit(input.topic()) | bit(Topic::Directive))
    }

    /// Sleeps on the events of all topics, which writers of ours notify as well; false after a time-out.
    fn sleep_on_events(&self, longest_ns: u64) -> bool {
        if self.bells.role(self.shared.role).poll() != self.rung {
            return true;
        }
        let mut descriptors: [BorrowedFd<'_>; 8] = std::array::from_fn(|_| self.shutdown.descriptor());
        let waiters =
            self.inputs.iter().map(|input| input.waiter()).chain([self.directive.reader().waiter()]);
        let mut used = 1;
        for (slot, descriptor) in descriptors[1..].iter_mut().zip(waiters.filter_map(Waiter::descriptor)) {
            *slot = descriptor;
            used += 1;
        }
        wait_for(&descriptors[..used], longest_ns)
    }

    /// Listens to events while a process that does not ring writes one of the topics read here, and notifies them while
    /// somebody listens. Called before inputs are emptied, so what was published before is found, and what is published
    /// later is heard.
    fn look_around(&mut self, again: bool) {
        self.outputs.iter().for_each(|output| output.poll_listeners());
        let mut needed = false;
        for input in &self.inputs {
            needed |= input.waiter().is_needed(again);
        }
        if needed || self.listens {
            self.listens = needed;
            self.inputs.iter().for_each(|input| input.waiter().listen(needed));
            self.directive.reader().waiter().listen(needed);
        }
    }

    /// Sleeps that lasted to their end.
    #[cfg(test)]
    pub(crate) fn timeouts(&self) -> u64 {
        self.shared.counters.timeouts.get()
    }
}
