//! Candidates: processes that run in shadow, for a swap or a comparison. Swaps and shadows
//! decide, the session starts, observes and ends them.

use std::collections::BTreeMap;

use console::limits::text_of;
use emulator::JudgedBy;
use handover::swap::outputs::RoleWatch;
use handover::swap::{Party, SwapEvent};
use plan::change;
use runtime::{HandoverData, monotonic_ns, own_settings_file, started_settings_file};
use shared_types::{Authority, Phase, ProcessState, Role, Topic};
use supervision::entry::ProcessEntry;
use supervision::fleet::Fleet;
use supervision::supervisor::{Event, ProcessExit, Supervisor, VisibleState};

use super::{GRANT_AHEAD, Session};
use crate::run_recorder::RunRecorder;

/// An output of a candidate may be for a scan that the orchestrator has not polled yet, but no further ahead [scans].
const MAX_AHEAD: u64 = 256;
/// Of so many candidates whose swap is over, the settings stay in the directory of the system, for recorders: on a busy
/// machine one may find a process when the swap is over.
const MAX_SETTLED: usize = 16;

/// The outputs of each candidate and of the process in charge, by incarnation of the candidate.
pub(crate) type Watches = BTreeMap<u32, RoleWatch>;

/// What the session does for a swap or a shadow.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Order {
    /// Publish which samples count, unless the supervisor has started another process since.
    Authorise {
        role: Role,
        /// Incarnations of the old and the new process.
        parties: [u32; 2],
        authority: Authority,
    },
    /// Kill the new process of a swap.
    Reject(u32),
    /// Kill a shadow.
    Dismiss(u32),
    /// The candidate fills its role from now on.
    Promote { role: Role, incarnation: u32, is_restart: bool },
    /// Print a line for the user.
    Note(String),
}

/// A process that is to become a candidate or a shadow of the one that fills its role.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Candidate {
    pub(super) entry: ProcessEntry,
    /// Its settings file, when its settings differ from those of its role.
    pub(super) settings: Option<String>,
}

/// The process that fills a role, as a request for a candidate finds it.
pub(super) struct Live<'a> {
    pub(super) entry: &'a ProcessEntry,
    /// The system drives, and the process is ready.
    pub(super) is_ready: bool,
    /// Names of the other hosts of the system.
    pub(super) hosts: &'a [String],
    /// Whether all roles are on the host of the orchestrator.
    pub(super) is_on_one_host: bool,
}

impl<'a> Live<'a> {
    /// The process of a role.
    ///
    /// # Errors
    /// A role without a process.
    pub(super) fn of(
        role: Role,
        fleet: &'a Fleet,
        supervisor: &Supervisor,
        hosts: &'a [String],
    ) -> Result<Self, String> {
        let entry = fleet.entry(role).ok_or_else(|| format!("no process of role {role}"))?;
        let is_ready = supervisor.process(role).is_some_and(|view| view.state == VisibleState::Ready);
        Ok(Self {
            entry,
            is_ready: is_ready && supervisor.phase() == Phase::Driving,
            hosts,
            is_on_one_host: fleet.places().all(|(_, host)| host.is_none()),
        })
    }

    /// Passes when the system drives and the process is ready; `purpose` is what it is not ready for else.
    ///
    /// # Errors
    /// The reason.
    pub(super) fn require_ready(&self, purpose: &str) -> Result<(), String> {
        let refused = || format!("{} is not ready {purpose}: the system must drive", self.entry.role());
        self.is_ready.then_some(()).ok_or_else(refused)
    }
}

impl Session {
    /// Hands the outputs since the last call to the swap and the shadows.
    pub(super) fn observe_candidates(&mut self) -> anyhow::Result<()> {
        if let Some([old, new]) = self.swaps.plan().map(|plan| [plan.old, plan.new]) {
            let (newest, answered) = (self.samples.newest_scan(), self.samples.answered_scan());
            let mut events = vec![SwapEvent::Scans { newest, answered }];
            events.extend(self.is_acknowledged().then_some(SwapEvent::Acknowledged));
            if let Some(watch) = self.watches.get_mut(&new) {
                watch.poll(old, new, |party, output| {
                    // The swap remembers the newest scan: one that can't be there yet is no output.
                    if output.scan <= newest.saturating_add(MAX_AHEAD) {
                        events.push(SwapEvent::Output(party, output));
                    }
                })?;
            }
            events.into_iter().try_for_each(|event| self.swap_event(event))?;
        }
        let (now_ns, newest) = (monotonic_ns(), self.samples.newest_scan());
        for (role, incarnation) in self.shadows.running().collect::<Vec<_>>() {
            let live = self.directives.current.authority[role.index()].incarnation;
            let Self { watches, shadows, .. } = self;
            if let Some(watch) = watches.get_mut(&incarnation) {
                watch.poll(live, incarnation, |party, output| {
                    if output.scan <= newest.saturating_add(MAX_AHEAD) {
                        shadows.output(now_ns, incarnation, party, output);
                    }
                })?;
            }
        }
        Ok(())
    }

