//! The state of each process by its heartbeats and checkpoints, for the supervisor and for `status`.

use std::collections::{BTreeMap, VecDeque};

use audit::ledger::SampleAudit;
use runtime::{Bus, Observer, RuntimeError, monotonic_ns};
use shared_types::{Checkpoint, Device, Heartbeat, ProcessState, Role};
use supervision::supervisor::{Event, VisibleState};

use crate::control::ProcessStatus;

/// Rates are averages over this time [ns].
const RATE_WINDOW_NS: u64 = 2_000_000_000;

/// Heartbeats of a process that are stored: ten a second, and those at changes of its state.
const MAX_BEATS: usize = 64;

/// A process whose last heartbeat is older than this is forgotten when another starts [ns].
const FORGET_NS: u64 = 10_000_000_000;

/// Heartbeats and checkpoints of all processes.
pub(crate) struct Vitals {
    heartbeats: Observer<Heartbeat>,
    checkpoints: Observer<Checkpoint>,
    newest: BTreeMap<Role, Checkpoint>,
    pulses: BTreeMap<u32, Pulse>,
}

#[derive(Default)]
struct Pulse {
    beat_ns: u64,
    activations: u64,
    published: VecDeque<(u64, u64)>,
    newest_output_ns: u64,
    scan: u64,
    obeys_stop: bool,
    device: Device,
}

impl Vitals {
    /// Starts to receive.
    pub(crate) fn new(bus: &Bus) -> Result<Self, RuntimeError> {
        Ok(Self {
            heartbeats: Observer::new(bus)?,
            checkpoints: Observer::new(bus)?,
            newest: BTreeMap::new(),
            pulses: BTreeMap::new(),
        })
    }

    /// Takes heartbeats and checkpoints; hands events for the supervisor to `each`, and counters to the sample audit.
    ///
    /// No successor resumes from the state of the incarnations `not_in_charge`.
    pub(crate) fn poll(
        &mut self,
        not_in_charge: &[u32],
        sample_audit: &mut SampleAudit,
        mut each: impl FnMut(Event),
    ) -> Result<(), RuntimeError> {
        let newest = &mut self.newest;
        self.checkpoints.poll(|checkpoint| {
            if let Ok(role) = Role::try_from(checkpoint.role)
                && !not_in_charge.contains(&checkpoint.header.incarnation)
            {
                newest.insert(role, *checkpoint);
            }
        })?;
        let pulses = &mut self.pulses;
        self.heartbeats.poll(|heartbeat| {
            let (Ok(role), Ok(state)) =
                (Role::try_from(heartbeat.role), ProcessState::try_from(heartbeat.state))
            else {
                return;
            };
            sample_audit.receive(heartbeat, monotonic_ns());
            let incarnation = heartbeat.header.incarnation;
            if !pulses.contains_key(&incarnation) {
                pulses.retain(|_, pulse| heartbeat.issued_ns.saturating_sub(pulse.beat_ns) < FORGET_NS);
            }
            let pulse = pulses.entry(incarnation).or_default();
            if state == ProcessState::Ending {
                return;
            }
            each(Event::StateReported { role, incarnation, state });
            if heartbeat.device != pulse.device {
                let text = format!("{}: {}", heartbeat.device.state().name(), heartbeat.device.reason());
                each(Event::DeviceReported { role, incarnation, text });
            }
            if heartbeat.activations != pulse.activations {
                pulse.activations = heartbeat.activations;
                each(Event::Progress { role, incarnation });
            }
            pulse.beat(heartbeat, monotonic_ns());
        })?;
        Ok(())
    }

    /// The newest state of a role.
    pub(crate) fn checkpoint(&self, role: Role) -> Option<&Checkpoint> {
        self.newest.get(&role)
    }

    /// When an incarnation was last known to work, by its heartbeats [ns]; 0 when it is not known.
    pub(crate) fn last_beat_ns(&self, incarnation: u32) -> u64 {
        self.pulses.get(&incarnation).map_or(0, |pulse| pulse.beat_ns)
    }

    /// The last scan that an incarnation is known to have worked on.
    pub(crate) fn scan_of(&self, incarnation: u32) -> u64 {
        self.pulses.get(&incarnation).map_or(0, |pulse| pulse.scan)
    }

    /// Whether an incarnation sees the stop word, by its heartbeats; without one it is assumed.
    fn obeys_stop(&self, incarnation: u32) -> bool {
        self.pulses.get(&incarnation).is_none_or(|pulse| pulse.obeys_stop)
    }

    /// The row of a process in `status`, with the figures of its heartbeats; all else is empty.
    pub(crate) fn row(&self, role: Role, state: VisibleState, incarnation: u32) -> ProcessStatus {
        let (rate_hz, last_sample_age_ms) = self.rate_and_age(incarnation);
        let obeys_stop = self.obeys_stop(incarnation);
        let mut row =
            ProcessStatus { rate_hz, last_sample_age_ms, obeys_stop, ..ProcessStatus::new(role, state) };
        if let Some(pulse) = self.pulses.get(&incarnation) {
            row.set_device(&pulse.device, monotonic_ns());
        }
        row
    }

    /// Outputs per second of an incarnation, and the age of its newest output [ms].
    fn rate_and_age(&self, incarnation: u32) -> (f64, f64) {
        let Some(pulse) = self.pulses.get(&incarnation) else { return (0.0, 0.0) };
        let age_ms = if pulse.newest_output_ns == 0 {
            0.0
        } else {
            monotonic_ns().saturating_sub(pulse.newest_output_ns) as f64 * 1e-6
        };
        let (Some(first), Some(last)) = (pulse.published.front(), pulse.published.back()) else {
            return (0.0, age_ms);
        };
        let elapsed_s = last.0.saturating_sub(first.0) as f64 * 1e-9;
        let rate = if elapsed_s > 0.0 { last.1.saturating_sub(first.1) as f64 / elapsed_s } else { 0.0 };
        (rate, age_ms)
    }
}

impl Pulse {
    fn beat(&mut self, heartbeat: &Heartbeat, arrived_ns: u64) {
        let (now, published) = (heartbeat.issued_ns.min(arrived_ns), heartbeat.published);
        if self.published.back().is_none_or(|(_, before)| published > *before) {
            self.newest_output_ns = now;
        }
        self.beat_ns = now;
        self.obeys_stop = heartbeat.obeys_stop == 1;
        self.device = heartbeat.device;
        self.scan = heartbeat.header.scan_id;
        self.published.push_back((now, published));
        let is_over = |(then, _): &(u64, u64)| now.saturating_sub(*then) > RATE_WINDOW_NS;
        while self.published.len() > MAX_BEATS || self.published.front().is_some_and(is_over) {
            self.published.pop_front();
        }
    }
}
