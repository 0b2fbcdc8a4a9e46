//! The conversation before data come: devices, subscriptions, geometry and configuration.
//!
//! Requests go out in three groups; the answers of a group come in any order, with data between them. An answer belongs
//! to the request with its device and subtype. Each request has a time limit, because the server drops what it does not
//! know without an answer.

use driver::beams::Fan;

use crate::command::{ClientMessage, DeliveryMode, QueueRule, access};
use crate::config::{Delivery, PlayerConfig, ScanSource, ScannerInterface};
use crate::header::{DeviceAddress, MessageHeader, interface};
use crate::message::{self, ServerMessage};
use crate::xdr::Malformed;

/// An answer that has not come after this time does not come [ns]: the limit of Player's own clients.
pub const ANSWER_NS: u64 = 5_000_000_000;

/// What is known about the devices when the conversation has ended.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PlayerSession {
    /// The scanner; `None` when the scans come from elsewhere.
    pub scanner: Option<DeviceAddress>,
    /// The beams, where the scanner reports them.
    pub fan: Option<Fan>,
    /// Length and width of the base, where it reports them [m].
    pub body_m: Option<[f64; 2]>,
    /// Mounting of the scanner, where it is reported: ahead, left, yaw [m, m, rad].
    pub mounting: Option<[f64; 3]>,
}

/// Why the conversation has failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refused {
    /// A device is missing.
    #[error("the server has no {wanted}; its devices are {}", listed(.devices))]
    NoDevice {
        /// What was looked for.
        wanted: String,
        /// What there is.
        devices: Vec<DeviceAddress>,
    },
    /// A device could not be opened.
    #[error("{0} cannot be opened: its driver failed to start, or the server does not have it")]
    NotOpened(DeviceAddress),
    /// The server refuses what is needed.
    #[error("{0} refuses request {1}")]
    Nack(DeviceAddress, u32),
    /// No answer came.
    #[error("{0} does not answer request {1} within 5 s")]
    Silent(DeviceAddress, u32),
    /// An answer is malformed.
    #[error("the answer of {0} to request {1}: {2}")]
    Malformed(DeviceAddress, u32, Malformed),
}

fn listed(devices: &[DeviceAddress]) -> String {
    let names: Vec<String> = devices.iter().map(ToString::to_string).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// A request without an answer yet.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pending {
    command: ClientMessage,
    /// Whether the conversation can do without.
    is_optional: bool,
}

/// The conversation.
#[derive(Debug)]
pub struct Handshake {
    base: DeviceAddress,
    scan: ScanSource,
    scanner: ScannerInterface,
    scanner_index: u32,
    session: PlayerSession,
    group: u32,
    pending: Vec<Pending>,
    sequence: u32,
    /// When the group was sent [ns].
    since_ns: u64,
    devices: Vec<DeviceAddress>,
}

impl Handshake {
    /// Begins: appends the first requests.
    pub fn new(config: &PlayerConfig, now_ns: u64, bytes: &mut Vec<u8>) -> Self {
        let mut handshake = Self {
            base: config.base(),
            scan: config.scan,
            scanner: config.scanner,
            scanner_index: config.scanner_index,
            session: PlayerSession::default(),
            group: 0,
            pending: Vec::new(),
            sequence: 0,
            since_ns: now_ns,
            devices: Vec::new(),
        };
        let mode = if config.delivery == Delivery::Pull { DeliveryMode::Pull } else { DeliveryMode::Push };
        handshake.ask(&[(ClientMessage::Deliver(mode), false), (ClientMessage::Devices, false)], bytes);
        handshake
    }

