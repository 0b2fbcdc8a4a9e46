//! Work on all cores.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;

/// The results of `work` on the numbers below `count`, in their order; `done` is called after each.
///
/// # Errors
/// A thread that can't be started; then no further work is begun.
pub(crate) fn on_all_cores<R: Send>(
    count: usize,
    work: impl Fn(usize) -> R + Sync,
    mut done: impl FnMut(),
) -> std::io::Result<Vec<R>> {
    let next = AtomicUsize::new(0);
    let (sender, receiver) = mpsc::channel();
    let workers = std::thread::available_parallelism().map_or(1, usize::from).min(count);
    let mut results: Vec<(usize, R)> = std::thread::scope(|scope| -> std::io::Result<_> {
        for _ in 0..workers {
            let (sender, next, work) = (sender.clone(), &next, &work);
            let started = std::thread::Builder::new().spawn_scoped(scope, move || {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= count || sender.send((index, work(index))).is_err() {
                        return;
                    }
                }
            });
            if let Err(error) = started {
                next.store(count, Ordering::Relaxed);
                return Err(error);
            }
        }
        drop(sender);
        Ok(receiver.iter().inspect(|_| done()).collect())
    })?;
    results.sort_by_key(|(index, _)| *index);
    Ok(results.into_iter().map(|(_, result)| result).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_in_the_order_of_their_numbers() {
        let mut count = 0;
        let squares = on_all_cores(20, |index| index * index, || count += 1).unwrap();
        assert_eq!(squares, (0..20).map(|index| index * index).collect::<Vec<_>>());
        assert_eq!(count, 20);
        assert!(on_all_cores(0, |index| index, || ()).unwrap().is_empty());
    }
}
