//! `scanloop stop`: blocks the wheels within a second, even without the help of the orchestrator.
//!
//! The command finds runs in `/proc`, latches their stop words and waits for the acknowledgement. The rest takes
//! longer: standstill, reports, the end of the processes, the removal of files. A copy of this program does that in a
//! session of its own, so closing the terminal does not interrupt it. What processes of a run have started in groups of
//! their own is named and ended as well; the command returns when it has ended, or says that it lives.
//!
//! A run in another pid or user namespace is stopped over its control socket. Without an orchestrator there it can't be.

use std::process::{Command, Stdio};
use std::time::Duration;

use console::exit::{Exit, Failure};
use console::limits;
use console::note;
use console::output::answer;
use runtime::{Domain, INCARNATION_VARIABLE, Priority, RUN_ID_VARIABLE, RuntimeError, monotonic_ns, print};
use rustix::process::{geteuid, setsid};
use session::control::{Reply, Request, ask};
use supervision::child::this_program;
use supervision::halt::{self, Blocked};
use supervision::lock::{SystemLock, hidden, is_hidden};
use supervision::runs::{LivingRun, RunProcess, absent};

use crate::cli::StopArguments;

/// Time between two requests to an orchestrator in another namespace.
const POLL: Duration = Duration::from_millis(10);
/// The command returns at most this long after its start when the wheels are blocked and there are no strays [ns].
const RETURN_NS: u64 = 900_000_000;

/// Stops systems.
///
/// # Errors
/// A system that is not running, naming those that are, and `--uid` without the right to it; exit code 2.
pub(crate) fn stop(system_id: &str, arguments: &StopArguments) -> anyhow::Result<Exit> {
    if let Some(run_id) = &arguments.finish {
        return finish(run_id, arguments.uid);
    }
    limits::require_proc()?;
    let own = geteuid().as_raw();
    let uid = arguments.uid.unwrap_or(own);
    if uid != own && own != 0 {
        return Err(Failure::bad_input(format!(
            "--uid {uid} is not allowed: only root stops the systems of others"
        )));
    }
    let (over, living): (Vec<_>, Vec<_>) =
        LivingRun::with_strays(uid).into_iter().partition(LivingRun::is_over);
    let chosen: Vec<&LivingRun> =
        living.iter().filter(|run| arguments.all || run.system_id == system_id).collect();
    // All runs are stopped before the first one is waited for.
    chosen.iter().filter_map(|run| run.word.as_ref()).for_each(runtime::StopWord::latch);
    let strays: Vec<Vec<Named>> = chosen.iter().map(|run| run.strays().map(Named::of).collect()).collect();
    let seen = chosen.iter().map(|run| stop_one(run)).fold(true, |all, confirmed| all & confirmed);
    let (hidden, refused) = match arguments.uid {
        None if arguments.all || chosen.is_empty() => hidden_systems(system_id, arguments.all, &living),
        _ => (Vec::new(), None),
    };
    let over: Vec<&LivingRun> =
        over.iter().filter(|run| arguments.all || run.system_id == system_id).collect();
    if chosen.is_empty() && hidden.is_empty() && over.is_empty() {
        refused.map_or(Ok(()), Err)?;
        return nothing(system_id, arguments, &living);
    }
    let unseen = hidden.iter().map(stop_unseen).fold(true, |all, confirmed| all & confirmed);
    let have_ended = chosen
        .iter()
        .zip(&strays)
        .map(|(run, strays)| follow_strays(run, strays))
        .fold(true, |all, end| all & end);
    if let Some(error) = &refused {
        let text = format!("warning: systems of another namespace may be left: {error}");
        print(Priority::Warning, &text);
    }
    let all_confirmed = seen & unseen & have_ended & end_strays(&over) & refused.is_none();
    Ok(if all_confirmed { Exit::Done } else { Exit::ProcessFailed })
}

/// The systems of that id, or all, whose processes live but can't be seen here; and why some may be missing.
fn hidden_systems(system_id: &str, all: bool, living: &[LivingRun]) -> (Vec<Domain>, Option<RuntimeError>) {
    let is_seen = |domain: &Domain| living.iter().any(|run| run.run_id == domain.run_id());
    let one = || match Domain::find(system_id) {
        Ok(found) => (found.into_iter().collect(), None),
        Err(error) => (Vec::new(), Some(error)),
    };
    let (mut domains, refused) = if all { Domain::all_found() } else { one() };
    domains.retain(|domain| !is_seen(domain) && is_hidden(domain));
    (domains, refused)
}

