use super::*;
use crate::header::{HEADER, kind};
use crate::xdr::{put_f64s, put_text, put_u32};

const RANGER: DeviceAddress = DeviceAddress { interface: interface::RANGER, index: 0 };
const LASER: DeviceAddress = DeviceAddress { interface: interface::LASER, index: 0 };
const BASE: DeviceAddress = DeviceAddress { interface: interface::POSITION2D, index: 0 };

/// A conversation with a server whose answers the test chooses.
struct Talk {
    handshake: Handshake,
    requests: Vec<u8>,
    session: Option<PlayerSession>,
}

impl Talk {
    fn new(config: &PlayerConfig) -> Self {
        let mut requests = Vec::new();
        let handshake = Handshake::new(config, 0, &mut requests);
        Self { handshake, requests, session: None }
    }

    /// Devices and subtypes of the requests since the last call.
    fn asked(&mut self) -> Vec<(DeviceAddress, u32)> {
        let mut asked = Vec::new();
        let mut rest = &self.requests[..];
        while let Ok(header) = MessageHeader::read(rest) {
            asked.push((header.device, header.subtype));
            rest = &rest[HEADER + header.size as usize..];
        }
        self.requests.clear();
        asked
    }

    fn answer(
        &mut self,
        device: DeviceAddress,
        subtype: u32,
        accepted: bool,
        payload: &[u8],
    ) -> Result<(), Refused> {
        let kind = if accepted { kind::ACK } else { kind::NACK };
        let size = payload.len() as u32;
        let header =
            MessageHeader { host: 0, robot: 6665, device, kind, subtype, time_s: 3.7, sequence: 0, size };
        let message = ServerMessage::read(&header, payload).unwrap();
        let session = self.handshake.take(&header, &message, 1, &mut self.requests)?;
        self.session = self.session.take().or(session);
        Ok(())
    }

    fn ack(&mut self, device: DeviceAddress, subtype: u32, payload: &[u8]) {
        self.answer(device, subtype, true, payload).unwrap();
    }

    /// Up to the list of devices.
    fn listed(config: &PlayerConfig, devices: &[DeviceAddress]) -> (Self, Result<(), Refused>) {
        let mut talk = Self::new(config);
        assert_eq!(talk.asked(), [(DeviceAddress::SERVER, 5), (DeviceAddress::SERVER, 1)]);
        // The second answer comes first.
        let listed = talk.answer(DeviceAddress::SERVER, 1, true, &list(devices));
        if listed.is_ok() {
            talk.ack(DeviceAddress::SERVER, 5, &[]);
        }
        (talk, listed)
    }
}

fn list(devices: &[DeviceAddress]) -> Vec<u8> {
    let mut bytes = Vec::new();
    put_u32(&mut bytes, devices.len() as u32);
    put_u32(&mut bytes, devices.len() as u32);
    for device in devices {
        [0x0100_007f, 6665, device.interface, device.index]
            .iter()
            .for_each(|field| put_u32(&mut bytes, *field));
    }
    bytes
}

fn opened(device: DeviceAddress, access: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    [0x0100_007f, 6665, device.interface, device.index, access]
        .iter()
        .for_each(|field| put_u32(&mut bytes, *field));
    put_text(&mut bytes, b"stage\0");
    bytes
}

fn config_of_ranger() -> Vec<u8> {
    let mut bytes = Vec::new();
    put_f64s(&mut bytes, &[-2.0, 2.0, 0.006, 0.02, 5.6, 0.001, 10.0]);
    bytes
}

