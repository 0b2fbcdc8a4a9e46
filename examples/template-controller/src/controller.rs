//! The decisions for one scan, in their order: stop, land, or drive a verified plan, one's own or a person's.

use shared_types::{
    Alarm, Command, CommandKind, DrivenBy, Flag, GivenControl, GivenGoal, Level, Obstacles, PlanNode, Pose,
    ScannerHealth, ScannerState, StopReason, plain_state,
};
use vehicle::Control;

use crate::planner::{Plan, hold, plans};
use crate::settings::{Goal, Settings};
use crate::verify::{Scene, Verified};

/// A centre that is further outside of the track contradicts it [m].
const ASTRAY_M: f64 = 1.0;
/// A body that overlaps an obstacle by more contradicts it [m].
const OVERLAP_M: f64 = 0.03;
/// Shares of the velocity that a person asks for that are tried: it gets slower before an obstacle.
const SLOWER: [f64; 4] = [1.0, 0.6, 0.3, 0.1];

plain_state! {
    /// What is saved after each scan. A process that takes the place of this one continues from it.
    pub struct Memory {
        /// The line that was pursued in the last scan [m]
        pub line_m: f64,
        /// Whether the robot has landed: it then stays where it is
        pub landed: Flag,
        /// Who drives, `DrivenBy`
        pub driven_by: u32,
        /// What a person who drives asks for
        pub person: GivenControl,
        /// The goal that was set last while driving
        pub given: GivenGoal,
        /// The first scan of the set goal that the robot drives to; 0 while it is that of the settings
        pub goal_from: u64,
    }
}

/// From pose and obstacles to a command.
#[derive(Clone)]
pub(crate) struct Controller {
    settings: Settings,
    period_ns: u64,
    period_s: f64,
    /// What the next scan depends on.
    pub(crate) memory: Memory,
}

impl Controller {
    /// A controller that has not seen a scan.
    pub(crate) fn new(settings: Settings, period_ns: u64) -> Self {
        let memory = Memory { line_m: settings.goal.y_m, ..Memory::default() };
        Self { settings, period_ns, period_s: period_ns as f64 * 1e-9, memory }
    }

    /// Takes a goal that was set while driving; it counts from its scan on.
    pub(crate) fn give(&mut self, goal: &GivenGoal) {
        // This controller drives to the first goal only.
        if goal.index == 0 && goal.is_newer(&self.memory.given) {
            self.memory.given = *goal;
        }
    }

    /// Drives to the set goal from its scan on, also where it has landed at the one before.
    fn heed_goal(&mut self, scan_id: u64) {
        let Memory { given, goal_from, .. } = self.memory;
        if given.from_scan == 0 || scan_id < given.from_scan {
            return;
        }
        self.settings.goal = Goal { x_m: given.x_m, y_m: given.y_m, tolerance_m: given.tolerance_m };
        if given.from_scan > goal_from {
            self.memory =
                Memory { line_m: given.y_m, landed: false.into(), goal_from: given.from_scan, ..self.memory };
        }
    }

    /// The command for one scan.
    pub(crate) fn step(&mut self, pose: &Pose, obstacles: &Obstacles) -> Command {
        self.heed_goal(obstacles.header.scan_id);
        // First the sample that comes last: it has the stamps of more stages.
        let header = obstacles.header.answer_both(&pose.header);
        let by_person = self.memory.driven_by == DrivenBy::Person.wire();
        let level = if by_person { Level::Person } else { Level::BestIterate };
        let command = match self.decide(pose, obstacles, by_person) {
            Ok((plan, verified)) => drive(&plan, &verified, level, pose.predicted_ns),
            Err(reason) => stop(reason),
        };
        self.memory.landed = (command.kind == CommandKind::Land.wire()).into();
        Command { header, ..command }
    }

    /// A plan that has passed the check, or the reason to block the wheels.
    fn decide(
        &mut self,
        pose: &Pose,
        obstacles: &Obstacles,
        by_person: bool,
    ) -> Result<(Plan, Verified), StopReason> {
        // A person drives on from the goal, and past it.
        if self.memory.landed.is_set() && !by_person {
            return Err(StopReason::Landed);
        }
        if self.memory.driven_by == DrivenBy::Nobody.wire() {
            return Err(StopReason::Paused);
        }
        let scene = Scene::new(&self.settings, pose, obstacles);
        if scene.outside_m(&scene.start) > ASTRAY_M || scene.overlap_m() > OVERLAP_M {
            return Err(StopReason::BadInput);
        }
        if !by_person {
            self.arrive(pose)?;
        }
        if pose.alarm == Alarm::Stop.wire() {
            return Err(StopReason::SelfCheck);
        }
        if !self.sees_enough(pose, &obstacles.scanner) {
            return Err(StopReason::Scanner);
        }
        if by_person {
            return self.follow_person(pose, obstacles);
        }
        let velocity_mps = self.velocity_mps(pose, &obstacles.scanner);
        let plans = plans(&self.settings, scene.start, velocity_mps, self.memory.line_m);
        for (line_m, plan) in plans {
            if let Some(verified) = scene.verify(&plan) {
                self.memory.line_m = line_m;
                return Ok((plan, verified));
            }
        }
        Err(StopReason::Blocked)
    }

