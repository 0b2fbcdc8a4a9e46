//! The calibration file: results, their errors, and the origin of the runs.
//!
//! A TOML file of up to three parts, one per kind of runs; a new calibration replaces its part and leaves the others.
//! It contains no date, because the same runs must give the same file: place and time belong in the note.

use serde::{Deserialize, Serialize};
use vehicle::bounds::STEERING_MAX_RAD;
use vehicle::correction::{CommandCorrection, SteeringCorrection};
use vehicle::network::SteeringNetwork;
use vehicle::{Invalid, require, toml_fault};

use crate::drift::DriftFit;
use crate::steering::SteeringFit;
use crate::velocity::VelocityFit;
use crate::{Estimate, RunRefusal};

/// The version of the file that is written and read.
pub const SCHEMA: u32 = 1;

/// Results of calibrations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationFile {
    /// Version of the file, [`SCHEMA`].
    pub schema: u32,
    /// From straight runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub velocity: Option<VelocityPart>,
    /// From circle runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steering: Option<SteeringPart>,
    /// From sine runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drift: Option<DriftPart>,
}

/// Where the runs of a part come from.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// How the runs were obtained: files, or an emulated robot with its seed.
    pub obtained: String,
    /// Date, place, floor: free text of the user.
    #[serde(default)]
    pub note: String,
}

/// The velocity factor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VelocityPart {
    /// Where the runs come from.
    pub origin: Origin,
    /// How many runs.
    pub runs: usize,
    /// Root mean square of the residuals of the times [s].
    pub residual_s: f64,
    /// Velocity sent per velocity desired, kv.
    pub factor: Estimate,
}

/// The steering map and its inverse.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SteeringPart {
    /// Where the runs come from.
    pub origin: Origin,
    /// How many runs.
    pub runs: usize,
    /// Root mean square of the residuals of single runs [rad].
    pub residual_rad: f64,
    /// Largest error over the third of the runs that the map was not fitted to [rad].
    pub held_out_rad: f64,
    /// Largest standard error of the realised angle over the desired range [rad].
    pub standard_error_rad: f64,
    /// Sent angles that were driven [rad].
    pub sent_range_rad: [f64; 2],
    /// Half the play between shaft and wheels [rad]; absent where it was not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub play_rad: Option<Estimate>,
    /// Realised angle for the angle sent.
    pub map: SteeringNetwork,
    /// Angle to send for the angle desired.
    pub inverse: SteeringNetwork,
    /// The map over the desired range.
    pub points: Vec<PointPart>,
}

/// One angle of the steering map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointPart {
    /// Desired angle [rad].
    pub desired_rad: f64,
    /// Angle to send for it [rad].
    pub sent_rad: f64,
    /// Standard error of the angle that is realised then [rad].
    pub standard_error_rad: f64,
}

/// The coefficients of the odometry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriftPart {
    /// Where the runs come from.
    pub origin: Origin,
    /// How many runs.
    pub runs: usize,
    /// How many measured positions.
    pub marks: usize,
    /// Root mean square of the residuals of corrected positions, per axis [m].
    pub residual_m: f64,
    /// Share of the distance that odometry does not report, df.
    pub longitudinal: Estimate,
    /// Growth of the lateral drift, dds [1/s].
    pub lateral_rate_per_s: Estimate,
    /// Half the play between shaft and wheels [rad]; absent where sent angles were not recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub play_rad: Option<Estimate>,
    /// How late the steering follows, `vehicle.command_delay_s` and `vehicle.steering_lag_s` together [s].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steering_late_s: Option<Estimate>,
}

impl Default for CalibrationFile {
    fn default() -> Self {
        Self { schema: SCHEMA, velocity: None, steering: None, drift: None }
    }
}

impl CalibrationFile {
    /// The file in `text`, checked; `file` stands in messages only.
    ///
    /// # Errors
    /// [`RunRefusal::Unreadable`] with file, key, value and allowed range.
    pub fn parse(text: &str, file: &str) -> Result<Self, RunRefusal> {
        let read: Self =
            toml::from_str(text).map_err(|error| RunRefusal::unreadable(file, toml_fault(text, &error)))?;
        read.validate().map_err(|invalid| RunRefusal::unreadable(file, invalid.to_string()))?;
        Ok(read)
    }

