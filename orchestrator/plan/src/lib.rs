//! What is to be driven: scenario and system, read, overridden and checked before anything is started.

pub mod calibration_file;
pub mod change;
pub mod difference;
mod driven_robot;
pub mod goal;
pub mod hosts;
pub mod map_file;
pub mod migrate;
pub mod overrides;
mod path_file;
mod possible;
mod rate;
pub mod reference;
pub mod settings;
mod source;
pub mod system;
pub mod topics;
mod vehicle_table;
mod written;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::Args;
use console::exit::Failure;
use console::user_file::{self, TEXT_BYTES};
use emulator::Scenario;
use nmpc::speed_limit;
use pipeline::PipelineSettings;
use runtime::{Domain, OwnTopics};
use supervision::child::other_program;
use toml::{Table, Value};
use vehicle::{Description, Invalid, Setting, Surroundings, did_you_mean};

pub use difference::PropertyDifference;
pub use source::SourceFile;
pub use system::System;
use written::Written;

/// Arguments that choose and change a scenario and a system.
#[derive(Debug, Args, Clone, Default)]
pub struct Choice {
    /// System file, or the name of a shipped one; without it the one that the scenario names, or the built-in one.
    #[arg(long, value_name = "FILE")]
    pub system: Option<PathBuf>,
    /// Calibration file from `scanloop calibrate`; its values replace the calibration of the system.
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// Add the real-time profile to the system: one processor, SCHED_FIFO, no idle states, locked memory (docs/tuning.md).
    #[arg(long)]
    pub realtime: bool,
    /// Seed of all random numbers of the scenario.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Override a key of the scenario or the system, for example `robot.velocity_factor=1.3`; may be repeated.
    ///
    /// `scanloop reference` lists the keys. Elements of a list are named by index or role: `obstacle.0.x_m=6`,
    /// `process.controller.grace_ms=500`.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
}

impl Choice {
    /// The files that are read, which no output may replace.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        [&self.system, &self.calibration].into_iter().flatten().map(PathBuf::as_path)
    }
}

/// Key of a scenario that names its system file.
const SYSTEM: &str = "system";
/// Scenario of a run without one.
const DEFAULT_SCENARIO: &str = "corridor";

/// What is to be driven, checked.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The scenario.
    pub scenario: Scenario,
    /// The system.
    pub system: System,
    /// Topics and companions of the system.
    pub own_topics: OwnTopics,
    /// Keys of the files that a user should replace.
    pub warnings: Vec<String>,
    /// Properties of robot and description that a file or an option gives.
    pub given: BTreeSet<String>,
}

impl Plan {
    /// Scenario, settings of the stages, and scan period, for a drive in simulated time.
    pub fn simulated(self) -> PipelineSettings {
        let (tuning, period_ns) = (self.system.tuning(), self.system.period_ns());
        PipelineSettings { scenario: self.scenario, tuning, period_ns }
    }

    /// Reads and checks scenario and system, with overrides.
    ///
    /// # Errors
    /// One message with file, key, value and allowed range; exit code 2.
    pub fn read(scenario: Option<&str>, choice: &Choice) -> anyhow::Result<Self> {
        Self::of_source(read_scenario(scenario.unwrap_or(DEFAULT_SCENARIO))?, choice)
    }

