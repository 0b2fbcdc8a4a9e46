//! The connection to a scanner: a serial line or TCP, never blocking.

use std::io;
use std::net::{SocketAddr, ToSocketAddrs};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::Path;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FlockOperation, Mode, OFlags, flock, open};
use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketFlags, SocketType, connect, socket_with, sockopt};
use rustix::termios::{ControlModes, InputModes, OptionalActions, isatty, tcgetattr, tcsetattr};

use crate::place::ScannerPlace;

/// What a read has brought.
#[derive(Debug)]
pub(crate) enum Read {
    Bytes(usize),
    Nothing,
    Closed(io::Error),
}

/// An open device, or a connection that is made or being made.
#[derive(Debug)]
pub(crate) struct Link {
    descriptor: OwnedFd,
    is_made: bool,
    /// Addresses of the name that are still to be tried.
    others: std::vec::IntoIter<SocketAddr>,
}

impl Link {
    /// Opens a device, or begins a connection.
    ///
    /// # Errors
    /// A device that can't be opened or is no serial line, and a name that can't be resolved.
    pub(crate) fn open(place: &ScannerPlace, bit_rate: u32) -> io::Result<Self> {
        match place {
            ScannerPlace::Device(path) => {
                let others = Vec::new().into_iter();
                Ok(Self { descriptor: open_device(path, bit_rate)?, is_made: true, others })
            }
            ScannerPlace::Tcp(name) => Self::to(name.to_socket_addrs()?.collect()),
        }
    }

    /// Begins a connection to the first of these addresses that answers.
    fn to(addresses: Vec<SocketAddr>) -> io::Result<Self> {
        let mut others = addresses.into_iter();
        let unknown = io::Error::new(io::ErrorKind::NotFound, "the name has no address");
        Ok(Self { descriptor: begin_next(&mut others, unknown)?, is_made: false, others })
    }

    /// Whether the connection is made. Where an address refuses it, the next one of the name is tried.
    ///
    /// # Errors
    /// A connection that was refused by all addresses.
    pub(crate) fn is_made(&mut self) -> io::Result<bool> {
        if !self.is_made && self.wait(0, PollFlags::OUT)? {
            if let Err(refused) = sockopt::socket_error(&self.descriptor)? {
                self.try_next(refused.into())?;
                return Ok(false);
            }
            sockopt::set_tcp_nodelay(&self.descriptor, true)?;
            self.is_made = true;
        }
        Ok(self.is_made)
    }

    /// Gives up the connection that is being made for this reason, and begins one to the next address of the name.
    ///
    /// # Errors
    /// The reason why no address was reached: the last one.
    pub(crate) fn try_next(&mut self, reason: io::Error) -> io::Result<()> {
        self.descriptor = begin_next(&mut self.others, reason)?;
        Ok(())
    }

    /// Waits until bytes can be read, or a connection is made, but not longer than `limit_ns`.
    ///
    /// # Errors
    /// Errors of the system.
    pub(crate) fn wait_for_input(&self, limit_ns: u64) -> io::Result<bool> {
        self.wait(limit_ns, if self.is_made { PollFlags::IN } else { PollFlags::OUT })
    }

