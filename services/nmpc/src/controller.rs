//! One scan in, one command out: the order of the decisions.
//!
//! 1. Invalid or contradictory inputs stop the robot.
//! 2. Landing is decided by position alone.
//! 3. The speed is limited to what can be stopped for something that appears unseen, and within what the scanner shows.
//! 4. The lattice planner chooses the passing sides, and shows whether the path is clear, if need be slowly; or an
//!    explicit rule does.
//! 5. The optimal control problem is solved from the best guess, then from others.
//! 6. Only a verified plan is driven: converged, best iterate, or the rest of the last plan; else stop.
//! 7. The stop rule checks what comes behind the end of the plan.
//!
//! Pure: the time comes with the samples, the clock of the budget is handed in. After [`Controller::resume`] a
//! controller gives the same commands as the one that [`Controller::state`] was taken from.

use ocp::{ActiveLimit, Budget, Limit};
use shared_types::{
    Alarm, Command, CommandKind, DrivenBy, GivenControl, GivenGoal, Level, Obstacles, PLAN_NODES, PlanNode,
    Pose, StopReason,
};
use vehicle::{Control, Goal, Invalid, State};

use crate::braking::STOP_MARGIN_M;
use crate::config::ControllerConfig;
use crate::contest::Contest;
use crate::gear::{self, Legs};
use crate::lattice::Search;
use crate::planner::{Choice, Planner};
use crate::predicted_obstacle::PredictedObstacle;
use crate::reference_path::ReferencePath;
use crate::scene::REST_MPS;
use crate::side::{self};
use crate::smoothing;
use crate::start::{self, Start};
use crate::state::{Arrival, ControllerState};

/// A body that blocks the way and came less than this ago may go again [s].
const COMES_AND_GOES_S: f64 = 3.0;

/// What a limit of a plan belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ShapedBy {
    /// The obstacle with this identity.
    Obstacle(u32),
    /// The bound of a component of the state: sideslip, yaw, yaw rate, x, y.
    Bound(usize),
}

/// A limit that shapes a plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shaping {
    /// What it belongs to.
    pub by: ShapedBy,
    /// Time of the plan at which it presses most [s].
    pub after_s: f64,
    /// By how much the objective falls if it is one unit further away there.
    pub multiplier: f64,
}

/// The controller of the robot.
#[derive(Debug, Clone)]
pub struct Controller {
    /// The settings, with the goal that the robot drives to, for the leg that it drives.
    config: ControllerConfig,
    legs: Legs,
    /// How far the search looks ahead; further where it remembers a dead end [m].
    range_m: f64,
    goals: Vec<Goal>,
    /// The first scan of the given goal that is among `goals`; 0 while none is.
    given_from: u64,
    search: Search,
    planner: Planner,
    state: ControllerState,
    predicted: Vec<PredictedObstacle>,
    reference_path: ReferencePath,
    /// A path past the nearest obstacle whose side is open, on the other side; used when there is a `contest`.
    alternative: ReferencePath,
    /// What the alternative is for, when there is one.
    contest: Option<Contest>,
}

impl Controller {
    /// A controller that has not seen a scan.
    ///
    /// # Errors
    /// [`Invalid`] with the first setting that is not allowed.
    pub fn new(mut config: ControllerConfig) -> Result<Self, Invalid> {
        config.validate()?;
        let planner = Planner::new(&config);
        let legs = Legs::new(&mut config);
        let mut reference_path = ReferencePath::default();
        reference_path.set_line(0.0, config.goal.y_m, config.cruise_mps);
        Ok(Self {
            goals: std::iter::once(config.goal).chain(config.next_goals.iter().copied()).collect(),
            given_from: 0,
            search: Search::default(),
            planner,
            legs,
            range_m: config.guide.range_m,
            state: ControllerState::default(),
            predicted: Vec::with_capacity(shared_types::MAX_OBSTACLES),
            reference_path,
            alternative: ReferencePath::default(),
            contest: None,
            config,
        })
    }

    /// Number of ellipse constraints (7.34) that are active in the last solution.
    pub fn active_ellipses(&self) -> u32 {
        self.planner.active_ellipses()
    }

