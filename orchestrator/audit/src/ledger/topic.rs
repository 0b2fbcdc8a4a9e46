//! The ledger of one topic: what was published, and what became of it at each reader.
//!
//! For every role that reads the topic
//!
//! ```text
//! published = used + replaced + lost + in flight + residual
//! ```
//!
//! *Published* counts each sample once per process that should receive it, so twice during a swap. *Replaced* are
//! samples that a rule drops: a newer one was used, too old, writer without authority, bad content. *Lost* are samples
//! that waited at a process that died, or had not reached it yet. *In flight* are samples that wait at a reader, or
//! were published after its last heartbeat. The *residual* is unexplained; it must be zero.
//!
//! What a reader that was killed did after its last heartbeat is not known: those samples count as lost.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

use runtime::PROCESS_QUEUE;
use shared_types::{Header, InputAccount, MAX_NUMBER, Role, Span, Topic};

use super::TIMEOUT_NS;
use super::fault::{DeliveryFault, DeliveryFaultKind};
use super::rows::LedgerRow;
use super::stream::{Seen, Stream};

/// Writers of one reader, and readers without counters, that are counted one by one: more than follow each other until the
/// first is settled.
const MAX_WRITERS: usize = 1024;
/// Entries of faults that one reader notices between two reconciliations; more are added up.
const MAX_NOTICED: usize = 64;

/// This long after the end of a process nothing of it can come any more [ns].
const SETTLED_NS: u64 = 25 * TIMEOUT_NS;

/// The ledger of one topic.
#[derive(Debug, Clone)]
pub struct TopicLedger {
    topic: Topic,
    streams: BTreeMap<u32, Stream>,
    readers: BTreeMap<u32, Reader>,
    /// Processes that read the topic and send no counters.
    silent: BTreeMap<u32, SilentReader>,
    settled: Settled,
    before_ns: u64,
    now_ns: u64,
}

/// One process that reads the topic, from its heartbeats.
#[derive(Debug, Clone)]
struct Reader {
    role: Role,
    from_start: bool,
    connected_ns: u64,
    polled_ns: u64,
    counters: InputAccount,
    /// Counters of the report before.
    reported: InputAccount,
    /// Faults that it noticed since the last reconciliation: kind, writer, first number and count.
    noticed: Vec<(DeliveryFaultKind, u32, u64, u64)>,
    /// By writer: the first sample after the last that arrived here, as it arrived at the orchestrator.
    beyond: BTreeMap<u32, Seen>,
    spans: BTreeMap<u32, Span>,
    /// First spans that do not begin with 1, too short for the buffer to have been full.
    begun: Vec<Span>,
    end: Option<ReaderEnd>,
}

/// A process that sends no counters: samples that were published while it lived were for it.
#[derive(Debug, Clone)]
struct SilentReader {
    role: Role,
    end: Option<ReaderEnd>,
}

/// The newest number of each writer when a reader ended.
#[derive(Debug, Clone)]
struct ReaderEnd {
    newest: BTreeMap<u32, u64>,
    is_death: bool,
    ended_ns: u64,
}

/// What can't change any more.
#[derive(Debug, Clone, Default)]
struct Settled {
    rows: BTreeMap<Role, LedgerRow>,
    /// The largest number of a writer that was for a reader of the role that is settled.
    covered: BTreeMap<(Role, u32), u64>,
    writers: BTreeSet<u32>,
    unobserved: u64,
}

/// The counters of one input in a heartbeat.
#[derive(Debug, Clone, Copy)]
pub struct InputReport<'a> {
    /// Its incarnation.
    pub incarnation: u32,
    /// Its role.
    pub role: Role,
    /// Whether it was connected before the first sample was published.
    pub from_start: bool,
    /// Whether the counts of its first heartbeat belong to another orchestrator.
    pub midway: bool,
    /// Since when it is connected [ns].
    pub connected_ns: u64,
    /// When it last polled the bus [ns].
    pub polled_ns: u64,
    /// What became of them.
    pub counters: &'a InputAccount,
}

impl TopicLedger {
    /// An empty ledger.
    pub fn new(topic: Topic) -> Self {
        Self {
            topic,
            streams: BTreeMap::new(),
            readers: BTreeMap::new(),
            silent: BTreeMap::new(),
            settled: Settled::default(),
            before_ns: 0,
            now_ns: 0,
        }
    }

