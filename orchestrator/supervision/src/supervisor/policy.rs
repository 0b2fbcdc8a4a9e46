//! How one process is to be kept alive.

use serde::{Deserialize, Serialize};
use shared_types::Role;
use vehicle::Setting;

/// Heartbeats come ten times a second; a limit below three of them would call a healthy process hung.
pub const MIN_HANG_AFTER_MS: u64 = 300;

/// When a process that ended is started again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Restart {
    /// Never: its end is the end of the run.
    Never,
    /// Unless it ended by itself with exit code 0, which ends the run.
    OnFailure,
    /// Always.
    Always,
}

impl Setting for Restart {}

/// How one process is started, watched, restarted and stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProcessPolicy {
    /// The role of the process; each role has one process.
    pub role: Role,
    /// When it is started again; a robot never is, independent of this.
    pub restart: Restart,
    /// Pause before the restart of a process that died at its start; doubles with each further death [ms].
    pub backoff_initial_ms: u64,
    /// Longest pause before a restart [ms].
    pub backoff_cap_ms: u64,
    /// Deaths before the first valid output, without a healthy run between, that end the run.
    pub start_limit: u32,
    /// Restarts within `restart_window_ms` of a process that had been ready; one death more ends the run.
    pub restart_limit: u32,
    /// Over this time deaths of a process that had been ready are counted [ms].
    pub restart_window_ms: u64,
    /// Time after its first valid output from which earlier deaths are forgotten [ms].
    pub healthy_after_ms: u64,
    /// Longest time to attach, once more to connect, and once more to the first output of a process that has all it
    /// reads [ms].
    pub start_timeout_ms: u64,
    /// Time between the request to end and the kill [ms].
    pub grace_ms: u64,
    /// A connected process without progress for this long while driving is killed as hung [ms].
    pub hang_after_ms: u64,
}

impl ProcessPolicy {
    /// The policy of a role at a scan period [ms]: hung after three periods, but never before three heartbeats.
    pub fn new(role: Role, period_ms: u64) -> Self {
        Self {
            role,
            restart: if role == Role::Robot { Restart::Never } else { Restart::OnFailure },
            backoff_initial_ms: 100,
            backoff_cap_ms: 5_000,
            // A wrong option or a missing file fails at once and every time: three tries are enough to know.
            start_limit: 3,
            // Backoff alone would never end a run whose process dies a second after each start.
            restart_limit: 5,
            restart_window_ms: 60_000,
            healthy_after_ms: 3_000,
            // An interpreter with a cold cache on a loaded machine needs seconds.
            start_timeout_ms: 10_000,
            grace_ms: 1_000,
            hang_after_ms: period_ms.saturating_mul(3).max(MIN_HANG_AFTER_MS),
        }
    }

    /// The rule of the role: a robot that died has lost its pose and the state of its wheels.
    pub(super) fn effective_restart(&self) -> Restart {
        if self.role == Role::Robot { Restart::Never } else { self.restart }
    }

    /// Pause before a restart after `streak` deaths without a healthy run between [ns].
    ///
    /// The first death of a process that was ready costs no pause: the robot is blind meanwhile.
    pub(super) fn backoff_ns(&self, streak: u32, was_ready: bool) -> u64 {
        if was_ready && streak <= 1 {
            return 0;
        }
        let doublings = streak.saturating_sub(1).min(32);
        nanoseconds(self.backoff_initial_ms.saturating_mul(1 << doublings).min(self.backoff_cap_ms))
    }
}

/// Milliseconds as nanoseconds.
pub(super) const fn nanoseconds(milliseconds: u64) -> u64 {
    milliseconds.saturating_mul(1_000_000)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pause_doubles_up_to_its_cap() {
        let policy = ProcessPolicy { backoff_cap_ms: 1_000, ..ProcessPolicy::new(Role::Controller, 100) };
        let pauses = [1, 2, 3, 4, 5, 6].map(|streak| policy.backoff_ns(streak, false) / 1_000_000);
        assert_eq!(pauses, [100, 200, 400, 800, 1_000, 1_000]);
        assert_eq!(policy.backoff_ns(u32::MAX, false), nanoseconds(1_000));
    }

    #[test]
    fn the_first_death_of_a_ready_process_costs_no_pause() {
        let policy = ProcessPolicy::new(Role::Controller, 100);
        assert_eq!(policy.backoff_ns(1, true), 0);
        assert_eq!(policy.backoff_ns(2, true), nanoseconds(200));
    }

    #[test]
    fn hung_means_three_periods_but_at_least_three_heartbeats() {
        assert_eq!(ProcessPolicy::new(Role::Estimator, 200).hang_after_ms, 600);
        assert_eq!(ProcessPolicy::new(Role::Estimator, 10).hang_after_ms, MIN_HANG_AFTER_MS);
    }
}
