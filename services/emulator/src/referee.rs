//! How a drive ends, judged by the truth and by what was sent to the robot.
//!
//! The referee gets one truth per scan, or, where the robot publishes none, the estimated pose. A run ends when the body has touched something, when the robot stands after
//! landing or after passing the goal, when the wheels stay blocked, or when the time is over. Time is that of the
//! plant, so a run in lock-step ends like one in real time.

mod estimate;
mod progress;

use serde::{Deserialize, Serialize};
use shared_types::{Actuation, ActuationKind, BlockReason, DrivenBy, StopReason, Truth, named_enum};

use self::estimate::Wheels;
use self::progress::Progress;
use crate::scenario::{Goal, Scenario};

pub use self::estimate::EstimatedScan;

named_enum! {
    /// How a run ended.
    #[derive(Default, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Outcome {
        /// Landed within the tolerance of the goal.
        Reached "reached",
        /// Landed elsewhere, or the goal was passed.
        Missed "missed",
        /// Time was up.
        Timeout "timeout",
        /// A safety rule blocked the wheels for good, or a moving obstacle struck the standing robot.
        Stopped "stopped",
        /// The moving body touched an obstacle or a wall.
        Collision "collision",
        /// The user ended the run.
        Interrupted "interrupted",
        /// A process could not be started or kept running.
        #[default]
        Failed "failed",
    }
}

named_enum! {
    /// What decides the outcome of a run.
    #[derive(Default, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum JudgedBy {
        /// The true state that an emulated robot publishes.
        #[default]
        Truth "truth",
        /// The estimated pose and what was sent to the robot: collisions are not seen.
        Estimate "estimate",
    }
}

/// Judges a drive.
#[derive(Debug, Clone)]
pub struct Referee {
    goals: Vec<Goal>,
    /// How far the robot has come along the course.
    progress: Progress,
    /// What became of the goals so far: all but the last one of a drive that is not over are reached.
    landings: Vec<Landing>,
    /// Whether the robot has landed without driving since.
    has_landed: bool,
    timeout_s: f64,
    stop_final_s: f64,
    /// Since when the wheels have been blocked without a break [s].
    blocked_since_s: Option<f64>,
    /// Whether the controller drives, by the last actuation.
    is_driven: bool,
    /// Time of the last scan, and how long another than the controller drove until then [s].
    seen_s: f64,
    by_hand_s: f64,
    /// The last actuation, if it blocks the wheels.
    block: Option<Block>,
    /// The last scan that was answered with turning wheels.
    driven_scan: u64,
    /// The last such scan whose answer had arrived at the robot.
    turned_scan: u64,
    /// The wheels of a robot that publishes no truth.
    wheels: Wheels,
    reason: String,
}

/// What became of a goal.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Landing {
    /// When the robot stood there, since the start of the run; nothing where it never did [s].
    pub reached_s: Option<f64>,
    /// Distance of the robot's centre to it then; nothing where the robot did not land [m].
    pub distance_m: Option<f64>,
    /// Difference of the robot's direction to its own then, nothing where it has none [rad].
    pub yaw_error_rad: Option<f64>,
}

/// What the referee of a drive has to know to continue where another has ended.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct DriveProgress {
    /// How far the robot has come along the course [m].
    pub along_m: f64,
    /// What became of the goals so far.
    pub landings: Vec<Landing>,
}

/// The robot at a scan, by the truth or by the estimate.
#[derive(Debug, Clone, Copy)]
struct Sight {
    time_s: f64,
    /// Position and direction in the plane; not finite as long as nothing is known.
    place: [f64; 3],
    /// Whether the wheels have been blocked since the scan before.
    blocked: bool,
    stands: bool,
    dead_man: bool,
}

/// Why an actuation blocks the wheels.
#[derive(Debug, Clone, Copy)]
struct Block {
    reason: Option<BlockReason>,
    stop: Option<StopReason>,
}

impl Outcome {
    /// The exit code of a run.
    pub const fn exit_code(self) -> u8 {
        match self {
            Self::Reached => 0,
            Self::Missed | Self::Timeout | Self::Stopped | Self::Interrupted => 1,
            Self::Collision => 3,
            Self::Failed => 4,
        }
    }
}

