//! How a process sleeps, and what it does when it wakes.
//!
//! It sleeps on the doorbell, or on the events of the bus while a publisher that does not ring writes one of its
//! topics, never without a time-out. When it wakes it reads the bell, takes the directive, then all inputs.
//!
//! A long sleep has a break shortly before the next input is expected, to warm up the caches. Then the stage may
//! prepare ([`Process::wait_preparing`]).

use std::os::fd::BorrowedFd;

use shared_types::{ProcessState, StageStamps, Topic};

use super::{MAX_WAIT_NS, Process};
use crate::bell::bit;
use crate::counters::count;
use crate::waiter::Waiter;
use crate::wake::wait_for;
use crate::{RuntimeError, monotonic_ns, orphan};

/// How long a heartbeat that is due may wait, so that it delays no process of the loop [ns].
const HEARTBEAT_TIMEOUT_NS: u64 = 30_000_000;
/// Sleeps that are longer than this leave caches cold [ns].
const COLD_NS: u64 = 5_000_000;
/// A polling process that yields and gets its processor back later than this shares it with others [ns].
const AWAY_NS: u64 = 500_000;
/// Periods without preparation after one that ended later than its input was expected.
const UNPREPARED_PERIODS: u64 = 3;
/// How long a process that shares its processor does not poll [ns].
const CROWDED_NS: u64 = 10_000_000_000;
/// How long no input must have come for a late heartbeat [ns].
const QUIET_NS: u64 = 2_000_000;

/// What a process sleeps for.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Need {
    /// Any input.
    Any,
    /// All inputs: an input that does not complete them need not wake.
    All,
    /// A time, as exactly as the settings allow, or an input before it.
    Time,
}

