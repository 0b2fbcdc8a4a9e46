//! The counters of one input: the reader's part of the sample audit.
//!
//! Each publisher numbers its samples without gaps, so a reader detects missing, repeated and late ones. Every sample
//! that arrived gets exactly one fate. Until then it is *open*, and must be waiting in the process. The numbers of
//! open samples are summed as well as counted, so a single sample without a fate is known by its number.

use crate::describe::layout;
use crate::{Fault, Header, MAX_LATE, MAX_NUMBER};

/// Publishers of one topic that are counted separately: as many as may write a topic at a time.
pub const WRITERS: usize = 4;

layout! {
    /// A run of sequence numbers of one writer.
    pub struct Span(24) {
        /// Incarnation of the writer; 0 for an entry that is not used
        pub incarnation: u32,
        /// Unused, zero
        pub reserved: u32,
        /// First sequence number
        pub first: u64,
        /// Last sequence number
        pub last: u64,
    }
}

layout! {
    /// What happened to the samples of one input since its process started.
    pub struct InputAccount(288) {
        /// Sequence numbers that arrived, per writer
        pub writers: [Span; WRITERS],
        /// The newest sequence numbers that did not arrive
        pub hole: Span,
        /// The newest sequence number that arrived twice
        pub twice: Span,
        /// The newest sequence number that arrived after a later one
        pub late: Span,
        /// Samples that arrived, repeated ones included
        pub arrived: u64,
        /// Used
        pub used: u64,
        /// Replaced in the process by newer ones before they were used
        pub replaced: u64,
        /// Overwritten by newer ones in the buffer before they were taken from the bus
        pub overwritten: u64,
        /// Dropped because they were too old
        pub stale: u64,
        /// Dropped because their writer had no authority for their scan
        pub foreign: u64,
        /// Dropped because of their content
        pub invalid: u64,
        /// Dropped because their number had arrived before
        pub duplicate: u64,
        /// Dropped because a later number had arrived before
        pub reordered: u64,
        /// Sequence numbers that never arrived although the buffer was not full
        pub missing: u64,
        /// Samples whose fate is not known yet
        pub open: u64,
        /// Sum of their sequence numbers
        pub open_sum: u64,
        /// Samples that wait in the process; equal to `open` if no sample has disappeared
        pub waiting: u64,
        /// Sum of the sequence numbers of samples that wait
        pub waiting_sum: u64,
        /// Samples of another layout, whose sequence numbers cannot be read
        pub unreadable: u64,
    }
}

/// What a reader does with a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// It is used.
    Used,
    /// A newer one is used instead.
    Replaced,
    /// It is too old.
    Stale,
    /// Its writer has no authority for its scan.
    Foreign,
    /// Its content may not be used.
    Invalid,
    /// Its number has arrived before.
    Duplicate,
    /// A later number has arrived before.
    Reordered,
}

impl Span {
    /// How many numbers it holds.
    pub fn count(&self) -> u64 {
        if self.incarnation == 0 || self.last < self.first {
            0
        } else {
            (self.last - self.first).saturating_add(1)
        }
    }

    /// Passes when it is a run of numbers that a publisher can have used.
    fn check(&self, field: &'static str) -> Result<(), Fault> {
        let is_run = self.incarnation == 0 || self.first <= self.last && self.last <= MAX_NUMBER;
        if is_run { Ok(()) } else { Err(Fault::OutOfRange { field, value: self.last as f64 }) }
    }

    /// Whether a number of a writer is one of them.
    pub fn contains(&self, incarnation: u32, sequence: u64) -> bool {
        self.incarnation == incarnation && (self.first..=self.last).contains(&sequence)
    }

    fn of(incarnation: u32, first: u64, last: u64) -> Self {
        Self { incarnation, reserved: 0, first, last }
    }
}

