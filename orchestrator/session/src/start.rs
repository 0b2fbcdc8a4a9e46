//! A run that starts: its files, its bus, its processes, and the session that drives it.

use std::path::PathBuf;

use audit::digest::Digests;
use audit::ledger::Books;
use audit::samples::Samples;
use console::progress::Progress;
use emulator::Referee;
use plan::Plan;
use report::recorder::{Recorder, RunInfo};
use runtime::{Bus, Domain, Shutdown, StopWord, Voice, latch_on_crash};
use shared_types::Directive;
use supervision::fleet::Fleet;
use supervision::lock::SystemLock;
use supervision::supervisor::{Event, Supervisor};

use crate::control::ControlSocket;
use crate::roster::RunFile;
use crate::service_manager::ServiceManager;
use crate::session::{End, Session, Shadows, Swaps};
use crate::vitals::Vitals;

/// How a run is driven, apart from what.
#[derive(Debug, Clone)]
pub struct Manner {
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
    pub(crate) bus: Bus,
    pub(crate) word: StopWord,
    pub(crate) fleet: Fleet,
    /// Listens since before the first of them was made.
    pub(crate) shutdown: Shutdown,
    pub(crate) events: Vec<Event>,
    pub(crate) directive: Directive,
    /// 0 when another orchestrator has begun.
    pub(crate) first_scan: u64,
}

/// A run with nothing behind it, which no process has joined yet. Logs go to `logs` below `manner.out`.
///
/// # Errors
/// Errors of the bus and of the file system.
pub fn start(
    domain: &Domain,
    plan: &Plan,
    manner: Manner,
    lock: SystemLock,
    shutdown: Shutdown,
) -> anyhow::Result<Session> {
    let word = StopWord::create(domain.run_id(), plan.system.period_ns())?;
    latch_on_crash(&word);
    plan.write_settings(domain, manner.lockstep)?;
    let Manner { out, lockstep, duration_s, .. } = manner.clone();
    let Plan { scenario, system } = plan.clone();
    RunFile { out, lockstep, duration_s, system, scenario }.write(domain)?;
    let bus = Bus::create(domain)?;
    let logs = manner.out.join("logs");
    let fleet = Fleet::new(
        domain.clone(),
        lock,
        word.clone(),
        &plan.system.realtime,
        &plan.system.processes,
        logs,
        false,
    )?;
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
