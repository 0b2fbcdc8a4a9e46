//! What orchestrator and agents agree on with `scanloop-link`, the bridge between the hosts of a system.
//!
//! Two files in the directory of the system: the table says what the link does, the status what it finds. Between the
//! processes of a host and its link messages travel over datagram sockets in the same directory.

use key_table::{of_text, text_of};
use serde::{Deserialize, Serialize};

use crate::domain::LINK_STATUS_FILE;
use crate::{Domain, Realtime, RuntimeError};

/// Name of the table.
const TABLE_FILE: &str = "link.toml";

/// Name of the socket of the link: a message is the name of a host, a line feed, and what the agent there is told.
pub const LINK_SOCKET: &str = "link.sock";
/// Name by which the host of the orchestrator is known to the others; no other host has a name of this length.
pub const HUB: &str = "orchestrator";

/// What a link does on its host.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct LinkTable {
    /// Name of this host.
    pub here: String,
    /// Id of the run of the orchestrator: samples of other runs do not cross.
    pub run_id: String,
    /// Scan period [ns].
    pub period_ns: u64,
    /// Processes end after this time without a directive [ns].
    #[serde(default)]
    pub orphan_timeout_ns: u64,
    /// Processors and priority of the link, and of the processes that an agent starts.
    #[serde(default)]
    pub realtime: Realtime,
    /// Topics that other hosts need from this one.
    pub sends: Vec<String>,
    /// Topics that this host needs from others.
    pub receives: Vec<String>,
    /// The other hosts; only the orchestrator's names any.
    #[serde(default)]
    pub peers: Vec<LinkPeer>,
    /// Folder with the certificates of this host, for an encrypted transport.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub credentials: Option<String>,
}

/// Another host.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct LinkPeer {
    /// Its name.
    pub name: String,
    /// Where its agent listens, as Zenoh writes it.
    pub endpoint: String,
    /// Topics of the loop that it needs.
    pub receives: Vec<String>,
    /// Topics that others need from it.
    pub sends: Vec<String>,
}

/// What became of samples at the link of one host since it was started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LinkCounts {
    /// Sent, copies not counted.
    pub sent: u64,
    /// Not sent, because a newer one was there.
    pub replaced: u64,
    /// Not sent, because the clock was not locked.
    pub held: u64,
    /// Received and published here.
    pub received: u64,
    /// Copies of one that was received before.
    pub repeated: u64,
    /// Numbers that were skipped: lost on the way, or not sent.
    pub missing: u64,
    /// Dropped because they were too old, or older than one before.
    pub old: u64,
    /// Dropped because their age was not known well enough.
    pub clock: u64,
    /// Dropped because they were no samples of this layout.
    pub damaged: u64,
}

/// Why samples did not reach the readers on another host.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LossReason {
    /// They did not arrive.
    Link,
    /// They were too old when they arrived.
    Age,
    /// The age was not known: the clock was not locked, or its bound was too large.
    Clock,
    /// They were of another layout.
    Layout,
    /// A newer one was there before they were sent.
    Newer,
}

impl LossReason {
    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Link => "link",
            Self::Age => "age",
            Self::Clock => "clock",
            Self::Layout => "layout",
            Self::Newer => "newer",
        }
    }
}

/// Samples of one writer, with consecutive numbers, that were lost between two hosts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkLoss {
    /// Name of the topic.
    pub topic: String,
    /// Incarnation of the writer.
    pub incarnation: u32,
    /// The first number.
    pub first: u64,
    /// The last number.
    pub last: u64,
    /// Why they were lost.
    pub reason: LossReason,
}

/// One host as its link sees it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LinkedHost {
    /// Its name.
    pub name: String,
    /// Version of its program, and fingerprint of its samples.
    pub version: String,
    /// Whether something came from it within the last second.
    pub is_connected: bool,
    /// Why no connection to it is made, where one end refuses the other; empty else.
    pub refused: String,
    /// Whether its clock is locked.
    pub is_locked: bool,
    /// Clock of the orchestrator minus its own [ns].
    pub offset_ns: i64,
    /// What that may be wrong by [ns].
    pub bound_ns: u64,
    /// Shortest round trip of the last probes [ns].
    pub round_trip_ns: u64,
    /// How often its clock, or that of the orchestrator, stood still or jumped.
    pub clocks_lost: u64,
    /// For how long it stood still since its link was started, suspended or stopped [ms].
    pub stood_still_ms: u64,
    /// Number of the newest directive that was published there.
    pub directive: u64,
    /// What became of samples there.
    pub counts: LinkCounts,
    /// Samples of the loop that were lost on the way to it or dropped there within the last seconds.
    pub losses: Vec<LinkLoss>,
}

