//! The process under test: its start, its states, its replacement and its end.

use console::exit::Failure;
use runtime::{HandoverData, monotonic_ns, write_handover};
use shared_types::{Authority, Checkpoint, Phase, ProcessState, Role};
use supervision::child::{Child, Launch};
use supervision::environment::environment_of;
use supervision::supervisor::ProcessExit;

use super::{TestBench, Tried, Trouble, failed};

/// A process that has not reached a state of the start barrier after this time does not reach it [ns].
const START_NS: u64 = 30_000_000_000;

impl TestBench<'_> {
    /// Starts the candidate; `restart` and `checkpoint` are what a successor is told.
    pub(crate) fn spawn(&mut self, restart: bool, checkpoint: Option<&Checkpoint>) -> Tried {
        let role = self.suite.role;
        let handover = checkpoint.map(|checkpoint| {
            let checkpoint = Checkpoint { issued_ns: monotonic_ns(), saved_ns: 0, ..*checkpoint };
            HandoverData { checkpoint, ended_ns: 0, actuations: Vec::new(), moved_ns: 0 }
        });
        write_handover(&self.domain, role, handover.as_ref())?;
        let environment = environment_of(&self.domain, &self.stop_word, role, self.incarnation, restart);
        let launch = Launch { command: self.suite.command.clone(), environment };
        self.child = Some(Child::spawn(&launch, &self.log).map_err(Failure::process)?);
        Ok(())
    }

    /// Kills the candidate, gives the next one its incarnation, starts it, and waits until it is connected.
    pub(crate) fn replace(&mut self, restart: bool, checkpoint: Option<&Checkpoint>) -> Tried {
        self.kill();
        self.incarnation += 1;
        let (role, incarnation) = (self.suite.role, self.incarnation);
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
        self.bus.clean_up_dead_processes();
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
        let reached = |bench: &Self| bench.heartbeats.iter().any(|beat| beat.state >= state.wire());
        if self.until(START_NS, reached)? {
            return Ok(());
        }
        let last = self.heartbeats.last().and_then(|beat| ProcessState::try_from(beat.state).ok());
        let last = last.map_or("nothing".to_owned(), |state| format!("`{state}`"));
        let (limit_s, lines) = (START_NS / 1_000_000_000, self.last_lines());
        failed(format!("did not report `{state}` within {limit_s} s; it reported {last}{lines}"))
    }

    /// How the candidate ended, if it has.
    pub(crate) fn exit(&mut self) -> Tried<Option<ProcessExit>> {
        Ok(self.child.as_mut().map(|child| child.try_wait()).transpose()?.flatten())
    }

    /// The last log lines of the candidate, to be appended to a reason.
    pub(crate) fn last_lines(&self) -> String {
        match self.log.last_lines(3) {
            Ok(lines) if !lines.is_empty() => format!("; its last log lines: {}", lines.join(" | ")),
            _ => String::new(),
        }
    }
}
