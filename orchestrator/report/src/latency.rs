//! Where the time between a scan and its actuation goes, from the header of the actuation alone.
//!
//! Each sample carries the stamps of all stages before it, so one actuation that answers a scan holds the whole
//! way: robot -> estimator -> obstacles -> controller -> actuator. The obstacles need the pose, so the five stages
//! run one after the other: this chain is the critical path. For a stage on it
//!
//! * **hop** is the time from the publication of its predecessor until it has taken its inputs,
//! * **compute** is the time from then until its result is computed,
//! * **publish** is the time from then until its sample is published,
//! * **wait** is the time it was awake with a part of its inputs before its predecessor published; it overlaps with
//!   the work of the predecessor and is not part of the path.
//!
//! Reaction time = sum of all hops, computes and publications, exactly, in nanoseconds. *Transport* is the
//! reaction time minus all compute: hops and publications, the cost of five processes over one.
//!
//! This holds for stamps of one clock. In lock-step the clock is simulated, so only complete chains are counted. An
//! answer with an incomplete chain (a controller that acted without obstacles) counts in reaction time and data age,
//! but not in the stages; so slow cases are never left out.

use figures::Distribution;
use shared_types::{Header, Role, StageStamps};

use crate::report::{LatencyReport, PerStage, Stages};

/// The stages that answer a scan, in the order of the critical path.
pub const STAGES: [Role; 4] = [Role::Estimator, Role::Obstacles, Role::Controller, Role::Actuator];

/// Times of one stage on the way of one scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StageTimes {
    /// From the publication of the predecessor until all inputs were taken [ns].
    pub hop_ns: u64,
    /// Awake before the predecessor published, not on the critical path [ns].
    pub wait_ns: u64,
    /// From the inputs taken until the result was computed [ns].
    pub compute_ns: u64,
    /// From the result until it was published [ns].
    pub publish_ns: u64,
}

/// Where the time of one scan went.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Attribution {
    /// From the publication of the scan to the publication of its actuation [ns].
    pub reaction_ns: u64,
    /// Reaction time minus all compute on the critical path [ns].
    pub transport_ns: u64,
    /// Times per stage, in the order of [`STAGES`].
    pub stages: [StageTimes; STAGES.len()],
}

/// No scan is older when it is answered: a process that stands still for so long was replaced, or its run has ended [ns].
const MAX_AGE_NS: u64 = 60_000_000_000;

/// Why a chain can't be attributed to stages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Incomplete {
    /// A stage has no stamps.
    #[error("{0} left no stamps")]
    Missing(Role),
    /// A stamp lies before the one it must follow.
    #[error("stamps of {0} run backwards")]
    Backwards(Role),
    /// A stamp lies longer before the answer than any scan is on its way.
    #[error("a stamp of {0} lies too far back")]
    TooOld(Role),
}

/// Attributes the reaction time of an answer to its stages.
///
/// # Errors
/// [`Incomplete`] when a stage lacks a stamp, or stamps run backwards.
pub fn attribute(header: &Header) -> Result<Attribution, Incomplete> {
    let scan_published_ns = header.scan_published_ns();
    if scan_published_ns == 0 {
        return Err(Incomplete::Missing(Role::Robot));
    }
    require_recent(header)?;
    let mut stages = [StageTimes::default(); STAGES.len()];
    let mut previous_ns = scan_published_ns;
    for (role, times) in STAGES.into_iter().zip(&mut stages) {
        *times = stage_times(role, header.stage(role), previous_ns)?;
        previous_ns = header.stage(role).published_ns;
    }
    let reaction_ns = previous_ns - scan_published_ns;
    let compute_ns: u64 = stages.iter().map(|times| times.compute_ns).sum();
    Ok(Attribution { reaction_ns, transport_ns: reaction_ns - compute_ns, stages })
}

/// Passes when no stamp lies further back than a scan may be old.
fn require_recent(header: &Header) -> Result<(), Incomplete> {
    let oldest_ns = header.stage(Role::Actuator).published_ns.saturating_sub(MAX_AGE_NS);
    let of_stages = Role::ALL.iter().flat_map(|role| {
        let StageStamps { woken_ns, taken_ns, computed_ns, published_ns } = *header.stage(*role);
        [woken_ns, taken_ns, computed_ns, published_ns].map(|stamp_ns| (*role, stamp_ns))
    });
    // Zero is a stamp that is missing.
    let mut old = of_stages.filter(|(_, stamp_ns)| *stamp_ns > 0 && *stamp_ns < oldest_ns);
    match old.next() {
        Some((role, _)) => Err(Incomplete::TooOld(role)),
        None if header.acquired_ns < oldest_ns => Err(Incomplete::TooOld(Role::Robot)),
        None => Ok(()),
    }
}

/// From the publication of the scan to that of its actuation [ns]; `None` when a stamp is missing, runs backwards or lies too far
/// back.
pub fn reaction_ns(header: &Header) -> Option<u64> {
    since(header.scan_published_ns(), header.stage(Role::Actuator).published_ns)
}

