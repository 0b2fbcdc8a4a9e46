//! The connection to a scanner: a serial line or TCP, never blocking.

use std::io;
use std::net::ToSocketAddrs;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::Path;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FlockOperation, Mode, OFlags, flock, open};
use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketFlags, SocketType, connect, socket_with, sockopt};
use rustix::termios::{ControlModes, InputModes, OptionalActions, isatty, tcgetattr, tcsetattr};

use crate::place::Place;

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
}

impl Link {
    /// Opens a device, or begins a connection.
    ///
    /// # Errors
    /// A device that can't be opened or is no serial line, and a name that can't be resolved.
    pub(crate) fn open(place: &Place, bit_rate: u32) -> io::Result<Self> {
        match place {
            Place::Device(path) => Ok(Self { descriptor: open_device(path, bit_rate)?, is_made: true }),
            Place::Tcp(address) => Ok(Self { descriptor: begin_connection(address)?, is_made: false }),
        }
    }

    /// Whether the connection is made.
    ///
    /// # Errors
    /// A connection that was refused.
    pub(crate) fn is_made(&mut self) -> io::Result<bool> {
        if !self.is_made && self.wait(0, PollFlags::OUT)? {
            sockopt::socket_error(&self.descriptor)??;
            sockopt::set_tcp_nodelay(&self.descriptor, true)?;
            self.is_made = true;
        }
        Ok(self.is_made)
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

fn begin_connection(address: &str) -> io::Result<OwnedFd> {
    let unknown = || io::Error::new(io::ErrorKind::NotFound, "the name has no address");
    let address = address.to_socket_addrs()?.next().ok_or_else(unknown)?;
    let family = if address.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
    let descriptor = socket_with(family, SocketType::STREAM, flags, None)?;
    match connect(&descriptor, &address) {
        Ok(()) | Err(Errno::INPROGRESS) => Ok(descriptor),
        Err(error) => Err(error.into()),
    }
}
