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
use std::ops::RangeInclusive;

use runtime::{LinkLoss, LossReason};
use shared_types::{Header, Heartbeat, ProcessState, Role, Sample, Topic};

use super::crossing::Crossing;
use super::fault::{DeliveryFault, DeliveryFaultKind};
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
/// Processes that are followed at a time: more than follow each other within [`SILENT_NS`].
const MAX_WORKERS: usize = 4096;
/// Where there are more, one without a heartbeat for so long is not followed any longer [ns].
const SILENT_NS: u64 = 10_000_000_000;
/// Ranges of excused scans that wait until they are taken.
const MAX_EXCUSED: usize = 1024;

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
    excused: Vec<(RangeInclusive<u64>, &'static str)>,
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
    /// When its last heartbeat arrived [ns].
    beat_ns: u64,
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
        // The actuator's own decisions carry the number of the scan before.
        if !self.follow(topic, header, sample.is_answer(), now_ns) {
            return;
        }
        if topic.writer() == Some(Role::Robot) {
            let first = if from_start { 1 } else { header.scan_id };
            let sweep = self.sweeps.entry(header.incarnation).or_insert_with(|| Sweep::new(first));
            sweep.see(topic, header.scan_id, now_ns);
        }
    }

    /// The poll at `now_ns` found a sample whose scan cannot exist: it has a place among those of its writer at most.
    pub fn see_impossible<S: Sample>(&mut self, sample: &S, now_ns: u64) {
        let Header { incarnation, sequence, scan_id, .. } = *sample.header();
        if self.follow(S::TOPIC, sample.header(), false, now_ns) && self.workers.contains_key(&incarnation) {
            let fault = DeliveryFault::new(S::TOPIC, DeliveryFaultKind::Impossible, incarnation);
            self.note(Some(fault.sequence(sequence).scan(scan_id)));
        }
    }

    /// Notes the number of a sample; false when its writer is not followed, because too many fill no role.
    fn follow(&mut self, topic: Topic, header: &Header, is_answer: bool, now_ns: u64) -> bool {
        let from_start = self.is_from_start(header.incarnation);
        let is_known = self.workers.contains_key(&header.incarnation);
        if !is_known && !self.note_stranger(topic, header.incarnation, now_ns) {
            return false;
        }
        let fault = self.topics.get_mut(&topic).and_then(|ledger| ledger.see(header, is_answer, from_start));
        self.note(fault);
        true
    }

    /// The poll found a full buffer, of so many samples: others may have been overwritten.
    pub fn overflowed(&mut self, topic: Topic, capacity: usize) {
        let ledger = self.topics.get_mut(&topic);
        let (scans, began) = ledger.map_or_else(Default::default, |ledger| {
            (ledger.overflowed(capacity as u64), ledger.began_midway())
        });
        if (began || !scans.is_empty()) && topic.writer() == Some(Role::Robot) {
            let unseen: Vec<_> = self.sweeps.values_mut().flat_map(Sweep::overflowed).collect();
            unseen.into_iter().for_each(|scans| self.excuse(scans, NOT_OBSERVED));
        }
        // Scans are counted by the truth, or by themselves where there is none.
        let has_truth = self.sweeps.values().any(Sweep::has_truth);
        if topic == if has_truth { Topic::Truth } else { Topic::Scan } {
            scans.into_iter().for_each(|scans| self.excuse(scans, NOT_OBSERVED));
        }
    }

    /// A heartbeat arrived.
    pub fn receive(&mut self, heartbeat: &Heartbeat, now_ns: u64) {
        let incarnation = heartbeat.header.incarnation;
        let (Ok(role), Ok(state)) = (Role::try_from(heartbeat.role), ProcessState::try_from(heartbeat.state))
        else {
            return;
        };
        if !self.has_room_for(incarnation, now_ns) {
            return;
        }
        let midway = self.midway;
        self.refused.add_heartbeat(role, heartbeat, midway && !self.workers.contains_key(&incarnation));
        let worker = self.workers.entry(incarnation).or_insert_with(|| Worker {
            reported: if midway { Worker::debt(heartbeat) } else { (0, 0) },
            ..Worker::default()
        });
        if [ProcessState::Connected, ProcessState::Ready].contains(&state) {
            worker.connected_ns.get_or_insert(heartbeat.issued_ns);
        }
        worker.beat_ns = now_ns;
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
            if role.may_ignore(*topic) && *counters == Default::default() {
                continue;
            }
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
    pub fn reconcile(&mut self, is_last: bool) -> Vec<DeliveryFault> {
        self.found.closings += 1;
        let mut found: Vec<DeliveryFault> =
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
    pub fn excused(&mut self) -> Vec<(RangeInclusive<u64>, &'static str)> {
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

    /// Counts a sample of a process without a role; false when there are too many of them.
    fn note_stranger(&mut self, topic: Topic, incarnation: u32, now_ns: u64) -> bool {
        let key = (topic, incarnation);
        let has_room = self.strangers.len() < MAX_STRANGERS || self.strangers.contains_key(&key);
        if has_room {
            let new = Stranger { count: 0, since_ns: now_ns, is_reported: false };
            self.strangers.entry(key).or_insert(new).count += 1;
        }
        has_room
    }

    /// Whether a process is followed or can be, perhaps in place of one that has been silent for long.
    fn has_room_for(&mut self, incarnation: u32, now_ns: u64) -> bool {
        if self.workers.len() < MAX_WORKERS || self.workers.contains_key(&incarnation) {
            return true;
        }
        let silent = |worker: &Worker| now_ns.saturating_sub(worker.beat_ns) > SILENT_NS;
        let oldest = self.workers.iter().find(|(_, worker)| silent(worker)).map(|(oldest, _)| *oldest);
        let Some(oldest) = oldest else { return false };
        self.ended(oldest, now_ns);
        self.workers.remove(&oldest);
        self.sweeps.remove(&oldest);
        self.refused.forget(oldest);
        true
    }

    /// Notes that scans may stay without an answer.
    fn excuse(&mut self, scans: RangeInclusive<u64>, reason: &'static str) {
        if self.excused.len() < MAX_EXCUSED && !scans.is_empty() {
            self.excused.push((scans, reason));
        }
    }

    fn is_from_start(&self, incarnation: u32) -> bool {
        self.workers.get(&incarnation).is_some_and(|worker| worker.from_start)
    }

    /// Outputs that are missing: the inputs for them were used.
    fn unanswered(&mut self) -> Vec<DeliveryFault> {
        let mut found = Vec::new();
        for (incarnation, worker) in &mut self.workers {
            let Some(debt) = worker.owes.take_if(|debt| debt.is_certain) else { continue };
            worker.reported = (worker.reported.0 + debt.count, worker.reported.1.wrapping_add(debt.scans));
            let Some(topic) = debt.role.writes().first() else { continue };
            let scan_id = if debt.count == 1 { debt.scans } else { 0 };
            // An input that came twice is answered once, and one that came after a later one not at all.
            let is_excused = |fault: &DeliveryFault| {
                matches!(fault.kind, DeliveryFaultKind::Duplicate | DeliveryFaultKind::Reordered)
                    && debt.role.answers().is_some_and(|topic| fault.topic == topic.name())
                    && fault.scan_id == scan_id
            };
            if scan_id == 0 || !self.found.faults.iter().any(is_excused) {
                found.push(
                    DeliveryFault::new(*topic, DeliveryFaultKind::Missing, *incarnation)
                        .scan(scan_id)
                        .noticed_by(debt.role),
                );
            }
        }
        found
    }

    /// Samples that the robot did not publish for a scan.
    fn lacking(&mut self, is_last: bool) -> Vec<DeliveryFault> {
        let (mut found, mut skipped) = (Vec::new(), Vec::new());
        let now_ns = self.topics.values().map(TopicLedger::polled_ns).min().unwrap_or(0);
        for (incarnation, sweep) in &mut self.sweeps {
            let has_finished = self.workers.get(incarnation).is_some_and(|robot| robot.has_finished);
            let is_dead = self.dead.contains(incarnation);
            for lack in sweep.reconcile(now_ns, is_dead || is_last && has_finished) {
                let missing = |topic, scan_id| {
                    DeliveryFault::new(topic, DeliveryFaultKind::Missing, *incarnation).scan(scan_id)
                };
                match lack {
                    // It may have died between two topics.
                    Lack::Sample(..) if is_dead => {}
                    Lack::Sample(topic, scan_id) => found.push(missing(topic, scan_id)),
                    Lack::Skipped(scans) if self.skips_are_faults => {
                        let count = scans.end().saturating_sub(*scans.start()).saturating_add(1);
                        found.push(missing(Topic::Scan, *scans.start()).count(count));
                    }
                    Lack::Skipped(scans) => skipped.push(scans),
                }
            }
        }
        skipped.into_iter().for_each(|scans| self.excuse(scans, ROBOT_HELD_UP));
        found
    }

    fn note(&mut self, fault: Option<DeliveryFault>) {
        let Some(fault) = fault else { return };
        let known = self.found.faults.iter_mut().find(|known| known.is_same(&fault));
        let (is_known, count) = match known {
            Some(known) => (true, known.merge(&fault)),
            None => (false, fault.count),
        };
        let total = match fault.kind {
            DeliveryFaultKind::Missing | DeliveryFaultKind::Vanished => &mut self.found.residual,
            DeliveryFaultKind::Duplicate => &mut self.found.duplicates,
            DeliveryFaultKind::Reordered => &mut self.found.reordered,
            DeliveryFaultKind::Impossible => &mut self.found.impossible,
        };
        *total = total.saturating_add(count);
        if is_known {
            return;
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
            assert_eq!(sample_audit.excused(), [(skipped, ROBOT_HELD_UP)]);
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
    fn the_audit_takes_a_limited_amount_of_memory_whatever_is_published() {
        let mut sample_audit = SampleAudit::new(false);
        let numbers = [0, 1, 2, 1 << 40, 1 << 48, (1 << 63) - 1, 1 << 63, u64::MAX - 1, u64::MAX];
        for round in 0..15_000 {
            let now_ns = 1_000_000_000 + round * 2_000_000;
            let (number, other) = (numbers[round as usize % 9], numbers[round as usize / 9 % 9]);
            let incarnation = round as u32;
            let mut scan = Scan::default();
            (scan.header.incarnation, scan.header.sequence, scan.header.scan_id) =
                (incarnation, number, other);
            sample_audit.poll(Topic::Scan, now_ns);
            sample_audit.see(&scan, now_ns);
            sample_audit.see_impossible(&scan, now_ns);
            let mut heartbeat =
                Heartbeat { role: Role::Obstacles.wire(), looked_ns: 1, ..Heartbeat::default() };
            heartbeat.state = ProcessState::Ready.wire();
            heartbeat.header.incarnation = incarnation;
            heartbeat.written[0] = number.min(1 << 48);
            heartbeat.inputs[0].missing = number.min(1 << 48);
            sample_audit.receive(&heartbeat, now_ns);
            if round % 1_000 == 0 {
                sample_audit.reconcile(false);
            }
        }
        assert!(sample_audit.workers.len() <= MAX_WORKERS && sample_audit.strangers.len() <= MAX_STRANGERS);
        assert!(sample_audit.sweeps.len() <= MAX_WORKERS + MAX_STRANGERS);
        assert!(sample_audit.excused.len() <= MAX_EXCUSED && sample_audit.found.faults.len() <= MAX_FAULTS);
        assert!(sample_audit.refused.readers() <= 2 * MAX_WORKERS);
        for ledger in sample_audit.topics.values() {
            let [streams, readers] = ledger.sizes();
            // Those that have ended are kept until they are settled, 10 s later.
            assert!(streams <= 2 * MAX_WORKERS + MAX_STRANGERS, "{streams}");
            assert!(readers <= 4 * MAX_WORKERS, "{readers}");
        }
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