/// What the link of the orchestrator finds.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LinkStatus {
    /// When it was written [ns of CLOCK_MONOTONIC].
    pub written_ns: u64,
    /// For how long this host stood still since its link was started, suspended or stopped [ms].
    pub stood_still_ms: u64,
    /// What became of samples at this host.
    pub counts: LinkCounts,
    /// Samples of the loop that were lost on the way to this host or dropped here within the last seconds.
    pub losses: Vec<LinkLoss>,
    /// The other hosts.
    pub hosts: Vec<LinkedHost>,
}

impl LinkTable {
    /// Writes the table of a system.
    ///
    /// # Errors
    /// [`RuntimeError::File`].
    pub fn write(&self, domain: &Domain) -> Result<(), RuntimeError> {
        domain.folder().write(TABLE_FILE, text(self).as_bytes())
    }

    /// The table of a system; `None` when all of it is on one host.
    ///
    /// # Errors
    /// [`RuntimeError::File`] and [`RuntimeError::Settings`] when it can't be read.
    pub fn read(domain: &Domain) -> Result<Option<Self>, RuntimeError> {
        match domain.folder().contains(TABLE_FILE) {
            true => read(domain, TABLE_FILE).map(Some),
            false => Ok(None),
        }
    }
}

impl LinkStatus {
    /// Writes the status of a system.
    ///
    /// # Errors
    /// [`RuntimeError::File`].
    pub fn write(&self, domain: &Domain) -> Result<(), RuntimeError> {
        domain.folder().write(LINK_STATUS_FILE, text(self).as_bytes())
    }

    /// The status of a system; `None` before the first.
    ///
    /// # Errors
    /// [`RuntimeError::File`] and [`RuntimeError::Settings`] when it can't be read.
    pub fn read(domain: &Domain) -> Result<Option<Self>, RuntimeError> {
        match domain.folder().contains(LINK_STATUS_FILE) {
            true => read(domain, LINK_STATUS_FILE).map(Some),
            false => Ok(None),
        }
    }

    /// A host by its name.
    pub fn host(&self, name: &str) -> Option<&LinkedHost> {
        self.hosts.iter().find(|host| host.name == name)
    }
}

impl LinkedHost {
    /// As text for another host.
    pub fn to_text(&self) -> String {
        text(self)
    }

    /// What another host has written; `None` when it is damaged.
    pub fn of_text(text: &str) -> Option<Self> {
        of_text(text).ok()
    }
}

/// Version of this program and fingerprint of its samples: hosts that differ in it get no samples of each other.
pub fn link_version() -> String {
    let layouts = shared_types::Layouts::built_in().to_string();
    let fingerprint = layouts.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    format!("{} {fingerprint:016x}", env!("CARGO_PKG_VERSION"))
}

/// The socket of the process that stands for one on another host.
pub fn reply_socket(incarnation: u32) -> String {
    format!("remote-{incarnation}.sock")
}

fn text(value: &impl Serialize) -> String {
    // Tables of texts, numbers and lists: TOML can write all of them.
    text_of(value).unwrap_or_default()
}

fn read<T: serde::de::DeserializeOwned>(domain: &Domain, name: &str) -> Result<T, RuntimeError> {
    let text = domain.folder().read_text(name)?;
    of_text(&text).map_err(|error| RuntimeError::settings(domain.directory().join(name), error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_and_status_are_read_back_as_they_were_written() {
        let domain = Domain::create(&format!("lk{}", std::process::id())).unwrap();
        assert_eq!((LinkTable::read(&domain).unwrap(), LinkStatus::read(&domain).unwrap()), (None, None));
        let peer = LinkPeer { name: "lab".to_owned(), sends: vec!["pose".to_owned()], ..LinkPeer::default() };
        let table =
            LinkTable { here: HUB.to_owned(), period_ns: 5, peers: vec![peer], ..LinkTable::default() };
        table.write(&domain).unwrap();
        assert_eq!(LinkTable::read(&domain).unwrap(), Some(table));
        let host =
            LinkedHost { name: "lab".to_owned(), offset_ns: -86_400_000_000_000, ..LinkedHost::default() };
        assert_eq!(LinkedHost::of_text(&host.to_text()), Some(host.clone()));
        let status = LinkStatus { written_ns: 7, hosts: vec![host.clone()], ..LinkStatus::default() };
        status.write(&domain).unwrap();
        let read = LinkStatus::read(&domain).unwrap().unwrap();
        assert_eq!((read.host("lab"), read.host("desk")), (Some(&host), None));
        domain.remove().unwrap();
    }

    #[test]
    fn the_version_contains_the_fingerprint_of_all_samples() {
        let version = link_version();
        assert!(version.starts_with("0.1.0 ") && version.len() == 22, "{version}");
    }
}
