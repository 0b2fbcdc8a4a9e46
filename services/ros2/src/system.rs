//! The running system, as a program of ours reaches it: by commands of `scanloop`, and by what its directory has.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, ensure};
use driver::ros2::Ros2Config;
use runtime::{
    COMPANION_VARIABLE, Companion, Domain, GoalOrder, RuntimeError, SYSTEM_ID_VARIABLE, settings_file,
};
use shared_types::Role;
use vehicle::Description;

/// The program of the commands.
const PROGRAM: &str = "scanloop";
/// The system of those who name none.
const DEFAULT_ID: &str = "default";

/// A running system.
pub(crate) struct System {
    program: PathBuf,
    domain: Domain,
}

impl System {
    /// The system of that id; without one, that of this companion, or of `SCANLOOP_SYSTEM_ID`.
    ///
    /// # Errors
    /// No such system.
    pub(crate) fn running(id: Option<&str>) -> anyhow::Result<Self> {
        let domain = match id {
            None if is_companion() => Domain::of_this_process()?,
            id => {
                let named = std::env::var(SYSTEM_ID_VARIABLE).ok();
                Domain::existing(id.or(named.as_deref()).unwrap_or(DEFAULT_ID))?
            }
        };
        let beside = std::env::current_exe().ok().map(|path| path.with_file_name(PROGRAM));
        let program = beside.filter(|path| path.is_file()).unwrap_or_else(|| PROGRAM.into());
        Ok(Self { program, domain })
    }

    /// A command, to be started.
    pub(crate) fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(&self.program);
        command.args(["--system-id", self.domain.system_id()]).args(arguments);
        command
    }

    /// Sets the goal of the drive.
    ///
    /// # Errors
    /// A program that can't be started.
    pub(crate) fn set_goal(&self, place: [f64; 2], yaw_rad: f64) -> Result<GoalOrder, RuntimeError> {
        GoalOrder::give_by(&self.program, Some(self.domain.system_id()), place, Some(yaw_rad))
    }

    /// What is said when a command can't be started.
    pub(crate) fn not_started(&self, error: &std::io::Error) -> anyhow::Error {
        anyhow::anyhow!("{}, beside this program or in PATH: {error}", self.program.display())
    }

    /// The robot as the controller knows it.
    ///
    /// # Errors
    /// Settings that can't be read.
    pub(crate) fn vehicle(&self) -> anyhow::Result<Description> {
        let table = self.settings(Role::Controller)?;
        let vehicle = table.get(Role::Controller.name()).and_then(|controller| controller.get("vehicle"));
        vehicle.cloned().context("the controller has no table vehicle")?.try_into().context("[vehicle]")
    }

    /// Where its robot is, when that one speaks ROS 2.
    ///
    /// # Errors
    /// Settings that can't be read.
    pub(crate) fn robot(&self) -> anyhow::Result<Option<Ros2Config>> {
        let table = self.settings(Role::Robot)?.remove("ros2");
        table.map(|table| table.try_into().context("[ros2]")).transpose()
    }

    fn settings(&self, role: Role) -> anyhow::Result<toml::Table> {
        let file = settings_file(role);
        self.domain.folder().read_text(&file)?.parse().context(file)
    }
}

/// Whether this process was started as a companion.
pub(crate) fn is_companion() -> bool {
    std::env::var_os(COMPANION_VARIABLE).is_some()
}

/// The only topic that a companion writes.
///
/// # Errors
/// None, or several.
pub(crate) fn only_output(companion: &Companion) -> anyhow::Result<String> {
    let writes = &companion.uses().writes;
    ensure!(writes.len() == 1, "writes = {writes:?} is not allowed: the name of one topic");
    Ok(writes[0].clone())
}
