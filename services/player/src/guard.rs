//! The guard of the wheels, a process that owns the sending end of the connection to a Player server.
//!
//! When driver and guard are killed together, the server sees the closed connection.

use std::io::Write;
use std::net::{Shutdown, TcpStream};
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::process::Command;

use driver::guard::{Commands, GuardAct, GuardFault, Held};

use crate::command::ClientMessage;
use crate::config::DriveCommand;
use crate::header::{DeviceAddress, interface};

/// The arguments with which `scanloop` is a guard.
const ARGUMENTS: [&str; 2] = ["service", "player-guard"];

/// The base and the command that drives it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Base {
    /// Index of the position2d.
    pub index: u32,
    /// Its command.
    pub command: DriveCommand,
}

impl Base {
    /// One number for both, which the driver hands to the guard.
    fn number(self) -> u64 {
        u64::from(self.index) << 1 | u64::from(self.command == DriveCommand::Velocity)
    }

    /// The base of a number.
    fn of_number(number: u64) -> Self {
        let command = if number & 1 == 1 { DriveCommand::Velocity } else { DriveCommand::Car };
        Self { index: u32::try_from(number >> 1).unwrap_or(u32::MAX), command }
    }

    fn device(self) -> DeviceAddress {
        DeviceAddress { interface: interface::POSITION2D, index: self.index }
    }

    /// The message that drives.
    pub fn drive(self, numbers: [f64; 2]) -> ClientMessage {
        match self.command {
            DriveCommand::Car => ClientMessage::Car(self.device(), numbers),
            DriveCommand::Velocity => ClientMessage::Velocity(self.device(), [numbers[0], 0.0, numbers[1]]),
        }
    }

    /// Appends the messages that stop the wheels: in the form that drives, and as velocities, which each base knows.
    pub fn stop(self, bytes: &mut Vec<u8>) {
        self.drive([0.0; 2]).write(bytes, 0.0, 0);
        ClientMessage::Velocity(self.device(), [0.0; 3]).write(bytes, 0.0, 0);
    }

    /// Stops the wheels in place of the guard, which does not.
    pub(crate) fn stop_now(self, mut server: &TcpStream) {
        let mut bytes = Vec::new();
        self.stop(&mut bytes);
        let _ = server.write_all(&bytes);
    }
}

/// Starts the guard of a connection; `scanloop` is this program, or another one with its services.
pub(crate) fn start(
    scanloop: &Path,
    server: &TcpStream,
    base: Base,
    timeout_ns: u64,
) -> Result<Held, GuardFault> {
    let output = OwnedFd::from(server.try_clone().map_err(GuardFault::NotStarted)?);
    let mut command = Command::new(scanloop);
    command.args(ARGUMENTS).stdout(output);
    Held::start(command, base.number(), timeout_ns)
}

/// Runs until the driver has ended, and stops the wheels then.
///
/// # Errors
/// A start by hand, and a connection that cannot be written to; the wheels stop when the server sees it closed.
pub fn run() -> anyhow::Result<()> {
    let server = TcpStream::from(std::io::stdout().as_fd().try_clone_to_owned()?);
    let ended = driver::guard::run(|number| {
        Ok(Connection {
            server: server.try_clone()?,
            base: Base::of_number(number),
            bytes: Vec::with_capacity(256),
        })
    });
    if ended.is_err() {
        // The driver and the server see it.
        let _ = server.shutdown(Shutdown::Both);
    }
    ended
}

/// The sending end.
struct Connection {
    server: TcpStream,
    base: Base,
    bytes: Vec<u8>,
}

impl Commands for Connection {
    fn send(&mut self, act: GuardAct) -> std::io::Result<()> {
        self.bytes.clear();
        match act {
            GuardAct::Drive(numbers) => self.base.drive(numbers).write(&mut self.bytes, 0.0, 0),
            GuardAct::Stop => self.base.stop(&mut self.bytes),
            GuardAct::Round => ClientMessage::Round.write(&mut self.bytes, 0.0, 0),
            // The server stamps nothing that it receives.
            GuardAct::Offset(_) => {}
        }
        self.server.write_all(&self.bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_base_comes_back_from_its_number() {
        for command in [DriveCommand::Car, DriveCommand::Velocity] {
            let base = Base { index: 65_535, command };
            assert_eq!(Base::of_number(base.number()), base);
        }
    }

    #[test]
    fn a_stop_is_sent_in_the_form_that_drives_and_as_velocities() {
        let mut bytes = Vec::new();
        Base { index: 1, command: DriveCommand::Car }.stop(&mut bytes);
        let sizes = [56, 68];
        assert_eq!(bytes.len(), sizes[0] + sizes[1]);
        assert_eq!((bytes[15], bytes[23]), (1, 3), "CAR of position2d:1");
        assert_eq!(bytes[40..56], [0; 16]);
        assert_eq!((bytes[56 + 15], bytes[56 + 23]), (1, 1), "VEL of position2d:1");
        assert_eq!(bytes[96..120], [0; 24]);
    }
}
