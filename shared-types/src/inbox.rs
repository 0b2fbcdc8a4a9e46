//! The rules of an input: what becomes of each sample that arrives. Readers on the bus and in simulated time have them.
//!
//! A sample is dropped at the first rule that it breaks: number, content, authority, age. What is dropped is handed
//! back, because it may be borrowed from its publisher.

use std::cell::Cell;
use std::collections::VecDeque;
use std::ops::Deref;

use crate::{
    Admission, Authority, AuthorityFilter, Fate, Fault, Header, InputAccount, KnownScan, SampleType,
    require_sequence,
};

/// Samples that wait in an input until the process takes them; the oldest is dropped for a newer one.
pub const QUEUE_DEPTH: usize = 12;
/// Samples of the other process of a swap that are kept in case it answers after all: one scan is open when it takes
/// over at 1.2 periods; two more for an orchestrator that is delayed.
pub const ASIDE_DEPTH: usize = 3;

/// Samples of one topic that wait for a process, as bytes.
#[derive(Debug, Clone)]
pub struct Inbox<B> {
    of: &'static SampleType,
    account: InputAccount,
    filter: AuthorityFilter,
    kept: VecDeque<B>,
    aside: VecDeque<B>,
}

/// What the rules depend on when samples arrive.
#[derive(Debug, Clone, Copy)]
pub struct InboxRules<'a> {
    /// Whose samples count; `None` for a topic that several processes write.
    pub authority: Option<Authority>,
    /// The newest scan that the process knows of.
    pub known_scan: &'a Cell<KnownScan>,
    /// When the input was polled before and last [ns of CLOCK_MONOTONIC].
    pub polled_ns: [u64; 2],
    /// The time of the loop [ns].
    pub now_ns: u64,
    /// Scan period [ns].
    pub period_ns: u64,
    /// Age above which a sample is dropped [ns].
    pub max_age_ns: u64,
    /// In lock-step the stamps are the clock: none is too old or from the future.
    pub is_lockstep: bool,
    /// The process reads the sample as a record, which stays true.
    pub is_record: bool,
}

/// What became of a sample that has arrived.
#[derive(Debug)]
pub struct InboxArrival<B> {
    /// What is wrong with it, if something is.
    pub fault: Option<Fault>,
    /// Its fate, if that is decided; `None` for one that waits, and for one whose number can't be read.
    pub fate: Option<Fate>,
    /// Numbers between the one before and it are missing, or it is the first of its publisher.
    pub is_news: bool,
    /// Numbers before it are missing.
    pub is_after_gap: bool,
    /// The sample, if it is dropped.
    pub dropped: Option<B>,
    /// An older one that was dropped for it.
    pub pushed_out: Option<B>,
}

impl<B> InboxArrival<B> {
    fn kept(pushed_out: Option<B>) -> Self {
        Self { fault: None, fate: None, is_news: false, is_after_gap: false, dropped: None, pushed_out }
    }

    fn dropped(sample: B, fate: Fate) -> Self {
        Self { fate: Some(fate), dropped: Some(sample), ..Self::kept(None) }
    }
}

impl<B: Deref<Target = [u8]>> Inbox<B> {
    /// An empty one for samples of a type.
    pub fn new(of: &'static SampleType) -> Self {
        Self {
            of,
            account: InputAccount::default(),
            filter: AuthorityFilter::default(),
            kept: VecDeque::with_capacity(QUEUE_DEPTH),
            aside: VecDeque::with_capacity(ASIDE_DEPTH),
        }
    }

