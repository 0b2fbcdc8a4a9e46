//! Fault injection: what a process publishes may be changed on its way out.
//!
//! Only processes of a run that allows it have a [`Tamper`]. The others pay one comparison per sample.

use std::cell::RefCell;

use shared_types::{SampleType, Topic};

/// Changes what a process publishes.
pub trait Tamper {
    /// Called before a sample of the topic counts as computed; may wait.
    fn delay(&mut self, topic: Topic);

    /// Changes a complete sample; whether it is sent at all.
    fn change(&mut self, of: &SampleType, sample: &mut [u8]) -> bool;
}

thread_local! {
    static NEXT: RefCell<Option<Box<dyn Tamper>>> = const { RefCell::new(None) };
}

/// Lets the next [`crate::Process`] that this thread attaches publish through `tamper`.
pub fn tamper_with(tamper: Box<dyn Tamper>) {
    NEXT.set(Some(tamper));
}

/// The tamper of the process that attaches now.
pub(crate) fn take() -> Option<Box<dyn Tamper>> {
    NEXT.take()
}
