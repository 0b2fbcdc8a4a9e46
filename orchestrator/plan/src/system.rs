//! The system file: which process fills which role, at which rate, with which settings.

use std::path::Path;

use console::exit::Failure;
use console::user_file::{self, TEXT_BYTES};
use pipeline::{Tuning, profile};
use runtime::{ClockKind, RunSettings};
use shared_types::Role;
use supervision::entry::ProcessEntry;
use supervision::realtime;
use toml::{Table, Value};
use vehicle::{Description, Documented, Invalid, did_you_mean, read, require, settings};

use crate::hosts::{self, HostEntry};
use crate::possible;
use crate::rate::{require_few_on_the_way, require_rate};
use crate::settings::{DRIVERS, DriverTable};
use crate::source::SourceFile;
use crate::topics::{self, TopicEntry};

/// The program of the implementation `ros2`, which is built apart.
pub const ROS2: &str = "scanloop-ros2";

/// The built-in process table.
pub const BUILT_IN: &str = include_str!("../../systems/default.toml");

/// Name and text of the other system files that come with the program.
const SHIPPED: [(&str, &str); 1] = [("thesis", include_str!("../../systems/thesis.toml"))];

/// What the key `orphan_stop_s` may be.
const ORPHAN_STOP: Documented =
    Documented { text: "0.5 to `orphan_timeout_s`", schema: "minimum = 0.5\nmaximum = 3600" };

settings! {
    /// A checked system file.
    pub struct System {
        /// Scans per second [Hz].
        pub rate_hz: f64 = 10.0, (0.5..=1000.0, "at least `controller.intervals` / `controller.horizon_s`");
        /// All processes end when no directive of an orchestrator has come for this long [s].
        pub orphan_timeout_s: f64 = 30.0, 1.0..=3600.0;
        /// The wheels are blocked when no directive has come for this long, until one comes; without the key 5.0, or
        /// `orphan_timeout_s` if that is less, and 0.5 with the actuator on another host [s].
        pub orphan_stop_s: Option<f64> = None, ORPHAN_STOP;
        /// The robot as all stages know it. An explicit `robot.KEY` of the scenario also holds here, unless the key is set.
        pub vehicle: Description = Description::default();
        /// Driver of a robot behind a Player server, for the implementation `player` of role `robot`.
        pub player: player::PlayerConfig = player::PlayerConfig::default();
        /// Driver of a ROS 2 robot, for the implementation `ros2` of role `robot`.
        pub ros2: driver::ros2::Ros2Config = driver::ros2::Ros2Config::default();
        /// Processors, scheduling, idle states and memory; the defaults need no privilege.
        pub realtime: runtime::Realtime = runtime::Realtime::default();
        /// What is kept of a drive in real time without `--record`.
        pub recording: RecordingSettings = RecordingSettings::default();
        /// Other machines of the system; a process runs on one with the key `host`.
        #[serde(rename = "host")]
        pub hosts: Vec<HostEntry> = Vec::new();
        /// Folder with the certificates of this host, for transport `quic`; `scanloop agent pair` makes it.
        pub credentials: Option<String> = None, "a folder";
        /// One table for each role.
        #[serde(rename = "process")]
        pub processes: Vec<ProcessEntry> = Vec::new();
        /// Topics in addition to those of the loop.
        #[serde(rename = "topic")]
        pub topics: Vec<TopicEntry> = Vec::new();
        /// Settings of the estimator: measured states, noise, odometry correction and prediction.
        pub estimator: estimator::EstimatorConfig = estimator::EstimatorConfig::default();
        /// Settings of the obstacle detector: walls, ellipses, noise and memory.
        pub obstacles: obstacles::ObstaclesConfig = obstacles::ObstaclesConfig::default();
        /// Settings of the controller: body, horizon, velocities and time limits.
        pub controller: nmpc::ControllerConfig = nmpc::ControllerConfig::default();
        /// Settings of the actuator: calibration, limits and timeouts.
        pub actuator: actuation::ActuatorConfig = actuation::ActuatorConfig::default();
    }
}

settings! {
    /// What is kept of a drive in real time without `--record`.
    #[derive(Copy)]
    pub struct RecordingSettings {
        /// At a death, a rollback, a collision or a stop other than landing, so many seconds before it are written to
        /// `incident-SCAN.mcap` in the folder of the results; 0 for none [s].
        pub ring_s: f64 = 60.0, 0.0..=3600.0;
    }
}

