//! Forwards or backwards: the legs of the course, and the settings with which each is driven.
//!
//! A robot that drives backwards moves as one that is turned round and drives forwards, with its axles exchanged and its
//! steering the other way. So a leg that is driven backwards is planned for that robot: the pose is turned round before,
//! and the command behind it.

use shared_types::{Command, Pose};
use vehicle::course::Leg;
use vehicle::{Course, Description, Goal, State, Track};

use crate::config::ControllerConfig;
use crate::state::ControllerState;
use crate::way_back::WayBack;

/// How far from the end of a leg the robot may change its direction of travel [m].
const TOLERANCE_M: f64 = 0.15;
/// How far behind a goal that was passed the robot turns [m].
const BEHIND_M: f64 = 3.0;
/// A goal so little behind the end of a leg is at its end [m].
const SAME_M: f64 = 1e-3;

/// The legs of a course.
#[derive(Debug, Clone)]
pub(crate) struct Legs {
    legs: Vec<Leg>,
    /// Each leg from its end to its begin.
    returns: Vec<Course>,
    forwards: Driving,
    backwards: Driving,
    track: Track,
    entered: Entered,
}

/// What the settings are for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Entered {
    leg: usize,
    /// Whether the robot is turned round.
    turned: bool,
    /// Whether it drives back out of a dead end.
    returns: bool,
}

/// What differs between forwards and backwards.
#[derive(Debug, Clone, Copy)]
struct Driving {
    vehicle: Description,
    cruise_mps: f64,
    careful_mps: f64,
}

impl Legs {
    /// The legs of the course of `config`, which is for the first one from now on.
    pub(crate) fn new(config: &mut ControllerConfig) -> Self {
        let legs = config.course.legs();
        let ControllerConfig { vehicle, cruise_mps, careful_mps, .. } = *config;
        let bounds = vehicle.bounds.mirrored().unwrap_or(vehicle.bounds);
        let turned = vehicle.mirrored(bounds);
        let slower = |velocity: f64| velocity.min(bounds.velocity_max_mps);
        let backwards =
            Driving { vehicle: turned, cruise_mps: slower(cruise_mps), careful_mps: slower(careful_mps) };
        let returns = legs.iter().map(|leg| leg.course.returned(config.track.x_m)).collect();
        config.course = legs[0].course.clone();
        let forwards = Driving { vehicle, cruise_mps, careful_mps };
        Self { legs, returns, forwards, backwards, track: config.track, entered: Entered::default() }
    }

    /// Whether the vehicle drives backwards at all.
    pub(crate) fn can_return(&self) -> bool {
        self.forwards.vehicle.bounds.mirrored().is_some() && !self.entered.turned
    }

    /// The settings of what the robot drives in `config`; true where they are others than before. A person drives forwards
    /// on each leg.
    pub(crate) fn enter(
        &mut self,
        state: &ControllerState,
        by_person: bool,
        config: &mut ControllerConfig,
    ) -> bool {
        let leg = (state.leg as usize).min(self.legs.len() - 1);
        let returns = state.back.drives == 1 && !by_person;
        let turned = returns || self.legs[leg].is_reverse && !by_person;
        let entered = Entered { leg, turned, returns };
        if entered == self.entered {
            return false;
        }
        self.entered = entered;
        let Driving { vehicle, cruise_mps, careful_mps } =
            if turned { self.backwards } else { self.forwards };
        let course = if returns { &self.returns[leg] } else { &self.legs[leg].course };
        config.course.clone_from(course);
        (config.vehicle, config.cruise_mps, config.careful_mps) = (vehicle, cruise_mps, careful_mps);
        config.track = self.track;
        if returns {
            config.track.y_m = self.track.y_m.map(|side| -side);
            config.track.y_m.reverse();
        }
        true
    }

    /// Whether the robot can come back to a goal of this course from behind it, over a way of at most `back_m`.
    pub(crate) fn can_come_back(&self, goal: &Goal, back_m: f64) -> bool {
        let course = &self.legs[0].course;
        let last_m = if course.is_line() { self.track.x_m[1] } else { course.length_m() };
        self.legs.len() == 1
            && self.can_return()
            && goal.yaw_rad.is_none()
            && BEHIND_M <= back_m
            && goal.x_m + BEHIND_M < last_m
    }

    /// How fast the robot drives backwards [m/s].
    pub(crate) fn reverse_mps(&self) -> f64 {
        self.backwards.cruise_mps
    }

    /// Whether the robot drives backwards.
    pub(crate) fn is_reverse(&self) -> bool {
        self.entered.turned
    }

    /// A place along the leg, seen from its other end [m].
    pub(crate) fn seen_from_end(&self, along_m: f64) -> f64 {
        let course = &self.legs[self.entered.leg].course;
        let [begin_m, end_m] =
            if course.is_line() { self.track.x_m } else { [course.begin_m(), course.length_m()] };
        begin_m + end_m - along_m
    }

    /// Whether the robot changes its direction of travel before it gets to a goal.
    pub(crate) fn ends_before(&self, goal: &Goal) -> bool {
        self.entered.returns || goal.x_m > self.legs[self.entered.leg].end_m + SAME_M
    }

    /// Where the robot lands: at the goal, or at the end of the leg, or of the way back.
    pub(crate) fn goal(&self, goal: Goal, back: &WayBack) -> Goal {
        let [x_m, y_m] = match self.entered {
            Entered { returns: true, .. } => [self.seen_from_end(back.to_m[0]), -back.to_m[1]],
            _ if back.overshoots() => [goal.x_m + BEHIND_M, goal.y_m],
            Entered { leg, .. } if self.ends_before(&goal) => [self.legs[leg].end_m, 0.0],
            _ => return goal,
        };
        Goal { x_m, y_m, tolerance_m: TOLERANCE_M, ..Goal::default() }
    }

    /// The leg on which a robot that has lost its state is most likely.
    pub(crate) fn find(&self, pose: &Pose) -> u32 {
        let misfit = |leg: &Leg| {
            let pose = if leg.is_reverse { turned(pose) } else { *pose };
            let state = State {
                x: pose.predicted_x_m,
                y: pose.predicted_y_m,
                yaw: pose.predicted_yaw_rad,
                ..State::default()
            };
            let place = leg.course.on_course(&state, leg.course.find(&state));
            place.y.abs() + place.yaw.abs() + (place.x - leg.end_m).max(0.0)
        };
        let nearest =
            self.legs.iter().enumerate().min_by(|one, other| misfit(one.1).total_cmp(&misfit(other.1)));
        nearest.map_or(0, |(index, _)| index as u32)
    }
}

/// The pose of the robot turned round.
pub(crate) fn turned(pose: &Pose) -> Pose {
    let turn = |yaw: f64| State { yaw, ..State::default() }.mirrored().yaw;
    Pose {
        yaw_rad: turn(pose.yaw_rad),
        predicted_yaw_rad: turn(pose.predicted_yaw_rad),
        speed_mps: -pose.speed_mps,
        predicted_speed_mps: -pose.predicted_speed_mps,
        ..*pose
    }
}

/// Makes the command for the robot turned round that of the robot.
pub(crate) fn turn_back(command: &mut Command) {
    (command.velocity_mps, command.steering_rad) = (-command.velocity_mps, -command.steering_rad);
    for node in &mut command.plan[..command.plan_length as usize] {
        node.yaw_rad = State { yaw: node.yaw_rad, ..State::default() }.mirrored().yaw;
        (node.velocity_mps, node.steering_rad) = (-node.velocity_mps, -node.steering_rad);
    }
}
