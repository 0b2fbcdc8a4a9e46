//! `scanloop adopt`: takes over the processes of a run whose orchestrator died, while they drive.
//!
//! The roster that the run wrote down says who fills which role and what everyone was told last. Who is still the
//! one it was is watched from now on; who ended is started again by its policy; who was about to take over or to leave
//! is ended, and what lives under a number that was written down but is a stranger is named and left alone.
//!
//! Where this fails: how an adopted process ends is not told to us, so an exit with code 0 counts as a failure;
//! exchanges that were going on are over without a certificate; and the account begins with the first scan seen.

use console::exit::{Exit, Failure};
use runtime::{Bus, Domain, Priority, RuntimeError, Shutdown, StopWord, latch_on_crash, monotonic_ns, print};
use shared_types::{Authority, Directive, Phase, Role};
use supervision::child::Child;
use supervision::entry::ProcessRow;
use supervision::fleet::Fleet;
use supervision::lock::SystemLock;
use supervision::runs::LivingRun;
use supervision::supervisor::{Event, MIN_HANG_AFTER_MS};

use crate::arguments::{AdoptArguments, check_duration, out_folder};
use crate::process_registry::{ProcessRegistry, RunFile};
use crate::results::conclude;
use crate::session::Session;
use crate::startup::{RunOptions, Startup};
use crate::survivors::Survivors;

/// Takes over the processes of a run and drives it to its end.
///
/// # Errors
/// Nothing to adopt, or an orchestrator that lives (exit code 2), and errors of the bus or the file system.
pub fn adopt(system_id: &str, arguments: &AdoptArguments) -> anyhow::Result<Exit> {
    check_duration(arguments.duration)?;
    let shutdown = Shutdown::of_orchestrator()?;
    let nothing = |left: &[String]| {
        let left: String = left.iter().map(|stranger| format!("; {stranger}")).collect();
        Failure::bad_input(format!("system `{system_id}` has no processes that could be adopted{left}"))
    };
    let Some(domain) = supervision::runs::find(system_id)? else { return Err(nothing(&[])) };
    let mut lock = SystemLock::take(&domain)?;
    let survivors = Survivors::find(&domain);
    if survivors.is_empty() {
        // Files without processes are of no use to anyone.
        lock.own();
        return Err(nothing(&survivors.strangers));
    }
    take_over(&domain, lock, shutdown, survivors, arguments)
}

/// [`adopt`] for who holds the lock and has found someone.
///
/// # Errors
/// As [`adopt`]. The processes are left as they are when they cannot be taken over.
pub(crate) fn take_over(
    domain: &Domain,
    mut lock: SystemLock,
    shutdown: Shutdown,
    survivors: Survivors,
    arguments: &AdoptArguments,
) -> anyhow::Result<Exit> {
    let refused = |why: String| {
        let system_id = domain.system_id();
        Failure::bad_input(format!(
            "system `{system_id}` cannot be adopted: {why}; `scanloop stop` ends its processes"
        ))
    };
    let word = stop_word(domain)?;
    let (run, plan) = RunFile::read(domain).map_err(|error| refused(format!("{error:#}")))?;
    if run.lockstep {
        return Err(refused(
            "a run in lock-step ends with its orchestrator, as a gap changes the result".into(),
        ));
    }
    if survivors.process_registry.role.is_empty() {
        return Err(refused("nobody wrote down who fills its roles".to_owned()));
    }
    let out = out_folder(arguments.out.clone().unwrap_or(run.out))?;
    let bus = Bus::take_over(domain).map_err(|error| match error {
        RuntimeError::SharedMemory(_) => error.into(),
        other => refused(other.to_string()),
    })?;
    // From here on the run is ours, and so is its end.
    lock.own();
    word.claim();
    latch_on_crash(&word);
    let mut fleet = Fleet::new(
        domain.clone(),
        lock,
        word.clone(),
        &plan.system.realtime,
        &plan.system.processes,
        out.join("logs"),
        true,
    )?;
    print(Priority::Notice, &format!("adopting {}", survivors.words()));
    for stranger in &survivors.strangers {
        print(Priority::Warning, &format!("{stranger}; it is left alone"));
    }
    let Survivors { process_registry, listed, unlisted, .. } = survivors;
    let dismissed_ns = monotonic_ns() + (3 * plan.system.period_ns()).max(MIN_HANG_AFTER_MS * 1_000_000);
    let mut processes: Vec<(ProcessRow, Child)> =
        listed.into_iter().filter_map(|(row, process)| Some((row, Child::adopt(process)?))).collect();
    let mut directive = directive_of(&process_registry);
    let mut events = Vec::new();
    for role in Role::ALL.iter().copied() {
        let authority = &mut directive.authority[role.index()];
        let lives = |incarnation: u32| {
            processes
                .iter()
                .position(|(row, _)| row.role == role.name() && row.identity.incarnation == incarnation)
        };
        let chosen = lives(authority.incarnation).or_else(|| {
            let previous = lives(authority.previous)?;
            *authority = Authority { incarnation: authority.previous, ..Authority::default() };
            Some(previous)
        });
        let Some(row) = process_registry.of(role) else { continue };
        let restarts = row.restarts;
        let (pid, incarnation) = match chosen.map(|index| processes.swap_remove(index)) {
            Some((ProcessRow { identity, entry, .. }, child)) => {
                let pid = child.pid();
                fleet.adopt(role, entry, identity.incarnation, Some(child));
                (Some(pid), identity.incarnation)
            }
            None => {
                fleet.adopt(role, row.entry.clone(), row.incarnation, None);
                (None, row.incarnation)
            }
        };
        if pid.is_some() || incarnation != 0 {
            events.push(Event::Adopted { role, pid, incarnation, restarts });
        }
    }
    for (ProcessRow { role, identity, entry }, child) in processes {
        let Ok(role) = role.parse::<Role>() else { continue };
        print(Priority::Notice, &format!("{role} {} fills no role and is ended", identity.pid));
        // Until everyone has heard who counts, the one before may still have to answer.
        let stood_by = directive.authority[role.index()].previous == identity.incarnation;
        let kill_ns = if stood_by { dismissed_ns } else { 0 };
        fleet.dismiss_adopted(role, entry, identity.incarnation, child, kill_ns);
    }
    unlisted.iter().for_each(|process| process.signal(rustix::process::Signal::KILL));
    let phase = Phase::try_from(process_registry.phase).unwrap_or(Phase::Stopping);
    events.push(Event::Resume { phase, last_incarnation: process_registry.last_incarnation });

    let manner = RunOptions {
        lockstep: false,
        duration_s: arguments.duration.or(run.duration_s),
        quiet: arguments.quiet,
        out: out.clone(),
    };
    let startup = Startup { bus, word, fleet, shutdown, events, directive, first_scan: 0 };
    let mut session = Session::new(domain, &plan, manner, startup)?;
    session.resume_end(process_registry.outcome, process_registry.reason);
    conclude(session, &plan.scenario, &out)
}

/// The stop word of the run, from one of its processes.
///
/// # Errors
/// A run that was stopped, and one whose processes do not have the word: neither can be driven on.
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

/// What everyone was told last, as the word of another orchestrator.
fn directive_of(process_registry: &ProcessRegistry) -> Directive {
    let mut directive = Directive {
        // The supervisor announces it again when it has ended everyone.
        phase: process_registry.phase,
        stop: process_registry.stop,
        authority: process_registry.authority(),
        ..Directive::default()
    };
    // Readers take news of another producer whatever its number, and repeats of the same one never.
    directive.header.incarnation = process_registry.generation + 1;
    directive
}
