//! The companions of a run: started, watched, restarted, replaced and ended.
//!
//! They share nothing with the roles but the directory and the bus: [`Keeper`] decides when one is started or killed,
//! and the page in shared memory has what it reports. No death of a companion is an event for the supervisor.

use std::os::fd::{AsFd, BorrowedFd};
use std::path::Path;
use std::sync::Arc;

use console::limits::text_of;
use runtime::{
    COMPANION_VARIABLE, CompanionPage, CompanionSelfReport, Domain, MAX_COMPANIONS, REPORT_VARIABLE,
    STOOD_STILL_NS, StopWord, monotonic_ns,
};
use rustix::process::{Pid, setpriority_process};
use shared_types::{Authority, Header, ProcessState, Role, did_you_mean};

use super::process::{Load, Process, command_of};
use super::starvation::Starvation;
use crate::child::{Child, Launch};
use crate::child_log::ChildLog;
use crate::entry::ProcessEntry;
use crate::environment::{joining, variable};
use crate::keeper::{Keeper, KeeperOrder, KeeperPolicy, Life};
use crate::supervisor::VisibleState;

/// Companions have incarnations from this number on, so that they differ from those of roles.
const FIRST_INCARNATION: u32 = 1 << 24;
/// Nice value of companions: where processors are scarce, the loop runs first. With 45 companions on two processors the median
/// latency of the loop is 0.9 ms with it and 2.1 ms without.
const NICE: i32 = 10;
/// How many of its last lines are shown when a companion dies.
const LAST_LOG_LINES: usize = 10;
/// Rates are averages over this time [ns].
const RATE_WINDOW_NS: u64 = 1_000_000_000;
/// In lock-step, a companion that leaves a sample unanswered for this long leaves the grants [ns].
const LOCKSTEP_LIMIT_NS: u64 = 2_000_000_000;

/// All companions of one run.
pub struct Companions {
    domain: Domain,
    stop_word: StopWord,
    page: CompanionPage,
    lockstep: bool,
    next_incarnation: u32,
    members: Vec<Member>,
    ends: bool,
    /// When they were looked at last [ns].
    advanced_ns: u64,
}

struct Member {
    entry: ProcessEntry,
    log: Arc<ChildLog>,
    keeper: Keeper,
    starvation: Starvation,
    process: Option<Running>,
    /// The one that takes over when it is connected.
    successor: Option<Running>,
    /// Those that were replaced, and when each is killed if it has not ended [ns].
    leaving: Vec<(Running, u64)>,
    /// Whose samples count.
    authority: Authority,
    report: usize,
    /// Lock-step waits for it.
    holds: bool,
    /// The scan of its last answer, and when it had changed [ns].
    answered: (u64, u64),
    /// When its rate was measured [ns], what it had published then, and the rate [Hz].
    rate: (u64, u64, f64),
    left_at_scan: Option<u64>,
    last_log_lines: Vec<String>,
}

struct Running {
    process: Process,
    report: usize,
    /// It may take over once it is connected.
    is_approved: bool,
}

/// What has happened to a companion.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CompanionEvent {
    /// It ended, or could not be started: its name, how, and its last log lines.
    Ended(String, String, Vec<String>),
    /// It made no progress and was killed.
    Hung(String),
    /// It is not started any more; true when the run needs it.
    Failed(String, bool),
    /// Lock-step waits for it no longer, from that scan on.
    LeftLockstep(String, u64),
    /// The samples of its successor count from that scan on.
    TakesOver(String, u64),
    /// Its successor ended before it took over, and how.
    SuccessorEnded(String, String, Vec<String>),
    /// Another process has taken over from that scan on.
    Replaced(String, u64),
}

/// A companion in `status` and in the report.
#[derive(Debug, Clone)]
pub struct CompanionView {
    /// Its name.
    pub name: String,
    /// Its command.
    pub command: String,
    /// Process id; 0 when none runs.
    pub pid: u32,
    /// What it does.
    pub state: VisibleState,
    /// Starts after the first.
    pub restarts: u32,
    /// Whether the run needs it.
    pub needed: bool,
    /// What it uses of the machine.
    pub load: Load,
    /// Samples published per second.
    pub rate_hz: f64,
    /// What it reports.
    pub report: CompanionSelfReport,
    /// The scan from which on lock-step did not wait for it any more.
    pub left_at_scan: Option<u64>,
    /// Last log lines of the process before the one that runs.
    pub last_log_lines: Vec<String>,
}

