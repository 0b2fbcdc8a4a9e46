//! `scanloop adopt`: takes over the processes of a run whose orchestrator died, while they drive.
//!
//! The process registry of the run contains the process of each role and the newest directive. A process that still
//! lives is watched from now on; one that ended is started again by its policy; candidates and processes that were
//! about to end are ended. An unrelated process that has the number of one in the registry is named and left alone.
//!
//! Where this fails: the kernel does not report how an adopted process ends, so an exit with code 0 counts as a failure;
//! a swap in progress is over without a certificate; and the sample audit begins with the first scan that is received.

use console::exit::{Exit, Failure};
use plan::change;
use runtime::{Bus, Domain, Priority, RuntimeError, Shutdown, StopWord, latch_on_crash, monotonic_ns, print};
use shared_types::{Authority, Directive, Phase, Role};
use supervision::child::Child;
use supervision::entry::ProcessRow;
use supervision::fleet::Fleet;
use supervision::lock::SystemLock;
use supervision::runs::{LivingRun, RunProcess, absent, strays_of};
use supervision::supervisor::{Event, MIN_HANG_AFTER_MS};

use crate::arguments::{CommonArguments, check_duration, out_folder};
use crate::own_processes::OwnProcesses;
use crate::process_registry::{ProcessRegistry, RoleRow, RunFile};
use crate::results::{claim, conclude};
use crate::session::Session;
use crate::start::start_link;
use crate::startup::{RunOptions, Startup};
use crate::survivors::Survivors;

/// Takes over the processes of a run and drives it to its end.
///
/// # Errors
/// Nothing to adopt, or an orchestrator that lives (exit code 2), and errors of the bus or the file system.
pub fn adopt(system_id: &str, arguments: &CommonArguments) -> anyhow::Result<Exit> {
    check_duration(arguments.duration)?;
    let shutdown = Shutdown::of_orchestrator()?;
    let nothing = |left: &[String]| {
        let left: String = left.iter().map(|stranger| format!("; {stranger}")).collect();
        Failure::bad_input(format!("system `{system_id}` has no processes that could be adopted{left}"))
    };
    let strays = || strays_of(system_id).iter().map(RunProcess::description).collect::<Vec<_>>();
    let Some(domain) = supervision::runs::find(system_id)? else {
        return Err(match absent(system_id) {
            error @ RuntimeError::OfAnother { .. } => error.into(),
            _ => nothing(&strays()),
        });
    };
    let mut lock = SystemLock::take(&domain)?;
    let survivors = Survivors::find(&domain);
    if survivors.is_empty() {
        // Files without processes are removed with the lock.
        lock.own();
        return Err(nothing(&[survivors.strangers, survivors.strays].concat()));
    }
    take_over(&domain, lock, shutdown, survivors, arguments)
}

