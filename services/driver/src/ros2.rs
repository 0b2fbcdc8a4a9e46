//! Settings of the program `scanloop-ros2`, the table `[ros2]` of the system file.
//!
//! They stand here, apart from the program, so that `scanloop check` names a wrong key without linking DDS.

use key_table::{Documented, Invalid, Setting, settings};
use serde::{Deserialize, Serialize};

use crate::scanner::{PLACE, ScannerSettings};

/// Which message drives the wheels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CommandType {
    /// `geometry_msgs/Twist`: velocity and yaw rate.
    Twist,
    /// `geometry_msgs/TwistStamped`: the same with a stamp.
    TwistStamped,
    /// `ackermann_msgs/AckermannDriveStamped`: velocity and steering angle.
    Ackermann,
}

/// What of the odometry is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OdometryUse {
    /// Pose and twist.
    Pose,
    /// The twist only, which is added up to a pose.
    Twist,
}

/// Where the scans come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Ros2Scan {
    /// From a topic of the robot.
    Topic,
    /// From a Hokuyo scanner that is connected to this computer.
    Urg,
}

/// Where the pose of the scanner on the robot comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ScannerPose {
    /// From the table `[vehicle]`.
    Vehicle,
    /// Its turn from `/tf_static`, also upside down; a place that is not that of `[vehicle]` ends the start.
    Tf,
}

/// How commands are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CommandReliability {
    /// Lost ones are sent again.
    Reliable,
    /// Lost ones are lost.
    BestEffort,
}

impl Setting for CommandType {}
impl Setting for OdometryUse {}
impl Setting for Ros2Scan {}
impl Setting for ScannerPose {}
impl Setting for CommandReliability {}

/// The topics that a robot has, as the program knows them.
pub const TOPICS: [&str; 4] = ["scan", "odom", "cmd_vel", "tf_static"];
/// What `remap` may be.
const REMAP: Documented = Documented {
    text: "texts FROM:=TO with FROM one of scan, odom, cmd_vel, tf_static",
    schema: "pattern = '^/*(scan|odom|cmd_vel|tf_static):=/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*$'",
};
/// What `interface` may be.
const INTERFACE: &str = "empty for all, or the IP address of a network interface, as 127.0.0.1";
/// What the name of a frame may be.
const FRAME: &str = "the name of a frame, or empty for any";

/// What `namespace` may be.
const NAMESPACE: Documented = Documented {
    text: "empty, or a name that begins with `/`",
    schema: "pattern = '^(/[A-Za-z_][A-Za-z0-9_]*)*$'",
};