    /// The same for a scenario that is not read from a file.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn of(scenario: &Scenario, choice: &Choice) -> anyhow::Result<Self> {
        Self::of_source(SourceFile::parse(scenario.to_toml(), scenario.name.clone())?, choice)
    }

    fn of_source(scenario: SourceFile, choice: &Choice) -> anyhow::Result<Self> {
        let named = named_system(&scenario)?;
        let system = System::read_table(choice.system.as_deref().or(named.as_deref()))?;
        let written = Written::new(scenario, system, choice)?;
        let check = |tables: [Table; 2]| Self::checked(tables).err();
        let mut plan = Self::checked(written.tables()?)
            .map_err(|invalid| Failure::bad_input(written.refusal(&invalid, check)))?;
        plan.own_topics = topics::read(&plan.system, written.system_file())?;
        Ok(plan)
    }

    /// What scenario and system say, without the topics of the system.
    fn checked([scenario, mut system]: [Table; 2]) -> Result<Self, Invalid> {
        let keys = |table: &Table, name: &str| match table.get(name) {
            Some(Value::Table(inner)) => inner.keys().cloned().collect(),
            _ => BTreeSet::new(),
        };
        let given = &keys(&scenario, "robot") | &keys(&system, "vehicle");
        driven_robot::add_defaults(&mut system);
        vehicle_table::adopt_scenario(&scenario, &mut system);
        vehicle_table::fit_stages(&mut system);
        // The file that it names was read: from here on the system is what counts.
        let mut scenario = Scenario { system: None, ..Scenario::checked(scenario)? };
        require_name_of_folder(&scenario.name)?;
        let mut warnings = vehicle_table::distribute(&mut system)?;
        if system.get("controller").is_some_and(|table| table.get("period_s").is_some()) {
            let (stage, key, why) = migrate::WITHOUT_EFFECT;
            warnings.push(format!("{stage}.{key} {why}"));
        }
        let system = System::checked(system)?;
        // From here on every reader of the scenario finds the values that the preset gives.
        scenario.robot = scenario.robot.resolved(&system.vehicle, scenario.seed);
        let view = scenario.true_scanner().require_view(scenario.robot_values().scanner_yaw_rad);
        view.map_err(|invalid| invalid.within("robot.scanner"))?;
        // What the stages take from the scenario may be allowed there and too much for them.
        let tuning = system.tuning().for_scenario(&scenario);
        tuning.validate()?;
        scenario.scanner.validate_mean(system.period_ns())?;
        possible::require_goals(&scenario, &tuning.controller)?;
        warnings.extend(possible::warnings(&scenario, &tuning.controller));
        warnings.extend(possible::unmapped(&tuning.actuator));
        warnings.extend(possible::blind(&scenario, &tuning.obstacles));
        if system.emulates_robot() {
            rate::require_few_on_robots_way(&scenario, system.rate_hz)?;
            warnings.extend(possible::drift(&scenario, &tuning.estimator));
            warnings.extend(possible::irregular(&scenario, system.rate_hz));
        }
        warnings.extend(hosts::warnings(&system));
        let own_topics = topics::table(&system, Vec::new());
        Ok(Self { scenario, system, own_topics, warnings, given })
    }

    /// Where the scenario differs from the description that the stages read; the largest share first.
    pub fn differences(&self) -> Vec<PropertyDifference> {
        let Self { scenario, system, .. } = self;
        let surroundings = [scenario.surroundings(), system.vehicle.surroundings];
        let mut found = difference::sorted(scenario.robot.differences(&system.vehicle), surroundings);
        for difference in &mut found {
            let is_of_preset = difference.key != "surroundings"
                && !self.given.contains(difference.key.split('.').next().unwrap_or_default());
            if difference.table == "track" && scenario.course.is_some() {
                difference.table = "course";
            }
            difference.preset = is_of_preset.then(|| scenario.robot.preset.name());
        }
        found
    }

    /// [`Self::differences`] of a robot that publishes its truth. The scenario tells nothing about any other one, as far as
    /// that is known before it runs.
    pub fn differences_of_truth(&self) -> Vec<PropertyDifference> {
        let has_truth = self.system.emulates_robot() && self.scenario.robot.publish_truth;
        if has_truth { self.differences() } else { Vec::new() }
    }

    /// What `run` and `check` print of a speed that the surroundings or the way to stop limit.
    pub fn careful(&self) -> Option<String> {
        let Description { surroundings, careful_mps, sudden_m, .. } = self.system.controller.vehicle;
        if surroundings == Surroundings::Open {
            let why = "nothing around shows that the scanner sees";
            return Some(format!("speed limited to {careful_mps} m/s: {why}"));
        }
        let controller = self.system.tuning().controller;
        let (limit_mps, cruise_mps) = (speed_limit(&controller), controller.cruise_mps);
        (limit_mps < cruise_mps).then(|| {
            format!(
                "speed limited to {limit_mps:.3} m/s instead of controller.cruise_mps = {cruise_mps}: the robot stops \
                 within vehicle.sudden_m = {sudden_m} at rate_hz = {}",
                self.system.rate_hz
            )
        })
    }

    /// Writes the settings file of each process of a system.
    ///
    /// # Errors
    /// Settings that are not allowed, and errors of the file system.
    pub fn write_settings(&self, domain: &Domain, lockstep: bool) -> anyhow::Result<()> {
        let Self { scenario, system, .. } = self;
        let driver = system.driver()?;
        if let (Some(driver), true) = (&driver, lockstep) {
            let message = format!("--lockstep: the robot `{}` drives in real time only", driver.name);
            return Err(Failure::bad_input(message));
        }
        if driver.as_ref().is_some_and(|driver| driver.name == "ros2") {
            other_program(system::ROS2, "services/ros2")?;
        }
        let run = system.run_settings(lockstep);
        OwnTopics { run: run.clone(), ..self.own_topics.clone() }.write(domain)?;
        let tuning = system.tuning().for_scenario(scenario);
        settings::write(domain, &run, &system.realtime, scenario, &tuning, driver.as_ref())
    }
}

