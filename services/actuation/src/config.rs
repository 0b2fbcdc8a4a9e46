//! Settings of the actuator.

use vehicle::correction::Calibration;
use vehicle::{Description, Invalid, settings};

settings! {
    /// Settings of the actuator.
    pub struct ActuatorConfig {
        /// Correction of velocity and steering angle that makes the robot do what is desired.
        pub calibration: Calibration = Calibration::Default;
        /// The robot as this stage knows it; `run` takes it from the table `[vehicle]`.
        pub vehicle: Description = Description::default();
        /// The wheels are blocked when no valid command has come for this many scan periods.
        // One late command is tolerated, a lost one is not.
        pub timeout_periods: f64 = 1.5, 1.0..=10.0;
        /// Largest age of a command since the front beam of its scan, in scan periods. A command younger than 25 ms is
        /// never too old.
        // An answer is due one period after the scan; two periods more cover a swap of the controller.
        pub max_age_periods: f64 = 3.0, 0.1..=100.0;
        /// Valid commands in a row that end a block caused by a timeout.
        // A single command may be the last one of a process that is dying.
        pub recovery: u32 = 2, 1.0..=100.0;
    }
}

impl ActuatorConfig {
    /// Passes when all settings are within their ranges.
    ///
    /// # Errors
    /// [`Invalid`] with the key, the value and the range.
    pub fn validate(&self) -> Result<(), Invalid> {
        self.require_ranges()?;
        self.vehicle.bounds.require_order().map_err(|invalid| invalid.within("vehicle.bounds"))
    }
}

#[cfg(test)]
mod tests {
    use vehicle::Bounds;

    use super::*;

    #[test]
    fn the_default_settings_are_allowed_and_nan_is_not() {
        assert_eq!(ActuatorConfig::default().validate(), Ok(()));
        let config = ActuatorConfig { timeout_periods: f64::NAN, ..ActuatorConfig::default() };
        assert_eq!(config.validate().unwrap_err().key, "timeout_periods");
        let bounds = Bounds { velocity_min_mps: 1.5, ..Bounds::default() };
        let vehicle = Description { bounds, ..Description::default() };
        let config = ActuatorConfig { vehicle, ..ActuatorConfig::default() };
        assert_eq!(
            config.validate().unwrap_err().to_string(),
            "vehicle.bounds.velocity_min_mps = 1.5 is not allowed: 0.02 to 1"
        );
        assert_eq!(
            ActuatorConfig { recovery: 0, ..ActuatorConfig::default() }.validate().unwrap_err().key,
            "recovery"
        );
    }

    #[test]
    fn settings_are_read_from_their_file() {
        let read = |text: &str| toml::from_str::<ActuatorConfig>(text);
        assert_eq!(read(""), Ok(ActuatorConfig::default()));
        let config = read("calibration = \"identity\"\n[vehicle.bounds]\nvelocity_max_mps = 0.5").unwrap();
        assert_eq!(
            (config.calibration, config.vehicle.bounds.velocity_max_mps),
            (Calibration::Identity, 0.5)
        );
        let calibration = Calibration::Custom(Calibration::Default.correction());
        let written = toml::to_string(&ActuatorConfig { calibration, ..ActuatorConfig::default() }).unwrap();
        assert_eq!(read(&written).unwrap().calibration, calibration);
        assert!(read("calibration = \"guess\"").unwrap_err().to_string().contains("identity"));
        assert!(read("timeout = 2").is_err());
    }
}
