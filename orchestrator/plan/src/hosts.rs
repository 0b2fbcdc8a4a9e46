//! The hosts of a system: which process runs where, and which topics cross between them.
//!
//! A process without the key `host` runs on the host of the orchestrator. Robot and actuator are on one host: there the
//! wheels are blocked when nothing comes any more, and that needs no network.

#[cfg(test)]
mod tests;

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};
use shared_types::{Role, TOPICS, Topic, did_you_mean};
use supervision::entry::ProcessEntry;
use vehicle::{Documented, Invalid, Setting, settings};

use crate::System;

/// Longest id of a system, which on a host is `ID-HOST`.
const MAX_ID: usize = 16;
/// What the name of a host may be: one letter at least is left for the system id.
pub const NAME_RULE: &str = "a small letter, then small letters and digits; at most 10";
const MAX_NAME: usize = 10;
const NAME_PATTERN: &str = "pattern = '^[a-z][a-z0-9]{0,9}$'";
/// What an address may be.
pub const ADDRESS_RULE: &str = "an IP address and a port, as 10.9.0.2:7411 or [fd00::2]:7411";

/// What samples travel with between two hosts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Transport {
    /// Encrypted datagrams between peers that have proven who they are.
    Quic,
    /// Plain datagrams: anyone who can reach the address can drive the robot.
    Udp,
    /// A plain stream, which waits for lost packets; as open as `udp`.
    Tcp,
}

impl Transport {
    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quic => "quic",
            Self::Udp => "udp",
            Self::Tcp => "tcp",
        }
    }
}

impl Setting for Transport {}

settings! {
    /// Another machine of the system, on which `scanloop agent` runs.
    pub struct HostEntry {
        /// Name by which `host` of a process means it.
        pub name: String = String::new(), (Documented { text: NAME_RULE, schema: NAME_PATTERN }, "must be given");
        /// Address at which its agent listens.
        pub address: String = String::new(), (ADDRESS_RULE, "must be given");
        /// What samples travel with: `quic` needs the certificates of `scanloop agent pair`; `udp` and `tcp` are for a cable
        /// that no other machine reaches.
        pub transport: Transport = Transport::Quic;
    }
}

/// A topic that crosses from one host to another; `None` is the host of the orchestrator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Crossing<'a> {
    /// Host of its writer.
    pub from: Option<&'a str>,
    /// Host that needs it.
    pub to: Option<&'a str>,
    /// The topic.
    pub topic: Topic,
}

/// A role, and a host that it has a process on; `None` is the host of the orchestrator. While a role moves it has two.
pub type RolePlace<'a> = (Role, Option<&'a str>);

/// Where the roles of a system are when it starts.
pub fn places(system: &System) -> impl Iterator<Item = RolePlace<'_>> {
    system.roles().map(|entry| (entry.role(), entry.host.as_deref()))
}

/// The topics that cross between the hosts of a system when it starts.
pub fn crossings(system: &System) -> Vec<Crossing<'_>> {
    crossings_between(&places(system).collect::<Vec<_>>())
}

/// The topics that cross between hosts.
///
/// A topic of the loop crosses to each host where a role reads it. The orchestrator observes them all. Directives cross to
/// each host, heartbeats, checkpoints and journals from each to the orchestrator.
pub fn crossings_between<'a>(places: &[RolePlace<'a>]) -> Vec<Crossing<'a>> {
    let mut hosts = vec![None];
    for (_, host) in places {
        if !hosts.contains(host) {
            hosts.push(*host);
        }
    }
    let mut found = Vec::new();
    for topic in TOPICS {
        for to in hosts.iter().copied() {
            let is_read = places.iter().any(|(role, host)| *host == to && role.reads().contains(&topic));
            let writers = places.iter().filter(|(role, _)| topic.writer() == Some(*role));
            for (_, from) in writers.filter(|(_, from)| *from != to && (to.is_none() || is_read)) {
                found.push(Crossing { from: *from, to, topic });
            }
            match topic {
                Topic::Directive if to.is_some() => found.push(Crossing { from: None, to, topic }),
                Topic::Heartbeat | Topic::Checkpoint | Topic::Journal if to.is_some() => {
                    found.push(Crossing { from: to, to: None, topic });
                }
                _ => {}
            }
        }
    }
    found
}

