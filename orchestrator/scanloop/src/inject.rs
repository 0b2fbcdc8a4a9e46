//! `scanloop inject`: causes a fault in a running system with the emulated robot.
//!
//! Faults of samples and of the robot are carried out by the process whose samples change. Faults of processes act from
//! outside, so this command carries them out; the orchestrator has allowed and noted them before.

pub mod act;

use std::time::Duration;

use clap::Args;
use console::exit::{Exit, Failure};
use console::{answer, output::data};
use faults::{Injection, ProcessFault, ProcessName};
use runtime::{Domain, Shutdown, wait_for};
use rustix::process::Pid;
use session::control::{Reply, Request, SystemStatus, ask};

use crate::shadow::duration_within;
use act::act;

/// Shortest and longest time of a fault.
const RANGE: [Duration; 2] = [Duration::from_millis(1), Duration::from_secs(600)];

/// Arguments of `inject`.
#[derive(Debug, Args)]
pub struct InjectArguments {
    /// Name of the fault: the first part of a name of `scanloop faults --list`.
    #[arg(value_name = "FAULT", required_unless_present = "list")]
    pub fault: Option<String>,
    /// Duration, 1ms to 10m, for example 2s or 500ms; a number without unit is in seconds. Default: as long as the fault
    /// itself says, else 2s. A process that is killed stays dead until it is restarted.
    #[arg(long = "for", value_name = "TIME", value_parser = time_of_a_fault)]
    pub duration: Option<Duration>,
    /// Print the names of the faults that can be injected to standard output.
    #[arg(long, conflicts_with = "fault")]
    pub list: bool,
}

fn time_of_a_fault(text: &str) -> Result<Duration, String> {
    duration_within(text, RANGE, "1ms to 10m")
}

/// Injects a fault now. A fault that suspends or floods ends with this command.
///
/// # Errors
/// A run that allows no faults, a fault that is unknown or can't be injected while the robot drives; exit code 2.
pub(crate) fn inject(system_id: &str, arguments: &InjectArguments) -> anyhow::Result<Exit> {
    let Some(name) = arguments.fault.as_deref() else {
        data(&(faults::live_names()?.join("\n") + "\n"))?;
        return Ok(Exit::Done);
    };
    let shutdown = Shutdown::on_signals()?;
    let domain = supervision::runs::existing(system_id)?;
    let Reply::Status(status) = ask(&domain, &Request::Status)? else {
        anyhow::bail!("the orchestrator did not answer with a status");
    };
    let for_s = arguments.duration.map(|duration| duration.as_secs_f64());
    let (for_s, orchestrator) = match ask(&domain, &Request::Inject { fault: name.to_owned(), for_s })? {
        Reply::Injected { for_s, orchestrator } => (for_s, orchestrator),
        Reply::Refused(reason) => return Err(Failure::bad_input(reason)),
        _ => anyhow::bail!("the orchestrator did not answer the request"),
    };
    match faults::find(name)?.map(|fault| fault.inject) {
        Some(Injection::Process(fault)) => {
            disturb(&fault, targets(&fault, &status, orchestrator), &domain, for_s, &shutdown)?;
            answer!(false, "{name}: done")?;
        }
        _ => _ = answer!(false, "{name}: for {for_s} s")?,
    }
    Ok(Exit::Done)
}

/// Process ids that a fault acts on.
fn targets(fault: &ProcessFault, status: &SystemStatus, orchestrator: u32) -> Vec<Pid> {
    let own = || Pid::from_raw(orchestrator.cast_signed());
    let running = status.processes.iter().filter(|row| match fault.process {
        ProcessName::Role(role) => row.role == role,
        ProcessName::Orchestrator => false,
        ProcessName::All => true,
    });
    let mut targets: Vec<Pid> = running.filter_map(|row| Pid::from_raw(row.pid)).collect();
    if !matches!(fault.process, ProcessName::Role(_)) {
        targets.extend(own());
    }
    targets
}

/// Kills at once; suspends or floods for a time, or until this command is ended.
fn disturb(
    fault: &ProcessFault,
    targets: Vec<Pid>,
    domain: &Domain,
    for_s: f64,
    shutdown: &Shutdown,
) -> anyhow::Result<()> {
    let mut acting = act(fault, targets, domain)?;
    if fault.action != faults::ProcessAction::Kill {
        wait_for(&[shutdown.descriptor()], (for_s * 1e9) as u64);
    }
    acting.release();
    Ok(())
}
