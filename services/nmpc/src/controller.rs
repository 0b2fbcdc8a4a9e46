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

use ocp::Budget;
use shared_types::{
    Alarm, Blocking, Command, CommandKind, DrivenBy, GivenControl, GivenGoal, Level, MAX_OBSTACLES,
    Obstacles, PLAN_NODES, PlanNode, Pose, StopReason,
};
use vehicle::{Control, Goal, Invalid, State};

use crate::blocking::blocking;
use crate::braking::STOP_MARGIN_M;
use crate::by_person;
use crate::config::{ControllerConfig, SideRule};
use crate::contest::Contest;
use crate::escape::struck_at_rest;
use crate::explicit_side;
use crate::gear::{self, Legs};
use crate::landing::{Approach, approach};
use crate::lattice::Search;
use crate::margin::MarginModel;
use crate::planner::{Choice, Planner, Task};
use crate::predicted_obstacle::PredictedObstacle;
use crate::query::Query;
use crate::reference_path::ReferencePath;
use crate::scene::{REST_MPS, Scene};
use crate::side::{self, Passing, held};
use crate::smoothing;
use crate::start::{self, Start};
use crate::state::{Arrival, ControllerState};
use crate::stop_rule::blocked_by;
use crate::warm;

/// Velocities at which a path past moving obstacles is searched, as shares of the cruising velocity.
const SLOWER: [f64; 4] = [1.0, 0.6, 0.35, 0.15];
/// A moving obstacle is passed on the other side when that costs less than this share.
const SWITCH_SHARE: f64 = 0.8;
/// A plan that the search does not agree with may have this slack.
const CONTINUED_SLACK: f64 = 0.01;
/// Blocked wheels that slide further than this are worth a slower plan [m].
const SLIDE_M: f64 = 0.2;
/// A way to the goal that begins so much slower than the robot is comes too late [m/s]: the robot is beside the obstacles.
const SUDDEN_MPS: f64 = 0.2;
/// Nearer to the goal no slow way is looked for [m]: a robot that creeps beside a body that moves unnoticed is touched.
const SLOW_WAY_M: f64 = 2.0;
/// A body that blocks the way and came less than this ago may go again [s].
const COMES_AND_GOES_S: f64 = 6.5;
/// Share of the drive's largest deceleration with which a path slows down for a narrow place.
const SLOWING_SHARE: f64 = 0.35;

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
        if !by_person {
            self.arrive(&initial, pose.predicted_speed_mps, period_s)?;
        }
        if pose.alarm == Alarm::Stop.wire() {
            return Err(StopReason::SelfCheck);
        }
        let mut start = Start::new(&self.config, pose, scanner, initial, period_s, self.legs.is_reverse())?;
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

    /// What a person asks for as a plan of one interval, which is verified as any other; slower where that is not refused.
    fn follow_person(
        &mut self,
        start: &Start,
        pose: &Pose,
        command: &mut Command,
    ) -> Result<Choice, StopReason> {
        let Self { config, predicted, planner, state, .. } = self;
        let scene = start.scene(config, predicted);
        let period_ns = (config.period_s * 1e9) as u64;
        let asked = by_person::asked(&scene, &state.person, pose.header.acquired_ns, period_ns);
        let (choice, index) = by_person::follow(&scene, asked.ok_or(StopReason::Released)?, planner);
        command.blocking = index.map(|index| blocking(&scene, index)).unwrap_or_default();
        choice.ok_or(StopReason::Blocked)
    }

    /// Passes unless the drive is paused: then a plan is made, so that all is ready, and not driven.
    fn may_drive(&self, choice: Choice) -> Result<Choice, StopReason> {
        match DrivenBy::try_from(self.state.driven_by) {
            Ok(DrivenBy::Controller | DrivenBy::Person) => Ok(choice),
            Ok(DrivenBy::Nobody) | Err(_) => Err(StopReason::Paused),
        }
    }

    /// A plan that may be driven, unless the path is blocked, or was until lately.
    fn wait_or_plan(
        &mut self,
        start: &Start,
        pose: &Pose,
        budget: &Budget,
        command: &mut Command,
    ) -> Result<Choice, StopReason> {
        self.wait_until_clear().inspect_err(|_| {
            let scene = start.scene(&self.config, &self.predicted);
            let index = blocked_by(&scene, &[], start.stop_m(), f64::INFINITY);
            command.blocking = index.map(|index| blocking(&scene, index)).unwrap_or_default();
        })?;
        self.plan(start, pose, budget, command)
    }

    /// A plan out of the way of a body that would strike the robot if it stopped: past the obstacles with little clearance,
    /// or a turn that keeps the largest; with the margin that it keeps.
    fn escape(
        &mut self,
        start: &Start,
        pose: &Pose,
        budget: &Budget,
        command: &mut Command,
    ) -> Option<(Choice, MarginModel)> {
        let Self { config, search, predicted, reference_path, state, planner, .. } = self;
        let scene = start.scene(config, predicted);
        let stopped_m = struck_at_rest(&scene, &start.stopping)?;
        let (speed, sides) = (config.cruise_mps.min(start.limit_mps), &state.sides);
        let bare = scene.keeping(start.margin.bare(), start.speed);
        search.find(&Query { scene: bare, speed, narrow: true, sides, forced: None }, reference_path);
        let task = Task::new(bare, reference_path, state, pose, start);
        let planned = if reference_path.clear { planner.plan(&task, budget, command) } else { None };
        if planned.is_some() {
            side::renew(&mut state.sides, predicted, |obstacle| reference_path.side_of(obstacle));
        }
        let task = Task::new(scene, reference_path, state, pose, start);
        let escape = match planned {
            Some(choice) => (choice, bare.margin),
            None => (planner.escape(&task, stopped_m)?, start.margin.none()),
        };
        command.blocking = Blocking::default();
        Some(escape)
    }

    /// The last plan, corrected, where it leads past the obstacles although the search found no path: the search is
    /// coarser than a plan that drives along an ellipse.
    fn continue_plan(
        &mut self,
        start: &Start,
        pose: &Pose,
        budget: &Budget,
        command: &mut Command,
    ) -> Option<Choice> {
        let Self { config, predicted, alternative, state, planner, .. } = self;
        alternative.set_line(start.initial.x, config.goal.y_m, config.cruise_mps.min(start.limit_mps));
        let scene = start.scene(config, predicted);
        let task = Task::new(scene, alternative, state, pose, start);
        let choice = planner.continue_plan(&task, budget, &mut 0, command)?;
        let is_open = choice.level == Level::Converged
            && command.slack < CONTINUED_SLACK
            && planner.is_fast()
            && blocked_by(&scene, &planner.rollout.samples, start.stop_m(), f64::NEG_INFINITY).is_none();
        is_open.then_some(choice)
    }

    /// A plan that may be driven, unless the path is blocked.
    fn plan(
        &mut self,
        start: &Start,
        pose: &Pose,
        budget: &Budget,
        command: &mut Command,
    ) -> Result<Choice, StopReason> {
        let other = self.cost_of_alternative(start, pose, budget, command);
        let Self { config, predicted, reference_path, alternative, contest, state, planner, .. } = self;
        let scene = start.scene(config, predicted);
        let task = Task::new(scene, reference_path, state, pose, start);
        let mut choice = planner.plan(&task, budget, command);
        let own = choice.filter(|choice| choice.level == Level::Converged).map(|_| command.objective);
        if let Some(contest) = contest {
            command.sides = contest.compare(own, other);
        }
        if let (Some(contest), Some(other)) = (contest, other)
            && own.is_none_or(|own| contest.share * own > other)
        {
            std::mem::swap(reference_path, alternative);
            side::renew(&mut state.sides, predicted, |obstacle| reference_path.side_of(obstacle));
            let task = Task::new(scene, reference_path, state, pose, start);
            choice = planner.plan(&task, budget, command);
        }
        let mut task = Task::new(scene, reference_path, state, pose, start);
        // Where blocked wheels slide far, a slower plan may keep clear although the fast one does not.
        let slowest = config.vehicle.bounds.velocity_min_mps;
        while choice.is_none()
            && start.stopping.slide(task.fastest_mps) > SLIDE_M
            && task.fastest_mps > slowest
        {
            task.fastest_mps = (task.fastest_mps / 2.0).max(slowest);
            choice = planner.plan(&task, budget, command);
        }
        let plan = if choice.is_some() { planner.rollout.samples.as_slice() } else { &[] };
        let follows_reference =
            choice.is_some() && reference_path.clear && warm::agrees(&scene, reference_path, plan);
        // Without a plan the robot stops at once, so no slack is accepted.
        let slack = if choice.is_some() { command.slack - config.stop.slack } else { f64::INFINITY };
        let is_open = follows_reference || (choice.is_none() && reference_path.clear);
        let refused_for = planner.refused_for;
        if !is_open && let Some(index) = blocked_by(&scene, plan, start.stop_m(), slack) {
            command.blocking = blocking(&scene, index);
            return Err(StopReason::Blocked);
        }
        choice.ok_or_else(|| {
            command.blocking = refused_for.map(|index| blocking(&scene, index)).unwrap_or_default();
            if planner.comes_unseen { StopReason::Unseen } else { StopReason::Unverified }
        })
    }

    /// Objective of a plan along the alternative; `None` without one that can be driven.
    fn cost_of_alternative(
        &mut self,
        start: &Start,
        pose: &Pose,
        budget: &Budget,
        command: &mut Command,
    ) -> Option<f64> {
        self.contest?;
        let Self { config, predicted, alternative, state, planner, .. } = self;
        let task = Task::new(start.scene(config, predicted), alternative, state, pose, start);
        let choice = planner.plan(&task, budget, command)?;
        (choice.level == Level::Converged).then_some(command.objective)
    }

    /// Smooths the ellipses of this scan, whose plan starts at `start_ns`.
    fn smooth(&mut self, start_ns: u64) {
        let elapsed_s = start_ns.saturating_sub(self.state.started_ns) as f64 * 1e-9;
        self.state.started_ns = start_ns;
        let Self { state, predicted, config, .. } = self;
        smoothing::smooth(&mut state.ellipses, predicted, elapsed_s, config.smoothing_s);
    }

    /// Which goal the robot drives to, or stands at.
    fn goal_index(&self) -> usize {
        usize::try_from(self.state.goal).map_or(0, |index| index.min(self.goals.len() - 1))
    }

    /// Puts the given goal in its place from its scan on. A robot that stood at the one before drives again.
    fn heed_goal(&mut self, scan_id: u64) {
        let given = self.state.given;
        if given.from_scan <= self.given_from || scan_id < given.from_scan {
            return;
        }
        self.given_from = given.from_scan;
        let index = usize::try_from(given.index).unwrap_or(usize::MAX);
        let Some(goal) = self.goals.get_mut(index) else { return };
        let replaced = std::mem::replace(goal, goal_of(&given));
        let arrival = self.state.arrival();
        // A successor that finds the goal in its settings has nothing to leave.
        if index == self.goal_index()
            && replaced != self.goals[index]
            && matches!(arrival, Arrival::Landed | Arrival::Passed)
        {
            (self.state.arrival, self.state.rested_ns) = (Arrival::OnTheWay.wire(), 0);
        }
    }

    /// Stays at a goal as long as it demands, then drives to the next one; at the last one for good.
    fn leave(&mut self, now_ns: u64, rests: bool) -> Result<(), StopReason> {
        if self.goal_index() + 1 == self.goals.len() {
            return Err(StopReason::Landed);
        }
        let state = &mut self.state;
        if state.rested_ns == 0 && rests {
            state.rested_ns = now_ns;
        }
        let stay_ns = (self.config.goal.stay_s * 1e9) as u64;
        if state.rested_ns == 0 || now_ns.saturating_sub(state.rested_ns) < stay_ns {
            return Err(StopReason::Landed);
        }
        (state.arrival, state.rested_ns) = (Arrival::OnTheWay.wire(), 0);
        self.drive_to(self.goal_index() + 1);
        Ok(())
    }

    /// After the state was lost: the first goal that is not behind the robot.
    fn find_goal(&mut self, along_m: f64) {
        let is_ahead = |goal: &Goal| along_m <= goal.x_m + goal.tolerance_m;
        self.drive_to(self.goals.iter().position(is_ahead).unwrap_or(self.goals.len() - 1));
    }

    fn drive_to(&mut self, index: usize) {
        self.state.goal = index as u64;
        self.config.goal = self.legs.goal(self.goals[index], &self.state.back);
    }

    /// Lands, or stops behind the goal; a goal that was passed stays passed until the robot is well before it.
    fn arrive(&self, initial: &State, speed: f64, period_s: f64) -> Result<(), StopReason> {
        let goal = &self.config.goal;
        let is_leg_end = self.legs.ends_before(&self.goals[self.goal_index()]);
        match approach(goal, initial, speed, period_s, &self.config.vehicle) {
            Approach::Land | Approach::Passed if is_leg_end => Err(StopReason::Reversal),
            Approach::Land => Err(StopReason::Landed),
            Approach::Passed => Err(StopReason::GoalPassed),
            Approach::Ahead
                if self.state.arrival() == Arrival::Passed
                    && goal.x_m - initial.x < 2.0 * goal.tolerance_m =>
            {
                Err(StopReason::GoalPassed)
            }
            Approach::Ahead => Ok(()),
        }
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

    /// Finds the reference path, and with it the passing sides.
    fn find_reference_path(&mut self, start: &Start) {
        let (config, predicted) = (&self.config, &self.predicted);
        let (goal, initial) = (&config.goal, &start.initial);
        let cruise = config.cruise_mps.min(start.limit_mps);
        let slowest = config.vehicle.bounds.velocity_min_mps;
        let reach = initial.x + config.guide.range_m;
        let (low, high) = (initial.y.min(goal.y_m) - 0.1, initial.y.max(goal.y_m) + 0.1);
        let margin = config.ellipse_margin_m + config.guide.comfort_m + start.margin.growth(0.0, cruise);
        let in_the_way = |obstacle: &PredictedObstacle| {
            let [x, y] = obstacle.centre;
            obstacle.moves()
                || (x - obstacle.a < reach
                    && x + obstacle.a + margin > initial.x
                    && y - obstacle.b - margin < high
                    && y + obstacle.b + margin > low)
        };
        if config.side != SideRule::Search {
            let scene = start.scene(config, predicted);
            explicit_side::find(&scene, &self.state.sides, cruise, &mut self.reference_path);
        } else if predicted.iter().any(in_the_way) {
            let scene = start.scene(config, predicted);
            let mut find = |speed: f64, narrow: bool| {
                let query = Query { scene, speed, narrow, sides: &self.state.sides, forced: None };
                self.search.find(&query, &mut self.reference_path);
                self.reference_path.clear
            };
            let moving = predicted.iter().any(PredictedObstacle::moves);
            if moving {
                self.find_way_past_moving(start, [slowest, cruise]);
            } else if !find(cruise, false) && find(slowest, true) {
                slow_down(&mut self.reference_path, &scene, [slowest, cruise]);
            }
            if self.reference_path.clear && self.reference_path.misses_goal && !moving {
                self.find_way_to_goal(start, [slowest, cruise]);
            }
            if !self.reference_path.clear {
                // It leads to what blocks it, as fast as that can be stopped for.
                self.reference_path.speed = cruise;
            }
        } else {
            self.reference_path.set_line(initial.x, goal.y_m, cruise);
        }
        self.find_alternative(start);
        let choose = |obstacle: &PredictedObstacle| self.reference_path.side_of(obstacle);
        side::renew(&mut self.state.sides, &self.predicted, choose);
    }

    /// The fastest path past bodies that move which leads to the goal; without one, the fastest that is clear.
    fn find_way_past_moving(&mut self, start: &Start, [slowest, cruise]: [f64; 2]) {
        let Self { config, search, predicted, reference_path, alternative, state, .. } = self;
        let scene = start.scene(config, predicted);
        let mut is_found = false;
        for share in SLOWER {
            let speed = (cruise * share).max(slowest);
            let query = Query { scene, speed, narrow: true, sides: &state.sides, forced: None };
            search.find(&query, alternative);
            let arrives = alternative.clear && !alternative.misses_goal;
            if arrives || !is_found {
                std::mem::swap(reference_path, alternative);
                is_found = reference_path.clear;
            }
            if arrives {
                break;
            }
        }
    }

    /// Where the path passes the goal too far away: one that leads to it, between ellipses that are no longer than they must
    /// be, and slow in narrow places if need be. The ellipses stay so for this scan.
    fn find_way_to_goal(&mut self, start: &Start, [slowest, cruise]: [f64; 2]) {
        let Self { config, search, predicted, reference_path, alternative, state, .. } = self;
        let mut axes = [0.0; MAX_OBSTACLES];
        for (axis, obstacle) in axes.iter_mut().zip(predicted.iter_mut()) {
            *axis = obstacle.a;
            obstacle.shorten(config.vehicle.length_m);
        }
        let scene = start.scene(config, predicted);
        let is_far = config.goal.x_m - start.initial.x > SLOW_WAY_M;
        let is_found = [cruise, slowest].into_iter().take(1 + usize::from(is_far)).any(|speed| {
            let query = Query { scene, speed, narrow: true, sides: &state.sides, forced: None };
            search.find(&query, alternative);
            if !alternative.clear || alternative.misses_goal {
                return false;
            }
            if speed < cruise {
                slow_down(alternative, &scene, [slowest, cruise]);
            }
            alternative.speed_at(start.initial.x) > start.speed - SUDDEN_MPS
        });
        if is_found {
            std::mem::swap(reference_path, alternative);
        } else {
            predicted.iter_mut().zip(axes).for_each(|(obstacle, axis)| obstacle.a = axis);
        }
    }

    /// Finds a path on the other side of the nearest obstacle whose side is not held, or that moves.
    fn find_alternative(&mut self, start: &Start) {
        self.contest = None;
        let (config, predicted, path) = (&self.config, &self.predicted, &self.reference_path);
        let is_searched = config.side == SideRule::Search;
        if !is_searched || !path.clear || !path.limits.is_empty() || path.y.len() < 2 {
            return;
        }
        let open =
            |obstacle: &&PredictedObstacle| obstacle.moves() || held(&self.state.sides, obstacle).is_none();
        let ahead = |obstacle: &&PredictedObstacle| obstacle.centre[0] > start.initial.x;
        let nearest = predicted
            .iter()
            .filter(ahead)
            .filter(open)
            .min_by(|one, other| one.centre[0].total_cmp(&other.centre[0]));
        let Some((obstacle, side)) = nearest.and_then(|obstacle| Some((obstacle, path.side_of(obstacle)?)))
        else {
            return;
        };
        let query = Query {
            scene: start.scene(config, predicted),
            speed: path.speed,
            narrow: false,
            sides: &self.state.sides,
            forced: Some((obstacle.id, side.other())),
        };
        self.search.find(&query, &mut self.alternative);
        let is_as_good = self.alternative.clear && (path.misses_goal || !self.alternative.misses_goal);
        if is_as_good && self.alternative.side_of(obstacle) == Some(side.other()) {
            let is_held = held(&self.state.sides, obstacle).is_some();
            let share = if is_held { SWITCH_SHARE } else { 1.0 };
            self.contest = Some(Contest { id: obstacle.id, side, share });
        }
    }

    /// Side on which the nearest obstacle that the line leads through is passed.
    fn nearest_side(&self, initial: &State) -> i32 {
        let line = self.config.goal.y_m;
        let in_the_way = |obstacle: &&PredictedObstacle| {
            obstacle.centre[0] > initial.x
                && (obstacle.centre[1] - line).abs() < obstacle.b
                && held(&self.state.sides, obstacle).is_some()
        };
        let nearest =
            self.predicted.iter().filter(in_the_way).min_by(|a, b| a.centre[0].total_cmp(&b.centre[0]));
        nearest.and_then(|obstacle| held(&self.state.sides, obstacle)).map_or(0, Passing::wire)
    }

    /// After a stop in front of a blocked path: waits until the path was clear for several scans.
    fn wait_until_clear(&mut self) -> Result<(), StopReason> {
        if self.state.blocked_scans == 0 {
            return Ok(());
        }
        self.state.clear_scans =
            if self.reference_path.clear { self.state.clear_scans.saturating_add(1) } else { 0 };
        let stop = &self.config.stop;
        if self.state.blocked_scans < stop.hold_scans || self.state.clear_scans < stop.resume_scans {
            return Err(StopReason::Blocked);
        }
        Ok(())
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

/// A given goal as one of the settings.
fn goal_of(given: &GivenGoal) -> Goal {
    let GivenGoal { x_m, y_m, tolerance_m, yaw_rad, yaw_tolerance_rad, stay_s, .. } = *given;
    let yaw_rad = (given.has_yaw == 1).then_some(yaw_rad);
    Goal { x_m, y_m, tolerance_m, yaw_rad, yaw_tolerance_rad, stay_s }
}

/// Slows down along a path that was searched for the slowest speed, only where the margin of a faster one does not fit.
fn slow_down(path: &mut ReferencePath, scene: &Scene, speeds: [f64; 2]) {
    let deceleration = SLOWING_SHARE * scene.config.vehicle.deceleration_max_mps2;
    path.set_limits(deceleration, |x, y, course| scene.fastest_at(x, y, course, speeds));
}

mod back;
#[cfg(test)]
mod tests;
