//! The emulated robot: actuations in, scans, odometry and the truth out.
//!
//! Times are nanoseconds since the start of the run. The plant moves in steps of 1 ms on a fixed grid; an
//! actuation or the dead-man splits a step. Asking for a measurement or moving the clock in smaller portions
//! splits nothing, so the result does not depend on how often a caller asks.
//!
//! The robot has a dead-man of its own: it blocks the wheels two scan periods after the last actuation. An
//! actuation that is not finite or beyond the limits of the drive is refused and does not feed the dead-man.

use shared_types::{Actuation, ActuationKind, Odometry, Scan, Truth};
use vehicle::correction::{SENT_STEERING_MAX_RAD, SENT_VELOCITY_MAX_MPS};
use vehicle::frame::wrap_angle;

use crate::history::{History, Node};
use crate::laser::{Laser, Sweep};
use crate::odometer::{Odometer, Reckoning};
use crate::plant::{Plant, STEP_NS};
use crate::scenario::{Goal, Scenario, Start};
use crate::scene::Scene;

/// The dead-man blocks the wheels this many scan periods after the last actuation.
const DEAD_MAN_PERIODS: u64 = 2;

/// Scan periods that the history covers: a caller may be late by two before old poses are forgotten.
const HISTORY_PERIODS: u64 = 3;

/// Tolerance of the limits, for numbers that went through a conversion.
const LIMIT_SLACK: f64 = 1e-9;

/// What the robot did with an actuation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Received {
    /// The wheels turn or block as commanded.
    Accepted,
    /// Numbers not finite or beyond the limits, or a kind it does not know: nothing changes.
    Refused,
}

/// The robot with everything around it.
#[derive(Debug, Clone)]
pub struct Emulator {
    scenario: Scenario,
    period_ns: u64,
    /// Times and counters; [`Self::state`] adds the state of the parts below.
    state: EmulatorState,
    plant: Plant,
    reckoning: Reckoning,
    scene: Scene,
    history: History,
    laser: Laser,
    odometer: Odometer,
}

impl Emulator {
    /// The robot at its start, with blocked wheels, scanning each `period_ns`.
    pub fn new(scenario: &Scenario, period_ns: u64) -> Self {
        let period_ns = period_ns.max(STEP_NS);
        let (plant, reckoning) = (Plant::new(scenario), Reckoning::new(scenario));
        let history = History::new(node(0, &plant, &reckoning), HISTORY_PERIODS.saturating_mul(period_ns));
        let mut scene = Scene::new(scenario);
        let body = scenario.start_body();
        scene.trigger(&body, 0.0);
        let min_clearance_m = scene.clearance(&body, 0.0);
        Self {
            period_ns,
            state: EmulatorState { min_clearance_m, ..EmulatorState::default() },
            plant,
            reckoning,
            scene,
            history,
            laser: Laser::new(scenario),
            odometer: Odometer::new(scenario),
            scenario: scenario.clone(),
        }
    }

    /// Time of the front beam of a scan [ns]. The first scan, 1, is taken one period after the start.
    pub fn acquired_ns(&self, scan_id: u64) -> u64 {
        scan_id.saturating_mul(self.period_ns)
    }

    /// How long the sweep over all beams lasts: two thirds of the period [ns].
    pub fn sweep_ns(&self) -> u64 {
        self.period_ns / 3 * 2 + self.period_ns % 3 * 2 / 3
    }

    /// When a scan is complete and can be published: a third of the period after its front beam [ns].
    pub fn scan_ready_ns(&self, scan_id: u64) -> u64 {
        self.acquired_ns(scan_id).saturating_add(self.period_ns / 3)
    }

    /// The time that [`Self::advance_to`] reached [ns].
    pub fn now_ns(&self) -> u64 {
        self.state.clock_ns
    }