    /// When the topic was last polled [ns].
    pub fn polled_ns(&self) -> u64 {
        self.now_ns
    }

    /// A poll of the topic begins.
    pub fn poll(&mut self, now_ns: u64) {
        self.before_ns = self.now_ns;
        self.now_ns = now_ns;
    }

    /// The poll found a sample; `answers` unless its scan may be an older one. With `from_start` its writer started
    /// when all readers were connected.
    pub fn see(&mut self, header: &Header, answers: bool, from_start: bool) -> Option<DeliveryFault> {
        let (topic, after_ns, now_ns) = (self.topic, self.before_ns, self.now_ns);
        let Header { incarnation, sequence, .. } = *header;
        let begin = || Stream::new(topic, incarnation, sequence.clamp(1, MAX_NUMBER), from_start);
        self.streams.entry(incarnation).or_insert_with(begin).see(header, answers, after_ns, now_ns)
    }

    /// The poll found a full buffer, of `capacity` samples: others may have been overwritten. Returns the scans that were
    /// not observed.
    pub fn overflowed(&mut self, capacity: u64) -> Vec<RangeInclusive<u64>> {
        let now_ns = self.now_ns;
        self.streams.values_mut().flat_map(|stream| stream.overflowed(now_ns, capacity)).collect()
    }

    /// Whether this poll found the first sample of a writer that had published before.
    pub fn began_midway(&self) -> bool {
        self.streams.values().any(|stream| stream.began_midway(self.now_ns))
    }

    /// A writer reports to have used the numbers up to `sequence`.
    pub fn claimed(&mut self, incarnation: u32, from_start: bool, sequence: u64, now_ns: u64) {
        if from_start && sequence > 0 {
            let begin = || Stream::new(self.topic, incarnation, 1, true);
            self.streams.entry(incarnation).or_insert_with(begin);
        }
        if let Some(stream) = self.streams.get_mut(&incarnation) {
            stream.claimed(sequence, now_ns);
        }
    }

    /// A reader reports what became of its samples.
    pub fn receive(&mut self, report: InputReport<'_>) {
        let InputReport { incarnation, role, from_start, midway, connected_ns, polled_ns, counters } = report;
        self.silent.remove(&incarnation);
        let reader = self.readers.entry(incarnation).or_insert_with(|| Reader {
            role,
            from_start,
            connected_ns,
            polled_ns,
            counters: InputAccount::default(),
            reported: if midway { *counters } else { InputAccount::default() },
            noticed: Vec::new(),
            beyond: BTreeMap::new(),
            spans: BTreeMap::new(),
            begun: Vec::new(),
            end: None,
        });
        (reader.polled_ns, reader.counters) = (polled_ns, *counters);
        reader.notice();
        (reader.from_start, reader.connected_ns) = (from_start, connected_ns);
        let is_open =
            |span: &&Span| span.incarnation != 0 && !self.settled.writers.contains(&span.incarnation);
        for span in counters.writers.iter().filter(is_open) {
            let Reader { spans, begun, .. } = &mut *reader;
            if spans.len() >= MAX_WRITERS && !spans.contains_key(&span.incarnation) {
                continue;
            }
            let known = spans.entry(span.incarnation).or_insert_with(|| {
                if span.first > 1 && span.count() < PROCESS_QUEUE as u64 {
                    begun.push(*span);
                }
                *span
            });
            // What the reader said last: a number that its writer did not reach was wrong.
            (known.first, known.last) = (known.first.min(span.first), span.last);
        }
    }

    /// A process reads the topic and sends no counters.
    pub fn add_silent_reader(&mut self, incarnation: u32, role: Role) {
        if !self.silent.contains_key(&incarnation) && self.silent.len() >= MAX_WRITERS {
            self.silent.pop_first();
        }
        self.silent.entry(incarnation).or_insert(SilentReader { role, end: None });
    }

