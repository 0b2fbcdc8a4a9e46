//! The sample audit of a run: what became of every sample of every topic.
//!
//! Three sources are compared. The *bus*: the orchestrator receives all samples of all topics, whether they count or
//! not. The *readers*: each heartbeat has counters of the samples of each input. The *writers*: each heartbeat has the
//! numbers that were used, and the inputs that were answered. A sample that one source has and another lacks is a fault
//! with a topic and a number or a scan. A fault is reported only when it is certain: a sample may be on its way, a
//! buffer may have been full, a process may have died.
//!
//! Not covered: the first samples of a process that was started while the robot drove, and what a process does between
//! its last heartbeat and its death. A process that sends no counters is judged from the bus alone.

use std::collections::BTreeMap;

use runtime::{LinkLoss, LossReason};
use shared_types::{Heartbeat, ProcessState, Role, Sample, Topic};

use super::crossing::Crossing;
use super::fault::{Fault, Kind};
use super::refused::{NewRefusal, Refused, RefusedRow};
use super::rows::{LedgerReport, LedgerRow, StrangerRow};
use super::sweep::{Lack, Sweep};
use super::topic::{InputReport, TopicLedger};
use super::{NOT_OBSERVED, ROBOT_HELD_UP, TIMEOUT_NS};

/// The topics that are audited: those of the loop, and the truth.
pub const AUDITED_TOPICS: [Topic; 7] = [
    Topic::Odometry,
    Topic::Scan,
    Topic::Pose,
    Topic::Obstacles,
    Topic::Command,
    Topic::Actuation,
    Topic::Truth,
];

/// A process that publishes for so long without a heartbeat fills no role [ns].
const STRANGER_NS: u64 = 1_000_000_000;
/// Processes without a role that are counted one by one.
const MAX_STRANGERS: usize = 64;
/// Maximum number of faults that are stored one by one; more are counted.
const MAX_FAULTS: usize = 1000;

/// The sample audit of one run.
#[derive(Debug, Clone, Default)]
pub struct SampleAudit {
    skips_are_faults: bool,
    midway: bool,
    driving: bool,
    run_ended: bool,
    topics: BTreeMap<Topic, TopicLedger>,
    workers: BTreeMap<u32, Worker>,
    sweeps: BTreeMap<u32, Sweep>,
    /// Robots that died: their last sweep may be incomplete.
    dead: Vec<u32>,
    excused: Vec<(u64, &'static str)>,
    crossing: Crossing,
    /// Scans of samples that were lost between two hosts.
    lost_scans: Vec<(u64, LossReason)>,
    /// The faults so far and their numbers.
    found: LedgerReport,
    /// How many of the faults were returned.
    reported: usize,
    refused: Refused,
    /// Samples of processes that send no heartbeat.
    strangers: BTreeMap<(Topic, u32), Stranger>,
}

/// Samples on a topic of the loop from a process that fills no role.
#[derive(Debug, Clone, Copy)]
struct Stranger {
    count: u64,
    since_ns: u64,
    is_reported: bool,
}

/// A process, from its heartbeats.
#[derive(Debug, Clone, Default)]
struct Worker {
    from_start: bool,
    connected_ns: Option<u64>,
    /// It ended with the run and finished its work.
    has_finished: bool,
    /// Missing answers that were reported: how many, and the sum of their scans.
    reported: (u64, u64),
    owes: Option<Debt>,
}

/// Inputs that a process took and has not answered.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Debt {
    role: Role,
    count: u64,
    scans: u64,
    since_ns: u64,
    is_certain: bool,
}

impl SampleAudit {
    /// An empty audit. A robot that is held up skips scans; in lock-step none is.
    pub fn new(skips_are_faults: bool) -> Self {
        Self {
            skips_are_faults,
            topics: AUDITED_TOPICS.map(|topic| (topic, TopicLedger::new(topic))).into(),
            ..Self::default()
        }
    }

    /// An audit of a run that another orchestrator started: counts begin at the first heartbeat of each process.
    pub fn midway() -> Self {
        Self { midway: true, driving: true, ..Self::new(false) }
    }

    /// The system has several hosts: samples may be lost between them.
    pub fn linked(&mut self) {
        self.crossing.link();
    }

