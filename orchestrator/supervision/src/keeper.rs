//! When a companion is started, killed as hung, and given up: decisions without clock and processes.
//!
//! A companion is started at once, and again after each death, with pauses that double from 0.1 s to 5 s. One that dies
//! more often than `restart_limit` within `restart_window_s` has failed. One whose loop makes no pass for
//! `hang_after_ms` is killed and counts as dead. A companion never ends a run, unless the system file calls it needed.

use std::collections::VecDeque;

/// First pause before a restart, and the longest [ns].
const PAUSES_NS: [u64; 2] = [100_000_000, 5_000_000_000];
/// A companion that makes no pass for three periods, and at least this long, is hung [ms].
const MIN_HANG_MS: u64 = 1000;

/// What decides about one companion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeeperPolicy {
    /// Whether it is started again after it ended.
    pub restarts: bool,
    /// Deaths within the window; one more is a failure.
    pub restart_limit: usize,
    /// Window in which deaths count [ns].
    pub window_ns: u64,
    /// Time without a pass after which it is hung [ns].
    pub hang_ns: u64,
    /// Time to its first report [ns].
    pub start_ns: u64,
}

/// What a companion does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Life {
    /// It is started at this time [ns].
    Due(u64),
    /// It runs; when it was started, its newest number of passes, and when that had changed [ns].
    Running {
        /// When it was started [ns].
        since_ns: u64,
        /// Passes through its loop; `None` before its first report.
        passes: Option<u64>,
        /// When they changed last [ns].
        progress_ns: u64,
    },
    /// It was killed because it made no progress.
    Hung,
    /// It ended and is not started again.
    Failed,
}

/// What is to be done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KeeperOrder {
    /// Start a process.
    Start,
    /// Kill the process, which hangs.
    Kill,
}

/// Keeps one companion running.
#[derive(Debug, Clone, PartialEq)]
pub struct Keeper {
    policy: KeeperPolicy,
    life: Life,
    deaths: VecDeque<u64>,
    starts: u32,
}

impl KeeperPolicy {
    /// The time without a pass after which a companion of a system with that period is hung [ns].
    pub fn hang_ns(period_ns: u64) -> u64 {
        (3 * period_ns).max(MIN_HANG_MS * 1_000_000)
    }
}

impl Keeper {
    /// A companion that is to be started at once.
    pub fn new(policy: KeeperPolicy) -> Self {
        Self { policy, life: Life::Due(0), deaths: VecDeque::new(), starts: 0 }
    }

    /// What it does.
    pub fn life(&self) -> Life {
        self.life
    }

    /// Starts after the first.
    pub fn restarts(&self) -> u32 {
        self.starts.saturating_sub(1)
    }

    /// What is to be done now; `passes` are those that its process has reported, if it has.
    pub fn advance(&mut self, now_ns: u64, passes: Option<u64>) -> Option<KeeperOrder> {
        match &mut self.life {
            Life::Due(at_ns) if now_ns >= *at_ns => {
                self.starts += 1;
                self.life = Life::Running { since_ns: now_ns, passes: None, progress_ns: now_ns };
                Some(KeeperOrder::Start)
            }
            Life::Running { passes: before, progress_ns, .. } => {
                let limit_ns = if before.is_some() { self.policy.hang_ns } else { self.policy.start_ns };
                if passes.is_some() && passes != *before {
                    (*before, *progress_ns) = (passes, now_ns);
                } else if now_ns.saturating_sub(*progress_ns) > limit_ns {
                    self.life = Life::Hung;
                    return Some(KeeperOrder::Kill);
                }
                None
            }
            Life::Due(_) | Life::Hung | Life::Failed => None,
        }
    }

    /// Whether a process that makes no pass is over its limit; `None` before half of it, and for one that makes progress.
    pub fn suspicion(&self, now_ns: u64, passes: Option<u64>) -> Option<bool> {
        let Life::Running { passes: before, progress_ns, .. } = self.life else { return None };
        let limit_ns = if before.is_some() { self.policy.hang_ns } else { self.policy.start_ns };
        let silent_ns = now_ns.saturating_sub(progress_ns);
        let has_moved = passes.is_some() && passes != before;
        (!has_moved && 2 * silent_ns > limit_ns).then_some(silent_ns > limit_ns)
    }

    /// Its process is short of a processor: its time begins anew.
    pub fn excuse(&mut self, now_ns: u64) {
        if let Life::Running { progress_ns, .. } = &mut self.life {
            *progress_ns = now_ns;
        }
    }

    /// The caller did not run for `away_ns`: its process may have stood still as well.
    pub fn forgive(&mut self, away_ns: u64) {
        if let Life::Running { progress_ns, .. } = &mut self.life {
            *progress_ns = progress_ns.saturating_add(away_ns);
        }
    }