    /// A process ended, as writer or as reader; `is_death` when it did not end with the run.
    pub fn ended(&mut self, incarnation: u32, now_ns: u64, is_death: bool) {
        if let Some(stream) = self.streams.get_mut(&incarnation) {
            stream.ended(now_ns, is_death);
        }
        let newest = self.streams.iter().map(|(writer, stream)| (*writer, stream.newest())).collect();
        let end = ReaderEnd { newest, is_death, ended_ns: now_ns };
        if let Some(reader) = self.silent.get_mut(&incarnation) {
            reader.end.get_or_insert(end);
        } else if let Some(reader) = self.readers.get_mut(&incarnation) {
            reader.end.get_or_insert(end);
        }
    }

    /// The faults that are certain after the last poll. With `is_last`, after the last heartbeats of a run, late
    /// samples are not waited for.
    pub fn reconcile(&mut self, is_last: bool) -> Vec<DeliveryFault> {
        let mut faults = Vec::new();
        let Self { topic, streams, readers, now_ns, .. } = self;
        for stream in streams.values_mut() {
            faults.extend(stream.reconcile(*now_ns, is_last));
        }
        for reader in readers.values_mut() {
            reader.reconcile(*topic, streams, &mut faults);
        }
        self.settle();
        faults
    }

    /// Counts per role that reads the topic, as if the run had ended now.
    pub fn rows(&self) -> Vec<LedgerRow> {
        let mut roles: Vec<Role> = self.readers.values().map(|reader| reader.role).collect();
        roles.extend(self.settled.rows.keys());
        roles.sort_unstable();
        roles.dedup();
        roles.into_iter().map(|role| self.row(role)).collect()
    }

    /// Samples that only their readers counted, because the orchestrator polled too late.
    pub fn unobserved(&self) -> u64 {
        self.settled.unobserved + self.streams.values().map(|stream| stream.unobserved).sum::<u64>()
    }

    /// The scan of a sample that came or was lost, if it is known; else 0.
    pub fn scan_of(&self, incarnation: u32, sequence: u64) -> u64 {
        self.streams.get(&incarnation).map_or(0, |stream| stream.scan_of(sequence))
    }

    /// How many writers and readers are stored one by one.
    #[cfg(test)]
    pub(super) fn sizes(&self) -> [usize; 2] {
        [self.streams.len(), self.readers.len() + self.silent.len()]
    }

    fn row(&self, role: Role) -> LedgerRow {
        let mut row = self.settled.rows.get(&role).cloned().unwrap_or_default();
        (row.topic, row.reader) = (self.topic.name().to_owned(), role.name().to_owned());
        let mut covered = self.settled.covered.clone();
        for (&incarnation, reader) in self.readers.iter().filter(|(_, reader)| reader.role == role) {
            self.account(incarnation, reader, self.streams.iter(), &mut covered, &mut row);
            reader.account(&self.streams, &mut row);
        }
        row.residual = row.published.saturating_sub(row.used + row.replaced + row.lost + row.in_flight);
        row
    }

