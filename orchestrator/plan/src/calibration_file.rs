//! What a calibration file replaces in a system.

use std::path::Path;

use calibration::CalibrationFile;
use console::exit::Failure;
use console::user_file::{self, TEXT_BYTES};
use toml::{Table, Value};
use vehicle::correction::Calibration;

use crate::overrides;
use crate::vehicle_table::usual_calibration;

/// The keys that a calibration file may set.
pub(crate) const KEYS: [&str; 3] =
    ["actuator.calibration", "estimator.odometry_longitudinal", "estimator.odometry_lateral_rate"];

/// Puts what a calibration file has into the settings of the system: `actuator.calibration` and the coefficients of
/// the estimator. Overrides come later and win.
///
/// # Errors
/// A file that is not allowed or empty, with key, value and range; exit code 2.
pub fn apply(path: &Path, system: &mut Table) -> anyhow::Result<()> {
    let name = path.display().to_string();
    let file = read_file(path)?;
    if file == CalibrationFile::default() {
        let parts = "[velocity], [steering] or [drift]";
        return Err(Failure::bad_input(format!("{name}: nothing is calibrated: expected {parts}")));
    }
    if file.velocity.is_some() || file.steering.is_some() {
        // What the file does not have stays as the system says; a system that is not allowed is reported later.
        let own = system.get("actuator").and_then(|actuator| actuator.get("calibration")).cloned();
        let own = own.and_then(|value| value.try_into::<Calibration>().ok());
        let base = own.unwrap_or_else(|| usual_calibration(system));
        let custom = Calibration::Custom(file.correction(&base.correction()));
        overrides::set(system, "actuator.calibration", Value::try_from(custom)?)?;
    }
    if let Some(part) = &file.drift {
        overrides::set(system, "estimator.odometry_longitudinal", Value::Float(part.longitudinal.value))?;
        overrides::set(
            system,
            "estimator.odometry_lateral_rate",
            Value::Float(part.lateral_rate_per_s.value),
        )?;
    }
    Ok(())
}

/// Reads and checks a calibration file.
///
/// # Errors
/// A file that can't be read or is not allowed, with key, value and range; exit code 2.
pub fn read_file(path: &Path) -> anyhow::Result<CalibrationFile> {
    let name = path.display().to_string();
    let text =
        user_file::read(path, TEXT_BYTES).map_err(|error| Failure::bad_input(format!("{name}: {error}")))?;
    CalibrationFile::parse(&text, &name).map_err(Failure::bad_input)
}