/// A scenario file, or a shipped scenario by its name, without any system.
///
/// # Errors
/// One message with file, key, value and allowed range; exit code 2.
pub fn scenario(name: &str) -> anyhow::Result<Scenario> {
    let SourceFile { table, name, .. } = read_scenario(name)?;
    Scenario::from_table(table, &name).map_err(|error| Failure::bad_input(error.to_string()))
}

/// Whether a key or table belongs to the scenario; all others belong to the system.
fn is_of_scenario(name: &str) -> bool {
    Scenario::keys().iter().any(|key| key.name == name)
}

/// A scenario file, or a shipped scenario.
fn read_scenario(name: &str) -> anyhow::Result<SourceFile> {
    let path = Path::new(name);
    if let Some(text) = Scenario::shipped(name).filter(|_| !path.is_file()) {
        return SourceFile::shipped(text, format!("shipped scenario {name}"));
    }
    let text = user_file::read(path, TEXT_BYTES).map_err(|error| {
        let shipped: Vec<&str> = Scenario::names().collect();
        let meant = did_you_mean(name, Scenario::names());
        Failure::bad_input(format!("{name}: {error}.{meant} Shipped scenarios are {}", shipped.join(", ")))
    })?;
    SourceFile::parse(text, name.to_owned())
}

/// Passes when the results of a run can be in a folder of this name: `..` is another one.
fn require_name_of_folder(name: &str) -> Result<(), Invalid> {
    match name.bytes().all(|letter| b" .".contains(&letter)) {
        true => Err(Invalid::new("name", name, "a name with more than dots and blanks")),
        false => Ok(()),
    }
}

