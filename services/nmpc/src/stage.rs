//! The controller as a stage of the loop: pose and obstacles in, one verified command out.

use ocp::Budget;
use shared_types::{
    AnySample, Blocking, Command, Directive, Obstacles, Pose, Role, Sample, SampleType, ScannerHealth, Stage,
    StageEvent, StopReason, Stopwatch,
};
use vehicle::Invalid;

use crate::rehearsal::rehearse;
use crate::{Controller, ControllerConfig, ControllerState};

/// The stage.
#[derive(Debug, Clone)]
pub struct ControllerStage {
    controller: Controller,
    period_ns: u64,
    /// In simulated time, the budget of a solution.
    iterations: u32,
    /// Else how long it may take [ns].
    budget_ns: u64,
    pose: Option<Pose>,
    obstacles: Option<Obstacles>,
    log: StopLog,
}

impl ControllerStage {
    /// The controller.
    pub fn controller(&self) -> &Controller {
        &self.controller
    }
}

impl Stage for ControllerStage {
    type Settings = ControllerConfig;
    type Invalid = Invalid;
    type Output = Command;
    type State = ControllerState;

    const ROLE: Role = Role::Controller;
    const ANSWERS: &'static [&'static SampleType] = &[Pose::TYPE, Obstacles::TYPE];
    const TAKES_ORDERS: bool = true;

    fn begin(settings: ControllerConfig, period_ns: u64) -> Result<Self, Invalid> {
        let budget_ns = (settings.budget_ms * 1e6).min(settings.budget_share * period_ns as f64) as u64;
        Ok(Self {
            iterations: settings.budget_iterations,
            controller: Controller::new(settings)?,
            period_ns,
            budget_ns,
            pose: None,
            obstacles: None,
            log: StopLog::default(),
        })
    }

    fn resume(&mut self, state: &ControllerState) -> bool {
        self.controller.resume(state);
        true
    }

    fn state(&self) -> Option<ControllerState> {
        Some(self.controller.state())
    }

    fn take(&mut self, sample: AnySample<'_>, _: u64) {
        if let Some(pose) = sample.get() {
            *self.pose.get_or_insert_default() = *pose;
        } else if let Some(obstacles) = sample.get() {
            *self.obstacles.get_or_insert_default() = *obstacles;
        } else if let Some(directive) = sample.get::<Directive>() {
            self.controller.give(&directive.goal);
            self.controller.obey(directive.driven_by, directive.person);
        }
    }

    fn output(&mut self, _: u64, watch: &Stopwatch<'_>) -> Option<Command> {
        let (pose, obstacles) = self.pose.as_ref().zip(self.obstacles.as_ref())?;
        let now_ns = || u64::from(watch.is_over(self.budget_ns));
        let budget = match watch.stands() {
            true => Budget::Iterations(self.iterations),
            false => Budget::Deadline { deadline_ns: 1, now_ns: &now_ns },
        };
        let mut command = self.controller.step(pose, obstacles, &budget);
        command.solve_ns = watch.elapsed_ns();
        Some(command)
    }

    fn follow(&mut self, event: StageEvent) -> bool {
        // Another plans afresh: it takes over only when it agrees with the process in charge.
        let rests = event == StageEvent::StateLost { in_charge: true };
        if rests {
            tracing::warn!("no fresh state to resume from: the robot has to rest first");
            self.controller.start_in_stop();
        }
        rests
    }

    fn published(&mut self, command: &Command) {
        if let Some(obstacles) = &self.obstacles {
            self.log.follow(command, &obstacles.scanner);
        }
    }

    fn rehearse(&mut self, due_ns: u64, now_ns: &dyn Fn() -> u64) {
        let Some((pose, obstacles)) = self.pose.as_ref().zip(self.obstacles.as_ref()) else { return };
        let deadline_ns = due_ns.min(now_ns().saturating_add(self.budget_ns));
        let budget = Budget::Deadline { deadline_ns, now_ns };
        rehearse(&mut self.controller, (pose, obstacles), self.period_ns, &budget);
    }
}

/// Logs when a stop for an obstacle or for the scanner begins and when it ends.
#[derive(Debug, Clone, Default)]
struct StopLog {
    stopped_for: Option<Blocking>,
    scanner_stops: bool,
}

impl StopLog {
    fn follow(&mut self, command: &Command, scanner: &ScannerHealth) {
        let scan_id = command.header.scan_id;
        match (self.stopped_for, command.stopped_for()) {
            (None, Some(blocking)) => tracing::warn!("scan {scan_id}: stopped: blocked by {blocking}"),
            (Some(_), None) => tracing::info!("scan {scan_id}: no longer stopped for an obstacle"),
            _ => {}
        }
        self.stopped_for = command.stopped_for();
        let scanner_stops = command.reason == StopReason::Scanner.wire();
        match (self.scanner_stops, scanner_stops) {
            (false, true) => tracing::warn!("scan {scan_id}: stopped: scanner {scanner}"),
            (true, false) => tracing::info!("scan {scan_id}: no longer stopped for the scanner"),
            _ => {}
        }
        self.scanner_stops = scanner_stops;
    }
}
