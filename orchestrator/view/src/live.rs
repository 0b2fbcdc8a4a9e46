//! A running system as a source: observers of its topics, its status, and the course.
//!
//! The system may not run yet, may end, and may start again: then its run id is another one, and all is opened anew. A
//! death of the orchestrator or of a process changes nothing here.

use std::collections::VecDeque;

use report::latency::Latencies;
use runtime::{Bus, Domain, Observer, RuntimeError, monotonic_ns};
use serde_json::{Value, json};
use shared_types::{Actuation, Command, Directive, Header, Obstacles, Pose, Sample, Scan, Topic, Truth};

use crate::actions::Verb;
use crate::course::course;
use crate::events::Events;
use crate::frame::Samples;
use crate::source::{Source, Update};
use crate::statuses::{Known, Statuses};

/// Least time between two frames [s].
const FRAME_S: f64 = 0.1;
/// A frame may come this much earlier, so that scans at 10 Hz have one each [s].
const EARLY_S: f64 = 0.03;
/// A scan that is not answered is shown after this time [s].
const UNANSWERED_S: f64 = 0.15;
/// Time between two states of the system [s].
const SYSTEM_S: f64 = 0.5;
/// Time between two tries to open the bus, and between two checks that the run is still there [s].
const RETRY_S: f64 = 0.25;
/// Percentiles are those of so many scans: a minute at 10 Hz.
const CHAINS: usize = 600;

/// The running system of one id, whenever there is one.
pub(crate) struct Live {
    system_id: String,
    verbs: Vec<Verb>,
    statuses: Statuses,
    attached: Option<Attached>,
    had_one: bool,
    events: Events,
    answers: u64,
    frames: u64,
    next_frame_s: f64,
    next_system_s: f64,
    next_try_s: f64,
}

impl Live {
    /// Waits for a system of that id.
    ///
    /// # Errors
    /// A thread that can't be started.
    pub(crate) fn new(system_id: &str, verbs: Vec<Verb>) -> anyhow::Result<Self> {
        Ok(Self {
            system_id: system_id.to_owned(),
            verbs,
            statuses: Statuses::start(system_id)?,
            attached: None,
            had_one: false,
            events: Events::default(),
            answers: 0,
            frames: 0,
            next_frame_s: 0.0,
            next_system_s: 0.0,
            next_try_s: 0.0,
        })
    }

    /// Opens the bus of a new run, and closes that of one that is over.
    fn follow(&mut self, known: &Known, now_s: f64) {
        if now_s < self.next_try_s {
            return;
        }
        self.next_try_s = now_s + RETRY_S;
        if self.attached.as_ref().is_some_and(|attached| !attached.domain.is_current()) {
            self.attached = None;
            self.events.end();
            self.next_system_s = now_s;
        }
        let Some(domain) = known.domain.as_ref().filter(|_| self.attached.is_none()) else { return };
        // A run that starts has not created its topics yet: the next try finds them.
        if let Ok(attached) = Attached::open(domain) {
            self.attached = Some(attached);
            self.events.start(&self.system_id);
            self.next_system_s = now_s;
        }
    }

    /// A directory that a dead run left behind is no system: one that lives answers or publishes.
    fn connection(&mut self, known: &Known) -> &'static str {
        let is_alive = |attached: &Attached| known.status.is_some() || attached.samples.newest_scan() > 0;
        let is_live = self.attached.as_ref().is_some_and(is_alive);
        self.had_one |= is_live;
        match (is_live, self.had_one) {
            (true, _) => "live",
            (false, true) => "over",
            (false, false) => "waiting",
        }
    }

    fn system(&mut self, known: &Known, now_s: f64) -> String {
        let connection = self.connection(known);
        if let Some(attached) = self.attached.as_mut().filter(|attached| attached.course.is_null()) {
            attached.course = course(&attached.domain);
        }
        let attached = self.attached.as_ref();
        let status = known.status.as_ref().filter(|_| attached.is_some());
        let age_s = status.map(|_| (monotonic_ns().saturating_sub(known.answered_ns)) as f64 * 1e-9);
        json!({
            "time_s": now_s,
            "connection": connection,
            "system_id": self.system_id,
            "run_id": attached.map(|attached| attached.domain.run_id()),
            "status": status,
            "status_age_s": age_s,
            "course": attached.map(|attached| &attached.course),
            "authority": attached.map(Attached::authority),
            "latency_us": attached.and_then(Attached::latency),
            "actions": self.verbs.iter().map(|verb| verb.name()).collect::<Vec<_>>(),
        })
        .to_string()
    }
}

