//! Delays that a test plants in the stages, one per scan.

use shared_types::Role;

/// A place in the work of a stage where a test plants a delay.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DelayPlace {
    /// Awake with all inputs there, before it takes them.
    Take,
    /// In its computation.
    Compute,
    /// With its result there, before it is published.
    Publish,
    /// Published, before the readers are woken.
    Deliver,
}

/// Stages and places of planted delays, and how long they are [ns]: one of 48 combinations per scan.
pub const STAGES: [Role; 4] = [Role::Estimator, Role::Obstacles, Role::Controller, Role::Actuator];
/// See [`STAGES`].
pub const PLACES: [DelayPlace; 4] =
    [DelayPlace::Take, DelayPlace::Compute, DelayPlace::Publish, DelayPlace::Deliver];
/// See [`STAGES`].
pub const DELAYS_NS: [u64; 3] = [1_000_000, 5_000_000, 20_000_000];

/// The delay that is planted for a scan: stage, place and length [ns].
pub fn plan(scan_id: u64) -> (Role, DelayPlace, u64) {
    let index = usize::try_from(scan_id).unwrap_or(0);
    (STAGES[index % 4], PLACES[index / 4 % 4], DELAYS_NS[index / 16 % 3])
}

/// The delay of a stage at a place for a scan, if one is planted there [ns].
pub fn planted(scan_id: u64, role: Role, place: DelayPlace) -> Option<u64> {
    let (stage, at, delay_ns) = plan(scan_id);
    (stage == role && at == place).then_some(delay_ns)
}
