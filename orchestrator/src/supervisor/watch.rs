//! What is due by the clock: restarts, start time-outs, hangs and kills.

use shared_types::Phase;

use super::policy::nanoseconds;
use super::slot::{Ending, Life};
use super::{Action, Supervisor, warn};

/// A kill is repeated at most this often [ms]: one that had no effect is worth a line in the log, not a flood.
const KILL_AGAIN_AFTER_MS: u64 = 1_000;

impl Supervisor {
    pub(super) fn tick(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        for index in 0..self.slots.len() {
            let hang_deadline_ns = match self.phase {
                Phase::Driving => self.slots[index].hang_deadline_ns(),
                _ => None,
            };
            let slot = &mut self.slots[index];
            let (role, policy) = (slot.policy.role, slot.policy);
            let due = |deadline: Option<u64>| deadline.is_some_and(|deadline_ns| deadline_ns <= now_ns);
            match &mut slot.life {
                Life::Waiting { due_ns } if *due_ns <= now_ns => self.spawn(index, actions),
                Life::Alive(alive) => {
                    if due(alive.kill_ns) {
                        actions.push(warn(format!("{role} does not end and is killed")));
                    } else if due(alive.start_deadline_ns) {
                        alive.ending = Some(Ending::StartTimeout);
                        let limit = policy.start_timeout_ms;
                        actions.push(warn(format!("{role} did not start within {limit} ms and is killed")));
                    } else if due(hang_deadline_ns) {
                        alive.ending = Some(Ending::Hung);
                        let limit = policy.hang_after_ms;
                        actions.push(warn(format!("{role} made no progress for {limit} ms and is killed")));
                    } else {
                        continue;
                    }
                    alive.start_deadline_ns = None;
                    alive.kill_ns = Some(now_ns.saturating_add(nanoseconds(KILL_AGAIN_AFTER_MS)));
                    actions.push(Action::Kill { role });
                }
                _ => {}
            }
        }
    }

    /// Gives everyone a fresh limit when the caller was stopped: processes may have been stopped with it.
    pub(super) fn forgive_own_stall(&mut self, now_ns: u64) {
        let longest_ms = self.slots.iter().map(|slot| slot.policy.hang_after_ms).max().unwrap_or(0);
        let gap_ns = self.last_event_ns.map_or(0, |last_ns| now_ns.saturating_sub(last_ns));
        self.last_event_ns = Some(now_ns);
        if gap_ns > nanoseconds(longest_ms).saturating_mul(2) {
            self.refresh_progress(now_ns);
        }
    }

    pub(super) fn refresh_progress(&mut self, now_ns: u64) {
        for slot in &mut self.slots {
            if let Life::Alive(alive) = &mut slot.life {
                alive.progress_ns = now_ns;
            }
        }
    }
}
