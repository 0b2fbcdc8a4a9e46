//! `scanloop run`: from the command line to the summary.

use std::io;
use std::path::{Path, PathBuf};

use anyhow::Context;
use emulator::scenario::{Obstacle, Shape};
use emulator::{Referee, Scenario};
use runtime::{Bus, ClockKind, Domain, RunSettings, RuntimeError, Shutdown, StopWord, Voice, latch_on_crash};
use shared_types::Directive;
use toml::{Table, Value};
use vehicle::frame::to_track;

use crate::adopt;
use crate::calibrate;
use crate::cli::{AdoptArguments, Choice, RunArguments};
use crate::control::ControlSocket;
use crate::digest::Digests;
use crate::exit::{Exit, Failure};
use crate::fleet::Fleet;
use crate::ledger::Books;
use crate::lock::{Claim, SystemLock, clear};
use crate::output::require_writable;
use crate::picture;
use crate::progress::Progress;
use crate::realtime;
use crate::recorder::{Recorder, RunInfo};
use crate::report::{Report, write_atomically};
use crate::roster::RunFile;
use crate::samples::Samples;
use crate::service_manager::ServiceManager;
use crate::session::{End, Session, Shadows, Swaps};
use crate::settings;
use crate::summary;
use crate::supervisor::{Event, Supervisor};
use crate::survivors::Survivors;
use crate::system::System;
use crate::table;
use crate::user_file::{self, TEXT_BYTES};
use crate::vitals::Vitals;

/// Scenario of a run without one.
const DEFAULT_SCENARIO: &str = "corridor";

/// Tables and keys that belong to the scenario; all others belong to the system.
const SCENARIO_KEYS: [&str; 11] = [
    "name",
    "seed",
    "timeout_s",
    "stop_final_s",
    "track",
    "start",
    "goal",
    "obstacle",
    "robot",
    "noise",
    "endless",
];

/// What is to be driven, checked.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// The scenario.
    pub scenario: Scenario,
    /// The system.
    pub system: System,
}

impl Plan {
    /// Reads and checks scenario and system, with overrides.
    ///
    /// # Errors
    /// One message with file, key, value and allowed range; exit code 2.
    pub(crate) fn read(scenario: Option<&str>, choice: &Choice) -> anyhow::Result<Self> {
        let (mut scenario, scenario_file) = read_scenario(scenario.unwrap_or(DEFAULT_SCENARIO))?;
        let (mut system, system_file) = System::read_table(choice.system.as_deref())?;
        if choice.realtime {
            realtime::add_profile(&mut system);
        }
        if let Some(file) = &choice.calibration {
            calibrate::apply(file, &mut system)?;
        }
        for text in &choice.overrides {
            let (key, value) = table::parse_override(text)?;
            let first = key.split('.').next().unwrap_or_default();
            let target = if SCENARIO_KEYS.contains(&first) { &mut scenario } else { &mut system };
            table::set(target, &key, value)?;
        }
        if let Some(seed) = choice.seed {
            let seed = i64::try_from(seed).map_err(|_| {
                Failure::bad_input(format!("--seed {seed} is not allowed: 0 to {}", i64::MAX))
            })?;
            scenario.insert("seed".to_owned(), Value::Integer(seed));
        }
        let scenario = Scenario::from_table(scenario, &scenario_file).map_err(Failure::bad_input)?;
        let system = System::from_table(system, &system_file)?;
        // What the stages take from the scenario may be allowed there and too much for them.
        let together = system.tuning().for_scenario(&scenario).validate();
        together.map_err(|invalid| Failure::bad_input(format!("{scenario_file}: {invalid}")))?;
        Ok(Self { scenario, system })
    }
}

/// How a run is driven, apart from what.
#[derive(Debug, Clone)]
pub(crate) struct Manner {
    /// Simulated time.
    pub lockstep: bool,
    /// Driven time after which it ends [s].
    pub duration_s: Option<f64>,
    /// No progress line.
    pub quiet: bool,
    /// Where results are written; an absolute path.
    pub out: PathBuf,
}

