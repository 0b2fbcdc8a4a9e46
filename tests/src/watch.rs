//! The true motion of a robot, for tests.

use std::cell::RefCell;

use runtime::{Bus, Observer};
use shared_types::Truth;

use crate::TestSystem;

/// The truth of a robot, observed from outside of its system.
pub struct TruthWatch {
    observer: Observer<Truth>,
    seen: RefCell<Vec<Truth>>,
    // Dropped last.
    _bus: Bus,
}

impl TruthWatch {
    /// Observes from now on.
    pub fn new(system: &TestSystem) -> Self {
        let bus = Bus::open(&system.domain(), "test").expect("a running system");
        let observer = Observer::new(&bus).expect("the topic of the truth");
        Self { observer, seen: RefCell::default(), _bus: bus }
    }

    /// The newest truth; polls the bus.
    pub fn newest(&self) -> Option<Truth> {
        let mut seen = self.seen.borrow_mut();
        self.observer.poll(|truth| seen.push(*truth)).expect("the topic of the truth");
        seen.last().copied()
    }

    /// Waits until the newest truth meets a condition; returns it.
    pub fn wait_for(&self, system: &TestSystem, what: &str, condition: impl Fn(&Truth) -> bool) -> Truth {
        system.wait_until(what, |_| self.newest().is_some_and(|truth| condition(&truth)));
        self.newest().expect("a truth")
    }

    /// All that was seen so far.
    pub fn all(&self) -> Vec<Truth> {
        let _ = self.newest();
        self.seen.borrow().clone()
    }
}