    /// The limits that shape the last solution, each with its largest multiplier: an ellipse by the identity of its
    /// obstacle, or the bound of a coordinate of the track.
    pub fn shaping(&self) -> Vec<Shaping> {
        let mut found: Vec<Shaping> = Vec::new();
        for (ActiveLimit { node, limit, multiplier }, owner) in self.planner.active_limits() {
            let by = match (limit, owner.and_then(|owner| self.predicted.get(owner))) {
                (Limit::State(component), _) => ShapedBy::Bound(component),
                (Limit::Ellipse(_), Some(obstacle)) => ShapedBy::Obstacle(obstacle.id),
                (Limit::Ellipse(_), None) => continue,
            };
            let shaping = Shaping { by, after_s: node as f64 * self.config.interval_s(), multiplier };
            match found.iter_mut().find(|other| other.by == by) {
                Some(other) if other.multiplier < multiplier => *other = shaping,
                Some(_) => {}
                None => found.push(shaping),
            }
        }
        found.sort_by(|one, other| other.multiplier.total_cmp(&one.multiplier));
        found
    }

    /// State that a successor continues from.
    pub fn state(&self) -> ControllerState {
        self.state
    }

    /// Continues from the state of another controller; an invalid plan is dropped.
    pub fn resume(&mut self, state: &ControllerState) {
        self.state = ControllerState {
            sides: side::valid(&state.sides),
            ellipses: smoothing::valid(&state.ellipses),
            sights: state.sights.valid(),
            memory: state.memory.valid(),
            movers: state.movers.valid(),
            ..*state
        };
        let length = state.plan_length as usize;
        let finite = |node: &PlanNode| node.velocity_mps.is_finite() && node.steering_rad.is_finite();
        let sound = (2..=PLAN_NODES).contains(&length)
            && state.plan[..length].iter().all(finite)
            && (1e-3..=10.0).contains(&state.plan_interval_s);
        if !sound {
            self.state.plan_length = 0;
        }
        let last = Control { velocity: state.velocity_mps, steering: state.steering_rad };
        if !last.is_finite() {
            (self.state.velocity_mps, self.state.steering_rad) = (0.0, 0.0);
        }
    }

    /// Gives a goal that counts from its scan on; one that is not newer than the last is no other.
    pub fn give(&mut self, goal: &GivenGoal) {
        if goal.is_newer(&self.state.given) {
            self.state.given = *goal;
        }
    }

    /// Who drives from now on, and what a person asks for.
    pub fn obey(&mut self, driven_by: u32, person: GivenControl) {
        (self.state.driven_by, self.state.person) = (driven_by, person);
    }

    /// Starts without the state of the controller before: stops the robot, then plans afresh.
    ///
    /// At rest nothing of the lost state matters: sides are chosen anew, the last controls are zero, and a landed
    /// robot lands again.
    pub fn start_in_stop(&mut self) {
        let ControllerState { given, driven_by, person, .. } = self.state;
        let arrival = Arrival::StateLost.wire();
        self.state = ControllerState { arrival, given, driven_by, person, ..ControllerState::default() };
    }

    /// The command for one scan. `solve_ns` and the stamps of the header are left to the caller.
    pub fn step(&mut self, pose: &Pose, obstacles: &Obstacles, budget: &Budget) -> Command {
        let mut command = Command {
            header: obstacles.header.answer_both(&pose.header),
            plan_start_ns: pose.predicted_ns,
            plan_interval_s: self.config.interval_s(),
            ..Command::default()
        };
        let period_s = self.period(pose);
        self.heed_goal(obstacles.header.scan_id);
        self.enter_leg(pose);
        self.state.sights.enter(pose, &obstacles.scanner);
        self.state.memory.follow(obstacles, pose);
        let now_ns = obstacles.header.acquired_ns;
        self.state.movers.follow(obstacles, now_ns, now_ns.saturating_sub(self.config.seen_for_ns()));
        let along_m = self.state.along();
        let recalls = self.state.back.is_before(along_m) || self.legs.is_reverse();
        let recalled = recalls.then(|| self.state.memory.beside(obstacles, pose));
        let obstacles = recalled.as_ref().unwrap_or(obstacles);
        self.config.guide.range_m = self.range_m + self.state.back.length_m();
        let turned = self.legs.is_reverse().then(|| gear::turned(pose));
        let pose = turned.as_ref().unwrap_or(pose);
        self.state.acquired_ns = pose.header.acquired_ns;
        let decided = self.decide(pose, obstacles, period_s, budget, &mut command);
        match decided.and_then(|choice| self.may_drive(choice)) {
            Ok(choice) => self.drive(choice, &mut command),
            Err(reason) => {
                self.stop(reason, &mut command);
                let lately = obstacles.list().iter().any(|body| {
                    body.id == command.blocking.id && body.sightings as f64 * period_s < COMES_AND_GOES_S
                });
                self.look_back(reason, pose, period_s, lately);
            }
        }
        if turned.is_some() {
            gear::turn_back(&mut command);
        }
        command
    }