/// What the one who drives a run begins with: nothing, or what another orchestrator left.
pub(crate) struct Beginning {
    pub bus: Bus,
    pub word: StopWord,
    pub fleet: Fleet,
    /// Listens since before the first of them was made.
    pub shutdown: Shutdown,
    pub events: Vec<Event>,
    pub directive: Directive,
    /// 0 when another orchestrator has begun.
    pub first_scan: u64,
}

/// Drives a scenario and writes its report.
///
/// # Errors
/// Bad input, a process that could not be kept running, and errors of the bus or the file system.
pub(crate) fn run(system_id: &str, arguments: &RunArguments) -> anyhow::Result<Exit> {
    let RunArguments { out, duration, quiet, .. } = arguments;
    let to_adopt = AdoptArguments { out: out.clone(), duration: *duration, quiet: *quiet };
    if arguments.adopt {
        return adopt::adopt(system_id, &to_adopt);
    }
    // Before anything is made: a run that a signal ends removes it again.
    let shutdown = Shutdown::of_orchestrator()?;
    let plan = Plan::read(arguments.scenario.as_deref(), &arguments.choice)?;
    check_duration(*duration)?;
    if Domain::take_stopped_mark(system_id)? && arguments.adopt_or_start {
        return Err(RuntimeError::Stopped(system_id.to_owned()).into());
    }
    if let Claim::Left(domain, lock) = Claim::take(system_id)? {
        let survivors = Survivors::find(&domain);
        if arguments.adopt_or_start && !survivors.is_empty() {
            return adopt::take_over(&domain, lock, shutdown, survivors, &to_adopt);
        }
        if !survivors.is_empty() {
            let words = survivors.words();
            runtime::print(
                runtime::Priority::Warning,
                &format!("an earlier run lost its orchestrator: blocking its wheels and ending {words}"),
            );
        }
        clear(&domain, lock)?;
    }
    let out = out_folder(out.clone().unwrap_or_else(|| PathBuf::from("out").join(&plan.scenario.name)))?;
    let (domain, lock) = Claim::take_new(system_id)?;
    let manner = Manner { lockstep: arguments.lockstep, duration_s: *duration, quiet: *quiet, out };
    if shutdown.requested() {
        runtime::print(runtime::Priority::Warning, "interrupted before anything was started");
        return Ok(Exit::NotReached);
    }
    let session = start(&domain, &plan, manner.clone(), lock, shutdown)?;
    conclude(session, &plan.scenario, &manner.out)
}

/// Checks `--duration`.
pub(crate) fn check_duration(duration_s: Option<f64>) -> anyhow::Result<()> {
    match duration_s {
        Some(duration_s) if !(duration_s > 0.0 && duration_s <= 1e6) => Err(Failure::bad_input(format!(
            "--duration {duration_s} is not allowed: above 0, up to 1000000 s"
        ))),
        _ => Ok(()),
    }
}

/// Makes the folder of the results; returns its absolute path.
pub(crate) fn out_folder(out: PathBuf) -> anyhow::Result<PathBuf> {
    if std::path::absolute(&out).is_ok_and(|path| path.to_str().is_none()) {
        let out = out.display();
        return Err(Failure::bad_input(format!(
            "--out {out}: the path of the folder is not UTF-8; name another one"
        )));
    }
    if let Err(reason) = require_writable(&out) {
        return Err(Failure::bad_input(format!("--out {}: {reason}", out.display())));
    }
    let made = std::fs::create_dir_all(&out).and_then(|()| std::path::absolute(&out));
    made.map_err(|error| Failure::bad_input(format!("--out {}: {error}", out.display())))
}

