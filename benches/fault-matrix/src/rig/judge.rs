//! What the orchestrator and an observer see of a drive.

use audit::samples::{MAX_DEVIATING, deviates, is_disobedient};
use estimator::EstimatorState;
use pipeline::LoopWatch;
use shared_types::{
    Actuation, AnySample, AnyStage, BlockReason, Command, Obstacles, Odometry, Pose, Role, Scan,
    ScannerState, StopReason, Suspect, Truth,
};

use super::swap::Seen;
use crate::finding::{FindingPlace, Findings};

/// Commands that are kept to compare the actuations with.
const COMMANDS: usize = 8;
/// From an actuation that disobeys its command to the wheels that the robot blocks by the stop word, in scan periods: a
/// turn of the orchestrator, and what the robot takes at most.
const HALT_PERIODS: f64 = 1.2;

/// Notes what is found, and whether the actuator obeys.
#[derive(Debug, Clone)]
pub(super) struct Judge {
    pub(super) findings: Findings,
    pub(super) truth: Truth,
    pub(super) actuation: Option<Actuation>,
    /// What a swap has to know.
    pub(super) seen: Seen,
    pub(super) place: FindingPlace,
    /// Stages look at their timeouts, and use no sample.
    pub(super) is_poll: bool,
    /// When the robot sees the stop word that the orchestrator has overwritten [ns].
    pub(super) halted_ns: Option<u64>,
    period_ns: u64,
    /// What the estimator had refused, and how often it had restarted.
    refused: [u64; 4],
    /// The newest commands that count.
    commands: Vec<Command>,
    /// Scans in a row in which the actuator turned the wheels otherwise than commanded.
    deviating: u32,
}

impl Judge {
    pub(super) fn new(period_ns: u64) -> Self {
        Self {
            findings: Findings::default(),
            truth: Truth::default(),
            actuation: None,
            seen: Seen::default(),
            place: FindingPlace { at_ns: 0, way_m: 0.0 },
            is_poll: false,
            halted_ns: None,
            period_ns,
            refused: [0; 4],
            commands: Vec::with_capacity(COMMANDS),
            deviating: 0,
        }
    }

    fn note(&mut self, role: Role, what: &'static str) {
        self.findings.note(role.name(), what, self.place);
    }

    /// Notes what the estimator has refused since the last call.
    fn note_refused(&mut self, state: &EstimatorState) {
        let refused = [state.rejected, state.restarts, state.skipped, state.invalid];
        let names = ["gate", "restarted", "not_newer", "refused"];
        for ((now, before), name) in refused.into_iter().zip(self.refused).zip(names) {
            if now > before {
                self.note(Role::Estimator, name);
            }
        }
        self.refused = refused;
    }

    /// The check of the orchestrator: an actuator that disobeys a command to block is not trusted any more.
    fn require_obedience(&mut self, actuation: &Actuation) {
        let scan_id = actuation.header.scan_id;
        let commands: Vec<Command> =
            self.commands.iter().filter(|command| command.header.scan_id == scan_id).copied().collect();
        if actuation.answers == 1 {
            self.deviating = if deviates(&commands, actuation) { self.deviating + 1 } else { 0 };
        }
        let is_wrong = is_disobedient(&commands, actuation) || self.deviating > MAX_DEVIATING;
        if self.halted_ns.is_none() && is_wrong {
            self.findings.note("orchestrator", "disobeyed", self.place);
            self.halted_ns = Some(self.place.at_ns + (HALT_PERIODS * self.period_ns as f64) as u64);
        }
    }
}

impl LoopWatch for Judge {
    fn measured(&mut self, _: &Scan, _: &Odometry, truth: &Truth) {
        self.truth = *truth;
        if truth.dead_man == 1 {
            self.note(Role::Robot, "dead_man");
        }
    }

    fn stepped(&mut self, stage: &dyn AnyStage, output: Option<AnySample<'_>>) {
        if stage.shape().role == Role::Estimator
            && let Some(Ok(state)) = stage.checkpoint().map(|checkpoint| checkpoint.state())
        {
            self.note_refused(&state);
        }
        let Some(output) = output else { return };
        if let Some(pose) = output.get::<Pose>()
            && let Ok(suspect) = Suspect::try_from(pose.suspect)
            && suspect != Suspect::None
        {
            self.note(Role::Estimator, suspect.name());
        } else if let Some(obstacles) = output.get::<Obstacles>()
            && obstacles.scanner.state() != ScannerState::Healthy
        {
            self.note(Role::Obstacles, obstacles.scanner.state().name());
        } else if let Some(command) = output.get::<Command>()
            && let Ok(reason) = StopReason::try_from(command.reason)
            && reason != StopReason::None
        {
            self.note(Role::Controller, reason.name());
        } else if let Some(actuation) = output.get::<Actuation>() {
            if self.is_poll
                && let Ok(reason) = BlockReason::try_from(actuation.reason)
            {
                self.note(Role::Actuator, reason.name());
            }
            self.seen.record(actuation);
            self.actuation = Some(*actuation);
        }
    }

    fn arrived(&mut self, sample: AnySample<'_>) {
        if let Some(command) = sample.get::<Command>() {
            self.seen.commands.push((self.place.at_ns, *command));
            if self.seen.authority.accepts(command.header.incarnation, command.header.scan_id) {
                if self.commands.len() == COMMANDS {
                    self.commands.remove(0);
                }
                self.commands.push(*command);
            }
        } else if let Some(actuation) = sample.get() {
            self.require_obedience(actuation);
        }
    }

    fn found(&mut self, role: Role, incarnation: u32, what: &'static str) {
        if role != Role::Controller || incarnation == self.seen.in_charge {
            self.note(role, what);
        }
    }
}