    /// The settings for the leg that the robot drives: the next one when it rests at the end of one.
    fn enter_leg(&mut self, pose: &Pose) {
        let by_person = self.state.driven_by == DrivenBy::Person.wire();
        match self.state.arrival() {
            Arrival::LegDriven if rests(pose) && !by_person => self.turn(pose),
            Arrival::StateLost => self.state.leg = self.legs.find(pose),
            _ => {}
        }
        if self.legs.enter(&self.state, by_person, &mut self.config) {
            self.planner.turn(&self.config);
        }
        self.config.goal = self.legs.goal(self.goals[self.goal_index()], &self.state.back);
    }

    /// The decisions in their order; an error is the reason to block the wheels.
    fn decide(
        &mut self,
        pose: &Pose,
        obstacles: &Obstacles,
        period_s: f64,
        budget: &Budget,
        command: &mut Command,
    ) -> Result<Choice, StopReason> {
        let rests = rests(pose);
        let arrival = self.state.arrival();
        let by_person = self.state.driven_by == DrivenBy::Person.wire();
        match arrival {
            // A person may drive on from there; the controller decides anew when it drives again.
            Arrival::Landed if by_person => {}
            Arrival::Landed => self.leave(pose.header.acquired_ns, rests)?,
            Arrival::StateLost if !rests => return Err(StopReason::StateLost),
            Arrival::StateLost => self.state.arrival = Arrival::OnTheWay.wire(),
            Arrival::LegDriven if !by_person => return Err(StopReason::Reversal),
            Arrival::OnTheWay | Arrival::Passed | Arrival::LegDriven => {}
        }
        let scanner = &obstacles.scanner;
        // Bodies that a faulty scanner shows may contradict the pose: then the scanner is the reason.
        let initial = start::read(&self.config, pose, obstacles, &self.state, &mut self.predicted)
            .map_err(|reason| if scanner.state().is_stop() { StopReason::Scanner } else { reason })?;
        if arrival == Arrival::StateLost {
            self.find_goal(initial.x);
        }
        self.smooth(pose.predicted_ns);
        // Where the place is not known, no goal is reached.
        if pose.alarm == Alarm::Stop.wire() {
            return Err(StopReason::SelfCheck);
        }
        if !by_person {
            self.arrive(&initial, pose.predicted_speed_mps, period_s)?;
        }
        let moves = self.predicted.iter().any(PredictedObstacle::moves);
        let driven = [self.legs.is_reverse(), moves];
        let mut start = Start::new(&self.config, pose, scanner, initial, period_s, driven)?;
        (command.speed_limit_mps, command.margin) =
            (start.limit_mps, start.margin.at(0.0, pose.predicted_speed_mps.abs()));
        if by_person {
            return self.follow_person(&start, pose, command);
        }
        self.find_reference_path(&start);
        command.side = self.nearest_side(&initial);
        if (!self.reference_path.clear || !self.reference_path.limits.is_empty())
            && let Some(choice) = self.continue_plan(&start, pose, budget, command)
        {
            command.margin = start.margin.at(0.0, self.planner.controls[0].velocity);
            return Ok(choice);
        }
        let unhurried = start;
        if !self.reference_path.clear {
            let scene = start.scene(&self.config, &self.predicted);
            let approach_mps = start.stopping.speed(scene.free_ahead() - start.margin.base() - STOP_MARGIN_M);
            let slowest = self.config.vehicle.bounds.velocity_min_mps;
            start.limit_mps =
                start.limit_mps.min(self.config.stop.approach_mps).min(approach_mps).max(slowest);
        }
        let (choice, margin) = match self.wait_or_plan(&start, pose, budget, command) {
            Ok(choice) => (choice, start.margin),
            Err(reason) => self.escape(&unhurried, pose, budget, command).ok_or(reason)?,
        };
        command.margin = margin.at(0.0, self.planner.controls[0].velocity);
        // The solver may have chosen another side than the search.
        command.side = self.nearest_side(&initial);
        Ok(choice)
    }

