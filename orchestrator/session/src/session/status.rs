//! The part of a session that shows how it goes: to the terminal, to the service manager, to `status`.

use std::time::Instant;

use console::progress::{COLUMNS, ProcessLabel, line};
use shared_types::{Phase, Role};

use super::Session;
use crate::control::{ProcessStatus, Status};

impl Session {
    pub(super) fn show(&mut self) {
        let processes: Vec<_> = self.supervisor.processes().collect();
        let words: Vec<_> =
            processes.iter().map(|view| ProcessLabel { role: view.role, state: view.state.name() }).collect();
        let view = self.recorder.view();
        self.progress.update(Instant::now(), &view, &words);
        match self.supervisor.phase() {
            Phase::Driving => self.manager.ready(),
            Phase::Stopping => self.manager.stopping(),
            Phase::Starting | Phase::Connecting => {}
        }
        self.manager.turn(|| line(&view, &words, COLUMNS));
    }

    pub(super) fn status(&mut self) -> Status {
        let views: Vec<_> = self.supervisor.processes().collect();
        let processes = views.into_iter().map(|view| {
            let (rate_hz, last_sample_age_ms) = self.vitals.rate_and_age(view.incarnation);
            let load = self.fleet.load(view.role);
            ProcessStatus {
                role: view.role.name().to_owned(),
                implementation: self.fleet.label(view.role),
                pid: view.pid.map_or(0, u32::cast_signed),
                state: view.state.name().to_owned(),
                restarts: view.restarts,
                rate_hz,
                last_sample_age_ms,
                cpu_percent: load.cpu_percent,
                memory_kib: load.memory_kib,
                obeys_stop: self.vitals.obeys_stop(view.incarnation),
                last_words: self.fleet.last_words(view.role).to_vec(),
            }
        });
        let mut processes: Vec<_> = processes.collect();
        processes.sort_by_key(|process| process.role.parse::<Role>().map_or(usize::MAX, Role::index));
        self.show_swap(&mut processes);
        self.show_shadows(&mut processes);
        Status {
            system_id: self.domain.system_id().to_owned(),
            state: Phase::try_from(self.directives.current.phase).map_or("starting", Phase::name).to_owned(),
            scenario: self.scenario.name.clone(),
            scan: self.samples.newest_scan(),
            lockstep: self.lockstep,
            processes,
            refused: self.sample_audit.refused().to_vec(),
        }
    }
}