impl Referee {
    /// A referee for one run of a scenario.
    pub fn new(scenario: &Scenario) -> Self {
        Self {
            goals: scenario.goal.all().to_vec(),
            progress: Progress::new(scenario),
            landings: Vec::with_capacity(scenario.goal.all().len()),
            has_landed: false,
            timeout_s: scenario.timeout_s,
            stop_final_s: scenario.stop_final_s,
            blocked_since_s: None,
            is_driven: true,
            seen_s: 0.0,
            by_hand_s: 0.0,
            block: None,
            driven_scan: 0,
            turned_scan: 0,
            wheels: Wheels::default(),
            reason: String::new(),
        }
    }

    /// The outcome, once there is one.
    ///
    /// `actuation` is the newest one, the same as before when none was published since.
    pub fn observe(&mut self, truth: &Truth, actuation: Option<&Actuation>) -> Option<Outcome> {
        // Wheels that turned until a gap between scans blocked them were not blocked without a break. One answer shows
        // this once: without another one they have been blocked since.
        let turned = self.driven_scan > self.turned_scan && self.driven_scan == truth.actuation_scan;
        if turned {
            self.turned_scan = self.driven_scan;
        }
        if let Some(actuation) = actuation {
            self.note(actuation);
            if self.block.is_none() && actuation.answers == 1 {
                self.driven_scan = actuation.header.scan_id;
            }
        }
        let contact = contact(truth);
        let sight = Sight {
            time_s: truth.time_s,
            place: [truth.x_m, truth.y_m, truth.yaw_rad],
            blocked: truth.blocked != 0 && !turned,
            stands: truth.blocked != 0 && truth.speed_mps == 0.0,
            dead_man: truth.dead_man != 0,
        };
        self.decide(&sight, contact)
    }

    /// The outcome of a drive without a truth, once there is one; a collision never is.
    pub fn observe_estimate(&mut self, scan: &EstimatedScan<'_>) -> Option<Outcome> {
        let is_of_scan = |actuation: &Actuation| actuation.header.scan_id >= scan.header.scan_id;
        // The actuator's own decisions carry the number of the scan before.
        let before = scan.actuations.iter().position(is_of_scan).unwrap_or(scan.actuations.len());
        let (before, since) = scan.actuations.split_at(before);
        before.iter().for_each(|actuation| self.wheels.note(actuation));
        let sight = self.wheels.at(scan);
        since.iter().for_each(|actuation| self.wheels.note(actuation));
        if let Some(newest) = scan.actuations.last() {
            self.note(newest);
        }
        self.decide(&sight, None)
    }

    /// Whether the wheels have been blocked since the last scan that was observed, or for longer.
    pub fn wheels_are_blocked(&self) -> bool {
        self.blocked_since_s.is_some()
    }

    /// Why the run ended; empty while it lasts.
    pub fn reason(&self) -> &str {
        &self.reason
    }

    /// Number of goals that were reached.
    pub fn reached(&self) -> usize {
        self.landings.iter().filter(|landing| landing.reached_s.is_some()).count()
    }

    /// From now on another goal is the one with this index; `along_m` is its place on the course.
    pub fn change_goal(&mut self, index: usize, goal: Goal, along_m: f64) {
        if let Some(place) = self.goals.get_mut(index) {
            *place = goal;
            self.progress.change_goal(index, along_m);
        }
    }

    /// How far the drive has come.
    pub fn progress(&self) -> DriveProgress {
        DriveProgress { along_m: self.along_m(), landings: self.landings.clone() }
    }

    /// Continues with a drive that another referee has judged so far.
    pub fn resume(&mut self, DriveProgress { along_m, landings }: DriveProgress) {
        self.progress.resume(along_m);
        self.landings = landings;
        self.landings.truncate(self.goals.len() - 1);
    }

    /// How far the robot has come along the course, in its lap [m].
    pub fn along_m(&self) -> f64 {
        self.progress.along_m()
    }