/// The system file that a scenario names: beside its own file, or a shipped one.
fn named_system(scenario: &SourceFile) -> anyhow::Result<Option<PathBuf>> {
    let Some(value) = scenario.table.get(SYSTEM) else { return Ok(None) };
    let Some(name) = value.as_str() else {
        let invalid = Invalid::new(SYSTEM, value, "the name of a shipped system file, or a file");
        return Err(Failure::bad_input(format!("{}: {invalid}", scenario.name)));
    };
    let beside = Path::new(&scenario.name).with_file_name(name);
    let is_shipped = System::is_shipped(name) && (scenario.is_shipped || !beside.is_file());
    Ok(Some(if is_shipped { PathBuf::from(name) } else { beside }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(overrides: &[&str]) -> Plan {
        let overrides = overrides.iter().map(ToString::to_string).collect();
        Plan::read(Some("free"), &Choice { overrides, ..Choice::default() }).unwrap()
    }

    fn keys(plan: &Plan) -> Vec<&'static str> {
        plan.differences().iter().map(|difference| difference.key).collect()
    }

    #[test]
    fn the_preset_is_resolved_once_and_differences_are_those_to_the_description() {
        let ideal = plan(&[]);
        assert_eq!(ideal.scenario.robot.velocity_lag_s, Some(0.0));
        assert!(keys(&ideal).contains(&"velocity_lag_s"), "{:?}", ideal.differences());
        let summit = plan(&["robot.preset=summit"]);
        assert_eq!(summit.scenario.robot.velocity_lag_s, Some(0.15));
        assert_eq!(summit.differences(), []);
        assert_eq!(ideal.differences_of_truth(), ideal.differences());
        assert_eq!(plan(&["robot.publish_truth=false"]).differences_of_truth(), []);
        let worn = plan(&["robot.preset=worn"]);
        assert!(keys(&worn).len() > 10);
        assert_ne!(worn.scenario.robot, plan(&["robot.preset=worn", "seed=2"]).scenario.robot);
    }

    #[test]
    fn a_name_of_dots_only_is_refused_because_it_is_another_folder() {
        let read = |name: &str| {
            let overrides = vec![format!("name={name}")];
            Plan::read(Some("free"), &Choice { overrides, ..Choice::default() })
        };
        for name in [".", "..", "...", ". ."] {
            let message = read(name).unwrap_err().to_string();
            let expected = format!("name = {name} is not allowed: a name with more than dots and blanks");
            assert!(message.ends_with(&expected), "{message}");
        }
        assert_eq!(read("..a").unwrap().scenario.name, "..a");
    }

    #[test]
    fn a_scenario_that_is_no_file_is_planned_like_one_that_is() {
        let overrides = vec!["robot.preset=summit".to_owned(), "controller.intervals=7".to_owned()];
        let choice = Choice { overrides, ..Choice::default() };
        let slalom = Scenario::parse(Scenario::shipped("slalom").unwrap(), "slalom").unwrap();
        let (of, read) = (Plan::of(&slalom, &choice).unwrap(), Plan::read(Some("slalom"), &choice).unwrap());
        assert_eq!((&of.scenario, of.system.tuning()), (&read.scenario, read.system.tuning()));
        assert_eq!(of.system.controller.intervals, 7);
    }

    #[test]
    fn an_explicit_key_of_the_robot_is_no_difference_unless_the_description_says_otherwise() {
        let adopted = plan(&["robot.preset=summit", "robot.width_m=0.5"]);
        assert_eq!((adopted.system.vehicle.width_m, adopted.differences()), (0.5, Vec::new()));
        let wrong = plan(&["robot.preset=summit", "robot.width_m=0.5", "vehicle.width_m=0.4"]);
        assert_eq!(keys(&wrong), ["width_m"]);
        assert_eq!(wrong.differences()[0].to_string(), "robot.width_m = 0.5, vehicle.width_m = 0.4 (+25 %)");
    }

    #[test]
    fn surroundings_of_the_scenario_reach_the_stages_unless_the_description_has_its_own() {
        let summit = |more: &[&str]| plan(&[&["robot.preset=summit"], more].concat());
        let hall = summit(&[]);
        assert_eq!((hall.system.controller.vehicle.surroundings, hall.careful()), (Surroundings::Hall, None));
        let open = summit(&["track.surroundings=open", "vehicle.careful_mps=0.4"]);
        for vehicle in [&open.system.vehicle, &open.system.controller.vehicle, &open.system.obstacles.vehicle]
        {
            assert_eq!(vehicle.surroundings, Surroundings::Open);
        }
        assert!(open.careful().is_some_and(|line| line.starts_with("speed limited to 0.4 m/s: ")));
        assert_eq!(open.differences(), []);
        let wrong = summit(&["track.surroundings=open", "vehicle.surroundings=hall"]);
        assert_eq!((keys(&wrong), wrong.careful()), (vec!["surroundings"], None));
    }
}