    /// Adds what became of the samples of these writers at one reader. `covered` are the largest numbers of each writer that
    /// were for earlier readers of the role.
    fn account<'a>(
        &self,
        incarnation: u32,
        reader: &Reader,
        streams: impl Iterator<Item = (&'a u32, &'a Stream)>,
        covered: &mut BTreeMap<(Role, u32), u64>,
        row: &mut LedgerRow,
    ) {
        let role = reader.role;
        let is_death = reader.end.as_ref().is_some_and(|end| end.is_death);
        for (&writer, stream) in streams {
            let span = reader.spans.get(&writer);
            row.published += span.map_or(0, Span::count);
            // Samples that a dead reader had not received may have been published before its successor came.
            if let (Some(span), Some(end)) = (span, covered.get(&(role, writer))) {
                let end = self.silent_until(role, incarnation, writer, stream).max(*end);
                let gap = span.first.saturating_sub(end.saturating_add(1));
                (row.published, row.lost) = (row.published + gap, row.lost + gap);
            }
            let newest = newest_for(reader.end.as_ref(), writer, stream);
            let tail = reader.last(writer, stream).map_or(0, |last| newest.saturating_sub(last));
            row.published += tail;
            let is_lost = stream.ended_ns.is_some_and(|ended_ns| reader.polled_ns > ended_ns);
            *(if is_lost || is_death { &mut row.lost } else { &mut row.in_flight }) += tail;
            let end = span.map_or(0, |span| span.last).max(newest);
            covered.entry((role, writer)).and_modify(|known| *known = end.max(*known)).or_insert(end);
        }
    }

    /// Adds up what can't change any more, so that a run with any number of swaps needs no more memory: readers that ended
    /// after all those before them, then writers that ended.
    fn settle(&mut self) {
        let mut settled = std::mem::take(&mut self.settled);
        while self.settle_readers(&mut settled) {}
        let is_settled =
            |stream: &Stream| stream.ended_ns.is_some_and(|ended_ns| is_old(ended_ns, self.now_ns));
        let writers = self.streams.iter().filter(|(_, stream)| is_settled(stream)).map(|(writer, _)| *writer);
        for writer in writers.collect::<Vec<_>>() {
            for (&incarnation, reader) in &self.readers {
                let row = settled.rows.entry(reader.role).or_default();
                let stream = self.streams.get_key_value(&writer);
                self.account(incarnation, reader, stream.into_iter(), &mut settled.covered, row);
            }
            settled.unobserved += self.streams.remove(&writer).map_or(0, |stream| stream.unobserved);
            settled.covered.retain(|(_, of), _| *of != writer);
            settled.writers.insert(writer);
            self.readers.values_mut().for_each(|reader| reader.forget(writer));
            let ends = self.silent.values_mut().filter_map(|reader| reader.end.as_mut());
            ends.for_each(|end| _ = end.newest.remove(&writer));
        }
        self.settled = settled;
    }

    /// Adds up the first reader of each role, if it has ended; returns whether one has.
    fn settle_readers(&mut self, settled: &mut Settled) -> bool {
        let mut first_of = BTreeMap::new();
        self.readers.iter().for_each(|(incarnation, reader)| {
            first_of.entry(reader.role).or_insert(*incarnation);
        });
        let before = self.readers.len();
        for (role, incarnation) in first_of {
            let reader = &self.readers[&incarnation];
            if reader.end.as_ref().is_some_and(|end| is_old(end.ended_ns, self.now_ns)) {
                let row = settled.rows.entry(role).or_default();
                self.account(incarnation, reader, self.streams.iter(), &mut settled.covered, row);
                reader.account(&self.streams, row);
                self.readers.remove(&incarnation);
            }
        }
        self.readers.len() < before
    }

    /// The largest number of a writer that was for a reader without counters before `incarnation`.
    fn silent_until(&self, role: Role, incarnation: u32, writer: u32, stream: &Stream) -> u64 {
        let before = self.silent.range(..incarnation).filter(|(_, reader)| reader.role == role);
        before.map(|(_, reader)| newest_for(reader.end.as_ref(), writer, stream)).max().unwrap_or(0)
    }
}

/// Whether nothing of a process that ended then can come any more.
fn is_old(ended_ns: u64, now_ns: u64) -> bool {
    now_ns > ended_ns.saturating_add(SETTLED_NS)
}

/// The largest number of a writer that was for a reader, whose end is given if it has ended.
fn newest_for(end: Option<&ReaderEnd>, writer: u32, stream: &Stream) -> u64 {
    end.map_or(stream.newest(), |end| end.newest.get(&writer).copied().unwrap_or(0))
}

impl Reader {
    /// Adds what this reader counted, and the samples of writers that are not among `streams`.
    fn account(&self, streams: &BTreeMap<u32, Stream>, row: &mut LedgerRow) {
        let Self { counters, spans, end, .. } = self;
        let unknown = spans.iter().filter(|(writer, _)| !streams.contains_key(writer));
        row.published += unknown.map(|(_, span)| span.count()).sum::<u64>();
        row.used += counters.used;
        row.replace(counters);
        row.duplicates += counters.duplicate;
        row.reordered += counters.reordered;
        let is_death = end.as_ref().is_some_and(|end| end.is_death);
        *(if is_death { &mut row.lost } else { &mut row.in_flight }) += counters.waiting;
    }

    /// Forgets a writer that is settled.
    fn forget(&mut self, writer: u32) {
        self.spans.remove(&writer);
        self.beyond.remove(&writer);
        if let Some(end) = &mut self.end {
            end.newest.remove(&writer);
        }
    }