impl InputAccount {
    /// Counts a sample from the bus; returns its fate when its number alone decides it.
    pub fn arrive(&mut self, header: &Header) -> Option<Fate> {
        let Header { incarnation, sequence, .. } = *header;
        self.arrived += 1;
        self.open += 1;
        self.open_sum = self.open_sum.wrapping_add(sequence);
        let Some(index) = self.writers.iter().position(|span| span.incarnation == incarnation) else {
            // Incarnations grow: the smallest is the oldest publisher, or an unused entry.
            if let Some(oldest) = self.writers.iter_mut().min_by_key(|span| span.incarnation) {
                *oldest = Span::of(incarnation, sequence, sequence);
            }
            return None;
        };
        let span = &mut self.writers[index];
        if sequence > span.last {
            if sequence > span.last.saturating_add(1) {
                self.hole = Span::of(incarnation, span.last + 1, sequence - 1);
                self.missing = self.missing.saturating_add(self.hole.count());
            }
            span.last = sequence;
            return None;
        }
        if self.goes_on_below(index, sequence) {
            self.go_back(index, sequence);
            return None;
        }
        let span = &mut self.writers[index];
        if sequence < span.first {
            span.first = sequence;
        } else if self.hole.contains(incarnation, sequence) {
            self.missing = self.missing.saturating_sub(1);
            self.fill_hole(sequence);
        } else {
            self.twice = Span::of(incarnation, sequence, sequence);
            return Some(Fate::Duplicate);
        }
        self.late = Span::of(incarnation, sequence, sequence);
        Some(Fate::Reordered)
    }

    /// Passes when it holds counts that the reader of a topic can have.
    ///
    /// # Errors
    /// [`Fault::OutOfRange`] with the first field that does not.
    pub fn check(&self) -> Result<(), Fault> {
        self.writers.iter().try_for_each(|span| span.check("writers"))?;
        [("hole", &self.hole), ("twice", &self.twice), ("late", &self.late)]
            .into_iter()
            .try_for_each(|(field, span)| span.check(field))?;
        [
            ("arrived", self.arrived),
            ("used", self.used),
            ("replaced", self.replaced),
            ("overwritten", self.overwritten),
            ("stale", self.stale),
            ("foreign", self.foreign),
            ("invalid", self.invalid),
            ("duplicate", self.duplicate),
            ("reordered", self.reordered),
            ("missing", self.missing),
            ("open", self.open),
            ("waiting", self.waiting),
            ("unreadable", self.unreadable),
        ]
        .into_iter()
        .try_for_each(|(field, count)| {
            let is_count = count <= MAX_NUMBER;
            if is_count { Ok(()) } else { Err(Fault::OutOfRange { field, value: count as f64 }) }
        })
    }

    /// Whether a publisher continues with lower numbers: the second in a row that lies far below its newest. Samples of one
    /// publisher arrive in its order, so the newest was wrong, and all that follow would be dropped as late ones.
    fn goes_on_below(&self, index: usize, sequence: u64) -> bool {
        let Span { incarnation, last, .. } = self.writers[index];
        let is_far = last - sequence > MAX_LATE;
        // A reader that polls seldom misses numbers in between.
        let follows = |before: &Span| before.last < sequence && sequence - before.last <= MAX_LATE;
        is_far
            && [self.late, self.twice]
                .iter()
                .any(|before| before.incarnation == incarnation && follows(before))
    }

    /// Continues with a lower number; numbers above it are not missing any more.
    fn go_back(&mut self, index: usize, sequence: u64) {
        let span = &mut self.writers[index];
        (span.first, span.last) = (span.first.min(sequence), sequence);
        let Span { incarnation, .. } = *span;
        if self.hole.incarnation != incarnation || self.hole.last < sequence {
            return;
        }
        // The number before was counted when it came.
        let missing = self.hole.count().saturating_sub(1);
        let last = sequence.saturating_sub(2);
        let is_left = last >= self.hole.first;
        self.hole = if is_left { Span { last, ..self.hole } } else { Span::default() };
        self.missing = self.missing.saturating_sub(missing).saturating_add(self.hole.count());
    }

