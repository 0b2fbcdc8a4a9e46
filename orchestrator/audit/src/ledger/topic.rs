//! The account of one topic: what was published, and what became of it at each reader.
//!
//! For every role that reads the topic
//!
//! ```text
//! published = used + replaced + lost + in flight + residual
//! ```
//!
//! *Published* counts each sample once per process that was to get it, so during an exchange twice. *Replaced* is
//! everything a rule drops: a newer one was used, it was too old, its writer had no authority, its content was bad.
//! *Lost* went with a process that died: it waited there, or had not come yet. *In flight* waits at a reader, or was
//! published after the reader's last word. The *residual* is what none of this explains; it must be none.
//!
//! What a reader that was killed did after its last word is not known: it counts as lost with it.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use shared_types::{Header, InputAccount, Role, Span, Topic};

use super::TIMEOUT_NS;
use super::fault::{Fault, Kind};
use super::rows::LedgerRow;
use super::stream::{NAMED, Seen, Stream};
/// The account of one topic.
#[derive(Debug, Clone)]
pub struct TopicLedger {
    topic: Topic,
    capacity: u64,
    streams: BTreeMap<u32, Stream>,
    readers: BTreeMap<u32, Reader>,
    /// Processes that read the topic and send no accounts.
    silent: BTreeMap<u32, SilentReader>,
    before_ns: u64,
    now_ns: u64,
}

/// One process that reads the topic, as its heartbeats tell.
#[derive(Debug, Clone)]
struct Reader {
    role: Role,
    from_start: bool,
    connected_ns: u64,
    looked_ns: u64,
    account: InputAccount,
    told: InputAccount,
    /// What it has noticed since the last closing: kind, writer and number.
    noticed: Vec<(Kind, u32, u64)>,
    /// By writer: the first sample beyond the last that came here, as it came to everyone else.
    beyond: BTreeMap<u32, Seen>,
    spans: BTreeMap<u32, Span>,
    /// First spans that do not begin with 1, and too short for the buffer to have been full before.
    begun: Vec<Span>,
    end: Option<ReaderEnd>,
}

/// A process that says nothing of its samples: what was published while it lived was for it.
#[derive(Debug, Clone)]
struct SilentReader {
    role: Role,
    end: Option<ReaderEnd>,
}

/// How far the writers were when a reader ended.
#[derive(Debug, Clone)]
struct ReaderEnd {
    newest: BTreeMap<u32, u64>,
    is_death: bool,
}

/// A word of a reader.
#[derive(Debug, Clone, Copy)]
pub struct InputReport<'a> {
    /// Its incarnation.
    pub incarnation: u32,
    /// Its role.
    pub role: Role,
    /// Whether it was connected before the first sample was published.
    pub from_start: bool,
    /// Whether what it says first was told to another orchestrator.
    pub midway: bool,
    /// Since when it is connected [ns].
    pub connected_ns: u64,
    /// When it last took samples from the bus [ns].
    pub looked_ns: u64,
    /// What became of them.
    pub account: &'a InputAccount,
}

impl TopicLedger {
    /// An account that is empty; `capacity` samples of a writer can wait at a reader.
    pub fn new(topic: Topic, capacity: usize) -> Self {
        let capacity = capacity as u64;
        Self {
            topic,
            capacity,
            streams: BTreeMap::new(),
            readers: BTreeMap::new(),
            silent: BTreeMap::new(),
            before_ns: 0,
            now_ns: 0,
        }
    }

    /// When the topic was last looked at [ns].
    pub fn looked_ns(&self) -> u64 {
        self.now_ns
    }

    /// A look at the topic begins.
    pub fn poll(&mut self, now_ns: u64) {
        self.before_ns = self.now_ns;
        self.now_ns = now_ns;
    }

    /// The look found a sample; `answers` unless its scan may be an older one. With `from_start` its writer began
    /// when everyone was connected.
    pub fn see(&mut self, header: &Header, answers: bool, from_start: bool) -> Option<Fault> {
        let (topic, after_ns, now_ns) = (self.topic, self.before_ns, self.now_ns);
        let Header { incarnation, sequence, .. } = *header;
        let begin = || Stream::new(topic, incarnation, sequence.max(1), from_start);
        self.streams.entry(incarnation).or_insert_with(begin).see(header, answers, after_ns, now_ns)
    }

    /// The look found as many samples as can wait, or more: some may have been overwritten before. Returns the scans
    /// of which nothing was observed.
    pub fn overflowed(&mut self) -> Vec<RangeInclusive<u64>> {
        let (now_ns, capacity) = (self.now_ns, self.capacity);
        self.streams.values_mut().flat_map(|stream| stream.overflowed(now_ns, capacity)).collect()
    }