/// Drives to the end, writes the results and prints the summary.
pub(crate) fn conclude(mut session: Session, scenario: &Scenario, out: &Path) -> anyhow::Result<Exit> {
    let ending = session.drive()?;
    let (recorder, digests) = session.finish();
    let report = Report { digests: digests.texts(), ..recorder.report(&ending) };
    let written = write_results(&report, scenario, &recorder, out);
    runtime::print(runtime::Priority::Notice, &summary::text(&report, Some(&near(out))));
    if let Err(error) = written {
        // The drive is over and ended as it did: a full disk changes nothing of that.
        runtime::print(runtime::Priority::Error, &format!("error: the results were not written: {error:#}"));
    }
    Ok(match ending.outcome.exit_code() {
        0 => Exit::Done,
        3 => Exit::Collision,
        4 => Exit::ProcessFailed,
        _ => Exit::NotReached,
    })
}

/// Writes report and picture. Those of an earlier run do not stay where they can't be replaced.
fn write_results(
    report: &Report,
    scenario: &Scenario,
    recorder: &Recorder,
    out: &Path,
) -> anyhow::Result<()> {
    let (report_file, picture_file) = (out.join("report.json"), out.join("drive.svg"));
    let report_written = or_none(&report_file, report.write(&report_file));
    let drawing = picture::draw(&scene_of(scenario, report), &recorder.drive())?;
    report_written.and(or_none(&picture_file, write_atomically(&picture_file, drawing.as_bytes())))
}

/// Removes the file of an earlier run when that of this run was not written.
fn or_none(path: &Path, written: io::Result<()>) -> anyhow::Result<()> {
    if written.is_err() {
        let _ = std::fs::remove_file(path);
    }
    written.with_context(|| format!("{}", path.display()))
}

/// A path as it is seen from the working folder.
fn near(path: &Path) -> PathBuf {
    let here = std::env::current_dir().unwrap_or_default();
    path.strip_prefix(here).unwrap_or(path).to_owned()
}

/// A run with nothing behind it, which no process has joined yet. Logs go to `logs` below `manner.out`.
///
/// # Errors
/// Errors of the bus and of the file system.
pub(crate) fn start(
    domain: &Domain,
    plan: &Plan,
    manner: Manner,
    lock: SystemLock,
    shutdown: Shutdown,
) -> anyhow::Result<Session> {
    let word = StopWord::create(domain.run_id(), plan.system.period_ns())?;
    latch_on_crash(&word);
    write_settings(domain, plan, manner.lockstep)?;
    let Manner { out, lockstep, duration_s, .. } = manner.clone();
    let Plan { scenario, system } = plan.clone();
    RunFile { out, lockstep, duration_s, system, scenario }.write(domain)?;
    let bus = Bus::create(domain)?;
    let logs = manner.out.join("logs");
    let fleet = Fleet::new(domain.clone(), lock, word.clone(), &plan.system, logs, false)?;
    let mut directive = Directive::default();
    directive.header.incarnation = 1;
    assemble(
        domain,
        plan,
        manner,
        Beginning { bus, word, fleet, shutdown, events: vec![Event::Start], directive, first_scan: 1 },
    )
}

/// A session that is about to drive.
pub(crate) fn assemble(
    domain: &Domain,
    plan: &Plan,
    manner: Manner,
    beginning: Beginning,
) -> anyhow::Result<Session> {
    let Plan { scenario, system } = plan;
    let Beginning { bus, word, fleet, shutdown, events, directive, first_scan } = beginning;
    shutdown.latch_also(&word)?;
    let control = ControlSocket::open(domain)?;
    let period_ns = system.period_ns();
    let policies = shared_types::Role::ALL
        .iter()
        .filter_map(|role| fleet.entry(*role).map(|entry| entry.policy(*role, period_ns)))
        .collect();
    let supervisor = Supervisor::new(policies);
    let supervisor = if manner.lockstep { supervisor.in_lockstep() } else { supervisor };
    let info = RunInfo {
        run_id: domain.run_id().to_owned(),
        scenario: scenario.name.clone(),
        seed: scenario.seed,
        lockstep: manner.lockstep,
        first_scan,
        goal_m: [scenario.goal.x_m, scenario.goal.y_m],
    };
    Ok(Session {
        samples: Samples::new(&bus, period_ns)?,
        books: if first_scan == 0 { Books::midway() } else { Books::new(manner.lockstep) },
        closed_ns: 0,
        vitals: Vitals::new(&bus)?,
        voice: Voice::new(&bus)?,
        digests: Digests::default(),
        referee: Referee::new(scenario),
        progress: Progress::new(manner.quiet),
        manager: ServiceManager::new(),
        recorder: Recorder::new(info),
        domain: domain.clone(),
        word,
        scenario: scenario.clone(),
        lockstep: manner.lockstep,
        duration_s: manner.duration_s,
        directive: Directive { orchestrator_pid: u64::from(std::process::id()), ..directive },
        written: None,
        rewrite_ns: 0,
        swaps: Swaps::default(),
        beginning: events,
        on_scan: None,
        shadows: Shadows::default(),
        end: End::NotYet,
        dirty: true,
        said_ns: 0,
        moved_ns: 0,
        period_ns,
        bus,
        fleet,
        supervisor,
        shutdown,
        control,
    })
}

