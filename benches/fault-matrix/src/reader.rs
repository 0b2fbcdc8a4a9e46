//! The reading end of a topic, with the rules of `runtime`: number, content, authority, age, in this order.
//!
//! The rules themselves are those of `shared-types`, which the processes use as well.

use std::collections::VecDeque;

use shared_types::{
    Admission, Authority, AuthorityFilter, Fate, InputAccount, KnownScan, Role, Rule, Sample, Topic,
    YOUNG_NS, require_sequence,
};

/// Samples that wait, as in `runtime`.
const DEPTH: usize = 12;
/// Samples of the other process of a swap that are kept.
const ASIDE: usize = 3;
/// Scan periods after which a sample is too old.
const MAX_AGE_PERIODS: u64 = 3;

/// Reads the samples of one topic for one role.
#[derive(Debug, Clone)]
pub(crate) struct Reader<S> {
    role: Role,
    max_age_ns: u64,
    period_ns: u64,
    known_scan: KnownScan,
    /// When the newest sample came [ns].
    arrived_ns: u64,
    account: InputAccount,
    filter: AuthorityFilter,
    kept: VecDeque<S>,
    aside: VecDeque<S>,
}

impl<S: Sample> Reader<S> {
    pub(crate) fn new(role: Role, period_ns: u64) -> Self {
        Self {
            role,
            max_age_ns: (MAX_AGE_PERIODS * period_ns).max(YOUNG_NS),
            period_ns,
            known_scan: KnownScan::default(),
            arrived_ns: 0,
            account: InputAccount::default(),
            filter: AuthorityFilter::default(),
            kept: VecDeque::new(),
            aside: VecDeque::new(),
        }
    }

    /// Takes a sample from the bus; returns the rule that it failed, or that numbers before it are missing.
    pub(crate) fn arrive(&mut self, sample: S, now_ns: u64, authority: &Authority) -> Option<&'static str> {
        let (check, header) = (sample.check(), *sample.header());
        let span = self.account.from(header.incarnation);
        let (newest, since_ns) = span.map_or((0, 0), |span| (span.last, self.arrived_ns));
        let readable = match check {
            Err(fault) if fault.hides_sequence() => Err(fault),
            _ => require_sequence(header.sequence, newest, now_ns.saturating_sub(since_ns)),
        };
        if let Err(fault) = readable {
            return Some(fault.rule().name());
        }
        self.arrived_ns = now_ns;
        let check =
            check.and_then(|()| self.known_scan.judge(&header, now_ns, self.max_age_ns, self.period_ns));
        let missing = self.account.missing;
        match self.account.arrive(sample.header()) {
            Some(Fate::Duplicate) => return Some("duplicate"),
            Some(_) => return Some("reordered"),
            None => {}
        }
        let lost = (self.account.missing > missing).then_some("missing");
        if let Err(fault) = check {
            return Some(fault.rule().name());
        }
        self.offer(sample, now_ns, authority, false).or(lost)
    }

    /// Looks again at what was kept aside, after the authority has changed.
    pub(crate) fn review(&mut self, now_ns: u64, authority: &Authority) {
        for sample in std::mem::take(&mut self.aside) {
            self.offer(sample, now_ns, authority, true);
        }
    }

    fn offer(
        &mut self,
        sample: S,
        now_ns: u64,
        authority: &Authority,
        was_aside: bool,
    ) -> Option<&'static str> {
        match self.filter.admit(Some(authority), sample.header(), was_aside) {
            Admission::Counts => {}
            Admission::Aside => {
                push(&mut self.aside, sample, ASIDE);
                return None;
            }
            Admission::Foreign => return None,
        }
        let acquired_ns = sample.header().acquired_ns;
        if acquired_ns.saturating_sub(now_ns) > self.max_age_ns {
            return Some(Rule::FromTheFuture.name());
        }
        let is_record = S::TOPIC == Topic::Actuation && self.role != Role::Robot;
        if !is_record && acquired_ns != 0 && now_ns.saturating_sub(acquired_ns) > self.max_age_ns {
            return Some(Rule::TooOld.name());
        }
        self.known_scan = self.known_scan.and(sample.header(), now_ns);
        push(&mut self.kept, sample, DEPTH);
        None
    }

    /// The oldest sample that waits.
    pub(crate) fn take(&mut self) -> Option<S> {
        self.kept.pop_front()
    }

    fn scans(&self) -> impl DoubleEndedIterator<Item = (u64, u64)> + '_ {
        self.kept.iter().map(|sample| (sample.header().scan_id, sample.header().acquired_ns))
    }

    fn take_scan(&mut self, scan_id: u64) -> Option<S> {
        while self.kept.front().is_some_and(|sample| sample.header().scan_id < scan_id) {
            self.kept.pop_front();
        }
        let is_there = self.kept.front().is_some_and(|sample| sample.header().scan_id == scan_id);
        if is_there { self.kept.pop_front() } else { None }
    }
}

