//! What the supervisor decides, carried out on processes and bus.

use report::Outcome;
use runtime::monotonic_ns;
use shared_types::{Authority, Phase, ProcessState, Role};
use supervision::supervisor::{Action, Event, Severity};

use super::{GRANT_AHEAD, Session};

impl Session {
    /// Tells the supervisor what has happened, and does what it decides.
    pub(super) fn handle(&mut self, event: Event) -> anyhow::Result<()> {
        let mut events = vec![event];
        while let Some(event) = events.pop() {
            for action in self.supervisor.handle(monotonic_ns(), event) {
                if let Some(answer) = self.carry_out(action)? {
                    events.insert(0, answer);
                }
            }
        }
        Ok(())
    }

    /// Carries out an action of the supervisor; returns the event that answers it.
    fn carry_out(&mut self, action: Action) -> anyhow::Result<Option<Event>> {
        match action {
            Action::Grant { role, incarnation } => {
                let authority = &mut self.directives.current.authority[role.index()];
                *authority = Authority { incarnation, ..Authority::default() };
                self.directives.forget_person();
                self.directives.changed = true;
                self.publish_directive()?;
            }
            Action::Spawn { role, .. } if !self.run.stop_word.is_armed() => {
                self.heed_stop();
                if self.supervisor.phase() != Phase::Driving {
                    self.handle(Event::StopRequested)?;
                }
                return Ok(Some(Event::SpawnFailed { role, error: "the run was stopped".to_owned() }));
            }
            Action::Spawn { role, incarnation } => {
                self.recording.recorder.outage_ended(role);
                let answer = self.fleet.spawn(role, incarnation, self.left_behind(role).as_ref());
                self.update_registry();
                return Ok(Some(answer));
            }
            Action::Terminate { role } => self.fleet.signal(role, false),
            Action::Kill { role: Role::Robot } if !self.robot_rests() => return Ok(self.leave_robot()),
            Action::Kill { role } => self.fleet.signal(role, true),
            Action::CleanUp { role } => {
                self.bus.clean_up_dead_processes();
                return Ok(Some(Event::CleanedUp { role }));
            }
            Action::Announce(phase) => {
                if phase == Phase::Connecting {
                    self.await_companions(ProcessState::Attached)?;
                    self.samples.connect();
                }
                if phase == Phase::Driving {
                    self.await_companions(ProcessState::Connected)?;
                    if self.recorder.as_mut().is_some_and(|recorder| !recorder.connect()) {
                        self.progress
                            .warn("the recorder did not connect in time: the first samples may be missing");
                    }
                    self.find_judge()?;
                    self.audit.samples.driving();
                    self.directives.grant(GRANT_AHEAD.min(self.companions.granted_scan(GRANT_AHEAD)));
                    self.audit.moved(monotonic_ns());
                }
                self.directives.enter(phase);
                self.publish_directive()?;
            }
            Action::RunFailed { role, reason } => {
                let reason = format!("{role} ({}): {reason}", self.fleet.label(role));
                if self.supervisor.phase() == Phase::Driving {
                    self.decide(Outcome::Failed, &reason);
                } else if self.conclusion.fail(reason) {
                    self.end_counting();
                    self.directives.stop();
                }
                self.publish_directive()?;
            }
            Action::AllStopped => {}
            Action::Log(Severity::Info, text) => {
                tracing::debug!("{text}");
                self.keep(false, &text);
            }
            Action::Log(Severity::Warn | Severity::Error, text) => {
                // A run that was stopped meanwhile ends because of that, not because its processes obey.
                self.heed_stop();
                match self.conclusion.is_open() {
                    true => self.warn(&text),
                    false => self.recorder.iter_mut().for_each(|recorder| recorder.note(&text)),
                }
            }
        }
        Ok(None)
    }
}
