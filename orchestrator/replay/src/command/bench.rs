//! A system with one process in it, whose inputs are published by the replay.

use std::sync::Arc;

use console::exit::{Exit, Failure};
use runtime::{
    Bus, ClockKind, Domain, HandoverData, Observer, Publisher, Realtime, RunSettings, Shutdown, StopWord,
    TopicPublishers, monotonic_ns, settings_file, write_handover,
};
use shared_types::{
    Authority, Checkpoint, Directive, Fault, Heartbeat, Phase, ProcessState, Role, Sample, Topic,
};
use supervision::child::{Child, Launch};
use supervision::child_log::ChildLog;
use supervision::environment::environment_of;
use supervision::lock::{Claim, SystemLock};
use toml::Value;

use super::inputs::Input;
use crate::ReplayDrive;

/// An answer that has not come after this time does not come [ns].
const ANSWER_NS: u64 = 5_000_000_000;
/// A process that has not reached a state of the start after this time does not reach it [ns].
const START_NS: u64 = 30_000_000_000;
/// The directive is repeated this often [ns].
const REPEAT_NS: u64 = 100_000_000;
/// Longest sleep between two polls [ns].
const POLL_NS: u64 = 5_000_000;
/// The process ends by itself when the replay has been gone for so long [ns].
const ORPHAN_NS: u64 = 10_000_000_000;
/// Incarnation of the process.
const PROCESS: u32 = 1;
/// Incarnations of the roles whose samples are published: this, plus the role.
const OTHERS: u32 = 100;

/// One process, its inputs and its outputs.
pub(super) struct Bench<'a, S: Sample> {
    // Dropped in this order: the process, the ports, the bus, and last all files of the system.
    child: Child,
    publishers: TopicPublishers,
    /// The topics that the role reads, with the number of the last sample.
    inputs: Vec<(Topic, u64)>,
    outputs: Observer<S>,
    heartbeats: Observer<Heartbeat>,
    directives: Publisher<Directive>,
    directive: Directive,
    published_ns: u64,
    log: Arc<ChildLog>,
    shutdown: &'a Shutdown,
    _bus: Bus,
    _stop_word: StopWord,
    _lock: SystemLock,
}

impl<'a, S: Sample> Bench<'a, S> {
    /// Starts the process and takes it through the start barrier; `state` is what a successor is told.
    pub(super) fn start(
        role: Role,
        command: &[String],
        drive: &ReplayDrive,
        state: Option<&Checkpoint>,
        shutdown: &'a Shutdown,
    ) -> anyhow::Result<Self> {
        // A system id has 16 letters at most.
        let (domain, lock) = Claim::take_new(&format!("r{}-{}", std::process::id(), role.index()))?;
        let stop_word = StopWord::create(domain.run_id(), drive.period_ns)?;
        stop_word.hand_down()?;
        write_settings(&domain, drive)?;
        let bus = Bus::create(&domain, drive.period_ns)?;
        let mut directive =
            Directive { orchestrator_pid: u64::from(std::process::id()), ..Directive::default() };
        directive.header.incarnation = 1;
        for other in Role::ALL {
            let incarnation = if *other == role { PROCESS } else { OTHERS + other.wire() };
            directive.authority[other.index()] = Authority { incarnation, ..Authority::default() };
        }
        let publishers = TopicPublishers::open(&domain, "replay", role.reads())?;
        let inputs = role.reads().iter().map(|topic| (*topic, 0)).collect();
        let outputs = Observer::waking(&bus)?;
        let (heartbeats, directives) = (Observer::new(&bus)?, Publisher::new(&bus)?);
        // Its times become those of the inputs: of the orchestrator's clock.
        let now_ns = monotonic_ns();
        let saved_ns = |state: &Checkpoint| now_ns.wrapping_add_signed(-state.moved_ns());
        let handover = state.map(|state| HandoverData {
            checkpoint: Checkpoint { issued_ns: now_ns, saved_ns: saved_ns(state), ..*state },
            ended_ns: 0,
            actuations: Vec::new(),
            moved_ns: 0,
        });
        write_handover(&domain, role, handover.as_ref())?;
        let log = ChildLog::open(&domain.directory().join("command.log"))?;
        let environment = environment_of(&domain, &stop_word, role, PROCESS, state.is_some());
        let launch = Launch { command: command.iter().map(Into::into).collect(), environment };
        let child =
            Child::spawn(&launch, &log).map_err(|error| Failure::process(format!("{role}: {error}")))?;
        let mut bench = Self {
            child,
            publishers,
            inputs,
            outputs,
            heartbeats,
            directives,
            directive,
            published_ns: 0,
            log,
            shutdown,
            _bus: bus,
            _stop_word: stop_word,
            _lock: lock,
        };
        bench.wait_for_state(role, ProcessState::Attached)?;
        bench.announce(Phase::Connecting)?;
        bench.wait_for_state(role, ProcessState::Connected)?;
        bench.announce(Phase::Driving)?;
        Ok(bench)
    }