/// From the front beam of the scan to the publication of its actuation [ns]; `None` as for [`reaction_ns`].
pub fn data_age_ns(header: &Header) -> Option<u64> {
    // The first front beam of a run may be at zero, so the acquisition has no mark for "missing".
    let published_ns = header.stage(Role::Actuator).published_ns;
    let age_ns = if published_ns == 0 { None } else { published_ns.checked_sub(header.acquired_ns) };
    age_ns.filter(|age_ns| *age_ns <= MAX_AGE_NS)
}

/// Distributions of all these times over a run.
#[derive(Debug, Clone)]
pub struct Latencies {
    simulated: bool,
    complete: u64,
    incomplete: u64,
    reaction: Distribution,
    data_age: Distribution,
    transport: Distribution,
    stages: [StageDistributions; STAGES.len()],
}

#[derive(Debug, Clone)]
struct StageDistributions {
    hop: Distribution,
    wait: Distribution,
    compute: Distribution,
    publish: Distribution,
}

impl Latencies {
    /// Empty distributions. With `simulated` stamps only chains are counted.
    pub fn new(simulated: bool) -> Self {
        let stage = || StageDistributions {
            hop: Distribution::of_times(),
            wait: Distribution::of_times(),
            compute: Distribution::of_times(),
            publish: Distribution::of_times(),
        };
        Self {
            simulated,
            complete: 0,
            incomplete: 0,
            reaction: Distribution::of_times(),
            data_age: Distribution::of_times(),
            transport: Distribution::of_times(),
            stages: [stage(), stage(), stage(), stage()],
        }
    }

    /// Records the way of one actuation that answers a scan.
    pub fn record(&mut self, header: &Header) {
        let attribution = attribute(header);
        *if attribution.is_ok() { &mut self.complete } else { &mut self.incomplete } += 1;
        if self.simulated {
            return;
        }
        if let Some(reaction_ns) = reaction_ns(header) {
            self.reaction.record(reaction_ns);
        }
        if let Some(data_age_ns) = data_age_ns(header) {
            self.data_age.record(data_age_ns);
        }
        if let Ok(attribution) = attribution {
            self.record_attribution(&attribution);
        }
    }

    fn record_attribution(&mut self, attribution: &Attribution) {
        self.transport.record(attribution.transport_ns);
        for (stage, times) in self.stages.iter_mut().zip(&attribution.stages) {
            stage.hop.record(times.hop_ns);
            stage.wait.record(times.wait_ns);
            stage.compute.record(times.compute_ns);
            stage.publish.record(times.publish_ns);
        }
    }

    /// The figures of everything recorded so far.
    pub fn report(&self) -> LatencyReport {
        let per_stage = |pick: fn(&StageDistributions) -> &Distribution| {
            let [estimator, obstacles, controller, actuator] =
                self.stages.each_ref().map(|stage| pick(stage).figures());
            PerStage { estimator, obstacles, controller, actuator }
        };
        LatencyReport {
            scan_to_actuation: self.reaction.figures(),
            data_age: self.data_age.figures(),
            stages: Stages {
                compute: per_stage(|stage| &stage.compute),
                transport: self.transport.figures(),
            },
            hops: per_stage(|stage| &stage.hop),
            waits: per_stage(|stage| &stage.wait),
            publications: per_stage(|stage| &stage.publish),
            simulated: self.simulated,
            complete_chains: self.complete,
            incomplete_chains: self.incomplete,
            companions: Vec::new(),
        }
    }
}

fn stage_times(role: Role, stamps: &StageStamps, previous_ns: u64) -> Result<StageTimes, Incomplete> {
    let StageStamps { woken_ns, taken_ns, computed_ns, published_ns } = *stamps;
    if [woken_ns, taken_ns, computed_ns, published_ns].contains(&0) {
        return Err(Incomplete::Missing(role));
    }
    if woken_ns > taken_ns || previous_ns > taken_ns || taken_ns > computed_ns || computed_ns > published_ns {
        return Err(Incomplete::Backwards(role));
    }
    Ok(StageTimes {
        hop_ns: taken_ns - previous_ns,
        wait_ns: previous_ns.saturating_sub(woken_ns),
        compute_ns: computed_ns - taken_ns,
        publish_ns: published_ns - computed_ns,
    })
}