fn write_settings(domain: &Domain, plan: &Plan, lockstep: bool) -> anyhow::Result<()> {
    let Plan { scenario, system } = plan;
    let run = RunSettings {
        period_ns: system.period_ns(),
        clock: if lockstep { ClockKind::Simulated } else { ClockKind::Monotonic },
        orphan_stop_ns: (system.orphan_stop_s() * 1e9) as u64,
        orphan_timeout_ns: (system.orphan_timeout_s * 1e9) as u64,
    };
    settings::write(domain, &run, &system.realtime, scenario, &system.tuning().for_scenario(scenario))
}

/// The table of a scenario file, or of a shipped scenario, and its name in messages.
fn read_scenario(name: &str) -> anyhow::Result<(Table, String)> {
    let path = Path::new(name);
    let (text, file) = match Scenario::shipped(name) {
        Some(text) if !path.is_file() => (text.to_owned(), format!("shipped scenario {name}")),
        _ => {
            let text = user_file::read(path, TEXT_BYTES).map_err(|error| {
                let shipped: Vec<&str> = Scenario::names().collect();
                Failure::bad_input(format!("{name}: {error}; shipped scenarios are {}", shipped.join(", ")))
            })?;
            (text, name.to_owned())
        }
    };
    let table = text.parse::<Table>().map_err(|error| {
        let line = error.span().map_or(1, |span| 1 + text[..span.start].matches('\n').count());
        Failure::bad_input(format!("{file}: line {line}: {}", error.message().replace('\n', ", ")))
    })?;
    Ok((table, file))
}

/// What the picture shows of a scenario.
fn scene_of(scenario: &Scenario, report: &Report) -> picture::Scene {
    picture::Scene {
        title: format!("{}: {}", report.scenario, report.outcome),
        subtitle: report.reason.clone(),
        track_x_m: scenario.track.x_m,
        track_y_m: scenario.track.y_m,
        walls: scenario.track.walls,
        obstacles: scenario.placed_obstacles().iter().map(outline).collect(),
        start_m: [scenario.start.x_m, scenario.start.y_m],
        goal_m: [scenario.goal.x_m, scenario.goal.y_m],
        goal_tolerance_m: scenario.goal.tolerance_m,
        body_length_m: scenario.robot.length_m,
        body_width_m: scenario.robot.width_m,
    }
}

/// The outline of an obstacle where the scenario puts it; a circle as a polygon of 48 corners.
fn outline(obstacle: &Obstacle) -> picture::Shape {
    let (x, y) = (obstacle.x_m, obstacle.y_m);
    let points = match obstacle.shape {
        Shape::Circle { radius_m } => (0..48)
            .map(|corner| {
                let (sin, cos) = (f64::from(corner) / 48.0 * std::f64::consts::TAU).sin_cos();
                [x + radius_m * cos, y + radius_m * sin]
            })
            .collect(),
        Shape::Box { length_m, width_m, yaw_rad } => [(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)]
            .map(|(forward, left)| {
                let corner = to_track(yaw_rad, forward * length_m, left * width_m);
                [x + corner.x, y + corner.y]
            })
            .to_vec(),
    };
    picture::Shape { points }
}
