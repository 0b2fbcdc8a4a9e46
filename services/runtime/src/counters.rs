//! What a process counts about its own samples.

use std::cell::Cell;

use shared_types::{Header, Heartbeat, InputAccount, PORTS, Role, Topic};

/// Counters of one process, shared by its inputs and outputs. Each input counts its own samples, see [`InputAccount`].
#[derive(Debug, Default)]
pub(crate) struct Counters {
    pub(crate) activations: Cell<u64>,
    pub(crate) published: Cell<u64>,
    pub(crate) undelivered: Cell<u64>,
    pub(crate) timeouts: Cell<u64>,
    pub(crate) last_scan: Cell<u64>,
    /// An input counted something that the orchestrator should know before the next heartbeat is due.
    pub(crate) is_urgent: Cell<bool>,
    /// A sample that the role answers was taken since the process woke.
    took: Cell<bool>,
    written: [Cell<u64>; PORTS],
    taken: Cell<u64>,
    taken_scans: Cell<u64>,
    answered: Cell<u64>,
    answered_scans: Cell<u64>,
}

/// Adds `more` to one counter.
pub(crate) fn count(counter: &Cell<u64>, more: u64) {
    counter.set(counter.get().wrapping_add(more));
}

impl Counters {
    /// Notes that the process woke.
    pub(crate) fn wake(&self) {
        count(&self.activations, 1);
        self.took.set(false);
    }

    /// Notes that `role` begins to work on a sample.
    pub(crate) fn take(&self, role: Role, topic: Topic, header: &Header) {
        if role.answers() == Some(topic) {
            self.took.set(true);
            count(&self.taken, 1);
            count(&self.taken_scans, header.scan_id);
        }
    }

    /// Notes that `role` has numbered a sample of its own. It counts as an answer while a sample taken has none.
    ///
    /// What an actuator decides by itself (`is_answer` is false) counts only when it took a command since it woke:
    /// then it refuses that command. Otherwise it reacts to a missing command, and an earlier one may still await its
    /// answer.
    pub(crate) fn write(&self, role: Role, topic: Topic, header: &Header, is_answer: bool) {
        let Some(port) = role.writes().iter().position(|written| *written == topic) else { return };
        self.written[port].set(header.sequence);
        // A role with several topics publishes one sample of each per scan; only the first is counted.
        if port > 0 {
            return;
        }
        self.last_scan.set(header.scan_id);
        count(&self.published, 1);
        let is_answer = is_answer || self.took.get();
        if is_answer && self.answered.get() < self.taken.get() {
            count(&self.answered, 1);
            count(&self.answered_scans, header.scan_id);
        }
    }

    /// Copies all counters into a heartbeat.
    pub(crate) fn fill(&self, heartbeat: &mut Heartbeat) {
        heartbeat.activations = self.activations.get();
        heartbeat.published = self.published.get();
        heartbeat.undelivered = self.undelivered.get();
        heartbeat.timeouts = self.timeouts.get();
        heartbeat.header.scan_id = self.last_scan.get();
        heartbeat.written = self.written.each_ref().map(Cell::get);
        heartbeat.taken = self.taken.get();
        heartbeat.taken_scans = self.taken_scans.get();
        heartbeat.answered = self.answered.get();
        heartbeat.answered_scans = self.answered_scans.get();
    }
}

/// Puts the counters of the `port`th input into a heartbeat, and adds them to the totals.
pub(crate) fn add_input(heartbeat: &mut Heartbeat, port: usize, account: InputAccount) {
    heartbeat.used += account.used;
    heartbeat.replaced += account.replaced + account.overwritten;
    heartbeat.invalid += account.invalid + account.unreadable;
    heartbeat.stale += account.stale;
    heartbeat.duplicate += account.duplicate;
    heartbeat.reordered += account.reordered;
    heartbeat.foreign += account.foreign;
    heartbeat.missing += account.missing;
    heartbeat.inputs[port] = account;
}

#[cfg(test)]
mod tests {
    use shared_types::{Actuation, Sample};

    use super::*;

    #[test]
    fn what_an_actuator_decides_by_itself_answers_no_command_but_one_that_it_refuses() {
        let counters = Counters::default();
        let command = Header { scan_id: 40, ..Header::default() };
        let publish = |scan_id, answers| {
            let mut actuation = Actuation { answers, ..Actuation::default() };
            actuation.header.scan_id = scan_id;
            counters.write(Role::Actuator, Topic::Actuation, &actuation.header, actuation.is_answer());
            counters.answered.get()
        };
        counters.take(Role::Actuator, Topic::Command, &command);
        counters.wake();
        counters.take(Role::Actuator, Topic::Directive, &Header::default());
        assert_eq!(publish(40, 0), 0, "it noticed a missing command, or was told to stop");
        assert_eq!(publish(40, 1), 1, "its answer");
        counters.take(Role::Actuator, Topic::Command, &command);
        assert_eq!(publish(39, 0), 2, "a refusal");
        assert_eq!(publish(40, 0), 2, "nothing is answered twice");
    }
}