    /// Samples were lost between two hosts; the same report may come any number of times.
    pub fn lost_between_hosts<'a>(&mut self, losses: impl IntoIterator<Item = &'a LinkLoss>) {
        losses.into_iter().for_each(|loss| self.crossing.note(loss));
    }

    /// Scans with a sample that was lost between two hosts, since the last call, each with the reason.
    pub fn lost_scans(&mut self) -> Vec<(u64, LossReason)> {
        std::mem::take(&mut self.lost_scans)
    }

    /// All processes are connected; the first sample may be published.
    pub fn driving(&mut self) {
        if !self.driving {
            self.driving = true;
            let connected = self.workers.values_mut().filter(|worker| worker.connected_ns.is_some());
            connected.for_each(|worker| worker.from_start = true);
        }
    }

    /// The run has ended: processes that end from now on did not die.
    pub fn run_ended(&mut self) {
        self.run_ended = true;
    }

    /// A poll of a topic begins.
    pub fn poll(&mut self, topic: Topic, now_ns: u64) {
        if let Some(ledger) = self.topics.get_mut(&topic) {
            ledger.poll(now_ns);
        }
    }

    /// The poll at `now_ns` found a sample.
    pub fn see<S: Sample>(&mut self, sample: &S, now_ns: u64) {
        let (topic, header) = (S::TOPIC, sample.header());
        let from_start = self.is_from_start(header.incarnation);
        if !self.workers.contains_key(&header.incarnation) {
            self.note_stranger(topic, header.incarnation, now_ns);
        }
        // The actuator's own decisions carry the number of the scan before.
        let is_answer = sample.is_answer();
        let fault = self.topics.get_mut(&topic).and_then(|ledger| ledger.see(header, is_answer, from_start));
        self.note(fault);
        if topic.writer() == Some(Role::Robot) {
            let first = if from_start { 1 } else { header.scan_id };
            let sweep = self.sweeps.entry(header.incarnation).or_insert_with(|| Sweep::new(first));
            sweep.see(topic, header.scan_id, now_ns);
        }
    }

    /// The poll found a full buffer, of so many samples: others may have been overwritten.
    pub fn overflowed(&mut self, topic: Topic, capacity: usize) {
        let ledger = self.topics.get_mut(&topic);
        let (scans, began) = ledger.map_or_else(Default::default, |ledger| {
            (ledger.overflowed(capacity as u64), ledger.began_midway())
        });
        if (began || !scans.is_empty()) && topic.writer() == Some(Role::Robot) {
            let unseen = self.sweeps.values_mut().flat_map(Sweep::overflowed);
            self.excused.extend(unseen.map(|scan| (scan, NOT_OBSERVED)));
        }
        // Scans are counted by the truth, or by themselves where there is none.
        let has_truth = self.sweeps.values().any(Sweep::has_truth);
        if topic == if has_truth { Topic::Truth } else { Topic::Scan } {
            self.excused.extend(scans.into_iter().flatten().map(|scan| (scan, NOT_OBSERVED)));
        }
    }

    /// A heartbeat arrived.
    pub fn receive(&mut self, heartbeat: &Heartbeat, now_ns: u64) {
        let incarnation = heartbeat.header.incarnation;
        let (Ok(role), Ok(state)) = (Role::try_from(heartbeat.role), ProcessState::try_from(heartbeat.state))
        else {
            return;
        };
        let midway = self.midway;
        self.refused.add_heartbeat(role, heartbeat, midway && !self.workers.contains_key(&incarnation));
        let worker = self.workers.entry(incarnation).or_insert_with(|| Worker {
            reported: if midway { Worker::debt(heartbeat) } else { (0, 0) },
            ..Worker::default()
        });
        if [ProcessState::Connected, ProcessState::Ready].contains(&state) {
            worker.connected_ns.get_or_insert(heartbeat.issued_ns);
        }
        worker.has_finished |= self.run_ended && state == ProcessState::Ending;
        worker.receive(role, heartbeat);
        let (from_start, connected_ns) = (worker.from_start, worker.connected_ns);
        for (topic, sequence) in role.writes().iter().zip(heartbeat.written) {
            if let Some(ledger) = self.topics.get_mut(topic) {
                ledger.claimed(incarnation, from_start, sequence, now_ns);
            }
        }
        if let Some(connected_ns) = connected_ns {
            self.receive_counters(role, heartbeat, from_start, connected_ns);
        }
        if state == ProcessState::Ending {
            self.ended(incarnation, now_ns);
        }
    }

    fn receive_counters(&mut self, role: Role, heartbeat: &Heartbeat, from_start: bool, connected_ns: u64) {
        let incarnation = heartbeat.header.incarnation;
        let (midway, polled_ns) = (self.midway, heartbeat.looked_ns);
        for (topic, counters) in role.reads().iter().zip(&heartbeat.inputs) {
            let Some(ledger) = self.topics.get_mut(topic) else { continue };
            if polled_ns == 0 {
                ledger.add_silent_reader(incarnation, role);
            } else {
                ledger.receive(InputReport {
                    incarnation,
                    role,
                    from_start,
                    midway,
                    connected_ns,
                    polled_ns,
                    counters,
                });
            }
        }
    }

    /// A process ended.
    pub fn ended(&mut self, incarnation: u32, now_ns: u64) {
        let is_death = !self.run_ended;
        self.topics.values_mut().for_each(|ledger| ledger.ended(incarnation, now_ns, is_death));
        if is_death {
            self.dead.push(incarnation);
        }
    }

    /// Compares what all sources report; returns the faults found since the last call. With `is_last`, after the last
    /// heartbeats of a run, late samples are not waited for.
    pub fn reconcile(&mut self, is_last: bool) -> Vec<Fault> {
        self.found.closings += 1;
        let mut found: Vec<Fault> =
            self.topics.values_mut().flat_map(|ledger| ledger.reconcile(is_last)).collect();
        found.extend(self.unanswered());
        found.extend(self.lacking(is_last));
        for (topic, incarnation, sequence, reason) in self.crossing.take_unnamed() {
            let scan_id = self.topics.get(&topic).map_or(0, |ledger| ledger.scan_of(incarnation, sequence));
            self.lost_scans.extend((scan_id > 0).then_some((scan_id, reason)));
        }
        let now_ns = self.topics.values().map(TopicLedger::polled_ns).max().unwrap_or(0);
        let found = self.crossing.filter(found, now_ns, is_last);
        found.into_iter().for_each(|fault| self.note(Some(fault)));
        let new = self.found.faults[self.reported..].to_vec();
        self.reported = self.found.faults.len();
        new
    }

    /// Whether a sample is known to be missing.
    pub fn is_something_missing(&self) -> bool {
        self.found.residual > 0
    }

    /// Processes without a role that publish on topics of the loop for longer than a second, or at all with `is_last`:
    /// those that were not returned before.
    pub fn new_strangers(&mut self, now_ns: u64, is_last: bool) -> Vec<StrangerRow> {
        let Self { strangers, workers, .. } = self;
        strangers.retain(|(_, incarnation), _| !workers.contains_key(incarnation));
        let is_new = |stranger: &&mut Stranger| {
            !stranger.is_reported && (is_last || now_ns > stranger.since_ns.saturating_add(STRANGER_NS))
        };
        let rows = strangers.iter_mut().map(|(key, stranger)| (*key, stranger));
        rows.filter_map(|(key, stranger)| {
            is_new(&stranger).then(|| {
                stranger.is_reported = true;
                stranger.row(key)
            })
        })
        .collect()
    }

    /// What readers dropped or refused because of its content since the last call.
    pub fn new_refusals(&mut self) -> Vec<NewRefusal> {
        self.refused.take_new()
    }

    /// Samples that readers dropped or refused because of their content.
    pub fn refused(&self) -> &[RefusedRow] {
        self.refused.rows()
    }

    /// Scans that may stay without an answer, since the last call, each with the reason.
    pub fn excused(&mut self) -> Vec<(u64, &'static str)> {
        std::mem::take(&mut self.excused)
    }

    /// The result, as if the run had ended now.
    pub fn report(&self) -> LedgerReport {
        let loop_topics = self.topics.iter().filter(|(topic, _)| **topic != Topic::Truth);
        LedgerReport {
            unobserved: self.topics.values().map(TopicLedger::unobserved).sum(),
            topics: loop_topics
                .flat_map(|(_, ledger)| ledger.rows())
                .map(|row| self.with_losses(row))
                .collect(),
            link_losses: self.crossing.total(),
            refused: self.refused.rows().to_vec(),
            strangers: self
                .strangers
                .iter()
                .filter(|((_, incarnation), _)| !self.workers.contains_key(incarnation))
                .map(|(key, stranger)| stranger.row(*key))
                .collect(),
            ..self.found.clone()
        }
    }

    /// Of what is unexplained in a row, the samples that were lost between two hosts.
    fn with_losses(&self, mut row: LedgerRow) -> LedgerRow {
        let counts: Vec<_> = self.crossing.counts(&row.topic, &row.reader).collect();
        for (reason, count) in counts {
            let lost = count.min(row.residual);
            (row.lost, row.residual) = (row.lost + lost, row.residual - lost);
            row.count(reason.name(), lost);
        }
        row
    }

    fn note_stranger(&mut self, topic: Topic, incarnation: u32, now_ns: u64) {
        let key = (topic, incarnation);
        if self.strangers.len() < MAX_STRANGERS || self.strangers.contains_key(&key) {
            let new = Stranger { count: 0, since_ns: now_ns, is_reported: false };
            self.strangers.entry(key).or_insert(new).count += 1;
        }
    }

    fn is_from_start(&self, incarnation: u32) -> bool {
        self.workers.get(&incarnation).is_some_and(|worker| worker.from_start)
    }

    /// Outputs that are missing: the inputs for them were used.
    fn unanswered(&mut self) -> Vec<Fault> {
        let mut found = Vec::new();
        for (incarnation, worker) in &mut self.workers {
            let Some(debt) = worker.owes.take_if(|debt| debt.is_certain) else { continue };
            worker.reported = (worker.reported.0 + debt.count, worker.reported.1.wrapping_add(debt.scans));
            let Some(topic) = debt.role.writes().first() else { continue };
            let scan_id = if debt.count == 1 { debt.scans } else { 0 };
            // An input that came twice is answered once, and one that came after a later one not at all.
            let is_excused = |fault: &Fault| {
                matches!(fault.kind, Kind::Duplicate | Kind::Reordered)
                    && debt.role.answers().is_some_and(|topic| fault.topic == topic.name())
                    && fault.scan_id == scan_id
            };
            if scan_id == 0 || !self.found.faults.iter().any(is_excused) {
                found.push(
                    Fault::new(*topic, Kind::Missing, *incarnation).scan(scan_id).noticed_by(debt.role),
                );
            }
        }
        found
    }

    /// Samples that the robot did not publish for a scan.
    fn lacking(&mut self, is_last: bool) -> Vec<Fault> {
        let mut found = Vec::new();
        let now_ns = self.topics.values().map(TopicLedger::polled_ns).min().unwrap_or(0);
        for (incarnation, sweep) in &mut self.sweeps {
            let has_finished = self.workers.get(incarnation).is_some_and(|robot| robot.has_finished);
            let is_dead = self.dead.contains(incarnation);
            for lack in sweep.reconcile(now_ns, is_dead || is_last && has_finished) {
                let missing = |topic, scan_id| Fault::new(topic, Kind::Missing, *incarnation).scan(scan_id);
                match lack {
                    // It may have died between two topics.
                    Lack::Sample(..) if is_dead => {}
                    Lack::Sample(topic, scan_id) => found.push(missing(topic, scan_id)),
                    Lack::Skipped(scan_id) if self.skips_are_faults => {
                        found.push(missing(Topic::Scan, scan_id))
                    }
                    Lack::Skipped(scan_id) => self.excused.push((scan_id, ROBOT_HELD_UP)),
                }
            }
        }
        found
    }

    fn note(&mut self, fault: Option<Fault>) {
        let Some(fault) = fault else { return };
        if let Some(known) = self.found.faults.iter_mut().find(|known| known.is_same(&fault)) {
            known.sequence = if known.sequence == 0 { fault.sequence } else { known.sequence };
            known.scan_id = if known.scan_id == 0 { fault.scan_id } else { known.scan_id };
            return;
        }
        match fault.kind {
            Kind::Missing | Kind::Vanished => self.found.residual += 1,
            Kind::Duplicate => self.found.duplicates += 1,
            Kind::Reordered => self.found.reordered += 1,
        }
        if self.found.faults.len() < MAX_FAULTS {
            self.found.faults.push(fault);
        }
    }
}

