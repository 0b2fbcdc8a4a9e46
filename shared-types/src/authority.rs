//! Whose samples count: the authority filter of every reader.
//!
//! A reader checks a sample in this order, and drops it at the first failure:
//!
//! 1. Is its number new? [`crate::InputAccount::arrive`] finds duplicates, and samples that come after a later one.
//! 2. Is its content valid? [`crate::Sample::check`].
//! 3. Has its publisher authority? [`AuthorityFilter`], below.
//! 4. Is its scan young enough? Only a reader that acts on the sample asks this.
//!
//! One incarnation has authority over a topic for all scans, except during a swap. Then one incarnation counts before
//! the handover scan and the other from it on. Readers learn the handover scan at different times, so during a swap
//!
//! * a sample of the incarnation that does not count for its scan is kept aside, because the handover scan may still
//!   move: it is checked again when the directive changes;
//! * a scan that one of the two has answered is not answered by the other: the second sample is dropped.
//!
//! Outside of swaps a publisher may repeat an older scan: a restarted actuator blocks the wheels with one.

use crate::Header;
use crate::describe::layout;

layout! {
    /// Whose samples count for one role.
    pub struct Authority(16) {
        /// The incarnation whose samples count from `from_scan` on; 0 accepts none
        pub incarnation: u32,
        /// The incarnation whose samples count before `from_scan`
        pub previous: u32,
        /// The scan at which authority changes
        pub from_scan: u64,
    }
}

impl Authority {
    /// Whether a sample for `scan_id` made by `incarnation` counts.
    pub fn accepts(&self, incarnation: u32, scan_id: u64) -> bool {
        let counts = if scan_id >= self.from_scan { self.incarnation } else { self.previous };
        counts != 0 && counts == incarnation
    }

    /// Whether `incarnation` takes part in a swap and counts for other scans than `scan_id`.
    fn may_accept_later(&self, incarnation: u32, scan_id: u64) -> bool {
        self.is_shared()
            && [self.incarnation, self.previous].contains(&incarnation)
            && !self.accepts(incarnation, scan_id)
    }

    /// Whether one process takes over from another.
    fn is_shared(&self) -> bool {
        self.incarnation != 0 && self.previous != 0 && self.incarnation != self.previous
    }
}

/// What a reader does with a sample by the authority of its publisher.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Admission {
    /// It is used.
    Counts,
    /// It is kept aside, and checked again when the directive changes.
    Aside,
    /// It is dropped.
    Foreign,
}

/// The authority filter of one reader of one topic: it keeps the newest scan answered, and by which incarnation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct AuthorityFilter {
    /// Incarnation of the sample admitted last.
    incarnation: u32,
    /// The newest scan of all samples admitted.
    scan_id: u64,
}

impl AuthorityFilter {
    /// What to do with a sample. `authority` comes from the newest directive, `None` for a topic that several
    /// processes write; `was_aside` is true for a sample that was kept aside before.
    pub fn admit(&mut self, authority: Option<&Authority>, header: &Header, was_aside: bool) -> Admission {
        let Header { incarnation, scan_id, .. } = *header;
        if let Some(authority) = authority {
            if authority.may_accept_later(incarnation, scan_id) {
                return Admission::Aside;
            }
            let is_other = was_aside || authority.is_shared() && incarnation != self.incarnation;
            if !authority.accepts(incarnation, scan_id) || (is_other && scan_id <= self.scan_id) {
                return Admission::Foreign;
            }
        }
        *self = Self { incarnation, scan_id: scan_id.max(self.scan_id) };
        Admission::Counts
    }
}

#[cfg(test)]
mod tests {
    use super::Admission::{Aside, Counts, Foreign};
    use super::*;

    const SWAP: Authority = Authority { incarnation: 9, previous: 4, from_scan: 100 };
    const ALONE: Authority = Authority { incarnation: 9, previous: 0, from_scan: 0 };

    fn of(incarnation: u32, scan_id: u64) -> Header {
        Header { incarnation, scan_id, ..Header::default() }
    }

    #[test]
    fn authority_changes_at_its_scan() {
        assert!(SWAP.accepts(4, 99) && !SWAP.accepts(4, 100) && SWAP.accepts(9, 100));
        assert!(!Authority::default().accepts(0, 1), "incarnation 0 never counts");
    }

    #[test]
    fn in_a_swap_one_counts_and_the_other_is_kept_aside() {
        for (incarnation, scan_id, expected) in
            [(4, 99, Counts), (9, 100, Counts), (9, 99, Aside), (4, 100, Aside), (5, 100, Foreign)]
        {
            let admission = AuthorityFilter::default().admit(Some(&SWAP), &of(incarnation, scan_id), false);
            assert_eq!(admission, expected, "{incarnation} for {scan_id}");
        }
        assert_eq!(AuthorityFilter::default().admit(Some(&ALONE), &of(4, 99), false), Foreign, "it is over");
    }

    #[test]
    fn a_scan_that_one_of_a_swap_has_answered_is_not_answered_by_the_other() {
        let mut filter = AuthorityFilter::default();
        assert_eq!(filter.admit(Some(&SWAP), &of(4, 99), false), Counts);
        let earlier = Authority { from_scan: 99, ..SWAP };
        assert_eq!(filter.admit(Some(&earlier), &of(9, 99), false), Foreign);
        assert_eq!(filter.admit(Some(&earlier), &of(9, 100), false), Counts);
    }

    #[test]
    fn what_was_aside_counts_unless_its_scan_was_answered_meanwhile() {
        let mut filter = AuthorityFilter::default();
        assert_eq!(filter.admit(Some(&ALONE), &of(9, 99), false), Counts);
        assert_eq!(filter.admit(Some(&ALONE), &of(9, 99), true), Foreign);
        assert_eq!(filter.admit(Some(&ALONE), &of(9, 100), true), Counts);
    }

    #[test]
    fn outside_of_a_swap_an_older_scan_counts_and_does_not_take_back_what_was_answered() {
        let mut filter = AuthorityFilter::default();
        for scan_id in [100, 98] {
            assert_eq!(filter.admit(Some(&ALONE), &of(9, scan_id), false), Counts);
        }
        assert_eq!(filter.admit(Some(&ALONE), &of(9, 99), true), Foreign);
    }

    #[test]
    fn on_a_topic_that_several_processes_write_all_count() {
        let mut filter = AuthorityFilter::default();
        for incarnation in [4, 9, 0] {
            assert_eq!(filter.admit(None, &of(incarnation, 7), false), Counts);
        }
    }
}
