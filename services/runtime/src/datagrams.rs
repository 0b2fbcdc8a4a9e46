//! Datagrams without content, which a library of the network takes for failures of its socket.
#![expect(
    unsafe_code,
    reason = "rustix attaches no filter to a socket, and the library lends none of its own"
)]

use std::io;
use std::net::SocketAddr;
use std::os::fd::{AsRawFd, BorrowedFd, OwnedFd};

use rustix::net::{RecvFlags, SocketType, getsockname, recv, sockopt};

/// Length of the header of UDP, with which a filter sees a datagram [bytes].
const HEADER: u32 = 8;

/// Has the kernel drop and count empty datagrams that come to the UDP sockets of this process at `port`. Those that wait there
/// are dropped as well, whatever they hold.
///
/// # Errors
/// Those of the kernel.
pub fn drop_empty_datagrams(port: u16) -> io::Result<()> {
    for entry in std::fs::read_dir("/proc/self/fd")? {
        let Some(number) = entry?.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        // SAFETY: the descriptor is used for one call only, which fails if another thread has closed it.
        let Ok(socket) = unsafe { BorrowedFd::borrow_raw(number) }.try_clone_to_owned() else { continue };
        let is_udp = sockopt::socket_type(&socket).is_ok_and(|kind| kind == SocketType::DGRAM);
        let address = getsockname(&socket).ok().and_then(|address| SocketAddr::try_from(address).ok());
        if is_udp && address.is_some_and(|address| address.port() == port) {
            attach(&socket)?;
            while recv(&socket, &mut [0; 1][..], RecvFlags::DONTWAIT).is_ok() {}
        }
    }
    Ok(())
}

fn attach(socket: &OwnedFd) -> io::Result<()> {
    let code = |words: u32| words as u16;
    let step = |code, jt, jf, k| libc::sock_filter { code, jt, jf, k };
    // Load the length; is it larger than a header? All of it, or nothing.
    let mut steps = [
        step(code(libc::BPF_LD | libc::BPF_W | libc::BPF_LEN), 0, 0, 0),
        step(code(libc::BPF_JMP | libc::BPF_JGT | libc::BPF_K), 0, 1, HEADER),
        step(code(libc::BPF_RET | libc::BPF_K), 0, 0, u32::MAX),
        step(code(libc::BPF_RET | libc::BPF_K), 0, 0, 0),
    ];
    let program = libc::sock_fprog { len: steps.len() as u16, filter: steps.as_mut_ptr() };
    // SAFETY: the program and its steps outlive the call, which copies them.
    let result = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_ATTACH_FILTER,
            (&raw const program).cast(),
            size_of_val(&program) as libc::socklen_t,
        )
    };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;

    use super::*;

    #[test]
    fn what_is_empty_does_not_arrive_and_what_is_not_arrives_whole() {
        for host in ["127.0.0.1:0", "[::1]:0"] {
            let Ok(socket) = UdpSocket::bind(host) else { continue };
            let address = socket.local_addr().unwrap();
            socket.send_to(&[], address).unwrap();
            drop_empty_datagrams(address.port()).unwrap();
            for content in [&b""[..], b"x", b"", b"whole", b""] {
                socket.send_to(content, address).unwrap();
            }
            let mut bytes = [0; 9];
            socket.set_nonblocking(true).unwrap();
            let mut next = || socket.recv(&mut bytes).ok().map(|length| bytes[..length].to_vec());
            assert_eq!([next(), next(), next()], [Some(b"x".to_vec()), Some(b"whole".to_vec()), None]);
        }
    }
}
