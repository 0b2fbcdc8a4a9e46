//! A free lane from start to goal that bends across the track, with obstacles beside it.

use std::f64::consts::TAU;

use crate::course::random_obstacle::obstacle;
use emulator::noise::NoiseStream;
use emulator::scenario::{Scenario, Start};

/// Shortest wave of the lane [m].
const WAVE_M: f64 = 8.0;

/// The lane.
pub(super) struct Lane {
    start: Start,
    goal: [f64; 2],
    /// Height of the wave [m]: 0.3 m keep a radius of 5 m with the shortest wave.
    height_m: f64,
    waves: f64,
    /// Free way to either side of the middle [m].
    half_width_m: f64,
}

impl Lane {
    /// A lane from the start to the goal of a scenario.
    pub(super) fn new(scenario: &Scenario, stream: &mut NoiseStream) -> Self {
        let goal = [scenario.goal.last().x_m, scenario.goal.last().y_m];
        let most = ((goal[0] - scenario.start.x_m) / WAVE_M).max(0.5);
        Self {
            start: scenario.start,
            goal,
            height_m: stream.between(-0.3, 0.3),
            waves: stream.between(0.5, most),
            half_width_m: stream.between(0.42, 0.8),
        }
    }

    /// Adds obstacles on both sides, between two places along the track.
    pub(super) fn fill(
        &self,
        scenario: &mut Scenario,
        stream: &mut NoiseStream,
        [from, to]: [f64; 2],
        count: usize,
    ) {
        let share = (to - from) / count as f64;
        for index in 0..count {
            let mut body = obstacle(stream);
            let x_m = from + share * (index as f64 + stream.uniform());
            body.x_m = x_m.clamp(from + body.reach(), to - body.reach());
            let offset = self.half_width_m + body.reach() + stream.between(0.0, 0.7);
            let side = if stream.chance(0.5) { 1.0 } else { -1.0 };
            body.y_m = self.middle_m(body.x_m) + side * offset;
            scenario.obstacles.push(body);
        }
    }

    /// Lateral position of the middle [m].
    fn middle_m(&self, x_m: f64) -> f64 {
        let length = self.goal[0] - self.start.x_m;
        let share = (x_m - self.start.x_m) / length;
        // A cubic with the heading of the start, and along the track at the goal.
        let blend = share * share * (3.0 - 2.0 * share);
        let turn = share * (1.0 - share).powi(2) * length * self.start.yaw_rad.tan();
        let line = self.start.y_m + (self.goal[1] - self.start.y_m) * blend + turn;
        line + self.height_m * (TAU * self.waves * share).sin() * 4.0 * share * (1.0 - share)
    }
}
