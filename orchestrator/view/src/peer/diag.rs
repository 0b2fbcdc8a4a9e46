//! Asks the kernel for one connection of this machine: `NETLINK_SOCK_DIAG`, see sock_diag(7).

use std::io;
use std::net::{IpAddr, SocketAddr};

use rustix::io::Errno;
use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketFlags, SocketType, netlink, recv, send, socket_with,
};

/// Type of the question and of its answer.
const SOCK_DIAG_BY_FAMILY: u16 = 20;
/// Type of an answer that is an error.
const NLMSG_ERROR: u16 = 2;
const NLM_F_REQUEST: u16 = 1;
const IPPROTO_TCP: u8 = 6;
/// Bytes of the header of a message.
const HEADER: usize = 16;
/// Places of the user id and of the inode in an answer [bytes].
const UID: usize = HEADER + 64;
const INODE: usize = UID + 4;

/// User id of the socket whose own address is `peer` and whose other end is `local`; `None` where there is none, and
/// where its process has closed it.
///
/// # Errors
/// A kernel that does not answer such questions.
pub(super) fn uid_of(peer: SocketAddr, local: SocketAddr) -> io::Result<Option<u32>> {
    let (kind, flags) = (SocketType::DGRAM, SocketFlags::CLOEXEC);
    let socket = socket_with(AddressFamily::NETLINK, kind, flags, Some(netlink::SOCK_DIAG))?;
    send(&socket, &question(peer, local), SendFlags::empty())?;
    let mut answer = [0; 512];
    // The kernel answers before the question returns.
    let (length, _) = recv(&socket, &mut answer[..], RecvFlags::DONTWAIT)?;
    read(&answer[..length])
}

fn read(answer: &[u8]) -> io::Result<Option<u32>> {
    let word =
        |at: usize| answer.get(at..at + 4).and_then(|four| four.try_into().ok()).map(u32::from_ne_bytes);
    let kind = answer.get(4..6).and_then(|two| two.try_into().ok()).map(u16::from_ne_bytes);
    match (kind, word(HEADER)) {
        (Some(SOCK_DIAG_BY_FAMILY), _) => Ok(word(UID).filter(|_| word(INODE) != Some(0))),
        (Some(NLMSG_ERROR), Some(code)) if code.cast_signed() == -Errno::NOENT.raw_os_error() => Ok(None),
        _ => Err(io::ErrorKind::Unsupported.into()),
    }
}

/// The question: a header, what is asked for, and both ends of the connection.
fn question(peer: SocketAddr, local: SocketAddr) -> Vec<u8> {
    let family = if peer.ip().to_canonical().is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let mut body = vec![family.as_raw() as u8, IPPROTO_TCP, 0, 0];
    // In any state.
    body.extend(u32::MAX.to_ne_bytes());
    body.extend(peer.port().to_be_bytes());
    body.extend(local.port().to_be_bytes());
    body.extend(address(peer.ip()));
    body.extend(address(local.ip()));
    // On any interface, and without the number that the kernel gave to the socket.
    body.extend([0_u32, u32::MAX, u32::MAX].iter().flat_map(|word| word.to_ne_bytes()));
    let mut message = ((HEADER + body.len()) as u32).to_ne_bytes().to_vec();
    message.extend(SOCK_DIAG_BY_FAMILY.to_ne_bytes());
    message.extend(NLM_F_REQUEST.to_ne_bytes());
    message.extend([0; 8]);
    message.extend(body);
    message
}

/// 16 bytes, of which an IPv4 address uses the first four.
fn address(ip: IpAddr) -> [u8; 16] {
    let mut bytes = [0; 16];
    match ip.to_canonical() {
        IpAddr::V4(ip) => bytes[..4].copy_from_slice(&ip.octets()),
        IpAddr::V6(ip) => bytes = ip.octets(),
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{TcpListener, TcpStream};

    #[test]
    fn one_connection_is_found_and_another_port_is_none() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let _client = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (server, peer) = listener.accept().unwrap();
        let local = server.local_addr().unwrap();
        // A kernel without this answers with an error, and the table is read.
        let Ok(found) = uid_of(peer, local) else { return };
        assert_eq!(found, Some(rustix::process::geteuid().as_raw()));
        assert_eq!(uid_of("127.0.0.1:1".parse().unwrap(), local).unwrap(), None);
    }

    #[test]
    fn what_is_no_answer_is_an_error() {
        for bytes in [&[][..], &[0; 15], &[0; 40]] {
            assert!(read(bytes).is_err() || read(bytes).unwrap().is_none(), "{bytes:?}");
        }
    }
}