/// Samples of the oldest scan that both have and that is young enough, else of the newest that both have.
pub(crate) fn join<A: Sample, B: Sample>(
    one: &mut Reader<A>,
    other: &mut Reader<B>,
    now_ns: u64,
) -> Option<(A, B)> {
    let has = |scan_id: u64| other.scans().any(|(scan, _)| scan == scan_id);
    let pairs: Vec<(u64, u64)> = one.scans().filter(|(scan_id, _)| has(*scan_id)).collect();
    let is_young = |(_, acquired_ns): &&(u64, u64)| now_ns.saturating_sub(*acquired_ns) < one.max_age_ns;
    let (scan_id, _) = *pairs.iter().find(is_young).or(pairs.last())?;
    let first = one.take_scan(scan_id)?;
    Some((first, other.take_scan(scan_id)?))
}

fn push<S>(queue: &mut VecDeque<S>, sample: S, depth: usize) {
    if queue.len() == depth {
        queue.pop_front();
    }
    queue.push_back(sample);
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::{Obstacles, Pose};

    const ALONE: Authority = Authority { incarnation: 4, previous: 0, from_scan: 0 };

    fn pose(scan_id: u64, sequence: u64) -> Pose {
        let mut pose = Pose::default();
        pose.header.layout = Pose::LAYOUT;
        (pose.header.scan_id, pose.header.sequence) = (scan_id, sequence);
        (pose.header.incarnation, pose.header.acquired_ns) = (4, scan_id * 100_000_000);
        pose
    }

    #[test]
    fn each_rule_drops_its_sample_and_names_itself() {
        let mut reader = Reader::<Pose>::new(Role::Controller, 100_000_000);
        let mut arrive = |sample: Pose, now_ns| reader.arrive(sample, now_ns, &ALONE);
        assert_eq!(arrive(pose(1, 1), 130_000_000), None);
        assert_eq!(arrive(pose(1, 1), 130_000_000), Some("duplicate"));
        assert_eq!(arrive(pose(3, 3), 330_000_000), Some("missing"));
        assert_eq!(arrive(pose(2, 2), 330_000_000), Some("reordered"));
        assert_eq!(arrive(Pose { x_m: f64::NAN, ..pose(4, 4) }, 430_000_000), Some("not_finite"));
        assert_eq!(arrive(pose(5, 5), 800_000_001), Some("too_old"));
        assert_eq!(arrive(pose(9, 6), 599_999_999), Some("from_the_future"));
        let mut foreign = pose(6, 7);
        foreign.header.layout ^= 1;
        assert_eq!(arrive(foreign, 630_000_000), Some("foreign_layout"));
        let taken: Vec<u64> =
            std::iter::from_fn(|| reader.take()).map(|sample| sample.header.scan_id).collect();
        assert_eq!(taken, [1, 3]);
    }

    #[test]
    fn both_samples_of_a_scan_are_joined_and_older_ones_are_dropped() {
        let mut poses = Reader::<Pose>::new(Role::Controller, 100_000_000);
        let mut bodies = Reader::<Obstacles>::new(Role::Controller, 100_000_000);
        for scan_id in 1..=3 {
            assert_eq!(poses.arrive(pose(scan_id, scan_id), 330_000_000, &ALONE), None);
        }
        assert!(join(&mut poses, &mut bodies, 330_000_000).is_none());
        let mut body =
            Obstacles { scanner: shared_types::ScannerHealth::healthy(5.0), ..Obstacles::default() };
        body.header = shared_types::Header { layout: Obstacles::LAYOUT, ..pose(2, 1).header };
        assert_eq!(bodies.arrive(body, 330_000_000, &ALONE), None);
        let joined = join(&mut poses, &mut bodies, 330_000_000).map(|(pose, _)| pose.header.scan_id);
        assert_eq!(joined, Some(2));
        assert_eq!(poses.take().map(|pose| pose.header.scan_id), Some(3));
    }
}
