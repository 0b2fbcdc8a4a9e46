//! Implementations of all roles with one fault each, to show that `scanloop conformance` finds it.
//!
//! `faulty ROLE FAULT`; the faults of a role are in its file, `loner` has those that a process on the crate `runtime`
//! cannot have. The table of faults and of the cases that find them is in `tests/conformance.rs`.

mod actuator;
mod controller;
mod estimator;
mod loner;
mod obstacles;
mod robot;

use runtime::{Bus, Domain, Observer};
use shared_types::Sample;

/// What a process ends with.
type Outcome = Result<(), Box<dyn std::error::Error>>;

fn main() -> Outcome {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["loner", fault] => loner::run(fault),
        ["estimator", fault] => estimator::run(fault),
        ["obstacles", fault] => obstacles::run(fault),
        ["controller", fault] => controller::run(fault),
        ["actuator", fault] => actuator::run(fault),
        ["robot", fault] => robot::run(fault),
        _ => Err("usage: faulty loner|estimator|obstacles|controller|actuator|robot FAULT".into()),
    }
}

/// The domain of the system that this process was started for.
fn domain() -> Result<Domain, Box<dyn std::error::Error>> {
    Ok(Domain::of_this_process()?)
}

/// Reads a topic without a check of the writer.
fn everything<S: Sample>() -> Result<(Bus, Observer<S>), Box<dyn std::error::Error>> {
    let bus = Bus::open(&domain()?, "faulty")?;
    let observer = Observer::new(&bus)?;
    Ok((bus, observer))
}
