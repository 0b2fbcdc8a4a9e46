//! The same drive with many seeds, on all cores.

use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::{available_parallelism, scope};

/// What `result` gives for each seed, in the order of the seeds.
pub(crate) fn each<T: Send>(seeds: RangeInclusive<u64>, result: impl Fn(u64) -> T + Sync) -> Vec<(u64, T)> {
    let next = AtomicU64::new(*seeds.start());
    let take = || Some(next.fetch_add(1, Ordering::Relaxed)).filter(|seed| seeds.contains(seed));
    let work = || std::iter::from_fn(take).map(|seed| (seed, result(seed))).collect::<Vec<_>>();
    let threads = available_parallelism().map_or(1, usize::from);
    let mut all: Vec<_> = scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        workers.into_iter().flat_map(|worker| worker.join().unwrap()).collect()
    });
    all.sort_by_key(|(seed, _)| *seed);
    all
}