    /// The true robot.
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// What stands around the robot.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Lets time pass until `ns`; an earlier time changes nothing.
    pub fn advance_to(&mut self, ns: u64) {
        self.state.clock_ns = self.state.clock_ns.max(ns);
        loop {
            let end = self.step_end();
            if end > self.state.clock_ns {
                return;
            }
            self.step_to(end);
        }
    }

    /// Receives an actuation now.
    pub fn actuate(&mut self, actuation: &Actuation) -> Received {
        let kind = ActuationKind::try_from(actuation.kind);
        let (velocity, steering) = (actuation.sent_velocity_mps, actuation.sent_steering_rad);
        // NaN is in no range.
        let is_possible = (-LIMIT_SLACK..=SENT_VELOCITY_MAX_MPS + LIMIT_SLACK).contains(&velocity)
            && steering.abs() <= SENT_STEERING_MAX_RAD + LIMIT_SLACK;
        self.step_to(self.state.clock_ns);
        match kind {
            Ok(ActuationKind::Block) => self.plant.block(),
            Ok(ActuationKind::Drive) if is_possible => self.plant.drive(velocity.max(0.0), steering),
            Ok(ActuationKind::Drive) | Err(_) => {
                self.state.refused += 1;
                return Received::Refused;
            }
        }
        // Speed and steering jump: the node of this moment holds the new ones.
        self.history.push(node(self.state.plant_ns, &self.plant, &self.reckoning));
        self.state.last_actuation_ns = self.state.clock_ns;
        if actuation.answers == 1 {
            self.state.actuation_scan = actuation.header.scan_id;
        }
        Received::Accepted
    }

    /// Fills scan, odometry and truth of a scan, but for their headers.
    ///
    /// Call it when the clock has reached [`Self::scan_ready_ns`]: later beams are measured as if the robot stood
    /// still from now on.
    pub fn measure(&mut self, scan_id: u64, scan: &mut Scan, odometry: &mut Odometry, truth: &mut Truth) {
        let present = self.present();
        self.history.push(present);
        let sweep = Sweep { scan_id, front_ns: self.acquired_ns(scan_id), duration_ns: self.sweep_ns() };
        scan.sweep_ns = sweep.duration_ns;
        scan.period_ns = self.period_ns;
        scan.reserved = 0;
        self.laser.measure(&sweep, &self.history, &self.scene, &mut scan.ranges_mm);
        let front = self.history.at(sweep.front_ns);
        if self.odometer.last.is_none() {
            self.reckoning.begin(seconds(self.state.plant_ns.saturating_sub(sweep.front_ns)));
        }
        self.odometer.report(scan_id, &front, odometry);
        self.fill_truth(&front, truth);
        // The plant has not made this part of a step: a measurement leaves no trace.
        self.history.forget_after(self.state.plant_ns);
    }

    /// The robot now, including the part of a step that the plant has not made yet.
    fn present(&self) -> Node {
        let (mut plant, mut reckoning) = (self.plant, self.reckoning);
        move_on(&mut plant, &mut reckoning, seconds(self.state.clock_ns - self.state.plant_ns));
        node(self.state.clock_ns, &plant, &reckoning)
    }

    fn fill_truth(&self, front: &Node, truth: &mut Truth) {
        let Goal { x_m, y_m, .. } = self.scenario.goal;
        let state = &front.state;
        let body = self.scenario.body(state.x, state.y, state.yaw);
        truth.time_s = seconds(front.time_ns);
        truth.x_m = state.x;
        truth.y_m = state.y;
        truth.yaw_rad = wrap_angle(state.yaw);
        truth.sideslip_rad = state.sideslip;
        truth.yaw_rate_radps = state.yaw_rate;
        truth.speed_mps = front.speed;
        truth.steering_rad = front.steering;
        truth.clearance_m = self.scene.clearance(&body, truth.time_s);
        truth.min_clearance_m = self.state.min_clearance_m.min(truth.clearance_m);
        truth.path_length_m = self.state.path_length_m;
        truth.max_abs_lateral_m = self.state.max_abs_lateral_m;
        truth.goal_distance_m = (state.x - x_m).hypot(state.y - y_m);
        truth.longest_blind_s = seconds(self.state.longest_blind_ns);
        truth.actuation_age_s = seconds(self.state.clock_ns - self.state.last_actuation_ns);
        truth.blocked = u32::from(self.plant.is_blocked());
        truth.collided = u32::from(self.state.collided.is_set());
        truth.struck = u32::from(self.state.struck.is_set());
        truth.dead_man = u32::from(self.state.dead_man.is_set());
        truth.actuation_scan = self.state.actuation_scan;
        truth.refused = self.state.refused;
        truth.steps = self.state.steps;
        truth.reserved = 0;
    }

