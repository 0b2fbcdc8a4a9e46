//! `scanloop demo`: drives, disturbs, changes and stops a system, and compares what was promised with what was measured.
//!
//! The demo is a user: it starts the commands of this program and looks at the samples on the bus. Every figure is
//! measured in this run, on this machine.

mod acts;
mod claims;
mod drive_view;
mod load;
mod page;
mod show;
mod story;
mod system;

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};
use console::exit::{Exit, Failure};
use console::new_file::Scratch;
use console::out_folder::OutFolder;
use console::{answer, note};
use runtime::Shutdown;
use session::arguments::out_folder;
use shared_types::Role;

use crate::print_json;
use claims::{Claim, Claims};
use show::Show;
use story::Story;
use system::{Interrupted, System};

/// The files of the results.
const DATA: &str = "demo.json";
const PAGE: &str = "demo.html";
/// Time between two acts, to look at the page.
const PAUSE: Duration = Duration::from_secs(4);

/// Arguments of `demo`.
#[derive(Debug, Args)]
pub struct DemoArguments {
    /// Without the live page and without pauses: for tests.
    #[arg(long)]
    pub fast: bool,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
    /// Folder for `demo.html`, one file to send to somebody, for `demo.json`, and for the report and the logs of the drive.
    #[arg(long, value_name = "DIR", value_parser = console::output::folder())]
    pub out: Option<PathBuf>,
    /// Replace files in the folder that this program did not write.
    #[arg(long)]
    pub force: bool,
    /// Port of the live page on 127.0.0.1; 0 for any free one.
    #[arg(long, value_name = "PORT", default_value_t = 0, conflicts_with = "fast")]
    pub port: u16,
    /// Only this act; may be given several times.
    #[arg(long, value_enum, value_name = "ACT")]
    pub only: Vec<Act>,
    /// Promise another value, as in `scan_to_actuation_ms=20`; the names are those of the JSON keys.
    #[arg(long = "promise", value_name = "NAME=NUMBER")]
    pub promises: Vec<String>,
}

/// A part of the demo.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Act {
    /// Drive undisturbed.
    Drive,
    /// Kill estimator, obstacles, controller and actuator in turn.
    Kill,
    /// Kill the orchestrator and adopt the processes.
    Orchestrator,
    /// Swap controller and robot under way.
    Swap,
    /// Plant 5 ms in one stage and find it.
    Delay,
    /// Blind the scanner.
    Blind,
    /// Drive one scenario twice in lock-step and compare.
    Lockstep,
}

impl Act {
    /// The names of its claims begin with one of these.
    const fn claims(self) -> &'static [&'static str] {
        match self {
            Self::Drive => &["answered_", "unanswered_", "scan_to_"],
            Self::Kill => &["killed_estimator", "killed_obstacles", "killed_controller", "killed_actuator"],
            Self::Orchestrator => &["killed_orchestrator"],
            Self::Swap => &["swapped_"],
            Self::Delay => &["planted_"],
            Self::Blind => &["blind_"],
            Self::Lockstep => &["lockstep_"],
        }
    }
}