fn since(from_ns: u64, until_ns: u64) -> Option<u64> {
    let span_ns = if from_ns == 0 { None } else { until_ns.checked_sub(from_ns) };
    span_ns.filter(|span_ns| *span_ns <= MAX_AGE_NS)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A scan published at `start` whose chain is, in nanoseconds after it:
    /// estimator 20, 30, 130, 135; obstacles 25 (early), 160, 460, 470; controller 480, 490, 2490, 2500;
    /// actuator 2520, 2530, 2545, 2550. Front beam 1000 before.
    pub(crate) fn chain(scan_id: u64, start: u64) -> Header {
        let mut header = Header { scan_id, acquired_ns: start - 1000, ..Header::default() };
        header.stage_mut(Role::Robot).published_ns = start;
        let stamps =
            [[20, 30, 130, 135], [25, 160, 460, 470], [480, 490, 2490, 2500], [2520, 2530, 2545, 2550]];
        for (role, [woken, taken, computed, published]) in STAGES.into_iter().zip(stamps) {
            *header.stage_mut(role) = StageStamps {
                woken_ns: start + woken,
                taken_ns: start + taken,
                computed_ns: start + computed,
                published_ns: start + published,
            };
        }
        header
    }

    #[test]
    fn a_known_chain_is_attributed_to_the_nanosecond() {
        let attribution = attribute(&chain(1, 5000)).unwrap();
        assert_eq!(attribution.reaction_ns, 2550);
        let times =
            |hop_ns, wait_ns, compute_ns, publish_ns| StageTimes { hop_ns, wait_ns, compute_ns, publish_ns };
        assert_eq!(attribution.stages[0], times(30, 0, 100, 5));
        assert_eq!(
            attribution.stages[1],
            times(25, 110, 300, 10),
            "woken by the scan, 110 before the pose was out"
        );
        assert_eq!(attribution.stages[2], times(20, 0, 2000, 10));
        assert_eq!(attribution.stages[3], times(30, 0, 15, 5));
        assert_eq!(attribution.transport_ns, 2550 - (100 + 300 + 2000 + 15));
        assert_eq!(data_age_ns(&chain(1, 5000)), Some(3550));
    }

    #[test]
    fn hops_computes_and_publications_add_up_to_the_reaction_time() {
        let attribution = attribute(&chain(1, 5000)).unwrap();
        let path: u64 = attribution.stages.iter().map(|s| s.hop_ns + s.compute_ns + s.publish_ns).sum();
        assert_eq!(path, attribution.reaction_ns);
    }

    #[test]
    fn a_chain_with_a_hole_counts_in_the_reaction_time_only() {
        let mut header = chain(1, 5000);
        *header.stage_mut(Role::Obstacles) = StageStamps::default();
        assert_eq!(attribute(&header), Err(Incomplete::Missing(Role::Obstacles)));
        let mut latencies = Latencies::new(false);
        latencies.record(&header);
        let report = latencies.report();
        assert_eq!((report.scan_to_actuation.count, report.scan_to_actuation.max), (1, 2.55));
        assert_eq!((report.stages.compute.controller.count, report.incomplete_chains), (0, 1));
    }

    #[test]
    fn stamps_that_run_backwards_are_refused() {
        let mut header = chain(1, 5000);
        header.stage_mut(Role::Controller).taken_ns = header.stage(Role::Obstacles).published_ns - 1;
        assert_eq!(attribute(&header), Err(Incomplete::Backwards(Role::Controller)));
        let mut header = chain(1, 5000);
        header.stage_mut(Role::Actuator).published_ns = 4000;
        assert_eq!(reaction_ns(&header), None);
    }

    #[test]
    fn an_age_that_no_scan_has_is_counted_as_incomplete_and_is_in_no_figure() {
        let start = 3_600_000_000_000;
        let mut latencies = Latencies::new(false);
        latencies.record(&chain(1, start));
        let change: [fn(&mut Header); 3] = [
            |header| header.acquired_ns = 1000,
            |header| header.stage_mut(Role::Robot).published_ns = 1,
            |header| header.stage_mut(Role::Obstacles).woken_ns = 1,
        ];
        for (change, role) in change.into_iter().zip([Role::Robot, Role::Robot, Role::Obstacles]) {
            let mut header = chain(2, start);
            change(&mut header);
            assert_eq!(attribute(&header), Err(Incomplete::TooOld(role)));
            latencies.record(&header);
        }
        let report = latencies.report();
        assert_eq!((report.complete_chains, report.incomplete_chains), (1, 3));
        for figures in [&report.data_age, &report.scan_to_actuation, &report.waits.obstacles] {
            assert!(figures.max < 10.0, "{figures:?}");
        }
        assert_eq!((report.data_age.count, report.scan_to_actuation.count), (3, 3));
    }

    #[test]
    fn simulated_stamps_are_not_recorded() {
        let mut latencies = Latencies::new(true);
        latencies.record(&chain(1, 5000));
        let report = latencies.report();
        assert!(report.simulated);
        assert_eq!(
            (report.scan_to_actuation.count, report.data_age.count, report.incomplete_chains),
            (0, 0, 0)
        );
        assert_eq!(report.complete_chains, 1);
    }

    #[test]
    fn figures_of_stages_are_in_microseconds() {
        let mut latencies = Latencies::new(false);
        latencies.record(&chain(1, 5000));
        let report = latencies.report();
        assert_eq!((report.stages.compute.controller.p50, report.stages.transport.max), (2.0, 0.135));
        assert_eq!((report.hops.obstacles.max, report.waits.obstacles.max), (0.025, 0.11));
    }
}