    /// The type of its samples.
    pub fn of(&self) -> &'static SampleType {
        self.of
    }

    /// Header of a sample.
    pub fn header<'s>(&self, sample: &'s B) -> &'s Header {
        (self.of.header)(sample)
    }

    /// Takes in a sample from the bus.
    pub fn arrive(&mut self, sample: B, rules: &InboxRules<'_>) -> InboxArrival<B> {
        let header = *self.header(&sample);
        let check = (self.of.check)(&sample);
        let readable = match check {
            Err(fault) if fault.hides_sequence() => Err(fault),
            _ => self.judge_sequence(&header, rules),
        };
        if let Err(fault) = readable {
            self.account.unreadable += 1;
            return InboxArrival { fault: Some(fault), dropped: Some(sample), ..InboxArrival::kept(None) };
        }
        let check = check.and_then(|()| self.judge_scan(&header, rules));
        let (missing, is_first) = (self.account.missing, self.account.from(header.incarnation).is_none());
        let by_number = self.account.arrive(&header);
        let is_after_gap = self.account.missing > missing;
        let arrival = match (by_number, check) {
            (Some(fate), _) => self.drop(sample, fate),
            (None, Err(fault)) => InboxArrival { fault: Some(fault), ..self.drop(sample, Fate::Invalid) },
            (None, Ok(())) => self.offer(sample, rules, false),
        };
        InboxArrival { is_news: is_first || is_after_gap || by_number.is_some(), is_after_gap, ..arrival }
    }

    /// Looks again at what was kept aside, after the authority has changed, and hands each result to `each`.
    pub fn review(&mut self, rules: &InboxRules<'_>, mut each: impl FnMut(InboxArrival<B>)) {
        for _ in 0..self.aside.len() {
            if let Some(sample) = self.aside.pop_front() {
                each(self.offer(sample, rules, true));
            }
        }
    }

    /// Keeps a sample that counts, keeps one aside that may count later, drops any other.
    fn offer(&mut self, sample: B, rules: &InboxRules<'_>, was_aside: bool) -> InboxArrival<B> {
        let header = *self.header(&sample);
        match self.filter.admit(rules.authority.as_ref(), &header, was_aside) {
            Admission::Counts => {}
            Admission::Aside => {
                let oldest = pushed(&mut self.aside, sample, ASIDE_DEPTH);
                return InboxArrival::kept(self.settled(oldest, Fate::Foreign));
            }
            Admission::Foreign => return self.drop(sample, Fate::Foreign),
        }
        if let Some(fault) = self.wrong_time(&header, rules) {
            return InboxArrival { fault: Some(fault), ..self.drop(sample, Fate::Stale) };
        }
        if self.is_of_the_loop() {
            rules.known_scan.set(rules.known_scan.get().and(&header, rules.now_ns));
        }
        let oldest = pushed(&mut self.kept, sample, QUEUE_DEPTH);
        InboxArrival::kept(self.settled(oldest, Fate::Replaced))
    }

    /// Whether one process writes the topic, in answer to scans.
    fn is_of_the_loop(&self) -> bool {
        self.of.topic.writer().is_some()
    }

    /// Passes when the publisher can have used the sequence number of a sample by now.
    fn judge_sequence(&self, header: &Header, rules: &InboxRules<'_>) -> Result<(), Fault> {
        let [before_ns, now_ns] = rules.polled_ns;
        // All that is known of a new publisher is that it is not older than the machine.
        let (newest, since_ns) =
            self.account.from(header.incarnation).map_or((0, 0), |span| (span.last, before_ns));
        require_sequence(header.sequence, newest, now_ns.saturating_sub(since_ns))
    }

    /// Passes when the scan of a sample can exist.
    fn judge_scan(&self, header: &Header, rules: &InboxRules<'_>) -> Result<(), Fault> {
        if !self.is_of_the_loop() {
            return Ok(());
        }
        let max_ahead_ns = if rules.is_lockstep { u64::MAX } else { rules.max_age_ns };
        rules.known_scan.get().judge(header, rules.now_ns, max_ahead_ns, rules.period_ns)
    }

    /// What is wrong with the time of a sample: it is too old, or from the future.
    fn wrong_time(&self, header: &Header, rules: &InboxRules<'_>) -> Option<Fault> {
        if rules.is_lockstep || !self.is_of_the_loop() || header.acquired_ns == 0 {
            return None;
        }
        let ahead_ns = header.acquired_ns.saturating_sub(rules.now_ns);
        if ahead_ns > rules.max_age_ns {
            return Some(Fault::FromTheFuture { ahead_ms: ahead_ns as f64 * 1e-6 });
        }
        let age_ns = rules.now_ns.saturating_sub(header.acquired_ns);
        let is_old = !rules.is_record && age_ns > rules.max_age_ns;
        is_old.then_some(Fault::TooOld { age_ms: age_ns as f64 * 1e-6 })
    }

    fn drop(&mut self, sample: B, fate: Fate) -> InboxArrival<B> {
        self.settle(fate, &sample);
        InboxArrival::dropped(sample, fate)
    }

    fn settled(&mut self, sample: Option<B>, fate: Fate) -> Option<B> {
        sample.inspect(|sample| self.settle(fate, sample))
    }

    /// Notes the fate of a sample.
    pub fn settle(&mut self, fate: Fate, sample: &B) {
        let header = *self.header(sample);
        self.account.settle(fate, &header);
    }

    /// The oldest sample that waits; its fate is not noted.
    pub fn pop(&mut self) -> Option<B> {
        self.kept.pop_front()
    }

    /// The newest sample; older ones are dropped and counted as replaced. Its own fate is not noted.
    pub fn pop_newest(&mut self) -> Option<B> {
        let sample = self.kept.pop_back()?;
        while let Some(older) = self.kept.pop_front() {
            self.settle(Fate::Replaced, &older);
        }
        Some(sample)
    }

    /// The sample of one scan, if it is there; older ones are dropped and counted as replaced. Its fate is not noted.
    pub fn pop_scan(&mut self, scan_id: u64) -> Option<B> {
        while self.next_scan().is_some_and(|next| next < scan_id) {
            if let Some(sample) = self.kept.pop_front() {
                self.settle(Fate::Replaced, &sample);
            }
        }
        if self.next_scan() == Some(scan_id) { self.kept.pop_front() } else { None }
    }

    /// The oldest sample that waits, unless it is of a later scan; its fate is not noted.
    pub fn pop_up_to(&mut self, scan_id: u64) -> Option<B> {
        if self.next_scan()? <= scan_id { self.kept.pop_front() } else { None }
    }

    /// Drops waiting samples that `is_old` accepts, counted as replaced.
    pub fn skip(&mut self, is_old: &dyn Fn(&[u8]) -> bool) {
        let Self { of, account, kept, .. } = self;
        kept.retain(|sample| {
            let is_old = is_old(sample);
            if is_old {
                account.settle(Fate::Replaced, (of.header)(sample));
            }
            !is_old
        });
    }

    /// The scan of the oldest sample that waits.
    pub fn next_scan(&self) -> Option<u64> {
        self.kept.front().map(|sample| self.header(sample).scan_id)
    }

    /// Whether no sample waits.
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// The scan of which this and another input have samples and which is to be answered next: the oldest that can be
    /// answered in time if the process can catch up with so many, else the newest.
    pub fn joint_scan(
        &self,
        other: &Self,
        catches_up: impl FnOnce(u64) -> bool,
        can_answer: impl Fn(&Header) -> bool,
    ) -> Option<u64> {
        let has = |scan_id| other.kept.iter().any(|sample| other.header(sample).scan_id == scan_id);
        let headers = self.kept.iter().map(|sample| self.header(sample));
        let mut pairs = headers.filter(|header| has(header.scan_id));
        let newest = pairs.clone().next_back()?;
        let catches_up = catches_up(pairs.clone().count() as u64);
        let oldest = pairs.find(|header| catches_up && can_answer(header));
        Some(oldest.unwrap_or(newest).scan_id)
    }

    /// The counters of all samples so far.
    pub fn account(&self) -> InputAccount {
        let mut account = self.account;
        for sample in self.kept.iter().chain(&self.aside) {
            account.waiting += 1;
            account.waiting_sum = account.waiting_sum.wrapping_add(self.header(sample).sequence);
        }
        account
    }

    /// Counts numbers that are missing since `before` as overwritten in a queue of `capacity` that was full; see
    /// [`InputAccount::overflowed_since`].
    pub fn overflowed_since(&mut self, before: &InputAccount, capacity: u64, is_all: bool) {
        self.account.overflowed_since(before, capacity, is_all);
    }
}

