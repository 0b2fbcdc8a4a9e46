//! The messages that a client receives: data of base and scanner, and answers to its requests.

use driver::beams::Fan;
use driver::motion::BaseState;

use crate::header::{DeviceAddress, MessageHeader, interface, kind};
use crate::xdr::{Malformed, Numbers, XdrReader};

/// Ranges of one sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RangeSweep<'a> {
    /// Ranges from the first beam to the last [m].
    pub ranges_m: Numbers<'a>,
    /// What the message tells about the beams; the interface ranger tells it by its configuration only.
    pub fan: Option<Fan>,
}

/// Why a device is not open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Subscription<'a> {
    /// The device.
    pub device: DeviceAddress,
    /// Access that was given.
    pub access: u32,
    /// Name of its driver, with the NUL of C.
    pub driver: &'a [u8],
}

/// A message from the server.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ServerMessage<'a> {
    /// The state of the base.
    State(BaseState),
    /// A sweep.
    Sweep(RangeSweep<'a>),
    /// Intensities of a sweep, which this client does not use.
    Intensities(Numbers<'a>),
    /// The answer to a request, with its payload.
    Answer {
        /// False for a refusal.
        accepted: bool,
        /// What the answer holds.
        payload: &'a [u8],
    },
    /// The end of a round in pull mode, with the number of messages that did not fit into the queue.
    RoundEnd(u32),
    /// A message of another interface, or of a number that this client does not know.
    Unknown,
}

impl<'a> ServerMessage<'a> {
    /// The message behind a header.
    ///
    /// # Errors
    /// A payload that is not what the header promises.
    pub fn read(header: &MessageHeader, payload: &'a [u8]) -> Result<Self, Malformed> {
        let MessageHeader { device: DeviceAddress { interface, .. }, kind, subtype, .. } = *header;
        let mut reader = XdrReader::new(payload);
        let message = match (interface, kind, subtype) {
            (_, kind::ACK | kind::NACK, _) => {
                return Ok(Self::Answer { accepted: kind == kind::ACK, payload });
            }
            (interface::PLAYER, kind::SYNCH, 1) => Self::RoundEnd(0),
            (interface::PLAYER, kind::SYNCH, 2) => Self::RoundEnd(reader.u32()?),
            (interface::POSITION2D, kind::DATA, 1) => {
                let (pose, velocity) = (reader.f64s()?, reader.f64s()?);
                Self::State(BaseState { pose, velocity, stalled: reader.u32()? != 0 })
            }
            (interface::RANGER, kind::DATA, 1) => {
                Self::Sweep(RangeSweep { ranges_m: Numbers::f64s(&mut reader)?, fan: None })
            }
            // Geometry and configuration may follow, which the client has asked for.
            (interface::RANGER, kind::DATA, 2) => {
                return Ok(Self::Sweep(RangeSweep { ranges_m: Numbers::f64s(&mut reader)?, fan: None }));
            }
            (interface::RANGER, kind::DATA, 3) => Self::Intensities(Numbers::f64s(&mut reader)?),
            (interface::LASER, kind::DATA, 1) => Self::Sweep(laser_scan(&mut reader)?),
            (interface::LASER, kind::DATA, 2) => {
                let sweep = laser_scan(&mut reader)?;
                reader.f64s::<3>()?;
                Self::Sweep(sweep)
            }
            _ => return Ok(Self::Unknown),
        };
        reader.end().map(|()| message)
    }
}

fn laser_scan<'a>(reader: &mut XdrReader<'a>) -> Result<RangeSweep<'a>, Malformed> {
    let (first_rad, last_rad, _resolution, max_range_m) =
        (reader.f32()?, reader.f32()?, reader.f32()?, reader.f32()?);
    let ranges_m = Numbers::f32s(reader)?;
    let _intensities = reader.text()?;
    let _id = reader.u32()?;
    Ok(RangeSweep { ranges_m, fan: Some(Fan { first_rad, last_rad, min_range_m: 0.0, max_range_m }) })
}

/// The devices in the answer to [`crate::command::ClientMessage::Devices`].
///
/// # Errors
/// A payload that is no list of devices.
pub fn devices(payload: &[u8]) -> Result<impl Iterator<Item = DeviceAddress> + '_, Malformed> {
    let mut reader = XdrReader::new(payload);
    let elements = reader.elements(16)?;
    reader.end()?;
    let device = |address: &[u8]| {
        let mut reader = XdrReader::new(address);
        reader.take(8)?;
        Ok::<DeviceAddress, Malformed>(DeviceAddress { interface: reader.u32()?, index: reader.u32()? })
    };
    Ok(elements.chunks_exact(16).filter_map(move |address| device(address).ok()))
}

/// The answer to a subscription; a refusal has the same payload.
///
/// # Errors
/// A payload that is no such answer.
pub fn subscription(payload: &[u8]) -> Result<Subscription<'_>, Malformed> {
    let mut reader = XdrReader::new(payload);
    reader.take(8)?;
    let device = DeviceAddress { interface: reader.u32()?, index: reader.u32()? };
    let subscription = Subscription { device, access: reader.u32()?, driver: reader.text()? };
    reader.end().map(|()| subscription)
}

/// The body of the base in the answer to a request for its geometry: length and width [m].
///
/// # Errors
/// A payload that is no geometry of a position2d.
pub fn body(payload: &[u8]) -> Result<[f64; 2], Malformed> {
    let mut reader = XdrReader::new(payload);
    let [_, _, _, _, _, _, width, length, _height] = reader.f64s::<9>()?;
    reader.end().map(|()| [length, width])
}

/// The mounting of a scanner in the answer to a request for its geometry: ahead, left, yaw [m, m, rad].
///
/// Other numbers in it may be uninitialised.
///
/// # Errors
/// A payload that is no geometry of this interface.
pub fn mounting(of: DeviceAddress, payload: &[u8]) -> Result<[f64; 3], Malformed> {
    let mut reader = XdrReader::new(payload);
    let [x_m, y_m, _, _, _, yaw_rad] = reader.f64s::<6>()?;
    reader.f64s::<3>()?;
    if of.interface == interface::RANGER {
        reader.elements(48)?;
        reader.elements(24)?;
    }
    reader.end().map(|()| [x_m, y_m, yaw_rad])
}

/// The beams in the answer to a request for the configuration of a scanner.
///
/// The resolution in it is ignored: Stage reports the opening divided by the number of beams, and measures with one
/// interval less. The number of beams of a sweep gives the true step.
///
/// # Errors
/// A payload that is no configuration of this interface.
pub fn fan(of: DeviceAddress, payload: &[u8]) -> Result<Fan, Malformed> {
    let mut reader = XdrReader::new(payload);
    let fan = if of.interface == interface::LASER {
        let (first_rad, last_rad, _resolution, max_range_m) =
            (reader.f32()?, reader.f32()?, reader.f32()?, reader.f32()?);
        reader.take(12)?;
        Fan { first_rad, last_rad, min_range_m: 0.0, max_range_m }
    } else {
        let [first_rad, last_rad, _resolution, _min_range_m, max_range_m, _, _] = reader.f64s::<7>()?;
        Fan { first_rad, last_rad, min_range_m: 0.0, max_range_m }
    };
    reader.end().map(|()| fan)
}