    /// What became of each goal.
    pub fn landings(&self) -> Vec<Landing> {
        let mut landings = self.landings.clone();
        landings.resize(self.goals.len(), Landing::default());
        landings
    }

    fn note(&mut self, actuation: &Actuation) {
        self.block = Block::of(actuation);
        self.is_driven = actuation.driven_by == DrivenBy::Controller.wire();
    }

    fn decide(&mut self, sight: &Sight, contact: Option<(Outcome, String)>) -> Option<Outcome> {
        let passed_s = (sight.time_s - self.seen_s).max(0.0);
        self.seen_s = sight.time_s;
        self.by_hand_s += if self.is_driven { 0.0 } else { passed_s };
        self.blocked_since_s =
            (sight.blocked && self.is_driven).then(|| self.blocked_since_s.unwrap_or(sight.time_s));
        self.progress.follow(sight.place);
        let (outcome, reason) = contact.or_else(|| self.judge(sight))?;
        self.reason = reason;
        Some(outcome)
    }

    fn judge(&mut self, sight: &Sight) -> Option<(Outcome, String)> {
        if !self.is_driven {
            return None;
        }
        let Sight { time_s, stands, .. } = *sight;
        let lands = self.block.is_some_and(Block::lands);
        self.has_landed &= lands && sight.blocked;
        if stands && lands && !self.has_landed {
            self.has_landed = true;
            return self.land(sight);
        }
        let index = self.landings.len().min(self.goals.len() - 1);
        let (goal, [x_m, y_m, _]) = (&self.goals[index], sight.place);
        let (name, distance) = (self.goal_name(index), goal.distance_m(x_m, y_m));
        if stands && self.block.is_some_and(Block::gives_up) {
            return Some((Outcome::Missed, format!("{name} was passed, it is {distance:.3} m away")));
        }
        if let Some(since) = self.blocked_since_s
            && time_s - since >= self.stop_final_s
        {
            let reason = format!("wheels blocked for {} s: {}", self.stop_final_s, self.block_name(sight));
            return Some((Outcome::Stopped, reason));
        }
        (time_s - self.by_hand_s >= self.timeout_s).then(|| {
            (Outcome::Timeout, format!("{} s are over, {name} is {distance:.3} m away", self.timeout_s))
        })
    }

    /// What a landing means: the next goal, or the end of the run.
    fn land(&mut self, sight: &Sight) -> Option<(Outcome, String)> {
        let [x_m, y_m, yaw_rad] = sight.place;
        let of = |goal: &Goal| (goal.distance_m(x_m, y_m), goal.yaw_error_rad(yaw_rad));
        let index = self.landings.len();
        let goal = *self.goals.get(index)?;
        let (distance_m, yaw_error_rad) = of(&goal);
        let left_m = self.progress.left_m(index);
        let is_reached = goal.is_reached(distance_m, yaw_error_rad) && left_m == 0.0;
        // A controller that has lost its state lands once more where it stays.
        if !is_reached && index > 0 && self.goals[index - 1].is_reached(of(&self.goals[index - 1]).0, None) {
            return None;
        }
        let reached_s = is_reached.then_some(sight.time_s);
        self.landings.push(Landing { reached_s, distance_m: Some(distance_m), yaw_error_rad });
        if is_reached && index + 1 < self.goals.len() {
            // The robot stays as long as it should; that is no stop.
            self.blocked_since_s = Some(sight.time_s + goal.stay_s);
            return None;
        }
        let name = self.goal_name(index);
        let mut reason = format!("landed {distance_m:.3} m from {name}, {} m are allowed", goal.tolerance_m);
        if let Some(error_rad) = yaw_error_rad {
            reason += &format!(
                ", and {error_rad:.3} rad from its direction, {} rad are allowed",
                goal.yaw_tolerance_rad
            );
        }
        if left_m > 0.0 {
            reason += &format!(", with {left_m:.1} m of the course before it not driven");
        }
        Some((if is_reached { Outcome::Reached } else { Outcome::Missed }, reason))
    }

    /// A goal in messages.
    fn goal_name(&self, index: usize) -> String {
        if self.goals.len() == 1 {
            "the goal".to_owned()
        } else {
            format!("goal {} of {}", index + 1, self.goals.len())
        }
    }