/// Appends a sample; from a queue that holds `depth`, the oldest is handed back.
fn pushed<B>(queue: &mut VecDeque<B>, sample: B, depth: usize) -> Option<B> {
    let oldest = if queue.len() == depth { queue.pop_front() } else { None };
    queue.push_back(sample);
    oldest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Obstacles, Pose, Rule, Sample, ScannerHealth};

    const PERIOD: u64 = 100_000_000;
    const ALONE: Authority = Authority { incarnation: 4, previous: 0, from_scan: 0 };

    fn pose(scan_id: u64, sequence: u64) -> Pose {
        let mut pose = Pose::default();
        pose.header.layout = Pose::LAYOUT;
        (pose.header.scan_id, pose.header.sequence) = (scan_id, sequence);
        (pose.header.incarnation, pose.header.acquired_ns) = (4, scan_id * PERIOD);
        pose
    }

    /// Bytes that lie where a sample may lie.
    fn bytes(sample: impl Sample) -> &'static [u8] {
        bytemuck::bytes_of(Box::leak(Box::new(sample)))
    }

    fn rules(known_scan: &Cell<KnownScan>, now_ns: u64) -> InboxRules<'_> {
        InboxRules {
            authority: Some(ALONE),
            known_scan,
            polled_ns: [0, now_ns],
            now_ns,
            period_ns: PERIOD,
            max_age_ns: 3 * PERIOD,
            is_lockstep: false,
            is_record: false,
        }
    }

    #[test]
    fn each_rule_drops_its_sample_and_names_itself() {
        let (mut inbox, known) = (Inbox::new(Pose::TYPE), Cell::default());
        let mut arrive = |sample: Pose, now_ns| {
            let arrival = inbox.arrive(bytes(sample), &rules(&known, now_ns));
            (arrival.fault.map(|fault| fault.rule()), arrival.fate, arrival.is_after_gap)
        };
        assert_eq!(arrive(pose(1, 1), 130_000_000), (None, None, false));
        assert_eq!(arrive(pose(1, 1), 130_000_000), (None, Some(Fate::Duplicate), false));
        assert_eq!(arrive(pose(3, 3), 330_000_000), (None, None, true));
        assert_eq!(arrive(pose(2, 2), 330_000_000), (None, Some(Fate::Reordered), false));
        let unusable = Pose { x_m: f64::NAN, ..pose(4, 4) };
        assert_eq!(arrive(unusable, 430_000_000), (Some(Rule::NotFinite), Some(Fate::Invalid), false));
        assert_eq!(arrive(pose(5, 5), 800_000_001), (Some(Rule::TooOld), Some(Fate::Stale), false));
        assert_eq!(arrive(pose(9, 6), 599_999_999), (Some(Rule::FromTheFuture), Some(Fate::Stale), false));
        let mut foreign = pose(6, 7);
        foreign.header.layout ^= 1;
        assert_eq!(arrive(foreign, 630_000_000), (Some(Rule::Layout), None, false));
        let mut taken = Vec::new();
        while let Some(sample) = inbox.pop() {
            taken.push(inbox.header(&sample).scan_id);
        }
        assert_eq!(taken, [1, 3]);
    }

    #[test]
    fn an_arrival_tells_what_is_news_and_what_waits_is_taken_up_to_a_scan() {
        let (mut inbox, known) = (Inbox::new(Pose::TYPE), Cell::default());
        let arrive = |inbox: &mut Inbox<_>, sample| inbox.arrive(bytes(sample), &rules(&known, 330_000_000));
        assert!(arrive(&mut inbox, pose(1, 1)).is_news, "the first of a publisher");
        assert!(!arrive(&mut inbox, pose(2, 2)).is_news);
        let before = inbox.account();
        assert!(arrive(&mut inbox, pose(3, 4)).is_news, "after a gap");
        assert!(arrive(&mut inbox, pose(3, 4)).is_news, "a second time");
        for count in 1..=2 {
            let mut foreign = pose(3, 5);
            foreign.header.layout ^= 1;
            assert!(arrive(&mut inbox, foreign).dropped.is_some());
            assert_eq!(inbox.account().unreadable, count);
        }
        // The queue was full: what is missing was overwritten in it.
        inbox.overflowed_since(&before, 3, false);
        assert_eq!((inbox.account().missing, inbox.account().overwritten), (0, 1));
        let mut taken = |up_to| inbox.pop_up_to(up_to).map(|sample| inbox.header(&sample).scan_id);
        assert_eq!([0, 2, 2, 2, 3].map(&mut taken), [None, Some(1), Some(2), None, Some(3)]);
        assert_eq!(taken(9), None);
    }

    #[test]
    fn both_samples_of_a_scan_are_joined_and_older_ones_are_dropped() {
        let (mut poses, mut bodies, known) =
            (Inbox::new(Pose::TYPE), Inbox::new(Obstacles::TYPE), Cell::default());
        for scan_id in 1..=3 {
            let arrival = poses.arrive(bytes(pose(scan_id, scan_id)), &rules(&known, 330_000_000));
            assert!(arrival.dropped.is_none());
        }
        let next = |poses: &Inbox<_>, bodies: &Inbox<_>| poses.joint_scan(bodies, |_| true, |_| true);
        assert_eq!(next(&poses, &bodies), None);
        let header = Header { layout: Obstacles::LAYOUT, ..pose(2, 1).header };
        let body = Obstacles { header, scanner: ScannerHealth::healthy(5.0), ..Obstacles::default() };
        assert!(bodies.arrive(bytes(body), &rules(&known, 330_000_000)).dropped.is_none());
        assert_eq!(next(&poses, &bodies), Some(2));
        assert!(poses.pop_scan(2).is_some());
        assert_eq!((poses.next_scan(), poses.account().replaced), (Some(3), 1));
    }
}