impl System {
    /// The system in a table that was read before, possibly with overrides in it; `file` stands in messages only.
    ///
    /// # Errors
    /// One message with file, key, value and allowed range; exit code 2.
    pub fn from_table(table: Table, file: &str) -> anyhow::Result<Self> {
        let refuse = |invalid: Invalid| Failure::bad_input(format!("{file}: {invalid}"));
        let system = Self::checked(table).map_err(refuse)?;
        topics::read(&system, file)?;
        Ok(system)
    }

    /// The system in a table, without the files of its topics.
    ///
    /// # Errors
    /// The first key that is not allowed.
    pub(crate) fn checked(mut table: Table) -> Result<Self, Invalid> {
        profile::add(&mut table);
        let system: Self = read(table)?;
        system.validate()?;
        Ok(system)
    }

    /// The table that reads back as this system.
    pub fn to_table(&self) -> Table {
        // Numbers, texts and tables with text keys can always be written.
        Table::try_from(self).unwrap_or_default()
    }

    /// Whether the built-in emulator is the robot, so that the scenario describes it.
    pub fn emulates_robot(&self) -> bool {
        let mut robots = self.roles().filter(|entry| entry.role() == Role::Robot);
        robots.any(|entry| entry.implementation.as_deref() == Some("emulator"))
    }

    /// What all processes need to know.
    pub fn run_settings(&self, lockstep: bool) -> RunSettings {
        RunSettings {
            period_ns: self.period_ns(),
            clock: if lockstep { ClockKind::Simulated } else { ClockKind::Monotonic },
            orphan_stop_ns: (self.orphan_stop_s() * 1e9) as u64,
            orphan_timeout_ns: (self.orphan_timeout_s * 1e9) as u64,
        }
    }

    /// The table of a file or of a shipped system, or the built-in one. Processes that it does not have are the built-in ones.
    ///
    /// # Errors
    /// A message with the file, and the line where the text is no TOML; exit code 2.
    pub fn read_table(file: Option<&Path>) -> anyhow::Result<SourceFile> {
        let Some(path) = file else {
            return SourceFile::shipped(BUILT_IN, "built-in system".to_owned());
        };
        let name = path.display().to_string();
        let shipped = SHIPPED.iter().find(|(shipped, _)| *shipped == name && !path.is_file());
        let mut source = if let Some((_, text)) = shipped {
            SourceFile::shipped(text, format!("shipped system {name}"))?
        } else {
            let text = user_file::read(path, TEXT_BYTES).map_err(|error| {
                let meant = did_you_mean(&name, SHIPPED.iter().map(|(shipped, _)| *shipped));
                Failure::bad_input(format!("{name}: {error}.{meant}"))
            })?;
            SourceFile::parse(text, name)?
        };
        add_built_in(&mut source.table);
        Ok(source)
    }

    /// Whether a system file of this name comes with the program.
    pub(crate) fn is_shipped(name: &str) -> bool {
        SHIPPED.iter().any(|(shipped, _)| *shipped == name)
    }

    /// How long the wheels may turn without a directive [s].
    pub fn orphan_stop_s(&self) -> f64 {
        let is_elsewhere = self.entry(Role::Actuator).is_some_and(|entry| entry.host.is_some());
        let default_s = if is_elsewhere { MIN_ORPHAN_STOP_S } else { ORPHAN_STOP_S };
        self.orphan_stop_s.unwrap_or_else(|| self.orphan_timeout_s.min(default_s))
    }

    /// The scan period [ns].
    pub fn period_ns(&self) -> u64 {
        (1e9 / self.rate_hz).round() as u64
    }

    /// The settings of the stages.
    pub fn tuning(&self) -> Tuning {
        Tuning {
            vehicle: self.vehicle,
            estimator: self.estimator.clone(),
            obstacles: self.obstacles.clone(),
            // The true period, so that no key can contradict the rate.
            controller: nmpc::ControllerConfig { period_s: 1.0 / self.rate_hz, ..self.controller.clone() },
            actuator: self.actuator.clone(),
        }
    }

