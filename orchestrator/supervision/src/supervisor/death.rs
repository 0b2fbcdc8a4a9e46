//! What follows a death, and the orderly end of a run.

use shared_types::{Phase, Role};

use super::slot::{EndReason, Life, Limit, Slot};
use super::turn::Turn;
use super::{Action, ProcessExit, Restart, Severity, Supervisor};

/// A caller that does not ask for the stop of a failed run within this time is not waited for [ms].
const HALT_MS: u64 = 3_000;

impl Supervisor {
    pub(super) fn spawn_failed(&mut self, turn: &mut Turn, role: Role, error: String) {
        let (stopping, lockstep) = (self.is_ending(), self.lockstep);
        let Some(slot) = self.slot(role) else { return };
        if slot.life != Life::Spawning {
            return;
        }
        slot.last_exit = Some(error.clone());
        if stopping {
            slot.life = Life::Stopped;
            return self.continue_stop(turn);
        }
        let limit = slot.count_death(turn.now_ns, None);
        if lockstep || slot.policy.effective_restart() == Restart::Never {
            return self.fail(turn, role, format!("could not be started: {error}"));
        }
        if let Some(limit) = limit {
            let reason = match limit {
                Limit::Start => format!("could not be started {} times, last: {error}", slot.failed_starts),
                Limit::Restart => too_often(slot, &error),
            };
            return self.fail(turn, role, reason);
        }
        // There never was a process, so nothing is left to be cleaned up.
        let pause_ns = slot.policy.backoff_ns(slot.streak, false);
        slot.life = Life::Waiting { due_ns: turn.now_ns.saturating_add(pause_ns) };
        let pause_ms = pause_ns / 1_000_000;
        turn.warn(format!("{role} could not be started: {error}; again in {pause_ms} ms"));
    }

    pub(super) fn exited(&mut self, turn: &mut Turn, role: Role, incarnation: u32, exit: ProcessExit) {
        let (stopping, lockstep) = (self.is_ending(), self.lockstep);
        let Some(slot) = self.slot(role) else { return };
        if !slot.is_live() || slot.incarnation != incarnation {
            return;
        }
        let (ready_ns, ending) = match slot.life {
            Life::Alive(alive) => (alive.ready_ns, alive.ending),
            _ => (None, None),
        };
        slot.last_exit = Some(exit.to_string());
        if stopping {
            slot.life = Life::Stopped;
            turn.info(format!("{role} ended: {exit}"));
            return self.continue_stop(turn);
        }
        if ending == Some(EndReason::Restart) {
            slot.life = Life::CleaningUp { due_ns: turn.now_ns };
            turn.info(format!("{role} ended for its restart: {exit}"));
            return turn.push(Action::CleanUp { role });
        }
        let reason = match ending {
            Some(EndReason::Hung) => format!("made no progress for {} ms", slot.policy.hang_after_ms),
            Some(EndReason::StartTimeout) => {
                format!("did not start within {} ms", slot.policy.start_timeout_ms)
            }
            Some(EndReason::NoOutput) => {
                let device =
                    slot.device.as_ref().map_or_else(String::new, |text| format!("; its devices: {text}"));
                format!("had no output within {} ms{device}", slot.policy.start_timeout_ms)
            }
            Some(EndReason::Refused) => {
                let why = slot.refused.as_ref().map_or("", |refused| refused.reason.as_str());
                format!("had no valid output within {} ms: {why}", slot.policy.start_timeout_ms)
            }
            _ if exit.is_success() => format!("ended by itself with {exit}"),
            _ => exit.to_string(),
        };
        // Outputs that no reader can use do not count.
        let ready_ns = ready_ns.filter(|_| ending != Some(EndReason::Refused));
        let limit = slot.count_death(turn.now_ns, ready_ns);
        let is_final = match slot.policy.effective_restart() {
            Restart::Never => true,
            Restart::OnFailure => ending.is_none() && exit.is_success(),
            Restart::Always => false,
        };
        if lockstep || is_final {
            return self.fail(turn, role, reason);
        }
        if let Some(limit) = limit {
            let reason = match limit {
                Limit::Start => {
                    format!("died {} times before its first output, last: {reason}", slot.failed_starts)
                }
                Limit::Restart => too_often(slot, &reason),
            };
            return self.fail(turn, role, reason);
        }
        let pause_ns = slot.policy.backoff_ns(slot.streak, ready_ns.is_some());
        slot.life = Life::CleaningUp { due_ns: turn.now_ns.saturating_add(pause_ns) };
        turn.warn(format!("{role} died: {reason}; restarted in {} ms", pause_ns / 1_000_000));
        turn.push(Action::CleanUp { role });
    }

