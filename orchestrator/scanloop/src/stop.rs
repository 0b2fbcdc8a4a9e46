//! `scanloop stop`: blocks the wheels within a second, even without the help of the orchestrator.
//!
//! The command finds runs in `/proc`, latches their stop words and waits for the acknowledgement. The rest takes
//! longer: standstill, reports, the end of the processes, the removal of files. A copy of this program does that in a
//! session of its own, so closing the terminal does not interrupt it.

use std::process::{Command, Stdio};

use console::exit::{Exit, Failure};
use console::output::answer;
use runtime::{Domain, Priority, RuntimeError, print};
use rustix::process::{geteuid, setsid};
use supervision::child::this_program;
use supervision::halt::{self, Blocked};
use supervision::lock::SystemLock;
use supervision::runs::LivingRun;

use crate::cli::StopArguments;

/// The command returns at most this long after its start when the wheels are blocked [ns].
const RETURN_NS: u64 = 900_000_000;

/// Stops systems.
///
/// # Errors
/// A system that is not running, naming those that are, and `--uid` without the right to it; exit code 2.
pub(crate) fn stop(system_id: &str, arguments: &StopArguments) -> anyhow::Result<Exit> {
    if let Some(run_id) = &arguments.finish {
        return finish(run_id, arguments.uid);
    }
    let own = geteuid().as_raw();
    let uid = arguments.uid.unwrap_or(own);
    if uid != own && own != 0 {
        return Err(Failure::bad_input(format!(
            "--uid {uid} is not allowed: only root stops the systems of others"
        )));
    }
    let living = LivingRun::all(uid);
    let chosen: Vec<&LivingRun> =
        living.iter().filter(|run| arguments.all || run.system_id == system_id).collect();
    if chosen.is_empty() {
        return nothing(system_id, arguments, &living);
    }
    // All runs are stopped before the first one is waited for.
    chosen.iter().filter_map(|run| run.word.as_ref()).for_each(runtime::StopWord::latch);
    let all_confirmed = chosen.iter().map(|run| stop_one(run)).fold(true, |all, confirmed| all & confirmed);
    Ok(if all_confirmed { Exit::Done } else { Exit::ProcessFailed })
}

/// Stops a run and prints the result; true when its wheels are confirmed to be blocked.
fn stop_one(run: &LivingRun) -> bool {
    let orphaned = run.orchestrator().is_none();
    let Blocked { confirmed, after_ns } = halt::block(run);
    let system_id = &run.system_id;
    let after_ms = after_ns / 1_000_000;
    if !confirmed {
        let what = format!("the block of the wheels is not confirmed after {after_ms} ms");
        let alive = run.alive().join(", ");
        print(Priority::Error, &format!("system `{system_id}`: {what}; alive: {alive}"));
    }
    let is_over = halt::wait_for_end(run, RETURN_NS.saturating_sub(after_ns));
    if is_over {
        halt::finish(run);
    } else if let Err(error) = detach(run) {
        print(Priority::Warning, &format!("system `{system_id}`: nothing ends its processes: {error}"));
    }
    if confirmed {
        let state = if orphaned { ", which had lost its orchestrator," } else { "" };
        let end = if is_over { "and it has ended" } else { "its processes are ending" };
        tell(&format!("system `{system_id}`{state} is stopped: wheels blocked after {after_ms} ms, {end}"));
    }
    confirmed
}

/// Prints the result. What happened does not depend on whether it can be printed.
fn tell(text: &str) {
    if let Err(error) = answer(false, text) {
        print(Priority::Error, &format!("{text} ({error:#})"));
    }
}

/// Starts a copy of this program that ends what is left of a run.
fn detach(run: &LivingRun) -> std::io::Result<()> {
    let mut command = Command::new(this_program());
    command.args(["--system-id", &run.system_id, "stop", "--finish", &run.run_id]);
    command.args(["--uid", &run.uid.to_string()]).current_dir("/");
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.spawn().map(drop)
}

/// The process that [`detach`] starts: ends what is left of a run.
fn finish(run_id: &str, uid: Option<u32>) -> anyhow::Result<Exit> {
    // A session without the terminal, so that closing it does not end this process.
    let _ = setsid();
    let runs = LivingRun::all(uid.unwrap_or_else(|| geteuid().as_raw()));
    let Some(run) = runs.into_iter().find(|run| run.run_id == run_id) else { return Ok(Exit::Done) };
    let left = halt::finish(&run);
    Ok(if left.is_empty() { Exit::Done } else { Exit::ProcessFailed })
}

/// No such system is running: removes the files of a dead one, and names the running ones.
fn nothing(system_id: &str, arguments: &StopArguments, living: &[LivingRun]) -> anyhow::Result<Exit> {
    if arguments.all {
        tell("no system is running");
        return Ok(Exit::Done);
    }
    if arguments.uid.is_none()
        && let Some(domain) = Domain::find(system_id)?
        && let Ok(mut lock) = SystemLock::take(&domain)
    {
        lock.own();
    }
    if living.is_empty() {
        return Err(RuntimeError::NotRunning(system_id.to_owned()).into());
    }
    let ids: Vec<String> = living.iter().map(name).collect();
    Err(Failure::bad_input(format!("system `{system_id}` is not running; running: {}", ids.join(", "))))
}

/// The system of a run, or its own id when it has neither processes nor a directory yet.
fn name(run: &LivingRun) -> String {
    if run.system_id.is_empty() { format!("run {}", run.run_id) } else { format!("`{}`", run.system_id) }
}
