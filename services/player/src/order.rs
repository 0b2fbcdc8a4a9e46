//! What the driver tells its guard, and what the guard answers: frames of fixed size on a socket between the two.

use crate::command::ClientMessage;
use crate::config::DriveCommand;
use crate::header::{DeviceAddress, interface};

/// Size of a frame of the driver [bytes].
pub const FRAME: usize = 40;
/// Size of an answer [bytes].
pub const ANSWER: usize = 16;

/// What the driver orders.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GuardOrder {
    /// First of all: which base is guarded, how it is driven, and after how long without an order it is stopped [ns].
    Guard(Base, u64),
    /// Drive, with the numbers of the command.
    Drive([f64; 2]),
    /// Stop the wheels.
    Stop,
    /// Ask the server for a round of data.
    Round,
}

/// The base and the command that drives it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Base {
    /// Index of the position2d.
    pub index: u32,
    /// Its command.
    pub command: DriveCommand,
}

impl Base {
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
}

/// An order with its number and time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Counts up from 1.
    pub number: u64,
    /// When it was given, on CLOCK_MONOTONIC [ns].
    pub given_ns: u64,
    /// The order.
    pub order: GuardOrder,
}

impl Frame {
    /// The frame as bytes.
    pub fn to_bytes(self) -> [u8; FRAME] {
        let (kind, numbers) = match self.order {
            GuardOrder::Guard(base, timeout_ns) => {
                let command = u64::from(base.command == DriveCommand::Velocity);
                (1, [u64::from(base.index) << 1 | command, timeout_ns])
            }
            GuardOrder::Drive(numbers) => (2, numbers.map(f64::to_bits)),
            GuardOrder::Stop => (3, [0; 2]),
            GuardOrder::Round => (4, [0; 2]),
        };
        let mut bytes = [0; FRAME];
        let fields = [kind, self.number, self.given_ns, numbers[0], numbers[1]];
        for (place, field) in bytes.chunks_exact_mut(8).zip(fields) {
            place.copy_from_slice(&field.to_le_bytes());
        }
        bytes
    }

    /// The frame in these bytes; `None` for any other bytes.
    pub fn from_bytes(bytes: &[u8; FRAME]) -> Option<Self> {
        let [kind, number, given_ns, one, other] = words(bytes);
        let order = match kind {
            1 => {
                let command = if one & 1 == 1 { DriveCommand::Velocity } else { DriveCommand::Car };
                GuardOrder::Guard(Base { index: u32::try_from(one >> 1).ok()?, command }, other)
            }
            2 => GuardOrder::Drive([one, other].map(f64::from_bits)),
            3 => GuardOrder::Stop,
            4 => GuardOrder::Round,
            _ => return None,
        };
        Some(Self { number, given_ns, order })
    }
}

/// What the guard answers to each frame, and when it stops the wheels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GuardAnswer {
    /// Number of the newest order.
    pub number: u64,
    /// How often it has stopped the wheels because the driver was silent.
    pub stops: u64,
}

impl GuardAnswer {
    /// The answer as bytes.
    pub fn to_bytes(self) -> [u8; ANSWER] {
        let mut bytes = [0; ANSWER];
        bytes[..8].copy_from_slice(&self.number.to_le_bytes());
        bytes[8..].copy_from_slice(&self.stops.to_le_bytes());
        bytes
    }

    /// The answer in these bytes.
    pub fn from_bytes(bytes: &[u8; ANSWER]) -> Self {
        let [number, stops] = words(bytes);
        Self { number, stops }
    }
}

/// Little-endian words; those that are not there are zero.
fn words<const N: usize>(bytes: &[u8]) -> [u64; N] {
    let mut words = [0; N];
    for (word, bytes) in words.iter_mut().zip(bytes.chunks_exact(8)) {
        *word = bytes.iter().rev().fold(0, |word, byte| word << 8 | u64::from(*byte));
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_and_answers_come_back_as_they_were() {
        let base = Base { index: 65_535, command: DriveCommand::Velocity };
        for order in [
            GuardOrder::Guard(base, 200_000_000),
            GuardOrder::Drive([0.7, -0.05]),
            GuardOrder::Stop,
            GuardOrder::Round,
        ] {
            let frame = Frame { number: 3, given_ns: u64::MAX - 1, order };
            assert_eq!(Frame::from_bytes(&frame.to_bytes()), Some(frame));
        }
        assert_eq!(Frame::from_bytes(&[9; FRAME]), None);
        let answer = GuardAnswer { number: 1 << 60, stops: 2 };
        assert_eq!(GuardAnswer::from_bytes(&answer.to_bytes()), answer);
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
