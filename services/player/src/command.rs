//! The messages that a client sends: requests to the server and its devices, and commands for the wheels.

use crate::header::{DeviceAddress, HEADER, MessageHeader, interface, kind};
use crate::xdr::{Malformed, XdrReader, put_f64s, put_text, put_u32};

/// Access to a device that is asked for, and that was given.
pub mod access {
    /// Open it.
    pub const OPEN: u32 = 1;
    /// Close it.
    pub const CLOSE: u32 = 2;
    /// The driver of the device could not be started.
    pub const ERROR: u32 = 3;
}

/// How the server delivers data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeliveryMode {
    /// Everything at once.
    Push = 1,
    /// What is queued, when the client asks.
    Pull = 2,
}

/// What the server does with data that a rule is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum QueueRule {
    /// A newer message replaces an older one in the queue.
    Replace = 1,
    /// Such messages are not sent.
    Ignore = 2,
}

/// A message that a client sends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ClientMessage {
    /// The list of all devices.
    Devices,
    /// The name of the driver of a device.
    DriverInfo(DeviceAddress),
    /// Opens or closes a device.
    Subscribe(DeviceAddress, u32),
    /// A round of data, in pull mode.
    Round,
    /// The delivery of data.
    Deliver(DeliveryMode),
    /// What is done with data of this device and subtype; `None` is any device, and any subtype.
    Queue(Option<(DeviceAddress, u32)>, QueueRule),
    /// The geometry of a device.
    Geometry(DeviceAddress),
    /// The configuration of a scanner.
    Configuration(DeviceAddress),
    /// Power of the motors on or off.
    MotorPower(DeviceAddress, bool),
    /// Sets the pose that the odometry reports: x, y, yaw [m, m, rad].
    SetOdometry(DeviceAddress, [f64; 3]),
    /// Drives with velocities ahead, left and counter-clockwise [m/s, m/s, rad/s].
    Velocity(DeviceAddress, [f64; 3]),
    /// Drives like a car, with a velocity and a steering angle, left positive [m/s, rad].
    Car(DeviceAddress, [f64; 2]),
}

/// Any interface, index or subtype in a rule.
const ANY: u32 = u32::MAX;

impl ClientMessage {
    /// Appends the message. `time_s` and `sequence` are free; the server repeats the sequence of its own answers.
    pub fn write(&self, bytes: &mut Vec<u8>, time_s: f64, sequence: u32) {
        let (device, kind, subtype) = self.address();
        let start = bytes.len();
        MessageHeader { host: 0, robot: 0, device, kind, subtype, time_s, sequence, size: 0 }.write(bytes);
        self.payload(bytes);
        let size = (bytes.len() - start - HEADER) as u32;
        bytes[start + HEADER - 4..start + HEADER].copy_from_slice(&size.to_be_bytes());
    }

    /// Device, kind and subtype; an answer repeats device and subtype.
    pub fn address(&self) -> (DeviceAddress, u32, u32) {
        let server = |subtype| (DeviceAddress::SERVER, kind::REQUEST, subtype);
        match *self {
            Self::Devices => server(1),
            Self::DriverInfo(_) => server(2),
            Self::Subscribe(..) => server(3),
            Self::Round => server(4),
            Self::Deliver(_) => server(5),
            Self::Queue(..) => server(10),
            Self::Geometry(device) => (device, kind::REQUEST, 1),
            Self::Configuration(device) => {
                let subtype = if device.interface == interface::LASER { 3 } else { 5 };
                (device, kind::REQUEST, subtype)
            }
            Self::MotorPower(device, _) => (device, kind::REQUEST, 2),
            Self::SetOdometry(device, _) => (device, kind::REQUEST, 5),
            Self::Velocity(device, _) => (device, kind::COMMAND, 1),
            Self::Car(device, _) => (device, kind::COMMAND, 3),
        }
    }

