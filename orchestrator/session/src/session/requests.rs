//! The requests of commands over the control socket, and the answers of a session.

use console::exit::{Exit, exit_of};
use console::limits::text_of;
use handover::swap::{KeyChange, Meant};
use plan::change;
use report::Outcome;
use runtime::{Domain, monotonic_ns, settings_file, wait_for};
use shared_types::Role;
use supervision::supervisor::Event;

use super::Session;
use super::candidates::Live;
use super::goals::GoalParts;
use super::injection::inject;
use super::person::PersonParts;
use super::swaps::Changed;
use crate::companion_swaps::CompanionSwaps;
use crate::control::{Reply, Request, SwapRequest};
use crate::run_recorder::RunRecorder;

impl Session {
    /// Answers all requests that have come.
    pub(super) fn serve(&mut self) -> anyhow::Result<()> {
        if !wait_for(&[self.control.descriptor()], 0) {
            return Ok(());
        }
        let now_ns = monotonic_ns();
        let stopped = !self.run.stop_word.is_armed();
        let (mut restarts, mut injected, mut is_stop) = (Vec::new(), Vec::new(), false);
        let (mut notes, drives) = (Vec::new(), self.drives());
        let status = Reply::Status(Box::new(self.status()));
        let Self { control, swaps, shadows, companions, fleet, supervisor, run, .. } = self;
        let Self { recording, samples, directives, person, recorder, .. } = self;
        let live = |role| Live::of(role, fleet, supervisor, &run.hosts);
        control.serve(|request| match request {
            Request::Status => status.clone(),
            Request::Swap(_)
            | Request::Shadow(_)
            | Request::Restart { .. }
            | Request::Inject { .. }
            | Request::ReplaceCompanion { .. }
            | Request::Goal { .. }
            | Request::Pause
            | Request::Resume
            | Request::Teleop
            | Request::Hold { .. }
            | Request::Control { .. }
                if stopped =>
            {
                Reply::Refused("the run was stopped".to_owned())
            }
            Request::Swap(request) => {
                let role = request.successor.role;
                match shadows.concern(role) {
                    true => Reply::Refused(format!("a process runs in the shadow of {role}: end that first")),
                    false => match changed_settings(&run.domain, &request) {
                        Ok(settings) => {
                            live(role).and_then(|live| swaps.ask(now_ns, &request, settings, &live)).into()
                        }
                        Err(error) => Reply::without(&error),
                    },
                }
            }
            Request::Shadow(_) if run.lockstep => Reply::Refused(
                "a shadow needs a run in real time: in lock-step all wait for the slowest".to_owned(),
            ),
            Request::Shadow(request) => {
                let role = request.successor.role;
                match swaps.concern(role) {
                    true => Reply::Refused(format!("{role} is being swapped: wait for the certificate")),
                    false => live(role).and_then(|live| shadows.ask(&request, &live)).into(),
                }
            }
            Request::ShadowResult { number } => shadows.result(number),
            Request::ShadowEnd { number } => shadows.end_early(number),
            Request::ReplaceCompanion { name, command, shadow_scans } => {
                let replaced = companions.replace(&run.domain, &name, command.as_deref(), shadow_scans);
                let accepted = |number: Option<u64>| number.map_or(Reply::Done, Reply::Accepted);
                replaced.map_or_else(Reply::Refused, accepted)
            }
            Request::SwapResult { number } if CompanionSwaps::is_of_companion(number) => {
                companions.swaps().result(number)
            }
            Request::Goal { .. } if !drives => {
                Reply::Refused("a goal is set while the system drives: it does not".to_owned())
            }
            Request::Goal { .. } if swaps.concern(Role::Controller) => {
                Reply::Refused("controller is being swapped: wait for the certificate".to_owned())
            }
            Request::Goal { set } => match (GoalParts { run, recording, samples, directives }).change(&set) {
                Ok((from_scan, text)) => {
                    notes.push(text);
                    Reply::Accepted(from_scan)
                }
                Err(error) => Reply::without(&error),
            },
            Request::Pause
            | Request::Resume
            | Request::Teleop
            | Request::Hold { .. }
            | Request::Control { .. }
                if !drives =>
            {
                Reply::Refused("a person takes over while the system drives: it does not".to_owned())
            }
            Request::Pause
            | Request::Resume
            | Request::Teleop
            | Request::Hold { .. }
            | Request::Control { .. } => {
                let mut parts = PersonParts { run, recording, samples, directives, person };
                match parts.answer(&request) {
                    Ok((reply, text)) => {
                        notes.extend(text.map(str::to_owned));
                        reply
                    }
                    Err(reason) => Reply::Refused(reason),
                }
            }
            Request::Inject { .. } if run.lockstep => Reply::Refused(
                "faults are injected into runs in real time; `scanloop faults` has them in simulated time"
                    .to_owned(),
            ),
            Request::Inject { fault, for_s } => {
                match inject(&run.domain, run.period_ns, &fault, for_s, live) {
                    Ok((reply, text)) => {
                        injected.push(text);
                        reply
                    }
                    Err(reason) => Reply::Refused(reason),
                }
            }
            Request::Keep => match recorder.as_mut().is_some_and(RunRecorder::keep) {
                true => Reply::Done,
                false => Reply::Refused("nothing of this drive is kept in memory".to_owned()),
            },
            Request::SwapResult { number } => swaps.result(number),
            Request::Restart { role } if swaps.concern(role) => {
                Reply::Refused(format!("{role} is not restarted: it is being swapped"))
            }
            Request::Restart { role: Role::Robot } => {
                Reply::Refused("the robot is not restarted: its end would end the run".to_owned())
            }
            Request::Restart { role } => match live(role) {
                // Where no process works, or one in its shadow is compared with it, the supervisor restarts it.
                Ok(live) if live.is_ready && !shadows.concern(role) => swaps.restart(now_ns, &live).into(),
                _ => {
                    restarts.push(role);
                    Reply::Done
                }
            },
            Request::Stop => {
                is_stop = true;
                Reply::Done
            }
        });
        if is_stop {
            // As final as a stop from outside: no process drives on that this loop does not reach.
            self.run.stop_word.latch();
            self.decide(Outcome::Interrupted, "stopped by command");
        }
        for text in injected {
            self.warn(&text);
        }
        notes.iter().for_each(|text| self.note(text));
        restarts.into_iter().try_for_each(|role| self.handle(Event::RestartRequested { role }))
    }
}

/// Other settings for a successor than those of the running process; `None` when none change.
///
/// # Errors
/// A key or value that is not allowed, or a file that can't be read.
fn changed_settings(domain: &Domain, request: &SwapRequest) -> anyhow::Result<Option<Changed>> {
    if request.set.is_empty() {
        return Ok(None);
    }
    let role = request.successor.role;
    let text = domain.folder().read_text(&settings_file(role))?;
    let settings = change::settings(role, &text, &request.set)?;
    let amounts = change::amounts(role, [&text, &settings], &request.set)?;
    let changes: Vec<KeyChange> = amounts.into_iter().map(|(key, by)| KeyChange { key, by }).collect();
    Ok(Some(Changed { settings, meant: Meant::of(&changes) }))
}

impl Reply {
    /// The answer to a request that an error ended.
    fn without(error: &anyhow::Error) -> Self {
        match exit_of(error) {
            Exit::BadInput => Self::Refused(text_of(error)),
            _ => Self::Failed(text_of(error)),
        }
    }
}

impl From<Result<u64, String>> for Reply {
    fn from(accepted: Result<u64, String>) -> Self {
        accepted.map_or_else(Self::Refused, Self::Accepted)
    }
}