    /// Takes a message; appends the next requests. The session, when all was answered.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn take(
        &mut self,
        header: &MessageHeader,
        message: &ServerMessage<'_>,
        now_ns: u64,
        bytes: &mut Vec<u8>,
    ) -> Result<Option<PlayerSession>, Refused> {
        let ServerMessage::Answer { accepted, payload } = *message else { return Ok(None) };
        let opened = message::subscription(payload).ok();
        let is_answered = |pending: &Pending| {
            let (device, _, subtype) = pending.command.address();
            let is_same = (device, subtype) == (header.device, header.subtype);
            // Two subscriptions differ in the device that they name.
            is_same
                && match pending.command {
                    ClientMessage::Subscribe(device, _) => {
                        opened.is_some_and(|opened| opened.device == device)
                    }
                    _ => true,
                }
        };
        let Some(place) = self.pending.iter().position(is_answered) else { return Ok(None) };
        let pending = self.pending.remove(place);
        self.read(&pending, accepted, payload)?;
        if self.pending.is_empty() {
            self.since_ns = now_ns;
            return self.next_group(bytes);
        }
        Ok(None)
    }

    /// Gives up requests that were not answered in time. The session, when no other is pending.
    ///
    /// # Errors
    /// [`Refused::Silent`] for a request that must be answered.
    pub fn expire(&mut self, now_ns: u64, bytes: &mut Vec<u8>) -> Result<Option<PlayerSession>, Refused> {
        if now_ns.saturating_sub(self.since_ns) < ANSWER_NS {
            return Ok(None);
        }
        if let Some(needed) = self.pending.iter().find(|pending| !pending.is_optional) {
            let (device, _, subtype) = needed.command.address();
            return Err(Refused::Silent(device, subtype));
        }
        self.pending.clear();
        self.since_ns = now_ns;
        self.next_group(bytes)
    }

    fn ask(&mut self, commands: &[(ClientMessage, bool)], bytes: &mut Vec<u8>) {
        for (command, is_optional) in commands {
            self.sequence += 1;
            command.write(bytes, 0.0, self.sequence);
            self.pending.push(Pending { command: *command, is_optional: *is_optional });
        }
    }

    fn next_group(&mut self, bytes: &mut Vec<u8>) -> Result<Option<PlayerSession>, Refused> {
        self.group += 1;
        let (base, scanner) = (self.base, self.session.scanner);
        match self.group {
            1 => {
                self.ask(&[(ClientMessage::Subscribe(base, access::OPEN), false)], bytes);
                if let Some(scanner) = scanner {
                    // Stage sends intensities of zero and one with each sweep: half of all bytes.
                    let rule = ClientMessage::Queue(Some((scanner, 3)), QueueRule::Ignore);
                    let asked = [(ClientMessage::Subscribe(scanner, access::OPEN), false), (rule, true)];
                    let count = if scanner.interface == interface::RANGER { 2 } else { 1 };
                    self.ask(&asked[..count], bytes);
                }
                Ok(None)
            }
            2 => {
                self.ask(
                    &[(ClientMessage::MotorPower(base, true), true), (ClientMessage::Geometry(base), true)],
                    bytes,
                );
                if let Some(scanner) = scanner {
                    // A laser reports its beams with each sweep.
                    let is_optional = scanner.interface == interface::LASER;
                    let asked = [
                        (ClientMessage::Geometry(scanner), true),
                        (ClientMessage::Configuration(scanner), is_optional),
                    ];
                    self.ask(&asked, bytes);
                }
                Ok(None)
            }
            _ => Ok(Some(self.session.clone())),
        }
    }

    fn read(&mut self, pending: &Pending, accepted: bool, payload: &[u8]) -> Result<(), Refused> {
        let (device, _, subtype) = pending.command.address();
        if let ClientMessage::Subscribe(wanted, _) = pending.command {
            let opened = message::subscription(payload);
            let opened = opened.map_err(|error| Refused::Malformed(device, subtype, error))?;
            let is_open = accepted && opened.access == access::OPEN;
            return if is_open { Ok(()) } else { Err(Refused::NotOpened(wanted)) };
        }
        if !accepted {
            return if pending.is_optional { Ok(()) } else { Err(Refused::Nack(device, subtype)) };
        }
        let result = match pending.command {
            ClientMessage::Devices => self.choose(payload)?,
            ClientMessage::Geometry(device) if device == self.base => {
                message::body(payload).map(|body_m| self.session.body_m = Some(body_m))
            }
            ClientMessage::Geometry(device) => {
                message::mounting(device, payload).map(|mounting| self.session.mounting = Some(mounting))
            }
            ClientMessage::Configuration(device) => {
                message::fan(device, payload).map(|fan| self.session.fan = Some(fan))
            }
            _ => Ok(()),
        };
        result.map_err(|error| Refused::Malformed(device, subtype, error))
    }

    /// Chooses base and scanner from the list of devices.
    fn choose(&mut self, payload: &[u8]) -> Result<Result<(), Malformed>, Refused> {
        let devices = match message::devices(payload) {
            Ok(devices) => devices,
            Err(error) => return Ok(Err(error)),
        };
        self.devices = devices.collect();
        let scanner = |interface| DeviceAddress { interface, index: self.scanner_index };
        let (ranger, laser) = (scanner(interface::RANGER), scanner(interface::LASER));
        let wanted: &[DeviceAddress] = match (self.scan, self.scanner) {
            (ScanSource::Urg, _) => &[],
            (_, ScannerInterface::Auto) => &[ranger, laser],
            (_, ScannerInterface::Ranger) => &[ranger],
            (_, ScannerInterface::Laser) => &[laser],
        };
        let missing = |wanted: String| Refused::NoDevice { wanted, devices: self.devices.clone() };
        if !self.devices.contains(&self.base) {
            return Err(missing(self.base.to_string()));
        }
        let found = wanted.iter().find(|device| self.devices.contains(device));
        if found.is_none() && !wanted.is_empty() {
            let names: Vec<String> = wanted.iter().map(ToString::to_string).collect();
            return Err(missing(names.join(" or ")));
        }
        self.session.scanner = found.copied();
        Ok(Ok(()))
    }
}

#[cfg(test)]
mod tests;