    fn payload(&self, bytes: &mut Vec<u8>) {
        match *self {
            Self::Devices | Self::Round | Self::Geometry(_) | Self::Configuration(_) => {}
            Self::DriverInfo(device) => {
                put_address(bytes, device);
                put_text(bytes, &[]);
            }
            Self::Subscribe(device, access) => {
                put_address(bytes, device);
                put_u32(bytes, access);
                put_text(bytes, &[]);
            }
            Self::Deliver(mode) => put_u32(bytes, mode as u32),
            Self::Queue(of, rule) => {
                let (interface, index, subtype) =
                    of.map_or((ANY, ANY, ANY), |(device, subtype)| (device.interface, device.index, subtype));
                for number in [interface, index, kind::DATA, subtype, rule as u32] {
                    put_u32(bytes, number);
                }
            }
            Self::MotorPower(_, on) => put_u32(bytes, u32::from(on)),
            Self::SetOdometry(_, pose) => put_f64s(bytes, &pose),
            Self::Velocity(_, velocities) => {
                put_f64s(bytes, &velocities);
                // Motors on.
                put_u32(bytes, 1);
            }
            Self::Car(_, values) => put_f64s(bytes, &values),
        }
    }
}

/// A device as the payload of a request names it: host and port of the server are left open.
fn put_address(bytes: &mut Vec<u8>, device: DeviceAddress) {
    for number in [0, 0, device.interface, device.index] {
        put_u32(bytes, number);
    }
}

impl ClientMessage {
    /// The command in a message of a client: for servers. `None` when it is another one.
    ///
    /// # Errors
    /// A payload that is not what the header promises.
    pub fn read(header: &MessageHeader, payload: &[u8]) -> Result<Option<Self>, Malformed> {
        let MessageHeader { device, kind, subtype, .. } = *header;
        let mut reader = XdrReader::new(payload);
        let command = match (device.interface, kind, subtype) {
            (interface::PLAYER, kind::REQUEST, 1) => Self::Devices,
            (interface::PLAYER, kind::REQUEST, 2) => {
                let of = address(&mut reader)?;
                reader.text()?;
                Self::DriverInfo(of)
            }
            (interface::PLAYER, kind::REQUEST, 3) => {
                let (of, access) = (address(&mut reader)?, reader.u32()?);
                reader.text()?;
                Self::Subscribe(of, access)
            }
            (interface::PLAYER, kind::REQUEST, 4) => Self::Round,
            (interface::PLAYER, kind::REQUEST, 5) => {
                Self::Deliver(if reader.u32()? == DeliveryMode::Pull as u32 {
                    DeliveryMode::Pull
                } else {
                    DeliveryMode::Push
                })
            }
            (interface::PLAYER, kind::REQUEST, 10) => {
                let of = DeviceAddress { interface: reader.u32()?, index: reader.u32()? };
                let (_kind, subtype) = (reader.u32()?, reader.u32()?);
                let rule = if reader.u32()? == QueueRule::Ignore as u32 {
                    QueueRule::Ignore
                } else {
                    QueueRule::Replace
                };
                Self::Queue((of.interface != ANY).then_some((of, subtype)), rule)
            }
            (interface::POSITION2D, kind::REQUEST, 2) => Self::MotorPower(device, reader.u32()? != 0),
            (interface::POSITION2D, kind::REQUEST, 5) => Self::SetOdometry(device, reader.f64s()?),
            (interface::POSITION2D, kind::COMMAND, 1) => {
                let velocities = reader.f64s()?;
                reader.u32()?;
                Self::Velocity(device, velocities)
            }
            (interface::POSITION2D, kind::COMMAND, 3) => Self::Car(device, reader.f64s()?),
            (interface::POSITION2D | interface::RANGER | interface::LASER, kind::REQUEST, 1) => {
                Self::Geometry(device)
            }
            (interface::RANGER, kind::REQUEST, 5) | (interface::LASER, kind::REQUEST, 3) => {
                Self::Configuration(device)
            }
            _ => return Ok(None),
        };
        reader.end().map(|()| Some(command))
    }
}

fn address(reader: &mut XdrReader<'_>) -> Result<DeviceAddress, Malformed> {
    reader.take(8)?;
    Ok(DeviceAddress { interface: reader.u32()?, index: reader.u32()? })
}
