//! `scanloop calibrate`: from recorded or driven runs to the calibration file that `run --calibration` uses.
//!
//! The fits are pure functions of the crate `calibration`; this module reads and writes files.

mod arguments;

use std::path::{Path, PathBuf};

use calibration::file::{DriftPart, Origin, SteeringPart, VelocityPart};
use calibration::record::{self, CircleRun, Record, SineRow, StraightRun};
use calibration::{CalibrationFile, Estimate, FitChart, drift, drive, steering, velocity};
use emulator::Scenario;

pub use arguments::{CalibrateArguments, CalibrationKind};

use console::answer;
use console::exit::{Exit, Failure};
use console::new_file::{self, behind_link, require_apart};
use console::out_folder::OutFolder;
use console::user_file;
use plan::Choice;
use plan::{Plan, calibration_file};
use report::picture::panels;
use vehicle::Description;

use crate::print_json;

/// The result of one calibration.
struct Found {
    /// The file with the new part only.
    file: CalibrationFile,
    charts: Vec<FitChart>,
    /// The summary.
    text: String,
    /// The table of driven runs.
    table: Option<String>,
}

/// Calibrates, merges the result into the calibration file, and draws the residuals of the fit.
///
/// # Errors
/// Runs that cannot be read or are refused, with the reason, exit code 2; errors of the file system.
pub(crate) fn calibrate(arguments: &CalibrateArguments) -> anyhow::Result<Exit> {
    let name = arguments.kind.name();
    let [table, picture] = ["csv", "svg"].map(|ending| format!("{name}.{ending}"));
    let names = if arguments.drive { vec![picture.as_str(), table.as_str()] } else { vec![picture.as_str()] };
    let out = OutFolder::claim(&arguments.out, &names, arguments.force)?;
    let into = arguments.into.clone().unwrap_or_else(|| arguments.out.join("calibration.toml"));
    let into = behind_link(&into)?;
    let inputs: Vec<&Path> = arguments.files.iter().map(PathBuf::as_path).collect();
    out.require_apart(&inputs)?;
    require_apart(&into, &inputs)?;
    let found = match arguments.kind {
        CalibrationKind::Velocity => of_velocity(arguments),
        CalibrationKind::Steering => of_steering(arguments),
        CalibrationKind::Drift => of_drift(arguments),
    }?;
    let merged = merge(&into, &found.file)?;

    let tell = |what: &str, path: &Path| answer!(arguments.json, "{what:<15} {}", path.display());
    if let Some(text) = &found.table {
        tell("table", &out.write(&table, text.as_bytes())?)?;
    }
    tell("picture", &out.write(&picture, panels::draw(&found.charts)?.as_bytes())?)?;
    new_file::write(&into, merged.to_toml().as_bytes())?;
    tell("calibration", &into)?;
    answer!(arguments.json, "{}", found.text)?;
    print_json(arguments.json, &found.file)?;
    Ok(Exit::Done)
}

fn of_velocity(arguments: &CalibrateArguments) -> anyhow::Result<Found> {
    let Collected { runs, origin, table, .. } = collect::<StraightRun>(arguments, drive::straight_runs)?;
    let fit = velocity::fit(&runs).map_err(Failure::bad_input)?;
    let text = format!(
        "kv              {}\nruns            {}, times miss {:.3} s\n",
        shown(&fit.factor, 1.0, ""),
        fit.runs,
        fit.residual_s
    );
    let velocity = Some(VelocityPart::of(&fit, origin));
    let file = CalibrationFile { velocity, ..CalibrationFile::default() };
    Ok(Found { file, charts: fit.charts, text, table })
}

fn of_steering(arguments: &CalibrateArguments) -> anyhow::Result<Found> {
    let Collected { runs, vehicle, origin, table } = collect::<CircleRun>(arguments, drive::circle_runs)?;
    let fit = steering::fit(&runs, &vehicle).map_err(Failure::bad_input)?;
    let part = SteeringPart::of(&fit, origin);
    let text = format!(
        "steering map    standard error up to {:.2} mrad, held-out error {:.2} mrad\nplay            {}\nruns            {}, single ones miss {:.2} mrad\n",
        1e3 * part.standard_error_rad,
        1e3 * part.held_out_rad,
        play(part.play_rad),
        part.runs,
        1e3 * part.residual_rad
    );
    let file = CalibrationFile { steering: Some(part), ..CalibrationFile::default() };
    Ok(Found { file, charts: fit.charts, text, table })
}

fn of_drift(arguments: &CalibrateArguments) -> anyhow::Result<Found> {
    let Collected { runs: rows, vehicle, origin, table } = collect::<SineRow>(arguments, drive::sine_runs)?;
    let fit = drift::fit(&rows, &vehicle).map_err(Failure::bad_input)?;
    let text = format!(
        "df              {}\ndds             {}\nplay            {}\nsteering        {}\nruns            {} with {} positions, which miss {:.1} mm\n",
        shown(&fit.longitudinal, 1.0, ""),
        shown(&fit.lateral_rate, 1.0, " 1/s"),
        play(fit.play),
        late(fit.steering_late),
        fit.runs,
        fit.marks,
        1e3 * fit.residual_m
    );
    let drift = Some(DriftPart::of(&fit, origin));
    let file = CalibrationFile { drift, ..CalibrationFile::default() };
    Ok(Found { file, charts: fit.charts, text, table })
}

/// Runs of a vehicle.
struct Collected<R> {
    runs: Vec<R>,
    vehicle: Description,
    origin: Origin,
    /// The table of driven ones.
    table: Option<String>,
}

