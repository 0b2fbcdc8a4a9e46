//! What is due by the clock: restarts, start time-outs, hangs and kills.

use shared_types::{Phase, ProcessState, ROLES, Role, Topic};

use super::policy::nanoseconds;
use super::slot::{EndReason, Life, Refused};
use super::turn::Turn;
use super::{Action, Supervisor};

/// A kill is repeated at most this often [ms]: one that had no effect is worth a line in the log, not a flood.
const KILL_AGAIN_AFTER_MS: u64 = 1_000;

impl Supervisor {
    pub(super) fn tick(&mut self, turn: &mut Turn) {
        if turn.is_due(self.halting_until_ns) {
            self.stop(turn);
        }
        let mut hung_robot_ms = None;
        for index in 0..self.slots.len() {
            let is_hung = self.phase == Phase::Driving && turn.is_due(self.slots[index].hang_deadline_ns());
            let slot = &mut self.slots[index];
            let (role, policy) = (slot.policy.role, slot.policy);
            match &mut slot.life {
                Life::Waiting { due_ns } if *due_ns <= turn.now_ns => self.spawn(turn, index),
                Life::Alive(alive) => {
                    if turn.is_due(alive.kill_ns) {
                        turn.warn(format!("{role} does not end and is killed"));
                    } else if turn.is_due(alive.start_deadline_ns) {
                        let connected = alive.reached >= Some(ProcessState::Connected);
                        let (ending, what) = match connected {
                            true if slot.refused.is_some() => (EndReason::Refused, "had no valid output"),
                            true => (EndReason::NoOutput, "had no output"),
                            false => (EndReason::StartTimeout, "did not start"),
                        };
                        alive.ending = Some(ending);
                        let limit = policy.start_timeout_ms;
                        turn.warn(format!("{role} {what} within {limit} ms and is killed"));
                    } else if is_hung && role == Role::Robot {
                        hung_robot_ms = Some(policy.hang_after_ms);
                        continue;
                    } else if is_hung {
                        alive.ending = Some(EndReason::Hung);
                        let limit = policy.hang_after_ms;
                        turn.warn(format!("{role} made no progress for {limit} ms and is killed"));
                    } else {
                        continue;
                    }
                    alive.start_deadline_ns = None;
                    alive.kill_ns = Some(turn.in_ms(KILL_AGAIN_AFTER_MS));
                    turn.push(Action::Kill { role });
                }
                _ => {}
            }
        }
        if let Some(limit) = hung_robot_ms.filter(|_| self.failure.is_none()) {
            let reason =
                format!("made no progress for {limit} ms; it is not killed, because it may be moving");
            self.end_failed(turn, Role::Robot, reason);
        }
    }

    /// Starts the timeout for the first output of a process that has all its inputs, and stops it for one that has not.
    /// An input that the process had to drop does not count; then the timeout of its writer runs.
    pub(super) fn watch_first_outputs(&mut self, turn: &Turn) {
        if self.phase != Phase::Driving || self.is_ending() {
            return;
        }
        let mut ready = [false; ROLES];
        self.slots.iter().for_each(|slot| ready[slot.policy.role.index()] = slot.is_ready());
        let mut supplies = ready;
        for slot in &mut self.slots {
            // The reader has received one that it could use.
            slot.refused.take_if(|refused| ready[refused.reader.index()]);
            supplies[slot.policy.role.index()] &= slot.refused.is_none();
        }
        for slot in &mut self.slots {
            let deadline_ns = turn.in_ms(slot.policy.start_timeout_ms);
            let is_due = match slot.is_ready() {
                true => slot.refused.is_some(),
                false => feeders(slot.policy.role).all(|feeder| supplies[feeder.index()]),
            };
            if let Life::Alive(alive) = &mut slot.life
                && alive.ending.is_none()
                && alive.reached >= Some(ProcessState::Connected)
            {
                match is_due {
                    true => _ = alive.start_deadline_ns.get_or_insert(deadline_ns),
                    false => alive.start_deadline_ns = None,
                }
            }
        }
    }

    /// In lock-step a sample that was dropped stops the loop: the run ends because of its writer. In real time the
    /// writer is given time for one that can be used.
    pub(super) fn refused(&mut self, turn: &mut Turn, role: Role, incarnation: u32, refused: Refused) {
        let (is_ending, lockstep) = (self.is_ending(), self.lockstep);
        let Some(slot) = self.slot(role) else { return };
        if is_ending || slot.alive(incarnation).is_none() {
            return;
        }
        if lockstep {
            return self.end_failed(turn, role, refused.reason);
        }
        slot.refused = Some(refused);
    }

    /// Time in which the caller was stopped does not count as silence, nor against a limit: the processes may have been
    /// stopped with it.
    pub(super) fn forgive_own_stall(&mut self, now_ns: u64) {
        let gap_ns = self.last_event_ns.map_or(0, |last_ns| now_ns.saturating_sub(last_ns));
        self.last_event_ns = Some(now_ns);
        for slot in &mut self.slots {
            let unwatched_ns = if gap_ns > slot.longest_gap_ns() { gap_ns } else { 0 };
            if let Life::Alive(alive) = &mut slot.life {
                alive.progress_ns = alive.progress_ns.saturating_add(unwatched_ns).min(now_ns);
                for limit_ns in [&mut alive.start_deadline_ns, &mut alive.kill_ns].into_iter().flatten() {
                    *limit_ns = limit_ns.saturating_add(unwatched_ns);
                }
            }
        }
    }

    /// The timeout for the first output of a reader begins anew.
    pub(super) fn forgive_late_inputs(&mut self, reader: Role) {
        if let Some(slot) = self.slot(reader)
            && let Life::Alive(alive) = &mut slot.life
            && alive.reached >= Some(ProcessState::Connected)
            && alive.ending.is_none()
        {
            alive.start_deadline_ns = None;
        }
    }

    pub(super) fn starved(&mut self, now_ns: u64, role: Role, incarnation: u32) {
        let Some(slot) = self.slot(role) else { return };
        let again_ns = nanoseconds(slot.policy.hang_after_ms) / 6;
        if let Some(alive) = slot.alive(incarnation) {
            alive.excused_ns = now_ns.saturating_add(again_ns);
        }
    }
}

/// The roles whose outputs a process needs for its first one. Actuations do not count: they are of the scan before.
pub(super) fn feeders(role: Role) -> impl Iterator<Item = Role> {
    role.reads().iter().filter(|topic| **topic != Topic::Actuation).filter_map(|topic| topic.writer())
}
