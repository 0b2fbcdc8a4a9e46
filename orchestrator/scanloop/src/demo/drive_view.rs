//! What the demo sees of the drive: the samples of truth and actuation, from the bus as any observer gets them.

use std::collections::BTreeSet;

use report::latency::{STAGES, attribute, reaction_ns};
use runtime::{Bus, Domain, Observer, RuntimeError};
use shared_types::{Actuation, ActuationKind, Role, Truth};

/// One actuation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Answer {
    /// The scan that it belongs to.
    pub(super) scan: u64,
    /// Whether it is the first answer to this scan.
    pub(super) answers: bool,
    /// Whether it drives.
    pub(super) drives: bool,
    /// When the front beam of its scan was taken [ns].
    pub(super) acquired_ns: u64,
    /// When it was published [ns].
    pub(super) published_ns: u64,
    /// From the scan to it [ms].
    pub(super) reaction_ms: Option<f64>,
    /// Computation and publication of each stage, in the order of [`STAGES`] [ms].
    pub(super) stages_ms: Option<[f64; STAGES.len()]>,
}

/// Observers of one system, and all that they have seen.
pub(super) struct Watch {
    truths: Observer<Truth>,
    actuations: Observer<Actuation>,
    /// Scans that were published: number, and when the front beam was taken [ns].
    pub(super) scans: Vec<(u64, u64)>,
    /// All actuations, in their order.
    pub(super) answers: Vec<Answer>,
    /// The newest state of the true robot.
    pub(super) newest: Truth,
    // Dropped last.
    _bus: Bus,
}

impl Watch {
    /// Observes from now on.
    ///
    /// # Errors
    /// [`RuntimeError`] when a topic can't be opened.
    pub(super) fn new(domain: &Domain) -> Result<Self, RuntimeError> {
        let bus = Bus::open(domain, "observer")?;
        Ok(Self {
            truths: Observer::new(&bus)?,
            actuations: Observer::new(&bus)?,
            scans: Vec::new(),
            answers: Vec::new(),
            newest: Truth::default(),
            _bus: bus,
        })
    }

    /// Takes what has come.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when receiving fails.
    pub(super) fn poll(&mut self) -> Result<(), RuntimeError> {
        let Self { truths, actuations, scans, answers, newest, .. } = self;
        truths.poll(|truth| {
            *newest = *truth;
            // A candidate publishes the same scans.
            if scans.last().is_none_or(|(scan, _)| *scan < truth.header.scan_id) {
                scans.push((truth.header.scan_id, truth.header.acquired_ns));
            }
        })?;
        actuations.poll(|actuation| answers.push(Answer::of(actuation)))?;
        Ok(())
    }

    /// Numbers of the scans taken in a time that have no answer; the answers must have arrived.
    pub(super) fn unanswered(&self, from_ns: u64, until_ns: u64) -> usize {
        let answered: BTreeSet<u64> =
            self.answers.iter().filter(|answer| answer.answers).map(|answer| answer.scan).collect();
        let in_time = self.scans.iter().filter(|(_, at_ns)| (from_ns..until_ns).contains(at_ns));
        in_time.filter(|(scan, _)| !answered.contains(scan)).count()
    }

    /// The answers to scans taken in a time.
    pub(super) fn answers_in(&self, from_ns: u64, until_ns: u64) -> impl Iterator<Item = &Answer> {
        let is_in = move |answer: &&Answer| (from_ns..until_ns).contains(&answer.acquired_ns);
        self.answers.iter().filter(|answer| answer.answers).filter(is_in)
    }

    /// When the first answer that drives was published, to a scan taken after a time [ns].
    pub(super) fn drives_after(&self, from_ns: u64) -> Option<u64> {
        self.answers_in(from_ns, u64::MAX).find(|answer| answer.drives).map(|answer| answer.published_ns)
    }

    /// Whether the wheels were blocked by an actuation published in a time.
    pub(super) fn blocks(&self, from_ns: u64, until_ns: u64) -> usize {
        let is_in = |answer: &&Answer| (from_ns..until_ns).contains(&answer.published_ns);
        self.answers.iter().filter(is_in).filter(|answer| !answer.drives).count()
    }
}

impl Answer {
    fn of(actuation: &Actuation) -> Self {
        let header = &actuation.header;
        let stages = attribute(header).ok().map(|attribution| attribution.stages);
        Self {
            scan: header.scan_id,
            answers: actuation.answers == 1,
            drives: actuation.kind == ActuationKind::Drive.wire(),
            acquired_ns: header.acquired_ns,
            published_ns: header.stage(Role::Actuator).published_ns,
            reaction_ms: reaction_ns(header).map(|ns| ns as f64 * 1e-6),
            stages_ms: stages.map(|all| all.map(|of| (of.compute_ns + of.publish_ns) as f64 * 1e-6)),
        }
    }
}

/// The median; `None` without values.
pub(super) fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