    /// Passes unless the drive is paused: then a plan is made, so that all is ready, and not driven.
    fn may_drive(&self, choice: Choice) -> Result<Choice, StopReason> {
        match DrivenBy::try_from(self.state.driven_by) {
            Ok(DrivenBy::Controller | DrivenBy::Person) => Ok(choice),
            Ok(DrivenBy::Nobody) | Err(_) => Err(StopReason::Paused),
        }
    }

    /// Smooths the ellipses of this scan, whose plan starts at `start_ns`.
    fn smooth(&mut self, start_ns: u64) {
        let elapsed_s = start_ns.saturating_sub(self.state.started_ns) as f64 * 1e-9;
        self.state.started_ns = start_ns;
        let Self { state, predicted, config, .. } = self;
        smoothing::smooth(&mut state.ellipses, predicted, elapsed_s, config.smoothing_s);
    }

    /// Time between the last two scans [s]. Scans that follow each other much faster than the scan period, after a gap, do
    /// not promise that the next one does.
    fn period(&self, pose: &Pose) -> f64 {
        let since = pose.header.acquired_ns.saturating_sub(self.state.acquired_ns) as f64 * 1e-9;
        let shortest = self.config.period_s / 2.0;
        if self.state.acquired_ns != 0 && (shortest..=1.0).contains(&since) {
            since
        } else {
            self.config.period_s
        }
    }

    fn drive(&mut self, choice: Choice, command: &mut Command) {
        let Planner { controls, rollout, .. } = &self.planner;
        let Choice { level, verified } = choice;
        let intervals = verified.intervals().min(controls.len());
        for (index, state) in rollout.nodes.iter().enumerate().take(intervals + 1) {
            // The last node repeats the control before it: nothing is planned behind it.
            let control = controls[index.min(intervals.max(1) - 1)];
            self.state.plan[index] = PlanNode {
                x_m: state.x,
                y_m: state.y,
                yaw_rad: state.yaw,
                sideslip_rad: state.sideslip,
                yaw_rate_radps: state.yaw_rate,
                velocity_mps: control.velocity,
                steering_rad: control.steering,
            };
            let State { x, y, yaw, .. } = self.config.course.in_plane(state);
            command.plan[index] = PlanNode { x_m: x, y_m: y, yaw_rad: yaw, ..self.state.plan[index] };
        }
        // Nodes behind the end are zero, as in the command.
        self.state.plan[intervals + 1..].fill(PlanNode::default());
        command.plan_length = intervals as u32 + 1;
        command.kind = CommandKind::Drive.wire();
        command.level = level.wire();
        command.reason = StopReason::None.wire();
        // The wheels get the control that was verified: there is no `Choice` without the evidence.
        let Control { velocity, steering } = verified.first();
        (command.velocity_mps, command.steering_rad, command.verified) = (velocity, steering, 1);

        for (index, obstacle) in self.predicted.iter().enumerate() {
            smoothing::grow(&mut self.state.ellipses, obstacle.id, self.planner.grown(index));
        }
        let state = &mut self.state;
        (state.arrival, state.blocked_scans, state.clear_scans) = (Arrival::OnTheWay.wire(), 0, 0);
        (state.velocity_mps, state.steering_rad) = (command.velocity_mps, command.steering_rad);
        state.plan_length = command.plan_length;
        state.plan_start_ns = command.plan_start_ns;
        state.plan_interval_s = command.plan_interval_s;
    }

    fn stop(&mut self, reason: StopReason, command: &mut Command) {
        command.kind =
            if reason == StopReason::Landed { CommandKind::Land } else { CommandKind::Stop }.wire();
        command.level = Level::Stop.wire();
        command.reason = reason.wire();
        let state = &mut self.state;
        match reason {
            StopReason::Landed => state.arrival = Arrival::Landed.wire(),
            StopReason::GoalPassed => state.arrival = Arrival::Passed.wire(),
            StopReason::Reversal => state.arrival = Arrival::LegDriven.wire(),
            StopReason::Blocked => state.blocked_scans = state.blocked_scans.saturating_add(1),
            _ => {}
        }
        // At standstill there is no previous control, and an old plan does not start from there.
        (state.velocity_mps, state.steering_rad) = (0.0, 0.0);
        state.plan_length = 0;
    }
}

/// Whether the robot rests, and will when the command acts.
fn rests(pose: &Pose) -> bool {
    pose.speed_mps.abs() < REST_MPS && pose.predicted_speed_mps.abs() < REST_MPS
}

pub use stopped::StopNumber;

mod back;
mod goals;
mod paths;
mod plans;
mod stopped;
#[cfg(test)]
mod tests;