/// [`adopt`] with the lock held and the processes found.
///
/// # Errors
/// As [`adopt`]. The processes are left as they are when they cannot be taken over.
pub(crate) fn take_over(
    domain: &Domain,
    mut lock: SystemLock,
    shutdown: Shutdown,
    survivors: Survivors,
    arguments: &CommonArguments,
) -> anyhow::Result<Exit> {
    let refused = |why: String| {
        let system_id = domain.system_id();
        Failure::bad_input(format!(
            "system `{system_id}` cannot be adopted: {why}; `scanloop stop` ends its processes"
        ))
    };
    let stop_word = stop_word(domain)?;
    let (run, plan) = RunFile::read(domain).map_err(|error| refused(format!("{error:#}")))?;
    if run.lockstep {
        return Err(refused(
            "a run in lock-step ends with its orchestrator, as a gap changes the result".into(),
        ));
    }
    if survivors.registry.role.is_empty() {
        let damage = ProcessRegistry::read(domain).err();
        return Err(refused(damage.map_or_else(
            || "its process registry names no process".to_owned(),
            |error| format!("its process registry: {error:#}"),
        )));
    }
    let out = out_folder(arguments.out.clone().unwrap_or(run.out))?;
    // The run has claimed its own folder already.
    let results = claim(&out, arguments.force || arguments.out.is_none())?;
    let _held = results.hold()?;
    let bus = Bus::take_over(domain, plan.system.period_ns()).map_err(|error| match error {
        RuntimeError::SharedMemory(_) => error.into(),
        other => refused(other.to_string()),
    })?;
    // From here on this orchestrator owns the run and its files.
    lock.own();
    stop_word.claim();
    latch_on_crash(&stop_word);
    let mut fleet = Fleet::new(
        domain.clone(),
        lock,
        stop_word.clone(),
        &plan.system.realtime,
        &plan.system.roles().cloned().collect::<Vec<_>>(),
        out.join("logs"),
        true,
    )?;
    print(Priority::Notice, &format!("adopting {}", survivors.labels()));
    for stranger in &survivors.strangers {
        print(Priority::Warning, &format!("{stranger}; it is left alone"));
    }
    for stray in &survivors.strays {
        print(Priority::Warning, &format!("{stray}, is no part of the system: it is left alone"));
    }
    let Survivors { registry, listed, unlisted, .. } = survivors;
    let listed = listed.into_iter();
    let processes = listed.filter_map(|(row, process)| Some((row, Child::adopt(process)?))).collect();
    let mut directive = directive_of(&registry);
    let (mut events, others) = fill_roles(&mut fleet, &registry, &mut directive, processes);
    for role in Role::ALL {
        change::keep(domain, *role, fleet.incarnation(*role))?;
    }
    let standby_ns = monotonic_ns() + (3 * plan.system.period_ns()).max(MIN_HANG_AFTER_MS * 1_000_000);
    for (ProcessRow { role, identity, entry }, child) in others {
        print(Priority::Notice, &format!("{role} {} fills no role and is ended", identity.pid));
        // A standby may still have to answer until all processes have received the directive.
        let is_standby = directive.authority[role.index()].previous == identity.incarnation;
        fleet.dismiss_adopted(entry, identity.incarnation, child, if is_standby { standby_ns } else { 0 });
    }
    unlisted.iter().for_each(|process| process.signal(rustix::process::Signal::KILL));
    let phase = Phase::try_from(registry.phase).unwrap_or(Phase::Stopping);
    events.push(Event::Resume { phase, last_incarnation: registry.last_incarnation });

    let duration_s = arguments.duration.or(run.duration_s);
    let options = RunOptions { lockstep: false, duration_s, quiet: arguments.quiet, out };
    let judged_by = registry.judged_by;
    let generation = directive.header.incarnation;
    let companions = OwnProcesses::new(&bus, domain, &stop_word, &plan, false, generation, &options.out)?;
    let link = start_link(domain, &plan, &fleet, &options)?;
    let startup = Startup {
        bus,
        stop_word,
        fleet,
        companions,
        shutdown,
        events,
        directive,
        first_scan: 0,
        judged_by,
        link,
    };
    let mut session = Session::new(domain, &plan, &options, startup)?;
    if plan.system.recording.ring_s > 0.0 {
        session.keep_ring(&options.out, plan.system.recording.ring_s);
    }
    session.resume_driver(registry.driven_by);
    session.resume_progress();
    session.resume_end(registry.outcome, registry.reason);
    conclude(session, &plan, &results)
}

/// Fills each role with the process in charge, or else with the one before it. Returns the events for the supervisor,
/// and the processes that are left over.
fn fill_roles(
    fleet: &mut Fleet,
    registry: &ProcessRegistry,
    directive: &mut Directive,
    mut processes: Vec<(ProcessRow, Child)>,
) -> (Vec<Event>, Vec<(ProcessRow, Child)>) {
    let mut events = Vec::new();
    for RoleRow { role, incarnation, restarts, entry } in registry.role.iter().cloned() {
        let authority = &mut directive.authority[role.index()];
        let index_of = |incarnation: u32| {
            let is_it = |row: &ProcessRow| row.role == role && row.identity.incarnation == incarnation;
            processes.iter().position(|(row, _)| is_it(row))
        };
        let chosen = index_of(authority.incarnation).or_else(|| {
            let previous = index_of(authority.previous)?;
            *authority = Authority { incarnation: authority.previous, ..Authority::default() };
            Some(previous)
        });
        let (entry, incarnation, child) = match chosen.map(|index| processes.swap_remove(index)) {
            Some((row, child)) => (row.entry, row.identity.incarnation, Some(child)),
            None => (entry, incarnation, None),
        };
        let pid = child.as_ref().map(Child::pid);
        fleet.adopt(role, entry, incarnation, child);
        if pid.is_some() || incarnation != 0 {
            events.push(Event::Adopted { role, pid, incarnation, restarts });
        }
    }
    (events, processes)
}

/// The stop word of the run, from one of its processes.
///
/// # Errors
/// A run that was stopped, and one whose processes do not hold a stop word: neither can be driven on.
fn stop_word(domain: &Domain) -> anyhow::Result<StopWord> {
    let system_id = domain.system_id();
    let word = LivingRun::of(domain.run_id()).and_then(|run| run.word);
    match word {
        Some(word) if word.is_armed() => Ok(word),
        Some(_) => Err(RuntimeError::Stopped(system_id.to_owned()).into()),
        None => Err(Failure::bad_input(format!(
            "system `{system_id}` cannot be adopted: no process of it has its stop word; `scanloop stop` ends its processes"
        ))),
    }
}

/// The newest directive of the run, as one of a new orchestrator.
fn directive_of(registry: &ProcessRegistry) -> Directive {
    let mut directive = Directive {
        // The supervisor announces `stopping` again when it ends the processes.
        phase: registry.phase,
        stop: registry.stop,
        authority: registry.authority(),
        ..Directive::default()
    };
    // Readers drop repeats of one publisher by their number; the first sample of another one is always taken.
    directive.header.incarnation = registry.generation + 1;
    directive
}