settings! {
    /// Settings of the driver for ROS 2 robots, implementation `ros2` of role `robot`.
    pub struct Ros2Config {
        /// The ROS 2 domain, as in `ROS_DOMAIN_ID`.
        pub domain: u32 = 0, 0.0..=232.0;
        /// Address of the only network interface that is used; empty for all.
        pub interface: String = String::new(), INTERFACE;
        /// Namespace of the robot, before all topics that do not begin with `/`.
        pub namespace: String = String::new(), NAMESPACE;
        /// Other names of topics, as `ros2 run` takes them: `scan:=/front/scan`.
        pub remap: Vec<String> = Vec::new(), REMAP;
        /// Message for the wheels: velocity and yaw rate, the same with a stamp, or velocity and steering angle.
        pub command: CommandType = CommandType::Twist;
        /// How commands are sent; both match a reader of the robot that takes what comes.
        pub reliability: CommandReliability = CommandReliability::Reliable;
        /// Wheelbase that the steering angle refers to: angle = atan(wheelbase x curvature) [m].
        pub wheelbase_m: f64 = 0.3, 0.01..=10.0;
        /// What of the odometry is used: its pose, or its twist alone.
        pub odometry: OdometryUse = OdometryUse::Pose;
        /// Where the scans come from: a topic of the robot, or a Hokuyo scanner at this computer.
        pub scan: Ros2Scan = Ros2Scan::Topic;
        /// Device or address of the Hokuyo scanner, with `scan = "urg"`.
        pub urg: String = "/dev/ttyACM0".to_owned(), PLACE;
        /// Scans of the Hokuyo scanner that are left out after each one; the rate falls by as much.
        pub urg_skip: u32 = 0, 0.0..=9.0;
        /// Steps of the Hokuyo scanner that are merged to one range, the smallest: fewer bytes on a slow line.
        pub urg_cluster: u32 = 1, 1.0..=10.0;
        /// Whether the Hokuyo scanner sends two characters per range instead of three: a third less, up to 4.09 m.
        pub urg_two_characters: bool = false;
        /// Bit rate of a serial line to the Hokuyo scanner; without effect over USB and TCP [bit/s].
        pub urg_bit_rate: u32 = 115_200, 9_600.0..=4_000_000.0;
        /// `frame_id` that the odometry has to have; empty for any.
        pub odometry_frame: String = String::new(), FRAME;
        /// `child_frame_id` that the odometry has to have; empty for any. Commands have it as `frame_id`.
        pub base_frame: String = String::new(), FRAME;
        /// `frame_id` that the scans have to have; empty for any.
        pub scan_frame: String = String::new(), FRAME;
        /// Where the pose of the scanner comes from: these settings, or `/tf_static`, whose place has to be that of `[vehicle]`.
        pub scanner_pose: ScannerPose = ScannerPose::Vehicle;
        /// Sign of the beam angles; -1 for a scanner that is mounted upside down.
        pub scan_sign: f64 = 1.0, Documented { text: "1 or -1", schema: "enum = [1, -1]" };
        /// Where the scanner's angle zero points, seen from straight ahead of the scan; pi for one that looks backwards [rad].
        pub scan_yaw_rad: f64 = 0.0, -3.15..=3.15;
        /// Duration of a sweep over all beams, for a scanner whose messages have no `time_increment` [s].
        pub sweep_s: f64 = 0.0, 0.0..=1.0;
        /// Smallest time from the stamp of an odometry to its arrival here [s].
        pub delay_s: f64 = 0.0, 0.0..=0.1;
        /// At the start, the driver waits this long for scan, odometry and a reader of its commands [s].
        pub connect_timeout_s: f64 = 5.0, 0.1..=8.0;
        /// The wheels are blocked when no message of a topic has come for this long, and for two scan periods [s].
        pub silence_s: f64 = 1.0, 0.2..=60.0;
    }
}

impl Ros2Config {
    /// Passes when all settings are allowed.
    ///
    /// # Errors
    /// The first key that is not, with its value and what is allowed.
    pub fn validate(&self) -> Result<(), Invalid> {
        self.require_ranges()?;
        let refuse =
            |key: &str, text: &str, allowed: &str| Err(Invalid::new(key, format!("{text:?}"), allowed));
        if !self.interface.is_empty() && self.interface.parse::<std::net::IpAddr>().is_err() {
            return refuse("interface", &self.interface, INTERFACE);
        }
        let is_namespace =
            self.namespace.is_empty() || (self.namespace.starts_with('/') && is_name(&self.namespace));
        if !is_namespace {
            return refuse("namespace", &self.namespace, NAMESPACE.text);
        }
        for (index, text) in self.remap.iter().enumerate() {
            let parts = text.split_once(":=");
            if !parts.is_some_and(|(from, to)| TOPICS.contains(&from.trim_start_matches('/')) && is_name(to))
            {
                return refuse(&format!("remap[{index}]"), text, REMAP.text);
            }
        }
        let frames = [
            ("odometry_frame", &self.odometry_frame),
            ("base_frame", &self.base_frame),
            ("scan_frame", &self.scan_frame),
        ];
        for (key, frame) in frames {
            if frame.contains(char::is_whitespace) {
                return refuse(key, frame, FRAME);
            }
        }
        ScannerSettings::require_place(&self.urg)?;
        let is_placed = self.scan_yaw_rad == 0.0 && self.scan_sign == 1.0;
        if self.has_scanner() && !(is_placed && self.scanner_pose == ScannerPose::Vehicle) {
            let allowed = "\"topic\" with scan_sign, scan_yaw_rad or scanner_pose, which are of a topic: `[vehicle]` has the \
                           pose of a scanner at this computer";
            return Err(Invalid::new("scan", "\"urg\"", allowed));
        }
        if self.scan_sign.abs() != 1.0 {
            return Err(Invalid::new("scan_sign", self.scan_sign, "1 or -1"));
        }
        if self.scanner_pose == ScannerPose::Tf {
            if self.scan_sign != 1.0 {
                return Err(Invalid::new(
                    "scan_sign",
                    self.scan_sign,
                    "1 with scanner_pose = \"tf\", which has it",
                ));
            }
            if self.scan_yaw_rad != 0.0 {
                let allowed = "0 with scanner_pose = \"tf\", which has it";
                return Err(Invalid::new("scan_yaw_rad", self.scan_yaw_rad, allowed));
            }
        }
        Ok(())
    }

