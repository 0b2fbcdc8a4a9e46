//! `scanloop swap`, `set` and `restart`: request the swap of a process, and print the certificate.

mod program;
mod watch;

use clap::Args;
use console::exit::{Exit, Failure};
use console::{answer, note};
use handover::swap::{Certificate, MAX_TOLERANCE, SwapOutcome};
use plan::change;
use plan::goal::is_of_goal;
use runtime::{Domain, OwnTopics, RuntimeError};
use session::control::{Reply, Request, Successor, SwapRequest, ask};
use shared_types::Role;

use crate::print_json;
use crate::successor::{SuccessorArguments, begin};

/// Time between two polls of a swap: a fifth of a scan period.
const SWAP_POLL: std::time::Duration = std::time::Duration::from_millis(20);

/// Arguments of `swap`.
#[derive(Debug, Args)]
pub struct SwapArguments {
    /// The process that takes over.
    #[command(flatten)]
    pub successor: SuccessorArguments,
    /// Swap again each time a file of the command changes: a program, a script, and what a Python script imports from its
    /// folder. Ctrl-C ends the command; the process that drives stays.
    #[arg(long, conflicts_with = "to")]
    pub watch: bool,
    /// When the new process takes over.
    #[command(flatten)]
    pub gate: GateArguments,
}

/// Arguments of `set`.
#[derive(Debug, Args)]
pub struct SetArguments {
    /// Keys of one role with their new values, for example `controller.intervals=7`; `scanloop reference` lists the keys. Or
    /// keys of a goal, `goal.x_m=8`: they swap no process.
    #[arg(value_name = "KEY=VALUE", required = true)]
    pub set: Vec<String>,
    /// When the new process takes over.
    #[command(flatten)]
    pub gate: GateArguments,
}

/// When the new process takes over, and how the result is printed.
#[derive(Debug, Clone, Args)]
pub struct GateArguments {
    /// Number of scans in a row for which the new process must agree with the old one.
    #[arg(long, visible_alias = "gate-scans", value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub shadow_scans: u64,
    /// Number of scans after the handover for which the old process stays ready as standby.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub standby_scans: u64,
    /// Factor on the bounds of agreement, 0 to 1000, for a process that drives differently on purpose. With 1000 only
    /// validity and timing are judged.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub tolerance: f64,
    /// Print the certificate as JSON to standard output.
    #[arg(long)]
    pub json: bool,
}

/// Swaps one process and prints the certificate.
///
/// # Errors
/// An unknown role or implementation, a system that is not running or already swaps a process; exit code 2.
pub(crate) fn swap(system_id: &str, arguments: &SwapArguments) -> anyhow::Result<Exit> {
    // A file that is watched may be written just now.
    if !arguments.watch {
        arguments.successor.require_script()?;
    }
    if arguments.successor.role.parse::<Role>().is_err()
        && is_companion(system_id, &arguments.successor.role)
        && !arguments.successor.command.is_empty()
    {
        let (name, command) = (&arguments.successor.role, arguments.successor.command_from_here());
        return replace(system_id, name, Some(command), arguments.gate.shadow_scans, arguments.gate.json);
    }
    let request = arguments.gate.request(arguments.successor.named()?, Vec::new())?;
    let domain = &supervision::runs::existing(system_id)?;
    if arguments.watch {
        return watch::watch(domain, &request, arguments.gate.json);
    }
    finish(domain, request, arguments.gate.json)
}

/// Changes settings of one role: swaps its process for the same program with other settings.
///
/// # Errors
/// Keys that do not belong to one role, values that are not allowed, and as [`swap`]; exit code 2.
pub(crate) fn set(system_id: &str, arguments: &SetArguments) -> anyhow::Result<Exit> {
    if arguments.set.iter().any(|text| is_of_goal(text)) {
        return set_goal(system_id, arguments);
    }
    let role = change::role_of(&arguments.set)?;
    let successor = Successor { role, implementation: None, command: None, host: None };
    let request = arguments.gate.request(successor, arguments.set.clone())?;
    finish(&supervision::runs::existing(system_id)?, request, arguments.gate.json)
}

/// Changes a goal: controller and referee have it from one scan on, and no process is swapped.
fn set_goal(system_id: &str, arguments: &SetArguments) -> anyhow::Result<Exit> {
    if let Some(other) = arguments.set.iter().find(|text| !is_of_goal(text)) {
        return Err(Failure::bad_input(format!("{other} is no key of a goal: set goals alone")));
    }
    let request = Request::Goal { set: arguments.set.clone() };
    let from_scan = begin(&supervision::runs::existing(system_id)?, &request)?;
    let json = arguments.gate.json;
    print_json(json, &serde_json::json!({ "set": arguments.set, "from_scan": from_scan }))?;
    answer!(json, "{} from scan {from_scan} on", arguments.set.join(", "))?;
    Ok(Exit::Done)
}