impl Process {
    /// Sleeps until an input has a sample, the deadline has passed, or a tenth of a second has; then takes all samples
    /// from the bus. False when the process must end.
    ///
    /// The deadline has no effect in simulated time, which moves with the samples.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn wait(&mut self, deadline_ns: Option<u64>) -> Result<bool, RuntimeError> {
        self.wait_until(deadline_ns, Need::Any, &mut |_| {})
    }

    /// [`Process::wait`] for a stage that prepares: `prepare` is called once per scan, `realtime.warm_up_us` before the
    /// next input is expected, with the time at which it is expected [ns].
    ///
    /// It is for whatever makes the next step faster, such as doing it on an expected input: after some milliseconds of
    /// sleep, code and data are no longer in the caches. It must not change what the step gives, because it is left out
    ///
    /// * in simulated time, and while scans are at most 5 ms apart;
    /// * when the input is there already, or the process was woken too late for it;
    /// * when the wheels have to be blocked, and when the process is to end;
    /// * for three periods after a preparation that ended later than the input was expected;
    /// * while a publisher that does not ring writes one of the topics, and with `realtime.rehearse = false`.
    ///
    /// An input that comes meanwhile waits until it ends. A preparation that never ends is a hang of the process.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn wait_preparing(
        &mut self,
        deadline_ns: Option<u64>,
        prepare: &mut dyn FnMut(u64),
    ) -> Result<bool, RuntimeError> {
        self.wait_until(deadline_ns, Need::Any, prepare)
    }

    /// [`Process::wait`] for a process that [`crate::join`]s its inputs: while several are missing, only the one
    /// opened last wakes it, and then the next that is missing.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn wait_joined(&mut self) -> Result<bool, RuntimeError> {
        self.wait_joined_preparing(&mut |_| {})
    }

    /// [`Process::wait_joined`] with the preparation of [`Process::wait_preparing`].
    ///
    /// # Errors
    /// Errors of the bus.
    pub(crate) fn wait_joined_preparing(
        &mut self,
        prepare: &mut dyn FnMut(u64),
    ) -> Result<bool, RuntimeError> {
        self.wait_until(None, Need::All, prepare)
    }

    /// [`Process::wait`] for a process whose work begins at a time, not with an input. With `realtime.poll_us` it is
    /// awake before that time.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn wait_for_time(&mut self, due_ns: u64) -> Result<bool, RuntimeError> {
        self.due_ns = due_ns;
        self.wait_until(Some(due_ns), Need::Time, &mut |_| {})
    }

    fn wait_until(
        &mut self,
        deadline_ns: Option<u64>,
        need: Need,
        prepare: &mut dyn FnMut(u64),
    ) -> Result<bool, RuntimeError> {
        if self.shared.produced.get() && self.state == ProcessState::Connected {
            self.enter(ProcessState::Ready)?;
        }
        let remaining = match deadline_ns {
            Some(deadline) if !self.shared.clock.is_simulated() => {
                deadline.saturating_sub(monotonic_ns()).min(MAX_WAIT_NS)
            }
            _ => MAX_WAIT_NS,
        };
        // Only the deadline itself is met exactly, not the end of an earlier sleep.
        let need = if need == Need::Time && remaining == MAX_WAIT_NS { Need::Any } else { need };
        self.sleep(remaining, need, prepare)
    }

    pub(super) fn sleep(
        &mut self,
        timeout_ns: u64,
        need: Need,
        prepare: &mut dyn FnMut(u64),
    ) -> Result<bool, RuntimeError> {
        let now = monotonic_ns();
        let is_due = self.shared.counters.is_urgent.get() || now >= self.next_heartbeat_ns;
        // A reader of the last output may be waiting for this processor: the heartbeat can wait.
        let waits =
            is_due && self.shared.worked.take() && now < self.next_heartbeat_ns + HEARTBEAT_TIMEOUT_NS;
        let (timeout_ns, need) =
            if waits { (timeout_ns.min(QUIET_NS), Need::Any) } else { (timeout_ns, need) };
        let beats = is_due && !waits;
        if beats {
            self.beat()?;
        }
        let until_ns = now + timeout_ns;
        let timed_out = if self.listens {
            !self.sleep_on_events(timeout_ns)
        } else {
            while let Some(early_ns) = self.early_ns(monotonic_ns(), until_ns, need) {
                let is_rung = self.bells.role(self.shared.role).sleep(self.rung, early_ns, self.topics);
                let continues = self.poll(beats, !is_rung)?;
                // A publisher that does not ring may have joined: the next sleep is on its events.
                if is_rung || !continues || self.listens || self.inputs.iter().any(|input| !input.is_empty())
                {
                    return Ok(continues);
                }
                if monotonic_ns() >= self.next_heartbeat_ns {
                    self.beat()?;
                }
                self.prepare(early_ns, prepare);
                self.outputs.iter().for_each(|output| output.warm_up());
            }
            !self.sleep_on_bell(now, until_ns, need)
        };
        count(&self.shared.counters.timeouts, u64::from(timed_out));
        self.poll(beats, timed_out)
    }

    /// When to wake to warm up the caches: shortly before the next input is expected; `None` when that is not needed.
    ///
    /// After some milliseconds of sleep a hop spends most of its time on waiting for memory. So a process polls its
    /// inputs and takes its next place in shared memory while no process waits for it.
    fn early_ns(&self, now: u64, until_ns: u64, need: Need) -> Option<u64> {
        let due_ns = match need {
            _ if self.shared.clock.is_simulated() => return None,
            Need::Time => until_ns,
            Need::Any | Need::All => self.shared.expected_ns.get(),
        };
        let early_ns = due_ns.saturating_sub(1000 * self.realtime.warm_up_us);
        (early_ns < due_ns && early_ns > now + COLD_NS && early_ns < until_ns).then_some(early_ns)
    }

    /// Lets the stage prepare for its next input, after a wake-up that was due at `early_ns`, unless that could delay
    /// the input.
    fn prepare(&mut self, early_ns: u64, prepare: &mut dyn FnMut(u64)) {
        let (now, lead_ns) = (monotonic_ns(), 1000 * self.realtime.warm_up_us);
        let due_ns = early_ns + lead_ns;
        let is_in_time = now < early_ns + lead_ns / 2 && now >= self.unprepared_until_ns;
        let is_rung = self.bells.role(self.shared.role).poll() != self.rung;
        if !self.realtime.rehearse || !is_in_time || is_rung || self.directive().stop == 1 {
            return;
        }
        prepare(due_ns);
        let end_ns = monotonic_ns();
        if end_ns > due_ns {
            self.unprepared_until_ns = end_ns + UNPREPARED_PERIODS * self.run.period_ns;
            tracing::debug!(
                late_ns = end_ns - due_ns,
                "the preparation took too long: the next ones are left out"
            );
        }
    }

    /// Sets the alarm for the end of the next sleep, when the work begins that [`Process::wait_for_time`] waited for.
    pub(super) fn set_alarm(&self) {
        if self.due_ns > 0 && !self.shared.clock.is_simulated() {
            let now = monotonic_ns();
            let periods = now.saturating_sub(self.due_ns) / self.run.period_ns + 1;
            let next_ns = self.due_ns + periods * self.run.period_ns;
            let early_ns = self.early_ns(now, next_ns, Need::Time);
            self.alarm.set(early_ns.unwrap_or(next_ns - 1000 * self.realtime.poll_us));
        }
    }

    /// Takes all new samples after a sleep, the directive first. Topics whose bells were not rung are skipped unless
    /// the process `beats` or its sleep timed out. False when the process must end.
    fn poll(&mut self, beats: bool, timed_out: bool) -> Result<bool, RuntimeError> {
        self.polled_ns = monotonic_ns();
        let woken_ns =
            if self.shared.clock.is_simulated() { self.shared.clock.now_ns() } else { self.polled_ns };
        self.shared.counters.wake();
        self.shared.stamps.set(StageStamps { woken_ns, ..StageStamps::default() });
        // Before any input is emptied: a sample that comes later rings again.
        self.rung = self.bells.role(self.shared.role).poll();
        // A publisher may have died between its sample and its ring, or not ring at all.
        let everywhere = beats || timed_out || self.listens;
        if everywhere || self.directive.reader().is_rung() {
            self.directive.reader().drain()?;
            self.update_listeners(beats);
        }
        if let Some(directive) = self.directive.take_newest() {
            *self.shared.directive.borrow_mut() = *directive;
            self.directive_seen_ns = self.polled_ns;
            // Before newer samples are taken: those kept aside come first.
            self.inputs.iter().for_each(|input| input.review());
        }
        for input in &self.inputs {
            if everywhere || self.listens || input.is_rung() {
                input.drain()?;
            }
        }
        let alone_ns = self.polled_ns.saturating_sub(self.directive_seen_ns);
        // In lock-step the robot waits for grants, so without directives it stops anyway.
        let simulated = self.shared.clock.is_simulated();
        self.shared.guard.set_silent(!simulated && alone_ns > self.run.orphan_stop_ns);
        self.publish_wheels();
        // A stopped run can't be adopted, so its processes end earlier.
        let timeout_ns = match self.shared.guard.is_latched() {
            true => self.run.orphan_timeout_ns.min(self.run.orphan_stop_ns),
            false => self.run.orphan_timeout_ns,
        };
        // The wheels are blocked by the age of the directive, whatever the reason; the end needs a silent orchestrator.
        let silent_ns = self.silence.since(self.directive_seen_ns, self.polled_ns);
        let orphaned = silent_ns > orphan::limit_ns(self.shared.role, timeout_ns);
        if orphaned {
            tracing::error!("no orchestrator for {} s: ending", silent_ns / 1_000_000_000);
            self.cleanup.mark_orphaned();
        }
        let continues = !self.shutdown.requested() && !orphaned;
        if !continues {
            self.realtime.leave_real_time();
        }
        Ok(continues)
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
            // Other processes are computing the missing inputs.
            Need::All if self.inputs.iter().any(|input| !input.is_empty()) => (now, now + poll_ns),
            Need::All => (until_ns, until_ns),
            Need::Any => {
                let expected_ns = self.shared.expected_ns.get();
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
            // The process it waits for may need this processor.
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

    /// The topics that wake a process that joins its inputs: the directive, and the last input that is missing.
    fn missing(&self) -> u32 {
        let missing = self.inputs.iter().rev().find(|input| input.is_empty());
        missing.map_or(self.topics, |input| bit(input.topic()) | bit(Topic::Directive))
    }

    /// Sleeps on the events of all topics, which all publishers notify; false after a time-out.
    fn sleep_on_events(&self, timeout_ns: u64) -> bool {
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
        wait_for(&descriptors[..used], timeout_ns)
    }

    /// Listens to events while a process that does not ring writes one of the topics read here, and notifies them
    /// while a process listens. Call it before the inputs are emptied, so that no sample is missed in between.
    fn update_listeners(&mut self, again: bool) {
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