    /// What a person asks for, held until the robot could stand behind it; slower where that may not be driven.
    fn follow_person(&self, pose: &Pose, obstacles: &Obstacles) -> Result<(Plan, Verified), StopReason> {
        let (person, bounds) = (&self.memory.person, &self.settings.vehicle.bounds);
        let is_fresh = person.is_fresh(pose.header.acquired_ns, self.period_ns);
        if !is_fresh || person.velocity_mps < bounds.velocity_min_mps {
            return Err(StopReason::Released);
        }
        let scene = Scene::without_goal(&self.settings, pose, obstacles);
        let fastest = self.fastest_mps(pose, &obstacles.scanner);
        let held = SLOWER.into_iter().find_map(|share| {
            let velocity = share * person.velocity_mps.min(fastest);
            let control = bounds.clamp(Control { velocity, steering: person.steering_rad });
            let plan = hold(control, 2.0 * self.period_s * velocity + self.braking_m(velocity));
            scene.verify(&plan).map(|verified| (plan, verified))
        });
        held.ok_or(StopReason::Blocked)
    }

    /// Lands when the robot comes to rest nearest to the goal if its wheels are blocked now.
    fn arrive(&self, pose: &Pose) -> Result<(), StopReason> {
        let goal = &self.settings.goal;
        let speed = pose.predicted_speed_mps;
        let left_m = goal.x_m - pose.predicted_x_m - self.braking_m(speed);
        // A scan later the robot would be further away, on the other side.
        if left_m > speed.max(self.settings.vehicle.bounds.velocity_min_mps) * self.period_s / 2.0 {
            return Ok(());
        }
        let miss_m = left_m.hypot(goal.y_m - pose.predicted_y_m);
        Err(if miss_m <= goal.tolerance_m { StopReason::Landed } else { StopReason::GoalPassed })
    }

    /// Whether the scanner works and the robot can stop within what it sees, two scans later.
    fn sees_enough(&self, pose: &Pose, scanner: &ScannerHealth) -> bool {
        let speed = pose.predicted_speed_mps.abs();
        let front_m = self.settings.vehicle.length_m / 2.0;
        let stop_m = front_m + 2.0 * self.period_s * speed + self.braking_m(speed);
        !scanner.state().is_stop() && scanner.seen_ahead_m > stop_m
    }

    /// Way to rest with blocked wheels [m].
    fn braking_m(&self, speed: f64) -> f64 {
        speed * speed / (2.0 * self.settings.vehicle.blocked_deceleration_mps2)
    }

    /// Cruising, and slower near the goal.
    fn velocity_mps(&self, pose: &Pose, scanner: &ScannerHealth) -> f64 {
        let settings = &self.settings;
        let landing = (settings.goal.x_m - pose.predicted_x_m) / settings.landing_time_s;
        landing.min(self.fastest_mps(pose, scanner)).max(settings.vehicle.bounds.velocity_min_mps)
    }

    /// Slower while the estimator suspects its calibration or the scanner is degraded.
    fn fastest_mps(&self, pose: &Pose, scanner: &ScannerHealth) -> f64 {
        let is_careful = pose.alarm != Alarm::None.wire() || scanner.state() != ScannerState::Healthy;
        if is_careful { self.settings.careful_mps } else { self.settings.cruise_mps }
    }
}

/// A command to drive the first control of a plan that has passed, with the plan in it.
fn drive(plan: &Plan, verified: &Verified, level: Level, start_ns: u64) -> Command {
    let controls = plan.controls();
    let mut command = Command {
        kind: CommandKind::Drive.wire(),
        level: level.wire(),
        verified: 1,
        velocity_mps: controls[0].velocity,
        steering_rad: controls[0].steering,
        plan_start_ns: start_ns,
        plan_interval_s: plan.interval_s,
        plan_length: verified.nodes().len() as u32,
        ..Command::default()
    };
    for (index, state) in verified.nodes().iter().enumerate() {
        // Nothing is planned behind the last node: it repeats the control before it.
        let control = controls[index.min(controls.len() - 1)];
        command.plan[index] = PlanNode {
            x_m: state.x,
            y_m: state.y,
            yaw_rad: state.yaw,
            sideslip_rad: state.sideslip,
            yaw_rate_radps: state.yaw_rate,
            velocity_mps: control.velocity,
            steering_rad: control.steering,
        };
    }
    command
}

/// A command to block the wheels.
fn stop(reason: StopReason) -> Command {
    let kind = if reason == StopReason::Landed { CommandKind::Land } else { CommandKind::Stop };
    Command { kind: kind.wire(), level: Level::Stop.wire(), reason: reason.wire(), ..Command::default() }
}