/// The host of the orchestrator, then those of the file that a process runs on.
pub fn hosts(system: &System) -> impl Iterator<Item = Option<&str>> {
    let used = |host: &&HostEntry| system.roles().any(|entry| entry.host.as_deref() == Some(&host.name));
    std::iter::once(None).chain(system.hosts.iter().filter(used).map(|host| Some(host.name.as_str())))
}

/// The lines of `scanloop check` about hosts; empty when all processes run on one.
pub fn describe(system: &System) -> String {
    let mut text = String::new();
    if hosts(system).count() < 2 {
        return text;
    }
    for host in hosts(system) {
        let roles = system.roles().filter(|entry| entry.host.as_deref() == host);
        let roles: Vec<&str> = roles.map(|entry| entry.role.as_str()).collect();
        let place = match system.hosts.iter().find(|entry| Some(entry.name.as_str()) == host) {
            Some(HostEntry { name, address, transport }) => {
                format!("{name} ({} {address})", transport.name())
            }
            None => "here".to_owned(),
        };
        text += &format!("  on {place}: {}\n", roles.join(", "));
    }
    for from in hosts(system) {
        for to in hosts(system) {
            let topics = crossings(system).into_iter().filter(|one| one.from == from && one.to == to);
            let topics: Vec<&str> = topics.map(|one| one.topic.name()).collect();
            if !topics.is_empty() {
                let [from, to] = [from, to].map(|host| host.unwrap_or("here"));
                text += &format!("  crosses from {from} to {to}: {}\n", topics.join(", "));
            }
        }
    }
    text
}

/// An address as Zenoh writes it; datagrams are not sent again when they are lost.
pub fn endpoint(transport: Transport, address: &str) -> String {
    let options = if transport == Transport::Tcp { "" } else { "?rel=0" };
    format!("{}/{address}{options}", transport.name())
}

/// What a user should know of a transport without certificates; `None` where no other machine can reach the address.
pub fn warning(transport: Transport, address: &str) -> Option<String> {
    let is_loopback =
        address.parse().is_ok_and(|address: SocketAddr| address.ip().to_canonical().is_loopback());
    (transport != Transport::Quic && !is_loopback).then(|| {
        format!(
            "transport = \"{}\" at {address}: any machine that reaches this address can drive the robot; use quic, or a cable \
             that no other machine reaches",
            transport.name()
        )
    })
}

/// The warnings of a system about the hosts that it uses.
pub(crate) fn warnings(system: &System) -> Vec<String> {
    let hosts = hosts(system).flatten().filter_map(|name| system.hosts.iter().find(|host| host.name == name));
    hosts
        .filter_map(|host| Some(format!("host {}: {}", host.name, warning(host.transport, &host.address)?)))
        .collect()
}

/// Requires certificates for a transport that needs them.
///
/// # Errors
/// The key `credentials` that is missing.
pub fn require_credentials(transport: Transport, credentials: Option<&str>) -> Result<(), Invalid> {
    match (transport, credentials) {
        (Transport::Quic, None) => {
            let allowed = "a folder that `scanloop agent pair` made, for transport quic; or transport udp or tcp on a \
                           cable that no other machine reaches";
            Err(Invalid::new("credentials", "(missing)", allowed))
        }
        _ => Ok(()),
    }
}