/// Requests the swap, waits for its certificate and prints it.
fn finish(domain: &Domain, request: SwapRequest, json: bool) -> anyhow::Result<Exit> {
    let number = begin(domain, &Request::Swap(request))?;
    let Some(certificate) = certificate(domain, number, || false)? else { return Ok(Exit::NotReached) };
    print_json(json, &certificate)?;
    answer!(json, "{certificate}")?;
    if certificate.outcome != SwapOutcome::Swapped && certificate.reason.contains("disagreement") {
        note!(
            "`--tolerance FACTOR` widens the bounds of agreement; with 1000 only validity and timing are checked"
        );
    }
    Ok(exit_of(&certificate))
}

impl GateArguments {
    fn request(&self, successor: Successor, set: Vec<String>) -> anyhow::Result<SwapRequest> {
        let Self { shadow_scans, standby_scans, tolerance, .. } = *self;
        // JSON has no NaN, so the orchestrator can't name it in a message.
        if !(0.0..=MAX_TOLERANCE).contains(&tolerance) {
            return Err(Failure::bad_input(format!(
                "--tolerance {tolerance} is not allowed: 0 to {MAX_TOLERANCE}"
            )));
        }
        Ok(SwapRequest { successor, set, shadow_scans, standby_scans, tolerance })
    }
}

/// Restarts one process; when the old one works, waits until the new one is in charge.
///
/// # Errors
/// An unknown role, a role that is not restarted, or a system that is not running; exit code 2.
pub(crate) fn restart(system_id: &str, role: &str) -> anyhow::Result<Exit> {
    if role.parse::<Role>().is_err() && is_companion(system_id, role) {
        return replace(system_id, role, None, 0, false);
    }
    let role: Role = role.parse().map_err(Failure::bad_input)?;
    let domain = &supervision::runs::existing(system_id)?;
    let number = match ask(domain, &Request::Restart { role })? {
        Reply::Refused(reason) => return Err(Failure::bad_input(reason)),
        Reply::Accepted(number) => number,
        _ => {
            answer!(false, "{role} is being restarted")?;
            return Ok(Exit::Done);
        }
    };
    let Some(certificate) = certificate(domain, number, || false)? else { return Ok(Exit::NotReached) };
    answer!(false, "{}", certificate.of_restart())?;
    Ok(exit_of(&certificate))
}

/// Whether the running system has a companion of that name.
fn is_companion(system_id: &str, name: &str) -> bool {
    let domain = supervision::runs::find(system_id).ok().flatten();
    let own = domain.and_then(|domain| OwnTopics::of(&domain).ok().flatten());
    own.is_some_and(|own| own.index_of(name).is_some())
}

/// Replaces a companion and prints the certificate. The new process takes over as soon as it is connected; where its
/// topics have bounds, after so many scans on which it has agreed with the old one.
fn replace(
    system_id: &str,
    name: &str,
    command: Option<Vec<String>>,
    shadow_scans: u64,
    json: bool,
) -> anyhow::Result<Exit> {
    let domain = &supervision::runs::existing(system_id)?;
    let request = Request::ReplaceCompanion { name: name.to_owned(), command, shadow_scans };
    let number = match ask(domain, &request)? {
        Reply::Refused(reason) => return Err(Failure::bad_input(reason)),
        Reply::Accepted(number) => number,
        _ => {
            answer!(json, "companion {name} is being started")?;
            return Ok(Exit::Done);
        }
    };
    let Some(certificate) = certificate(domain, number, || false)? else { return Ok(Exit::NotReached) };
    print_json(json, &certificate)?;
    answer!(json, "{certificate}")?;
    Ok(exit_of(&certificate))
}

/// Waits for the certificate of a swap; `None` when the system ends first, or `is_over`.
fn certificate(
    domain: &Domain,
    number: u64,
    is_over: impl Fn() -> bool,
) -> anyhow::Result<Option<Certificate>> {
    while !is_over() {
        match ask(domain, &Request::SwapResult { number }) {
            Ok(Reply::Certificate(certificate)) => return Ok(Some(*certificate)),
            Ok(Reply::Refused(reason)) => anyhow::bail!(reason),
            Ok(_) => std::thread::sleep(SWAP_POLL),
            Err(error) if matches!(error.downcast_ref(), Some(RuntimeError::NotRunning(_))) => {
                note!("the system ended before the swap did: {error:#}");
                return Ok(None);
            }
            Err(error) => {
                note!("the swap was accepted, but its result is not known: {error:#}");
                return Ok(None);
            }
        }
    }
    Ok(None)
}

fn exit_of(certificate: &Certificate) -> Exit {
    if certificate.outcome == SwapOutcome::Swapped { Exit::Done } else { Exit::NotReached }
}
