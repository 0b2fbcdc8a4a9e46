//! Obstacles that the seed places along the whole track.

use vehicle::{Invalid, settings};

use super::{ScenarioObstacle, Shape, Start};
use crate::noise::{NoiseStream, Purpose};

/// The first obstacle stands this far after the start: nearer ones need not be passable [m].
const FIRST_M: f64 = 6.0;
/// No obstacle stands nearer to the goal than this [m].
const LAST_M: f64 = 6.0;

/// The longest track at the smallest spacing holds no more.
const MAX_PLACED: u64 = 20_000;

settings! {
    /// One upright box per spacing, as wide and as far to the side as the seed says.
    #[derive(Copy)]
    pub struct Endless {
        /// Distance from one obstacle to the next along the track [m].
        pub spacing_m: f64 = 5.5, 1.0..=1000.0;
        /// Smallest and largest width of an obstacle [m].
        pub width_m: [f64; 2] = [0.2, 0.5], (0.005..=5.0, "the smaller one first");
        /// Length of an obstacle along the track [m].
        pub length_m: f64 = 0.1, 0.005..=5.0;
        /// Largest lateral offset of an obstacle's centre from the line through the start [m].
        pub lateral_m: f64 = 0.6, 0.0..=100.0;
    }
}

impl Endless {
    /// Passes when the widths are in order.
    pub(super) fn validate(&self) -> Result<(), Invalid> {
        let [narrow, wide] = self.width_m;
        if narrow > wide {
            return Err(Invalid::new("width_m", format!("[{narrow}, {wide}]"), "the smaller one first"));
        }
        Ok(())
    }

    /// The obstacles between a start and a goal at `goal_x_m` along the track.
    pub(super) fn placed(
        &self,
        seed: u64,
        start: &Start,
        goal_x_m: f64,
    ) -> impl Iterator<Item = ScenarioObstacle> {
        let (settings, start) = (*self, *start);
        let place = move |number: u64| start.x_m + FIRST_M + number as f64 * settings.spacing_m;
        (0..MAX_PLACED).take_while(move |number| place(*number) <= goal_x_m - LAST_M).map(move |number| {
            let mut stream = NoiseStream::new(seed, Purpose::Placement, number);
            let width_m = stream.between(settings.width_m[0], settings.width_m[1]);
            let y_m = start.y_m + stream.between(-settings.lateral_m, settings.lateral_m);
            let shape = Shape::Box { length_m: settings.length_m, width_m, yaw_rad: 0.0 };
            ScenarioObstacle::fixed(shape, place(number), y_m)
        })
    }
}
