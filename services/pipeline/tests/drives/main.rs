//! Whole drives of one process: the shipped scenarios with every preset, gaps, and stops in time.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod beside;
mod examples;
mod gaps;
mod goal;
mod hostile;
mod laser;
mod map;
mod models;
mod presets;
mod released;
mod reversing;
mod rooms;
mod scanner;
mod seeds;
mod source;
mod stopping;

use emulator::{Outcome, Scenario};
use pipeline::{PipelineSettings, drive};

/// How a drive ended.
#[derive(Debug, Clone, PartialEq)]
struct End {
    outcome: Outcome,
    reason: String,
    /// True smallest distance between body and obstacles [m].
    clearance_m: f64,
    /// True distance to the goal at the end [m].
    goal_m: f64,
}

impl End {
    fn is_untouched(&self) -> bool {
        self.outcome != Outcome::Collision && self.clearance_m > 0.0
    }
}

/// Drives to the end.
fn end(settings: &PipelineSettings) -> End {
    let (mut clearance_m, mut goal_m) = (f64::INFINITY, f64::INFINITY);
    let drive = drive(settings, |step| {
        (clearance_m, goal_m) = (step.truth.min_clearance_m, step.truth.goal_distance_m);
    })
    .unwrap();
    End { outcome: drive.outcome, reason: drive.reason, clearance_m, goal_m }
}

fn parse(text: &str) -> Scenario {
    Scenario::parse(text, "test").unwrap()
}

fn shipped(name: &str) -> Scenario {
    parse(Scenario::shipped(name).unwrap())
}