    /// Counts the fate of a sample that arrived.
    pub fn settle(&mut self, fate: Fate, header: &Header) {
        self.open = self.open.saturating_sub(1);
        self.open_sum = self.open_sum.wrapping_sub(header.sequence);
        let count = match fate {
            Fate::Used => &mut self.used,
            Fate::Replaced => &mut self.replaced,
            Fate::Stale => &mut self.stale,
            Fate::Foreign => &mut self.foreign,
            Fate::Invalid => &mut self.invalid,
            Fate::Duplicate => &mut self.duplicate,
            Fate::Reordered => &mut self.reordered,
        };
        *count += 1;
    }

    /// Counts overwritten samples, which are not missing, after at least as many came since `before` as the buffer of
    /// the reader holds. A sample is overwritten only when `capacity` newer ones wait; a gap that fewer follow stays,
    /// unless samples still wait (`is_all` is false): those behind the newest gap may be among them.
    pub fn overflowed_since(&mut self, before: &Self, capacity: u64, is_all: bool) {
        let newest = self.from(self.hole.incarnation).map_or(0, |span| span.last);
        let is_behind = is_all && newest < self.hole.last.saturating_add(capacity);
        let stays = self.hole != before.hole && is_behind;
        let missing = before.missing + if stays { self.hole.count() } else { 0 };
        self.overwritten += self.missing.saturating_sub(missing);
        self.missing = self.missing.min(missing);
        if !stays {
            self.hole = before.hole;
        }
    }

    /// The numbers that arrived from a publisher.
    pub fn from(&self, incarnation: u32) -> Option<&Span> {
        self.writers.iter().find(|span| span.incarnation == incarnation && incarnation != 0)
    }

