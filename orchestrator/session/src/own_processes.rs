//! The companions of a run and the topics that they write, as the session sees them.

use std::collections::VecDeque;
use std::os::fd::BorrowedFd;
use std::path::Path;

use audit::digest::Digests;
use audit::ledger::{CompanionLedger, DelayRow, LedgerRow};
use handover::swap::Certificate;
use plan::Plan;
use report::CompanionReport;
use runtime::{Bus, Domain, OwnObserver, OwnTopics, PortCount, PortTable, RuntimeError, StopWord};
use rustix::io::Errno;
use rustix::process::{Pid, test_kill_process};
use shared_types::{Authority, Header, ProcessState};
use supervision::entry::ProcessEntry;
use supervision::fleet::companions::{CompanionEvent, CompanionView, Companions};

use crate::companion_swaps::CompanionSwaps;

/// A queue of this many samples takes all that a companion may publish before it is polled: two are on their way.
const SPARE: usize = 2;

/// Companions and topics of a run; empty without them.
pub(crate) struct OwnProcesses {
    companions: Option<Companions>,
    /// In lock-step: topics whose samples are part of the digests.
    streams: Vec<Stream>,
    /// The shortest queue of all topics: grants go no further ahead.
    queue: u64,
    ports: Option<Ports>,
    swaps: CompanionSwaps,
}

/// What the processes count of these topics, and its sums.
struct Ports {
    table: OwnTopics,
    counts: PortTable,
    ledger: CompanionLedger,
}

/// One topic in lock-step: the samples of scans that are not recorded yet wait.
struct Stream {
    topic: String,
    writer: String,
    observer: OwnObserver,
    waiting: VecDeque<Vec<u8>>,
}

impl OwnProcesses {
    /// The companions of a plan, none started yet. `generation` numbers the orchestrators of a run.
    ///
    /// # Errors
    /// Errors of the bus, and a page or a log that can't be opened.
    pub(crate) fn new(
        bus: &Bus,
        domain: &Domain,
        stop_word: &StopWord,
        plan: &Plan,
        lockstep: bool,
        generation: u32,
        out: &Path,
    ) -> anyhow::Result<Self> {
        let entries: Vec<ProcessEntry> = plan.system.companions().cloned().collect();
        let table = &plan.own_topics;
        if entries.is_empty() && table.topic.is_empty() {
            let swaps = CompanionSwaps::default();
            return Ok(Self { companions: None, streams: Vec::new(), queue: u64::MAX, ports: None, swaps });
        }
        let period_ns = plan.system.period_ns();
        let counts = PortTable::create(domain)?;
        counts.free(has_ended);
        let ports = Ports { table: table.clone(), counts, ledger: CompanionLedger::default() };
        let companions =
            Companions::new(domain, stop_word, &entries, period_ns, lockstep, generation, &out.join("logs"))?;
        let is_digested =
            |writer: &str| entries.iter().any(|entry| entry.name() == writer && entry.is_in_lockstep());
        let mut streams = Vec::new();
        for row in table.topic.iter().filter(|row| lockstep && is_digested(&row.writer)) {
            let observer = OwnObserver::new(bus, table, &row.name)?;
            let (topic, writer) = (row.name.clone(), row.writer.clone());
            streams.push(Stream { topic, writer, observer, waiting: VecDeque::new() });
        }
        let queue = table.topic.iter().map(|row| row.queue.saturating_sub(SPARE).max(1)).min();
        Ok(Self {
            companions: Some(companions),
            streams,
            queue: queue.map_or(u64::MAX, |queue| queue as u64),
            ports: Some(ports),
            swaps: CompanionSwaps::default(),
        })
    }

    /// Tells companions the phase, and whose samples of the loop count.
    pub(crate) fn announce(&self, phase: u32, authority: &[Authority]) {
        if let Some(companions) = &self.companions {
            companions.announce(phase, authority);
        }
        self.streams.iter().for_each(|stream| stream.observer.connect());
    }

    /// Starts, reaps and judges companions; returns what has happened, and the certificates of swaps that have ended.
    ///
    /// # Errors
    /// Errors of the bus.
    pub(crate) fn advance(
        &mut self,
        recorded_scan: u64,
        newest_scan: u64,
    ) -> Result<(Vec<CompanionEvent>, Vec<Certificate>), RuntimeError> {
        let Self { companions, swaps, .. } = self;
        let Some(companions) = companions else { return Ok((Vec::new(), Vec::new())) };
        let before = swaps.certificates().len();
        swaps.advance(companions)?;
        let events = companions.advance(recorded_scan, newest_scan);
        events.iter().for_each(|event| _ = swaps.note(event));
        Ok((events, swaps.certificates()[before..].to_vec()))
    }

    /// Adds the samples of recorded scans to the digests.
    ///
    /// # Errors
    /// Errors of the bus.
    pub(crate) fn digest(&mut self, recorded_scan: u64, digests: &mut Digests) -> Result<(), RuntimeError> {
        let Self { companions, streams, .. } = self;
        for Stream { topic, writer, observer, waiting } in streams {
            let counts = |sample: &[u8]| {
                let header = bytemuck::pod_read_unaligned(&sample[..size_of::<Header>()]);
                companions.as_ref().is_some_and(|companions| companions.counts(writer, &header))
            };
            while let Some(sample) = observer.next()? {
                if counts(&sample) {
                    waiting.push_back(sample);
                }
            }
            while waiting.front().is_some_and(|sample| scan_of(sample) <= recorded_scan) {
                if let Some(sample) = waiting.pop_front() {
                    digests.add_bytes(topic, observer.own_type().fields(), &sample);
                }
            }
        }
        Ok(())
    }

