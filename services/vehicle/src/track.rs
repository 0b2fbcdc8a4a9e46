//! Where the robot drives: the track, as scenario and controller know it.

use std::fmt;

use key_table::{Ascending, Setting, settings};
use serde::{Deserialize, Serialize};

/// What the scanner sees outside of the track.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Surroundings {
    /// A hall whose walls and pillars are within reach of the scanner.
    #[default]
    Hall,
    /// Nothing: a blind scanner and an empty track give the same scans.
    Open,
}

impl Setting for Surroundings {}

impl Surroundings {
    /// How far outside of the track's bounds the walls of the hall stand [m].
    pub const HALL_M: f64 = 2.0;
    /// Side of a pillar of the hall [m].
    pub const PILLAR_M: f64 = 0.3;
    /// Distance from pillar to pillar; one is at x = 0 [m].
    pub const SPACING_M: f64 = 2.5;

    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Hall => "hall",
            Self::Open => "open",
        }
    }
}

impl fmt::Display for Surroundings {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

settings! {
    /// The track.
    #[derive(Copy)]
    pub struct Track {
        /// Bounds of the robot's centre along the track, (7.45) [m].
        pub x_m: [f64; 2] = [0.0, 22.0], Ascending(-1e4..=1e4, 0.0);
        /// Bounds of the robot's centre across the track, (7.46), or with `walls` the surfaces of the walls [m].
        pub y_m: [f64; 2] = [-1.5, 1.5], Ascending(-1e3..=1e3, Self::MIN_WIDTH_M);
        /// Whether the track has walls at `y_m`, which the scanner sees. The robot's centre then stays half the body width
        /// and the safety distance away from them.
        pub walls: bool = false;
        /// What the scanner sees outside of the track. `hall`: walls 2 m outside of the bounds, the side walls with
        /// pillars of 0.3 m every 2.5 m; `walls` hides it, and the robot can't touch it. `open`: nothing.
        pub surroundings: Surroundings = Surroundings::Hall;
    }
}

impl Track {
    /// Smallest width of a track: what is between the bands of its walls [m].
    pub const MIN_WIDTH_M: f64 = 0.5;
}