    /// Samples that were dropped or replaced by a rule, with the name of the reason.
    pub fn by_rule(&self) -> [(&'static str, u64); 5] {
        [
            ("newer", self.replaced),
            ("queue_full", self.overwritten),
            ("age", self.stale),
            ("authority", self.foreign),
            ("content", self.invalid),
        ]
    }

    fn fill_hole(&mut self, sequence: u64) {
        if self.hole.count() == 1 {
            self.hole = Span::default();
        } else if sequence == self.hole.first {
            self.hole.first += 1;
        } else if sequence == self.hole.last {
            self.hole.last -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(incarnation: u32, sequence: u64) -> Header {
        Header { incarnation, sequence, ..Header::default() }
    }

    /// Counters after these numbers of publisher 7 arrived, each used unless its number decides otherwise.
    fn account(sequences: &[u64]) -> InputAccount {
        let mut account = InputAccount::default();
        for &sequence in sequences {
            let fate = account.arrive(&header(7, sequence)).unwrap_or(Fate::Used);
            account.settle(fate, &header(7, sequence));
        }
        account
    }

    #[test]
    fn numbers_without_gaps_are_all_used() {
        let account = account(&[4, 5, 6]);
        assert_eq!((account.arrived, account.used, account.missing, account.open), (3, 3, 0, 0));
        assert_eq!(account.from(7), Some(&Span::of(7, 4, 6)));
        assert_eq!(account.from(0), None);
    }

    #[test]
    fn a_number_that_does_not_come_is_named() {
        let account = account(&[1, 2, 4]);
        assert_eq!((account.missing, account.hole), (1, Span::of(7, 3, 3)));
    }

    #[test]
    fn two_that_change_places_are_one_late_and_none_missing() {
        let account = account(&[1, 3, 2, 4]);
        assert_eq!((account.missing, account.reordered, account.used), (0, 1, 3));
        assert_eq!((account.late, account.hole), (Span::of(7, 2, 2), Span::default()));
    }

    #[test]
    fn a_number_that_comes_twice_is_named() {
        let account = account(&[1, 2, 2, 3]);
        assert_eq!((account.duplicate, account.used, account.missing), (1, 3, 0));
        assert_eq!(account.twice, Span::of(7, 2, 2));
    }

    #[test]
    fn one_wrong_number_costs_one_sample() {
        for wrong in [1_026, MAX_NUMBER] {
            let numbers: Vec<u64> = (1..=25).chain([wrong]).chain(27..=60).collect();
            let account = account(&numbers);
            assert_eq!((account.missing, account.hole), (1, Span::of(7, 26, 26)), "{wrong}");
            // 27 is late; 28 shows that the publisher continues there.
            assert_eq!((account.reordered, account.duplicate, account.used), (1, 0, 59), "{wrong}");
            assert_eq!(account.from(7), Some(&Span::of(7, 1, 60)), "{wrong}");
        }
    }

    #[test]
    fn one_wrong_number_costs_one_sample_of_a_reader_that_sees_every_third() {
        let numbers: Vec<u64> = (1..=25).step_by(3).chain([1_000_000]).chain((31..=61).step_by(3)).collect();
        let account = account(&numbers);
        assert_eq!((account.reordered, account.used), (1, 9 + 1 + 10));
        assert_eq!(account.from(7), Some(&Span::of(7, 1, 61)));
        assert_eq!(account.used + account.reordered + account.missing, 61 + 1);
    }

    #[test]
    fn a_publisher_that_counts_anew_loses_one_sample() {
        let numbers: Vec<u64> = (1..=100).chain(1..=50).collect();
        let account = account(&numbers);
        assert_eq!((account.duplicate, account.missing, account.used), (1, 0, 149));
    }

    #[test]
    fn samples_that_come_a_little_late_stay_late() {
        let numbers: Vec<u64> = (1..=4).chain(9..=20).chain(5..=8).chain(21..=30).collect();
        let account = account(&numbers);
        assert_eq!((account.reordered, account.missing, account.used), (4, 0, 26));
    }

    #[test]
    fn counts_that_no_reader_can_have_are_named() {
        let fault = |change: fn(&mut InputAccount)| {
            let mut account = account(&[1, 2, 4]);
            change(&mut account);
            account.check().map_err(|fault| fault.finding().0)
        };
        assert_eq!(fault(|_| ()), Ok(()));
        assert_eq!(fault(|account| account.missing = 1 << 63), Err("missing"));
        assert_eq!(fault(|account| account.hole = Span::of(7, 3, 2)), Err("hole"));
        assert_eq!(fault(|account| account.writers[1].incarnation = 9), Ok(()));
        assert_eq!(fault(|account| account.writers[1] = Span::of(9, 1, u64::MAX)), Err("writers"));
    }

    #[test]
    fn what_a_full_buffer_lost_is_overwritten_and_not_missing() {
        let before = account(&[1, 2, 4]);
        let mut after = before;
        (9..=24).for_each(|sequence| assert_eq!(after.arrive(&header(7, sequence)), None));
        after.overflowed_since(&before, 16, true);
        assert_eq!((after.overwritten, after.missing, after.hole), (4, 1, Span::of(7, 3, 3)));
    }

    #[test]
    fn a_gap_among_the_newest_is_missing_even_behind_a_full_buffer() {
        let before = account(&[1]);
        let mut after = before;
        (9..=30).filter(|sequence| *sequence != 20).for_each(|sequence| {
            after.arrive(&header(7, sequence));
        });
        let mut with_more = after;
        after.overflowed_since(&before, 16, true);
        assert_eq!((after.overwritten, after.missing, after.hole), (7, 1, Span::of(7, 20, 20)));
        with_more.overflowed_since(&before, 16, false);
        assert_eq!((with_more.overwritten, with_more.missing, with_more.hole), (8, 0, Span::default()));
    }

    #[test]
    fn one_without_a_fate_is_known_by_its_number() {
        let mut account = account(&[1, 2]);
        account.arrive(&header(7, 3));
        account.arrive(&header(7, 4));
        account.settle(Fate::Used, &header(7, 4));
        assert_eq!((account.open, account.open_sum), (1, 3));
    }

    #[test]
    fn writers_are_counted_separately_and_the_oldest_is_replaced() {
        let mut account = InputAccount::default();
        for incarnation in 1..=5 {
            for sequence in 1..=2 {
                assert_eq!(account.arrive(&header(incarnation, sequence)), None);
            }
        }
        assert_eq!(account.missing, 0);
        assert_eq!(account.from(1), None);
        assert_eq!(account.from(5), Some(&Span::of(5, 1, 2)));
    }
}
