//! The faults that are injected into the loop, and what is expected of it then.
//!
//! Each file in `faults/` is one fault: what fails and by how much, how a drive may end, which part must detect it, and
//! within what time. The name of the file is the name of the fault. A fault acts at one of four places:
//!
//! * on the samples of a topic, [`SampleFault`]: [`Change`] applies it to the bytes of a sample;
//! * in the emulated robot, as other values of keys of the scenario;
//! * on a process, [`ProcessFault`]: it is killed, suspended, or floods its topic;
//! * on a person who drives, [`PersonFault`].
//!
//! This crate only reads the table and changes samples. It starts nothing and knows no process, so whatever injects
//! faults can use it.

mod change;
mod exceptions;
mod fault;
mod live;
mod sample_fault;

pub use change::{Change, Changed, UnknownField};
pub use exceptions::Exceptions;
pub use fault::{
    DrivePhase, Expectation, FaultError, InPhase, InjectedFault, Injection, PersonFault, ProcessAction,
    ProcessFault, ProcessName, ScenarioFault,
};
pub use live::{ActiveFault, PERMIT_FILE, fault_file, live_names};
pub use sample_fault::{SampleAction, SampleFault};

/// Name and text of each file in `faults/`.
const FILES: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/list.rs"));

/// All faults, in the order of their names.
///
/// # Errors
/// The first file that is not allowed, with its key.
pub fn all() -> Result<Vec<InjectedFault>, FaultError> {
    FILES.iter().map(|(name, text)| InjectedFault::parse(name, text)).collect()
}

/// The fault of a name; `None` when there is none.
///
/// # Errors
/// Its file is not allowed, with the key.
pub fn find(name: &str) -> Result<Option<InjectedFault>, FaultError> {
    let file = FILES.iter().find(|(known, _)| *known == name);
    file.map(|(name, text)| InjectedFault::parse(name, text)).transpose()
}

#[cfg(test)]
mod tests;
