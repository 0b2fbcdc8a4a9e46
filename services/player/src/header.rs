//! The header of 40 bytes before each message, and the codes in it.

use crate::xdr::{Malformed, XdrReader, put_f64s, put_u32};

/// Size of a header [bytes].
pub const HEADER: usize = 40;

/// The kind of a message.
pub mod kind {
    /// Measured data, from the server.
    pub const DATA: u32 = 1;
    /// A command, which has no answer.
    pub const COMMAND: u32 = 2;
    /// A request.
    pub const REQUEST: u32 = 3;
    /// The request was done.
    pub const ACK: u32 = 4;
    /// The end of a round of data in pull mode.
    pub const SYNCH: u32 = 5;
    /// The request was refused.
    pub const NACK: u32 = 6;
}

/// Codes of the interfaces that this client knows.
pub mod interface {
    /// The server itself.
    pub const PLAYER: u32 = 1;
    /// The base with its wheels.
    pub const POSITION2D: u32 = 4;
    /// A scanner by the older interface.
    pub const LASER: u32 = 6;
    /// A scanner.
    pub const RANGER: u32 = 62;
}

/// A device of the server: interface and index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeviceAddress {
    /// Code of the interface.
    pub interface: u32,
    /// Index among the devices of this interface.
    pub index: u32,
}

impl DeviceAddress {
    /// The server itself, which is always open.
    pub const SERVER: Self = Self { interface: interface::PLAYER, index: 0 };
}

impl std::fmt::Display for DeviceAddress {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.interface {
            interface::PLAYER => write!(formatter, "player:{}", self.index),
            interface::POSITION2D => write!(formatter, "position2d:{}", self.index),
            interface::LASER => write!(formatter, "laser:{}", self.index),
            interface::RANGER => write!(formatter, "ranger:{}", self.index),
            other => write!(formatter, "interface {other}:{}", self.index),
        }
    }
}

/// What precedes each payload.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MessageHeader {
    /// Address of the server; a client sends 0 and ignores what it receives.
    pub host: u32,
    /// Port of the server; a client may send 0.
    pub robot: u32,
    /// The device that the message is from or for.
    pub device: DeviceAddress,
    /// One of [`kind`].
    pub kind: u32,
    /// Number of the message within interface and kind.
    pub subtype: u32,
    /// Time of the server [s]. Uninitialised in messages of kind SYNCH.
    pub time_s: f64,
    /// Chosen by the client; only the server itself repeats it, drivers answer 0.
    pub sequence: u32,
    /// Size of the payload [bytes].
    pub size: u32,
}

impl MessageHeader {
    /// The header in its 40 bytes.
    ///
    /// # Errors
    /// [`Malformed::Short`] when there are less.
    pub fn read(bytes: &[u8]) -> Result<Self, Malformed> {
        let mut reader = XdrReader::new(bytes);
        Ok(Self {
            host: reader.u32()?,
            robot: reader.u32()?,
            device: DeviceAddress { interface: reader.u32()?, index: reader.u32()? },
            kind: reader.u32()?,
            subtype: reader.u32()?,
            time_s: reader.f64()?,
            sequence: reader.u32()?,
            size: reader.u32()?,
        })
    }

    /// Appends the header.
    pub fn write(&self, bytes: &mut Vec<u8>) {
        let Self { host, robot, device, kind, subtype, time_s, sequence, size } = *self;
        for number in [host, robot, device.interface, device.index, kind, subtype] {
            put_u32(bytes, number);
        }
        put_f64s(bytes, &[time_s]);
        put_u32(bytes, sequence);
        put_u32(bytes, size);
    }

    /// Whether a server may have sent this: codes of two bytes and one byte have four bytes on the wire.
    pub fn is_plausible(&self) -> bool {
        let DeviceAddress { interface, index } = self.device;
        (kind::DATA..=kind::NACK).contains(&self.kind)
            && interface <= u32::from(u16::MAX)
            && index <= u32::from(u16::MAX)
            && self.subtype <= u32::from(u8::MAX)
    }
}