    /// Whether a writer was first heard in this look, in the middle of its work.
    pub fn began_midway(&self) -> bool {
        self.streams.values().any(|stream| stream.began_midway(self.now_ns))
    }

    /// A writer said that it has used up the numbers up to `sequence`.
    pub fn claimed(&mut self, incarnation: u32, from_start: bool, sequence: u64, now_ns: u64) {
        if from_start && sequence > 0 {
            let begin = || Stream::new(self.topic, incarnation, 1, true);
            self.streams.entry(incarnation).or_insert_with(begin);
        }
        if let Some(stream) = self.streams.get_mut(&incarnation) {
            stream.claimed(sequence, now_ns);
        }
    }

    /// A reader said what became of its samples.
    pub fn received(&mut self, word: InputReport<'_>) {
        let InputReport { incarnation, role, from_start, midway, connected_ns, looked_ns, account } = word;
        self.silent.remove(&incarnation);
        let reader = self.readers.entry(incarnation).or_insert_with(|| Reader {
            role,
            from_start,
            connected_ns,
            looked_ns,
            account: InputAccount::default(),
            told: if midway { *account } else { InputAccount::default() },
            noticed: Vec::new(),
            beyond: BTreeMap::new(),
            spans: BTreeMap::new(),
            begun: Vec::new(),
            end: None,
        });
        (reader.looked_ns, reader.account) = (looked_ns, *account);
        reader.notice();
        (reader.from_start, reader.connected_ns) = (from_start, connected_ns);
        for span in account.writers.iter().filter(|span| span.incarnation != 0) {
            let Reader { spans, begun, .. } = &mut *reader;
            let known = spans.entry(span.incarnation).or_insert_with(|| {
                if span.first > 1 && span.count() < self.capacity {
                    begun.push(*span);
                }
                *span
            });
            (known.first, known.last) = (known.first.min(span.first), known.last.max(span.last));
        }
    }

    /// A process reads the topic and sends no accounts.
    pub fn add_silent_reader(&mut self, incarnation: u32, role: Role) {
        self.silent.entry(incarnation).or_insert(SilentReader { role, end: None });
    }

    /// A process ended, as writer or as reader; `is_death` when it was not asked to.
    pub fn ended(&mut self, incarnation: u32, now_ns: u64, is_death: bool) {
        if let Some(stream) = self.streams.get_mut(&incarnation) {
            stream.ended(now_ns, is_death);
        }
        let newest = self.streams.iter().map(|(writer, stream)| (*writer, stream.newest())).collect();
        let end = ReaderEnd { newest, is_death };
        if let Some(reader) = self.silent.get_mut(&incarnation) {
            reader.end.get_or_insert(end);
        } else if let Some(reader) = self.readers.get_mut(&incarnation) {
            reader.end.get_or_insert(end);
        }
    }

    /// What is certain to be wrong after the last look. At the end of a run, when all processes have said their last
    /// word, nothing is waited for.
    pub fn close(&mut self, is_last: bool) -> Vec<Fault> {
        let mut faults = Vec::new();
        let Self { topic, streams, readers, now_ns, .. } = self;
        for stream in streams.values_mut() {
            faults.extend(stream.close(*now_ns, is_last));
        }
        for reader in readers.values_mut() {
            reader.close(*topic, streams, &mut faults);
        }
        faults
    }

    /// The account per role that reads the topic, as if the run had ended now.
    pub fn rows(&self) -> Vec<LedgerRow> {
        let mut roles: Vec<Role> = self.readers.values().map(|reader| reader.role).collect();
        roles.sort_unstable();
        roles.dedup();
        roles.into_iter().map(|role| self.row(role)).collect()
    }

    /// Samples that only their readers know of, because the orchestrator looked too late.
    pub fn unobserved(&self) -> u64 {
        self.streams.values().map(|stream| stream.unobserved).sum()
    }

