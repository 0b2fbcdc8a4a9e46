//! Which tests run at the same time: all that their runner starts, or one alone, when it needs more of the machine than
//! the others leave to it.

use std::collections::HashMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{ThreadId, current};
use std::time::{Duration, Instant};

/// A test that runs alone waits at most this long for the end of the others.
const LIMIT: Duration = Duration::from_secs(90);

/// Who runs.
#[derive(Debug)]
struct Turns {
    /// How many turns each thread has begun.
    running: Option<HashMap<ThreadId, usize>>,
    alone: Option<ThreadId>,
}

static TURNS: Mutex<Turns> = Mutex::new(Turns { running: None, alone: None });
static CHANGED: Condvar = Condvar::new();

fn turns() -> MutexGuard<'static, Turns> {
    TURNS.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Turns {
    fn running(&mut self) -> &mut HashMap<ThreadId, usize> {
        self.running.get_or_insert_default()
    }
}

/// A test among others, until it is dropped.
#[derive(Debug)]
pub(crate) struct Turn(ThreadId);

impl Turn {
    /// Waits while another test runs alone. A thread that has begun a turn may begin more of them, and one without a name
    /// need not wait: a test has started it, which is waited for or runs alone itself.
    pub(crate) fn begin() -> Self {
        let (own, is_of_a_test) = (current().id(), current().name().is_none());
        let waits = |turns: &mut Turns| {
            let another = turns.alone.is_some_and(|it| it != own);
            another && !is_of_a_test && !turns.running().contains_key(&own)
        };
        let mut turns = CHANGED.wait_while(turns(), waits).unwrap_or_else(PoisonError::into_inner);
        *turns.running().entry(own).or_default() += 1;
        Self(own)
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        let mut turns = turns();
        if let Some(count) = turns.running().get_mut(&self.0) {
            *count -= 1;
        }
        turns.running().retain(|_, count| *count > 0);
        CHANGED.notify_all();
    }
}

/// A test that runs alone, until it is dropped.
#[derive(Debug)]
pub(crate) struct Alone(());

impl Alone {
    /// Lets no other test begin, and waits until those that run have ended.
    pub(crate) fn begin() -> Self {
        let own = current().id();
        let mut turns = CHANGED
            .wait_while(turns(), |turns| turns.alone.is_some())
            .unwrap_or_else(PoisonError::into_inner);
        turns.alone = Some(own);
        let until = Instant::now() + LIMIT;
        while turns.running().keys().any(|thread| *thread != own) && Instant::now() < until {
            let rest = until.saturating_duration_since(Instant::now());
            turns = CHANGED.wait_timeout(turns, rest).unwrap_or_else(PoisonError::into_inner).0;
        }
        Self(())
    }
}

impl Drop for Alone {
    fn drop(&mut self) {
        turns().alone = None;
        CHANGED.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;

    #[test]
    fn a_test_that_runs_alone_waits_for_the_others_and_the_others_for_it() {
        let is_alone = AtomicBool::new(false);
        let (first, second) = (Turn::begin(), Turn::begin());
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let _alone = Alone::begin();
                is_alone.store(true, Ordering::SeqCst);
                let _nested = Turn::begin();
                // A thread of this test, which it waits for.
                std::thread::scope(|scope| _ = scope.spawn(|| drop(Turn::begin())));
                std::thread::park_timeout(Duration::from_millis(20));
                is_alone.store(false, Ordering::SeqCst);
            });
            while turns().alone.is_none() {
                std::thread::yield_now();
            }
            // One that runs already may begin more; it is waited for.
            drop(Turn::begin());
            drop(second);
            assert!(!is_alone.load(Ordering::SeqCst));
            drop(first);
            let another = std::thread::Builder::new().name("another".to_owned());
            let began = another.spawn_scoped(scope, || {
                let _turn = Turn::begin();
                assert!(!is_alone.load(Ordering::SeqCst));
            });
            began.expect("a thread");
        });
        assert!(!turns().running().contains_key(&current().id()));
    }
}
