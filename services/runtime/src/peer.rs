//! Which user is at the other end of a socket.
#![expect(unsafe_code, reason = "rustix gives no peer of another pid namespace, whose process id is 0 here")]

use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;

/// User id of the process that made the connection, as the kernel saw it then.
///
/// # Errors
/// Those of the kernel, which do not happen to a connected socket.
pub fn peer_uid(stream: &UnixStream) -> io::Result<u32> {
    let mut peer = libc::ucred { pid: 0, uid: 0, gid: 0 };
    let mut length = size_of::<libc::ucred>() as libc::socklen_t;
    // SAFETY: `peer` is writable for `length` bytes, both outlive the call, and any bytes make a valid `ucred`.
    let result = unsafe {
        libc::getsockopt(
            stream.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_PEERCRED,
            (&raw mut peer).cast(),
            &raw mut length,
        )
    };
    if result == 0 { Ok(peer.uid) } else { Err(io::Error::last_os_error()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_other_end_of_a_pair_is_of_this_user() {
        let (near, _far) = UnixStream::pair().unwrap();
        assert_eq!(peer_uid(&near).unwrap(), rustix::process::geteuid().as_raw());
    }
}