impl Companions {
    /// The companions of `entries`, none started yet; logs go to files below `logs`. `generation` numbers the
    /// orchestrators of the run.
    ///
    /// # Errors
    /// A page or a log that can't be opened.
    pub fn new(
        domain: &Domain,
        stop_word: &StopWord,
        entries: &[ProcessEntry],
        period_ns: u64,
        lockstep: bool,
        generation: u32,
        logs: &Path,
    ) -> anyhow::Result<Self> {
        let mut members = Vec::new();
        for (index, entry) in entries.iter().enumerate() {
            let path = logs.join(format!("{}.log", entry.name()));
            let log = ChildLog::of_run(&path, generation > 1)?;
            members.push(Member {
                keeper: Keeper::new(policy_of(entry, period_ns, lockstep)),
                starvation: Starvation::default(),
                log,
                process: None,
                successor: None,
                leaving: Vec::new(),
                authority: Authority::default(),
                report: index,
                holds: lockstep && entry.is_in_lockstep(),
                answered: (0, monotonic_ns()),
                rate: (monotonic_ns(), 0, 0.0),
                left_at_scan: None,
                last_log_lines: Vec::new(),
                entry: entry.clone(),
            });
        }
        Ok(Self {
            domain: domain.clone(),
            stop_word: stop_word.clone(),
            page: CompanionPage::create(domain)?,
            lockstep,
            next_incarnation: FIRST_INCARNATION.saturating_mul(generation.clamp(1, 100)),
            members,
            ends: false,
            advanced_ns: monotonic_ns(),
        })
    }

    /// Tells companions that the orchestrator works, the phase, and whose samples of the loop count.
    pub fn announce(&self, phase: u32, authority: &[Authority]) {
        for (role, authority) in Role::ALL.iter().zip(authority) {
            self.page.set_role(*role, authority);
        }
        self.page.beat(monotonic_ns(), phase);
    }

    /// Starts, reaps and judges; `recorded_scan` is the newest scan that is recorded, `newest_scan` the newest published.
    pub fn advance(&mut self, recorded_scan: u64, newest_scan: u64) -> Vec<CompanionEvent> {
        let mut events = Vec::new();
        self.forgive_own_stall();
        let working = |member: &Member| {
            let report = self.page.report(member.report);
            member.holds && report.taken > report.answered
        };
        let any_works = self.members.iter().any(working);
        for index in 0..self.members.len() {
            self.reap(index, &mut events);
            self.members[index].measure(&self.page);
            if !self.ends {
                self.keep(index, &mut events);
                self.hand_over(index, recorded_scan, &mut events);
                self.watch_lockstep(index, newest_scan, any_works, &mut events);
            }
        }
        events
    }

    fn reap(&mut self, index: usize, events: &mut Vec<CompanionEvent>) {
        let now_ns = monotonic_ns();
        let member = &mut self.members[index];
        let name = member.entry.name().to_owned();
        member.leaving.retain_mut(|(running, kill_ns)| {
            if now_ns >= *kill_ns {
                let _ = running.process.child.kill();
            }
            !running.process.has_ended()
        });
        let mut is_successor_gone = false;
        let exit_of = |running: &mut Option<Running>| {
            let exit = running.as_mut()?.process.child.try_wait().ok().flatten()?;
            *running = None;
            Some(exit)
        };
        if let Some(exit) = exit_of(&mut member.successor) {
            let lines = member.log.last_lines(LAST_LOG_LINES).unwrap_or_default();
            events.push(CompanionEvent::SuccessorEnded(name.clone(), exit.to_string(), lines));
            // Samples that it has published may count already: those of the old process do again.
            if let Some(running) = &member.process {
                let incarnation = running.process.incarnation;
                member.authority = Authority { incarnation, ..Authority::default() };
            }
            is_successor_gone = true;
        }
        let Some(exit) = exit_of(&mut member.process) else {
            if is_successor_gone {
                self.publish(index);
            }
            return;
        };
        member.last_log_lines = member.log.last_lines(LAST_LOG_LINES).unwrap_or_default();
        member.authority = Authority::default();
        if self.ends {
            return;
        }
        events.push(CompanionEvent::Ended(name.clone(), exit.to_string(), member.last_log_lines.clone()));
        // A gap changes what a run in lock-step gives, so it is not started again there.
        if self.lockstep && member.holds {
            member.leave(now_ns, events);
        }
        member.died(now_ns, events);
        self.publish(index);
    }