#[test]
fn answers_come_in_any_order_and_belong_to_their_device() {
    let (mut talk, _) = Talk::listed(&PlayerConfig::default(), &[BASE, RANGER, LASER]);
    assert_eq!(
        talk.asked(),
        [(DeviceAddress::SERVER, 3), (DeviceAddress::SERVER, 3), (DeviceAddress::SERVER, 10)]
    );
    talk.ack(DeviceAddress::SERVER, 10, &[]);
    talk.ack(DeviceAddress::SERVER, 3, &opened(RANGER, 1));
    talk.ack(DeviceAddress::SERVER, 3, &opened(RANGER, 1));
    assert_eq!(talk.asked(), [], "the base is not open yet");
    talk.ack(DeviceAddress::SERVER, 3, &opened(BASE, 1));
    assert_eq!(talk.asked(), [(BASE, 2), (BASE, 1), (RANGER, 1), (RANGER, 5)]);
    let mut body = Vec::new();
    put_f64s(&mut body, &[0.0, 0.0, 4.6e-310, 0.0, 0.0, 0.0, 0.45, 0.6, 4.6e-310]);
    let mut mounting = Vec::new();
    put_f64s(&mut mounting, &[0.2, 0.0, 0.0, 0.0, 0.0, 0.1, 0.05, 0.05, 0.07]);
    [0; 4].iter().for_each(|count| put_u32(&mut mounting, *count));
    talk.ack(RANGER, 5, &config_of_ranger());
    talk.ack(RANGER, 1, &mounting);
    talk.ack(BASE, 1, &body);
    assert_eq!(talk.session, None);
    // A base without power control refuses.
    talk.answer(BASE, 2, false, &[]).unwrap();
    let session = talk.session.unwrap();
    assert_eq!(session.scanner, Some(RANGER));
    assert_eq!(session.fan, Some(Fan { first_rad: -2.0, last_rad: 2.0, min_range_m: 0.0, max_range_m: 5.6 }));
    assert_eq!((session.body_m, session.mounting), (Some([0.6, 0.45]), Some([0.2, 0.0, 0.1])));
}

#[test]
fn the_laser_is_used_where_there_is_no_ranger_or_it_is_wanted() {
    let scanner_of = |config: &PlayerConfig, devices: &[DeviceAddress]| {
        let (mut talk, listed) = Talk::listed(config, devices);
        listed.map(|()| {
            let asked = talk.asked();
            (asked.len(), talk.handshake.session.scanner)
        })
    };
    assert_eq!(scanner_of(&PlayerConfig::default(), &[LASER, BASE]), Ok((2, Some(LASER))));
    let laser = PlayerConfig { scanner: ScannerInterface::Laser, ..PlayerConfig::default() };
    assert_eq!(scanner_of(&laser, &[BASE, RANGER, LASER]), Ok((2, Some(LASER))));
    let urg = PlayerConfig { scan: ScanSource::Urg, ..PlayerConfig::default() };
    assert_eq!(scanner_of(&urg, &[BASE]), Ok((1, None)));
    let missing = scanner_of(&PlayerConfig::default(), &[BASE]).unwrap_err().to_string();
    assert_eq!(missing, "the server has no ranger:0 or laser:0; its devices are position2d:0");
    let second = PlayerConfig { position2d: 1, ..PlayerConfig::default() };
    let missing = scanner_of(&second, &[BASE, RANGER]).unwrap_err().to_string();
    assert_eq!(missing, "the server has no position2d:1; its devices are position2d:0, ranger:0");
}

#[test]
fn a_device_that_does_not_open_is_named_in_both_forms_of_refusal() {
    for (accepted, access) in [(false, 3), (true, 3)] {
        let (mut talk, _) = Talk::listed(&PlayerConfig::default(), &[BASE, RANGER]);
        let refused = talk.answer(DeviceAddress::SERVER, 3, accepted, &opened(RANGER, access));
        assert_eq!(refused, Err(Refused::NotOpened(RANGER)));
    }
}

#[test]
fn a_missing_answer_ends_the_conversation_unless_it_is_optional() {
    let mut talk = Talk::new(&PlayerConfig::default());
    assert_eq!(talk.handshake.expire(ANSWER_NS - 1, &mut Vec::new()), Ok(None));
    let silent = talk.handshake.expire(ANSWER_NS, &mut Vec::new());
    assert_eq!(silent, Err(Refused::Silent(DeviceAddress::SERVER, 5)));

    let (mut talk, _) = Talk::listed(&PlayerConfig::default(), &[BASE, RANGER]);
    talk.ack(DeviceAddress::SERVER, 3, &opened(BASE, 1));
    talk.ack(DeviceAddress::SERVER, 3, &opened(RANGER, 1));
    assert_eq!(talk.handshake.expire(2 * ANSWER_NS, &mut talk.requests), Ok(None));
    assert_eq!(talk.asked().len(), 3 + 4, "it continues without the rule");
    talk.ack(RANGER, 5, &config_of_ranger());
    let session = talk.handshake.expire(4 * ANSWER_NS, &mut talk.requests).unwrap().unwrap();
    assert_eq!((session.body_m, session.mounting), (None, None));
}

#[test]
fn a_malformed_answer_is_named() {
    let mut talk = Talk::new(&PlayerConfig::default());
    let malformed = talk.answer(DeviceAddress::SERVER, 1, true, &[0, 0, 0, 1]).unwrap_err().to_string();
    assert_eq!(malformed, "the answer of player:0 to request 1: the payload ends 4 bytes too early");
}
