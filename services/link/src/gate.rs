//! Old data never acts: whether a sample that came over the link is young enough, by its mapped age.

use shared_types::Topic;

/// Samples of topics that do not drive the wheels may be this old [ns].
const OUTSIDE_OF_THE_LOOP_NS: u64 = 1_000_000_000;

/// Why a sample is dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Refusal {
    /// Its age may exceed the limit.
    Old,
    /// Its age is not known: the clocks are not locked, their bound is too large, or it comes from the future.
    Clock,
}

/// What a receiver knows when a sample arrives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Arriving {
    /// When its publisher published it, on the clock that both hosts map to [ns].
    pub(crate) published_ns: u64,
    /// What the clock of the sending host may be wrong by [ns].
    pub(crate) sender_bound_ns: u64,
    /// Now on the common clock, and what that may be wrong by [ns]; `None` while the clock is not locked.
    pub(crate) now: Option<(u64, u64)>,
}

/// The oldest that a sample may be at its arrival: one period, because the actuator blocks at one and a half [ns].
pub(crate) fn limit_ns(topic: Topic, period_ns: u64) -> u64 {
    match topic.writer() {
        Some(_) => period_ns,
        None => OUTSIDE_OF_THE_LOOP_NS,
    }
}

/// Passes when the age of a sample is below `limit_ns`, even if the clocks are as wrong as their bounds allow; a bound
/// above half a period says too little.
///
/// # Errors
/// Why the sample is to be dropped.
pub(crate) fn admit(arriving: Arriving, limit_ns: u64, period_ns: u64) -> Result<(), Refusal> {
    let Some((now_ns, own_bound_ns)) = arriving.now else { return Err(Refusal::Clock) };
    let bound_ns = arriving.sender_bound_ns.saturating_add(own_bound_ns);
    if bound_ns > period_ns / 2 || arriving.published_ns > now_ns.saturating_add(bound_ns) {
        return Err(Refusal::Clock);
    }
    let age_ns = now_ns.saturating_sub(arriving.published_ns).saturating_add(bound_ns);
    if age_ns > limit_ns { Err(Refusal::Old) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 100_000_000;

    fn at(published_ns: u64, sender_bound_ns: u64, now: Option<(u64, u64)>) -> Result<(), Refusal> {
        admit(Arriving { published_ns, sender_bound_ns, now }, limit_ns(Topic::Command, PERIOD_NS), PERIOD_NS)
    }

    #[test]
    fn age_counts_with_the_bounds_of_both_clocks() {
        let now_ns = 5_000_000_000;
        assert_eq!(at(now_ns - 98_000_000, 1_000_000, Some((now_ns, 1_000_000))), Ok(()));
        assert_eq!(at(now_ns - 98_000_000, 1_000_000, Some((now_ns, 1_000_001))), Err(Refusal::Old));
        assert_eq!(
            at(now_ns - 3_200_000_000, 0, Some((now_ns, 0))),
            Err(Refusal::Old),
            "a burst after an outage"
        );
    }

    #[test]
    fn without_a_clock_no_sample_counts() {
        assert_eq!(at(5, 0, None), Err(Refusal::Clock));
        assert_eq!(
            at(1_000_000_000, 30_000_000, Some((1_000_000_000, 30_000_000))),
            Err(Refusal::Clock),
            "above T / 2"
        );
        assert_eq!(
            at(1_003_000_000, 1_000_000, Some((1_000_000_000, 1_000_000))),
            Err(Refusal::Clock),
            "the future"
        );
        assert_eq!(
            at(1_002_000_000, 1_000_000, Some((1_000_000_000, 1_000_000))),
            Ok(()),
            "within the bounds"
        );
    }

    #[test]
    fn heartbeats_and_directives_may_be_a_second_old() {
        assert_eq!(limit_ns(Topic::Heartbeat, PERIOD_NS), 1_000_000_000);
        assert_eq!(limit_ns(Topic::Directive, 1_000_000), 1_000_000_000);
        assert_eq!(limit_ns(Topic::Pose, 1_000_000), 1_000_000);
    }
}
