//! The part of a session that answers commands.

use report::Outcome;
use runtime::wait_for;
use shared_types::Role;
use supervision::supervisor::Event;

use super::Session;
use crate::control::{Reply, Request};

impl Session {
    /// Answers all requests that have come.
    pub(super) fn serve(&mut self) -> anyhow::Result<()> {
        if !wait_for(&[self.control.descriptor()], 0) {
            return Ok(());
        }
        let stopped = !self.word.is_armed();
        let mut requests = Vec::new();
        let status = Reply::Status(Box::new(self.status()));
        let Self { control, swaps, shadows, fleet, supervisor, lockstep, .. } = self;
        control.serve(|request| match request {
            Request::Status => status.clone(),
            Request::Swap(_) | Request::Shadow(_) | Request::Restart { .. } if stopped => {
                Reply::Refused("the run was stopped".to_owned())
            }
            Request::Swap(request) if shadows.concern(request.successor.role) => Reply::Refused(format!(
                "a process runs in the shadow of {}: end that first",
                request.successor.role
            )),
            Request::Swap(request) => swaps.ask(request, fleet, supervisor),
            Request::Shadow(_) if *lockstep => Reply::Refused(
                "a shadow needs a run in real time: in lock-step all wait for the slowest".to_owned(),
            ),
            Request::Shadow(request) if swaps.concerns(request.successor.role) => Reply::Refused(format!(
                "{} is being exchanged: wait for the certificate",
                request.successor.role
            )),
            Request::Shadow(request) => shadows.ask(&request, fleet, supervisor),
            Request::ShadowResult { number } => shadows.result(number),
            Request::ShadowEnd { number } => shadows.end_early(number),
            Request::SwapResult { number } => swaps.result(number),
            Request::Restart { role } if swaps.concerns(role) => {
                Reply::Refused(format!("{role} is not restarted: it is being exchanged"))
            }
            Request::Restart { role: Role::Robot } => {
                Reply::Refused("the robot is not restarted: its end would end the run".to_owned())
            }
            Request::Restart { role } => {
                swaps.restart(role, shadows, fleet, supervisor).unwrap_or_else(|| {
                    requests.push(Event::RestartRequested { role });
                    Reply::Done
                })
            }
            Request::Stop => {
                requests.push(Event::StopRequested);
                Reply::Done
            }
        });
        for request in requests {
            match request {
                Event::StopRequested => self.decide(Outcome::Interrupted, "stopped by command"),
                event => self.handle(event)?,
            }
        }
        Ok(())
    }
}