/// Stops a run whose processes can't be seen here by its orchestrator; true when its wheels are confirmed to be blocked.
fn stop_unseen(domain: &Domain) -> bool {
    let began_ns = monotonic_ns();
    if !matches!(ask(domain, &Request::Stop), Ok(Reply::Done)) {
        print(Priority::Error, &format!("error: {:#}", hidden(domain)));
        return false;
    }
    let (system_id, how) = (domain.system_id(), "over its control socket, as it runs in another namespace");
    loop {
        let after_ms = (monotonic_ns() - began_ns) / 1_000_000;
        let blocked = match ask(domain, &Request::Status) {
            Ok(Reply::Status(status)) => status.wheels.is_some_and(|wheels| wheels.are_blocked()),
            // It ends when the robot rests.
            _ => !is_hidden(domain),
        };
        if blocked {
            note!(
                "system `{system_id}` is stopped {how}: wheels blocked after {after_ms} ms, its processes are ending"
            );
            return true;
        }
        if after_ms > RETURN_NS / 1_000_000 {
            let what = format!("the block of the wheels is not confirmed after {after_ms} ms");
            print(Priority::Error, &format!("system `{system_id}` was asked to stop {how}: {what}"));
            return false;
        }
        std::thread::sleep(POLL);
    }
}

/// A stray with its description from the time when it lived.
struct Named {
    process: RunProcess,
    description: String,
}

impl Named {
    fn of(process: &RunProcess) -> Self {
        Self { process: process.clone(), description: process.description() }
    }
}

/// Ends what runs that are over have left; false when some of it does not end.
fn end_strays(over: &[&LivingRun]) -> bool {
    let strays: Vec<Named> = over.iter().flat_map(|run| run.strays()).map(Named::of).collect();
    let left = halt::end_strays(over);
    tell_ends(&strays, &left, |stray, has_ended| {
        let end = if has_ended { "it is ended" } else { "it does not end, and lives" };
        format!("no system lives by it, but a run that is over had left {stray}: {end}")
    })
}

/// Waits until the strays of a run that was stopped are ended; false when some of them do not end.
fn follow_strays(run: &LivingRun, strays: &[Named]) -> bool {
    if strays.is_empty() {
        return true;
    }
    let left = halt::wait_for_strays(run);
    tell_ends(strays, &left, |stray, has_ended| {
        let end = if has_ended { "is ended too" } else { "does not end, and lives" };
        format!("{stray}, {end}")
    })
}

/// Prints what became of strays, also of those that have been started meanwhile; true when all have ended.
fn tell_ends(strays: &[Named], left: &[RunProcess], text: impl Fn(&str, bool) -> String) -> bool {
    let lives = |process: &RunProcess| left.iter().any(|other| other.identity == process.identity);
    for stray in strays.iter().filter(|stray| !lives(&stray.process)) {
        tell(&text(&stray.description, true));
    }
    for stray in left {
        print(Priority::Error, &text(&stray.description(), false));
    }
    left.is_empty()
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
    let is_all = is_over && run.strays().next().is_none();
    let detached = if is_all { Ok(()) } else { detach(run) };
    if confirmed {
        let state = if orphaned { ", which had lost its orchestrator," } else { "" };
        let end = if is_over { "and it has ended" } else { "its processes are ending" };
        tell(&format!("system `{system_id}`{state} is stopped: wheels blocked after {after_ms} ms, {end}"));
    }
    if let Err(error) = &detached {
        let what = "this command ends its processes itself, which takes longer";
        print(Priority::Warning, &format!("system `{system_id}`: {what}: {error}"));
    }
    if is_all || detached.is_err() {
        halt::finish(run);
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
    // A process of the run may have started this command; the copy is none, or it would end itself.
    command.env_remove(RUN_ID_VARIABLE).env_remove(INCARNATION_VARIABLE);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.spawn().map(drop)
}

/// The process that [`detach`] starts: ends what is left of a run.
fn finish(run_id: &str, uid: Option<u32>) -> anyhow::Result<Exit> {
    // A session without the terminal, so that closing it does not end this process.
    let _ = setsid();
    let runs = LivingRun::with_strays(uid.unwrap_or_else(|| geteuid().as_raw()));
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
    let absent = absent(system_id);
    if living.is_empty() || matches!(absent, RuntimeError::OfAnother { .. }) {
        return Err(absent.into());
    }
    let ids: Vec<String> = living.iter().map(name).collect();
    Err(Failure::bad_input(format!("system `{system_id}` is not running; running: {}", ids.join(", "))))
}

/// The system of a run, or its own id when it has neither processes nor a directory yet.
fn name(run: &LivingRun) -> String {
    if run.system_id.is_empty() { format!("run {}", run.run_id) } else { format!("`{}`", run.system_id) }
}
