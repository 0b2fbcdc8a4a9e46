//! One client of the server: its requests and its subscriptions.

use std::io::{self, ErrorKind, Write};
use std::net::TcpStream;
use std::time::Duration;

use player::command::{ClientMessage, DeliveryMode, QueueRule, access};
use player::header::{DeviceAddress, HEADER, MessageHeader, interface, kind};
use player::xdr::{put_f64s, put_text, put_u32};
use rustix::net::RecvFlags;
use shared_types::{BEAMS, ScanGeometry};

use super::world::{Data, MAX_RANGE_M, World};

/// The server's own address, as it stands in messages.
const HOST: u32 = 0x0100_007f;
const BASE: DeviceAddress = DeviceAddress { interface: interface::POSITION2D, index: 0 };
const RANGER: DeviceAddress = DeviceAddress { interface: interface::RANGER, index: 0 };
const LASER: DeviceAddress = DeviceAddress { interface: interface::LASER, index: 0 };
const DEVICES: [DeviceAddress; 3] = [BASE, RANGER, LASER];
/// Wheelbase of the car that the steering angle belongs to [m].
const WHEELBASE_M: f64 = 0.185;
/// A client that does not read is dropped after this time.
const SEND: Duration = Duration::from_millis(200);

pub(super) struct Client {
    stream: TcpStream,
    port: u16,
    received: Vec<u8>,
    open: Vec<DeviceAddress>,
    is_pull: bool,
    /// Devices and subtypes that it does not want.
    ignored: Vec<(DeviceAddress, u32)>,
    /// What waits for a request in pull mode.
    queued: Vec<u8>,
    has_asked: bool,
    is_lost: bool,
}

impl Client {
    pub(super) fn new(stream: TcpStream, port: u16, _time_s: f64) -> Option<Self> {
        stream.set_nonblocking(false).ok()?;
        stream.set_write_timeout(Some(SEND)).ok()?;
        stream.set_nodelay(true).ok()?;
        let mut ident = *b"Player v.3.1.0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0";
        ident[31] = 0;
        (&stream).write_all(&ident).ok()?;
        let (received, open, ignored, queued) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let [is_pull, has_asked, is_lost] = [false; 3];
        Some(Self { stream, port, received, open, is_pull, ignored, queued, has_asked, is_lost })
    }

    pub(super) fn has_base(&self) -> bool {
        self.open.contains(&BASE)
    }

    /// Answers what has come; an error when the connection has ended.
    pub(super) fn serve(&mut self, world: &mut World) -> io::Result<()> {
        let mut bytes = [0; 4096];
        loop {
            match rustix::net::recv(&self.stream, &mut bytes[..], RecvFlags::DONTWAIT) {
                Err(rustix::io::Errno::AGAIN) => break,
                // What came before the end is still obeyed.
                Ok((_, 0)) | Err(_) => {
                    self.is_lost = true;
                    break;
                }
                Ok((_, count)) => self.received.extend_from_slice(&bytes[..count]),
            }
        }
        let mut read = 0;
        while let Ok(header) = MessageHeader::read(&self.received[read..]) {
            let end = read + HEADER + header.size as usize;
            let Some(payload) = self.received.get(read + HEADER..end) else { break };
            let command = ClientMessage::read(&header, payload).map_err(io::Error::other)?;
            read = end;
            if let Some(command) = command {
                self.obey(&header, &command, world);
            }
        }
        self.received.drain(..read);
        if self.is_lost { Err(ErrorKind::BrokenPipe.into()) } else { Ok(()) }
    }

    fn obey(&mut self, header: &MessageHeader, command: &ClientMessage, world: &mut World) {
        let mut payload = Vec::new();
        let mut kind = kind::ACK;
        match *command {
            ClientMessage::Car(BASE, [velocity_mps, angle_rad]) => {
                return world.command(velocity_mps, angle_rad);
            }
            ClientMessage::Velocity(BASE, [velocity_mps, _, yaw_rate]) => {
                let curvature = if velocity_mps == 0.0 { 0.0 } else { yaw_rate / velocity_mps };
                return world.command(velocity_mps, (WHEELBASE_M * curvature).atan());
            }
            // Unknown devices and numbers have no answer.
            ClientMessage::Car(..) | ClientMessage::Velocity(..) => return,
            ClientMessage::Devices => {
                put_u32(&mut payload, DEVICES.len() as u32);
                put_u32(&mut payload, DEVICES.len() as u32);
                DEVICES.iter().for_each(|device| self.address(&mut payload, *device));
            }
            ClientMessage::Subscribe(device, wanted) => {
                let is_known = DEVICES.contains(&device);
                self.open.retain(|open| *open != device);
                if is_known && wanted == access::OPEN {
                    self.open.push(device);
                }
                self.address(&mut payload, device);
                put_u32(&mut payload, if is_known { wanted } else { access::ERROR });
                put_text(&mut payload, b"emulator\0");
                kind = if is_known { kind::ACK } else { kind::NACK };
            }
            ClientMessage::DriverInfo(device) => {
                self.address(&mut payload, device);
                put_text(&mut payload, b"emulator\0");
            }
            ClientMessage::Deliver(mode) => self.is_pull = mode == DeliveryMode::Pull,
            ClientMessage::Queue(Some(of), QueueRule::Ignore) => self.ignored.push(of),
            ClientMessage::Queue(..) | ClientMessage::MotorPower(..) | ClientMessage::SetOdometry(..) => {}
            ClientMessage::Round => self.has_asked = true,
            ClientMessage::Geometry(device) => geometry(device, &mut payload),
            ClientMessage::Configuration(device) => configuration(device, &mut payload),
        }
        let sequence = if header.device == DeviceAddress::SERVER { header.sequence } else { 0 };
        let time_s = world.time_s();
        let answer = MessageHeader { kind, time_s, sequence, ..*header };
        let message = self.message(&answer, &payload);
        self.send(&message);
        self.flush();
    }

