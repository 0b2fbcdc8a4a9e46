//! The connection between a process of the chain and the driver: a Unix socket with one message per line.
//!
//! It also ends the processes: when the driver closes it, or dies, they notice within a tenth of a second.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use rustix::net::{RecvFlags, recv};

use crate::{HopError, Setup};

/// An order of the driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriverOrder {
    /// The chain is connected: measure.
    Go,
    /// Report what has come so far.
    Finish,
    /// The chain is closed: end.
    Close,
}

/// A process's end of the connection.
#[derive(Debug)]
pub struct DriverConnection(UnixStream);

impl DriverConnection {
    /// Connects to the driver; call [`DriverConnection::hello`] when all ports are open.
    ///
    /// # Errors
    /// [`HopError::System`].
    pub fn connect(setup: &Setup) -> Result<Self, HopError> {
        let stream = UnixStream::connect(&setup.control).map_err(HopError::system("reach the driver"))?;
        Ok(Self(stream))
    }

    /// Tells the driver that this process has opened its ports.
    ///
    /// # Errors
    /// [`HopError::System`].
    pub fn hello(&mut self, setup: &Setup) -> Result<(), HopError> {
        self.send_line(&format!("hello {}", setup.index))
    }

    /// Sends a line.
    ///
    /// # Errors
    /// [`HopError::System`].
    pub fn send_line(&mut self, line: &str) -> Result<(), HopError> {
        self.0.write_all(format!("{line}\n").as_bytes()).map_err(HopError::system("tell the driver"))
    }

    /// Sends the latencies [ns], 0 for a message that was lost.
    ///
    /// # Errors
    /// [`HopError::System`].
    pub fn report(&mut self, latencies_ns: &[u64]) -> Result<(), HopError> {
        self.send_line(&format!("result {}", latencies_ns.len()))?;
        let bytes: Vec<u8> = latencies_ns.iter().flat_map(|latency| latency.to_le_bytes()).collect();
        self.0.write_all(&bytes).map_err(HopError::system("report to the driver"))
    }

    /// The next order of the driver; waits up to `timeout` for it.
    pub fn order(&mut self, timeout: Duration) -> Option<DriverOrder> {
        let mut letter = [0];
        let read = if timeout.is_zero() {
            recv(&self.0, &mut letter, RecvFlags::DONTWAIT).map(|(count, _)| count).map_err(Into::into)
        } else {
            self.0.set_read_timeout(Some(timeout)).and_then(|()| self.0.read(&mut letter))
        };
        match read {
            Ok(1) if letter[0] == b'g' => Some(DriverOrder::Go),
            Ok(1) if letter[0] == b'f' => Some(DriverOrder::Finish),
            Ok(_) => Some(DriverOrder::Close),
            Err(error) => {
                let nothing = [ErrorKind::WouldBlock, ErrorKind::TimedOut, ErrorKind::Interrupted];
                if nothing.contains(&error.kind()) { None } else { Some(DriverOrder::Close) }
            }
        }
    }

    /// Sleeps until the driver closes the chain: for a process whose library forwards the messages.
    pub fn wait_for_close(&mut self) {
        while self.order(Duration::from_secs(1)) != Some(DriverOrder::Close) {}
    }
}
