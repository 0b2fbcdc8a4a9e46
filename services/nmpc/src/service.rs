//! The process of the role `controller`: pose and obstacles in, one verified command out.

use ocp::Budget;
use std::cell::Cell;

use runtime::{Handover, Process, join, monotonic_ns};
use shared_types::{Blocking, Command, JournalKind, Obstacles, Pose, Role, ScannerHealth, StopReason};

use crate::config::ControllerConfig;
use crate::controller::Controller;
use crate::rehearsal::Rehearsal;

/// Runs until asked to end.
///
/// # Errors
/// Settings that are not allowed, and errors of the bus.
pub fn run() -> anyhow::Result<()> {
    let mut process = Process::attach(Role::Controller)?;
    let config = process.settings::<ControllerConfig>("controller")?;
    let mut controller = Controller::new(config.clone())?;
    let poses = process.input::<Pose>()?;
    let obstacles = process.input::<Obstacles>()?;
    let commands = process.output::<Command>()?;
    let handover = process.resume()?;
    if !process.start()? {
        return Ok(());
    }
    match handover {
        Handover::State(state) => controller.resume(&state),
        Handover::FirstStart => {}
        Handover::Lost if process.is_in_charge() => {
            tracing::warn!("no fresh state to resume from: the robot has to rest first");
            process.note(JournalKind::BegunInStop, 0);
            controller.start_in_stop();
        }
        // A candidate plans afresh: it takes over only when it agrees with the process in charge.
        Handover::Lost => {}
    }
    if let Some((scan_id, state)) = process.join()? {
        controller.resume(&state);
        poses.skip_to(scan_id);
    }
    let mut stop = StopLog::default();
    let budget_ns = (config.budget_ms * 1e6).min(config.budget_share * process.period_ns() as f64) as u64;
    let mut rehearsal = Rehearsal::new(process.period_ns());
    while process.wait_joined_preparing(&mut |due_ns| {
        let deadline_ns = due_ns.min(monotonic_ns() + budget_ns);
        rehearsal.run(&mut controller, &Budget::Deadline { deadline_ns, now_ns: &monotonic_ns });
    })? {
        while let Some((pose, obstacles)) = join(&poses, &obstacles) {
            let simulated = process.clock().is_simulated();
            let started_ns = monotonic_ns();
            let (deadline_ns, readings, is_over) = (started_ns + budget_ns, Cell::new(0), Cell::new(false));
            let now_ns = || {
                let now_ns = monotonic_ns();
                if now_ns >= deadline_ns && !is_over.replace(true) {
                    process.note(JournalKind::Budget, readings.get());
                }
                readings.set(readings.get() + 1);
                now_ns
            };
            let budget = if simulated {
                Budget::Iterations(config.budget_iterations)
            } else {
                Budget::Deadline { deadline_ns, now_ns: &now_ns }
            };
            let mut command = controller.step(&pose, &obstacles, &budget);
            command.solve_ns = if simulated { 0 } else { monotonic_ns() - started_ns };
            commands.publish(&mut command)?;
            stop.follow(&command, &obstacles.scanner);
            process.save(&command.header, &controller.state())?;
            rehearsal.keep(&pose, &obstacles);
        }
    }
    Ok(())
}

/// Logs when a stop for an obstacle or for the scanner begins and when it ends.
#[derive(Debug, Default)]
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