    fn keep(&mut self, index: usize, events: &mut Vec<CompanionEvent>) {
        let now_ns = monotonic_ns();
        let report = self.page.report(self.members[index].report);
        let member = &mut self.members[index];
        let incarnation = member.process.as_ref().map_or(0, |running| running.process.incarnation);
        let passes = (report.incarnation == incarnation && incarnation != 0).then_some(report.activations);
        member.excuse_starved(now_ns, passes);
        match member.keeper.advance(now_ns, passes) {
            Some(KeeperOrder::Start) => {
                let started = self.start(index);
                let member = &mut self.members[index];
                match started {
                    Ok(running) => {
                        let incarnation = running.process.incarnation;
                        member.authority = Authority { incarnation, ..Authority::default() };
                        member.report = running.report;
                        member.process = Some(running);
                    }
                    Err(error) => {
                        let (name, text) = (member.entry.name().to_owned(), text_of(&error));
                        events.push(CompanionEvent::Ended(name, text, Vec::new()));
                        member.died(now_ns, events);
                    }
                }
                self.publish(index);
            }
            Some(KeeperOrder::Kill) => {
                events.push(CompanionEvent::Hung(member.entry.name().to_owned()));
                if let Some(running) = &member.process {
                    let _ = running.process.child.kill();
                }
            }
            None => {}
        }
    }

    /// Time in which this process was stopped does not count as silence: companions may have been stopped with it.
    fn forgive_own_stall(&mut self) {
        let now_ns = monotonic_ns();
        let away_ns = now_ns.saturating_sub(std::mem::replace(&mut self.advanced_ns, now_ns));
        if away_ns > STOOD_STILL_NS {
            for member in &mut self.members {
                member.keeper.forgive(away_ns);
                member.answered.1 = member.answered.1.saturating_add(away_ns).min(now_ns);
            }
        }
    }

    fn start(&mut self, index: usize) -> anyhow::Result<Running> {
        let incarnation = self.next_incarnation;
        self.next_incarnation += 1;
        let member = &self.members[index];
        // The other of its two reports, when one is in use.
        let used = member.process.as_ref().map(|running| running.report);
        let report = if used == Some(index) { index + MAX_COMPANIONS } else { index };
        self.page.clear_report(report);
        let mut environment =
            joining(&self.domain, &self.stop_word, incarnation, member.keeper.restarts() > 0);
        environment.push(variable(COMPANION_VARIABLE, member.entry.name()));
        environment.push(variable(REPORT_VARIABLE, report));
        let _ = member.log.begin(&format!(
            "{} incarnation {incarnation}: {}",
            member.entry.name(),
            member.entry.label()
        ));
        let launch = Launch { command: command_of(&member.entry), environment };
        let child = Child::spawn(&launch, &member.log)?;
        self.stop_word.enlist(child.pid());
        // One that has ended, or runs with a lower priority already, stays as it is.
        let _ = setpriority_process(Pid::from_raw(child.pid().cast_signed()), NICE);
        let process = Process::new(member.entry.clone(), incarnation, child);
        Ok(Running { process, report, is_approved: false })
    }

    /// A successor that is connected takes over two scans later; then the old process ends.
    fn hand_over(&mut self, index: usize, recorded_scan: u64, events: &mut Vec<CompanionEvent>) {
        let member = &mut self.members[index];
        let Some(successor) = &member.successor else { return };
        let report = self.page.report(successor.report);
        let is_connected = report.incarnation == successor.process.incarnation
            && report.state().is_some_and(|state| state >= ProcessState::Connected);
        let new = successor.process.incarnation;
        if is_connected && successor.is_approved && member.authority.incarnation != new {
            let previous = member.authority.incarnation;
            let from_scan = recorded_scan + 3;
            member.authority = Authority { incarnation: new, previous, from_scan };
            events.push(CompanionEvent::TakesOver(member.entry.name().to_owned(), from_scan));
            self.publish(index);
            return;
        }
        if member.authority.incarnation != new || recorded_scan < member.authority.from_scan + 1 {
            return;
        }
        let from_scan = member.authority.from_scan;
        let Some(successor) = member.successor.take() else { return };
        member.report = successor.report;
        member.entry.command = successor.process.entry.command.clone();
        member.authority = Authority { incarnation: new, ..Authority::default() };
        let now_ns = monotonic_ns();
        if let Some(old) = member.process.replace(successor) {
            let _ = old.process.child.terminate();
            member.leaving.push((old, now_ns + member.entry.grace_ms * 1_000_000));
        }
        member.keeper.replaced(now_ns);
        events.push(CompanionEvent::Replaced(member.entry.name().to_owned(), from_scan));
        self.publish(index);
    }

