//! Any role of the loop with a fault of one of its samples, for tests of the ledger.
//!
//! `faulty-role ROLE FAULT TOPIC SCAN` mistreats the first sample for that scan or a later one, see [`Fault`], and
//! writes to its log which scan and which number it was. The fault `forge` gives every eighth sample a wrong number in its
//! header, `forge-N` gives one sample the N-th of them.
//! `faulty-role ROLE delay` waits where [`scanloop_tests::planted`] plans it, and writes to its log
//! from when to when it really waited.
//!
//! The work itself is that of the built-in implementation.

mod outlet;
mod roles;

use std::error::Error;

use shared_types::{Role, Topic};

use crate::outlet::Fault;

/// What is wrong with this process.
#[derive(Debug, Clone, Copy)]
enum Trouble {
    /// One sample of a topic is treated wrongly.
    Sample(Fault, Topic, u64),
    /// It waits at planted places.
    Delay,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (role, trouble) = parse(&arguments)
        .ok_or("usage: faulty-role ROLE drop|omit|repeat|double|swap|mix|forge|forge-N TOPIC SCAN | delay")?;
    match role {
        Role::Robot => roles::robot(trouble),
        Role::Estimator => roles::estimator(trouble),
        Role::Obstacles => roles::obstacles(trouble),
        Role::Controller => roles::controller(trouble),
        Role::Actuator => roles::actuator(trouble),
    }
}

fn parse(arguments: &[String]) -> Option<(Role, Trouble)> {
    let [role, fault, rest @ ..] = arguments else { return None };
    let role = role.parse().ok()?;
    match (fault.as_str(), rest) {
        ("delay", []) => Some((role, Trouble::Delay)),
        (fault, [topic, scan]) => {
            Some((role, Trouble::Sample(fault.parse().ok()?, topic.parse().ok()?, scan.parse().ok()?)))
        }
        _ => None,
    }
}
