//! Which user made a connection on this machine, from the kernel's table of connections.

use std::net::{IpAddr, SocketAddr};

/// User id of the process that connected `peer` to `local`; `None` for a connection that the kernel does not list here.
pub(crate) fn uid_of_peer(peer: SocketAddr, local: SocketAddr) -> Option<u32> {
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
            assert_eq!(uid_of_peer(peer, server.local_addr().unwrap()), Some(own), "{host}");
            assert_eq!(uid_of_peer("127.0.0.1:1".parse().unwrap(), client.local_addr().unwrap()), None);
        }
    }

    #[test]
    #[cfg(target_endian = "little")]
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
