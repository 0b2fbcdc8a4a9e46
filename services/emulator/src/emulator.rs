//! The emulated robot: actuations in, scans, odometry and the truth out.
//!
//! Times are nanoseconds since the start of the run. The plant moves in steps of 1 ms on a fixed grid; an
//! actuation or the dead-man splits a step. Asking for a measurement or moving the clock in smaller portions
//! splits nothing, so the result does not depend on how often a caller asks.
//!
//! An actuation travels to the robot for a while, or gets lost, see the module `way`; then it acts at its exact time.
//!
//! The robot has a dead-man of its own: it blocks the wheels two scan periods after the last actuation arrived. An
//! actuation that is not finite or beyond the limits of the drive is refused and does not feed the dead-man.

use shared_types::{Actuation, ActuationKind, GivenGoal, Odometry, Scan, Truth};
use vehicle::Description;
use vehicle::frame::wrap_angle;

use crate::history::{History, Node};
use crate::laser::{Laser, Sweep};
use crate::odometer::{Odometer, Reckoning};
use crate::plant::{Plant, STEP_NS};
use crate::scenario::{Robot, Scenario, Start};
use crate::scene::Scene;
use crate::schedule::Schedule;
use way::Way;

/// Time that passes at once at most [ns]: a forged time would take years of steps. A robot that stood still for longer makes it
/// up over several calls.
pub(crate) const MAX_AHEAD_NS: u64 = 600_000_000_000;

/// The dead-man blocks the wheels this many scan periods after the last actuation.
const DEAD_MAN_PERIODS: u64 = 2;

/// Scan periods that the history covers: a caller may be late by two before old poses are forgotten.
const HISTORY_PERIODS: u64 = 3;

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
    schedule: Schedule,
    way: Way,
    /// Where the robot is along the course, so that the search for its next place begins there [m].
    along_m: f64,
    /// Lateral position of the start on the course [m].
    start_across_m: f64,
}