    fn wait(&self, limit_ns: u64, flags: PollFlags) -> io::Result<bool> {
        let limit_ns = limit_ns.min(i64::MAX as u64).cast_signed();
        let limit = Timespec { tv_sec: limit_ns / 1_000_000_000, tv_nsec: limit_ns % 1_000_000_000 };
        match poll(&mut [PollFd::new(&self.descriptor, flags)], Some(&limit)) {
            Ok(ready) => Ok(ready > 0),
            Err(Errno::INTR) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    pub(crate) fn read(&self, buffer: &mut [u8]) -> Read {
        match rustix::io::read(&self.descriptor, buffer) {
            Ok(0) => Read::Closed(io::Error::new(io::ErrorKind::UnexpectedEof, "closed by the scanner")),
            Ok(count) => Read::Bytes(count),
            Err(Errno::AGAIN | Errno::INTR) => Read::Nothing,
            Err(error) => Read::Closed(error.into()),
        }
    }

    /// Writes what is possible now; returns the number of bytes.
    ///
    /// # Errors
    /// A connection that is lost.
    pub(crate) fn write(&self, bytes: &[u8]) -> io::Result<usize> {
        match rustix::io::write(&self.descriptor, bytes) {
            Ok(count) => Ok(count),
            Err(Errno::AGAIN | Errno::INTR) => Ok(0),
            Err(error) => Err(error.into()),
        }
    }
}

impl AsFd for Link {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.descriptor.as_fd()
    }
}

fn open_device(path: &Path, bit_rate: u32) -> io::Result<OwnedFd> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let descriptor = open(path, flags, Mode::empty())?;
    if !isatty(&descriptor) {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "is no serial line"));
    }
    // Two readers would each get a part of the bytes.
    flock(&descriptor, FlockOperation::NonBlockingLockExclusive).map_err(|error| match error {
        Errno::WOULDBLOCK => io::Error::new(io::ErrorKind::ResourceBusy, "is used by another process"),
        error => error.into(),
    })?;
    let mut modes = tcgetattr(&descriptor)?;
    modes.make_raw();
    modes.input_modes -= InputModes::IXON | InputModes::IXOFF;
    modes.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
    modes.control_modes -= ControlModes::CRTSCTS;
    modes.set_speed(bit_rate)?;
    tcsetattr(&descriptor, OptionalActions::Flush, &modes)?;
    Ok(descriptor)
}

/// Begins a connection to the first of the addresses for which that is possible; the others remain.
///
/// # Errors
/// `failed`, or why no connection could be begun.
fn begin_next(addresses: &mut std::vec::IntoIter<SocketAddr>, mut failed: io::Error) -> io::Result<OwnedFd> {
    for address in addresses {
        match begin_connection(&address) {
            Ok(descriptor) => return Ok(descriptor),
            Err(error) => failed = error,
        }
    }
    Err(failed)
}

fn begin_connection(address: &SocketAddr) -> io::Result<OwnedFd> {
    let family = if address.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
    let descriptor = socket_with(family, SocketType::STREAM, flags, None)?;
    match connect(&descriptor, address) {
        Ok(()) | Err(Errno::INPROGRESS) => Ok(descriptor),
        Err(error) => Err(error.into()),
    }
}

#[cfg(test)]
mod tests {
    use std::net::{Ipv4Addr, TcpListener};

    use super::*;

    fn listener() -> (TcpListener, SocketAddr) {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let address = listener.local_addr().unwrap();
        (listener, address)
    }

    /// Waits until a connection is made or refused.
    fn made(link: &mut Link) -> io::Result<()> {
        while !link.is_made()? {
            link.wait_for_input(10_000_000)?;
        }
        Ok(())
    }

    #[test]
    fn every_address_of_a_name_is_tried_in_turn() {
        let closed = [listener().1, listener().1];
        let (open, address) = listener();
        let mut link = Link::to(vec![closed[0], closed[1], address]).unwrap();
        made(&mut link).unwrap();
        assert!(open.accept().is_ok());
        let refused = Link::to(closed.to_vec()).and_then(|mut link| made(&mut link)).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::ConnectionRefused);
        assert_eq!(Link::to(Vec::new()).unwrap_err().to_string(), "the name has no address");
    }

    #[test]
    fn a_connection_that_is_given_up_goes_on_with_the_next_address() {
        let [(silent, first), (open, second)] = [listener(), listener()];
        let mut link = Link::to(vec![first, second]).unwrap();
        let late = || io::Error::new(io::ErrorKind::TimedOut, "late");
        link.try_next(late()).unwrap();
        made(&mut link).unwrap();
        assert!(open.accept().is_ok());
        assert_eq!(link.try_next(late()).unwrap_err().kind(), io::ErrorKind::TimedOut);
        drop(silent);
    }
}