    /// Its process has ended, or could not be started.
    pub fn died(&mut self, now_ns: u64) {
        let window_ns = self.policy.window_ns;
        self.deaths.retain(|death| now_ns.saturating_sub(*death) < window_ns);
        self.deaths.push_back(now_ns);
        if !self.policy.restarts || self.deaths.len() > self.policy.restart_limit {
            self.life = Life::Failed;
            return;
        }
        let doublings = (self.deaths.len() - 1).min(16) as u32;
        self.life = Life::Due(now_ns + (PAUSES_NS[0] << doublings).min(PAUSES_NS[1]));
    }

    /// Another process, started at `now_ns`, is it from now on.
    pub fn replaced(&mut self, now_ns: u64) {
        self.life = Life::Running { since_ns: now_ns, passes: None, progress_ns: now_ns };
    }

    /// It is to be started at once.
    pub fn start_now(&mut self) {
        self.deaths.clear();
        self.life = Life::Due(0);
    }

    /// It is not started any more.
    pub fn give_up(&mut self) {
        self.life = Life::Failed;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;
    const POLICY: KeeperPolicy = KeeperPolicy {
        restarts: true,
        restart_limit: 2,
        window_ns: 60 * SECOND,
        hang_ns: SECOND,
        start_ns: 10 * SECOND,
    };

    #[test]
    fn it_is_started_at_once_and_again_after_a_pause_that_doubles() {
        let mut keeper = Keeper::new(POLICY);
        assert_eq!(keeper.advance(5, None), Some(KeeperOrder::Start));
        keeper.died(SECOND);
        assert_eq!(keeper.life(), Life::Due(SECOND + PAUSES_NS[0]));
        assert_eq!(keeper.advance(SECOND, None), None);
        assert_eq!(keeper.advance(2 * SECOND, None), Some(KeeperOrder::Start));
        keeper.died(2 * SECOND);
        assert_eq!(keeper.life(), Life::Due(2 * SECOND + 2 * PAUSES_NS[0]));
        assert_eq!(keeper.restarts(), 1);
        keeper.died(3 * SECOND);
        assert_eq!(keeper.life(), Life::Failed, "two within a minute are allowed");
    }

    #[test]
    fn deaths_that_are_long_ago_do_not_count() {
        let mut keeper = Keeper::new(POLICY);
        for minute in 1..10 {
            keeper.died(minute * 120 * SECOND);
            assert_ne!(keeper.life(), Life::Failed);
        }
    }

    #[test]
    fn the_time_in_which_nothing_could_be_seen_does_not_count() {
        let mut keeper = Keeper::new(POLICY);
        keeper.advance(0, None);
        keeper.advance(SECOND, Some(1));
        keeper.forgive(45 * SECOND);
        assert_eq!(keeper.advance(46 * SECOND, Some(1)), None, "nothing was seen for 45 s");
        assert_eq!(keeper.advance(47 * SECOND, Some(1)), None);
        assert_eq!(keeper.advance(47 * SECOND + 1, Some(1)), Some(KeeperOrder::Kill), "a second of silence");
    }

    #[test]
    fn one_that_is_short_of_a_processor_is_suspected_and_may_be_excused() {
        let mut keeper = Keeper::new(POLICY);
        assert_eq!(keeper.suspicion(0, None), None, "it does not run");
        keeper.advance(0, None);
        assert_eq!(keeper.suspicion(5 * SECOND, None), None, "it may take long to start");
        assert_eq!(keeper.suspicion(5 * SECOND + 1, None), Some(false));
        keeper.advance(6 * SECOND, Some(1));
        assert_eq!(keeper.suspicion(6 * SECOND + SECOND / 2, Some(1)), None);
        assert_eq!(keeper.suspicion(7 * SECOND, Some(1)), Some(false), "more than half of its time is over");
        assert_eq!(keeper.suspicion(7 * SECOND + 1, Some(1)), Some(true));
        assert_eq!(keeper.suspicion(7 * SECOND + 1, Some(2)), None, "a pass");
        keeper.excuse(7 * SECOND + 1);
        assert_eq!(keeper.advance(8 * SECOND, Some(1)), None, "its time began anew");
        assert_eq!(keeper.advance(8 * SECOND + 2, Some(1)), Some(KeeperOrder::Kill));
    }

    #[test]
    fn one_that_makes_no_pass_is_killed_once() {
        let mut keeper = Keeper::new(POLICY);
        keeper.advance(0, None);
        assert_eq!(keeper.advance(5 * SECOND, None), None, "it may take long to start");
        assert_eq!(keeper.advance(6 * SECOND, Some(1)), None);
        assert_eq!(keeper.advance(7 * SECOND, Some(1)), None);
        assert_eq!(keeper.advance(7 * SECOND + 1, Some(1)), Some(KeeperOrder::Kill));
        assert_eq!(keeper.advance(9 * SECOND, Some(1)), None);
        assert_eq!(keeper.life(), Life::Hung);
    }
}
