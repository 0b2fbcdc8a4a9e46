//! What viewers draw: scan, pose, path, obstacles and log lines in the well-known types of Foxglove, encoded as CDR.
//!
//! These messages are made from the samples, so they hold nothing new. Of a scan every fourth beam is drawn. Ranges are
//! rounded to 1/128 m, less than the scanner's noise, and the path to 1/1024 m, because such numbers end with zeros and
//! compress well.

use shared_types::{Command, CommandKind, Obstacles, Pose, Scan};

use crate::cdr::{self, Cdr};
use crate::mcap::Schema;
use crate::schema::{ROS2MSG, SEPARATOR};

/// Frame of the track.
const TRACK: &str = "track";
/// Frame of the robot.
const ROBOT: &str = "robot";
/// One of so many beams is drawn: their ranges are the largest part of what viewers draw.
const DRAWN_BEAMS: usize = 4;
/// Rounding of ranges [1/m].
const RANGE_STEPS: f64 = 128.0;
/// Rounding of the path [1/m].
const PATH_STEPS: f64 = 1024.0;
/// Height that bodies are drawn with [m].
const HEIGHT_M: f64 = 0.3;

/// The channels made from samples: topic, type, and the text of the type.
pub(crate) const CHANNELS: [(&str, &str, &str); 6] = [
    ("/foxglove/scan", "LaserScan", include_str!("foxglove/LaserScan.msg")),
    ("/foxglove/pose", "PoseInFrame", include_str!("foxglove/PoseInFrame.msg")),
    ("/foxglove/robot", "FrameTransform", include_str!("foxglove/FrameTransform.msg")),
    ("/foxglove/path", "PosesInFrame", include_str!("foxglove/PosesInFrame.msg")),
    ("/foxglove/obstacles", "SceneUpdate", include_str!("foxglove/SceneUpdate.msg")),
    ("/foxglove/log", "Log", include_str!("foxglove/Log.msg")),
];
pub(crate) const SCAN: usize = 0;
pub(crate) const POSE: usize = 1;
pub(crate) const TRANSFORM: usize = 2;
pub(crate) const PATH: usize = 3;
pub(crate) const OBSTACLES: usize = 4;
/// Index of the log in [`CHANNELS`].
pub(crate) const LOG: usize = 5;

/// The schemas of [`CHANNELS`], in their order.
pub(crate) fn schemas() -> impl Iterator<Item = Schema> {
    CHANNELS.iter().map(|(_, name, text)| Schema {
        name: format!("foxglove_msgs/msg/{name}"),
        encoding: ROS2MSG.to_owned(),
        text: text.replace("---\n", &format!("{SEPARATOR}\n")),
    })
}

/// A line of a log, as it was recorded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogLine {
    /// When it was recorded, on the clock of the loop [ns].
    pub log_ns: u64,
    /// The role, or `orchestrator`.
    pub name: String,
    /// Whether it is a warning or an error.
    pub is_warning: bool,
    /// The line.
    pub text: String,
}

/// The line in what follows the encapsulation of a message of [`LOG`]; `None` when it is damaged.
pub(crate) fn log_line(log_ns: u64, content: &[u8]) -> Option<LogLine> {
    let mut cdr = cdr::Decoder::new(content);
    let (_, level) = (cdr.time()?, cdr.u8()?);
    let (text, name) = (cdr.text()?.to_owned(), cdr.text()?.to_owned());
    Some(LogLine { log_ns, name, is_warning: level >= Level::Warning as u8, text })
}

/// Severity of a log line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Level {
    /// Nothing else is known.
    Info = 2,
    /// Degraded, but driving.
    Warning = 3,
    /// No output.
    Error = 4,
}

/// A scan in the frame of the robot.
pub(crate) fn scan(scan: &Scan) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.time(scan.header.acquired_ns).text(ROBOT).pose([0.0; 2], 0.0, 0.0);
    let beams = (0..scan.ranges().len()).step_by(DRAWN_BEAMS);
    cdr.f64(scan.beam_yaw_rad(0)).f64(scan.beam_yaw_rad(beams.clone().next_back().unwrap_or_default()));
    cdr.length(beams.len());
    for beam in beams {
        let range_m = scan.range_m(beam).map(|range_m| rounded(range_m, RANGE_STEPS));
        cdr.f64(range_m.unwrap_or(f64::INFINITY));
    }
    cdr.length(0);
    cdr.finish()
}

/// A pose on the track.
pub(crate) fn pose(pose: &Pose) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.time(pose.header.acquired_ns).text(TRACK).pose([pose.x_m, pose.y_m], 0.0, pose.yaw_rad);
    cdr.finish()
}

/// The place of the robot's frame on the track.
pub(crate) fn transform(pose: &Pose) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.time(pose.header.acquired_ns).text(TRACK).text(ROBOT).pose([pose.x_m, pose.y_m], 0.0, pose.yaw_rad);
    cdr.finish()
}

/// The plan of a command; empty while the wheels are to be blocked.
pub(crate) fn path(command: &Command) -> Vec<u8> {
    let drives = command.kind == CommandKind::Drive.wire();
    let nodes = if drives { command.nodes() } else { &[] };
    let mut cdr = Cdr::new();
    cdr.time(command.header.acquired_ns).text(TRACK).length(nodes.len());
    for node in nodes {
        let (sin, cos) = (node.yaw_rad / 2.0).sin_cos();
        let numbers = [node.x_m, node.y_m, 0.0, 0.0, 0.0, sin, cos];
        cdr.numbers(&numbers.map(|number| rounded(number, PATH_STEPS)));
    }
    cdr.finish()
}

fn rounded(number: f64, steps: f64) -> f64 {
    (number * steps).round() / steps
}

/// Boxes and ellipses of obstacles; those of earlier scans are removed.
pub(crate) fn obstacles(obstacles: &Obstacles) -> Vec<u8> {
    const DELETE_ALL: u8 = 1;
    let time_ns = obstacles.header.acquired_ns;
    let mut cdr = Cdr::new();
    cdr.length(1).time(time_ns).u8(DELETE_ALL).text("");
    cdr.length(obstacles.list().len());
    for item in obstacles.list() {
        cdr.time(time_ns).text(TRACK).text(&item.id.to_string());
        // Lifetime: until it is removed. Not locked to its frame.
        cdr.u32(0).u32(0).u8(0);
        // Metadata, arrows.
        cdr.length(0).length(0);
        cdr.length(1).pose([item.box_x_m, item.box_y_m], HEIGHT_M / 2.0, item.box_yaw_rad);
        cdr.numbers(&[item.box_length_m, item.box_width_m, HEIGHT_M]).numbers(&[0.8, 0.2, 0.1, 0.9]);
        // Spheres.
        cdr.length(0);
        cdr.length(1).pose([item.x_m, item.y_m], 0.0, 0.0);
        cdr.numbers(&[2.0 * item.a_m, 2.0 * item.b_m, 0.02]).numbers(&[1.0, 1.0]);
        cdr.numbers(&[0.9, 0.6, 0.1, 0.3]);
        // Lines, triangles, texts, models.
        (0..4).for_each(|_| _ = cdr.length(0));
    }
    cdr.finish()
}

/// A line of a log.
pub(crate) fn log(time_ns: u64, level: Level, name: &str, message: &str) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.time(time_ns).u8(level as u8).text(message).text(name).text("").u32(0);
    cdr.finish()
}