impl Emulator {
    /// The robot at its start, with blocked wheels, scanning each `period_ns`.
    ///
    /// Values of the robot that the scenario leaves open are those of its preset, around the default description.
    pub fn new(scenario: &Scenario, period_ns: u64) -> Self {
        let robot = scenario.robot.resolved(&Description::default(), scenario.seed);
        let scenario = &Scenario { robot, ..scenario.clone() };
        let period_ns = period_ns.max(STEP_NS);
        let (plant, reckoning) = (Plant::new(scenario), Reckoning::new(scenario));
        let history = History::new(node(0, &plant, &reckoning), history_ns(scenario, period_ns));
        let Start { x_m: along_m, y_m: start_across_m, .. } = scenario.start_on_course();
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
            schedule: Schedule::new(scenario, period_ns),
            way: Way::new(scenario),
            along_m,
            start_across_m,
            scenario: scenario.clone(),
        }
    }

    /// Time of the front beam of a scan [ns]. The first scan, 1, is taken one period after the start.
    pub fn acquired_ns(&self, scan_id: u64) -> u64 {
        self.schedule.acquired_ns(scan_id)
    }

    /// The time stamp of a scan, which may differ from [`Self::acquired_ns`] [ns]. Stamps ascend strictly.
    pub fn stamp_ns(&self, scan_id: u64) -> u64 {
        self.schedule.stamp_ns(scan_id)
    }

    /// How long the sweep over all beams lasts [ns].
    pub fn sweep_ns(&self) -> u64 {
        self.scenario.true_scanner().sweep_ns(self.period_ns)
    }

    /// Time from the front beam of a scan to its last one [ns].
    pub fn after_front_ns(&self) -> u64 {
        self.schedule.after_front_ns
    }

    /// When a scan can be published: when its sweep is complete, or later
    /// where the scanner is late [ns].
    pub fn scan_ready_ns(&self, scan_id: u64) -> u64 {
        self.schedule.ready_ns(scan_id)
    }

    /// The time that [`Self::advance_to`] reached [ns].
    pub fn now_ns(&self) -> u64 {
        self.state.clock_ns
    }

    /// The true robot.
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// Takes note of a goal that was given while driving: from its scan on the truth has the distance to it, if it is the
    /// last one of the drive.
    pub fn give(&mut self, given: &GivenGoal, scan_id: u64) {
        let Scenario { course, goal: goals, .. } = &mut self.scenario;
        let is_last = given.index as usize + 1 == goals.all().len();
        let Some(goal) = goals.all_mut().last_mut().filter(|_| is_last) else { return };
        if (1..=scan_id).contains(&given.from_scan) {
            let along = course.as_ref().map(|course| course.at(given.x_m).point(0.0, given.y_m));
            [goal.x_m, goal.y_m] = along.map_or([given.x_m, given.y_m], Into::into);
        }
    }

    /// What stands around the robot.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Lets time pass until `ns`, at most ten minutes at once; an earlier time changes nothing.
    pub fn advance_to(&mut self, ns: u64) {
        let latest_ns = self.state.clock_ns.saturating_add(MAX_AHEAD_NS);
        self.state.clock_ns = self.state.clock_ns.max(ns.min(latest_ns));
        loop {
            self.receive_due();
            let end = self.step_end();
            if end > self.state.clock_ns {
                return;
            }
            self.step_to(end);
        }
    }

    /// Sends an actuation to the robot now; it acts when it arrives, if it does.
    pub fn actuate(&mut self, actuation: &Actuation) -> Received {
        let kind = ActuationKind::try_from(actuation.kind);
        let (velocity, steering) = (actuation.sent_velocity_mps, actuation.sent_steering_rad);
        // NaN is in no range.
        let is_possible = self.plant.may_be_sent(velocity, steering);
        self.step_to(self.state.clock_ns);
        let blocks = match kind {
            Ok(ActuationKind::Block) => true,
            Ok(ActuationKind::Drive) if is_possible => false,
            Ok(ActuationKind::Drive) | Err(_) => {
                self.state.refused += 1;
                return Received::Refused;
            }
        };
        // The numbers of a block may be anything.
        let (velocity_mps, steering_rad) = if blocks { (0.0, 0.0) } else { (velocity, steering) };
        if let Some(arrives_ns) = self.way.arrives_ns(actuation, self.state.clock_ns) {
            let answered_scan = if actuation.answers == 1 { actuation.header.scan_id } else { 0 };
            let travelling = Travelling {
                arrives_ns,
                velocity_mps,
                steering_rad,
                answered_scan,
                blocks: blocks.into(),
                answers: (actuation.answers == 1).into(),
            };
            self.state.travelling.push(travelling);
            self.receive_due();
        }
        Received::Accepted
    }

    /// Blocks the wheels now, and forgets what is on its way: the process of the robot does this when it must stop.
    pub fn block_at_once(&mut self) {
        self.step_to(self.state.clock_ns);
        self.state.travelling = Travellings::default();
        self.receive(&Travelling { blocks: true.into(), ..Travelling::default() });
    }

    /// Receives what has arrived by the time that the plant has reached.
    fn receive_due(&mut self) {
        while let Some(arrived) = self.state.travelling.take_due(self.state.plant_ns) {
            self.receive(&arrived);
        }
    }

    fn receive(&mut self, arrived: &Travelling) {
        if arrived.blocks.is_set() {
            self.plant.block();
        } else {
            self.plant.drive(arrived.velocity_mps, arrived.steering_rad);
        }
        // Speed and steering may jump: the node of this moment holds the new ones.
        self.history.push(node(self.state.plant_ns, &self.plant, &self.reckoning));
        self.state.last_actuation_ns = self.state.plant_ns;
        if arrived.answers.is_set() {
            self.state.actuation_scan = arrived.answered_scan;
        }
    }

    /// Fills scan, odometry and truth of a scan, but for their headers.
    ///
    /// Call it when the clock has reached [`Self::scan_ready_ns`]: later beams are measured as if the robot stood
    /// still from now on.
    pub fn measure(&mut self, scan_id: u64, scan: &mut Scan, odometry: &mut Odometry, truth: &mut Truth) {
        let present = self.present();
        self.history.push(present);
        let sweep = Sweep { scan_id, front_ns: self.acquired_ns(scan_id), duration_ns: self.sweep_ns() };
        scan.set_geometry(self.laser.geometry());
        scan.sweep_ns = sweep.duration_ns;
        scan.period_ns = self.period_ns;
        self.laser.measure(&sweep, &self.history, &self.scene, scan.ranges_mut());
        let is_missing = self.schedule.is_missing(scan_id);
        scan.missing = is_missing.into();
        if is_missing {
            scan.ranges_mm.fill(0);
        }
        let front = self.history.at(sweep.front_ns);
        if self.odometer.last.is_none() {
            self.reckoning.begin(seconds(self.state.plant_ns.saturating_sub(sweep.front_ns)));
        }
        self.odometer.report(scan_id, self.stamp_ns(scan_id), &front, odometry);
        self.fill_truth(&front, truth);
        // The plant has not made this part of a step: a measurement leaves no trace.
        self.history.forget_after(self.state.plant_ns);
    }

    /// The robot now, including the part of a step that the plant has not made yet.
    fn present(&self) -> Node {
        let (mut plant, mut reckoning) = (self.plant, self.reckoning);
        move_on(&mut plant, &mut reckoning, self.state.plant_ns, self.state.clock_ns);
        node(self.state.clock_ns, &plant, &reckoning)
    }

    fn fill_truth(&self, front: &Node, truth: &mut Truth) {
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
        truth.goal_distance_m = self.scenario.goal.last().distance_m(state.x, state.y);
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

    /// End of the next step: the next point of the grid, or before it the dead-man's deadline or an arrival.
    fn step_end(&self) -> u64 {
        let grid = (self.state.plant_ns / STEP_NS).saturating_add(1).saturating_mul(STEP_NS);
        let grid = self.state.travelling.next_ns().map_or(grid, |arrives_ns| grid.min(arrives_ns));
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
        let Robot { pushed_s, pushed_left_m, pushed_yaw_rad, .. } = self.scenario.robot;
        let is_pushed = (self.state.plant_ns..end_ns).contains(&((pushed_s * 1e9) as u64));
        if is_pushed && pushed_s > 0.0 && !self.plant.wrecked {
            self.plant.push(pushed_left_m, pushed_yaw_rad);
            self.reckoning.turn(pushed_yaw_rad);
        }
        let turned = !self.plant.is_blocked() && self.plant.speed() != 0.0;
        let distance = move_on(&mut self.plant, &mut self.reckoning, self.state.plant_ns, end_ns);
        self.state.plant_ns = end_ns;
        self.state.steps += 1;
        self.state.path_length_m += distance.abs();
        if turned {
            self.state.longest_blind_ns =
                self.state.longest_blind_ns.max(end_ns - self.state.last_actuation_ns);
        }
        self.check_contact(distance != 0.0);
        self.history.push(node(end_ns, &self.plant, &self.reckoning));
    }

    /// Offset from the line through the start, or across the course from the start [m].
    fn lateral_m(&mut self) -> f64 {
        let state = self.plant.state();
        let Some(course) = &self.scenario.course else { return state.y - self.scenario.start.y_m };
        let on_course = course.on_course(state, self.along_m);
        self.along_m = on_course.x;
        on_course.y - self.start_across_m
    }

    /// Updates clearance and contact after a step.
    fn check_contact(&mut self, moved: bool) {
        let state = *self.plant.state();
        let lateral_m = self.lateral_m();
        self.state.max_abs_lateral_m = self.state.max_abs_lateral_m.max(lateral_m.abs());
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

/// Moves the robot and its odometry; returns the distance driven, negative backwards [m].
fn move_on(plant: &mut Plant, reckoning: &mut Reckoning, start_ns: u64, end_ns: u64) -> f64 {
    let (before, duration) = (*plant.state(), seconds(end_ns - start_ns));
    let turns_per_way = plant.turns_per_way();
    let distance = plant.step(duration);
    reckoning.step(start_ns, [&before, plant.state()], distance, turns_per_way, duration);
    distance
}

fn node(time_ns: u64, plant: &Plant, reckoning: &Reckoning) -> Node {
    Node {
        time_ns,
        state: *plant.state(),
        speed: plant.speed(),
        steering: plant.steering(),
        reported: reckoning.reported(),
        reported_yaw: reckoning.yaw(),
        encoder_m: reckoning.encoder_m(),
    }
}

/// How long past poses are kept [ns].
fn history_ns(scenario: &Scenario, period_ns: u64) -> u64 {
    let late_ns = (scenario.scanner.late_s * 1e9) as u64;
    HISTORY_PERIODS.saturating_mul(period_ns).saturating_add(late_ns)
}

fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

mod state;
#[cfg(test)]
mod tests;
mod way;

pub use state::{APPEARING, EmulatorState};
pub use way::{Travelling, Travellings};
