//! What happens in a running system, found in the differences between its samples and states.

use serde::Serialize;
use session::control::{ProcessStatus, SystemStatus};
use shared_types::{
    Actuation, ActuationKind, BlockReason, Command, Directive, Obstacles, Phase, Role, ScannerState,
    StopReason,
};
use supervision::supervisor::VisibleState;

/// How an event is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Kind {
    /// For information.
    Info,
    /// A good end.
    Good,
    /// Something is not as it should be, and the loop copes with it.
    Warning,
    /// The wheels are blocked, or a process has failed.
    Bad,
}

/// One line of the list of events.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Event {
    /// From 1.
    pub(crate) number: u64,
    /// Time since the server started [s].
    pub(crate) time_s: f64,
    pub(crate) kind: Kind,
    pub(crate) text: String,
    /// The scan that was answered by it; for `why`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) scan_id: Option<u64>,
}

/// Finds events; remembers what it has seen last.
#[derive(Debug, Default)]
pub(crate) struct Events {
    number: u64,
    now_s: f64,
    found: Vec<Event>,
    phase: Option<u32>,
    in_charge: Vec<u32>,
    wheels: Option<(u32, u32)>,
    scanner: Option<u32>,
    processes: Vec<ProcessStatus>,
    state: String,
    /// There is no status, which would tell restarts.
    is_recording: bool,
}

impl Events {
    /// Finds all in samples.
    pub(crate) fn of_recording() -> Self {
        Self { is_recording: true, ..Self::default() }
    }

