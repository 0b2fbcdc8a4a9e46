//! An emulated scanner on a TCP port or a pseudo terminal.

use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd, OwnedFd};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use crate::emulator::ScannerEmulator;

/// The host's end, as far as it is there.
#[derive(Debug)]
enum Line {
    /// Waits for a connection, or has one.
    Tcp(TcpListener, Option<TcpStream>),
    /// The end of the emulator, and the other one, which stays open so that a host may come and go.
    Terminal { own: OwnedFd, _other: OwnedFd },
}

/// An emulated scanner with its line. Call [`Port::serve`] again and again.
#[derive(Debug)]
pub struct Port {
    line: Line,
    /// The scanner.
    pub emulator: ScannerEmulator,
}

impl Port {
    /// A scanner that accepts one TCP connection at a time.
    ///
    /// # Errors
    /// An address that can't be used.
    pub fn tcp(address: &str, emulator: ScannerEmulator) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Self { line: Line::Tcp(listener, None), emulator })
    }

    /// A scanner on a pseudo terminal; returns the device for the host as well.
    ///
    /// # Errors
    /// A system without free pseudo terminals.
    pub fn terminal(emulator: ScannerEmulator) -> io::Result<(Self, String)> {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let own = openpt(flags)?;
        grantpt(&own)?;
        unlockpt(&own)?;
        rustix::io::ioctl_fionbio(&own, true)?;
        let name = ptsname(&own, Vec::new())?.to_string_lossy().into_owned();
        let other = rustix::pty::ioctl_tiocgptpeer(&own, flags)?;
        let mut modes = tcgetattr(&other)?;
        modes.make_raw();
        tcsetattr(&other, OptionalActions::Now, &modes)?;
        Ok((Self { line: Line::Terminal { own, _other: other }, emulator }, name))
    }

    /// The address of a TCP port.
    pub fn address(&self) -> Option<SocketAddr> {
        match &self.line {
            Line::Tcp(listener, _) => listener.local_addr().ok(),
            Line::Terminal { .. } => None,
        }
    }

    /// Ends the connection; a host may connect again.
    pub fn disconnect(&mut self) {
        if let Line::Tcp(_, stream) = &mut self.line {
            *stream = None;
        }
    }

    /// Waits for bytes of the host until a scan is due, but not longer than `limit_ns`, and sends what is to be sent.
    /// `now_ns` reads a clock.
    ///
    /// # Errors
    /// Errors of the system; an end of the connection is none.
    pub fn serve(&mut self, limit_ns: u64, now_ns: fn() -> u64) -> io::Result<()> {
        let begin_ns = now_ns();
        let due_ns = self.emulator.due_ns().map_or(limit_ns, |due_ns| due_ns.saturating_sub(begin_ns));
        self.wait(due_ns.min(limit_ns))?;
        if let Line::Tcp(listener, stream @ None) = &mut self.line
            && let Ok((accepted, _)) = listener.accept()
        {
            accepted.set_nonblocking(true)?;
            accepted.set_nodelay(true)?;
            *stream = Some(accepted);
        }
        self.read(now_ns());
        self.emulator.advance(now_ns());
        self.write();
        Ok(())
    }

    fn wait(&self, limit_ns: u64) -> io::Result<()> {
        let limit = Timespec {
            tv_sec: (limit_ns / 1_000_000_000).cast_signed(),
            tv_nsec: (limit_ns % 1_000_000_000).cast_signed(),
        };
        let descriptor = match &self.line {
            Line::Tcp(listener, None) => listener.as_fd(),
            Line::Tcp(_, Some(stream)) => stream.as_fd(),
            Line::Terminal { own, .. } => own.as_fd(),
        };
        match poll(&mut [PollFd::new(&descriptor, PollFlags::IN)], Some(&limit)) {
            Ok(_) | Err(Errno::INTR) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    fn read(&mut self, now_ns: u64) {
        let mut buffer = [0; 256];
        let read = match &self.line {
            Line::Tcp(_, None) => return,
            Line::Tcp(_, Some(stream)) => rustix::io::read(stream, &mut buffer[..]),
            Line::Terminal { own, .. } => rustix::io::read(own, &mut buffer[..]),
        };
        match read {
            Ok(0) => self.disconnect(),
            Ok(count) => self.emulator.receive(&buffer[..count], now_ns),
            Err(Errno::AGAIN | Errno::INTR) => {}
            Err(_) => self.disconnect(),
        }
    }

    fn write(&mut self) {
        let output = self.emulator.output();
        while !output.is_empty() {
            let written = match &self.line {
                // What a scanner sends without a connection is lost.
                Line::Tcp(_, None) => return output.clear(),
                Line::Tcp(_, Some(stream)) => rustix::io::write(stream, output.as_slices().0),
                Line::Terminal { own, .. } => rustix::io::write(own, output.as_slices().0),
            };
            match written {
                Ok(count) => drop(output.drain(..count)),
                Err(Errno::AGAIN | Errno::INTR) => return,
                Err(_) => return self.disconnect(),
            }
        }
    }
}
