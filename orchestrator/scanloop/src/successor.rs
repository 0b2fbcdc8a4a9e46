//! The common part of `swap` and `shadow`: a second process for a role.

use std::path::Path;

use clap::{ArgGroup, Args};
use console::exit::Failure;
use runtime::Domain;
use session::control::{Reply, Request, Successor, ask};
use supervision::child::require_script;
use supervision::replaceable;

/// The role, and the process for it.
#[derive(Debug, Clone, Args)]
#[command(group = ArgGroup::new("successor").required(true))]
pub struct SuccessorArguments {
    /// Role of the process: robot, estimator, obstacles, controller or actuator. `swap` also takes the name of a companion.
    pub role: String,
    /// Built-in implementation: emulator, player, ros2, ekf, ellipses, nmpc or actuation. With `@HOST` it runs on that `[[host]]`
    /// of the system file, or on the host of `run` for `@orchestrator`; without, on the host where the role is.
    #[arg(long, value_name = "IMPLEMENTATION[@HOST]", group = "successor")]
    pub to: Option<String>,
    /// Program of your own that fills the role, with its arguments.
    #[arg(last = true, value_name = "COMMAND", group = "successor")]
    pub command: Vec<String>,
}

impl SuccessorArguments {
    /// The process in the form that the orchestrator needs; its working folder is another one.
    ///
    /// # Errors
    /// An unknown role; exit code 2.
    pub(crate) fn named(&self) -> anyhow::Result<Successor> {
        let role = self.role.parse().map_err(Failure::bad_input)?;
        let command = (!self.command.is_empty()).then(|| self.command_from_here());
        let (implementation, host) = match self.to.as_deref().map(|to| to.split_once('@').ok_or(to)) {
            Some(Ok((name, host))) => (Some(name.to_owned()), Some(host.to_owned())),
            Some(Err(name)) => (Some(name.to_owned()), None),
            None => (None, None),
        };
        Ok(Successor { role, implementation, command, host })
    }

    /// Passes when the program of the command is not a script that can't be executed.
    ///
    /// # Errors
    /// The program and the line; exit code 2.
    pub(crate) fn require_script(&self) -> anyhow::Result<()> {
        let program = self.command.first().map_or(Ok(()), |program| require_script(Path::new(program)));
        program.map_err(Failure::bad_input)
    }

    /// The command as the orchestrator finds it.
    pub(crate) fn command_from_here(&self) -> Vec<String> {
        let command = from_here(&self.command);
        if let Some(reason) = replaceable::command(&command) {
            runtime::print(runtime::Priority::Warning, &format!("warning: {reason}"));
        }
        command
    }
}

/// Requests a swap or a shadow; returns its number.
///
/// # Errors
/// A refused request, exit code 2, one that could not be carried out, exit code 4, and a system that is not running.
pub(crate) fn begin(domain: &Domain, request: &Request) -> anyhow::Result<u64> {
    match ask(domain, request)? {
        Reply::Accepted(number) => Ok(number),
        Reply::Refused(reason) => Err(Failure::bad_input(reason)),
        Reply::Failed(reason) => Err(Failure::process(reason)),
        _ => anyhow::bail!("the orchestrator did not answer the request"),
    }
}

/// The command with absolute paths of its program and of a script in it, because the working folder of the
/// orchestrator is another one.
fn from_here(command: &[String]) -> Vec<String> {
    let absolute = |(index, part): (usize, &String)| {
        let is_script = || part.ends_with(".py") && Path::new(part).is_file();
        let is_path = if index == 0 { part.contains('/') } else { is_script() };
        let path = is_path.then(|| std::path::absolute(part).ok()).flatten();
        path.map_or_else(|| part.clone(), |path| path.to_string_lossy().into_owned())
    };
    command.iter().enumerate().map(absolute).collect()
}
