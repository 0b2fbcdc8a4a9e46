//! `scanloop check --live`: what the robot and its scanner really do, one line per check.
//!
//! A running system is observed only. Otherwise robot, estimator and obstacle detector of the system are started.
//! This command is then their orchestrator and actuator: it keeps the wheels blocked, or drives a metre with `--drive`.
//!
//! Limits: stamps, rate and returns are judged by what the robot publishes. Whether the ranges are right is seen only
//! from the state of the scanner, and fully only while the robot drives.

mod bench;
mod feed;
mod finding;
mod motion;
mod sensors;

use std::fmt::Write as _;

use clap::Args;
use console::answer;
use console::exit::{Exit, Failure};
use plan::{Choice, Plan, System};
use runtime::{Bus, Domain, Shutdown, monotonic_ns, wait_for};
use serde::Serialize;
use session::driven_system;
use supervision::private_system::POLL_NS;
use supervision::runs;

use crate::print_json;
use bench::Bench;
use feed::Feed;
use finding::{Finding, Outcome};

/// What `check` does without `--live`. The options of `--live` are refused with it by themselves: beside what excludes
/// `--live`, it is not asked for.
const NOT_LIVE: [&str; 2] = ["files", "list"];

/// Arguments of `check --live`.
#[derive(Debug, Args, Clone)]
pub struct LiveArguments {
    /// Check a robot and its scanner: of the running system, or of the given one, which is started with blocked wheels.
    #[arg(long, conflicts_with_all = NOT_LIVE)]
    pub live: bool,
    /// Drive about 2 m, first straight on and then to the left, and measure the stops. Without it the robot never drives.
    #[arg(long, requires = "live", conflicts_with_all = NOT_LIVE)]
    pub drive: bool,
    /// Speed of `--drive`, 0.1 to 1 m/s; it is sent without a calibration.
    #[arg(long, value_name = "MPS", default_value_t = 0.3, requires = "drive", conflicts_with_all = NOT_LIVE)]
    pub speed: f64,
    /// Stops of `--drive`, 1 to 20, from the speed and from half of it in turn, as far as the way is free.
    #[arg(long, value_name = "N", default_value_t = 4, requires = "drive", conflicts_with_all = NOT_LIVE)]
    pub stops: usize,
    /// Time to observe scanner and odometry, 1 to 3600 s.
    #[arg(long, value_name = "S", default_value_t = 5.0, requires = "live", conflicts_with_all = NOT_LIVE)]
    pub observe: f64,
    /// Time for each motion by hand, up to 600 s; 0 skips them.
    #[arg(long, value_name = "S", default_value_t = 30.0, requires = "live", conflicts_with_all = ["drive", "files", "list"])]
    pub by_hand: f64,
    /// Print the findings as JSON to standard output.
    #[arg(long, requires = "live", conflicts_with_all = NOT_LIVE)]
    pub json: bool,
}

/// All findings.
#[derive(Debug, Serialize)]
struct LiveReport {
    system_id: String,
    /// `running` or `started`.
    system: &'static str,
    checks: Vec<Finding>,
    ok: usize,
    failed: usize,
    skipped: usize,
    /// The value to be entered in `[vehicle]`, once it was measured.
    blocked_deceleration_mps2: Option<f64>,
    /// The most probable deceleration of blocked wheels; the value to be entered is smaller by its error.
    deceleration_estimate_mps2: Option<f64>,
}