    /// The text that reads back as this file.
    pub fn to_toml(&self) -> String {
        // Numbers, texts and tables with text keys can always be written.
        toml::to_string(self).unwrap_or_default()
    }

    /// Passes when every number is within its range and the correction rises over all desired angles.
    ///
    /// # Errors
    /// [`Invalid`] with the key, the value and what is allowed.
    pub fn validate(&self) -> Result<(), Invalid> {
        require("schema", f64::from(self.schema), 1.0..=f64::from(SCHEMA))?;
        if let Some(part) = &self.velocity {
            part.factor.validate(0.2..=5.0).map_err(|error| error.within("velocity.factor"))?;
        }
        if let Some(part) = &self.steering {
            part.validate().map_err(|error| error.within("steering"))?;
        }
        if let Some(part) = &self.drift {
            part.longitudinal.validate(-0.5..=0.5).map_err(|error| error.within("drift.longitudinal"))?;
            part.lateral_rate_per_s
                .validate(-1.0..=1.0)
                .map_err(|error| error.within("drift.lateral_rate_per_s"))?;
            validate_play(part.play_rad).map_err(|error| error.within("drift.play_rad"))?;
            if let Some(late) = part.steering_late_s {
                late.validate(-0.01..=1.0).map_err(|error| error.within("drift.steering_late_s"))?;
            }
        }
        Ok(())
    }

    /// The correction of commands: `base` with the parts that the file has.
    pub fn correction(&self, base: &CommandCorrection) -> CommandCorrection {
        CommandCorrection {
            velocity_factor: self.velocity.as_ref().map_or(base.velocity_factor, |part| part.factor.value),
            steering: self
                .steering
                .as_ref()
                .map_or(base.steering, |part| SteeringCorrection::Network(part.inverse)),
            play_rad: self.play().map_or(base.play_rad, |play| play.value.max(0.0)),
        }
    }

    /// Half the play between shaft and wheels: of circles and sines the one with the smaller standard error.
    fn play(&self) -> Option<Estimate> {
        let circles = self.steering.as_ref().and_then(|part| part.play_rad);
        let sines = self.drift.as_ref().and_then(|part| part.play_rad);
        circles
            .into_iter()
            .chain(sines)
            .min_by(|one, other| one.standard_error.total_cmp(&other.standard_error))
    }
}

impl SteeringPart {
    fn validate(&self) -> Result<(), Invalid> {
        for (key, network) in [("map", &self.map), ("inverse", &self.inverse)] {
            if !network.is_usable() {
                return Err(Invalid::new(key, "a network", "weights within 1e6, scales from 1e-6 to 10 rad"));
            }
        }
        // Where a correction falls, more desired angle would give less.
        let desired_max_rad =
            self.points.iter().map(|point| point.desired_rad).fold(STEERING_MAX_RAD, f64::max);
        for step in -60..=60 {
            let desired = desired_max_rad * f64::from(step) / 60.0;
            let slope = self.inverse.derivative(desired);
            if !(slope > 0.0 && slope < 20.0) {
                let value = format!("slope {slope:.3} at {desired:.4} rad");
                return Err(Invalid::new("inverse", value, "0 to 20 at every desired angle"));
            }
        }
        validate_play(self.play_rad).map_err(|error| error.within("play_rad"))
    }
}

fn validate_play(play: Option<Estimate>) -> Result<(), Invalid> {
    play.map_or(Ok(()), |play| play.validate(-0.01..=0.1))
}

impl VelocityPart {
    /// The part of a fit to straight runs.
    pub fn of(fit: &VelocityFit, origin: Origin) -> Self {
        Self { origin, runs: fit.runs, residual_s: fit.residual_s, factor: fit.factor }
    }
}

