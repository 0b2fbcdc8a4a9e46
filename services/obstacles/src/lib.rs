//! The obstacle detector, (7.32)-(7.35): from the ranges of one scan to the ellipses that the robot stays outside of.
//!
//! Returns are placed in the track from the pose at their own time, those of walls are removed, the rest is segmented
//! into bodies. Bodies are tracked from scan to scan: their outline grows as more of them is seen, their place and
//! velocity are filtered, and they are remembered beside and behind the robot until a scan shows their place free.
//! Each body is then covered by ellipses.
//!
//! Pure: the same inputs give the same bits. State between scans is [`ObstaclesState`], plain bytes that another
//! process can resume from.

mod config;
mod detector;
mod ellipse;
mod evidence;
mod hollow;
mod hull;
mod motion;
mod outline;
mod outlines;
mod part;
mod points;
mod segment;
mod shape;
mod stage;
mod state;
mod thin;
mod track;
mod tracks;
mod visibility;
mod walls;
mod way;

pub use config::{CoverRule, ObstaclesConfig, SWEEP_SHARE};
pub use detector::ObstacleDetector;
pub use shape::DIRECTIONS;
pub use stage::DetectorStage;
pub use state::{ObstaclesState, TRACKS, TrackState};
