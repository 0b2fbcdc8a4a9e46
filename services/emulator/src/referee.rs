//! How a drive ends, judged by the truth and by what was sent to the robot.
//!
//! The referee gets one truth per scan. A run ends when the body has touched something, when the robot stands after
//! landing or after passing the goal, when the wheels stay blocked, or when the time is over. Time is that of the
//! plant, so a run in lock-step ends like one in real time.

use serde::{Deserialize, Serialize};
use shared_types::{Actuation, ActuationKind, BlockReason, StopReason, Truth, named_enum};

use crate::scenario::Scenario;

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

/// Judges a drive.
#[derive(Debug, Clone)]
pub struct Referee {
    tolerance_m: f64,
    timeout_s: f64,
    stop_final_s: f64,
    /// Since when the wheels have been blocked without a break [s].
    blocked_since_s: Option<f64>,
    /// The last actuation, if it blocks the wheels.
    block: Option<Block>,
    /// The last scan that was answered with turning wheels.
    driven_scan: u64,
    reason: String,
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
            tolerance_m: scenario.goal.tolerance_m,
            timeout_s: scenario.timeout_s,
            stop_final_s: scenario.stop_final_s,
            blocked_since_s: None,
            block: None,
            driven_scan: 0,
            reason: String::new(),
        }
    }

    /// The outcome, once there is one.
    ///
    /// `actuation` is the newest one, the same as before when none was published since.
    pub fn observe(&mut self, truth: &Truth, actuation: Option<&Actuation>) -> Option<Outcome> {
        // Wheels that turned until a gap between scans blocked them were not blocked without a break.
        let turned = self.driven_scan > 0 && self.driven_scan == truth.actuation_scan;
        if let Some(actuation) = actuation {
            self.block = Block::of(actuation);
            if self.block.is_none() && actuation.answers == 1 {
                self.driven_scan = actuation.header.scan_id;
            }
        }
        if truth.blocked == 0 || turned {
            self.blocked_since_s = None;
        } else if self.blocked_since_s.is_none() {
            self.blocked_since_s = Some(truth.time_s);
        }
        let (outcome, reason) = self.judge(truth)?;
        self.reason = reason;
        Some(outcome)
    }

    /// Why the run ended; empty while it lasts.
    pub fn reason(&self) -> &str {
        &self.reason
    }

    fn judge(&self, truth: &Truth) -> Option<(Outcome, String)> {
        let distance = truth.goal_distance_m;
        if truth.collided != 0 {
            let place =
                format!("the body touched something at x = {:.3} m, y = {:.3} m", truth.x_m, truth.y_m);
            return Some((Outcome::Collision, place));
        }
        if truth.struck != 0 {
            return Some((Outcome::Stopped, "struck".to_owned()));
        }
        let stands = truth.blocked != 0 && truth.speed_mps <= 0.0;
        if stands && self.block.is_some_and(Block::lands) {
            let reason = format!("landed {distance:.3} m from the goal, {} m are allowed", self.tolerance_m);
            // NaN does not count as reached.
            let outcome = if distance <= self.tolerance_m { Outcome::Reached } else { Outcome::Missed };
            return Some((outcome, reason));
        }
        if stands && self.block.is_some_and(Block::gives_up) {
            return Some((Outcome::Missed, format!("the goal was passed, it is {distance:.3} m away")));
        }
        if let Some(since) = self.blocked_since_s
            && truth.time_s - since >= self.stop_final_s
        {
            let reason = format!("wheels blocked for {} s: {}", self.stop_final_s, self.block_name(truth));
            return Some((Outcome::Stopped, reason));
        }
        (truth.time_s >= self.timeout_s).then(|| {
            (Outcome::Timeout, format!("{} s are over, the goal is {distance:.3} m away", self.timeout_s))
        })
    }

    /// Name of the reason why the wheels are blocked.
    fn block_name(&self, truth: &Truth) -> &'static str {
        match self.block {
            Some(Block { reason: Some(BlockReason::Commanded), stop: Some(stop) }) => stop.name(),
            Some(Block { reason: Some(reason), .. }) => reason.name(),
            _ if truth.dead_man != 0 => "dead_man",
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

#[cfg(test)]
mod tests {
    use super::*;

    fn truth(time_s: f64, goal_distance_m: f64, blocked: u32) -> Truth {
        Truth { time_s, goal_distance_m, blocked, ..Truth::default() }
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
    fn contact_is_a_collision_while_moving_and_a_stop_while_standing() {
        let hit = Truth { collided: 1, ..truth(1.0, 9.0, 0) };
        assert_eq!(referee().observe(&hit, None), Some(Outcome::Collision));
        let mut referee = referee();
        assert_eq!(referee.observe(&Truth { struck: 1, ..truth(1.0, 9.0, 1) }, None), Some(Outcome::Stopped));
        assert_eq!(referee.reason(), "struck");
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