    fn row(&self, role: Role) -> LedgerRow {
        let mut row = LedgerRow {
            topic: self.topic.name().to_owned(),
            reader: role.name().to_owned(),
            ..LedgerRow::default()
        };
        let mut covered: BTreeMap<u32, u64> = BTreeMap::new();
        for (&incarnation, reader) in self.readers.iter().filter(|(_, reader)| reader.role == role) {
            let account = &reader.account;
            row.published += reader.spans.values().map(Span::count).sum::<u64>();
            row.used += account.used;
            row.replaced += account.by_policy();
            row.duplicates += account.duplicate;
            row.reordered += account.reordered;
            let mut waiting = [0, account.waiting];
            for (&writer, stream) in &self.streams {
                let span = reader.spans.get(&writer);
                // What a reader that died had not heard of, its successor may have missed too.
                if let (Some(span), Some(end)) = (span, covered.get(&writer)) {
                    let end = self.silent_until(role, incarnation, writer).max(*end);
                    let gap = span.first.saturating_sub(end + 1);
                    (row.published, row.lost) = (row.published + gap, row.lost + gap);
                }
                let newest = reader.newest(writer, stream);
                let tail = reader.last(writer, stream).map_or(0, |last| newest.saturating_sub(last));
                row.published += tail;
                let is_lost = stream.ended_ns.is_some_and(|ended_ns| reader.looked_ns > ended_ns);
                waiting[usize::from(!is_lost)] += tail;
                let end = span.map_or(0, |span| span.last).max(newest);
                covered.entry(writer).and_modify(|known| *known = end.max(*known)).or_insert(end);
            }
            let is_death = reader.end.as_ref().is_some_and(|end| end.is_death);
            row.lost += waiting[0] + if is_death { waiting[1] } else { 0 };
            row.in_flight += if is_death { 0 } else { waiting[1] };
        }
        row.residual = row.published.saturating_sub(row.used + row.replaced + row.lost + row.in_flight);
        row
    }
}

impl TopicLedger {
    /// The largest number of a writer that was for a reader without accounts which came before `incarnation`.
    fn silent_until(&self, role: Role, incarnation: u32, writer: u32) -> u64 {
        let before = self.silent.range(..incarnation).filter(|(_, reader)| reader.role == role);
        let newest = before.map(|(_, reader)| match &reader.end {
            Some(end) => end.newest.get(&writer).copied().unwrap_or(0),
            None => self.streams.get(&writer).map_or(0, Stream::newest),
        });
        newest.max().unwrap_or(0)
    }
}

impl Reader {
    /// The largest number of a writer that was for this reader.
    fn newest(&self, writer: u32, stream: &Stream) -> u64 {
        match &self.end {
            Some(end) => end.newest.get(&writer).copied().unwrap_or(0),
            None => stream.newest(),
        }
    }

    /// The largest number of a writer that came to this reader; `None` when it is not known where it began to hear it.
    fn last(&self, writer: u32, stream: &Stream) -> Option<u64> {
        let from_start = self.from_start && stream.from_start;
        self.spans.get(&writer).map(|span| span.last).or(from_start.then_some(0))
    }

    /// Notes what the last word has that the words before had not: of several of a kind an account names the newest.
    fn notice(&mut self) {
        let Self { account, told, noticed, .. } = self;
        let hole = &account.hole;
        for back in (0..account.missing.saturating_sub(told.missing)).rev() {
            let is_known = hole.incarnation != 0 && hole.last.saturating_sub(back) >= hole.first;
            let sequence = if is_known { hole.last - back } else { 0 };
            noticed.push((Kind::Missing, hole.incarnation, sequence));
        }
        let twice = (Kind::Duplicate, account.twice.incarnation, account.twice.first);
        noticed.extend((told.duplicate..account.duplicate).map(|_| twice));
        let late = (Kind::Reordered, account.late.incarnation, account.late.first);
        noticed.extend((told.reordered..account.reordered).map(|_| late));
        (told.missing, told.duplicate, told.reordered) =
            (account.missing, account.duplicate, account.reordered);
    }

    fn close(&mut self, topic: Topic, streams: &BTreeMap<u32, Stream>, faults: &mut Vec<Fault>) {
        for (&writer, stream) in streams {
            if let Some(next) = self.last(writer, stream).map(|last| last + 1) {
                // Remembered here, because a stream remembers the newest only.
                if self.beyond.get(&writer).is_none_or(|seen| seen.sequence < next) {
                    self.beyond.remove(&writer);
                    self.beyond.extend(stream.arrival_of(next).map(|seen| (writer, *seen)));
                }
            }
        }
        let (account, told, role) = (&self.account, &self.told, self.role);
        let scan = |writer: u32, sequence| streams.get(&writer).map_or(0, |stream| stream.scan_of(sequence));
        let mut note = |kind, writer: u32, sequence: u64| {
            let fault = Fault::new(topic, kind, writer).sequence(sequence).scan(scan(writer, sequence));
            faults.push(fault.noticed_by(role));
        };
        self.noticed.drain(..).for_each(|(kind, writer, sequence)| note(kind, writer, sequence));
        // One number: the sum of all without a fate but those that wait and those told before.
        let vanished = |account: &InputAccount| account.open.saturating_sub(account.waiting);
        let sum = |account: &InputAccount| account.open_sum.wrapping_sub(account.waiting_sum);
        match vanished(account).saturating_sub(vanished(told)) {
            0 => {}
            1 => note(Kind::Vanished, newest_writer(account), sum(account).wrapping_sub(sum(told))),
            _ => note(Kind::Vanished, newest_writer(account), 0),
        }
        for Span { incarnation, first, .. } in self.begun.drain(..) {
            if self.from_start && streams.get(&incarnation).is_some_and(|stream| stream.from_start) {
                (1..first).take(NAMED).for_each(|sequence| note(Kind::Missing, incarnation, sequence));
            }
        }
        for (&writer, stream) in streams {
            // It looked long after the sample had come to everyone else.
            if self.end.is_none()
                && stream.ended_ns.is_none()
                && let Some(last) = self.last(writer, stream)
                && let Some(seen) = self.beyond.get(&writer)
                && seen.after_ns > self.connected_ns
                && self.looked_ns >= seen.seen_ns.saturating_add(TIMEOUT_NS)
            {
                note(Kind::Missing, writer, last + 1);
            }
        }
        self.told = *account;
    }
}