    /// What was found since the last call.
    pub(crate) fn take(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.found)
    }

    /// [`Events::take`] in the order of time, for events that were not found in it.
    pub(crate) fn take_sorted(&mut self) -> Vec<Event> {
        let mut found = self.take();
        found.sort_by(|one, other| one.time_s.total_cmp(&other.time_s));
        found.iter_mut().zip(1..).for_each(|(event, number)| event.number = number);
        found
    }

    /// A recorded line: all of the orchestrator, which tells deaths, restarts and injected faults, and warnings of others.
    pub(crate) fn log(&mut self, time_s: f64, name: &str, line: &str, is_warning: bool) {
        let is_of_all = name == "orchestrator";
        if !is_of_all && !is_warning {
            return;
        }
        self.set_time(time_s);
        let text = match is_of_all {
            true => line.trim_start_matches("WARN ").to_owned(),
            false => format!("{name}: {line}"),
        };
        self.note(if is_warning { Kind::Warning } else { Kind::Info }, text);
    }

    /// The time of what is found from here on [s].
    pub(crate) fn set_time(&mut self, now_s: f64) {
        self.now_s = now_s;
    }

    /// Forgets the run before.
    pub(crate) fn start(&mut self, system_id: &str) {
        let found = self.take();
        *self = Self { number: self.number, now_s: self.now_s, found, ..Self::default() };
        self.note(Kind::Info, format!("system {system_id} found"));
    }

    /// The system is gone.
    pub(crate) fn end(&mut self) {
        self.note(Kind::Info, "the run has ended".to_owned());
    }

    fn note(&mut self, kind: Kind, text: String) {
        self.number += 1;
        let (number, time_s) = (self.number, self.now_s);
        self.found.push(Event { number, time_s, kind, text, scan_id: None });
    }

    /// Phases of the run, and processes that take over.
    pub(crate) fn directive(&mut self, directive: &Directive) {
        if self.phase.replace(directive.phase) != Some(directive.phase)
            && let Ok(phase @ (Phase::Driving | Phase::Stopping)) = Phase::try_from(directive.phase)
        {
            self.note(Kind::Info, phase.name().to_owned());
        }
        let in_charge: Vec<u32> = directive.authority.iter().map(|authority| authority.incarnation).collect();
        let before = std::mem::replace(&mut self.in_charge, in_charge.clone());
        for (role, (old, new)) in Role::ALL.iter().zip(before.into_iter().zip(in_charge)) {
            let from = directive.authority[role.index()].from_scan;
            if old == new || old == 0 || new == 0 {
                continue;
            }
            // A restart has no scan from which it counts, and its own event comes from the status.
            if from != 0 {
                self.note(Kind::Info, format!("{role}: incarnation {new} in charge from scan {from}"));
            } else if self.is_recording {
                self.note(Kind::Warning, format!("{role} restarted as incarnation {new}"));
            }
        }
    }

    /// Wheels that are blocked or released.
    pub(crate) fn actuation(&mut self, actuation: &Actuation, command: &Command) {
        let known = self.found.len();
        self.wheels(actuation, command);
        // What comes from silence answers no scan.
        let scan_id = (actuation.answers == 1).then_some(actuation.header.scan_id);
        self.found[known..].iter_mut().for_each(|event| event.scan_id = scan_id);
    }

    fn wheels(&mut self, actuation: &Actuation, command: &Command) {
        let wheels = (actuation.kind, actuation.reason);
        let before = self.wheels.replace(wheels);
        if before == Some(wheels) {
            return;
        }
        if actuation.kind == ActuationKind::Drive.wire() {
            // Of a system that drives already when it is found, it is not known since when.
            if before.is_some() {
                self.note(Kind::Info, "wheels released".to_owned());
            }
            return;
        }
        match BlockReason::try_from(actuation.reason) {
            Ok(BlockReason::Landed) => self.note(Kind::Good, "landed: wheels blocked at the goal".to_owned()),
            Ok(BlockReason::Start) | Err(_) => {}
            Ok(reason @ (BlockReason::Paused | BlockReason::Released | BlockReason::EmergencyStop)) => {
                self.note(Kind::Info, format!("wheels blocked: {}", words(reason.name())))
            }
            Ok(BlockReason::StopRequested) => {
                self.note(Kind::Info, "wheels blocked: stop requested".to_owned())
            }
            Ok(BlockReason::Commanded) => {
                let reason = StopReason::try_from(actuation.stop_reason).map_or("unknown", StopReason::name);
                let blocking = command.stopped_for().map(|blocking| format!(" by {blocking}"));
                let text = format!("wheels blocked: {}{}", words(reason), blocking.unwrap_or_default());
                self.note(Kind::Bad, text);
            }
            Ok(reason) => self.note(Kind::Bad, format!("wheels blocked: {}", words(reason.name()))),
        }
    }

    /// The state of the scanner.
    pub(crate) fn obstacles(&mut self, obstacles: &Obstacles) {
        let scanner = obstacles.scanner.state;
        let before = self.scanner.replace(scanner);
        if before == Some(scanner) || before.is_none() && scanner == ScannerState::Healthy.wire() {
            return;
        }
        let Ok(state) = ScannerState::try_from(scanner) else { return };
        let kind = match state {
            ScannerState::Healthy => Kind::Good,
            ScannerState::Degraded => Kind::Warning,
            _ => Kind::Bad,
        };
        self.note(kind, format!("scanner {}", state.name()));
    }

    /// Processes that end, restart or run as candidates, and a system that loses its orchestrator.
    pub(crate) fn status(&mut self, status: &SystemStatus) {
        if status.state == session::orphaned::ORPHANED && self.state != status.state {
            self.note(Kind::Bad, "the orchestrator is gone: the processes are orphaned".to_owned());
        } else if self.state == session::orphaned::ORPHANED && self.state != status.state {
            self.note(Kind::Good, "another orchestrator has adopted the processes".to_owned());
        }
        self.state.clone_from(&status.state);
        let before = std::mem::replace(&mut self.processes, status.processes.clone());
        if before.is_empty() {
            return;
        }
        for process in &status.processes {
            let same = before.iter().find(|old| old.role == process.role && old.pid == process.pid);
            let role = process.role;
            match (same, process.state) {
                (Some(old), state) if old.state == state => {}
                (_, VisibleState::Hung) => self.note(Kind::Bad, format!("{role} hangs")),
                (_, VisibleState::Backoff) => {
                    self.note(Kind::Bad, format!("{role} has died; it is restarted"))
                }
                (_, VisibleState::Failed) => self.note(Kind::Bad, format!("{role} has failed")),
                (_, VisibleState::Standby) => {
                    self.note(Kind::Info, format!("{role}: the old process is standby"))
                }
                (None, VisibleState::Shadow) => {
                    let text = format!("{role}: candidate {} runs in shadow", process.implementation);
                    self.note(Kind::Info, text);
                }
                (None, _) if process.pid != 0 && is_restarted(&before, process) => {
                    self.note(Kind::Warning, format!("{role} restarted as process {}", process.pid));
                }
                _ => {}
            }
        }
    }
}