    /// Whether the scanner has a connection of its own.
    pub fn has_scanner(&self) -> bool {
        self.scan == Ros2Scan::Urg
    }

    /// The Hokuyo scanner at this computer.
    pub fn scanner_settings(&self) -> ScannerSettings {
        ScannerSettings {
            place: self.urg.clone(),
            skip: self.urg_skip,
            cluster: self.urg_cluster,
            two_characters: self.urg_two_characters,
            bit_rate: self.urg_bit_rate,
        }
    }

    /// The name of one of [`TOPICS`] with remapping and namespace, beginning with `/`.
    pub fn topic(&self, name: &str) -> String {
        let mut pairs = self.remap.iter().filter_map(|text| text.split_once(":="));
        let mapped = pairs.rfind(|(from, _)| from.trim_start_matches('/') == name);
        let name = match (mapped, name) {
            (Some((_, to)), _) => to,
            // Frames of all robots stand in one tree.
            (None, "tf_static") => "/tf_static",
            (None, name) => name,
        };
        if name.starts_with('/') { name.to_owned() } else { format!("{}/{name}", self.namespace) }
    }
}

/// Whether a text is the name of a topic, or a namespace.
pub fn is_name(text: &str) -> bool {
    let is_part = |part: &str| {
        part.starts_with(|first: char| first.is_ascii_alphabetic() || first == '_')
            && part.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
    };
    text.strip_prefix('/').unwrap_or(text).split('/').all(is_part)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(text: &str) -> Ros2Config {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn a_value_that_is_not_allowed_is_named_with_its_range() {
        let refusal = |text: &str| {
            config(text).validate().map_err(|invalid| invalid.within("ros2")).unwrap_err().to_string()
        };
        assert_eq!(Ros2Config::default().validate(), Ok(()));
        assert_eq!(refusal("domain = 233"), "ros2.domain = 233 is not allowed: 0 to 232");
        assert_eq!(
            refusal("interface = \"lo\""),
            format!("ros2.interface = \"lo\" is not allowed: {INTERFACE}")
        );
        for remap in ["scan=/front", "laser:=/scan", "scan:=/front scan", "scan:=", "scan:=/1a"] {
            let expected = format!("ros2.remap[0] = {remap:?} is not allowed: {}", REMAP.text);
            assert_eq!(refusal(&format!("remap = [{remap:?}]")), expected);
        }
        assert!(refusal("namespace = \"robot1\"").contains("begins with `/`"));
        assert!(refusal("scan_frame = \"a b\"").contains("the name of a frame"));
        assert_eq!(refusal("scan_sign = 0.5"), "ros2.scan_sign = 0.5 is not allowed: 1 or -1");
        assert_eq!(
            refusal("urg = \"ttyACM0\""),
            "ros2.urg = \"ttyACM0\" is not allowed: a device such as /dev/ttyACM0, or HOST:PORT"
        );
        for with in ["scan_sign = -1", "scan_yaw_rad = 3.0", "scanner_pose = \"tf\""] {
            let refused = refusal(&format!("scan = \"urg\"\n{with}"));
            assert!(refused.starts_with("ros2.scan = \"urg\" is not allowed: \"topic\" with"), "{refused}");
        }
        assert_eq!(config("scan = \"urg\"\nurg = \"10.0.0.7:10940\"").validate(), Ok(()));
        let turned = refusal("scanner_pose = \"tf\"\nscan_yaw_rad = 3.0");
        assert_eq!(
            turned,
            "ros2.scan_yaw_rad = 3 is not allowed: 0 with scanner_pose = \"tf\", which has it"
        );
        assert!(
            refusal("scanner_pose = \"tf\"\nscan_sign = -1")
                .contains("ros2.scan_sign = -1 is not allowed: 1 with")
        );
    }

    #[test]
    fn topics_are_remapped_as_ros_users_write_it() {
        let plain = Ros2Config::default();
        assert_eq!(TOPICS.map(|name| plain.topic(name)), ["/scan", "/odom", "/cmd_vel", "/tf_static"]);
        let robot = config("namespace = \"/robot1\"\nremap = [\"scan:=/front/scan\", \"/cmd_vel:=drive\"]");
        let names = ["/front/scan", "/robot1/odom", "/robot1/drive", "/tf_static"];
        assert_eq!(TOPICS.map(|name| robot.topic(name)), names);
    }
}