fn newest_writer(account: &InputAccount) -> u32 {
    account.writers.iter().map(|span| span.incarnation).max().unwrap_or(0)
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

    fn word(account: &InputAccount, looked_ns: u64) -> InputReport<'_> {
        let (incarnation, role) = (READER, Role::Obstacles);
        InputReport {
            incarnation,
            role,
            from_start: true,
            midway: false,
            connected_ns: 1,
            looked_ns,
            account,
        }
    }

    fn named(faults: &[Fault]) -> Vec<(Kind, u64, u64)> {
        faults.iter().map(|fault| (fault.kind, fault.sequence, fault.scan_id)).collect()
    }

    #[test]
    fn what_a_reader_without_accounts_had_between_two_others_is_not_lost() {
        for (is_received, lost) in [(true, 0), (false, 20)] {
            let mut ledger = TopicLedger::new(Topic::Pose, 16);
            ledger.poll(5);
            let mut account = InputAccount { used: 4, arrived: 4, ..InputAccount::default() };
            (1..=4).for_each(|sequence| assert_eq!(ledger.see(&header(sequence), true, true), None));
            account.writers[0] = span(1, 4);
            ledger.received(word(&account, 5));
            if is_received {
                ledger.add_silent_reader(5, Role::Obstacles);
            }
            ledger.ended(READER, 6, true);
            (5..=24).for_each(|sequence| assert_eq!(ledger.see(&header(sequence), true, true), None));
            ledger.ended(5, 7, true);
            (25..=28).for_each(|sequence| assert_eq!(ledger.see(&header(sequence), true, true), None));
            account.writers[0] = span(25, 28);
            ledger.received(InputReport { incarnation: 7, from_start: false, ..word(&account, 8) });
            let rows = ledger.rows();
            let row = rows.first().unwrap();
            assert_eq!((row.lost, row.used, row.residual), (lost, 8, 0), "{row:?}");
        }
    }

    #[test]
    fn several_faults_that_one_reader_noticed_between_two_closings_are_all_named() {
        let mut ledger = TopicLedger::new(Topic::Pose, 16);
        ledger.poll(5);
        (1..=9).for_each(|sequence| assert_eq!(ledger.see(&header(sequence), true, true), None));
        let mut account = InputAccount { missing: 1, hole: span(3, 3), ..InputAccount::default() };
        account.writers[0] = span(1, 4);
        ledger.received(word(&account, 5));
        account.writers[0] = span(1, 9);
        (account.missing, account.hole) = (2, span(7, 7));
        (account.duplicate, account.twice) = (1, span(8, 8));
        ledger.received(word(&account, 6));
        let expected = [(Kind::Missing, 3, 3), (Kind::Missing, 7, 7), (Kind::Duplicate, 8, 8)];
        assert_eq!(named(&ledger.close(false)), expected);
        ledger.received(word(&account, 7));
        assert_eq!(ledger.close(false), [], "once is enough");
    }

    #[test]
    fn a_reader_that_hears_nothing_any_more_is_noticed_at_any_rate() {
        for period_ns in [2_000_000, 20_000_000] {
            let mut ledger = TopicLedger::new(Topic::Pose, 16);
            let mut account = InputAccount::default();
            let (mut found, mut closed_ns) = (Vec::new(), 0);
            for sequence in 1..=3_000_000_000 / period_ns {
                let now_ns = 1_000_000_000 + sequence * period_ns;
                ledger.poll(now_ns);
                ledger.see(&header(sequence), true, true);
                if sequence <= 10 {
                    account.writers[0] = span(1, sequence);
                }
                ledger.received(word(&account, now_ns));
                if now_ns >= closed_ns + 1_000_000_000 {
                    closed_ns = now_ns;
                    found.extend(named(&ledger.close(false)));
                }
            }
            assert!(
                found.iter().any(|(kind, sequence, _)| (*kind, *sequence) == (Kind::Missing, 11)),
                "{found:?}"
            );
        }
    }
}