/// Checks the robot and prints the findings; exit code 1 when a check failed.
///
/// # Errors
/// Wrong usage, a process that can't be started or ends, and errors of the bus.
pub(crate) fn check(system_id: &str, arguments: &LiveArguments, choice: &Choice) -> anyhow::Result<Exit> {
    validate(arguments)?;
    let shutdown = Shutdown::of_orchestrator()?;
    let is_running = runs::living(system_id).is_some_and(|run| !run.is_over());
    let (checks, deceleration) = if is_running {
        (observe(system_id, arguments, &shutdown)?, None)
    } else {
        let plan = Plan::read(None, choice)?;
        let mut bench = Bench::start(system_id, &plan, shutdown)?;
        bench.observe((arguments.observe * 1e9) as u64)?;
        let mut checks = sensors::findings(&bench.feed.observed, &plan.system);
        show(&checks, arguments)?;
        let moved = motion::findings(&mut bench, &plan.system, arguments, &checks)?;
        checks.extend(moved.findings);
        (checks, moved.deceleration)
    };
    let count = |outcome: Outcome| checks.iter().filter(|finding| finding.outcome == outcome).count();
    let [ok, failed, skipped] = [Outcome::Ok, Outcome::Failed, Outcome::Skipped].map(count);
    let entered_mps2 = deceleration.map(|found| found.entered_mps2);
    answer!(arguments.json, "{}", summary(ok, failed, skipped, entered_mps2))?;
    let report = LiveReport {
        system_id: system_id.to_owned(),
        system: if is_running { "running" } else { "started" },
        checks,
        ok,
        failed,
        skipped,
        blocked_deceleration_mps2: entered_mps2,
        deceleration_estimate_mps2: deceleration.map(|found| found.estimate_mps2),
    };
    print_json(arguments.json, &report)?;
    Ok(if failed == 0 { Exit::Done } else { Exit::NotReached })
}

fn validate(arguments: &LiveArguments) -> anyhow::Result<()> {
    let LiveArguments { speed, stops, observe, by_hand, .. } = *arguments;
    let ranges = [
        ("--speed", speed, 0.1..=1.0, "0.1 to 1 m/s"),
        ("--stops", stops as f64, 1.0..=20.0, "1 to 20"),
        ("--observe", observe, 1.0..=3600.0, "1 to 3600 s"),
        ("--by-hand", by_hand, 0.0..=600.0, "0 to 600 s"),
    ];
    match ranges.iter().find(|(_, value, range, _)| !range.contains(value)) {
        Some((name, value, _, allowed)) => {
            Err(Failure::bad_input(format!("{name} {value} is not allowed: {allowed}")))
        }
        None => Ok(()),
    }
}

/// Observes a running system and changes nothing.
fn observe(system_id: &str, arguments: &LiveArguments, shutdown: &Shutdown) -> anyhow::Result<Vec<Finding>> {
    let domain = runs::existing(system_id)?;
    let system = system_of(&domain)?;
    if arguments.drive {
        return Err(Failure::bad_input(format!(
            "--drive needs the robot alone, and system `{system_id}` is running: stop it first"
        )));
    }
    let bus = Bus::open(&domain, "observer")?;
    let mut feed = Feed::open(&bus, &system.vehicle)?;
    let end_ns = monotonic_ns() + (arguments.observe * 1e9) as u64;
    while monotonic_ns() < end_ns {
        wait_for(&[shutdown.descriptor()], POLL_NS);
        if shutdown.requested() {
            return Err(Failure::interrupted());
        }
        feed.poll()?;
    }
    let mut checks = sensors::findings(&feed.observed, &system);
    let reason = "the system is running: stop it, then check again";
    checks.extend(motion::NAMES.map(|name| Finding::skipped(name, reason)));
    show(&checks, arguments)?;
    Ok(checks)
}

/// The system of a run in real time.
fn system_of(domain: &Domain) -> anyhow::Result<System> {
    let id = domain.system_id();
    match driven_system(domain) {
        Ok((system, false)) => Ok(system),
        Ok((_, true)) => Err(Failure::bad_input(format!("system `{id}` runs in simulated time"))),
        Err(error) => Err(Failure::bad_input(format!("system `{id}` is not driven by `run`: {error:#}"))),
    }
}

fn show(checks: &[Finding], arguments: &LiveArguments) -> anyhow::Result<()> {
    checks.iter().try_for_each(|finding| answer!(arguments.json, "{finding}").map(drop))
}

fn summary(ok: usize, failed: usize, skipped: usize, deceleration_mps2: Option<f64>) -> String {
    let mut text = format!("{ok} ok, {failed} failed, {skipped} skipped");
    if let Some(value) = deceleration_mps2 {
        let _ = write!(
            text,
            "\nenter in the table [vehicle] of the system file:\n  blocked_deceleration_mps2 = {value}"
        );
    }
    text
}
