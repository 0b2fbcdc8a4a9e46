//! The state of a session for the terminal, the service manager and `scanloop status`.

use std::time::Instant;

use console::progress::{COLUMNS, ProcessLabel, line};
use runtime::Wheels;
use shared_types::{BlockReason, DrivenBy, Phase, Role, StopReason};
use supervision::supervisor::VisibleState;

use super::Session;
use crate::control::{ProcessStatus, SystemStatus};

/// A person who gets less is told [m/s].
const SLOWER_MPS: f64 = 0.01;

impl Session {
    pub(super) fn show(&mut self) {
        let processes = self.supervisor.processes();
        let labels: Vec<_> =
            processes.map(|view| ProcessLabel { role: view.role, state: view.state.name() }).collect();
        let view = self.recording.recorder.view();
        self.progress.update(Instant::now(), &view, &labels);
        match self.supervisor.phase() {
            Phase::Driving => self.manager.ready(),
            Phase::Stopping => self.manager.stopping(),
            Phase::Starting | Phase::Connecting => {}
        }
        self.manager.turn(|| line(&view, &labels, COLUMNS));
    }

    pub(super) fn status(&mut self) -> SystemStatus {
        let views: Vec<_> = self.supervisor.processes().collect();
        let processes = views.into_iter().map(|view| {
            let load = self.fleet.load(view.role);
            ProcessStatus {
                implementation: self.fleet.label(view.role),
                host: self.fleet.entry(view.role).and_then(|entry| entry.host.clone()),
                pid: view.pid.map_or(0, u32::cast_signed),
                restarts: view.restarts,
                cpu_percent: load.cpu_percent,
                memory_kib: load.memory_kib,
                last_words: self.fleet.last_log_lines(view.role).to_vec(),
                ..self.vitals.row(view.role, view.state, view.incarnation)
            }
        });
        let mut processes: Vec<_> = processes.collect();
        processes.sort_by_key(|process| process.role.index());
        if let Some((role, incarnation, state)) = self.swaps.shown() {
            self.show_candidate(&mut processes, role, incarnation, state);
        }
        for (role, incarnation) in self.shadows.incarnations().collect::<Vec<_>>() {
            self.show_candidate(&mut processes, role, incarnation, VisibleState::Shadow);
        }
        SystemStatus {
            system_id: self.run.domain.system_id().to_owned(),
            state: Phase::try_from(self.directives.current.phase).map_or("starting", Phase::name).to_owned(),
            scenario: self.run.scenario.clone(),
            scan: self.samples.newest_scan(),
            judged_by: self.judged_by,
            lockstep: self.run.lockstep,
            wheels: Some(self.wheels()),
            driven_by: Some(self.driven_by().name().to_owned()),
            blocking: self.recording.recorder.stopped_for().map(Into::into),
            hindered: self.hindered(),
            scanner: self.recording.recorder.scanner().map(Into::into),
            processes,
            companions: self.companions.views().into_iter().map(Into::into).collect(),
            refused: self.audit.samples.refused().to_vec(),
            hosts: self.link.as_ref().map_or_else(Vec::new, |link| link.hosts().to_vec()),
            events: self.events.rows(),
        }
    }

    /// Why the wheels are blocked, or turn slower than a person asks for.
    fn hindered(&self) -> Option<String> {
        let recorder = &self.recording.recorder;
        let actuation = recorder.last_actuation()?;
        let (driven, asked) = (actuation.desired_velocity_mps, self.directives.current.person.velocity_mps);
        let obstacle = recorder.hindered_by().map(|obstacle| obstacle.to_string());
        if actuation.drives() {
            let is_slower =
                actuation.driven_by == DrivenBy::Person.wire() && driven.abs() < asked.abs() - SLOWER_MPS;
            let reason = obstacle.unwrap_or_else(|| "no more is allowed here".to_owned());
            return is_slower.then(|| format!("{driven:.2} of {asked:.2} m/s, {reason}"));
        }
        let plain = |name: &str| name.replace('_', " ");
        Some(match (BlockReason::try_from(actuation.reason), StopReason::try_from(actuation.stop_reason)) {
            (Ok(BlockReason::Commanded), Ok(stop)) => obstacle.unwrap_or_else(|| plain(stop.name())),
            (reason, _) => plain(reason.map_or("unknown", BlockReason::name)),
        })
    }

    /// What the wheels do, as far as it is known since a stop.
    fn wheels(&self) -> Wheels {
        let word = &self.run.stop_word;
        let reports = word.obeyed_by(Role::Robot) == self.fleet.last_pid(Role::Robot);
        let (wheels, seen_ns) = word.wheels(if reports { Role::Robot } else { Role::Actuator });
        if seen_ns >= word.stopped_ns() { wheels } else { Wheels::Unknown }
    }

    /// Adds the row of a candidate after those of its role; one that is in charge comes first, before its standby.
    fn show_candidate(
        &mut self,
        rows: &mut Vec<ProcessStatus>,
        role: Role,
        incarnation: u32,
        state: VisibleState,
    ) {
        let Some((pid, entry, load)) = self.fleet.candidate(incarnation) else { return };
        let Some(index) = rows.iter().rposition(|row| row.role == role) else { return };
        let row = ProcessStatus {
            implementation: entry.label(),
            host: entry.host,
            pid: pid.cast_signed(),
            cpu_percent: load.cpu_percent,
            memory_kib: load.memory_kib,
            ..self.vitals.row(role, state, incarnation)
        };
        if state == VisibleState::Ready {
            rows[index].state = VisibleState::Standby;
            rows.insert(index, row);
        } else {
            rows.insert(index + 1, row);
        }
    }
}
