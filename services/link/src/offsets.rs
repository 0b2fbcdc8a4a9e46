//! Topic `clock`: which offset each other host has used for each scan, published at the host of the orchestrator.
//!
//! Every sample of the loop and every journal tells the offset of its scan, so it is known here for each scan of which
//! anything has arrived.

use std::sync::{Mutex, PoisonError};

use runtime::{Domain, RuntimeError, TopicPublishers};
use shared_types::{ClockOffset, Sample, Topic};

use crate::clock::Offset;

/// A peer can name any host: more than a system can have are not remembered.
const MAX_HOSTS: usize = 64;

/// Scans whose offsets are remembered, so that each is published once.
const SCANS: usize = 256;

/// The writing end of the topic.
pub(crate) struct Offsets(Mutex<Outlet>);

struct Outlet {
    publishers: TopicPublishers,
    sequence: u64,
    hosts: Vec<Known>,
}

/// What was published of one host: scan and offset.
struct Known {
    host: String,
    scans: [Option<(u64, i64)>; SCANS],
}

impl Offsets {
    /// Publishes on the bus of `domain`.
    ///
    /// # Errors
    /// Errors of the bus.
    pub(crate) fn open(domain: &Domain) -> Result<Self, RuntimeError> {
        let publishers = TopicPublishers::open(domain, "link", &[Topic::Clock])?;
        Ok(Self(Mutex::new(Outlet { publishers, sequence: 0, hosts: Vec::new() })))
    }

    /// A sample of a host came at `now_ns` with this offset of its scan.
    ///
    /// # Errors
    /// Errors of the bus.
    pub(crate) fn note(
        &self,
        host: &str,
        scan_id: u64,
        clock: Offset,
        now_ns: u64,
    ) -> Result<(), RuntimeError> {
        let mut outlet = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if !outlet.is_new(host, scan_id, clock.offset_ns) {
            return Ok(());
        }
        let Offset { offset_ns, bound_ns } = clock;
        let mut offset = ClockOffset::new(host, scan_id, now_ns, offset_ns, bound_ns);
        outlet.sequence += 1;
        (offset.header.layout, offset.header.sequence) = (ClockOffset::LAYOUT, outlet.sequence);
        outlet.publishers.publish(0, bytemuck::bytes_of(&offset))
    }
}

impl Outlet {
    /// Whether it was not published yet; from now on it counts as published.
    fn is_new(&mut self, host: &str, scan_id: u64, offset_ns: i64) -> bool {
        let known = self.hosts.iter().position(|known| known.host == host);
        if known.is_none() && self.hosts.len() == MAX_HOSTS {
            return false;
        }
        let index = known.unwrap_or_else(|| {
            self.hosts.push(Known { host: host.to_owned(), scans: [None; SCANS] });
            self.hosts.len() - 1
        });
        let known = &mut self.hosts[index].scans[(scan_id % SCANS as u64) as usize];
        known.replace((scan_id, offset_ns)) != Some((scan_id, offset_ns))
    }
}
