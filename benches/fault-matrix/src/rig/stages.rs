//! What the stages do with the samples that have arrived.

use audit::samples::{MAX_DEVIATING, deviates, is_disobedient};
use emulator::Received;
use shared_types::{Actuation, BlockReason, Command, Odometry, Role, ScannerState, Suspect};

use super::{COMMANDS, HALT_PERIODS, Rig, alone};
use crate::finding::FindingPlace;
use crate::reader::join;

impl Rig {
    /// Hands samples that have arrived to their readers; whether there were any.
    pub(super) fn deliver(&mut self) -> bool {
        let (now_ns, mut any) = (self.now_ns, false);
        while let Some(scan) = self.wires.scan.receive(now_ns) {
            let found = self.ends.to_detector.0.arrive(scan, now_ns, &alone(Role::Robot));
            self.note_some(Role::Obstacles, found);
            any = true;
        }
        while let Some(odometry) = self.wires.odometry.receive(now_ns) {
            let found = self.ends.to_estimator.0.arrive(odometry, now_ns, &alone(Role::Robot));
            self.note_some(Role::Estimator, found);
            any = true;
        }
        while let Some(pose) = self.wires.pose.receive(now_ns) {
            let authority = alone(Role::Estimator);
            let found = self.ends.to_detector.1.arrive(pose, now_ns, &authority);
            self.note_some(Role::Obstacles, found);
            let found = self.controllers.receive_pose(&pose, now_ns, &authority);
            self.note_some(Role::Controller, found);
            any = true;
        }
        while let Some(obstacles) = self.wires.obstacles.receive(now_ns) {
            let found = self.controllers.receive_obstacles(&obstacles, now_ns, &alone(Role::Obstacles));
            self.note_some(Role::Controller, found);
            any = true;
        }
        while let Some(command) = self.wires.command.receive(now_ns) {
            let found = self.ends.to_actuator.arrive(command, now_ns, &self.authority);
            if found.is_some_and(|rule| rule != "missing") {
                self.actuator.note_dropped();
            }
            self.note_some(Role::Actuator, found);
            self.controllers.observe(now_ns, &command);
            if self.authority.accepts(command.header.incarnation, command.header.scan_id) {
                if self.commands.len() == COMMANDS {
                    self.commands.remove(0);
                }
                self.commands.push(command);
            }
            any = true;
        }
        while let Some(actuation) = self.wires.actuation.receive(now_ns) {
            let found = self.ends.to_estimator.1.arrive(actuation, now_ns, &alone(Role::Actuator));
            self.note_some(Role::Estimator, found);
            self.require_obedience(&actuation);
            self.wires.to_robot.send(actuation, now_ns, &mut self.ends.actuations);
            any = true;
        }
        while let Some(actuation) = self.wires.to_robot.receive(now_ns) {
            let found = self.ends.to_robot.arrive(actuation, now_ns, &alone(Role::Actuator));
            self.note_some(Role::Robot, found);
            any = true;
        }
        any
    }

    /// Lets each stage do what its inputs allow; whether one did something.
    pub(super) fn step(&mut self) -> bool {
        let (now_ns, mut any) = (self.now_ns, false);
        while let Some(actuation) = self.ends.to_robot.take() {
            any = true;
            if !self.is_halted && self.emulator.actuate(&actuation) == Received::Refused {
                self.note(Role::Robot, "refused");
            }
        }
        while let Some(actuation) = self.ends.to_estimator.1.take() {
            self.estimator.note(&actuation, now_ns);
            any = true;
        }
        while let Some(odometry) = self.ends.to_estimator.0.take() {
            self.estimate(&odometry);
            any = true;
        }
        while let Some((scan, pose)) =
            join(&mut self.ends.to_detector.0, &mut self.ends.to_detector.1, now_ns)
        {
            let mut obstacles = self.detector.step(&scan, &pose);
            let state = obstacles.scanner.state();
            if state != ScannerState::Healthy {
                self.note(Role::Obstacles, state.name());
            }
            self.ends.obstacles.complete(&mut obstacles, now_ns);
            self.wires.obstacles.send(obstacles, now_ns, &mut self.ends.obstacles);
            any = true;
        }
        let Self { controllers, wires, findings, .. } = self;
        let place = FindingPlace { at_ns: now_ns, way_m: self.way_m };
        any |= controllers.step(now_ns, &mut wires.command, |reason| {
            findings.note(Role::Controller.name(), reason.name(), place);
        });
        while let Some(command) = self.ends.to_actuator.take() {
            let actuation = self.actuator.answer(&command, now_ns);
            if let Some(fault) = self.actuator.refusal() {
                let rule = fault.rule().name();
                self.note(Role::Actuator, rule);
            }
            self.controllers.record(&command, &actuation);
            self.actuate(actuation);
            any = true;
        }
        any
    }

    fn estimate(&mut self, odometry: &Odometry) {
        let Some(mut pose) = self.estimator.step(odometry, None, self.now_ns) else {
            return self.note_refused();
        };
        if let Ok(suspect) = Suspect::try_from(pose.suspect)
            && suspect != Suspect::None
        {
            self.note(Role::Estimator, suspect.name());
        }
        self.note_refused();
        self.ends.poses.complete(&mut pose, self.now_ns);
        self.wires.pose.send(pose, self.now_ns, &mut self.ends.poses);
    }

    /// Notes what the estimator has refused since the last call.
    fn note_refused(&mut self) {
        let state = self.estimator.state();
        let refused = [state.rejected, state.restarts, state.skipped, state.invalid];
        let names = ["gate", "restarted", "not_newer", "refused"];
        for ((now, before), name) in refused.into_iter().zip(self.refused).zip(names) {
            if now > before {
                self.note(Role::Estimator, name);
            }
        }
        self.refused = refused;
    }

    pub(super) fn poll_actuator(&mut self) {
        if let Some(block) = self.actuator.tick(self.now_ns) {
            if let Ok(reason) = BlockReason::try_from(block.reason) {
                self.note(Role::Actuator, reason.name());
            }
            self.actuate(block);
        }
    }

    fn actuate(&mut self, mut actuation: Actuation) {
        self.ends.actuations.complete(&mut actuation, self.now_ns);
        self.wires.actuation.send(actuation, self.now_ns, &mut self.ends.actuations);
        self.actuation = Some(actuation);
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
            self.findings.note("orchestrator", "disobeyed", self.place());
            self.halted_ns = Some(self.now_ns + (HALT_PERIODS * self.period_ns as f64) as u64);
        }
    }
}
