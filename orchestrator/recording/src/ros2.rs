//! Scan and odometry as messages of ROS 2: `sensor_msgs/msg/LaserScan` and `nav_msgs/msg/Odometry`, as a bag has them.
//!
//! The order of the fields stands here, once for both ways; `ros2/*.msg` are the schemas of a bag that is written.

use runtime::settings_file;
use shared_types::{MIN_RANGE_MM, Odometry, Role, Sample, Scan, Topic};
use toml::Table;

use crate::cdr::{Cdr, Decoder};
use crate::mcap::{Contents, Schema};
use crate::read::attachment;
use crate::schema::{ENCAPSULATION, ROS2MSG, SEPARATOR};
use crate::tape::PREFIX;

/// Smallest and largest range of a scanner that is not described [m].
const LIMITS_M: [f32; 2] = [MIN_RANGE_MM as f32 * 1e-3, 100.0];

/// A message of ROS 2.
pub trait Ros2Message: Sized {
    /// Name of its type.
    const TYPE: &'static str;

    /// The message in CDR, little endian, with its encapsulation; `None` for bytes that are none.
    fn decode(data: &[u8]) -> Option<Self>;

    /// The message in CDR, little endian.
    fn encode(&self) -> Vec<u8>;

    /// Whether a schema has this name; before ROS 2 it had no `/msg/`.
    fn is_named(name: &str) -> bool {
        name == Self::TYPE || name == Self::TYPE.replace("/msg/", "/")
    }
}

/// A sweep.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LaserScan {
    /// When the first ray was measured; zero where the message does not say so [ns].
    pub stamp_ns: u64,
    /// Its frame.
    pub frame: String,
    /// Angles of the first and the last ray, and from one ray to the next [rad].
    pub angles_rad: [f32; 3],
    /// Time from one ray to the next, and from one scan to the next; zero where it is not known [s].
    pub times_s: [f32; 2],
    /// Smallest and largest range that is measured [m].
    pub limits_m: [f32; 2],
    /// Range per ray [m].
    pub ranges_m: Vec<f32>,
}

/// Pose and velocities of the base.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BaseOdometry {
    /// When it was measured; zero where the message does not say so [ns].
    pub stamp_ns: u64,
    /// The frame of the pose, and that of the velocities.
    pub frames: [String; 2],
    /// Position and yaw [m, m, rad].
    pub pose: [f64; 3],
    /// Velocities ahead and to the left, yaw rate [m/s, m/s, rad/s].
    pub velocity: [f64; 3],
}

impl LaserScan {
    /// A scan of a scanner with these limits as a message [m].
    pub fn of(scan: &Scan, limits_m: [f32; 2]) -> Self {
        let beams = scan.ranges().len();
        let time_s = scan.sweep_ns as f64 * 1e-9 / beams.max(1) as f64;
        let before_front_ns = (scan.geometry().front() * time_s * 1e9).round() as i64;
        let range = |beam: usize| scan.range_m(beam).map_or(f32::INFINITY, |range_m| range_m as f32);
        Self {
            stamp_ns: scan.header.acquired_ns.saturating_add_signed(before_front_ns.saturating_neg()),
            frame: "laser".to_owned(),
            angles_rad: [
                scan.beam_yaw_rad(0),
                scan.beam_yaw_rad(beams.saturating_sub(1)),
                scan.increment_rad,
            ]
            .map(|angle| angle as f32),
            times_s: [time_s as f32, scan.period_ns as f32 * 1e-9],
            limits_m,
            ranges_m: (0..beams).map(range).collect(),
        }
    }
}

impl BaseOdometry {
    /// A sample of the odometry as a message.
    pub fn of(odometry: &Odometry) -> Self {
        let Odometry { x_m, y_m, yaw_rad, dyaw_rad, dt_s, speed_mps, .. } = *odometry;
        let yaw_rate_radps = if dt_s > 0.0 { dyaw_rad / dt_s } else { 0.0 };
        Self {
            stamp_ns: odometry.header.acquired_ns,
            frames: ["odom", "base_link"].map(str::to_owned),
            pose: [x_m, y_m, yaw_rad],
            velocity: [speed_mps, 0.0, yaw_rate_radps],
        }
    }
}

