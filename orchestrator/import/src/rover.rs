//! The log of a rover with differential drive and a Hokuyo URG-04LX, as the CoreSLAM paper published one: a scan per line.
//!
//! Columns, from 0: time [us]; ticks of the left and right wheel in 2 and 3; the 682 ranges [mm] from 24 on, in the order of the
//! scanner. 4,000 ticks are a turn of a wheel as published; matched scans say that the robot drives and turns further than that, so
//! both ways have a factor.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use console::user_file::{self, DATA_BYTES};
use recording::ros2::{BaseOdometry, LaserScan};
use shared_types::{BEAMS, ScanGeometry};

use crate::message::{Each, Message, refuse};

/// Columns that count.
const COLUMNS: usize = FIRST_RANGE + BEAMS;
const FIRST_RANGE: usize = 24;
/// Way of a wheel per tick, as published: radius 77 mm [m].
const TICK_M: f64 = PI / 2000.0 * 0.077;
/// Half of the axle, as published [m].
const HALF_AXLE_M: f64 = 0.165;
/// A turn of the scanner, of which two thirds are the sweep [s].
const TURN_S: f64 = 0.0987;
/// Its times begin anywhere [ns].
const START_NS: u64 = 1_000_000_000;
/// No log is longer: a year [us].
const MAX_TIME_US: f64 = 3.2e13;

/// A log.
pub(crate) struct RoverLog {
    path: PathBuf,
    rows: Vec<Row>,
    /// Whether the end of its last line is missing.
    pub(crate) cut_off: bool,
}

/// What a line says beside its ranges.
#[derive(Debug, Clone, Copy, Default)]
struct Row {
    time_ns: u64,
    /// Pose by the ticks [m, m, rad].
    pose: [f64; 3],
    /// Way and turn since the line before [m, rad].
    moved: [f64; 2],
}

impl RoverLog {
    /// What is known of the rover.
    pub(crate) const VEHICLE: &'static [&'static str] =
        &["vehicle.model=differential", "vehicle.scanner_x_m=0.145"];

    /// Reads a log with factors on the published way and turn.
    ///
    /// # Errors
    /// A file that is no such log, with the line; exit code 2.
    pub(crate) fn open(path: &Path, [way_factor, turn_factor]: [f64; 2]) -> anyhow::Result<Self> {
        let (mut rows, mut before): (Vec<Row>, Option<[f64; 2]>) = (Vec::new(), None);
        let cut_off = lines(path, &mut |_, fields| {
            let ticks = [fields[2], fields[3]];
            let [left_m, right_m] =
                before.map_or([0.0; 2], |before| [0, 1].map(|side| (ticks[side] - before[side]) * TICK_M));
            before = Some(ticks);
            let way_m = way_factor * (left_m + right_m) / 2.0;
            let turn_rad = turn_factor * (right_m - left_m) / (2.0 * HALF_AXLE_M);
            let [x_m, y_m, yaw_rad] = rows.last().map_or([0.0; 3], |row| row.pose);
            let (sin, cos) = (yaw_rad + turn_rad / 2.0).sin_cos();
            rows.push(Row {
                time_ns: START_NS + (fields[0] * 1e3) as u64,
                pose: [x_m + way_m * cos, y_m + way_m * sin, yaw_rad + turn_rad],
                moved: [way_m, turn_rad],
            });
            Ok(())
        })?;
        match rows.is_empty() {
            true => Err(refuse(path, "the file has no line")),
            false => Ok(Self { path: path.to_owned(), rows, cut_off }),
        }
    }

    /// Hands over its lines as messages.
    ///
    /// # Errors
    /// A file that was changed meanwhile; exit code 2. Errors of `each`.
    pub(crate) fn read(&self, each: &mut Each<'_>) -> anyhow::Result<()> {
        let geometry = ScanGeometry::URG_04LX;
        let ray_s = TURN_S * 2.0 / 3.0 / BEAMS as f64;
        let before_front_ns = (geometry.front() * ray_s * 1e9) as u64;
        lines(&self.path, &mut |index, fields| {
            let Some(row) = self.rows.get(index) else { return Err(refuse(&self.path, "it has grown")) };
            let odometry = BaseOdometry {
                stamp_ns: row.time_ns,
                pose: row.pose,
                velocity: self.velocity(index),
                ..BaseOdometry::default()
            };
            each(row.time_ns, Message::Odometry(odometry))?;
            let angles = [geometry.first_rad, geometry.yaw_rad(BEAMS - 1), geometry.increment_rad];
            let scan = LaserScan {
                stamp_ns: row.time_ns - before_front_ns,
                angles_rad: angles.map(|angle| angle as f32),
                times_s: [ray_s as f32, TURN_S as f32],
                limits_m: [0.02, 5.6],
                ranges_m: fields[FIRST_RANGE..COLUMNS]
                    .iter()
                    .map(|range_mm| (range_mm * 1e-3) as f32)
                    .collect(),
                ..LaserScan::default()
            };
            each(row.time_ns, Message::Scan(scan))
        })
        .map(drop)
    }

    /// Velocities at a line: of the ways around it, because the times jitter.
    fn velocity(&self, index: usize) -> [f64; 3] {
        let around = &self.rows[index.saturating_sub(1)..(index + 2).min(self.rows.len())];
        let sum =
            |of: usize| around.iter().map(|row| row.moved[of]).sum::<f64>() / (around.len() as f64 * TURN_S);
        [sum(0), 0.0, sum(1)]
    }
}