    /// End of the next step: the next point of the grid, or the dead-man's deadline if that comes first.
    fn step_end(&self) -> u64 {
        let grid = (self.state.plant_ns / STEP_NS).saturating_add(1).saturating_mul(STEP_NS);
        let deadline = self.dead_man_ns();
        if !self.plant.is_blocked() && deadline > self.state.plant_ns { grid.min(deadline) } else { grid }
    }

    fn dead_man_ns(&self) -> u64 {
        self.state.last_actuation_ns.saturating_add(DEAD_MAN_PERIODS.saturating_mul(self.period_ns))
    }

    /// One plant step up to `end_ns`; none if the plant has reached that time.
    fn step_to(&mut self, end_ns: u64) {
        if end_ns <= self.state.plant_ns {
            return;
        }
        if !self.plant.is_blocked() && self.state.plant_ns >= self.dead_man_ns() {
            self.plant.block();
            self.state.dead_man = true.into();
        }
        let turned = !self.plant.is_blocked() && self.plant.speed() > 0.0;
        let distance = move_on(&mut self.plant, &mut self.reckoning, seconds(end_ns - self.state.plant_ns));
        self.state.plant_ns = end_ns;
        self.state.steps += 1;
        self.state.path_length_m += distance;
        if turned {
            self.state.longest_blind_ns =
                self.state.longest_blind_ns.max(end_ns - self.state.last_actuation_ns);
        }
        self.check_contact(distance > 0.0);
        self.history.push(node(end_ns, &self.plant, &self.reckoning));
    }

    /// Updates clearance and contact after a step.
    fn check_contact(&mut self, moved: bool) {
        let Start { y_m, .. } = self.scenario.start;
        let state = *self.plant.state();
        self.state.max_abs_lateral_m = self.state.max_abs_lateral_m.max((state.y - y_m).abs());
        let (body, time_s) = (self.scenario.body(state.x, state.y, state.yaw), seconds(self.state.plant_ns));
        self.scene.trigger(&body, time_s);
        // Only a new minimum or a contact matters here.
        let limit = self.state.min_clearance_m.max(0.0);
        let clearance = self.scene.clearance_below(&body, time_s, limit);
        self.state.min_clearance_m = self.state.min_clearance_m.min(clearance);
        let touches = clearance < 0.0 || (clearance <= 0.0 && limit > 0.0);
        if touches && moved {
            self.state.collided = true.into();
            self.plant.wreck();
        } else if touches && !self.state.collided.is_set() {
            self.state.struck = true.into();
        }
    }
}

/// Moves the robot and its odometry; returns the distance driven [m].
fn move_on(plant: &mut Plant, reckoning: &mut Reckoning, duration: f64) -> f64 {
    let before = *plant.state();
    let distance = plant.step(duration);
    reckoning.step(&before, plant.state(), distance, duration);
    distance
}

fn node(time_ns: u64, plant: &Plant, reckoning: &Reckoning) -> Node {
    Node {
        time_ns,
        state: *plant.state(),
        speed: plant.speed(),
        steering: plant.steering(),
        reported: reckoning.reported(),
    }
}

fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

mod state;
#[cfg(test)]
mod tests;

pub use state::{APPEARING, EmulatorState};
