//! Commands to the orchestrator of a running system: `status`, `restart`, `swap`.

use std::fmt::Write as _;

use console::exit::{Exit, Failure};
use console::note;
use console::output::data;
use handover::swap::{Certificate, MOST_TOLERANCE, SwapOutcome};
use runtime::{Domain, RuntimeError};
use session::control::{Reply, Request, Status, SwapRequest, ask};
use session::driverless::{self, DRIVERLESS};
use shared_types::Role;

use crate::cli::SwapArguments;

/// Time between two looks at an exchange: a fifth of a scan period.
const SWAP_LOOK: std::time::Duration = std::time::Duration::from_millis(20);

/// Prints the state of the system.
///
/// # Errors
/// A system that is not running; exit code 2.
pub(crate) fn status(domain: &Domain, json: bool) -> anyhow::Result<Exit> {
    let status = match ask(domain, &Request::Status) {
        Ok(Reply::Status(status)) => *status,
        Ok(_) => anyhow::bail!("the orchestrator did not answer with a status"),
        Err(error) => match driverless::status(domain) {
            Some(status) if is_not_running(&error) => status,
            _ => return Err(error),
        },
    };
    if json {
        data(&serde_json::to_string_pretty(&status)?)?;
    } else {
        note!("{}", table(&status));
        if status.state == DRIVERLESS {
            note!("its orchestrator died: `scanloop adopt` takes it over, `scanloop stop` ends it");
        }
    }
    Ok(Exit::Done)
}

/// Restarts one process; waits until the new one drives when the one before works.
///
/// # Errors
/// An unknown role, a role that is not restarted, or a system that is not running; exit code 2.
pub(crate) fn restart(system_id: &str, role: &str) -> anyhow::Result<Exit> {
    let role: Role = role.parse().map_err(Failure::bad_input)?;
    let domain = &supervision::runs::existing(system_id)?;
    let number = match ask(domain, &Request::Restart { role: role.name().to_owned() })? {
        Reply::Refused(reason) => return Err(Failure::bad_input(reason)),
        Reply::Accepted(number) => number,
        _ => {
            note!("{role} is being restarted");
            return Ok(Exit::Done);
        }
    };
    let Some(certificate) = certificate(domain, number)? else { return Ok(Exit::NotReached) };
    note!("{}", certificate.of_restart());
    Ok(exit_of(&certificate))
}

/// Exchanges one process and prints what became of it.
///
/// # Errors
/// An unknown role or implementation, a system that is not running or already exchanges one; exit code 2.
pub(crate) fn swap(system_id: &str, arguments: &SwapArguments) -> anyhow::Result<Exit> {
    let role: Role = arguments.role.parse().map_err(Failure::bad_input)?;
    let tolerance = arguments.tolerance;
    // JSON has no word for NaN, so the orchestrator could not say what is wrong with it.
    if !(0.0..=MOST_TOLERANCE).contains(&tolerance) {
        return Err(Failure::bad_input(format!(
            "--tolerance {tolerance} is not allowed: 0 to {MOST_TOLERANCE}"
        )));
    }
    let request = SwapRequest {
        role: role.name().to_owned(),
        implementation: arguments.to.clone(),
        command: (!arguments.command.is_empty()).then(|| from_here(&arguments.command)),
        shadow_scans: arguments.shadow_scans,
        standby_scans: arguments.standby_scans,
        tolerance,
    };
    let domain = &supervision::runs::existing(system_id)?;
    let number = match ask(domain, &Request::Swap(request))? {
        Reply::Accepted(number) => number,
        Reply::Refused(reason) => return Err(Failure::bad_input(reason)),
        _ => anyhow::bail!("the orchestrator did not answer the request"),
    };
    let Some(certificate) = certificate(domain, number)? else { return Ok(Exit::NotReached) };
    if arguments.json {
        data(&serde_json::to_string_pretty(&certificate)?)?;
    }
    note!("{certificate}");
    Ok(exit_of(&certificate))
}

/// Waits for the certificate of a swap; none when the system ends before.
fn certificate(domain: &Domain, number: u64) -> anyhow::Result<Option<Certificate>> {
    loop {
        match ask(domain, &Request::SwapResult { number }) {
            Ok(Reply::Certificate(certificate)) => return Ok(Some(*certificate)),
            Ok(Reply::Refused(reason)) => anyhow::bail!(reason),
            Ok(_) => std::thread::sleep(SWAP_LOOK),
            Err(error) => {
                note!("the system ended before the swap did: {error:#}");
                return Ok(None);
            }
        }
    }
}

fn exit_of(certificate: &Certificate) -> Exit {
    if certificate.outcome == SwapOutcome::Swapped { Exit::Done } else { Exit::NotReached }
}

fn is_not_running(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(RuntimeError::NotRunning(_)))
}

/// A command as the orchestrator has to start it, whose working folder is another one.
pub(crate) fn from_here(command: &[String]) -> Vec<String> {
    let mut command = command.to_vec();
    if let Some(program) = command.first_mut()
        && program.contains('/')
        && let Ok(path) = std::path::absolute(&*program)
    {
        *program = path.to_string_lossy().into_owned();
    }
    command
}

fn table(status: &Status) -> String {
    let mut text = format!(
        "system {}: {}, scenario {}, scan {}\n{:<11} {:<16} {:>7}  {:<9} {:>8} {:>8} {:>8} {:>6} {:>9}\n",
        status.system_id,
        status.state,
        status.scenario,
        status.scan,
        "role",
        "implementation",
        "pid",
        "state",
        "restarts",
        "rate/Hz",
        "age/ms",
        "cpu/%",
        "mem/KiB"
    );
    for process in &status.processes {
        let _ = writeln!(
            text,
            "{:<11} {:<16.16} {:>7}  {:<9} {:>8} {:>8.1} {:>8.0} {:>6.1} {:>9}",
            process.role,
            process.implementation,
            process.pid,
            process.state,
            process.restarts,
            process.rate_hz,
            process.last_sample_age_ms,
            process.cpu_percent,
            process.memory_kib
        );
        if !process.obeys_stop && ["robot", "actuator"].contains(&process.role.as_str()) {
            let _ = writeln!(text, "            ! it does not see the stop word: `scanloop stop` ends it");
        }
        for line in &process.last_words {
            let _ = writeln!(text, "            | {line}");
        }
        for row in status.refused.iter().filter(|row| row.writer == process.role) {
            let _ = writeln!(text, "            ! {row}");
        }
    }
    text
}