/// Hands over the numbers of each line that is not empty; whether the end of the last one, which is left out, is missing.
fn lines(path: &Path, each: &mut dyn FnMut(usize, &[f64]) -> anyhow::Result<()>) -> anyhow::Result<bool> {
    const EXPECTED: &str = "it is neither a bag of ROS 2 in MCAP nor a log of a rover";
    let text = user_file::read(path, DATA_BYTES)
        .map_err(|reason| refuse(path, format_args!("{EXPECTED}: {reason}")))?;
    let mut fields = Vec::new();
    let full = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    for (index, (number, line)) in full.enumerate() {
        fields.clear();
        let words = line.split_ascii_whitespace().take(COLUMNS);
        fields.extend(words.map_while(|word| word.parse::<f64>().ok()));
        let (line, count) = (number + 1, fields.len());
        if count < COLUMNS {
            if index > 0 && line == text.lines().count() && !text.ends_with('\n') {
                return Ok(true);
            }
            let reason = format!("line {line}: {count} numbers instead of {COLUMNS} or more");
            return Err(refuse(
                path,
                format_args!("{}{reason}", if index == 0 { format!("{EXPECTED}: ") } else { String::new() }),
            ));
        }
        if !(0.0..=MAX_TIME_US).contains(&fields[0]) || !fields.iter().all(|number| number.is_finite()) {
            return Err(refuse(
                path,
                format_args!("line {line}: a time of 0 to {MAX_TIME_US} us and finite numbers are expected"),
            ));
        }
        each(index, &fields)?;
    }
    Ok(false)
}

#[cfg(test)]
mod tests {
    use console::new_file::Scratch;

    use super::*;

    fn line(time_us: u64, left: i32, right: i32) -> String {
        let ranges: Vec<String> = (0..BEAMS).map(|beam| (10 + beam).to_string()).collect();
        format!("{time_us} 0 {left} {right}{} {} 0\n", " 0.5".repeat(20), ranges.join(" "))
    }

    #[test]
    fn lines_are_scans_with_the_way_of_the_wheels_times_the_factors() {
        let folder = Scratch::new().unwrap();
        let path = folder.path().join("log");
        // Half a turn of both wheels, 0.242 m as published; then 330 ticks apart, a tenth of that over the axle.
        let text = line(0, 0, 0) + "\n" + &line(98_700, 2000, 2000) + &line(197_400, 2000, 2200);
        std::fs::write(&path, text).unwrap();
        let log = RoverLog::open(&path, [2.0, 1.5]).unwrap();
        let mut read = Vec::new();
        log.read(&mut |log_ns, message| {
            read.push((log_ns, message));
            Ok(())
        })
        .unwrap();
        assert_eq!(read.len(), 6);
        let Message::Odometry(last) = &read[4].1 else { panic!() };
        let wheel_m = PI * 0.077;
        let ahead_m = 2.0 * wheel_m + 2.0 * (0.1 * wheel_m) / 2.0;
        let turned = 1.5 * (0.1 * wheel_m) / 0.33;
        assert!((last.pose[0] - ahead_m).abs() < 1e-3 && (last.pose[2] - turned).abs() < 1e-12, "{last:?}");
        let Message::Scan(scan) = &read[5].1 else { panic!() };
        assert_eq!((scan.ranges_m.len(), scan.ranges_m[681]), (682, 0.691));
        // The front beam has the time of the line.
        assert!(read[5].0 - scan.stamp_ns > 32_000_000);
    }

    #[test]
    fn another_file_and_a_bad_line_are_named() {
        let folder = Scratch::new().unwrap();
        let path = folder.path().join("log");
        let error = |text: &str| {
            std::fs::write(&path, text).unwrap();
            RoverLog::open(&path, [1.0; 2]).err().unwrap().to_string()
        };
        assert!(
            error("hello\n")
                .contains("neither a bag of ROS 2 in MCAP nor a log of a rover: line 1: 0 numbers")
        );
        let good = line(1, 0, 0);
        assert!(error(&format!("{good}1 2 3\n")).ends_with("line 2: 3 numbers instead of 706 or more"));
        std::fs::write(&path, format!("{good}1 2 3")).unwrap();
        let cut = RoverLog::open(&path, [1.0; 2]).unwrap();
        assert!(cut.cut_off && cut.rows.len() == 1);
        assert!(error(&good.replacen('1', "nan", 1)).contains("line 1: a time of 0 to"));
        assert!(error("\n\n").ends_with("the file has no line"));
    }
}