    /// The settings of the driver, when the robot has one.
    ///
    /// # Errors
    /// None, as far as settings can be written.
    pub fn driver(&self) -> anyhow::Result<Option<DriverTable>> {
        let implementation = self.entry(Role::Robot).and_then(|entry| entry.implementation.as_deref());
        implementation.map_or(Ok(None), |name| self.driver_of(name))
    }

    /// The settings of a driver by the name of its implementation; `None` for another implementation.
    ///
    /// # Errors
    /// As [`Self::driver`].
    pub fn driver_of(&self, implementation: &str) -> anyhow::Result<Option<DriverTable>> {
        let Some(name) = DRIVERS.into_iter().find(|name| *name == implementation) else { return Ok(None) };
        let table =
            if name == "ros2" { Value::try_from(&self.ros2)? } else { Value::try_from(&self.player)? };
        Ok(Some(DriverTable { name, table }))
    }

    /// The entry of a role; a checked system has one for each.
    pub fn entry(&self, role: Role) -> Option<&ProcessEntry> {
        self.roles().find(|entry| entry.role() == role)
    }

    /// The processes of the loop.
    pub fn roles(&self) -> impl Iterator<Item = &ProcessEntry> {
        self.processes.iter().filter(|entry| !entry.is_companion())
    }

    /// The processes beside the loop.
    pub fn companions(&self) -> impl Iterator<Item = &ProcessEntry> {
        self.processes.iter().filter(|entry| entry.is_companion())
    }

    fn validate(&self) -> Result<(), Invalid> {
        self.require_ranges()?;
        // First: everything else asks for the roles.
        self.require_each_role_once()?;
        for (index, entry) in self.processes.iter().enumerate() {
            entry.validate().map_err(|error| error.within(&format!("process[{index}]")))?;
            if !entry.is_companion()
                && let Err(unknown) = entry.role.parse::<Role>()
            {
                let value = if entry.role.is_empty() { "(missing)" } else { &entry.role };
                return Err(Invalid::new(&format!("process[{index}].role"), value, unknown.to_string()));
            }
        }
        self.recording.require_ranges().map_err(|invalid| invalid.within("recording"))?;
        require("orphan_stop_s", self.orphan_stop_s(), MIN_ORPHAN_STOP_S..=self.orphan_timeout_s)?;
        self.player.validate().map_err(|invalid| invalid.within("player"))?;
        self.ros2.validate().map_err(|invalid| invalid.within("ros2"))?;
        realtime::validate(&self.realtime).map_err(|invalid| invalid.within("realtime"))?;
        if let Some(role) = Role::ALL.iter().find(|role| self.entry(**role).is_none()) {
            let missing = format!("no process of role {role}");
            return Err(Invalid::new("process", missing, "one process per role"));
        }
        hosts::validate(self)?;
        topics::validate(self)?;
        require_rate(&self.controller, self.rate_hz)?;
        for (table, delay_s) in [
            ("vehicle", self.vehicle.command_delay_s),
            ("estimator.vehicle", self.estimator.vehicle.command_delay_s),
        ] {
            require_few_on_the_way(table, delay_s, 0.0, self.rate_hz)?;
        }
        possible::require_velocity(self)?;
        self.tuning().validate()
    }

    /// Passes when no role stands twice. That comes before the checks of an entry: the second one of a role has none of the
    /// values that the built-in system gives the first one.
    fn require_each_role_once(&self) -> Result<(), Invalid> {
        for role in Role::ALL {
            let is_of_role = |entry: &ProcessEntry| !entry.is_companion() && entry.role == role.name();
            let of_role = self.processes.iter().enumerate().filter(|(_, entry)| is_of_role(entry));
            let indices: Vec<usize> = of_role.map(|(index, _)| index).collect();
            if let [_, second, ..] = indices.as_slice() {
                let topics: Vec<&str> = role.writes().iter().map(|topic| topic.name()).collect();
                let allowed = format!(
                    "one process per role; {} processes would write topic {}",
                    indices.len(),
                    topics.join(", ")
                );
                return Err(Invalid::new(&format!("process[{second}].role"), role, allowed));
            }
        }
        Ok(())
    }
}

