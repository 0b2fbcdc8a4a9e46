//! What the wheels did, from the log of the emulator and from the truth that an observer recorded.

use std::path::Path;

use serde_json::Value;

/// A line of the emulator's log about its wheels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WheelsChange {
    /// Time of the robot [ns of CLOCK_MONOTONIC].
    pub at_ns: u64,
    /// What they do from then on.
    pub wheels: WheelsState,
}

/// What wheels do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WheelsState {
    /// They may turn.
    Turning,
    /// They are blocked, and the robot slides.
    Blocked,
    /// They are blocked, and the robot is at rest.
    Resting,
}

/// One sample of the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Time of its front beam [ns of CLOCK_MONOTONIC].
    pub at_ns: u64,
    /// True speed [m/s].
    pub speed_mps: f64,
    /// Whether the robot has touched something.
    pub collided: bool,
    /// Longest time that the wheels turned without an actuation [s].
    pub longest_blind_s: f64,
}

/// All changes in the log of an emulator.
pub fn changes(log: &str) -> Vec<WheelsChange> {
    let state = |line: &str| match line {
        _ if line.contains(": wheels may turn ") => Some(WheelsState::Turning),
        _ if line.contains(": wheels are blocked ") => Some(WheelsState::Blocked),
        _ if line.contains(": wheels rest ") => Some(WheelsState::Resting),
        _ => None,
    };
    let at_ns = |line: &str| line.rsplit_once("at_ns=")?.1.trim().parse().ok();
    log.lines().filter_map(|line| Some(WheelsChange { wheels: state(line)?, at_ns: at_ns(line)? })).collect()
}

/// The state at a time; `None` before the first change.
pub fn state_at(changes: &[WheelsChange], at_ns: u64) -> Option<WheelsState> {
    changes.iter().rev().find(|change| change.at_ns <= at_ns).map(|change| change.wheels)
}

/// All samples in a file that `scanloop topic echo truth` has written.
pub fn points(file: &Path) -> Vec<Point> {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    // The last line may be cut off.
    text.lines().filter_map(|line| point(&serde_json::from_str(line).ok()?)).collect()
}

fn point(truth: &Value) -> Option<Point> {
    Some(Point {
        at_ns: truth["header"]["acquired_ns"].as_u64()?,
        speed_mps: truth["speed_mps"].as_f64()?,
        collided: truth["collided"].as_u64()? != 0,
        longest_blind_s: truth["longest_blind_s"].as_f64()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_tells_what_the_wheels_did() {
        let log = "=== scanloop: robot\n INFO emulator::service: wheels rest speed_mps=0.0 at_ns=100\n\
                   INFO emulator::service: wheels may turn speed_mps=0.1 at_ns=200\n other\n\
                   INFO emulator::service: wheels are blocked speed_mps=1.0 at_ns=300\n";
        let changes = changes(log);
        assert_eq!(changes.len(), 3);
        assert_eq!(state_at(&changes, 99), None);
        assert_eq!(state_at(&changes, 250), Some(WheelsState::Turning));
        assert_eq!(state_at(&changes, 900), Some(WheelsState::Blocked));
    }
}