impl Stranger {
    fn row(&self, (topic, incarnation): (Topic, u32)) -> StrangerRow {
        StrangerRow { topic: topic.name().to_owned(), incarnation, samples: self.count }
    }
}

impl Worker {
    /// Inputs that were taken and not answered: how many, and the sum of their scans.
    fn debt(heartbeat: &Heartbeat) -> (u64, u64) {
        let Heartbeat { taken, answered, taken_scans, answered_scans, .. } = heartbeat;
        (taken.saturating_sub(*answered), taken_scans.wrapping_sub(*answered_scans))
    }

    fn receive(&mut self, role: Role, heartbeat: &Heartbeat) {
        let debt = Self::debt(heartbeat);
        let (count, scans) = (debt.0.saturating_sub(self.reported.0), debt.1.wrapping_sub(self.reported.1));
        // A process that was started without the state it needs sends no output at first.
        let is_silent = heartbeat.answered == 0 && !self.from_start;
        if count == 0 || is_silent {
            self.owes = None;
            return;
        }
        let since_ns = match self.owes {
            Some(debt) if (debt.count, debt.scans) == (count, scans) => debt.since_ns,
            _ => heartbeat.issued_ns,
        };
        let passed_over = count == 1 && scans < heartbeat.header.scan_id;
        let waited = heartbeat.issued_ns.saturating_sub(since_ns) >= TIMEOUT_NS;
        self.owes = Some(Debt {
            role,
            count,
            scans,
            since_ns,
            is_certain: passed_over || waited || self.has_finished,
        });
    }
}