/// Adds the built-in process of each role that no process of the file has, behind those of the file. A process that names
/// its role alone is the built-in one with the other keys of the file.
pub(crate) fn add_built_in(table: &mut Table) {
    let built_in: Table = BUILT_IN.parse().unwrap_or_default();
    let processes = table.entry("process".to_owned()).or_insert_with(|| Value::Array(Vec::new()));
    // The reader of the whole file refuses what is no list.
    let (Value::Array(own), Some(Value::Array(all))) = (processes, built_in.get("process")) else { return };
    for process in all.iter().filter_map(Value::as_table) {
        let is_of_role = |own: &&mut Table| own.get("role") == process.get("role");
        match own.iter_mut().filter_map(Value::as_table_mut).find(is_of_role) {
            None => own.push(Value::Table(process.clone())),
            Some(own) if own.contains_key("implementation") || own.contains_key("command") => {}
            Some(own) => process.iter().for_each(|(key, value)| {
                own.entry(key.clone()).or_insert_with(|| value.clone());
            }),
        }
    }
}

/// Directives come ten times a second, and a busy machine may hold them up.
const MIN_ORPHAN_STOP_S: f64 = 0.5;
/// A robot without supervision drives on for this time at most [s].
const ORPHAN_STOP_S: f64 = 5.0;

#[cfg(test)]
mod tests {
    use super::*;

    fn error_of(text: &str) -> String {
        let mut table: Table = BUILT_IN.parse().unwrap();
        for (key, value) in text.parse::<Table>().unwrap() {
            match (table.get_mut(&key), value) {
                (Some(Value::Array(items)), Value::Array(more)) => items.extend(more),
                (_, value) => drop(table.insert(key, value)),
            }
        }
        System::from_table(table, "lab.toml").unwrap_err().to_string()
    }

    #[test]
    fn the_built_in_system_is_valid_and_fills_every_role() {
        let system = System::from_table(BUILT_IN.parse().unwrap(), "built-in").unwrap();
        assert_eq!(system.processes.len(), 5);
        assert_eq!(system.period_ns(), 100_000_000);
    }

    #[test]
    fn the_controller_gets_the_true_period_at_every_rate() {
        for (rate, period_s) in [(2.5, 0.4), (4.0, 0.25), (1000.0, 0.001)] {
            let mut table: Table = BUILT_IN.parse().unwrap();
            table.insert("rate_hz".to_owned(), Value::Float(rate));
            let system = System::from_table(table, "lab.toml").unwrap();
            assert_eq!(system.tuning().controller.period_s, period_s);
        }
    }

    #[test]
    fn a_rate_without_a_safe_speed_is_refused_with_the_keys_that_decide_it() {
        let message = error_of("rate_hz = 0.5\n[controller.vehicle]\nsudden_m = 0.2");
        assert!(message.starts_with("lab.toml: rate_hz = 0.5 is not allowed: at least "), "{message}");
    }

    #[test]
    fn messages_name_file_key_value_and_what_is_allowed() {
        assert_eq!(error_of("rate_hz = nan"), "lab.toml: rate_hz = NaN is not allowed: 0.5 to 1000");
        assert!(error_of("rate = 10.0").starts_with(
            "lab.toml: rate = 10.0 is not allowed: the key is unknown. Did you mean `rate_hz`? Expected one of `rate_hz`"
        ));
        let typed = error_of("rate_hz = \"fast\"");
        assert_eq!(typed, "lab.toml: rate_hz = \"fast\" is not allowed: a number");
    }

    #[test]
    fn two_processes_of_one_role_are_refused() {
        let twice = error_of("[[process]]\nrole = \"controller\"\nimplementation = \"nmpc\"");
        assert_eq!(
            twice,
            "lab.toml: process[5].role = controller is not allowed: one process per role; 2 processes would write topic command"
        );
        let unknown = error_of("[[process]]\nrole = \"pilot\"\nimplementation = \"nmpc\"");
        assert!(unknown.contains("process[5].role = pilot is not allowed: one of robot"), "{unknown}");
        let foreign = BUILT_IN.replace("\"nmpc\"", "\"ekf\"").parse().unwrap();
        let foreign = System::from_table(foreign, "lab.toml").unwrap_err().to_string();
        assert!(foreign.contains("process[3].implementation = ekf is not allowed: one of nmpc"), "{foreign}");
    }
}