    /// One that has taken a sample and does not answer it keeps others waiting: it is the one that leaves.
    fn watch_lockstep(
        &mut self,
        index: usize,
        newest_scan: u64,
        any_works: bool,
        events: &mut Vec<CompanionEvent>,
    ) {
        let member = &mut self.members[index];
        if !member.holds {
            return;
        }
        let now_ns = monotonic_ns();
        let CompanionSelfReport { answered_scan, taken, answered, .. } = self.page.report(member.report);
        let is_late = now_ns.saturating_sub(member.answered.1) > LOCKSTEP_LIMIT_NS;
        if answered_scan != member.answered.0 || answered_scan >= newest_scan {
            member.answered = (answered_scan, now_ns);
        } else if is_late && (taken > answered || !any_works) {
            member.leave(now_ns, events);
            self.publish(index);
        }
    }

    fn publish(&self, index: usize) {
        let member = &self.members[index];
        self.page.set_companion(index, &member.authority, member.report, member.holds);
    }

    /// Whether all companions that the start waits for report this state or a later one: those in lock-step, and those
    /// that the run needs.
    pub fn have_reached(&self, wanted: ProcessState) -> bool {
        self.members.iter().all(|member| {
            let waits = member.holds || member.entry.is_needed();
            let is_gone = member.keeper.life() == Life::Failed;
            let report = self.page.report(member.report);
            !waits || is_gone || report.state().is_some_and(|state| state >= wanted)
        })
    }

    /// In lock-step, the newest scan that all companions that hold the grants are done with; `None` when none does.
    pub fn answered_scan(&self) -> Option<u64> {
        let held = self.members.iter().filter(|member| member.holds);
        held.map(|member| self.page.report(member.report).answered_scan).min()
    }

    /// Starts a process that replaces a companion while the robot drives, once it is approved; returns whether an old
    /// process runs.
    ///
    /// # Errors
    /// Why it can't be replaced.
    pub fn swap(&mut self, name: &str, command: &[String]) -> Result<bool, String> {
        let index = self.find(name)?;
        if self.members[index].successor.is_some() {
            return Err(format!("companion {name} is being replaced already"));
        }
        let before = self.members[index].entry.clone();
        self.members[index].entry.command = Some(command.to_vec());
        if self.members[index].process.is_none() {
            self.members[index].keeper.start_now();
            return Ok(false);
        }
        let started = self.start(index);
        self.members[index].entry = before;
        self.members[index].successor = Some(started.map_err(|error| text_of(&error))?);
        Ok(true)
    }

    /// The command of a companion.
    ///
    /// # Errors
    /// An unknown name.
    pub fn command(&self, name: &str) -> Result<Vec<String>, String> {
        let index = self.find(name)?;
        Ok(self.members[index].entry.command.clone().unwrap_or_default())
    }

    /// The incarnations of a companion and of its successor, if it has one.
    pub fn incarnations(&self, name: &str) -> Option<(u32, u32)> {
        let member = self.members.iter().find(|member| member.entry.name() == name)?;
        let incarnation = |running: &Option<Running>| Some(running.as_ref()?.process.incarnation);
        Some((incarnation(&member.process).unwrap_or(0), incarnation(&member.successor)?))
    }

    /// Whether a sample of a companion counts; the last ones of a process that has died do.
    pub fn counts(&self, name: &str, header: &Header) -> bool {
        let member = self.members.iter().find(|member| member.entry.name() == name);
        member.is_some_and(|Member { authority, .. }| {
            authority.incarnation == 0 || authority.accepts(header.incarnation, header.scan_id)
        })
    }

    /// The successor of a companion may take over.
    pub fn approve(&mut self, name: &str) {
        let successors = self.members.iter_mut().filter(|member| member.entry.name() == name);
        successors
            .filter_map(|member| member.successor.as_mut())
            .for_each(|running| running.is_approved = true);
    }

    /// Ends the successor of a companion, which stays as it is.
    pub fn refuse(&mut self, name: &str) {
        let now_ns = monotonic_ns();
        for member in self.members.iter_mut().filter(|member| member.entry.name() == name) {
            if let Some(successor) = member.successor.take() {
                let _ = successor.process.child.terminate();
                member.leaving.push((successor, now_ns + member.entry.grace_ms * 1_000_000));
            }
        }
    }

    fn find(&self, name: &str) -> Result<usize, String> {
        let names = || self.members.iter().map(|member| member.entry.name()).collect::<Vec<_>>().join(", ");
        let found = self.members.iter().position(|member| member.entry.name() == name);
        found.ok_or_else(|| {
            let meant = did_you_mean(name, self.members.iter().map(|member| member.entry.name()));
            format!("unknown companion `{name}`: the system has {}.{meant}", names())
        })
    }