    /// Whether all hosts with a process have the last change of authority.
    fn is_acknowledged(&self) -> bool {
        let Some(link) = &self.link else { return true };
        let mut hosts = self.fleet.places().filter_map(|(_, host)| host);
        hosts.all(|host| link.has_directive(host, self.authorised))
    }

    /// A process reported its state.
    pub(super) fn candidate_reported(&mut self, incarnation: u32, state: ProcessState) {
        self.swaps.received(incarnation, state);
        // One that has just attached waits for the directive, which would be repeated only after a while.
        self.directives.changed |= state == ProcessState::Attached && self.watches.contains_key(&incarnation);
    }

    /// A process ended; whether that does not concern the supervisor.
    pub(super) fn candidate_ended(
        &mut self,
        role: Role,
        incarnation: u32,
        exit: ProcessExit,
    ) -> anyhow::Result<bool> {
        if self.shadows.ended(incarnation, || self.fleet.reason_of(role, exit)) {
            return Ok(true);
        }
        let Some(party) = self.swaps.party_of(incarnation) else { return Ok(false) };
        let is_new = party == Party::New;
        let reason = if is_new { self.fleet.reason_of(role, exit) } else { exit.to_string() };
        self.swap_event(SwapEvent::Exited(party, reason))?;
        let is_known = self.supervisor.process(role).is_some_and(|view| view.incarnation == incarnation);
        Ok(!is_known)
    }

    /// Starts the candidates that were asked for, moves the swap and the shadows on, and grants scans in lock-step.
    pub(super) fn advance_candidates(&mut self) -> anyhow::Result<()> {
        if !self.drives() {
            let orders = self.swaps.run_ends(monotonic_ns());
            self.follow(orders)?;
        }
        let (granted_scan, vitals) = (self.directives.current.granted_scan, &self.vitals);
        let due = self.swaps.due(monotonic_ns(), granted_scan, |role| vitals.checkpoint(role));
        if let Some(candidate) = due {
            let role = candidate.entry.role();
            let old = self.supervisor.process(role).map_or(0, |view| view.incarnation);
            let new = self.supervisor.next_incarnation();
            let needs_truth = self.judged_by == Some(JudgedBy::Truth);
            let started = self.start_candidate(candidate, new, needs_truth);
            let order = self.swaps.begin(monotonic_ns(), [old, new], started);
            self.follow(order)?;
        }
        self.swap_event(SwapEvent::Tick)?;
        if self.run.lockstep
            && self.is_recorded()
            && let Some(scan) = self.swaps.granted_scan(monotonic_ns())
        {
            let held = self.companions.granted_scan(super::GRANT_AHEAD);
            let copied = self.recorder.as_mut().and_then(RunRecorder::copied_scan);
            let recorded =
                copied.map_or(scan, |copied| scan.min(copied + self.companions.ahead(GRANT_AHEAD)));
            self.directives.grant(self.may_be_granted(recorded.min(held)));
        }
        for asked in self.shadows.take_asked() {
            let incarnation = self.supervisor.next_incarnation();
            let candidate = Candidate { entry: asked.entry.clone(), settings: None };
            let started = self.start_candidate(candidate, incarnation, false);
            let order = self.shadows.begin(monotonic_ns(), asked, incarnation, started);
            self.follow(order)?;
        }
        let orders = self.shadows.advance(monotonic_ns(), !self.drives());
        self.follow(orders)?;
        let Self { watches, swaps, shadows, run, settled, .. } = self;
        let swapped = swaps.plan().map(|plan| plan.new);
        watches.retain(|incarnation, _| {
            let is_candidate = swapped == Some(*incarnation)
                || shadows.incarnations().any(|(_, shadow)| shadow == *incarnation);
            if !is_candidate {
                // A process in charge has those of its role by now.
                let _ = run.domain.folder().remove(&own_settings_file(*incarnation));
                settled.push_back(*incarnation);
            }
            is_candidate
        });
        while settled.len() > MAX_SETTLED {
            let oldest = settled.pop_front();
            let _ = oldest.map(|incarnation| run.domain.folder().remove(&started_settings_file(incarnation)));
        }
        Ok(())
    }

