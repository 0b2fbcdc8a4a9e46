//! The emulated robot: actuations in, scans, odometry and the truth out.
//!
//! Times are nanoseconds since the start of the run. The plant moves in steps of 1 ms on a fixed grid; an
//! actuation or the dead-man splits a step. Asking for a measurement or moving the clock in smaller portions
//! splits nothing, so how often a caller looks never changes what happens.
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

/// Scan periods that the history goes back: a caller may be late by two before old poses are forgotten.
const HISTORY_PERIODS: u64 = 3;

/// Slack of the limits, for numbers that went through a conversion.
const LIMIT_SLACK: f64 = 1e-9;

/// What the robot did with an actuation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Received {
    /// It turns or blocks its wheels as told.
    Accepted,
    /// Numbers not finite or beyond the limits, or a kind it does not know: nothing changes.
    Refused,
}

/// What is counted since the start of the run.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Tally {
    min_clearance: f64,
    path_length: f64,
    max_abs_lateral: f64,
    longest_blind_ns: u64,
    collided: bool,
    struck: bool,
    dead_man: bool,
    refused: u64,
    steps: u64,
    actuation_scan: u64,
}

/// The robot with everything around it.
#[derive(Debug, Clone)]
pub struct Emulator {
    scenario: Scenario,
    period_ns: u64,
    /// The time asked for.
    clock_ns: u64,
    /// The time that the plant has reached: the clock, less a part of a step.
    plant_ns: u64,
    last_actuation_ns: u64,
    plant: Plant,
    reckoning: Reckoning,
    scene: Scene,
    history: History,
    laser: Laser,
    odometer: Odometer,
    tally: Tally,
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
        let tally = Tally { min_clearance: scene.clearance(&body, 0.0), ..Tally::default() };
        Self {
            period_ns,
            clock_ns: 0,
            plant_ns: 0,
            last_actuation_ns: 0,
            plant,
            reckoning,
            scene,
            history,
            laser: Laser::new(scenario),
            odometer: Odometer::new(scenario),
            tally,
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
        self.clock_ns
    }

