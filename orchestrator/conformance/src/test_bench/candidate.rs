//! The process under test: its start, its states, its replacement and its end.

use console::exit::Failure;
use runtime::monotonic_ns;
use shared_types::{Authority, Checkpoint, Phase, ProcessState, Role};
use supervision::private_system::START_NS;
use supervision::supervisor::ProcessExit;

use super::{TestBench, Tried, failed};
use crate::case::Trouble;

impl TestBench<'_> {
    /// Starts the candidate; `restart` and `checkpoint` are what a successor is told.
    pub(crate) fn spawn(&mut self, restart: bool, checkpoint: Option<&Checkpoint>) -> Tried {
        let role = self.suite.role;
        let fresh = |state: &Checkpoint| Checkpoint { issued_ns: monotonic_ns(), saved_ns: 0, ..*state };
        self.system.hand_over(role, checkpoint.map(fresh))?;
        let child = self.system.launch(role, self.suite.command.clone(), restart, &self.log);
        self.child = Some(child.map_err(Failure::process)?);
        Ok(())
    }

    /// Kills the candidate, gives the next one its incarnation, starts it, and waits until it is connected.
    pub(crate) fn replace(&mut self, restart: bool, checkpoint: Option<&Checkpoint>) -> Tried {
        self.kill();
        let (role, incarnation) = (self.suite.role, self.incarnation() + 1);
        self.direct(|directive| {
            directive.authority[role.index()] = Authority { incarnation, ..Authority::default() };
        })?;
        self.heartbeats.clear();
        self.received.clear();
        self.spawn(restart, checkpoint)?;
        self.wait_for_state(ProcessState::Connected)?;
        // A restarted robot begins with scan 1 again.
        self.scan_id = if role == Role::Robot { 1 } else { self.scan_id };
        self.begin();
        Ok(())
    }

    /// Kills and reaps the candidate and cleans up after it.
    pub(crate) fn kill(&mut self) {
        self.child = None;
        self.system.bus.clean_up_dead_processes();
    }

    /// Starts the candidate and takes it through the start barrier.
    pub(crate) fn start(&mut self) -> Tried {
        self.spawn(false, None)?;
        self.attach()?;
        self.announce(Phase::Connecting)?;
        self.wait_for_state(ProcessState::Connected)?;
        self.announce(Phase::Driving)
    }

    /// Waits until the candidate has attached; if it does not, it can't be started, which ends the suite.
    pub(crate) fn attach(&mut self) -> Tried {
        self.wait_for_state(ProcessState::Attached).map_err(|trouble| match trouble {
            Trouble::Failed(reason) => Failure::process(format!("could not be started: {reason}")).into(),
            other => other,
        })
    }

    /// Waits until the candidate reports this state or a later one.
    pub(crate) fn wait_for_state(&mut self, state: ProcessState) -> Tried {
        if self.until(START_NS, |bench| bench.system.has_reached(bench.suite.role, state))? {
            return Ok(());
        }
        let last = self.heartbeats.last().and_then(|beat| ProcessState::try_from(beat.state).ok());
        let last = last.map_or("nothing".to_owned(), |state| format!("`{state}`"));
        let (limit_s, lines) = (START_NS / 1_000_000_000, self.log.last_lines_suffix());
        failed(format!("did not report `{state}` within {limit_s} s; it reported {last}{lines}"))
    }

    /// Incarnation of the newest candidate.
    pub(crate) fn incarnation(&self) -> u32 {
        self.system.incarnation(self.suite.role)
    }

    /// How the candidate ended, if it has.
    pub(crate) fn exit(&mut self) -> Tried<Option<ProcessExit>> {
        Ok(self.child.as_mut().map(|child| child.try_wait()).transpose()?.flatten())
    }
}
