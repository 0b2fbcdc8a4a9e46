//! A system with one process in it, whose inputs are published by the replay.

use std::sync::Arc;

use console::exit::Failure;
use runtime::{
    ClockKind, Domain, Observer, Realtime, RunSettings, Shutdown, TopicPublishers, monotonic_ns,
    settings_file,
};
use shared_types::{Checkpoint, Fault, Phase, ProcessState, Role, Sample};
use supervision::child::Child;
use supervision::child_log::ChildLog;
use supervision::private_system::{ANSWER_NS, PrivateSystem, START_NS, poll_until};
use toml::Value;

use super::inputs::Input;
use crate::ReplayDrive;

/// The process ends by itself when the replay has been gone for so long [ns].
const ORPHAN_NS: u64 = 10_000_000_000;
/// Incarnation of the process.
const PROCESS: u32 = 1;
/// Incarnations of the roles whose samples are published: this, plus the role.
const OTHERS: u32 = 100;

/// One process, its inputs and its outputs.
pub(super) struct Bench<'a, S: Sample> {
    // Dropped in this order: the process, the ports, and last the system.
    child: Child,
    publishers: TopicPublishers,
    outputs: Observer<S>,
    log: Arc<ChildLog>,
    shutdown: &'a Shutdown,
    system: PrivateSystem,
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
        let system = PrivateSystem::create(
            // A system id has 16 letters at most.
            &format!("r{}-{}", std::process::id(), role.index()),
            drive.period_ns,
            |other| if other == role { PROCESS } else { OTHERS + other.wire() },
            |domain| write_settings(domain, drive),
        )?;
        let publishers = TopicPublishers::open(&system.domain, "replay", role.reads())?;
        let outputs = Observer::waking(&system.bus)?;
        // Its times become those of the inputs: of the orchestrator's clock.
        let now_ns = monotonic_ns();
        let saved_ns = |state: &Checkpoint| now_ns.wrapping_add_signed(-state.moved_ns());
        let fresh = |state| Checkpoint { issued_ns: now_ns, saved_ns: saved_ns(state), ..*state };
        system.hand_over(role, state.map(fresh))?;
        let log = ChildLog::open(&system.domain.directory().join("command.log"))?;
        let child = system
            .launch(role, command.iter().map(Into::into).collect(), state.is_some(), &log)
            .map_err(|error| Failure::process(format!("{role}: {error}")))?;
        let mut bench = Self { child, publishers, outputs, log, shutdown, system };
        bench.wait_for_state(role, ProcessState::Attached)?;
        bench.system.announce(Phase::Connecting)?;
        bench.wait_for_state(role, ProcessState::Connected)?;
        bench.system.announce(Phase::Driving)?;
        Ok(bench)
    }

    /// Publishes an input.
    pub(super) fn publish(&mut self, mut input: Input) -> anyhow::Result<()> {
        let (topic, sample) = (input.topic, input.bytes_mut());
        let header = (topic.sample_type().header_mut)(sample);
        header.incarnation = OTHERS + topic.writer().map_or(0, Role::wire);
        Ok(self.publishers.publish_on(topic, sample, false)?)
    }

    /// The first answer to a scan, and what is wrong with it; `None` if there is none in time.
    pub(super) fn answer(&mut self, scan_id: u64) -> anyhow::Result<Option<(S, Result<(), Fault>)>> {
        self.find(ANSWER_NS, |bench| {
            while let Some((sample, checked)) = bench.outputs.next()? {
                if sample.header().scan_id == scan_id && sample.is_answer() {
                    return Ok(Some((sample, checked)));
                }
            }
            Ok(None)
        })
    }

    /// The last log lines of the process, to be appended to a reason.
    pub(super) fn last_lines(&self) -> String {
        self.log.last_lines_suffix()
    }

    fn wait_for_state(&mut self, role: Role, state: ProcessState) -> anyhow::Result<()> {
        let reached = |bench: &Self| Ok(bench.system.has_reached(role, state).then_some(()));
        if self.find(START_NS, reached)?.is_some() {
            return Ok(());
        }
        let (limit_s, lines) = (START_NS / 1_000_000_000, self.last_lines());
        Err(Failure::process(format!(
            "{role}: the command did not report `{state}` within {limit_s} s{lines}"
        )))
    }

    /// Works until something is found, or for `limit_ns`; fails when the process has ended.
    fn find<T>(
        &mut self,
        limit_ns: u64,
        found: impl Fn(&Self) -> anyhow::Result<Option<T>>,
    ) -> anyhow::Result<Option<T>> {
        let turn = |bench: &mut Self| {
            bench.system.turn(bench.shutdown, |_| {})?;
            match bench.child.try_wait()? {
                Some(exit) => {
                    Err(Failure::process(format!("the command ended: {exit}{}", bench.last_lines())))
                }
                None => found(bench),
            }
        };
        poll_until(self, limit_ns, turn, |bench, left_ns| _ = bench.outputs.wait(left_ns))
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
