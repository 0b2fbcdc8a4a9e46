//! The part of a system that runs here: a bus of its own, and the processes that its orchestrator wants.

use std::path::Path;
use std::sync::Arc;

use runtime::{
    Bus, CANDIDATE_VARIABLE, Domain, LinkTable, StopWord, monotonic_ns, own_settings_file, write_handover,
};
use shared_types::Role;
use supervision::child::{Child, Launch, this_program};
use supervision::child_log::ChildLog;
use supervision::environment::{environment_of, variable};
use supervision::halt;
use supervision::lock::{Claim, SystemLock};
use supervision::supervisor::ProcessExit;

use crate::message::{Down, RemoteOrder, RemoteStart, RemoteState, Up, of_hex};

/// Lines of its log that are reported when a process has ended.
const LAST_LINES: usize = 10;
/// A process whose orchestrator says nothing about it for this long, although it could, is killed [ns].
const FORGOTTEN_NS: u64 = 1_000_000_000;
/// A system without processes that is not heard of for this long has ended [ns].
const ENDED_NS: u64 = 2_000_000_000;

/// A system of another host, as far as it runs here.
pub(crate) struct Served {
    /// Id of the run at the orchestrator.
    pub(crate) run_id: String,
    /// Id of the system there.
    pub(crate) system_id: String,
    heard_ns: u64,
    processes: Vec<ServedProcess>,
    stop_word: StopWord,
    bus: Bus,
    domain: Domain,
    // Dropped last: what it removes must not be in use any more.
    _lock: SystemLock,
}

/// One process.
struct ServedProcess {
    role: Role,
    incarnation: u32,
    child: Child,
    log: Arc<ChildLog>,
    heard_ns: u64,
    is_ending: bool,
    ended: Option<(RemoteState, Vec<String>)>,
}

impl Served {
    /// Makes the bus of a system, and the table of its link.
    ///
    /// # Errors
    /// An id that is too long or in use, and errors of the bus.
    pub(crate) fn new(host: &str, down: &Down, start: &RemoteStart) -> anyhow::Result<Self> {
        let (domain, lock) = Claim::take_new(&format!("{}-{host}", down.system_id))?;
        let table = LinkTable {
            here: host.to_owned(),
            run_id: down.run_id.clone(),
            period_ns: start.period_ns,
            orphan_timeout_ns: 0,
            realtime: start.realtime.clone(),
            sends: start.sends.clone(),
            receives: start.receives.clone(),
            peers: Vec::new(),
            credentials: None,
        };
        table.write(&domain)?;
        let bus = Bus::create(&domain, start.period_ns)?;
        let stop_word = StopWord::create(domain.run_id(), start.period_ns)?;
        stop_word.hand_down()?;
        let (run_id, system_id) = (down.run_id.clone(), down.system_id.clone());
        Ok(Self {
            run_id,
            system_id,
            heard_ns: monotonic_ns(),
            processes: Vec::new(),
            stop_word,
            bus,
            domain,
            _lock: lock,
        })
    }

    /// Id of the system here.
    pub(crate) fn id(&self) -> &str {
        self.domain.system_id()
    }

    /// Does what a message wants; returns the answer. `offset_ns` is the orchestrator's clock minus ours, if it is known.
    pub(crate) fn obey(&mut self, down: &Down, offset_ns: Option<i64>, logs: &Path) -> Option<Up> {
        let now_ns = monotonic_ns();
        self.heard_ns = now_ns;
        if down.stopped {
            self.stop_word.latch();
        }
        let known = self.processes.iter().position(|process| process.incarnation == down.incarnation);
        match (known, down.order, &down.start) {
            (Some(index), order, _) => {
                let process = &mut self.processes[index];
                process.heard_ns = now_ns;
                if order == RemoteOrder::Terminate && !process.is_ending {
                    process.is_ending = true;
                    let _ = process.child.terminate();
                }
            }
            // A state with times of another clock is of no use: the message comes again.
            (None, RemoteOrder::Start, Some(start)) if start.handover.is_some() && offset_ns.is_none() => {
                return None;
            }
            (None, RemoteOrder::Start, Some(start)) => {
                if let Err(error) = self.start(down, start, offset_ns.unwrap_or(0), logs) {
                    return Some(refusal(down, format!("{error:#}")));
                }
            }
            (None, ..) => return Some(answer(down, RemoteState::Unknown)),
        }
        self.state_of(down.incarnation)
    }

