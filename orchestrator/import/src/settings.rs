//! The files that an imported recording begins with, as those of a run: scenario, system, settings of the stages, processes.

use pipeline::first_incarnation;
use plan::{Choice, Plan};
use recording::mcap::Writer;
use runtime::{Identity, LAYOUTS_FILE, settings_file};
use serde::Serialize;
use shared_types::{Layouts, Role};
use supervision::entry::{ProcessEntry, ProcessRow};
use toml::{Table, Value};

use crate::ImportOptions;
use crate::rays::Beams;

/// What runs over imported scans: role and implementation.
const STAGES: [(Role, &str); 2] = [(Role::Estimator, "ekf"), (Role::Obstacles, "ellipses")];
/// What the wheels were told is not known, so the model of the robot says little about its way between two scans; with the noise of
/// a drive of this program, the estimator would take turns for faults of the odometry.
const PROCESS_NOISE: &str = "estimator.process_noise=[0.05, 0.001, 0.001]";
/// Where nothing is known of the surroundings: all bodies are described, and no wall is.
const SCENARIO: &str =
    "name = \"imported\"\n[track]\nx_m = [-1000.0, 1000.0]\ny_m = [-1000.0, 1000.0]\n[goal]\nx_m = 990.0\n";

/// The plan of a drive with these beams; `vehicle` are keys of its robot where the options name no system.
///
/// # Errors
/// Options that are not allowed, and a scanner that can't be described; exit code 2.
pub(crate) fn plan(
    options: &ImportOptions,
    vehicle: &[&str],
    beams: &Beams,
    period_ns: u64,
    sweep_share: f64,
) -> anyhow::Result<Plan> {
    let [min_range_m, range_m] = beams.limits_m;
    let geometry = beams.geometry;
    let of_robot = vehicle.iter().filter(|_| options.system.is_none()).map(|key| (*key).to_owned());
    let mut overrides: Vec<String> = of_robot.collect();
    overrides.extend([
        PROCESS_NOISE.to_owned(),
        format!("rate_hz={:?}", 1e9 / period_ns as f64),
        format!("vehicle.scanner.beams={}", geometry.count),
        format!("vehicle.scanner.first_rad={:?}", geometry.first_rad),
        format!("vehicle.scanner.increment_rad={:?}", geometry.increment_rad),
        format!("vehicle.scanner.min_range_m={min_range_m:?}"),
        format!("vehicle.scanner.range_m={range_m:?}"),
        format!("vehicle.scanner.sweep_share={sweep_share:?}"),
    ]);
    overrides.extend(options.overrides.iter().cloned());
    let choice = Choice { system: options.system.clone(), overrides, ..Choice::default() };
    match &options.scenario {
        Some(name) => Plan::read(Some(name), &choice),
        None => Plan::of(&emulator::Scenario::parse(SCENARIO, "the scenario of an import")?, &choice),
    }
}

/// Attaches the files.
///
/// # Errors
/// Those of `writer`.
pub(crate) fn attach<W: std::io::Write>(
    writer: &mut Writer<W>,
    plan: &Plan,
    source: &str,
) -> anyhow::Result<()> {
    let Plan { scenario, system, .. } = plan;
    let run = system.run_settings(true);
    let tuning = system.tuning().for_scenario(scenario);
    let mut table = Table::new();
    table.insert("out".to_owned(), Value::from(""));
    table.insert("lockstep".to_owned(), Value::from(true));
    table.insert("system".to_owned(), system.to_table().into());
    table.insert("scenario".to_owned(), scenario.to_table().into());
    let mut files = vec![(recording::read::RUN.to_owned(), table.to_string())];
    for role in Role::ALL {
        let settings = plan::settings::of(*role, &run, &system.realtime, scenario, &tuning)?;
        files.push((settings_file(*role), settings.to_string()));
    }
    files.push((LAYOUTS_FILE.to_owned(), Layouts::built_in().to_string()));
    files.push(("processes-1.toml".to_owned(), processes(source)?));
    for (name, text) in files {
        writer.attach(&name, "application/toml", text.as_bytes(), 0)?;
    }
    Ok(())
}

/// The table of processes: the robot is what the drive was imported from.
fn processes(source: &str) -> anyhow::Result<String> {
    #[derive(Serialize)]
    struct Processes {
        process: Vec<ProcessRow>,
    }
    let row = |(role, implementation): (Role, &str)| ProcessRow {
        role,
        // No process of a machine.
        identity: Identity {
            pid: 0,
            start_ticks: 0,
            incarnation: first_incarnation(role),
            run_id: String::new(),
            uid: 0,
            boot_id: String::new(),
            pid_namespace: 0,
        },
        entry: ProcessEntry {
            role: role.name().to_owned(),
            implementation: Some(implementation.to_owned()),
            ..ProcessEntry::default()
        },
    };
    let rows = [(Role::Robot, source)].into_iter().chain(STAGES);
    Ok(vehicle::text_of(&Processes { process: rows.map(row).collect() })?)
}
