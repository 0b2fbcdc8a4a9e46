//! Who made a connection: which user of this machine, as the kernel says, or which other machine.
//! Each has a limited number of places, so that none can take those of the others.

mod diag;

use std::net::{IpAddr, Shutdown, SocketAddr, TcpStream};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Who is at the other end of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Peer {
    /// A user of this machine.
    User(u32),
    /// Another machine, or a connection whose user the kernel does not know: one that it does not list, or that was closed.
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
    held: Mutex<Vec<Place>>,
    next: AtomicU64,
}

/// A place that a peer holds.
#[derive(Debug)]
struct Place {
    number: u64,
    peer: Peer,
    /// The connection, as long as nothing was asked over it.
    silent: Option<TcpStream>,
}

/// A place that is held; free again when it is dropped.
#[derive(Debug)]
pub(crate) struct Held(Arc<Places>, u64);

impl Places {
    /// No place is held.
    pub(crate) fn new(each: usize, others: usize) -> Arc<Self> {
        Arc::new(Self { each, others, held: Mutex::default(), next: AtomicU64::new(0) })
    }

    /// A place for this peer; `None` when it holds all that it may, or when the others together do.
    pub(crate) fn take(self: &Arc<Self>, peer: Peer) -> Option<Held> {
        let mut held = self.held();
        self.full(&held, peer).is_none().then(|| self.add(&mut held, peer, None))
    }

    /// A place for a new connection. Where none is free, the oldest connection over which nothing was asked yet is closed for
    /// it, one of the same peer or of the others together: however many a program opens, a click on Stop is heard.
    pub(crate) fn take_for(self: &Arc<Self>, peer: Peer, connection: &TcpStream) -> Option<Held> {
        let mut held = self.held();
        if let Some(is_among) = self.full(&held, peer) {
            let oldest =
                held.iter().position(|place| place.silent.is_some() && is_among(place.peer, peer))?;
            if let Some(silent) = held.remove(oldest).silent {
                let _ = silent.shutdown(Shutdown::Both);
            }
        }
        Some(self.add(&mut held, peer, connection.try_clone().ok()))
    }

    /// Whether a peer has no place left, and whose places are the ones in its way.
    fn full(&self, held: &[Place], peer: Peer) -> Option<fn(Peer, Peer) -> bool> {
        let others = held.iter().filter(|place| !is_own(place.peer)).count();
        let own = held.iter().filter(|place| place.peer == peer).count();
        if own >= self.each {
            return Some(|holder, peer| holder == peer);
        }
        (!is_own(peer) && others >= self.others).then_some(|holder, _| !is_own(holder))
    }

    fn add(self: &Arc<Self>, held: &mut Vec<Place>, peer: Peer, silent: Option<TcpStream>) -> Held {
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        held.push(Place { number, peer, silent });
        Held(Arc::clone(self), number)
    }

    fn held(&self) -> MutexGuard<'_, Vec<Place>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How many are held.
    #[cfg(test)]
    pub(crate) fn count(&self) -> usize {
        self.held().len()
    }
}

impl Held {
    /// Something was asked over its connection, which is not closed for another one any more.
    pub(crate) fn asked(&self) {
        if let Some(place) = self.0.held().iter_mut().find(|place| place.number == self.1) {
            place.silent = None;
        }
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.0.held().retain(|place| place.number != self.1);
    }
}

fn is_own(peer: Peer) -> bool {
    peer == Peer::User(rustix::process::geteuid().as_raw())
}

/// User id of the process that connected `peer` to `local`; `None` for a connection that the kernel does not list here, and for
/// one that is closed at that end: it is of no user any more, and the kernel shows that of root.
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
        let columns: Vec<&str> = row.split_ascii_whitespace().take(10).collect();
        // A socket that its process has closed has no inode.
        let is_it = columns.len() == 10
            && columns[9] != "0"
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
    use std::net::TcpListener;

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
            // What is closed is listed until the other end has closed it too, as one of root.
            drop(client);
            let found = [uid_of_peer(peer, local), uid_in_tables(peer, local)];
            assert_eq!(found, [None; 2], "{host}: its end is closed");
            assert_eq!(peer_of(peer, local), Peer::Host(peer.ip()), "{host}");
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
            2: 0100007F:9C41 0100007F:1BCD 05 00000000:00000000 00:00000000 00000000     0 0 0\n\
            3: torn\n";
        let (client, server) = ("127.0.0.1:40000".parse().unwrap(), "127.0.0.1:7117".parse().unwrap());
        assert_eq!(uid_in(table, client, server), Some(1001));
        assert_eq!(uid_in(table, server, client), Some(1000));
        assert_eq!(uid_in(table, "127.0.0.1:40001".parse().unwrap(), server), None, "closed");
        assert_eq!(uid_in(table, client, "127.0.0.1:7118".parse().unwrap()), None);
    }
}