    fn start(&mut self, down: &Down, start: &RemoteStart, offset_ns: i64, logs: &Path) -> anyhow::Result<()> {
        let Down { role, incarnation, .. } = *down;
        self.domain.folder().write(&own_settings_file(incarnation), start.settings.as_bytes())?;
        let handover = start.handover.as_deref().and_then(|text| of_hex(text, -offset_ns));
        write_handover(&self.domain, role, handover.as_ref())?;
        let mut environment = environment_of(&self.domain, &self.stop_word, role, incarnation, start.restart);
        environment.extend(start.candidate.map(|running| variable(CANDIDATE_VARIABLE, running)));
        let path = logs.join(format!("{role}.log"));
        let log = ChildLog::of_run(&path, true)?;
        log.begin(&format!("{role} incarnation {incarnation}: {}", start.implementation))?;
        let command = vec![this_program().into(), "service".into(), (&start.implementation).into()];
        let child = Child::spawn(&Launch { command, environment }, &log)?;
        self.stop_word.enlist(child.pid());
        for refused in start.realtime.apply_to(child.pid()) {
            log.begin(&refused)?;
        }
        let heard_ns = monotonic_ns();
        self.processes.push(ServedProcess {
            role,
            incarnation,
            child,
            log,
            heard_ns,
            is_ending: false,
            ended: None,
        });
        Ok(())
    }

    /// Notices processes that have ended, and kills those that the orchestrator has forgotten although `could_tell`.
    /// Returns a message for each that has just ended.
    pub(crate) fn watch(&mut self, could_tell: bool) -> Vec<Up> {
        let now_ns = monotonic_ns();
        let mut ended = Vec::new();
        for process in self.processes.iter_mut().filter(|process| process.ended.is_none()) {
            if could_tell && now_ns.saturating_sub(process.heard_ns) > FORGOTTEN_NS {
                match process.role {
                    // It ends at rest: a robot that is killed while it moves can't be stopped any more.
                    Role::Robot => {
                        self.stop_word.latch();
                        let _ = process.child.terminate();
                    }
                    _ => _ = process.child.kill(),
                }
            }
            if let Ok(Some(exit)) = process.child.try_wait() {
                let lines = process.log.last_lines(LAST_LINES).unwrap_or_default();
                process.ended = Some((state_of(exit), lines));
                ended.push(process.incarnation);
            }
        }
        if !ended.is_empty() {
            self.bus.clean_up_dead_processes();
        }
        ended.into_iter().filter_map(|incarnation| self.state_of(incarnation)).collect()
    }

    /// Frees what a link that has ended has left on the bus.
    pub(crate) fn clean_up(&self) {
        self.bus.clean_up_dead_processes();
    }

    /// Whether the orchestrator speaks about this system now.
    pub(crate) fn is_wanted(&self) -> bool {
        monotonic_ns().saturating_sub(self.heard_ns) < ENDED_NS
    }

    /// Whether all of it has ended.
    pub(crate) fn has_ended(&self) -> bool {
        !self.is_wanted() && self.is_idle()
    }

    /// Whether none of its processes runs.
    pub(crate) fn is_idle(&self) -> bool {
        self.processes.iter().all(|process| process.ended.is_some())
    }

    /// Ends all processes: the wheels are blocked first, and a robot ends at rest. Returns a message for each.
    pub(crate) fn end(&mut self) -> Vec<Up> {
        let is_running = |process: &mut ServedProcess| matches!(process.child.try_wait(), Ok(None));
        if self.processes.iter_mut().any(is_running) {
            halt::end_own_run(&self.domain, &self.stop_word);
        }
        let ended = self.watch(false);
        // A robot that is not known to rest is left.
        self.processes.iter_mut().for_each(|process| process.child.release());
        ended
    }

    fn state_of(&self, incarnation: u32) -> Option<Up> {
        let process = self.processes.iter().find(|process| process.incarnation == incarnation)?;
        let running = || (RemoteState::Running { pid: process.child.pid() }, Vec::new());
        let (state, last_lines) = process.ended.clone().unwrap_or_else(running);
        let stopped = !self.stop_word.is_armed();
        let (wheels, seen_ns) = self.stop_word.wheels(process.role);
        let is_news = seen_ns > 0 && seen_ns >= self.stop_word.stopped_ns();
        let wheels = (has_wheels(process.role) && is_news).then_some(wheels as u64);
        Some(Up { run_id: self.run_id.clone(), incarnation, state, stopped, wheels, last_lines })
    }
}

/// Whether the process of a role reports what the wheels do.
fn has_wheels(role: Role) -> bool {
    matches!(role, Role::Robot | Role::Actuator)
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.end();
    }
}

/// The answer that the process of a message is not started, with the reason.
pub(crate) fn refusal(down: &Down, reason: String) -> Up {
    answer(down, RemoteState::Refused { reason })
}

fn answer(down: &Down, state: RemoteState) -> Up {
    let Down { run_id, incarnation, .. } = down.clone();
    Up { run_id, incarnation, state, stopped: false, wheels: None, last_lines: Vec::new() }
}

fn state_of(exit: ProcessExit) -> RemoteState {
    match exit {
        ProcessExit::Code(code) => RemoteState::Exited { code },
        ProcessExit::Signal(signal) => RemoteState::Killed { signal },
        ProcessExit::Unknown => RemoteState::Unknown,
    }
}