    /// Descriptors that become readable when a companion ends.
    pub fn descriptors(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        self.members.iter().filter_map(|member| Some(member.process.as_ref()?.process.child.as_fd()))
    }

    /// The companions, for `status` and the report.
    pub fn views(&mut self) -> Vec<CompanionView> {
        let Self { members, page, .. } = self;
        members.iter_mut().map(|member| member.view(page)).collect()
    }

    /// Asks all companions to end; from now on none is started.
    pub fn end(&mut self) {
        self.ends = true;
        let now_ns = monotonic_ns();
        for member in &mut self.members {
            let running = member.process.take().into_iter().chain(member.successor.take());
            for running in running.collect::<Vec<_>>() {
                let _ = running.process.child.terminate();
                member.leaving.push((running, now_ns + member.entry.grace_ms * 1_000_000));
            }
        }
    }

    /// Whether all have ended; those that do not end in time are killed.
    pub fn have_ended(&mut self) -> bool {
        let mut events = Vec::new();
        (0..self.members.len()).for_each(|index| self.reap(index, &mut events));
        self.members.iter().all(|member| member.leaving.is_empty())
    }
}

/// In lock-step a companion may wait for another one that hangs, so its own limit is longer.
fn policy_of(entry: &ProcessEntry, period_ns: u64, lockstep: bool) -> KeeperPolicy {
    let policy = entry.keeper_policy(period_ns);
    let least_ns = if lockstep { 2 * LOCKSTEP_LIMIT_NS } else { 0 };
    KeeperPolicy { hang_ns: policy.hang_ns.max(least_ns), ..policy }
}

impl Member {
    /// On a busy machine a companion, which has a lower priority than the loop, may wait for a processor longer than the
    /// time after which it counts as hung.
    fn excuse_starved(&mut self, now_ns: u64, passes: Option<u64>) {
        let suspicion = self.keeper.suspicion(now_ns, passes);
        let Some((is_over, running)) = suspicion.zip(self.process.as_ref()) else {
            self.starvation.clear();
            return;
        };
        let Process { incarnation, child, .. } = &running.process;
        if self.starvation.is_starved(*incarnation, child.pid()) && is_over {
            self.keeper.excuse(now_ns);
        }
    }

    /// Measures the rate of its outputs once a second.
    fn measure(&mut self, page: &CompanionPage) {
        let (now_ns, published) = (monotonic_ns(), page.report(self.report).published);
        let (at_ns, before, _) = self.rate;
        let elapsed_ns = now_ns.saturating_sub(at_ns);
        if elapsed_ns > RATE_WINDOW_NS {
            let rate_hz = published.saturating_sub(before) as f64 / (elapsed_ns as f64 * 1e-9);
            self.rate = (now_ns, published, rate_hz);
        }
    }

    fn died(&mut self, now_ns: u64, events: &mut Vec<CompanionEvent>) {
        self.keeper.died(now_ns);
        if self.left_at_scan.is_some() {
            self.keeper.give_up();
        }
        if self.keeper.life() == Life::Failed {
            events.push(CompanionEvent::Failed(self.entry.name().to_owned(), self.entry.is_needed()));
        }
    }

    fn leave(&mut self, now_ns: u64, events: &mut Vec<CompanionEvent>) {
        let scan = self.answered.0 + 1;
        self.holds = false;
        self.left_at_scan = Some(scan);
        self.answered.1 = now_ns;
        events.push(CompanionEvent::LeftLockstep(self.entry.name().to_owned(), scan));
    }

    fn view(&mut self, page: &CompanionPage) -> CompanionView {
        let report = page.report(self.report);
        let state = match (self.keeper.life(), report.state()) {
            (Life::Due(_), _) => VisibleState::Backoff,
            (Life::Hung, _) => VisibleState::Hung,
            (Life::Failed, _) => VisibleState::Failed,
            (Life::Running { .. }, Some(state)) if state >= ProcessState::Connected => VisibleState::Ready,
            (Life::Running { .. }, _) => VisibleState::Starting,
        };
        CompanionView {
            name: self.entry.name().to_owned(),
            command: self.entry.label(),
            pid: self.process.as_ref().map_or(0, |running| running.process.child.pid()),
            state,
            restarts: self.keeper.restarts(),
            needed: self.entry.is_needed(),
            load: self.process.as_mut().map_or_else(Load::default, |running| running.process.load()),
            rate_hz: self.rate.2,
            report,
            left_at_scan: self.left_at_scan,
            last_log_lines: self.last_log_lines.clone(),
        }
    }
}