impl Source for Live {
    fn poll(&mut self, now_s: f64) -> Update {
        let known = self.statuses.known();
        self.events.set_time(now_s);
        self.follow(&known, now_s);
        let mut update = Update::default();
        if let Some(attached) = &mut self.attached {
            if let Some(status) = known.status.as_ref().filter(|_| known.answers != self.answers) {
                self.answers = known.answers;
                attached.samples.simulated = status.lockstep;
                self.events.status(status);
            }
            if attached.receive(&mut self.events, now_s).is_err() {
                self.attached = None;
            } else if now_s >= self.next_frame_s - EARLY_S && attached.is_due(now_s) {
                self.frames += 1;
                self.next_frame_s = (self.next_frame_s + FRAME_S).max(now_s);
                update.frame = Some(attached.frame(self.frames, now_s));
            }
        }
        if now_s >= self.next_system_s {
            self.next_system_s = now_s + SYSTEM_S;
            update.system = Some(self.system(&known, now_s));
        }
        update.events = self.events.take();
        update
    }
}

/// The observers of one run.
struct Attached {
    domain: Domain,
    course: Value,
    samples: Samples,
    directive: Directive,
    /// Headers of the newest actuations.
    chains: VecDeque<Header>,
    /// When the newest scan came that no frame shows yet [s].
    scan_came_s: Option<f64>,
    has_actuation: bool,
    directives: Observer<Directive>,
    scans: Observer<Scan>,
    poses: Observer<Pose>,
    obstacles: Observer<Obstacles>,
    commands: Observer<Command>,
    actuations: Observer<Actuation>,
    truths: Observer<Truth>,
    /// Dropped after its observers.
    _bus: Bus,
}

impl Attached {
    fn open(domain: &Domain) -> Result<Self, RuntimeError> {
        let bus = Bus::open(domain, "view")?;
        Ok(Self {
            directives: Observer::new(&bus)?,
            scans: Observer::new(&bus)?,
            poses: Observer::new(&bus)?,
            obstacles: Observer::new(&bus)?,
            commands: Observer::new(&bus)?,
            actuations: Observer::new(&bus)?,
            truths: Observer::new(&bus)?,
            _bus: bus,
            domain: domain.clone(),
            course: Value::Null,
            samples: Samples::default(),
            directive: Directive::default(),
            chains: VecDeque::with_capacity(CHAINS),
            scan_came_s: None,
            has_actuation: false,
        })
    }

    /// Takes all samples that have come. Samples of processes that are not in charge are ignored.
    fn receive(&mut self, events: &mut Events, now_s: f64) -> Result<(), RuntimeError> {
        let Self { directive, samples, chains, has_actuation, .. } = self;
        let newest = samples.newest_scan();
        self.directives.poll(|new| {
            events.directive(new);
            *directive = *new;
        })?;
        keep(&self.scans, directive, &mut samples.scan, |_| {})?;
        keep(&self.poses, directive, &mut samples.pose, |_| {})?;
        keep(&self.obstacles, directive, &mut samples.obstacles, |new| events.obstacles(new))?;
        keep(&self.commands, directive, &mut samples.command, |_| {})?;
        self.truths.poll(|new| samples.truth = Some(*new))?;
        let unknown = Command::default();
        self.actuations.poll(|new| {
            if directive.counts(Topic::Actuation, &new.header) {
                events.actuation(new, samples.command.as_deref().unwrap_or(&unknown));
                samples.act(new);
                *has_actuation = true;
                if new.answers == 1 {
                    if chains.len() == CHAINS {
                        chains.pop_front();
                    }
                    chains.push_back(new.header);
                }
            }
        })?;
        if self.samples.newest_scan() != newest || self.has_actuation {
            self.scan_came_s.get_or_insert(now_s);
        }
        Ok(())
    }

    /// Whether there is something new to show, and the chain of the newest scan is complete or late.
    fn is_due(&self, now_s: f64) -> bool {
        self.scan_came_s.is_some_and(|came_s| self.samples.is_whole() || now_s - came_s > UNANSWERED_S)
    }

    fn frame(&mut self, number: u64, now_s: f64) -> crate::history::Stored {
        let frame = self.samples.frame(number, now_s);
        (self.scan_came_s, self.has_actuation, self.samples.reaction_ns) = (None, false, None);
        frame
    }

    /// The incarnations in charge, in the order of the roles.
    fn authority(&self) -> Vec<u32> {
        self.directive.authority.iter().map(|authority| authority.incarnation).collect()
    }

    /// The figures of the newest scans, as in `report.json`; `None` in simulated time.
    fn latency(&self) -> Option<Value> {
        if self.samples.simulated || self.chains.is_empty() {
            return None;
        }
        let mut latencies = Latencies::new(false);
        self.chains.iter().for_each(|header| latencies.record(header));
        serde_json::to_value(latencies.report()).ok()
    }
}

/// Keeps the newest sample of the process in charge.
fn keep<S: Sample>(
    observer: &Observer<S>,
    directive: &Directive,
    place: &mut Option<Box<S>>,
    mut each: impl FnMut(&S),
) -> Result<(), RuntimeError> {
    observer.poll(|new| {
        if directive.counts(S::TOPIC, new.header()) {
            each(new);
            match place {
                Some(place) => **place = *new,
                None => *place = Some(Box::new(*new)),
            }
        }
    })?;
    Ok(())
}