impl SteeringPart {
    /// The part of a fit to circle runs.
    pub fn of(fit: &SteeringFit, origin: Origin) -> Self {
        let points: Vec<PointPart> = fit
            .points
            .iter()
            .map(|point| PointPart {
                desired_rad: point.desired_rad,
                sent_rad: point.sent_rad,
                standard_error_rad: point.realised_rad.standard_error,
            })
            .collect();
        Self {
            origin,
            runs: fit.runs,
            residual_rad: fit.residual_rad,
            held_out_rad: fit.held_out_rad,
            standard_error_rad: points.iter().map(|point| point.standard_error_rad).fold(0.0, f64::max),
            sent_range_rad: fit.sent_range_rad,
            play_rad: fit.play,
            map: fit.map,
            inverse: fit.inverse,
            points,
        }
    }
}

impl DriftPart {
    /// The part of a fit to sine runs.
    pub fn of(fit: &DriftFit, origin: Origin) -> Self {
        Self {
            origin,
            runs: fit.runs,
            marks: fit.marks,
            residual_m: fit.residual_m,
            longitudinal: fit.longitudinal,
            lateral_rate_per_s: fit.lateral_rate,
            play_rad: fit.play,
            steering_late_s: fit.steering_late,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle::correction::{Calibration, SHIPPED_NETWORK};

    fn file() -> CalibrationFile {
        let estimate = Estimate::new(0.01, 1e-4, 40);
        let origin = Origin { obtained: "runs.csv".to_owned(), note: "dry floor".to_owned() };
        CalibrationFile {
            velocity: Some(VelocityPart {
                origin: origin.clone(),
                runs: 12,
                residual_s: 0.05,
                factor: Estimate::new(1.37, 0.002, 11),
            }),
            steering: Some(SteeringPart {
                origin: origin.clone(),
                runs: 82,
                residual_rad: 4e-4,
                held_out_rad: 1e-3,
                standard_error_rad: 2e-4,
                sent_range_rad: [-0.085, 0.085],
                play_rad: None,
                map: SHIPPED_NETWORK,
                inverse: SHIPPED_NETWORK,
                points: Vec::new(),
            }),
            drift: Some(DriftPart {
                origin,
                runs: 4,
                marks: 84,
                residual_m: 0.006,
                longitudinal: estimate,
                lateral_rate_per_s: estimate,
                play_rad: Some(estimate),
                steering_late_s: Some(estimate),
            }),
            ..CalibrationFile::default()
        }
    }

    #[test]
    fn a_file_reads_back_as_it_was_written() {
        assert_eq!(CalibrationFile::parse(&file().to_toml(), "a.toml"), Ok(file()));
        assert_eq!(CalibrationFile::parse("schema = 1", "a.toml"), Ok(CalibrationFile::default()));
    }

    #[test]
    fn messages_name_file_key_value_and_range() {
        let message = |text: &str| CalibrationFile::parse(text, "a.toml").unwrap_err().to_string();
        let wrong = file().to_toml().replacen("value = 1.37", "value = 7.0", 1);
        assert_eq!(message(&wrong), "a.toml: velocity.factor.value = 7 is not allowed: 0.2 to 5");
        assert!(message("schema = 1\n[speed]\nx = 1").starts_with("a.toml: line 2: unknown field `speed`"));
        assert!(message("schema = 2").contains("schema = 2 is not allowed: 1 to 1"));
        assert!(message("schema = ").starts_with("a.toml: line 1"));
    }

    #[test]
    fn a_correction_that_is_not_rising_is_refused() {
        let mut file = file();
        if let Some(part) = &mut file.steering {
            part.inverse.output_weights[1] = -9.0;
        }
        assert_eq!(file.validate().unwrap_err().key, "steering.inverse");
    }

    #[test]
    fn parts_that_are_missing_leave_the_correction_as_it_was() {
        let base = Calibration::Identity.correction();
        let mut file = file();
        file.steering = None;
        let correction = file.correction(&base);
        assert_eq!((correction.velocity_factor, correction.steering), (1.37, SteeringCorrection::Identity));
    }
}
