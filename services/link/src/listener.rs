//! The socket that an agent listens with: whether it is read, and what the kernel drops there.
//!
//! Zenoh reads all connections over UDP in one task, which waits for the reader of each. Where that has ended, because the
//! connection has, the task waits for ever, and no other end can connect any more. So the kernel is asked whether datagrams wait.
//!
//! After an empty datagram Zenoh pauses, as after a failure of the socket: those who send some would keep all others out. So the
//! kernel drops them.

use std::net::SocketAddr;

use runtime::{Priority, drop_empty_datagrams, monotonic_ns, print};

/// A socket whose datagrams have waited for this long without a break is not read [ns].
const STUCK_NS: u64 = 1_000_000_000;
/// Further datagrams that were dropped are told after this time [ns].
const AGAIN_NS: u64 = 60_000_000_000;

/// The listening socket of an agent over UDP.
pub(crate) struct Listener {
    port: u16,
    /// Since when datagrams wait [ns].
    waiting_ns: Option<u64>,
    /// How many dropped datagrams were told last, and when [ns].
    told: (u64, Option<u64>),
}

impl Listener {
    /// The socket of an endpoint, at which empty datagrams are dropped from now on; `None` with other transports than UDP.
    pub(crate) fn of(endpoint: &str) -> Option<Self> {
        let address = endpoint.strip_prefix("udp/")?.split(['?', '#']).next()?;
        let port = address.parse::<SocketAddr>().ok()?.port();
        if let Err(error) = drop_empty_datagrams(port) {
            let message = format!("empty datagrams to port {port} are not dropped: {error}");
            print(Priority::Warning, &message);
        }
        Some(Self { port, waiting_ns: None, told: (0, None) })
    }

    /// Whether it is not read; to be asked several times a second. Tells what was dropped.
    pub(crate) fn is_stuck(&mut self) -> bool {
        let (counts, now_ns) = (self.counts(), monotonic_ns());
        if self.tells(counts.dropped, now_ns) {
            let message = format!(
                "{} datagrams to port {} were dropped: they were empty, or too many at a time",
                counts.dropped, self.port
            );
            print(Priority::Warning, &message);
        }
        self.is_stuck_at(counts.waiting_bytes, now_ns)
    }

    fn counts(&self) -> Counts {
        let tables = ["/proc/self/net/udp", "/proc/self/net/udp6"];
        let tables = tables.iter().filter_map(|path| std::fs::read_to_string(path).ok());
        tables.map(|table| counts(&table, self.port)).fold(Counts::default(), Counts::plus)
    }

    fn is_stuck_at(&mut self, waiting_bytes: u64, now_ns: u64) -> bool {
        self.waiting_ns = (waiting_bytes > 0).then(|| self.waiting_ns.unwrap_or(now_ns));
        self.waiting_ns.is_some_and(|since_ns| now_ns.saturating_sub(since_ns) > STUCK_NS)
    }

    /// Whether more have been dropped than were told, not a moment ago.
    fn tells(&mut self, dropped: u64, now_ns: u64) -> bool {
        let (before, at_ns) = self.told;
        let tells = dropped > before && at_ns.is_none_or(|at_ns| now_ns.saturating_sub(at_ns) > AGAIN_NS);
        if tells {
            self.told = (dropped, Some(now_ns));
        }
        tells
    }
}

/// What the kernel counts at sockets.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Counts {
    /// Bytes that wait.
    waiting_bytes: u64,
    /// Datagrams that were dropped since the start.
    dropped: u64,
}

impl Counts {
    fn plus(self, other: Self) -> Self {
        Self {
            waiting_bytes: self.waiting_bytes + other.waiting_bytes,
            dropped: self.dropped + other.dropped,
        }
    }
}

/// What is counted at the sockets of a port, from the table of the kernel. A row is, after a number: own address, other address,
/// state, the bytes to be sent and received, seven more, and the number of dropped datagrams.
fn counts(table: &str, port: u16) -> Counts {
    let of_row = |row: &str| {
        let mut columns = row.split_whitespace().skip(1);
        let own = u16::from_str_radix(columns.next()?.rsplit_once(':')?.1, 16).ok()?;
        let (_, received) = columns.nth(2)?.split_once(':')?;
        let waiting_bytes = u64::from_str_radix(received, 16).ok().filter(|_| own == port)?;
        let dropped = columns.nth(7).and_then(|count| count.parse().ok()).unwrap_or(0);
        Some(Counts { waiting_bytes, dropped })
    };
    table.lines().skip(1).filter_map(of_row).fold(Counts::default(), Counts::plus)
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;

    use super::*;

    #[test]
    fn datagrams_that_are_not_read_are_noticed_after_a_second_and_empty_ones_are_dropped_and_counted() {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = socket.local_addr().unwrap();
        let mut listener = Listener::of(&format!("udp/{address}?rel=0")).unwrap();
        assert_eq!(listener.counts(), Counts::default());
        (0..3).for_each(|_| _ = socket.send_to(&[], address).unwrap());
        assert_eq!(listener.counts(), Counts { waiting_bytes: 0, dropped: 3 });
        socket.send_to(&[7; 100], address).unwrap();
        assert!(listener.counts().waiting_bytes >= 100);
        assert!(!listener.is_stuck(), "it may be read in a moment");
        assert_eq!(listener.told.0, 3);
        socket.recv(&mut [0; 100]).unwrap();
        assert_eq!(listener.counts().waiting_bytes, 0);
        for (bytes, now_ns, is_stuck) in
            [(9, 100, false), (9, STUCK_NS, false), (0, STUCK_NS + 50, false), (9, STUCK_NS + 60, false)]
        {
            assert_eq!(listener.is_stuck_at(bytes, now_ns), is_stuck, "{bytes} {now_ns}");
        }
        assert!(listener.is_stuck_at(9, 2 * STUCK_NS + 61));
        assert!(Listener::of("quic/127.0.0.1:7411?rel=0").is_none());
        listener.told = (0, None);
        let tells = [(0, 1), (2, 1), (5, 2), (5, AGAIN_NS + 2), (5, 3 * AGAIN_NS)];
        assert_eq!(
            tells.map(|(dropped, now_ns)| listener.tells(dropped, now_ns)),
            [false, true, false, true, false]
        );
    }
}
