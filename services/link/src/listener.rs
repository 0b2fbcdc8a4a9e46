//! Whether the socket that an agent listens with is read.
//!
//! Zenoh reads all connections over UDP in one task, which waits for the reader of each. Where that has ended, because the
//! connection has, the task waits for ever, and no other end can connect any more. So the kernel is asked whether datagrams wait.

use std::net::SocketAddr;

use runtime::monotonic_ns;

/// A socket whose datagrams have waited for this long without a break is not read [ns].
const STUCK_NS: u64 = 1_000_000_000;

/// The listening socket of an agent over UDP.
pub(crate) struct Listener {
    port: u16,
    /// Since when datagrams wait [ns].
    waiting_ns: Option<u64>,
}

impl Listener {
    /// The socket of an endpoint; `None` with other transports than UDP.
    pub(crate) fn of(endpoint: &str) -> Option<Self> {
        let address = endpoint.strip_prefix("udp/")?.split(['?', '#']).next()?;
        Some(Self { port: address.parse::<SocketAddr>().ok()?.port(), waiting_ns: None })
    }

    /// Whether it is not read; to be asked several times a second.
    pub(crate) fn is_stuck(&mut self) -> bool {
        let tables = ["/proc/self/net/udp", "/proc/self/net/udp6"];
        let waits = tables.iter().filter_map(|path| std::fs::read_to_string(path).ok());
        self.is_stuck_at(waits.map(|table| waiting_bytes(&table, self.port)).sum(), monotonic_ns())
    }

    fn is_stuck_at(&mut self, waiting_bytes: u64, now_ns: u64) -> bool {
        self.waiting_ns = (waiting_bytes > 0).then(|| self.waiting_ns.unwrap_or(now_ns));
        self.waiting_ns.is_some_and(|since_ns| now_ns.saturating_sub(since_ns) > STUCK_NS)
    }
}

/// Bytes that wait at sockets of a port, from the table of the kernel. A row is, after a number: own address, other address,
/// state, and the bytes to be sent and received.
fn waiting_bytes(table: &str, port: u16) -> u64 {
    let of_row = |row: &str| {
        let mut columns = row.split_whitespace().skip(1);
        let own = u16::from_str_radix(columns.next()?.rsplit_once(':')?.1, 16).ok()?;
        let (_, received) = columns.nth(2)?.split_once(':')?;
        u64::from_str_radix(received, 16).ok().filter(|_| own == port)
    };
    table.lines().skip(1).filter_map(of_row).sum()
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;

    use super::*;

    #[test]
    fn datagrams_that_are_not_read_are_noticed_after_a_second() {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = socket.local_addr().unwrap();
        let mut listener = Listener::of(&format!("udp/{address}?rel=0")).unwrap();
        let waiting =
            || waiting_bytes(&std::fs::read_to_string("/proc/self/net/udp").unwrap(), address.port());
        assert_eq!(waiting(), 0);
        socket.send_to(&[7; 100], address).unwrap();
        assert!(waiting() >= 100);
        assert!(!listener.is_stuck(), "it may be read in a moment");
        socket.recv(&mut [0; 100]).unwrap();
        assert_eq!(waiting(), 0);
        for (bytes, now_ns, is_stuck) in
            [(9, 100, false), (9, STUCK_NS, false), (0, STUCK_NS + 50, false), (9, STUCK_NS + 60, false)]
        {
            assert_eq!(listener.is_stuck_at(bytes, now_ns), is_stuck, "{bytes} {now_ns}");
        }
        assert!(listener.is_stuck_at(9, 2 * STUCK_NS + 61));
        assert!(Listener::of("quic/127.0.0.1:7411?rel=0").is_none());
    }
}