    /// Name of the reason why the wheels are blocked.
    fn block_name(&self, sight: &Sight) -> &'static str {
        match self.block {
            Some(Block { reason: Some(BlockReason::Commanded), stop: Some(StopReason::Unseen) }) => {
                "unseen, something may be behind it"
            }
            Some(Block { reason: Some(BlockReason::Commanded), stop: Some(stop) }) => stop.name(),
            Some(Block { reason: Some(reason), .. }) => reason.name(),
            _ if sight.dead_man => "dead_man",
            _ => BlockReason::Start.name(),
        }
    }
}

impl Block {
    fn of(actuation: &Actuation) -> Option<Self> {
        (actuation.kind == ActuationKind::Block.wire()).then(|| Self {
            reason: BlockReason::try_from(actuation.reason).ok(),
            stop: StopReason::try_from(actuation.stop_reason).ok(),
        })
    }

    fn lands(self) -> bool {
        self.reason == Some(BlockReason::Landed) || self.stop == Some(StopReason::Landed)
    }

    fn gives_up(self) -> bool {
        self.stop == Some(StopReason::GoalPassed)
    }
}

/// The outcome of a drive in which the body touches something.
fn contact(truth: &Truth) -> Option<(Outcome, String)> {
    if truth.collided != 0 {
        let place = format!("the body touched something at x = {:.3} m, y = {:.3} m", truth.x_m, truth.y_m);
        return Some((Outcome::Collision, place));
    }
    (truth.struck != 0).then(|| (Outcome::Stopped, "struck".to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::{Header, Pose, Role};

    fn truth(time_s: f64, goal_distance_m: f64, blocked: u32) -> Truth {
        Truth { time_s, x_m: 10.0 + goal_distance_m, goal_distance_m, blocked, ..Truth::default() }
    }

    fn block(reason: BlockReason, stop: StopReason) -> Actuation {
        Actuation {
            kind: ActuationKind::Block.wire(),
            reason: reason.wire(),
            stop_reason: stop.wire(),
            ..Actuation::default()
        }
    }

    fn drive() -> Actuation {
        Actuation { kind: ActuationKind::Drive.wire(), ..Actuation::default() }
    }

    fn referee() -> Referee {
        Referee::new(&Scenario::default())
    }

    #[test]
    fn landing_within_the_tolerance_is_reached_and_elsewhere_missed() {
        let landed = block(BlockReason::Landed, StopReason::Landed);
        assert_eq!(referee().observe(&truth(12.0, 0.1, 1), Some(&landed)), Some(Outcome::Reached));
        assert_eq!(referee().observe(&truth(12.0, 0.101, 1), Some(&landed)), Some(Outcome::Missed));
        assert_eq!(referee().observe(&truth(12.0, f64::NAN, 1), Some(&landed)), Some(Outcome::Missed));
        let sliding = Truth { speed_mps: 0.3, ..truth(12.0, 0.05, 1) };
        assert_eq!(referee().observe(&sliding, Some(&landed)), None, "it has to stand");
    }

    /// Goals at 4 m, where the robot stays for 7 s, longer than a stop may last, and at 10 m.
    fn two_goals() -> Referee {
        let text = "[[goal]]\nx_m = 4.0\nstay_s = 7.0\n[[goal]]\nyaw_rad = 0.0\nyaw_tolerance_rad = 0.1\n";
        Referee::new(&Scenario::parse(text, "two").unwrap())
    }

    fn truth_at(time_s: f64, x_m: f64, yaw_rad: f64, blocked: u32) -> Truth {
        Truth { x_m, yaw_rad, ..truth(time_s, (x_m - 10.0).abs(), blocked) }
    }

    #[test]
    fn another_referee_goes_on_in_the_lap_and_at_the_goal_of_the_one_before() {
        let circle = "[course]\nlaps = 2\nwaypoints = [{ x_m = 5 }, { y_m = 5 }, { x_m = -5 }, { y_m = -5 }, { x_m = 5 }]";
        let scenario = Scenario::parse(circle, "circle").unwrap();
        let landed = block(BlockReason::Landed, StopReason::Landed);
        let at_the_end = Truth { x_m: 5.0, yaw_rad: std::f64::consts::FRAC_PI_2, ..truth(60.0, 0.0, 1) };
        // What was noted lies half a metre before, and before the end of the first lap.
        for (along_m, expected) in [(61.5, Outcome::Reached), (31.2, Outcome::Missed), (0.0, Outcome::Missed)]
        {
            let mut referee = Referee::new(&scenario);
            referee.resume(DriveProgress { along_m, landings: Vec::new() });
            let outcome = referee.observe(&at_the_end, Some(&landed));
            assert_eq!(outcome, Some(expected), "{along_m}: {}", referee.reason());
        }
        let mut first = two_goals();
        assert_eq!(first.observe(&truth_at(5.0, 4.05, 0.0, 1), Some(&landed)), None);
        let mut second = two_goals();
        second.resume(first.progress());
        assert_eq!(second.observe(&truth_at(20.0, 10.0, 0.05, 1), Some(&landed)), Some(Outcome::Reached));
        assert_eq!(second.landings()[0].reached_s, Some(5.0));
    }

    #[test]
    fn each_goal_is_judged_when_the_robot_lands_there_and_staying_is_no_stop() {
        let landed = block(BlockReason::Landed, StopReason::Landed);
        let mut referee = two_goals();
        for tenth in 50..=118 {
            let seen = truth_at(f64::from(tenth) / 10.0, 4.05, 0.0, 1);
            assert_eq!(referee.observe(&seen, Some(&landed)), None, "{}", referee.reason());
        }
        assert_eq!(referee.observe(&truth_at(13.0, 5.0, 0.0, 0), Some(&drive())), None);
        assert_eq!(referee.observe(&truth_at(20.0, 9.98, 0.05, 1), Some(&landed)), Some(Outcome::Reached));
        let [first, second] = referee.landings().try_into().unwrap();
        assert_eq!((first.reached_s, second.reached_s), (Some(5.0), Some(20.0)));
        assert!((first.distance_m.unwrap() - 0.05).abs() < 1e-9 && first.yaw_error_rad.is_none());
        assert!((second.yaw_error_rad.unwrap() - 0.05).abs() < 1e-9);
        let reason = referee.reason();
        assert!(
            reason.starts_with("landed 0.020 m from goal 2 of 2, 0.1 m are allowed, and 0.050 rad"),
            "{reason}"
        );
    }

    #[test]
    fn a_goal_that_is_missed_ends_the_run_and_a_wrong_direction_is_a_miss() {
        let landed = block(BlockReason::Landed, StopReason::Landed);
        let mut referee = two_goals();
        assert_eq!(referee.observe(&truth_at(5.0, 4.2, 0.0, 1), Some(&landed)), Some(Outcome::Missed));
        assert_eq!(referee.landings()[0].reached_s, None);
        assert_eq!(referee.landings()[1], Landing::default());
        let mut referee = two_goals();
        assert_eq!(referee.observe(&truth_at(5.0, 4.0, 0.0, 1), Some(&landed)), None);
        assert_eq!(referee.observe(&truth_at(13.0, 5.0, 0.0, 0), Some(&drive())), None);
        assert_eq!(referee.observe(&truth_at(20.0, 10.0, 0.2, 1), Some(&landed)), Some(Outcome::Missed));
        let passed = block(BlockReason::Commanded, StopReason::GoalPassed);
        let mut referee = two_goals();
        assert_eq!(referee.observe(&truth_at(5.0, 4.3, 0.0, 1), Some(&passed)), Some(Outcome::Missed));
        assert_eq!(referee.reason(), "goal 1 of 2 was passed, it is 0.300 m away");
    }

    #[test]
    fn a_robot_that_lands_again_where_it_stays_has_not_missed_the_next_goal() {
        let landed = block(BlockReason::Landed, StopReason::Landed);
        let mut referee = two_goals();
        assert_eq!(referee.observe(&truth_at(5.0, 4.0, 0.0, 1), Some(&landed)), None);
        let lost = block(BlockReason::Commanded, StopReason::StateLost);
        assert_eq!(referee.observe(&truth_at(5.1, 4.0, 0.0, 1), Some(&lost)), None);
        assert_eq!(referee.observe(&truth_at(5.2, 4.0, 0.0, 1), Some(&landed)), None);
        // A stop that lasts, after the stay, is one.
        let blocked = block(BlockReason::Commanded, StopReason::Blocked);
        let ended = (53..300).find(|tenth| {
            referee.observe(&truth_at(f64::from(*tenth) / 10.0, 4.0, 0.0, 1), Some(&blocked)).is_some()
        });
        assert_eq!(ended, Some(170), "7 s of staying and 5 s of the stop");
    }

    #[test]
    fn near_the_goal_without_landing_nothing_is_over() {
        assert_eq!(referee().observe(&truth(12.0, 0.0, 0), Some(&drive())), None);
        assert_eq!(referee().observe(&truth(12.0, 0.0, 1), None), None);
    }

    #[test]
    fn a_goal_given_up_is_missed() {
        let passed = block(BlockReason::Commanded, StopReason::GoalPassed);
        assert_eq!(referee().observe(&truth(12.0, 0.05, 1), Some(&passed)), Some(Outcome::Missed));
    }

    #[test]
    fn five_seconds_of_blocked_wheels_without_a_break_are_a_stop() {
        let mut referee = referee();
        let blocked = block(BlockReason::Commanded, StopReason::Blocked);
        for tenth in 0..50 {
            assert_eq!(referee.observe(&truth(3.0 + f64::from(tenth) / 10.0, 4.0, 1), Some(&blocked)), None);
        }
        assert_eq!(referee.observe(&truth(8.0, 4.0, 1), None), Some(Outcome::Stopped));
        assert_eq!(referee.reason(), "wheels blocked for 5 s: blocked");
    }

    #[test]
    fn a_moment_of_driving_starts_the_five_seconds_again() {
        let mut referee = referee();
        let blocked = block(BlockReason::NoCommand, StopReason::None);
        assert_eq!(referee.observe(&truth(0.1, 9.0, 1), Some(&blocked)), None);
        assert_eq!(referee.observe(&truth(4.9, 9.0, 0), Some(&drive())), None);
        assert_eq!(referee.observe(&truth(5.0, 9.0, 1), Some(&blocked)), None);
        assert_eq!(referee.observe(&truth(9.9, 9.0, 1), Some(&blocked)), None);
        assert_eq!(referee.observe(&truth(10.0, 9.0, 1), Some(&blocked)), Some(Outcome::Stopped));
        assert_eq!(referee.reason(), "wheels blocked for 5 s: no_command");
    }

    #[test]
    fn gaps_between_scans_are_no_stop() {
        let mut referee = referee();
        for scan_id in 1..=100 {
            let mut drive = Actuation { answers: 1, ..drive() };
            drive.header.scan_id = scan_id;
            let seen = Truth { actuation_scan: scan_id - 1, ..truth(0.2 * scan_id as f64, 9.0, 1) };
            assert_eq!(referee.observe(&seen, Some(&drive)), None, "scan {scan_id}");
        }
        // The same for a robot that receives none of them.
        let mut referee = self::referee();
        let outcomes = (1..=100).filter_map(|scan_id| {
            let mut drive = Actuation { answers: 1, ..drive() };
            drive.header.scan_id = scan_id;
            referee.observe(&truth(0.2 * scan_id as f64, 9.0, 1), Some(&drive))
        });
        assert_eq!(outcomes.last(), Some(Outcome::Stopped));
    }

    #[test]
    fn a_stage_that_falls_silent_ends_in_a_stop_although_its_last_answer_turned_the_wheels() {
        let mut referee = referee();
        let mut drive = Actuation { answers: 1, ..drive() };
        drive.header.scan_id = 7;
        assert_eq!(referee.observe(&truth(0.8, 9.0, 0), Some(&drive)), None);
        let mut silent = block(BlockReason::NoCommand, StopReason::None);
        silent.header.scan_id = 7;
        let outcomes = (9..=70).filter_map(|tenth| {
            let seen = Truth { actuation_scan: 7, ..truth(f64::from(tenth) / 10.0, 9.0, 1) };
            referee.observe(&seen, Some(&silent)).map(|outcome| (tenth, outcome))
        });
        // Once the answer of scan 7 counts as turning, then 5 s pass.
        assert_eq!(outcomes.collect::<Vec<_>>().first(), Some(&(60, Outcome::Stopped)));
        assert_eq!(referee.reason(), "wheels blocked for 5 s: no_command");
    }

    #[test]
    fn contact_is_a_collision_while_moving_and_a_stop_while_standing() {
        let hit = Truth { collided: 1, ..truth(1.0, 9.0, 0) };
        assert_eq!(referee().observe(&hit, None), Some(Outcome::Collision));
        let mut referee = referee();
        assert_eq!(referee.observe(&Truth { struck: 1, ..truth(1.0, 9.0, 1) }, None), Some(Outcome::Stopped));
        assert_eq!(referee.reason(), "struck");
    }

    /// A referee that sees scans without a truth, every 0.1 s from zero.
    struct Blind {
        referee: Referee,
        scan_id: u64,
    }

    impl Blind {
        fn new() -> Self {
            Self { referee: referee(), scan_id: 0 }
        }

        /// The next scan at this place and speed, answered so; `late` are blocks that the actuator decided before it.
        fn scan(
            &mut self,
            x_m: f64,
            speed_mps: f64,
            late: &[Actuation],
            answer: Actuation,
        ) -> Option<Outcome> {
            self.scan_id += 1;
            let acquired_ns = (self.scan_id - 1) * 100_000_000;
            let header = Header { scan_id: self.scan_id, acquired_ns, ..Header::default() };
            let pose = Pose { x_m, speed_mps, ..Pose::default() };
            let mut answer = Actuation { header, answers: 1, ..answer };
            answer.header.stage_mut(Role::Actuator).published_ns = acquired_ns + 40_000_000;
            let mut actuations: Vec<Actuation> = late.to_vec();
            for actuation in &mut actuations {
                actuation.header.scan_id = self.scan_id - 1;
            }
            actuations.push(answer);
            self.referee.observe_estimate(&EstimatedScan {
                header: &header,
                time_s: acquired_ns as f64 * 1e-9,
                period_ns: 100_000_000,
                pose: Some(&pose),
                actuations: &actuations,
            })
        }
    }

    #[test]
    fn without_a_truth_a_landing_is_judged_by_the_estimate_once_the_robot_stands() {
        let landed = block(BlockReason::Landed, StopReason::Landed);
        for (x_m, outcome) in [(9.91, Outcome::Reached), (9.89, Outcome::Missed)] {
            let mut blind = Blind::new();
            assert_eq!(blind.scan(x_m, 0.5, &[], drive()), None);
            assert_eq!(blind.scan(x_m, 0.5, &[], landed), None, "the wheels turned until now");
            assert_eq!(blind.scan(x_m, 0.3, &[], landed), None, "it slides");
            assert_eq!(blind.scan(x_m, 0.04, &[], landed), Some(outcome), "{}", blind.referee.reason());
        }
        // An estimate that never gets to rest delays the end, and does not prevent it.
        let mut blind = Blind::new();
        let outcomes: Vec<_> = (0..20).map(|_| blind.scan(10.0, 0.2, &[], landed)).collect();
        assert_eq!(outcomes.iter().position(Option::is_some), Some(15));
    }

    #[test]
    fn without_a_truth_a_stop_and_the_timeout_count_as_with_it() {
        let blocked = block(BlockReason::Commanded, StopReason::Blocked);
        let mut blind = Blind::new();
        blind.scan(3.0, 0.5, &[], drive());
        let ended = (2..100).find(|_| blind.scan(3.0, 0.0, &[], blocked).is_some());
        assert_eq!((ended, blind.referee.reason()), (Some(53), "wheels blocked for 5 s: blocked"));
        let mut blind = Blind::new();
        let ended = (1..1000).find(|_| blind.scan(3.0, 0.5, &[], drive()).is_some());
        assert_eq!((ended, blind.referee.reason()), (Some(601), "60 s are over, the goal is 7.000 m away"));
    }

    #[test]
    fn without_a_truth_gaps_between_scans_are_no_stop_and_a_silent_actuator_is() {
        let gap = block(BlockReason::NoCommand, StopReason::None);
        let mut blind = Blind::new();
        assert!((0..100).all(|_| blind.scan(3.0, 0.5, &[gap], drive()).is_none()));
        let mut blind = Blind::new();
        blind.scan(3.0, 0.5, &[], drive());
        let header =
            |scan_id: u64| Header { scan_id, acquired_ns: scan_id * 100_000_000, ..Header::default() };
        let ended = (2..100).find(|scan_id| {
            let silent = EstimatedScan {
                header: &header(*scan_id),
                time_s: *scan_id as f64 * 0.1,
                period_ns: 100_000_000,
                pose: None,
                actuations: &[],
            };
            blind.referee.observe_estimate(&silent) == Some(Outcome::Stopped)
        });
        assert_eq!((ended, blind.referee.reason()), (Some(53), "wheels blocked for 5 s: dead_man"));
    }

    #[test]
    fn while_a_person_has_paused_or_drives_nothing_but_a_contact_ends_a_run_and_no_time_counts() {
        let of = |driven_by: DrivenBy, stop| Actuation {
            driven_by: driven_by.wire(),
            ..block(BlockReason::Paused, stop)
        };
        let mut referee = referee();
        for second in 0..100 {
            let by = if second % 2 == 0 { DrivenBy::Nobody } else { DrivenBy::Person };
            for stop in [StopReason::Blocked, StopReason::GoalPassed, StopReason::Landed] {
                let seen = referee.observe(&truth(f64::from(second), 4.0, 1), Some(&of(by, stop)));
                assert_eq!(seen, None, "{second} s");
            }
        }
        let blocked = block(BlockReason::Commanded, StopReason::Blocked);
        assert_eq!(referee.clone().observe(&truth(99.1, 9.0, 0), Some(&drive())), None);
        assert_eq!(referee.clone().observe(&truth(160.0, 9.0, 0), Some(&drive())), Some(Outcome::Timeout));
        assert_eq!(referee.observe(&truth(99.1, 9.0, 1), Some(&blocked)), None);
        assert_eq!(referee.clone().observe(&truth(104.0, 9.0, 1), Some(&blocked)), None);
        assert_eq!(referee.observe(&truth(104.2, 9.0, 1), Some(&blocked)), Some(Outcome::Stopped));
        let hit = Truth { collided: 1, ..truth(105.0, 9.0, 0) };
        let by_person = of(DrivenBy::Person, StopReason::None);
        assert_eq!(referee.observe(&hit, Some(&by_person)), Some(Outcome::Collision));
    }

    #[test]
    fn time_is_up_at_the_timeout() {
        assert_eq!(referee().observe(&truth(59.9, 9.0, 0), Some(&drive())), None);
        assert_eq!(referee().observe(&truth(60.0, 9.0, 0), Some(&drive())), Some(Outcome::Timeout));
    }

    #[test]
    fn names_and_exit_codes_are_those_of_the_interface() {
        let all = [
            (Outcome::Reached, "reached", 0),
            (Outcome::Missed, "missed", 1),
            (Outcome::Timeout, "timeout", 1),
            (Outcome::Stopped, "stopped", 1),
            (Outcome::Collision, "collision", 3),
            (Outcome::Interrupted, "interrupted", 1),
            (Outcome::Failed, "failed", 4),
        ];
        for (outcome, name, code) in all {
            assert_eq!((outcome.name(), outcome.exit_code()), (name, code));
        }
    }

    #[test]
    fn unknown_numbers_in_an_actuation_never_panic() {
        let unknown = Actuation { kind: 77, reason: 99, stop_reason: 99, ..Actuation::default() };
        assert_eq!(referee().observe(&truth(1.0, 9.0, 1), Some(&unknown)), None);
    }
}