    pub(super) fn swap_event(&mut self, event: SwapEvent) -> anyhow::Result<()> {
        let orders = self.swaps.handle(monotonic_ns(), event);
        self.follow(orders)
    }

    /// Carries out orders.
    pub(super) fn follow(&mut self, orders: impl IntoIterator<Item = Order>) -> anyhow::Result<()> {
        for order in orders {
            match order {
                Order::Authorise { role, parties, authority } => {
                    let current = &mut self.directives.current.authority[role.index()];
                    if parties.contains(&current.incarnation) && *current != authority {
                        *current = authority;
                        self.directives.forget_person();
                        self.directives.changed = true;
                        self.publish_directive()?;
                        self.authorised = self.directives.current.header.sequence;
                    }
                }
                Order::Reject(incarnation) => {
                    self.audit.samples.ended(incarnation, monotonic_ns());
                    self.fleet.dismiss(incarnation);
                }
                Order::Dismiss(incarnation) => self.fleet.dismiss(incarnation),
                Order::Promote { role, incarnation, is_restart } => {
                    if let Err(error) = change::keep(&self.run.domain, role, incarnation) {
                        let text = format!("{role}: a restart of it has its old settings: {error}");
                        self.warn(&text);
                    }
                    if let Some(pid) = self.fleet.promote(incarnation) {
                        self.handle(Event::Replaced { role, pid, incarnation, is_restart })?;
                    }
                }
                Order::Note(text) => self.note(&text),
            }
        }
        Ok(())
    }

    /// Starts a process beside the one that fills its role, records it and observes its output. With `needs_truth` a robot
    /// must publish the truth.
    ///
    /// # Errors
    /// When shared memory or a file system is full, or the command can't be started; then no such process runs.
    fn start_candidate(
        &mut self,
        candidate: Candidate,
        incarnation: u32,
        needs_truth: bool,
    ) -> Result<(), String> {
        let has_own_settings = candidate.settings.is_some();
        let started = self.try_start(candidate, incarnation, needs_truth);
        if has_own_settings && started.is_err() {
            for name in [own_settings_file(incarnation), started_settings_file(incarnation)] {
                let _ = self.run.domain.folder().remove(&name);
            }
        }
        started.map_err(|error| text_of(&error))
    }

    fn try_start(&mut self, candidate: Candidate, incarnation: u32, needs_truth: bool) -> anyhow::Result<()> {
        let Candidate { entry, settings } = candidate;
        let role = entry.role();
        if let Some(link) = &mut self.link {
            let place = (role, entry.host.as_deref());
            link.reach(&self.fleet.places().chain([place]).collect::<Vec<_>>())?;
        }
        if let Some(text) = settings {
            for name in [own_settings_file(incarnation), started_settings_file(incarnation)] {
                self.run.domain.folder().write(&name, text.as_bytes())?;
            }
        }
        let handover = self.hand_over(role);
        self.fleet.spawn_candidate(entry, incarnation, handover.as_ref())?;
        // After the start: until then the reserve holds the memory of the watch.
        let watch = RoleWatch::new(&self.bus, role, needs_truth).map_err(anyhow::Error::from);
        let begun = watch.and_then(|watch| self.write_registry().map(|()| watch));
        if begun.is_err() {
            self.fleet.dismiss(incarnation);
        }
        self.watches.insert(incarnation, begun?);
        Ok(())
    }

    /// Holds shared memory for the next process, while none starts.
    pub(super) fn keep_room(&mut self) {
        let starts = self.supervisor.processes().any(|view| view.state == VisibleState::Starting);
        if let Some(shortage) = self.fleet.keep_room(&self.bus, starts) {
            self.warn(&format!("no reserve for a swap or a restart: {shortage}"));
        }
    }

    /// The state that the process of a role leaves to its successor when it has ended, or was killed because it hung.
    pub(super) fn left_behind(&self, role: Role) -> Option<HandoverData> {
        let data = self.hand_over(role)?;
        let ended_ns = self.vitals.last_beat_ns(data.checkpoint.header.incarnation);
        Some(HandoverData { ended_ns, ..data })
    }

    /// The state that the running process of a role hands to one that starts while it drives.
    fn hand_over(&self, role: Role) -> Option<HandoverData> {
        let checkpoint = *self.vitals.checkpoint(role)?;
        let reads_actuations = role.reads().contains(&Topic::Actuation);
        let actuations = self.samples.recent_actuations().filter(|_| reads_actuations).copied().collect();
        Some(HandoverData { checkpoint, ended_ns: 0, actuations, moved_ns: 0 })
    }
}
