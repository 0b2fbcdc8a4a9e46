//! What `scanloop top` shows, without terminal, bus and clock.

use std::collections::VecDeque;

use session::control::{EventRow, SystemStatus};
use shared_types::{Actuation, ActuationKind, Command, GivenGoal, Obstacles, Pose, Role, Scan, Truth};
use vehicle::course::CourseOutline;
use vehicle::frame::to_track;
use vehicle::{Description, Goal, State, Track};

use super::reasons::Reasons;

/// How many reaction times are kept: a minute at 10 Hz.
const MAX_REACTIONS: usize = 600;
/// How many events of this view are kept.
const MAX_NOTES: usize = 16;

/// What is shown.
#[derive(Default)]
pub(super) struct Model {
    /// Id of the system.
    pub(super) system_id: String,
    /// The last status that was received.
    pub(super) status: Option<SystemStatus>,
    /// Why there is no newer status.
    pub(super) trouble: Option<String>,
    /// The course and the robot as the controller knows them.
    pub(super) course: Course,
    pub(super) pose: Option<Pose>,
    pub(super) truth: Option<Truth>,
    pub(super) actuation: Option<Actuation>,
    pub(super) command: Option<Box<Command>>,
    pub(super) obstacles: Option<Box<Obstacles>>,
    /// Returns of the newest scan in track coordinates [m].
    pub(super) returns: Vec<[f64; 2]>,
    /// From scan to actuation, the newest last [ms].
    pub(super) reactions_ms: VecDeque<f64>,
    /// Medians of the stages and of the transport since the view began [ms].
    pub(super) stages_ms: [f64; 5],
    /// Lines of this view: what its commands printed.
    pub(super) notes: VecDeque<String>,
    /// Index of the role that the keys are for.
    pub(super) selected: usize,
    /// The keys are explained.
    pub(super) help: bool,
    /// The scan of the last stop that this view has seen.
    pub(super) stop_scan: Option<u64>,
    /// The answer to the last question, while it is shown.
    pub(super) reasons: Option<Reasons>,
    /// The view belongs to a run, which Ctrl-C ends.
    pub(super) of_run: bool,
}

/// The course and the robot.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Course {
    /// The bounds and the goals, along and across the way.
    pub(super) track: Track,
    pub(super) goals: Vec<Goal>,
    /// The goal that was given last; it counts from its scan on.
    given: GivenGoal,
    pub(super) way: vehicle::Course,
    /// The way as lines; none of the line along x.
    pub(super) outline: Option<CourseOutline>,
    pub(super) vehicle: Description,
}

impl Course {
    pub(super) fn new(track: Track, goals: Vec<Goal>, way: vehicle::Course, vehicle: Description) -> Self {
        let outline = (!way.is_line()).then(|| way.outline(track.x_m));
        Self { track, goals, given: GivenGoal::default(), way, outline, vehicle }
    }

    /// Takes a goal that counts from its scan on; one that is not newer than the last is no other.
    pub(super) fn give(&mut self, goal: &GivenGoal) {
        if goal.is_newer(&self.given) {
            self.given = *goal;
        }
    }

    /// Puts the given goal in its place when a scan has come from which it counts.
    pub(super) fn heed_goal(&mut self, scan_id: u64) {
        let GivenGoal { from_scan, index, x_m, y_m, tolerance_m, .. } = self.given;
        if let Some(goal) = self.goals.get_mut(index as usize).filter(|_| (1..=scan_id).contains(&from_scan))
        {
            *goal = Goal { x_m, y_m, tolerance_m, ..*goal };
        }
    }

    /// The goals in the plane.
    pub(super) fn goals_in_plane(&self) -> impl Iterator<Item = Goal> {
        self.goals.iter().map(|goal| {
            let on_way = State { x: goal.x_m, y: goal.y_m, ..State::default() };
            let State { x, y, .. } = self.way.in_plane(&on_way);
            Goal { x_m: x, y_m: y, ..*goal }
        })
    }

    /// How far the next goal is from a pose: along the way where there is one [m].
    pub(super) fn to_goal_m(&self, pose: &Pose) -> f64 {
        let state = State { x: pose.x_m, y: pose.y_m, yaw: pose.yaw_rad, ..State::default() };
        let place = self.way.on_course(&state, self.way.find(&state));
        let is_ahead = |goal: &&Goal| place.x <= goal.x_m + goal.tolerance_m;
        let next = self.goals.iter().find(is_ahead).or(self.goals.last());
        next.map_or(f64::NAN, |goal| goal.distance_m(place.x, place.y))
    }
}

impl Model {
    /// The role that the keys are for.
    pub(super) fn role(&self) -> Role {
        Role::ALL[self.selected.min(Role::ALL.len() - 1)]
    }

    /// Selects the role before or after.
    pub(super) fn select(&mut self, down: bool) {
        let count = Role::ALL.len();
        self.selected = (self.selected + if down { 1 } else { count - 1 }) % count;
    }

    /// Adds a line.
    pub(super) fn note(&mut self, text: String) {
        self.notes.push_back(text);
        if self.notes.len() > MAX_NOTES {
            self.notes.pop_front();
        }
    }

    /// Adds a reaction time [ms].
    pub(super) fn react(&mut self, time_ms: f64) {
        self.reactions_ms.push_back(time_ms);
        if self.reactions_ms.len() > MAX_REACTIONS {
            self.reactions_ms.pop_front();
        }
    }

    /// The reaction time that this share of the kept ones does not exceed [ms].
    pub(super) fn reaction_ms(&self, share: f64) -> Option<f64> {
        let mut sorted: Vec<f64> = self.reactions_ms.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        let rank = (share * sorted.len() as f64).ceil().max(1.0) as usize - 1;
        sorted.get(rank).copied()
    }

    /// Places the returns of a scan.
    pub(super) fn place(&mut self, scan: &Scan) {
        let Some(pose) = &self.pose else { return };
        let vehicle = &self.course.vehicle;
        let scanner = to_track(pose.yaw_rad, vehicle.scanner_x_m, vehicle.scanner_y_m);
        let place = |beam| {
            let range_m = scan.range_m(beam)?;
            let yaw = pose.yaw_rad + vehicle.scanner_yaw_rad + scan.beam_yaw_rad(beam);
            Some([pose.x_m + scanner.x + range_m * yaw.cos(), pose.y_m + scanner.y + range_m * yaw.sin()])
        };
        self.returns = (0..scan.ranges().len()).filter_map(place).collect();
    }

    /// Whether the wheels are blocked now.
    pub(super) fn is_blocked(&self) -> bool {
        self.actuation.is_some_and(|actuation| actuation.kind != ActuationKind::Drive.wire())
    }

    /// The last events, the newest last: those of the system, then those of this view.
    pub(super) fn events(&self) -> impl DoubleEndedIterator<Item = (Option<&EventRow>, &str)> {
        let of_system = self.status.iter().flat_map(|status| &status.events);
        let notes = self.notes.iter().map(|text| (None, text.as_str()));
        of_system.map(|event| (Some(event), event.text.as_str())).chain(notes)
    }
}