/// The runs of all files, or driven ones with their table; and their origin.
fn collect<R: Record>(
    arguments: &CalibrateArguments,
    drive: fn(&Scenario, &Description, u64) -> Vec<R>,
) -> anyhow::Result<Collected<R>> {
    let note = arguments.note.clone();
    let (system, overrides) = (arguments.system.clone(), arguments.overrides.clone());
    let choice = Choice { system, overrides, ..Choice::default() };
    let Plan { scenario: robot, system, .. } = Plan::read(arguments.scenario.as_deref(), &choice)?;
    let vehicle = system.vehicle;
    if arguments.drive {
        let runs = drive(&robot, &vehicle, arguments.seed);
        let obtained = format!("driven by the emulated robot of {}, seed {}", robot.name, arguments.seed);
        let table = record::write(&runs);
        return Ok(Collected { runs, vehicle, origin: Origin { obtained, note }, table: Some(table) });
    }
    let mut runs: Vec<R> = Vec::new();
    for path in &arguments.files {
        let name = path.display().to_string();
        let text =
            user_file::read_table(path).map_err(|error| Failure::bad_input(format!("{name}: {error}")))?;
        let mut more = record::read::<R>(&text, &name).map_err(Failure::bad_input)?;
        record::append(&mut runs, &mut more);
    }
    let names: Vec<String> = arguments.files.iter().map(|path| path.display().to_string()).collect();
    let origin = Origin { obtained: format!("recorded in {}", names.join(", ")), note };
    Ok(Collected { runs, vehicle, origin, table: None })
}

/// The existing file with the new parts.
fn merge(path: &Path, new: &CalibrationFile) -> anyhow::Result<CalibrationFile> {
    let old = if path.exists() { calibration_file::read_file(path)? } else { CalibrationFile::default() };
    Ok(CalibrationFile {
        schema: new.schema,
        velocity: new.velocity.clone().or(old.velocity),
        steering: new.steering.clone().or(old.steering),
        drift: new.drift.clone().or(old.drift),
    })
}

fn shown(estimate: &Estimate, scale: f64, unit: &str) -> String {
    let Estimate { value, standard_error, interval_95: [low, high] } = *estimate;
    // Two digits of the standard error, at least three decimals.
    let digits = (2.0 - (scale * standard_error).abs().max(1e-9).log10().ceil()).clamp(3.0, 9.0) as usize;
    let number = |value: f64| format!("{:.digits$}", scale * value);
    let [value, standard_error, low, high] = [value, standard_error, low, high].map(number);
    format!("{value} +- {standard_error}{unit}, 95 %: {low} to {high}")
}

fn play(play: Option<Estimate>) -> String {
    play.map_or("not measured".to_owned(), |play| shown(&play, 1e3, " mrad"))
}

/// How late the steering is, and which keys describe it.
fn late(late: Option<Estimate>) -> String {
    let keys = "vehicle.command_delay_s + vehicle.steering_lag_s";
    late.map_or("not measured".to_owned(), |late| format!("late by {}: {keys}", shown(&late, 1.0, " s")))
}

#[cfg(test)]
mod tests {
    use toml::{Table, Value};
    use vehicle::correction::Calibration;

    use super::*;

    #[test]
    fn estimates_are_shown_with_two_digits_of_their_error() {
        let estimate = Estimate { value: 1.400_34, standard_error: 0.002_11, interval_95: [1.396, 1.404_6] };
        assert_eq!(shown(&estimate, 1.0, ""), "1.4003 +- 0.0021, 95 %: 1.3960 to 1.4046");
    }

    #[test]
    fn a_calibration_replaces_its_part_and_leaves_the_others() {
        let part = |value: f64| {
            Some(VelocityPart {
                origin: Origin::default(),
                runs: 5,
                residual_s: 0.0,
                factor: Estimate::new(value, 0.001, 4),
            })
        };
        let folder = std::env::temp_dir().join(format!("scanloop-calibration-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("calibration.toml");
        let old = CalibrationFile {
            velocity: part(1.3),
            drift: Some(DriftPart {
                origin: Origin::default(),
                runs: 1,
                marks: 11,
                residual_m: 0.004,
                longitudinal: Estimate::new(0.012, 1e-4, 17),
                lateral_rate_per_s: Estimate::new(0.05, 1e-4, 17),
                play_rad: None,
                steering_late_s: None,
            }),
            ..CalibrationFile::default()
        };
        std::fs::write(&path, old.to_toml()).unwrap();
        let new = CalibrationFile { velocity: part(1.5), ..CalibrationFile::default() };
        let merged = merge(&path, &new).unwrap();
        assert_eq!((&merged.velocity, &merged.drift), (&new.velocity, &old.drift));

        let mut system: Table = "[actuator]\ncalibration = \"identity\"".parse().unwrap();
        calibration_file::apply(&path, &mut system).unwrap();
        assert_eq!(system["estimator"]["odometry_longitudinal"], Value::Float(0.012));
        let custom =
            system["actuator"]["calibration"].clone().try_into::<Calibration>().unwrap().correction();
        let sent = custom.correct(
            &vehicle::Bounds::default(),
            vehicle::Control { velocity: 1.0, steering: 0.05 },
            vehicle::correction::Linkage::default(),
        );
        assert_eq!((custom.velocity_factor, sent.velocity, sent.steering), (1.3, 1.3, 0.05));
        std::fs::write(&path, "schema = 1").unwrap();
        assert!(
            calibration_file::apply(&path, &mut system)
                .unwrap_err()
                .to_string()
                .contains("nothing is calibrated")
        );
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
