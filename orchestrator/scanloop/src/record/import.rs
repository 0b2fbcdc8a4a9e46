//! `scanloop recording import`.

use std::path::PathBuf;

use clap::Args;
use console::answer;
use console::exit::{Exit, Failure};
use import::{ImportOptions, Mounting};

use crate::print_json;

/// Where a scanner may point [rad].
const MAX_YAW_RAD: f64 = 3.15;
/// Factors on the way of wheels.
const FACTORS: std::ops::RangeInclusive<f64> = 0.1..=10.0;

/// Arguments of `recording import`.
#[derive(Debug, Args)]
pub struct ImportArguments {
    /// A bag of ROS 2: its folder, or one file in MCAP; or the log of a rover, with 682 ranges per line.
    file: PathBuf,
    /// The new recording.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Topic with the scans, of type `sensor_msgs/msg/LaserScan`; needed if there are several.
    #[arg(long, value_name = "TOPIC")]
    scan: Option<String>,
    /// Topic with the odometry, of type `nav_msgs/msg/Odometry`; needed if there are several.
    #[arg(long, value_name = "TOPIC")]
    odometry: Option<String>,
    /// System file with the robot as `[vehicle]`; its scanner is described by the scans.
    #[arg(long, value_name = "FILE")]
    system: Option<PathBuf>,
    /// Scenario with the track and the start; without it an area of a kilometre to each side.
    #[arg(long, value_name = "SCENARIO")]
    scenario: Option<String>,
    /// Override a key of the system or the scenario, for example `vehicle.scanner_x_m=0.1`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// Where the scanner's angle zero points, counter-clockwise from straight ahead; 3.1416 for one that looks backwards.
    #[arg(long, value_name = "RAD", default_value_t = 0.0, allow_negative_numbers = true)]
    scan_yaw: f64,
    /// The scanner is mounted upside down.
    #[arg(long)]
    upside_down: bool,
    /// Factors on way and turn of the log of a rover. With these, the scans of the published log match.
    #[arg(long, value_name = "WAY,TURN", value_delimiter = ',', num_args = 1, default_value = "1.9,1.7")]
    wheel_factors: Vec<f64>,
    /// Replace a file of that name.
    #[arg(long)]
    force: bool,
    /// Print what was imported as JSON to standard output.
    #[arg(long)]
    json: bool,
}

/// Imports a drive of another program.
///
/// # Errors
/// Options that are not allowed, a file that can't be read or written; exit code 2.
pub(super) fn import(arguments: &ImportArguments) -> anyhow::Result<Exit> {
    let ImportArguments { file, out, scan_yaw, upside_down, force, json, .. } = arguments;
    if !(-MAX_YAW_RAD..=MAX_YAW_RAD).contains(scan_yaw) {
        let message = format!("--scan-yaw {scan_yaw} is not allowed: -{MAX_YAW_RAD} to {MAX_YAW_RAD}");
        return Err(Failure::bad_input(message));
    }
    let &[way, turn] = &arguments.wheel_factors[..] else {
        return Err(Failure::bad_input("--wheel-factors are two numbers: WAY,TURN"));
    };
    if let Some(factor) = [way, turn].iter().find(|factor| !FACTORS.contains(factor)) {
        let (first, last) = FACTORS.into_inner();
        let message = format!("--wheel-factors {factor} is not allowed: {first} to {last}");
        return Err(Failure::bad_input(message));
    }
    let options = ImportOptions {
        scan: arguments.scan.clone(),
        odometry: arguments.odometry.clone(),
        system: arguments.system.clone(),
        scenario: arguments.scenario.clone(),
        overrides: arguments.overrides.clone(),
        mounting: Mounting { yaw_rad: *scan_yaw, sign: if *upside_down { -1.0 } else { 1.0 } },
        wheel_factors: [way, turn],
        force: *force,
    };
    let imported = import::import(file, out, &options)?;
    if imported.cut_off {
        let text = format!(
            "warning: {}: it was cut off; imported up to its last whole chunk or line",
            file.display()
        );
        runtime::print(runtime::Priority::Warning, &text);
    }
    answer!(*json, "{imported}")?;
    print_json(*json, &imported)?;
    Ok(Exit::Done)
}