    fn address(&self, payload: &mut Vec<u8>, device: DeviceAddress) {
        [HOST, u32::from(self.port), device.interface, device.index]
            .iter()
            .for_each(|field| put_u32(payload, *field));
    }

    /// A message with this server as its sender.
    fn message(&self, header: &MessageHeader, payload: &[u8]) -> Vec<u8> {
        let (mut bytes, size) = (Vec::new(), payload.len() as u32);
        MessageHeader { host: HOST, robot: u32::from(self.port), size, ..*header }.write(&mut bytes);
        bytes.extend_from_slice(payload);
        bytes
    }

    /// Sends the data of a sweep, or queues them.
    pub(super) fn deliver(&mut self, data: &Data) {
        let mut state = Vec::new();
        put_f64s(&mut state, &data.pose);
        put_f64s(&mut state, &data.velocity);
        put_u32(&mut state, 0);
        let mut ranges = Vec::new();
        put_u32(&mut ranges, BEAMS as u32);
        put_u32(&mut ranges, BEAMS as u32);
        put_f64s(&mut ranges, &data.ranges_m);
        self.publish(BASE, 1, data.time_s, &state);
        self.publish(RANGER, 1, data.time_s, &ranges);
        self.publish(RANGER, 3, data.time_s, &ranges);
        // As the converter of Player does.
        let laser = laser(&data.ranges_m);
        self.publish(LASER, 1, data.time_s, &laser);
        self.publish(LASER, 1, data.time_s, &laser);
        self.flush();
    }

    /// The same, but only half of the bytes.
    pub(super) fn deliver_half(&mut self, data: &Data) {
        let is_pull = std::mem::replace(&mut self.is_pull, true);
        self.has_asked = false;
        self.deliver(data);
        let half = self.queued.len() / 2;
        let bytes = std::mem::take(&mut self.queued);
        self.send(&bytes[..half]);
        self.is_pull = is_pull;
    }

    fn publish(&mut self, device: DeviceAddress, subtype: u32, time_s: f64, payload: &[u8]) {
        if self.ignored.contains(&(device, subtype)) || !self.open.contains(&device) {
            return;
        }
        let header = MessageHeader {
            host: 0,
            robot: 0,
            device,
            kind: kind::DATA,
            subtype,
            time_s,
            sequence: 0,
            size: 0,
        };
        let message = self.message(&header, payload);
        if self.is_pull {
            self.queued.extend(message);
        } else {
            self.send(&message);
        }
    }

    /// In pull mode: sends what was asked for, and the end of the round.
    fn flush(&mut self) {
        if !(self.is_pull && self.has_asked) || self.queued.is_empty() {
            return;
        }
        self.has_asked = false;
        // Time and sequence of the real server are uninitialised.
        let (time_s, sequence) = (4.6e-310, 3_090_320_311);
        let (device, kind) = (DeviceAddress::SERVER, kind::SYNCH);
        let end = MessageHeader { host: 0, robot: 0, device, kind, subtype: 1, time_s, sequence, size: 0 };
        let mut bytes = std::mem::take(&mut self.queued);
        bytes.extend(self.message(&end, &[]));
        self.send(&bytes);
    }

    pub(super) fn send(&mut self, bytes: &[u8]) {
        self.is_lost |= (&self.stream).write_all(bytes).is_err();
    }
}

fn geometry(of: DeviceAddress, payload: &mut Vec<u8>) {
    if of == BASE {
        return put_f64s(payload, &[0.0, 0.0, 4.6e-310, 6.9e-310, 0.0, 0.0, 0.4, 0.56, 4.6e-310]);
    }
    put_f64s(payload, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.05, 0.05, 0.07]);
    if of == RANGER {
        put_u32(payload, 1);
        put_u32(payload, 1);
        put_f64s(payload, &[0.0; 6]);
        put_u32(payload, 1);
        put_u32(payload, 1);
        put_f64s(payload, &[0.05, 0.05, 0.07]);
    }
}

fn configuration(of: DeviceAddress, payload: &mut Vec<u8>) {
    let (first, last) = (ScanGeometry::URG_04LX.yaw_rad(0), ScanGeometry::URG_04LX.yaw_rad(BEAMS - 1));
    // Stage reports the opening by the number of beams.
    let resolution = (last - first) / BEAMS as f64;
    if of == LASER {
        put_f32s(payload, &[first, last, resolution, MAX_RANGE_M, 0.001]);
        put_u32(payload, 0);
        put_f32s(payload, &[10.0]);
    } else {
        put_f64s(payload, &[first, last, resolution, 0.02, MAX_RANGE_M, 0.001, 10.0]);
    }
}

fn laser(ranges_m: &[f64]) -> Vec<u8> {
    let (first, last) = (ScanGeometry::URG_04LX.yaw_rad(0), ScanGeometry::URG_04LX.yaw_rad(BEAMS - 1));
    let mut payload = Vec::new();
    put_f32s(&mut payload, &[first, last, (last - first) / BEAMS as f64, MAX_RANGE_M]);
    put_u32(&mut payload, ranges_m.len() as u32);
    put_u32(&mut payload, ranges_m.len() as u32);
    put_f32s(&mut payload, ranges_m);
    put_text(&mut payload, &[]);
    put_u32(&mut payload, 0);
    payload
}

fn put_f32s(payload: &mut Vec<u8>, numbers: &[f64]) {
    numbers.iter().for_each(|number| payload.extend_from_slice(&(*number as f32).to_be_bytes()));
}