    /// Publishes an input.
    pub(super) fn publish(&mut self, mut input: Input) -> anyhow::Result<()> {
        let Some(index) = self.inputs.iter().position(|(topic, _)| *topic == input.topic) else {
            return Ok(());
        };
        let (topic, sequence) = &mut self.inputs[index];
        *sequence += 1;
        let sample = input.bytes_mut();
        let header = (topic.sample_type().header_mut)(sample);
        header.incarnation = OTHERS + topic.writer().map_or(0, Role::wire);
        (header.layout, header.sequence) = (topic.layout(), *sequence);
        Ok(self.publishers.publish(index, sample)?)
    }

    /// The first answer to a scan, and what is wrong with it; `None` if there is none in time.
    pub(super) fn answer(&mut self, scan_id: u64) -> anyhow::Result<Option<(S, Result<(), Fault>)>> {
        let end_ns = monotonic_ns() + ANSWER_NS;
        loop {
            self.turn()?;
            while let Some((sample, checked)) = self.outputs.next()? {
                if sample.header().scan_id == scan_id && sample.is_answer() {
                    return Ok(Some((sample, checked)));
                }
            }
            let left_ns = end_ns.saturating_sub(monotonic_ns());
            if left_ns == 0 {
                return Ok(None);
            }
            self.outputs.wait(left_ns.min(POLL_NS));
        }
    }

    /// The last log lines of the process, to be appended to a reason.
    pub(super) fn last_lines(&self) -> String {
        match self.log.last_lines(3) {
            Ok(lines) if !lines.is_empty() => format!("; its last log lines: {}", lines.join(" | ")),
            _ => String::new(),
        }
    }

    fn announce(&mut self, phase: Phase) -> anyhow::Result<()> {
        self.directive.phase = phase.wire();
        self.published_ns = 0;
        self.turn()
    }

    /// Publishes the directive when it is time; fails when the process has ended.
    fn turn(&mut self) -> anyhow::Result<()> {
        if self.shutdown.requested() {
            let message = "interrupted by a signal".to_owned();
            return Err(Failure { exit: Exit::NotReached, message }.into());
        }
        let now_ns = monotonic_ns();
        if now_ns >= self.published_ns + REPEAT_NS {
            self.directive.issued_ns = now_ns;
            self.directives.publish(&mut self.directive, self.published_ns == 0)?;
            self.published_ns = now_ns;
        }
        match self.child.try_wait()? {
            Some(exit) => Err(Failure::process(format!("the command ended: {exit}{}", self.last_lines()))),
            None => Ok(()),
        }
    }

    fn wait_for_state(&mut self, role: Role, state: ProcessState) -> anyhow::Result<()> {
        let end_ns = monotonic_ns() + START_NS;
        let mut reached = false;
        while !reached {
            self.turn()?;
            self.heartbeats.poll(|beat| reached |= beat.state >= state.wire())?;
            if !reached && monotonic_ns() > end_ns {
                let (limit_s, lines) = (START_NS / 1_000_000_000, self.last_lines());
                return Err(Failure::process(format!(
                    "{role}: the command did not report `{state}` within {limit_s} s{lines}"
                )));
            }
            self.outputs.wait(POLL_NS);
        }
        Ok(())
    }
}

/// The recorded settings, in simulated time and without the privileges of the recorded drive.
fn write_settings(domain: &Domain, drive: &ReplayDrive) -> anyhow::Result<()> {
    let run = RunSettings {
        period_ns: drive.period_ns,
        clock: ClockKind::Simulated,
        orphan_stop_ns: ORPHAN_NS,
        orphan_timeout_ns: ORPHAN_NS,
    };
    for (role, table) in drive.settings() {
        let mut table = table.clone();
        table.insert("run".to_owned(), Value::try_from(&run)?);
        table.insert("realtime".to_owned(), Value::try_from(Realtime::default())?);
        domain.folder().write(&settings_file(role), toml::to_string(&table)?.as_bytes())?;
    }
    Ok(())
}