/// Runs the acts and prints the table; exit code 1 when a claim does not hold.
///
/// # Errors
/// Promises that are not allowed, a system of that id, a port in use, a folder that can't be written to (exit code 2), and
/// a system that does not start.
pub(crate) fn demo(system_id: Option<&str>, arguments: &DemoArguments) -> anyhow::Result<Exit> {
    let acts = if arguments.only.is_empty() { Act::value_variants() } else { &arguments.only };
    let is_live = acts.iter().any(|act| *act != Act::Lockstep);
    require_page(is_live, arguments.port)?;
    let whole_drive = ["clearance_", "unaccounted_"];
    let is_chosen = |name: &str| {
        let begins = |starts: &[&str]| starts.iter().any(|start| name.starts_with(start));
        acts.iter().any(|act| begins(act.claims()))
            || is_live && begins(&whole_drive)
            || name == "left_behind"
    };
    let claims = Claims::new(is_chosen, &arguments.promises)?;
    let shutdown = Shutdown::of_orchestrator()?;
    let id = system_id.map_or_else(|| format!("demo-{}", std::process::id()), str::to_owned);
    // What runs under this id is stopped at the end, so it must not be a system of the user.
    if supervision::runs::find(&id)?.is_some() {
        return Err(Failure::bad_input(format!(
            "system `{id}` exists already: the demo starts a system of its own, name another one"
        )));
    }
    let scratch = Scratch::new()?;
    let drive = match &arguments.out {
        Some(out) => out_folder(out.clone())?,
        None => scratch.path().to_owned(),
    };
    let results = OutFolder::claim(&drive, &[DATA, PAGE], arguments.force)?;
    let system = System::new(id, scratch.path().to_owned(), drive.join("drive"));
    let pause = if arguments.fast { Duration::ZERO } else { PAUSE };
    let mut show = Show { system, watch: None, story: Story::new(), claims, shutdown: &shutdown, pause };
    let port = (!arguments.fast).then_some(arguments.port);
    match play(&mut show, acts, is_live.then_some(port)) {
        Err(error) if error.is::<Interrupted>() => {
            note!("interrupted: everything is being stopped");
            return Ok(Exit::NotReached);
        }
        played => played?,
    }
    answer!(arguments.json, "\n{}", show.claims.table())?;
    let failed = show.claims.claims.iter().filter(|claim| !claim.held).count();
    let time_s = show.story.time_s();
    answer!(
        arguments.json,
        "{} of {} promises held, measured in {time_s:.0} s",
        show.claims.claims.len() - failed,
        show.claims.claims.len()
    )?;
    if show.claims.claims.iter().any(Claim::may_fail_by_load)
        && let Some(busy) = load::busy()
    {
        answer!(
            arguments.json,
            "{busy}: the times are promised for a machine with idle processors, so try again"
        )?;
    }
    if let Some(out) = &arguments.out {
        results.write(DATA, (serde_json::to_string_pretty(&show.claims)? + "\n").as_bytes())?;
        let picture = std::fs::read_to_string(out.join("drive/drive.svg")).ok();
        let page = page::html(&show.claims, &show.story, picture.as_deref());
        answer!(arguments.json, "page            {}", results.write(PAGE, page.as_bytes())?.display())?;
    }
    print_json(arguments.json, &show.claims)?;
    Ok(if show.claims.held { Exit::Done } else { Exit::NotReached })
}

/// Refuses a port for the page of a demo that has none.
fn require_page(is_live: bool, port: u16) -> anyhow::Result<()> {
    if is_live || port == 0 {
        return Ok(());
    }
    let reason = "act `lockstep` alone has no live page: leave it out, or name another act too";
    Err(Failure::bad_input(format!("--port {port}: {reason}")))
}

/// Plays the acts in their order. An act that fails leaves its claims unmeasured.
fn play(show: &mut Show<'_>, acts: &[Act], live: Option<Option<u16>>) -> anyhow::Result<()> {
    if let Some(port) = live {
        show.start(port)?;
    }
    let mut ends_by_itself = false;
    for act in Act::value_variants().iter().filter(|act| **act != Act::Lockstep && acts.contains(act)) {
        let played = perform(show, *act);
        let is_done = settle(show, played)?;
        ends_by_itself |= is_done && *act == Act::Blind;
        if show.pause > Duration::ZERO {
            let observed = show.observe(show.pause);
            settle(show, observed)?;
        }
    }
    if live.is_some() {
        let finished = show.finish(ends_by_itself);
        settle(show, finished)?;
    }
    if acts.contains(&Act::Lockstep) {
        let driven = show.lockstep();
        settle(show, driven)?;
    }
    show.leave()
}

fn perform(show: &mut Show<'_>, act: Act) -> anyhow::Result<()> {
    match act {
        Act::Drive => show.drive(),
        Act::Kill => {
            for role in [Role::Estimator, Role::Obstacles, Role::Controller, Role::Actuator] {
                show.kill(role)?;
                // Time to see it drive; also, the next death is then a first one again.
                show.observe(show.pause.max(Duration::from_secs(1)))?;
            }
            Ok(())
        }
        Act::Orchestrator => show.kill_orchestrator(),
        Act::Swap => {
            show.swap(Role::Controller, "nmpc")?;
            show.swap(Role::Robot, "emulator")
        }
        Act::Delay => show.delay(),
        Act::Blind => show.blind(),
        Act::Lockstep => show.lockstep(),
    }
}

/// Whether an act was played. Tells what went wrong and lets the demo continue, unless it was interrupted.
fn settle(show: &mut Show<'_>, played: anyhow::Result<()>) -> anyhow::Result<bool> {
    match played {
        Err(error) if error.is::<Interrupted>() => Err(error),
        Err(error) => {
            show.story.tell("failed", &format!("{error:#}"));
            Ok(false)
        }
        Ok(()) => Ok(true),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_is_refused_where_no_page_is_served() {
        let of = |only: Vec<Act>, port: u16| DemoArguments {
            fast: false,
            json: false,
            out: None,
            force: false,
            port,
            only,
            promises: Vec::new(),
        };
        let refused = demo(None, &of(vec![Act::Lockstep], 7117)).unwrap_err().to_string();
        assert!(refused.starts_with("--port 7117: act `lockstep` alone has no live page: "), "{refused}");
        assert!(require_page(true, 7117).is_ok() && require_page(false, 0).is_ok());
    }
}
