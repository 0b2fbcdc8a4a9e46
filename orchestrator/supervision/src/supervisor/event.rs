//! The events that the supervisor handles, and the actions that it asks for.

use shared_types::{Phase, ProcessState, Role};

use super::ProcessExit;

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// The run is to begin.
    Start,
    /// A process of an orchestrator that died; sent for each of them before [`Event::Resume`].
    Adopted {
        /// Its role.
        role: Role,
        /// Its process id; `None` when it has ended meanwhile.
        pid: Option<u32>,
        /// Its incarnation.
        incarnation: u32,
        /// How often the role was started again before.
        restarts: u32,
    },
    /// In place of [`Event::Start`]: the run of an orchestrator that died continues.
    Resume {
        /// The phase that the processes received last.
        phase: Phase,
        /// The largest number given to a process.
        last_incarnation: u32,
    },
    /// The process asked for by [`Action::Spawn`] exists.
    Spawned {
        /// Its role.
        role: Role,
        /// Its process id.
        pid: u32,
        /// Its incarnation, as asked for.
        incarnation: u32,
    },
    /// The process asked for by [`Action::Spawn`] could not be started.
    SpawnFailed {
        /// Its role.
        role: Role,
        /// Why, with the command named.
        error: String,
    },
    /// A process reported its state.
    StateReported {
        /// Its role.
        role: Role,
        /// Its incarnation.
        incarnation: u32,
        /// The state.
        state: ProcessState,
    },
    /// The devices behind a process do something else than before.
    DeviceReported {
        /// Its role.
        role: Role,
        /// Its incarnation.
        incarnation: u32,
        /// What they do, and why.
        text: String,
    },
    /// A process completed a cycle of its loop since the last such event.
    Progress {
        /// Its role.
        role: Role,
        /// Its incarnation.
        incarnation: u32,
    },
    /// A reader dropped samples of a process because of their content.
    Refused {
        /// Role of the process that wrote them.
        role: Role,
        /// Its incarnation.
        incarnation: u32,
        /// Role of the reader.
        reader: Role,
        /// Which sample it was, and what is wrong with it.
        reason: String,
    },
    /// A reader dropped samples because of their age: it has no inputs for its first output.
    InputsLate {
        /// Role of the reader.
        reader: Role,
    },
    /// A process of [`super::Supervisor::suspects`] has work to do and does not get a processor.
    Starved {
        /// Its role.
        role: Role,
        /// Its incarnation.
        incarnation: u32,
    },
    /// A process ended and was reaped.
    Exited {
        /// Its role.
        role: Role,
        /// Its incarnation.
        incarnation: u32,
        /// How it ended.
        exit: ProcessExit,
    },
    /// Time has passed. Send it after all other events at hand, several times within a hang limit.
    Tick,
    /// The run is to end. Repeats change nothing.
    StopRequested,
    /// One process is to be ended and started again.
    RestartRequested {
        /// Its role.
        role: Role,
    },
    /// Another process fills a role from now on; it is ready and in charge. The one before does not matter any more.
    Replaced {
        /// The role.
        role: Role,
        /// Its process id.
        pid: u32,
        /// Its incarnation, from `Supervisor::next_incarnation`.
        incarnation: u32,
        /// Whether it runs the same program as the one before, which counts as a restart.
        is_restart: bool,
    },
    /// The remains asked for by [`Action::CleanUp`] are gone from the bus.
    CleanedUp {
        /// Role of the dead process.
        role: Role,
    },
}

/// Something to be done, in the order given.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Action {
    /// Accept the samples of this incarnation, and of no other of the role.
    Grant {
        /// The role.
        role: Role,
        /// The incarnation that counts from now on.
        incarnation: u32,
    },
    /// Start the process of a role; answer with [`Event::Spawned`] or [`Event::SpawnFailed`].
    Spawn {
        /// The role.
        role: Role,
        /// The incarnation it is to be given.
        incarnation: u32,
    },
    /// Ask the process group of a role to end (SIGTERM).
    Terminate {
        /// The role.
        role: Role,
    },
    /// Kill the process group of a role (SIGKILL). May come again for a process that does not go.
    Kill {
        /// The role.
        role: Role,
    },
    /// Remove what a dead process left on the bus; answer with [`Event::CleanedUp`].
    CleanUp {
        /// The role.
        role: Role,
    },
    /// Publish the new phase to all processes.
    Announce(Phase),
    /// The run cannot continue; no process is started any more. Comes at most once. While the loop drives, bring the robot to
    /// rest and then ask for the stop with [`Event::StopRequested`]; else all processes are being stopped already.
    RunFailed {
        /// The role whose process is the cause.
        role: Role,
        /// Why.
        reason: String,
    },
    /// No process lives any more. Comes once, as the last action.
    AllStopped,
    /// Something worth a line in the log.
    Log(Severity, String),
}

/// How much a line of the log matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Severity {
    /// All is as planned.
    Info,
    /// Degraded, but the run continues.
    Warn,
    /// The run ends.
    Error,
}