/// Checks hosts, and the key `host` of each process.
///
/// # Errors
/// The first key that is not allowed.
pub(crate) fn validate(system: &System) -> Result<(), Invalid> {
    for (index, host) in system.hosts.iter().enumerate() {
        let refuse = |key: &str, value: &str, allowed: &str| {
            let value = if value.is_empty() { "(missing)" } else { value };
            Err(Invalid::new(&format!("host[{index}].{key}"), value, allowed))
        };
        if !is_name(&host.name) {
            return refuse("name", &host.name, NAME_RULE);
        }
        if system.hosts[..index].iter().any(|other| other.name == host.name) {
            return refuse("name", &host.name, "each name once");
        }
        if !is_address(&host.address) {
            return refuse("address", &host.address, ADDRESS_RULE);
        }
        if system.hosts[..index].iter().any(|other| other.address == host.address) {
            return refuse("address", &host.address, "each address once");
        }
    }
    for host in &system.hosts {
        require_credentials(host.transport, system.credentials.as_deref())?;
    }
    for (index, entry) in system.processes.iter().enumerate() {
        validate_process(system, entry).map_err(|invalid| invalid.within(&format!("process[{index}]")))?;
    }
    require_robot_together(system)?;
    if hosts(system).count() > 1 && (system.companions().next().is_some() || !system.topics.is_empty()) {
        let (key, count) = match system.topics.len() {
            0 => ("process.role", "companion".to_owned()),
            count => ("topic", count.to_string()),
        };
        return Err(Invalid::new(
            key,
            count,
            "none in a system of several hosts: only topics of the loop cross",
        ));
    }
    Ok(())
}

fn validate_process(system: &System, entry: &ProcessEntry) -> Result<(), Invalid> {
    let Some(host) = &entry.host else { return Ok(()) };
    if !system.hosts.iter().any(|other| other.name == *host) {
        let names: Vec<&str> = system.hosts.iter().map(|host| host.name.as_str()).collect();
        let allowed = match names.is_empty() {
            true => "a [[host]] of the file, which has none".to_owned(),
            false => format!("one of {}.{}", names.join(", "), did_you_mean(host, names.iter().copied())),
        };
        return Err(Invalid::new("host", host, allowed));
    }
    if let Some(command) = &entry.command {
        let allowed = "an `implementation`: an agent starts no command that comes from another host";
        return Err(Invalid::new("command", command.join(" "), allowed));
    }
    Ok(())
}

/// The stop needs no network: the wheels are blocked by two processes on one host.
fn require_robot_together(system: &System) -> Result<(), Invalid> {
    let [robot, actuator] =
        [Role::Robot, Role::Actuator].map(|role| system.entry(role).and_then(|entry| entry.host.as_deref()));
    if robot != actuator {
        let names = [robot, actuator].map(|host| host.unwrap_or("(the one of the orchestrator)"));
        let value = format!("{} for robot, {} for actuator", names[0], names[1]);
        return Err(Invalid::new(
            "process.host",
            value,
            "the same for robot and actuator: a stop needs no network",
        ));
    }
    Ok(())
}

/// Checks that the id of the system on each of its hosts, `ID-HOST`, is short enough.
///
/// # Errors
/// The first host for which it is too long, as a sentence.
pub fn require_short_ids(system: &System, system_id: &str) -> Result<(), String> {
    let mut names = system.hosts.iter().map(|host| &host.name);
    match names.find(|host| system_id.len() + 1 + host.len() > MAX_ID) {
        Some(host) => Err(format!(
            "system id {system_id} is not allowed: `{system_id}-{host}` on host {host} has more than {MAX_ID} characters"
        )),
        None => Ok(()),
    }
}

/// Whether a text may be the name of a host.
pub fn is_name(text: &str) -> bool {
    let rest = text.strip_prefix(|first: char| first.is_ascii_lowercase());
    let allowed = |letter: char| letter.is_ascii_lowercase() || letter.is_ascii_digit();
    rest.is_some_and(|rest| rest.len() < MAX_NAME && rest.chars().all(allowed))
}

/// Whether a text is an address of one machine; names are not, because their meaning may change while driving.
fn is_address(text: &str) -> bool {
    text.parse::<std::net::SocketAddr>().is_ok_and(|address| {
        address.port() != 0 && !address.ip().is_unspecified() && !address.ip().is_multicast()
    })
}