impl Ros2Message for LaserScan {
    const TYPE: &'static str = "sensor_msgs/msg/LaserScan";

    fn encode(&self) -> Vec<u8> {
        let mut cdr = Cdr::new();
        cdr.time(self.stamp_ns).text(&self.frame);
        for number in self.angles_rad.iter().chain(&self.times_s).chain(&self.limits_m) {
            cdr.f32(*number);
        }
        cdr.length(self.ranges_m.len());
        self.ranges_m.iter().for_each(|range| _ = cdr.f32(*range));
        cdr.length(0);
        cdr.finish()
    }

    fn decode(data: &[u8]) -> Option<Self> {
        let cdr = &mut Decoder::new(data.strip_prefix(&ENCAPSULATION)?);
        Some(Self {
            stamp_ns: stamp_ns(cdr)?,
            frame: cdr.text()?.to_owned(),
            angles_rad: [cdr.f32()?, cdr.f32()?, cdr.f32()?],
            times_s: [cdr.f32()?, cdr.f32()?],
            limits_m: [cdr.f32()?, cdr.f32()?],
            ranges_m: cdr.f32s()?,
        })
    }
}

impl Ros2Message for BaseOdometry {
    const TYPE: &'static str = "nav_msgs/msg/Odometry";

    fn encode(&self) -> Vec<u8> {
        let mut cdr = Cdr::new();
        let [frame, child] = &self.frames;
        cdr.time(self.stamp_ns).text(frame).text(child);
        cdr.pose([self.pose[0], self.pose[1]], 0.0, self.pose[2]).numbers(&[0.0; 36]);
        let [ahead, left, yaw_rate] = self.velocity;
        cdr.numbers(&[ahead, left, 0.0, 0.0, 0.0, yaw_rate]).numbers(&[0.0; 36]);
        cdr.finish()
    }

    fn decode(data: &[u8]) -> Option<Self> {
        let cdr = &mut Decoder::new(data.strip_prefix(&ENCAPSULATION)?);
        let stamp_ns = stamp_ns(cdr)?;
        let frames = [cdr.text()?.to_owned(), cdr.text()?.to_owned()];
        let [x_m, y_m, _, x, y, z, w] = cdr.numbers()?;
        let _covariance: [f64; 36] = cdr.numbers()?;
        let [ahead, left, _, _, _, yaw_rate] = cdr.numbers()?;
        let yaw_rad = (2.0 * (w * z + x * y)).atan2(w * w + x * x - y * y - z * z);
        Some(Self { stamp_ns, frames, pose: [x_m, y_m, yaw_rad], velocity: [ahead, left, yaw_rate] })
    }
}

/// A stamp [ns]; zero for one before its epoch.
fn stamp_ns(cdr: &mut Decoder<'_>) -> Option<u64> {
    let [seconds, nanoseconds] = cdr.time()?;
    let is_time = seconds <= i32::MAX as u32 && nanoseconds < 1_000_000_000;
    Some(if is_time { u64::from(seconds) * 1_000_000_000 + u64::from(nanoseconds) } else { 0 })
}

