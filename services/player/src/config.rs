//! Settings of the driver, the table `[player]` of the system file.

use driver::scanner::{PLACE, ScannerSettings};
use key_table::{Documented, Invalid, Setting, settings};
use serde::{Deserialize, Serialize};

use crate::header::{DeviceAddress, interface};

/// Where the scans come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScanSource {
    /// From a scanner of the Player server.
    Player,
    /// From a Hokuyo scanner that is connected to this computer.
    Urg,
}

/// Which interface of a scanner is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScannerInterface {
    /// `ranger` where the server has one, else `laser`.
    Auto,
    /// The interface ranger.
    Ranger,
    /// The older interface laser.
    Laser,
}

/// How the server delivers data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Delivery {
    /// At once.
    Push,
    /// When the driver asks.
    Pull,
}

/// Which command drives the wheels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DriveCommand {
    /// Velocity and steering angle.
    Car,
    /// Velocity and yaw rate.
    Velocity,
}

impl Setting for ScanSource {}
impl Setting for ScannerInterface {}
impl Setting for Delivery {}
impl Setting for DriveCommand {}

/// What a sign may be.
const SIGN: &str = "1 or -1";
const ONE: &str = "enum = [1, -1]";

settings! {
    /// Settings of the driver for Player servers, implementation `player` of role `robot`.
    pub struct PlayerConfig {
        /// Host name or address of the server.
        pub host: String = "127.0.0.1".to_owned(), Documented { text: "not empty", schema: "minLength = 1" };
        /// Port of the server, which selects the robot.
        pub port: u32 = 6665, 1.0..=65535.0;
        /// Index of the base among the devices of interface position2d.
        pub position2d: u32 = 0, 0.0..=65535.0;
        /// Where the scans come from: a scanner of the server, or a Hokuyo scanner at this computer.
        pub scan: ScanSource = ScanSource::Player;
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
        /// Interface of the server's scanner; `auto` is ranger, or laser where there is no ranger.
        pub scanner: ScannerInterface = ScannerInterface::Auto;
        /// Index of the scanner among the devices of its interface.
        pub scanner_index: u32 = 0, 0.0..=65535.0;
        /// Whether the server sends data at once, or when the driver asks.
        pub delivery: Delivery = Delivery::Push;
        /// Command for the wheels: CAR has velocity and steering angle, VEL has velocity and yaw rate.
        pub command: DriveCommand = DriveCommand::Car;
        /// Wheelbase that the server's steering angle refers to: angle = atan(wheelbase x curvature) [m].
        // A robot that steers both axles by the same angle turns like a car with half its axle distance.
        pub wheelbase_m: f64 = 0.185, 0.01..=10.0;
        /// Sign of the velocity that is sent.
        pub velocity_sign: f64 = 1.0, Documented { text: SIGN, schema: ONE };
        /// Sign of the steering angle, or of the yaw rate, that is sent; 1 if left is positive.
        pub steering_sign: f64 = 1.0, Documented { text: SIGN, schema: ONE };
        /// Signs of the reported x, y and yaw; 1 if ahead, left and counter-clockwise are positive.
        pub odometry_signs: [f64; 3] = [1.0, 1.0, 1.0], Documented { text: "1 or -1 each", schema: ONE };
        /// Sign of the beam angles; -1 for a scanner that is mounted upside down.
        pub scan_sign: f64 = 1.0, Documented { text: SIGN, schema: ONE };
        /// Duration of a sweep over all beams: 0 in Stage, 0.0667 for a Hokuyo URG-04LX [s].
        pub sweep_s: f64 = 0.0, 0.0..=1.0;
        /// Time stamp of a scan minus the time of its front beam, on the server [s].
        pub stamp_offset_s: f64 = 0.0, -1.0..=1.0;
        /// Smallest time from the stamp of a state of the base to its arrival here [s].
        pub delay_s: f64 = 0.0, 0.0..=0.1;
        /// At the start, the driver tries to connect for this long [s].
        pub connect_timeout_s: f64 = 5.0, 0.1..=8.0;
        /// The connection is renewed when no data have come for this long, and for two scan periods [s].
        pub silence_s: f64 = 1.0, 0.2..=60.0;
    }
}

impl PlayerConfig {
    /// Passes when all settings are allowed.
    ///
    /// # Errors
    /// The first key that is not, with its value and what is allowed.
    pub fn validate(&self) -> Result<(), Invalid> {
        self.require_ranges()?;
        if self.host.trim().is_empty() {
            return Err(Invalid::new("host", "\"\"", "the name or address of a host"));
        }
        ScannerSettings::require_place(&self.urg)?;
        let signs = [("velocity_sign", self.velocity_sign), ("steering_sign", self.steering_sign)];
        let signs = signs.into_iter().chain([("scan_sign", self.scan_sign)]);
        let signs = signs.chain(self.odometry_signs.map(|sign| ("odometry_signs", sign)));
        for (key, sign) in signs {
            if sign.abs() != 1.0 {
                return Err(Invalid::new(key, sign, SIGN));
            }
        }
        Ok(())
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

    /// The base.
    pub fn base(&self) -> DeviceAddress {
        DeviceAddress { interface: interface::POSITION2D, index: self.position2d }
    }

    /// The server as messages name it.
    pub fn server(&self) -> String {
        format!("{}:{}", self.host, self.port)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(text: &str) -> String {
        let config: PlayerConfig = toml::from_str(text).unwrap();
        config.validate().map_err(|invalid| invalid.within("player")).unwrap_err().to_string()
    }

    #[test]
    fn a_value_that_is_not_allowed_is_named_with_its_range() {
        assert_eq!(PlayerConfig::default().validate(), Ok(()));
        assert_eq!(refusal("port = 70000"), "player.port = 70000 is not allowed: 1 to 65535");
        assert_eq!(
            refusal("host = \" \""),
            "player.host = \"\" is not allowed: the name or address of a host"
        );
        assert_eq!(refusal("steering_sign = 0.5"), "player.steering_sign = 0.5 is not allowed: 1 or -1");
        assert_eq!(
            refusal("odometry_signs = [1, nan, 1]"),
            "player.odometry_signs = NaN is not allowed: 1 or -1"
        );
        assert_eq!(refusal("wheelbase_m = 0"), "player.wheelbase_m = 0 is not allowed: 0.01 to 10");
    }
}
