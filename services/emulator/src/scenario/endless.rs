//! Obstacles that the seed places along the whole track.

use serde::{Deserialize, Serialize};
use vehicle::{Invalid, require};

use super::{Obstacle, Scenario, Shape};
use crate::noise::{Purpose, Stream};

/// The first obstacle stands this far after the start: nearer ones need not be passable [m].
const FIRST_M: f64 = 6.0;
/// No obstacle stands nearer to the goal than this [m].
const LAST_M: f64 = 6.0;

/// The longest track at the smallest spacing holds no more.
const MAX_PLACED: u64 = 20_000;

/// One upright box per spacing, as wide and as far to the side as the seed says.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Endless {
    /// Distance from one obstacle to the next along the track [m], 1 to 1000.
    pub spacing_m: f64,
    /// Smallest and largest width of an obstacle [m], 0.005 to 5.
    pub width_m: [f64; 2],
    /// Length of an obstacle along the track [m], 0.005 to 5.
    pub length_m: f64,
    /// Largest lateral offset of an obstacle's centre from the line through the start [m], 0 to 100.
    pub lateral_m: f64,
}

impl Default for Endless {
    fn default() -> Self {
        Self { spacing_m: 5.5, width_m: [0.2, 0.5], length_m: 0.1, lateral_m: 0.6 }
    }
}

impl Endless {
    pub(super) fn validate(&self) -> Result<(), Invalid> {
        require("spacing_m", self.spacing_m, 1.0..=1000.0)?;
        let [narrow, wide] = self.width_m;
        let allowed = 0.005..=5.0;
        if !(allowed.contains(&narrow) && allowed.contains(&wide) && narrow <= wide) {
            let words = "two numbers from 0.005 to 5, the smaller one first";
            return Err(Invalid::new("width_m", format!("[{narrow}, {wide}]"), words));
        }
        require("length_m", self.length_m, 0.005..=5.0)?;
        require("lateral_m", self.lateral_m, 0.0..=100.0)
    }

    /// Appends the obstacles between start and goal.
    pub(super) fn place(&self, scenario: &Scenario, obstacles: &mut Vec<Obstacle>) {
        let last = scenario.goal.x_m.min(scenario.track.x_m[1]) - LAST_M;
        for number in 0..MAX_PLACED {
            let x_m = scenario.start.x_m + FIRST_M + number as f64 * self.spacing_m;
            if x_m > last {
                return;
            }
            let mut stream = Stream::new(scenario.seed, Purpose::Placement, number);
            let width_m = stream.between(self.width_m[0], self.width_m[1]);
            let y_m = scenario.start.y_m + stream.between(-self.lateral_m, self.lateral_m);
            let shape = Shape::Box { length_m: self.length_m, width_m, yaw_rad: 0.0 };
            obstacles.push(Obstacle::fixed(shape, x_m, y_m));
        }
    }
}