    /// The largest number of a writer that arrived at this reader; `None` when its first number is not known.
    fn last(&self, writer: u32, stream: &Stream) -> Option<u64> {
        let from_start = self.from_start && stream.from_start;
        self.spans.get(&writer).map(|span| span.last).or(from_start.then_some(0))
    }

    /// Notes the faults that are new in the last report: of several of a kind the counters name the newest.
    fn notice(&mut self) {
        let Self { counters, reported, .. } = self;
        let (hole, twice, late) = (counters.hole, counters.twice, counters.late);
        let missing = counters.missing.saturating_sub(reported.missing);
        let known = hole.count().min(missing);
        let found = [
            (DeliveryFaultKind::Missing, hole.incarnation, 0, missing - known),
            (
                DeliveryFaultKind::Missing,
                hole.incarnation,
                hole.last.saturating_sub(known.saturating_sub(1)),
                known,
            ),
            again(
                DeliveryFaultKind::Duplicate,
                &twice,
                counters.duplicate.saturating_sub(reported.duplicate),
            ),
            again(DeliveryFaultKind::Reordered, &late, counters.reordered.saturating_sub(reported.reordered)),
        ];
        (reported.missing, reported.duplicate, reported.reordered) =
            (counters.missing, counters.duplicate, counters.reordered);
        for (kind, writer, first, count) in found.into_iter().filter(|(.., count)| *count > 0) {
            let first = if self.noticed.len() >= MAX_NOTICED { 0 } else { first };
            let same =
                |known: &(DeliveryFaultKind, u32, u64, u64)| (known.0, known.1, known.2) == (kind, writer, 0);
            match self.noticed.iter().position(same) {
                Some(index) if first == 0 => {
                    let known = &mut self.noticed[index].3;
                    *known = known.saturating_add(count);
                }
                // A reader names four writers at a time.
                _ if self.noticed.len() < 2 * MAX_NOTICED => self.noticed.push((kind, writer, first, count)),
                _ => {}
            }
        }
    }

    fn reconcile(&mut self, topic: Topic, streams: &BTreeMap<u32, Stream>, faults: &mut Vec<DeliveryFault>) {
        for (&writer, stream) in streams {
            if let Some(next) = self.last(writer, stream).map(|last| last.saturating_add(1)) {
                // Stored here, because a stream stores the newest only.
                if self.beyond.get(&writer).is_none_or(|seen| seen.sequence < next) {
                    self.beyond.remove(&writer);
                    self.beyond.extend(stream.arrival_of(next).map(|seen| (writer, *seen)));
                }
            }
        }
        let (counters, reported, role) = (&self.counters, &self.reported, self.role);
        let scan = |writer: u32, sequence| streams.get(&writer).map_or(0, |stream| stream.scan_of(sequence));
        let mut note = |kind, writer: u32, first: u64, count: u64| {
            let fault = DeliveryFault::new(topic, kind, writer)
                .sequence(first)
                .count(count)
                .scan(scan(writer, first));
            faults.push(fault.noticed_by(role));
        };
        self.noticed.drain(..).for_each(|(kind, writer, first, count)| note(kind, writer, first, count));
        // Of one sample: the sum of the numbers without a fate, less those that wait and those reported before.
        let vanished = |counters: &InputAccount| counters.open.saturating_sub(counters.waiting);
        let sum = |counters: &InputAccount| counters.open_sum.wrapping_sub(counters.waiting_sum);
        match vanished(counters).saturating_sub(vanished(reported)) {
            0 => {}
            1 => note(
                DeliveryFaultKind::Vanished,
                newest_writer(counters),
                sum(counters).wrapping_sub(sum(reported)),
                1,
            ),
            count => note(DeliveryFaultKind::Vanished, newest_writer(counters), 0, count),
        }
        for Span { incarnation, first, .. } in self.begun.drain(..) {
            if self.from_start && streams.get(&incarnation).is_some_and(|stream| stream.from_start) {
                note(DeliveryFaultKind::Missing, incarnation, 1, first - 1);
            }
        }
        for (&writer, stream) in streams {
            // It polled long after the sample had arrived at the orchestrator.
            if self.end.is_none()
                && stream.ended_ns.is_none()
                && let Some(last) = self.last(writer, stream)
                && let Some(seen) = self.beyond.get(&writer)
                && seen.after_ns > self.connected_ns
                && self.polled_ns >= seen.seen_ns.saturating_add(TIMEOUT_NS)
            {
                note(DeliveryFaultKind::Missing, writer, last + 1, 1);
            }
        }
        self.reported = *counters;
    }
}