    /// The moving robot.
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// What stands around the robot.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Lets time pass until `ns`; an earlier time changes nothing.
    pub fn advance_to(&mut self, ns: u64) {
        self.clock_ns = self.clock_ns.max(ns);
        loop {
            let end = self.step_end();
            if end > self.clock_ns {
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
        self.step_to(self.clock_ns);
        match kind {
            Ok(ActuationKind::Block) => self.plant.block(),
            Ok(ActuationKind::Drive) if is_possible => self.plant.drive(velocity.max(0.0), steering),
            Ok(ActuationKind::Drive) | Err(_) => {
                self.tally.refused += 1;
                return Received::Refused;
            }
        }
        // Speed and steering jump: the node of this moment holds the new ones.
        self.history.push(node(self.plant_ns, &self.plant, &self.reckoning));
        self.last_actuation_ns = self.clock_ns;
        if actuation.answers == 1 {
            self.tally.actuation_scan = actuation.header.scan_id;
        }
        Received::Accepted
    }

    /// Fills scan, odometry and truth of a scan, but for their headers.
    ///
    /// The clock has to have reached [`Self::scan_ready_ns`]; what lies ahead of it is measured as if the robot
    /// stood still from now on.
    pub fn measure(&mut self, scan_id: u64, scan: &mut Scan, odometry: &mut Odometry, truth: &mut Truth) {
        let present = self.present();
        self.history.push(present);
        let sweep = Sweep { scan_id, front_ns: self.acquired_ns(scan_id), duration_ns: self.sweep_ns() };
        scan.sweep_ns = sweep.duration_ns;
        scan.period_ns = self.period_ns;
        scan.reserved = 0;
        self.laser.measure(&sweep, &self.history, &self.scene, &mut scan.ranges_mm);
        let front = self.history.at(sweep.front_ns);
        self.odometer.report(scan_id, &front, odometry);
        self.fill_truth(&front, truth);
        // The plant has not made this part of a step: looking leaves no trace.
        self.history.forget_after(self.plant_ns);
    }

    /// The robot now, with a part of a step added that the plant itself has not made yet.
    fn present(&self) -> Node {
        let (mut plant, mut reckoning) = (self.plant, self.reckoning);
        move_on(&mut plant, &mut reckoning, seconds(self.clock_ns - self.plant_ns));
        node(self.clock_ns, &plant, &reckoning)
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
        truth.min_clearance_m = self.tally.min_clearance.min(truth.clearance_m);
        truth.path_length_m = self.tally.path_length;
        truth.max_abs_lateral_m = self.tally.max_abs_lateral;
        truth.goal_distance_m = (state.x - x_m).hypot(state.y - y_m);
        truth.longest_blind_s = seconds(self.tally.longest_blind_ns);
        truth.actuation_age_s = seconds(self.clock_ns - self.last_actuation_ns);
        truth.blocked = u32::from(self.plant.is_blocked());
        truth.collided = u32::from(self.tally.collided);
        truth.struck = u32::from(self.tally.struck);
        truth.dead_man = u32::from(self.tally.dead_man);
        truth.actuation_scan = self.tally.actuation_scan;
        truth.refused = self.tally.refused;
        truth.steps = self.tally.steps;
        truth.reserved = 0;
    }

    /// End of the step that begins now: the next point of the grid, or the dead-man if it comes first.
    fn step_end(&self) -> u64 {
        let grid = (self.plant_ns / STEP_NS).saturating_add(1).saturating_mul(STEP_NS);
        let deadline = self.dead_man_ns();
        if !self.plant.is_blocked() && deadline > self.plant_ns { grid.min(deadline) } else { grid }
    }

    fn dead_man_ns(&self) -> u64 {
        self.last_actuation_ns.saturating_add(DEAD_MAN_PERIODS.saturating_mul(self.period_ns))
    }

    /// One plant step; nothing when the plant is there already.
    fn step_to(&mut self, end_ns: u64) {
        if end_ns <= self.plant_ns {
            return;
        }
        if !self.plant.is_blocked() && self.plant_ns >= self.dead_man_ns() {
            self.plant.block();
            self.tally.dead_man = true;
        }
        let turned = !self.plant.is_blocked() && self.plant.speed() > 0.0;
        let way = move_on(&mut self.plant, &mut self.reckoning, seconds(end_ns - self.plant_ns));
        self.plant_ns = end_ns;
        self.tally.steps += 1;
        self.tally.path_length += way;
        if turned {
            self.tally.longest_blind_ns = self.tally.longest_blind_ns.max(end_ns - self.last_actuation_ns);
        }
        self.look_around(way > 0.0);
        self.history.push(node(end_ns, &self.plant, &self.reckoning));
    }

    /// Clearance and contact after a step.
    fn look_around(&mut self, moved: bool) {
        let Start { y_m, .. } = self.scenario.start;
        let state = *self.plant.state();
        self.tally.max_abs_lateral = self.tally.max_abs_lateral.max((state.y - y_m).abs());
        let (body, time_s) = (self.scenario.body(state.x, state.y, state.yaw), seconds(self.plant_ns));
        self.scene.trigger(&body, time_s);
        // Only what is nearer than ever before, or touches, is of interest here.
        let limit = self.tally.min_clearance.max(0.0);
        let clearance = self.scene.clearance_below(&body, time_s, limit);
        self.tally.min_clearance = self.tally.min_clearance.min(clearance);
        let touches = clearance < 0.0 || (clearance <= 0.0 && limit > 0.0);
        if touches && moved {
            self.tally.collided = true;
            self.plant.wreck();
        } else if touches && !self.tally.collided {
            self.tally.struck = true;
        }
    }
}

/// Moves the robot and what it believes; returns the way driven [m].
fn move_on(plant: &mut Plant, reckoning: &mut Reckoning, duration: f64) -> f64 {
    let before = *plant.state();
    let way = plant.step(duration);
    reckoning.step(&before, plant.state(), way, duration);
    way
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