#[cfg(test)]
mod tests {
    use shared_types::{Odometry, Scan, Truth};

    use super::*;

    #[test]
    fn a_robot_that_is_first_seen_behind_a_full_buffer_lacks_nothing() {
        let mut sample_audit = SampleAudit::midway();
        fn poll<S: Sample + Default>(sample_audit: &mut SampleAudit, scans: std::ops::RangeInclusive<u64>) {
            sample_audit.poll(S::TOPIC, 10);
            for scan_id in scans {
                let mut sample = S::default();
                let header = sample.header_mut();
                (header.incarnation, header.sequence, header.scan_id) = (9, scan_id, scan_id);
                sample_audit.see(&sample, 10);
            }
        }
        poll::<Truth>(&mut sample_audit, 101..=140);
        poll::<Scan>(&mut sample_audit, 125..=140);
        sample_audit.overflowed(Topic::Scan, 16);
        poll::<Odometry>(&mut sample_audit, 125..=140);
        sample_audit.overflowed(Topic::Odometry, 16);
        AUDITED_TOPICS.iter().for_each(|topic| sample_audit.poll(*topic, 10 + 2 * TIMEOUT_NS));
        assert_eq!(sample_audit.reconcile(false), []);
    }

    #[test]
    fn scans_that_a_robot_skipped_before_it_died_are_excused() {
        // Scans seen before its death, and after it.
        for (before, after, skipped) in
            [(vec![1, 5], vec![], 2..=4), (vec![1], vec![5], 2..=4), (vec![], vec![5], 1..=4)]
        {
            let mut sample_audit = SampleAudit::new(false);
            let see = |sample_audit: &mut SampleAudit, scan_id| {
                let mut truth = Truth::default();
                (truth.header.incarnation, truth.header.sequence, truth.header.scan_id) =
                    (9, scan_id, scan_id);
                sample_audit.see(&truth, 10);
            };
            let mut heartbeat = Heartbeat { role: Role::Robot.wire(), ..Heartbeat::default() };
            (heartbeat.state, heartbeat.header.incarnation) = (ProcessState::Connected.wire(), 9);
            sample_audit.receive(&heartbeat, 5);
            sample_audit.driving();
            before.into_iter().for_each(|scan_id| see(&mut sample_audit, scan_id));
            sample_audit.ended(9, 20);
            after.into_iter().for_each(|scan_id| see(&mut sample_audit, scan_id));
            sample_audit.reconcile(false);
            assert_eq!(sample_audit.excused(), skipped.map(|scan| (scan, ROBOT_HELD_UP)).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_process_that_publishes_without_a_role_is_named_once_and_counted() {
        let mut sample_audit = SampleAudit::new(false);
        let mut publish = |incarnation, sequence, now_ns| {
            let mut scan = Scan::default();
            (scan.header.incarnation, scan.header.sequence, scan.header.scan_id) =
                (incarnation, sequence, sequence);
            sample_audit.see(&scan, now_ns);
        };
        (1..=5).for_each(|sequence| publish(77, sequence, 10));
        publish(3, 6, 10);
        let mut heartbeat = Heartbeat { role: Role::Robot.wire(), ..Heartbeat::default() };
        heartbeat.header.incarnation = 3;
        sample_audit.receive(&heartbeat, 20);
        assert_eq!(sample_audit.new_strangers(STRANGER_NS, false), []);
        let [row] = sample_audit.new_strangers(STRANGER_NS + 11, false).try_into().unwrap();
        assert_eq!((row.topic.as_str(), row.incarnation, row.samples), ("scan", 77, 5));
        assert_eq!(sample_audit.new_strangers(STRANGER_NS + 12, true), []);
        assert_eq!(sample_audit.report().strangers, [row]);
    }

    #[test]
    fn a_robot_that_died_between_two_topics_owes_nothing() {
        let mut sample_audit = SampleAudit::new(false);
        let mut truth = Truth::default();
        (truth.header.incarnation, truth.header.sequence, truth.header.scan_id) = (9, 1, 1);
        sample_audit.see(&truth, 10);
        sample_audit.ended(9, 20);
        (truth.header.sequence, truth.header.scan_id) = (2, 2);
        sample_audit.see(&truth, 30);
        AUDITED_TOPICS.iter().for_each(|topic| sample_audit.poll(*topic, 30 + 2 * TIMEOUT_NS));
        assert_eq!(sample_audit.reconcile(false), []);
    }
}