/// Samples that came late or again: the newest is named, unless its number is not known.
fn again(kind: DeliveryFaultKind, newest: &Span, count: u64) -> (DeliveryFaultKind, u32, u64, u64) {
    (kind, newest.incarnation, newest.first, if newest.first == 0 { count } else { count.min(1) })
}

fn newest_writer(counters: &InputAccount) -> u32 {
    counters.writers.iter().map(|span| span.incarnation).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const WRITER: u32 = 4;
    const READER: u32 = 3;

    fn header(sequence: u64) -> Header {
        Header { incarnation: WRITER, sequence, scan_id: sequence, ..Header::default() }
    }

    fn span(first: u64, last: u64) -> Span {
        Span { incarnation: WRITER, first, last, ..Span::default() }
    }

    fn report(counters: &InputAccount, polled_ns: u64) -> InputReport<'_> {
        let (incarnation, role) = (READER, Role::Obstacles);
        InputReport {
            incarnation,
            role,
            from_start: true,
            midway: false,
            connected_ns: 1,
            polled_ns,
            counters,
        }
    }

    fn named(faults: &[DeliveryFault]) -> Vec<(DeliveryFaultKind, u64, u64)> {
        faults.iter().map(|fault| (fault.kind, fault.sequence, fault.scan_id)).collect()
    }

    #[test]
    fn samples_of_a_reader_without_counters_between_two_others_are_not_lost() {
        for (is_received, lost) in [(true, 0), (false, 20)] {
            let mut ledger = TopicLedger::new(Topic::Pose);
            ledger.poll(5);
            let mut counters = InputAccount { used: 4, arrived: 4, ..InputAccount::default() };
            (1..=4).for_each(|sequence| assert_eq!(ledger.see(&header(sequence), true, true), None));
            counters.writers[0] = span(1, 4);
            ledger.receive(report(&counters, 5));
            if is_received {
                ledger.add_silent_reader(5, Role::Obstacles);
            }
            ledger.ended(READER, 6, true);
            (5..=24).for_each(|sequence| assert_eq!(ledger.see(&header(sequence), true, true), None));
            ledger.ended(5, 7, true);
            (25..=28).for_each(|sequence| assert_eq!(ledger.see(&header(sequence), true, true), None));
            counters.writers[0] = span(25, 28);
            ledger.receive(InputReport { incarnation: 7, from_start: false, ..report(&counters, 8) });
            let rows = ledger.rows();
            let row = rows.first().unwrap();
            assert_eq!((row.lost, row.used, row.residual), (lost, 8, 0), "{row:?}");
        }
    }

    /// Writers and readers that take over from each other, every second, with a reader that dies with five samples unread
    /// and one that starts ten samples later.
    fn swapped(count: u32, settle: bool) -> TopicLedger {
        let mut ledger = TopicLedger::new(Topic::Pose);
        for index in 1..=count {
            let now_ns = u64::from(index) * 1_000_000_000;
            ledger.poll(now_ns);
            let (writer, reader) = (10 * index, 10 * index + 1);
            for sequence in 1..=40 {
                let header = Header { incarnation: writer, ..header(sequence) };
                ledger.see(&header, false, index == 1);
            }
            let mut counters = InputAccount { used: 25, arrived: 25, ..InputAccount::default() };
            counters.writers[0] = Span { incarnation: writer, ..span(11, 35) };
            counters.writers[1] = Span { incarnation: writer - 10, ..span(36, 40) };
            counters.used += if index == 1 { 0 } else { 5 };
            ledger.receive(InputReport {
                incarnation: reader,
                from_start: index == 1,
                ..report(&counters, now_ns + 1)
            });
            if settle {
                ledger.reconcile(false);
            }
            ledger.ended(writer, now_ns + 2, true);
            ledger.ended(reader, now_ns + 3, true);
        }
        ledger
    }

    #[test]
    fn what_is_settled_counts_as_before_and_takes_no_memory() {
        let (kept, settled) = (swapped(100, false), swapped(100, true));
        assert_eq!(kept.rows(), settled.rows());
        assert!(kept.rows()[0].lost > 0 && kept.rows()[0].used > 2500, "{:?}", kept.rows());
        assert_eq!((kept.streams.len(), kept.readers.len()), (100, 100));
        assert!(settled.streams.len() < 13 && settled.readers.len() < 13, "{}", settled.readers.len());
        assert!(settled.readers.values().all(|reader| reader.spans.len() < 13));
    }

    #[test]
    fn several_faults_that_one_reader_noticed_between_two_reconciliations_are_all_named() {
        let mut ledger = TopicLedger::new(Topic::Pose);
        ledger.poll(5);
        (1..=9).for_each(|sequence| assert_eq!(ledger.see(&header(sequence), true, true), None));
        let mut counters = InputAccount { missing: 1, hole: span(3, 3), ..InputAccount::default() };
        counters.writers[0] = span(1, 4);
        ledger.receive(report(&counters, 5));
        counters.writers[0] = span(1, 9);
        (counters.missing, counters.hole) = (2, span(7, 7));
        (counters.duplicate, counters.twice) = (1, span(8, 8));
        ledger.receive(report(&counters, 6));
        let expected = [
            (DeliveryFaultKind::Missing, 3, 3),
            (DeliveryFaultKind::Missing, 7, 7),
            (DeliveryFaultKind::Duplicate, 8, 8),
        ];
        assert_eq!(named(&ledger.reconcile(false)), expected);
        ledger.receive(report(&counters, 7));
        assert_eq!(ledger.reconcile(false), [], "once is enough");
    }

    #[test]
    fn a_gap_of_any_size_is_one_fault() {
        let mut ledger = TopicLedger::new(Topic::Pose);
        ledger.poll(5);
        (1..=4).for_each(|sequence| assert_eq!(ledger.see(&header(sequence), true, true), None));
        let gap = 1 << 47;
        let mut counters = InputAccount { missing: gap, hole: span(5, gap + 4), ..InputAccount::default() };
        counters.writers[0] = span(1, gap + 5);
        ledger.receive(report(&counters, 5));
        (counters.missing, counters.duplicate, counters.reordered) = (gap + 2, 1 << 47, 1 << 47);
        ledger.receive(report(&counters, 6));
        let faults = ledger.reconcile(false);
        let counts: Vec<_> = faults.iter().map(|fault| (fault.kind, fault.sequence, fault.count)).collect();
        let expected = [
            (DeliveryFaultKind::Missing, 5, gap),
            (DeliveryFaultKind::Missing, gap + 3, 2),
            (DeliveryFaultKind::Duplicate, 0, 1 << 47),
            (DeliveryFaultKind::Reordered, 0, 1 << 47),
        ];
        assert_eq!(counts, expected);
        for round in 0..10_000 {
            counters.missing += 1;
            counters.hole = span(2 * round + 5, 2 * round + 5);
            ledger.receive(report(&counters, 7 + round));
        }
        assert!(ledger.readers[&READER].noticed.len() <= 2 * MAX_NOTICED);
    }

    #[test]
    fn a_reader_that_receives_nothing_any_more_is_noticed_at_any_rate() {
        for period_ns in [2_000_000, 20_000_000] {
            let mut ledger = TopicLedger::new(Topic::Pose);
            let mut counters = InputAccount::default();
            let (mut found, mut reconciled_ns) = (Vec::new(), 0);
            for sequence in 1..=3_000_000_000 / period_ns {
                let now_ns = 1_000_000_000 + sequence * period_ns;
                ledger.poll(now_ns);
                ledger.see(&header(sequence), true, true);
                if sequence <= 10 {
                    counters.writers[0] = span(1, sequence);
                }
                ledger.receive(report(&counters, now_ns));
                if now_ns >= reconciled_ns + 1_000_000_000 {
                    reconciled_ns = now_ns;
                    found.extend(named(&ledger.reconcile(false)));
                }
            }
            assert!(
                found
                    .iter()
                    .any(|(kind, sequence, _)| (*kind, *sequence) == (DeliveryFaultKind::Missing, 11)),
                "{found:?}"
            );
        }
    }
}