    /// Whether all companions that the start waits for report this state or a later one.
    pub(crate) fn have_reached(&self, state: ProcessState) -> bool {
        self.companions.as_ref().is_none_or(|companions| companions.have_reached(state))
    }

    /// In lock-step, the newest scan that companions allow the robot to publish.
    pub(crate) fn granted_scan(&self, ahead: u64) -> u64 {
        let answered = self.companions.as_ref().and_then(Companions::answered_scan);
        answered.map_or(u64::MAX, |scan| scan.saturating_add(self.ahead(ahead)))
    }

    /// So many scans may lie between what is granted and what a reader has taken, `ahead` at most.
    pub(crate) fn ahead(&self, ahead: u64) -> u64 {
        ahead.min(self.queue)
    }

    /// Whether lock-step waits for a companion that has not answered a scan.
    pub(crate) fn delays(&self, scan: u64) -> bool {
        self.companions.as_ref().and_then(Companions::answered_scan).is_some_and(|answered| answered < scan)
    }

    /// Replaces a companion, by a new process of its command when there is none; the number of the swap, or none when
    /// no old process runs.
    ///
    /// # Errors
    /// Why it can't be replaced.
    pub(crate) fn replace(
        &mut self,
        domain: &Domain,
        name: &str,
        command: Option<&[String]>,
        shadow_scans: u64,
    ) -> Result<Option<u64>, String> {
        let Self { companions: Some(companions), ports: Some(ports), swaps, .. } = self else {
            return Err("the system has no companions".to_owned());
        };
        swaps.begin(companions, domain, &ports.table, name, command, shadow_scans)
    }

    /// The swaps of companions.
    pub(crate) fn swaps(&self) -> &CompanionSwaps {
        &self.swaps
    }

    /// Descriptors that become readable when a companion ends.
    pub(crate) fn descriptors(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        self.companions.iter().flat_map(Companions::descriptors)
    }

    /// The companions as they are now.
    pub(crate) fn views(&mut self) -> Vec<CompanionView> {
        self.companions.as_mut().map_or_else(Vec::new, Companions::views)
    }

    /// Their rows in the report, as of the end of the run.
    pub(crate) fn reports(&mut self) -> Vec<CompanionReport> {
        let row = |view: CompanionView| CompanionReport {
            name: view.name,
            command: view.command,
            restarts: view.restarts,
            state: view.state.name().to_owned(),
            taken: view.report.taken,
            answered: view.report.answered,
            published: view.report.published,
            invalid: view.report.invalid,
            foreign: view.report.foreign,
            missed: view.report.missed,
            left_lockstep_at_scan: view.left_at_scan,
        };
        self.views().into_iter().map(row).collect()
    }

    /// Takes what all processes have counted; returns what readers have dropped for a new reason, as text. A process that
    /// ends while the system `drives` has died.
    pub(crate) fn reconcile(&mut self, drives: bool) -> Vec<String> {
        let Some(Ports { table, counts, ledger }) = &mut self.ports else { return Vec::new() };
        ledger.update(&counts.counts(), |count| drives && has_ended(count));
        if drives {
            counts.free(has_ended);
        }
        ledger.new_drops(table)
    }

    /// What became of the samples beside the loop, and their delays in real time.
    pub(crate) fn ledger(&self) -> (Vec<LedgerRow>, Vec<DelayRow>) {
        let rows = |ports: &Ports| (ports.ledger.rows(&ports.table), ports.ledger.delays(&ports.table));
        self.ports.as_ref().map(rows).unwrap_or_default()
    }

    /// Asks all companions to end.
    pub(crate) fn end(&mut self) {
        self.companions.iter_mut().for_each(Companions::end);
    }

    /// Whether all have ended.
    pub(crate) fn have_ended(&mut self) -> bool {
        self.companions.as_mut().is_none_or(Companions::have_ended)
    }
}

/// Delays that the running processes of a system have measured on topics beside the loop since each was started.
///
/// # Errors
/// A table of the system that can't be read.
pub fn companion_delays(domain: &Domain) -> anyhow::Result<Vec<DelayRow>> {
    let Some(table) = OwnTopics::of(domain)? else { return Ok(Vec::new()) };
    let mut ledger = CompanionLedger::default();
    ledger.update(&PortTable::open(domain)?.counts(), |_| false);
    Ok(ledger.delays(&table))
}

/// Whether the process of a port has ended.
fn has_ended(count: &PortCount) -> bool {
    let pid = Pid::from_raw(count.pid.cast_signed());
    pid.is_none_or(|pid| test_kill_process(pid) == Err(Errno::SRCH))
}

fn scan_of(sample: &[u8]) -> u64 {
    bytemuck::pod_read_unaligned::<Header>(&sample[..size_of::<Header>()]).scan_id
}