/// Topics of a bag that is written, with the schemas of their messages.
pub(crate) fn topics() -> [(&'static str, Schema); 2] {
    let schema = |name: &str, text: &str| Schema {
        name: name.to_owned(),
        encoding: ROS2MSG.to_owned(),
        text: text.replace("---\n", &format!("{SEPARATOR}\n")),
    };
    [
        ("/scan", schema(LaserScan::TYPE, include_str!("ros2/LaserScan.msg"))),
        ("/odom", schema(BaseOdometry::TYPE, include_str!("ros2/Odometry.msg"))),
    ]
}

/// What a message of a recording is for ROS 2: the place of its topic in [`topics`], and its content. `None` for all but scans
/// and odometry with the layout of this program.
pub(crate) fn message(channel: &str, data: &[u8], limits_m: [f32; 2]) -> Option<(usize, Vec<u8>)> {
    let bytes = data.strip_prefix(&ENCAPSULATION)?;
    match channel.strip_prefix(PREFIX)?.parse().ok()? {
        Topic::Scan => sample::<Scan>(bytes).map(|scan| (0, LaserScan::of(&scan, limits_m).encode())),
        Topic::Odometry => {
            sample::<Odometry>(bytes).map(|odometry| (1, BaseOdometry::of(&odometry).encode()))
        }
        _ => None,
    }
}

/// The smallest and the largest range of the scanner that the settings of a recording describe [m].
pub(crate) fn limits_m(contents: &Contents) -> [f32; 2] {
    let described = || {
        let table: Table = attachment(contents, &settings_file(Role::Obstacles))?.parse().ok()?;
        let scanner = table.get("obstacles")?.get("vehicle")?.get("scanner")?;
        let of = |key: &str| Some(scanner.get(key)?.as_float()? as f32);
        Some([of("min_range_m")?, of("range_m")?])
    };
    described().unwrap_or(LIMITS_M)
}

fn sample<S: Sample>(bytes: &[u8]) -> Option<S> {
    bytemuck::try_pod_read_unaligned(bytes).ok().filter(|sample: &S| sample.header().layout == S::LAYOUT)
}

#[cfg(test)]
mod tests {
    use shared_types::{Header, ScanGeometry};

    use super::*;

    fn scan() -> Scan {
        let header = Header { acquired_ns: 1_700_000_000_123_456_789, ..Header::default() };
        let mut scan =
            Scan { header, sweep_ns: 66_666_666, period_ns: 100_000_000, ..Scan::of(ScanGeometry::URG_04LX) };
        for (beam, range) in scan.ranges_mut().iter_mut().enumerate() {
            *range = 10 + 8 * beam as u32;
        }
        scan
    }

    #[test]
    fn a_scan_comes_back_to_the_millimetre_and_an_error_code_is_no_return() {
        let message = LaserScan::of(&scan(), LIMITS_M);
        let read = LaserScan::decode(&message.encode()).unwrap();
        assert_eq!(read, message);
        // 340 of 682 beams lie before the front one: 33.2 ms.
        assert_eq!(scan().header.acquired_ns - read.stamp_ns, 33_235_581);
        assert_eq!((read.ranges_m[0], read.ranges_m[1]), (f32::INFINITY, f32::INFINITY));
        for (beam, range_m) in read.ranges_m.iter().enumerate().skip(2) {
            assert_eq!((f64::from(*range_m) * 1e3).round() as u32, scan().ranges_mm[beam]);
        }
    }

    #[test]
    fn an_odometry_comes_back() {
        let odometry = Odometry { x_m: 1.5, yaw_rad: -2.5, dyaw_rad: 0.25, dt_s: 0.5, ..Odometry::default() };
        let message = BaseOdometry { stamp_ns: 7_000_000_001, ..BaseOdometry::of(&odometry) };
        let read = BaseOdometry::decode(&message.encode()).unwrap();
        assert_eq!(
            (read.stamp_ns, read.frames, read.velocity),
            (7_000_000_001, message.frames, [0.0, 0.0, 0.5])
        );
        assert!((read.pose[2] + 2.5).abs() < 1e-12 && read.pose[0] == 1.5);
    }

    #[test]
    fn a_cut_message_and_one_that_is_longer_than_its_bytes_are_none() {
        let data = LaserScan::of(&scan(), LIMITS_M).encode();
        for length in 0..data.len() - 4 {
            assert_eq!(LaserScan::decode(&data[..length]), None);
        }
        // The length of the ranges stands in front of them and of that of no intensities.
        let at = data.len() - 4 - 682 * 4 - 4;
        let mut forged = data.clone();
        forged[at..at + 4].copy_from_slice(&(1_u32 << 31).to_le_bytes());
        assert_eq!((LaserScan::decode(&forged), LaserScan::decode(&data).is_some()), (None, true));
        assert_eq!(LaserScan::decode(&[&[0, 0, 0, 0], &data[4..]].concat()), None, "big endian");
    }
}
