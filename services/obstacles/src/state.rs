//! State that a restarted or swapped process resumes from: all tracks as plain bytes.

use shared_types::{Flag, plain_state};

use crate::evidence::EvidenceState;
use crate::shape::DIRECTIONS;

/// Largest number of tracked bodies: as many as fit a checkpoint, and more than a sample holds.
pub const TRACKS: usize = 17;

plain_state! {
    /// One tracked body.
    pub struct TrackState {
        /// Place and velocity of the reference point: x, y, vx, vy [m, m/s]
        pub motion: [f64; 4],
        /// Covariance of `motion`, column by column
        pub motion_covariance: [f64; 16],
        /// Place of the reference point of a body at rest [m]
        pub rest: [f64; 2],
        /// Covariance of `rest`: xx, xy, yy [m^2]
        pub rest_covariance: [f64; 3],
        /// Where the reference point was first seen, or last came to rest [m]
        pub origin: [f64; 2],
        /// Direction of the edges seen, at four times its angle, with their squared length [m^2]
        pub edges: [f64; 2],
        /// Time since the body was last seen [s]
        pub unseen_s: f64,
        /// For how long its returns have not come although it should be in view [s]
        pub silent_s: f64,
        /// For how much of that the robot has rested [s]
        pub rested_s: f64,
        /// Reach in each direction from the reference point, as bits of an f32 [m]
        pub reach: [u32; DIRECTIONS],
        /// Identity of the body, never 0
        pub body: u32,
        /// Scans that showed the body
        pub sightings: u32,
        /// Scans in a row that saw its place free
        pub free: u32,
        /// 1 while the body moves
        pub moving: Flag,
        /// Scans in a row that speak against `moving`
        pub doubts: u32,
        /// Direction of the box's axis
        pub orientation: u32,
        /// Ellipses that cover the body; 0 before the first description
        pub pieces: u32,
        /// 1 once the body is reported
        pub confirmed: Flag,
    }
}

plain_state! {
    /// State of an [`ObstacleDetector`](crate::ObstacleDetector) after a scan.
    pub struct ObstaclesState {
        /// When the last scan was acquired [ns]
        pub acquired_ns: u64,
        /// The last usable pose: x, y, yaw [m, rad]
        pub pose: [f64; 3],
        /// Place of that pose along the course, 0 without a course and -infinity before the first pose [m]
        pub along_m: f64,
        /// Identity of the body last found
        pub last_body: u32,
        /// How many of `tracks` are used
        pub count: u32,
        /// The tracks, oldest first
        pub tracks: [TrackState; TRACKS],
        /// What is known of the scanner
        pub evidence: EvidenceState,
    }
}