fn is_restarted(before: &[ProcessStatus], process: &ProcessStatus) -> bool {
    before.iter().any(|old| old.role == process.role && old.restarts < process.restarts)
}

/// A name of a file format as words.
fn words(name: &str) -> String {
    name.replace('_', " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(events: &mut Events) -> Vec<String> {
        events.take().into_iter().map(|event| event.text).collect()
    }

    fn actuation(kind: ActuationKind, reason: BlockReason) -> Actuation {
        Actuation { kind: kind.wire(), reason: reason.wire(), ..Actuation::default() }
    }

    #[test]
    fn blocked_wheels_are_an_event_once() {
        let mut events = Events::default();
        let command = Command::default();
        let mut blocked = actuation(ActuationKind::Block, BlockReason::NoCommand);
        (blocked.header.scan_id, blocked.answers) = (57, 1);
        (0..3).for_each(|_| events.actuation(&blocked, &command));
        events.actuation(&actuation(ActuationKind::Drive, BlockReason::None), &command);
        events.actuation(&actuation(ActuationKind::Block, BlockReason::Landed), &command);
        let expected =
            ["wheels blocked: no command", "wheels released", "landed: wheels blocked at the goal"];
        assert_eq!(
            events.found.iter().map(|event| event.scan_id).collect::<Vec<_>>(),
            [Some(57), None, None]
        );
        assert_eq!(texts(&mut events), expected);
    }

    #[test]
    fn a_restart_and_a_candidate_are_events() {
        let process = |pid: i32, state: VisibleState, restarts: u32| {
            let row = serde_json::json!({
                "role": "controller", "implementation": "nmpc", "pid": pid, "state": state, "restarts": restarts,
                "rate_hz": 0.0, "last_sample_age_ms": 0.0, "cpu_percent": 0.0, "memory_kib": 0, "last_words": [],
            });
            serde_json::from_value::<ProcessStatus>(row).unwrap()
        };
        let status = |processes: Vec<ProcessStatus>| SystemStatus { processes, ..SystemStatus::default() };
        let mut events = Events::default();
        events.status(&status(vec![process(5, VisibleState::Ready, 0)]));
        events.status(&status(vec![process(0, VisibleState::Backoff, 0)]));
        events.status(&status(vec![process(6, VisibleState::Starting, 1)]));
        events.status(&status(vec![process(6, VisibleState::Ready, 1), process(7, VisibleState::Shadow, 0)]));
        let expected = [
            "controller has died; it is restarted",
            "controller restarted as process 6",
            "controller: candidate nmpc runs in shadow",
        ];
        assert_eq!(texts(&mut events), expected);
    }

    #[test]
    fn a_scanner_is_an_event_when_its_state_changes() {
        let mut events = Events::default();
        let mut obstacles = Obstacles::default();
        for state in [ScannerState::Healthy, ScannerState::Blind, ScannerState::Blind, ScannerState::Healthy]
        {
            obstacles.scanner.state = state.wire();
            events.obstacles(&obstacles);
        }
        assert_eq!(texts(&mut events), ["scanner blind", "scanner healthy"]);
    }
}