    pub(super) fn cleaned_up(&mut self, turn: &mut Turn, role: Role) {
        let Some(index) = self.index(role) else { return };
        let Life::CleaningUp { due_ns } = self.slots[index].life else { return };
        if due_ns <= turn.now_ns {
            self.spawn(turn, index);
        } else {
            self.slots[index].life = Life::Waiting { due_ns };
        }
    }

    pub(super) fn fail(&mut self, turn: &mut Turn, role: Role, reason: String) {
        if let Some(slot) = self.slot(role) {
            slot.life = Life::Failed;
        }
        self.end_failed(turn, role, reason);
    }

    /// Ends the run because of a process that lives or has died.
    pub(super) fn end_failed(&mut self, turn: &mut Turn, role: Role, reason: String) {
        if let Some(slot) = self.slot(role) {
            slot.is_at_fault = true;
        }
        turn.push(Action::Log(Severity::Error, format!("{role} {reason}: the run ends")));
        turn.push(Action::RunFailed { role, reason: reason.clone() });
        self.failure = Some((role, reason));
        let robot_lives = self.slots.iter().any(|slot| slot.policy.role == Role::Robot && slot.is_live());
        if self.phase == Phase::Driving && robot_lives && !self.lockstep {
            self.halting_until_ns = Some(turn.in_ms(HALT_MS));
            self.cancel_starts();
        } else {
            self.stop(turn);
        }
    }

    pub(super) fn stop(&mut self, turn: &mut Turn) {
        if self.phase == Phase::Stopping {
            return;
        }
        self.phase = Phase::Stopping;
        self.halting_until_ns = None;
        turn.push(Action::Announce(Phase::Stopping));
        self.cancel_starts();
        self.continue_stop(turn);
    }

    /// Gives up what was about to be started, and waits for no start any more.
    fn cancel_starts(&mut self) {
        for slot in &mut self.slots {
            match &mut slot.life {
                Life::Alive(alive) => alive.start_deadline_ns = None,
                Life::Spawning | Life::Failed => {}
                Life::Idle | Life::CleaningUp { .. } | Life::Waiting { .. } | Life::Stopped => {
                    slot.life = Life::Stopped;
                }
            }
        }
    }

    /// Ends the processes of the first wave that still has any.
    pub(super) fn continue_stop(&mut self, turn: &mut Turn) {
        if self.phase != Phase::Stopping {
            return;
        }
        let wave =
            self.slots.iter().filter(|slot| slot.is_live()).map(|slot| stop_wave(slot.policy.role)).min();
        let Some(wave) = wave else {
            self.all_stopped = true;
            return turn.push(Action::AllStopped);
        };
        for slot in &mut self.slots {
            let Slot { policy, life: Life::Alive(alive), .. } = slot else { continue };
            if stop_wave(policy.role) != wave || alive.ending == Some(EndReason::Stop) {
                continue;
            }
            // A process that was asked to end or killed before needs no second request.
            if alive.ending.is_none() {
                alive.kill_ns = Some(turn.in_ms(policy.grace_ms));
                turn.push(Action::Terminate { role: policy.role });
            }
            alive.ending = Some(EndReason::Stop);
        }
    }
}

fn too_often(slot: &Slot, last: &str) -> String {
    let window_s = slot.policy.restart_window_ms as f64 * 1e-3;
    format!("died {} times within {window_s} s, last: {last}", slot.deaths.len())
}

/// The actuator ends after the processes that command, and the robot after the actuator.
const fn stop_wave(role: Role) -> u8 {
    match role {
        Role::Controller | Role::Obstacles | Role::Estimator => 0,
        Role::Actuator => 1,
        Role::Robot => 2,
    }
}
