//! Who made a connection: which user of this machine, as the kernel says, or which other machine.
//! Each has a limited number of places, so that none can take those of the others.

mod diag;

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, PoisonError};

/// Who is at the other end of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Peer {
    /// A user of this machine.
    User(u32),
    /// Another machine, or a connection that the kernel does not list.
    Host(IpAddr),
}

/// Finds who connected `peer` to `local`.
pub(crate) fn peer_of(peer: SocketAddr, local: SocketAddr) -> Peer {
    let ip = peer.ip().to_canonical();
    uid_of_peer(peer, local).map_or(Peer::Host(ip), Peer::User)
}

/// Counts what each peer holds.
#[derive(Debug)]
pub(crate) struct Places {
    /// Maximum for one peer.
    each: usize,
    /// Maximum for all peers but the user of this process, who always has the places of [`Places::each`].
    others: usize,
    held: Mutex<HashMap<Peer, usize>>,
}

/// A place that is held; free again when it is dropped.
#[derive(Debug)]
pub(crate) struct Held(Arc<Places>, Peer);

impl Places {
    /// No place is held.
    pub(crate) fn new(each: usize, others: usize) -> Arc<Self> {
        Arc::new(Self { each, others, held: Mutex::default() })
    }

    /// A place for this peer; `None` when it holds all that it may, or when the others together do.
    pub(crate) fn take(self: &Arc<Self>, peer: Peer) -> Option<Held> {
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        let others: usize = held.iter().filter(|(holder, _)| !is_own(**holder)).map(|(_, count)| count).sum();
        let own = held.get(&peer).copied().unwrap_or(0);
        if own >= self.each || !is_own(peer) && others >= self.others {
            return None;
        }
        held.insert(peer, own + 1);
        Some(Held(Arc::clone(self), peer))
    }

    /// How many are held.
    #[cfg(test)]
    pub(crate) fn count(&self) -> usize {
        self.held.lock().unwrap_or_else(PoisonError::into_inner).values().sum()
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        let mut held = self.0.held.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = held.get_mut(&self.1) {
            *count -= 1;
            if *count == 0 {
                held.remove(&self.1);
            }
        }
    }
}

fn is_own(peer: Peer) -> bool {
    peer == Peer::User(rustix::process::geteuid().as_raw())
}

/// User id of the process that connected `peer` to `local`; `None` for a connection that the kernel does not list here.
pub(crate) fn uid_of_peer(peer: SocketAddr, local: SocketAddr) -> Option<u32> {
    // A question for one connection takes the same time however many there are; not every kernel answers it.
    diag::uid_of(peer, local).unwrap_or_else(|_| uid_in_tables(peer, local))
}

/// The same from the table of all connections.
fn uid_in_tables(peer: SocketAddr, local: SocketAddr) -> Option<u32> {
    ["/proc/net/tcp", "/proc/net/tcp6"].into_iter().find_map(|path| {
        let table = std::fs::read_to_string(path).ok()?;
        uid_in(&table, peer, local)
    })
}

/// The user of the row whose own address is `peer` and whose other end is `local`.
fn uid_in(table: &str, peer: SocketAddr, local: SocketAddr) -> Option<u32> {
    let (near, far) = (addresses(peer), addresses(local));
    table.lines().skip(1).find_map(|row| {
        let columns: Vec<&str> = row.split_ascii_whitespace().take(8).collect();
        let is_it = columns.len() == 8
            && near.iter().any(|address| address == columns[1])
            && far.iter().any(|address| address == columns[2]);
        if is_it { columns[7].parse().ok() } else { None }
    })
}

/// An address as the kernel writes it: words of four bytes in the order of the machine, alone and inside of IPv6.
fn addresses(address: SocketAddr) -> Vec<String> {
    let words = |bytes: &[u8]| -> String {
        let word = |four: &[u8]| u32::from_ne_bytes([four[0], four[1], four[2], four[3]]);
        bytes.chunks_exact(4).map(|four| format!("{:08X}", word(four))).collect()
    };
    let hosts = match address.ip().to_canonical() {
        IpAddr::V4(ip) => vec![words(&ip.octets()), words(&ip.to_ipv6_mapped().octets())],
        IpAddr::V6(ip) => vec![words(&ip.octets())],
    };
    hosts.into_iter().map(|host| format!("{host}:{:04X}", address.port())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{TcpListener, TcpStream};

    #[test]
    fn a_connection_of_this_process_is_of_this_user() {
        let own = rustix::process::geteuid().as_raw();
        for host in ["127.0.0.1:0", "[::1]:0"] {
            let Ok(listener) = TcpListener::bind(host) else { continue };
            let client = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
            let (server, peer) = listener.accept().unwrap();
            let local = server.local_addr().unwrap();
            assert_eq!(uid_of_peer(peer, local), Some(own), "{host}");
            assert_eq!(uid_in_tables(peer, local), Some(own), "{host}");
            assert_eq!(uid_of_peer("127.0.0.1:1".parse().unwrap(), client.local_addr().unwrap()), None);
        }
    }

    #[test]
    fn no_peer_takes_the_places_of_the_owner_or_more_than_its_own() {
        let own = Peer::User(rustix::process::geteuid().as_raw());
        let host = |last| Peer::Host(IpAddr::from([192, 168, 0, last]));
        let places = Places::new(3, 5);
        let mut held: Vec<Held> = (0..3).map(|_| places.take(host(1)).unwrap()).collect();
        assert!(places.take(host(1)).is_none(), "one peer has its own places only");
        held.extend((0..2).map(|_| places.take(host(2)).unwrap()));
        assert!(places.take(host(3)).is_none(), "the others share theirs");
        held.extend((0..3).map(|_| places.take(own).unwrap()));
        assert!(places.take(own).is_none());
        assert_eq!(places.count(), 8);
        held.truncate(4);
        assert!(places.take(host(3)).is_some() && places.take(own).is_some());
        drop(held);
        assert_eq!(places.count(), 0);
    }

    #[test]
    fn the_row_of_the_other_end_is_not_taken() {
        let table = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid\n\
            0: 0100007F:1BCD 0100007F:9C40 01 00000000:00000000 00:00000000 00000000  1000 0 1\n\
            1: 0100007F:9C40 0100007F:1BCD 01 00000000:00000000 00:00000000 00000000  1001 0 2\n\
            2: torn\n";
        let (client, server) = ("127.0.0.1:40000".parse().unwrap(), "127.0.0.1:7117".parse().unwrap());
        assert_eq!(uid_in(table, client, server), Some(1001));
        assert_eq!(uid_in(table, server, client), Some(1000));
        assert_eq!(uid_in(table, client, "127.0.0.1:7118".parse().unwrap()), None);
    }
}
