//! The codec against bytes that a Player 3.1 server with Stage and its clients have exchanged.
//!
//! The folder `recordings` has what two clients sent, complete, and the first messages of what the server sent: one
//! session in push mode, one with the original C library in pull mode.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;

use driver::beams::{Beams, Fan};
use player::command::{ClientMessage, DeliveryMode, QueueRule, access};
use player::config::{Delivery, PlayerConfig};
use player::handshake::Handshake;
use player::header::{DeviceAddress, HEADER, MessageHeader, interface, kind};
use player::message::ServerMessage;
use player::stream::MessageStream;
use player::{message, xdr};
use proptest::collection::vec;
use proptest::prelude::*;
use vehicle::ScannerDescription;

const PUSH: &[u8] = include_bytes!("recordings/own-push-ranger.s2c.bin");
const PULL: &[u8] = include_bytes!("recordings/ref-pull-ranger.s2c.bin");
const PUSH_SENT: &[u8] = include_bytes!("recordings/own-push-ranger.c2s.bin");
const PULL_SENT: &[u8] = include_bytes!("recordings/ref-pull-ranger.c2s.bin");
const BASE: DeviceAddress = DeviceAddress { interface: interface::POSITION2D, index: 0 };
const RANGER: DeviceAddress = DeviceAddress { interface: interface::RANGER, index: 0 };
/// Interface of the simulation, which the client does not use.
const SIMULATION: u32 = 31;

/// All messages of a stream that arrives in chunks.
fn messages(bytes: &[u8], chunk: usize) -> Vec<(MessageHeader, Vec<u8>)> {
    let (mut stream, mut all) = (MessageStream::default(), Vec::new());
    for mut part in bytes.chunks(chunk) {
        while !part.is_empty() {
            let space = stream.space();
            let count = part.len().min(space.len());
            space[..count].copy_from_slice(&part[..count]);
            stream.add(count);
            part = &part[count..];
            while let Some((header, payload)) = stream.next().unwrap() {
                all.push((header, payload.to_vec()));
            }
        }
    }
    all
}

/// How many messages there are of each interface, kind and subtype.
fn counts(messages: &[(MessageHeader, Vec<u8>)]) -> BTreeMap<(u32, u32, u32), usize> {
    let mut counts = BTreeMap::new();
    for (header, _) in messages {
        *counts.entry((header.device.interface, header.kind, header.subtype)).or_default() += 1;
    }
    counts
}

/// The payload of the first message of a kind.
fn first(messages: &[(MessageHeader, Vec<u8>)], of: DeviceAddress, kind: u32, subtype: u32) -> &[u8] {
    let found = messages
        .iter()
        .find(|(header, _)| (header.device, header.kind, header.subtype) == (of, kind, subtype));
    &found.unwrap().1
}

#[test]
fn the_streams_are_cut_into_the_same_messages_in_any_pieces() {
    for (bytes, expected) in [(PUSH, 19), (PULL, 22)] {
        let whole = messages(bytes, bytes.len());
        assert_eq!(whole.len(), expected);
        for chunk in [1, 7, 39, 41, 4096, 65_536] {
            assert_eq!(messages(bytes, chunk), whole);
        }
        for (header, payload) in &whole {
            assert_eq!(ServerMessage::read(header, payload).err(), None, "{header:?}");
        }
    }
}

#[test]
fn the_messages_are_those_of_the_index() {
    let (data, ack, synch) = (kind::DATA, kind::ACK, kind::SYNCH);
    let (base, ranger, server) = (interface::POSITION2D, interface::RANGER, interface::PLAYER);
    let push = counts(&messages(PUSH, 4096));
    let expected = [
        ((server, ack, 1), 1),
        ((server, ack, 3), 3),
        ((base, data, 1), 3),
        ((base, ack, 1), 1),
        ((base, ack, 2), 1),
        ((SIMULATION, ack, 1), 1),
        ((SIMULATION, ack, 2), 1),
        ((ranger, data, 1), 3),
        ((ranger, data, 3), 3),
        ((ranger, ack, 1), 1),
        ((ranger, ack, 5), 1),
    ];
    assert_eq!(push, BTreeMap::from(expected));
    let pull = counts(&messages(PULL, 4096));
    assert_eq!((pull[&(server, synch, 1)], pull[&(server, ack, 4)], pull[&(server, ack, 2)]), (1, 1, 4));
}

#[test]
fn what_the_server_tells_about_its_devices_is_read() {
    let push = messages(PUSH, 4096);
    let devices: Vec<DeviceAddress> =
        message::devices(first(&push, DeviceAddress::SERVER, kind::ACK, 1)).unwrap().collect();
    let interfaces: Vec<u32> = devices.iter().map(|device| device.interface).collect();
    assert_eq!(interfaces, [SIMULATION, interface::POSITION2D, interface::RANGER, interface::LASER]);
    let opened = message::subscription(first(&push, DeviceAddress::SERVER, kind::ACK, 3)).unwrap();
    assert_eq!((opened.access, opened.driver), (access::OPEN, &b"stage\0"[..]));
    assert_eq!(message::body(first(&push, BASE, kind::ACK, 1)), Ok([0.6, 0.45]));
    assert_eq!(message::mounting(RANGER, first(&push, RANGER, kind::ACK, 1)), Ok([0.2, 0.0, 0.0]));
    let fan = message::fan(RANGER, first(&push, RANGER, kind::ACK, 5)).unwrap();
    assert!((fan.first_rad.to_degrees() + 119.707).abs() < 1e-3 && fan.last_rad == -fan.first_rad, "{fan:?}");
    assert_eq!(fan.max_range_m, 5.6);
}

#[test]
fn the_first_sweep_has_the_walls_and_the_box_of_the_corridor() {
    let push = messages(PUSH, 4096);
    let (header, payload) =
        push.iter().find(|(header, _)| (header.device, header.kind) == (RANGER, kind::DATA)).unwrap();
    assert_eq!(header.time_s, 3.8);
    let Ok(ServerMessage::Sweep(sweep)) = ServerMessage::read(header, payload) else { panic!("no sweep") };
    assert_eq!((sweep.ranges_m.len(), sweep.fan), (682, None));
    for (beam, range_m) in
        [(0, 1.72698), (85, 1.50001), (255, 2.9903), (340, 3.65002), (341, 3.65002), (596, 1.50001)]
    {
        assert!(
            // The page of the protocol prints four or five digits.
            (sweep.ranges_m.get(beam) - range_m).abs() < 2e-5,
            "beam {beam}: {}",
            sweep.ranges_m.get(beam)
        );
    }
    assert_eq!((0..682).filter(|beam| sweep.ranges_m.get(*beam) == 5.6).count(), 69);
    // Each beam of the scan lies half a step beside those of Stage.
    let fan = message::fan(RANGER, first(&push, RANGER, kind::ACK, 5)).unwrap();
    let mut ranges_mm = [0_u32; 682];
    Beams::new(fan, 682, 1.0, &ScannerDescription::default())
        .unwrap()
        .fill(|beam| sweep.ranges_m.get(beam), &mut ranges_mm);
    assert_eq!(ranges_mm[340], 3650);
    assert!(ranges_mm[0].abs_diff(1727) < 5, "{}", ranges_mm[0]);
    assert!((60..80).contains(&ranges_mm.iter().filter(|range| **range == 0).count()));
}

#[test]
fn states_carry_the_pose_and_commands_move_it() {
    let poses: Vec<[f64; 3]> = messages(PUSH, 4096)
        .iter()
        .filter_map(|(header, payload)| match ServerMessage::read(header, payload) {
            Ok(ServerMessage::State(state)) => Some(state.pose),
            _ => None,
        })
        .collect();
    assert_eq!(poses.len(), 3);
    assert!(poses.iter().all(|pose| pose.iter().all(|number| number.abs() < 0.2)), "{poses:?}");
}

/// The sessions as a whole, in a folder that `PLAYER_RECORDINGS` names: the crate has only their beginnings.
#[test]
fn whole_sessions_are_read_to_their_last_byte() {
    let Some(folder) = std::env::var_os("PLAYER_RECORDINGS").map(std::path::PathBuf::from) else {
        return eprintln!("skipped: PLAYER_RECORDINGS names no folder with whole sessions");
    };
    for (name, expected) in [("own-push-ranger", [61, 61, 11]), ("ref-pull-ranger", [39, 39, 39])] {
        let bytes = std::fs::read(folder.join(format!("{name}.s2c.bin"))).unwrap();
        let all = messages(&bytes, 1000);
        assert_eq!(bytes.len(), 32 + all.iter().map(|(_, payload)| HEADER + payload.len()).sum::<usize>());
        all.iter().for_each(|(header, payload)| _ = ServerMessage::read(header, payload).unwrap());
        let counts = counts(&all);
        let count = |interface, subtype| counts[&(interface, kind::DATA, subtype)];
        let found =
            [count(interface::POSITION2D, 1), count(interface::RANGER, 1), count(interface::RANGER, 3)];
        assert_eq!(found, expected, "{name}");
    }
}

/// The messages that a client sent.
fn sent(bytes: &[u8]) -> Vec<(MessageHeader, &[u8])> {
    let (mut all, mut rest) = (Vec::new(), bytes);
    while let Ok(header) = MessageHeader::read(rest) {
        let end = HEADER + header.size as usize;
        all.push((header, &rest[..end]));
        rest = &rest[end..];
    }
    assert!(rest.is_empty());
    all
}

#[test]
fn every_message_that_a_client_sent_is_written_with_the_same_bytes() {
    for (bytes, unknown) in [(PUSH_SENT, 3), (PULL_SENT, 0)] {
        let mut others = 0;
        for (header, message) in sent(bytes) {
            let Some(command) = ClientMessage::read(&header, &message[HEADER..]).unwrap() else {
                assert_eq!(header.device.interface, SIMULATION);
                others += 1;
                continue;
            };
            let mut written = Vec::new();
            command.write(&mut written, header.time_s, header.sequence);
            // The C library sends its own port, and in driver information the address of the server.
            written[4..8].copy_from_slice(&message[4..8]);
            if matches!(command, ClientMessage::DriverInfo(_)) {
                written[HEADER..HEADER + 8].copy_from_slice(&message[HEADER..HEADER + 8]);
            }
            assert_eq!(written, message, "{command:?}");
        }
        assert_eq!(others, unknown);
    }
}

#[test]
fn commands_are_those_that_were_given() {
    let commands = |bytes| -> Vec<ClientMessage> {
        let read = |(header, message): &(MessageHeader, &[u8])| {
            ClientMessage::read(header, &message[HEADER..]).unwrap()
        };
        sent(bytes).iter().filter_map(read).collect()
    };
    let push = commands(PUSH_SENT);
    assert!(push.contains(&ClientMessage::Car(BASE, [0.8, 0.0])));
    assert!(push.contains(&ClientMessage::Velocity(BASE, [0.0; 3])));
    assert!(push.contains(&ClientMessage::Queue(Some((RANGER, 3)), QueueRule::Ignore)));
    assert!(push.contains(&ClientMessage::Subscribe(BASE, access::CLOSE)));
    let pull = commands(PULL_SENT);
    assert_eq!(
        pull[..3],
        [
            ClientMessage::Deliver(DeliveryMode::Pull),
            ClientMessage::Queue(None, QueueRule::Replace),
            ClientMessage::Devices
        ]
    );
    assert_eq!(pull.iter().filter(|command| **command == ClientMessage::Round).count(), 37);
}

#[test]
fn the_conversation_ends_with_the_answers_of_the_server() {
    let answers: Vec<(MessageHeader, Vec<u8>)> =
        messages(PULL, 4096).into_iter().filter(|(header, _)| header.kind == kind::ACK).collect();
    let config = PlayerConfig { delivery: Delivery::Pull, ..PlayerConfig::default() };
    let (mut requests, mut session) = (Vec::new(), None);
    let mut handshake = Handshake::new(&config, 0, &mut requests);
    // Answers of the recording in its order, until those that this client asks for have all come.
    for _ in 0..4 {
        for (header, payload) in &answers {
            let message = ServerMessage::read(header, payload).unwrap();
            session = session.or(handshake.take(header, &message, 0, &mut requests).unwrap());
        }
    }
    let session = session.unwrap();
    assert_eq!((session.scanner, session.body_m), (Some(RANGER), Some([0.6, 0.45])));
    assert_eq!(session.mounting, Some([0.2, 0.0, 0.0]));
}

/// Reads a stream as the client does, until its end or its first error; returns how many messages there were.
fn survive(bytes: &[u8], chunk: usize) -> usize {
    let (mut stream, mut count, mut requests) = (MessageStream::default(), 0, Vec::new());
    let mut handshake = Handshake::new(&PlayerConfig::default(), 0, &mut requests);
    let mut fan = Fan { first_rad: -2.0, last_rad: 2.0, min_range_m: 0.0, max_range_m: 5.6 };
    let mut ranges_mm = [0_u32; 682];
    for part in bytes.chunks(chunk) {
        let space = stream.space();
        assert!(space.len() >= part.len(), "the stream keeps its memory");
        space[..part.len()].copy_from_slice(part);
        stream.add(part.len());
        while let Ok(Some((header, payload))) = stream.next() {
            count += 1;
            let Ok(message) = ServerMessage::read(&header, payload) else { return count };
            let _ = handshake.take(&header, &message, 0, &mut requests);
            if let Ok(changed) = message::fan(header.device, payload) {
                fan = changed;
            }
            if let ServerMessage::Sweep(sweep) = message
                && let Ok(beams) = Beams::new(fan, sweep.ranges_m.len(), 1.0, &ScannerDescription::default())
            {
                beams.fill(|beam| sweep.ranges_m.get(beam), &mut ranges_mm);
            }
        }
        if stream.next().is_err() {
            return count;
        }
    }
    assert!(requests.len() < 2000, "few requests, whatever is answered");
    count
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 10_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn mutated_streams_neither_panic_nor_take_memory(
        mutations in vec((0..6_500_usize, any::<u8>()), 1..12),
        removed in prop::option::of((0..6_400_usize, 1..100_usize)),
        chunk in 1..3_000_usize,
        pull in any::<bool>(),
    ) {
        let mut bytes = (if pull { PULL } else { PUSH })[..6_700].to_vec();
        for (place, byte) in mutations {
            bytes[place] ^= byte;
        }
        if let Some((start, count)) = removed {
            bytes.drain(start..start + count);
        }
        prop_assert!(survive(&bytes, chunk) <= bytes.len() / HEADER);
    }
}

#[test]
fn the_laser_of_older_robots_is_read() {
    let mut payload = Vec::new();
    for number in [-2.0_f32, 2.0, 0.1, 4.0] {
        payload.extend_from_slice(&number.to_be_bytes());
    }
    for count in [3, 3] {
        xdr::put_u32(&mut payload, count);
    }
    for range in [1.0_f32, 2.5, 4.0] {
        payload.extend_from_slice(&range.to_be_bytes());
    }
    xdr::put_text(&mut payload, &[1, 2, 3]);
    xdr::put_u32(&mut payload, 0);
    let device = DeviceAddress { interface: interface::LASER, index: 0 };
    let header = |subtype, size: usize| MessageHeader {
        host: 0,
        robot: 0,
        device,
        kind: kind::DATA,
        subtype,
        time_s: 1.0,
        sequence: 0,
        size: size as u32,
    };
    for subtype in [1, 2] {
        let Ok(ServerMessage::Sweep(sweep)) = ServerMessage::read(&header(subtype, payload.len()), &payload)
        else {
            panic!("no sweep")
        };
        assert_eq!(
            sweep.fan,
            Some(Fan { first_rad: -2.0, last_rad: 2.0, min_range_m: 0.0, max_range_m: 4.0 })
        );
        assert_eq!([0, 1, 2].map(|beam| sweep.ranges_m.get(beam)), [1.0, 2.5, 4.0]);
        xdr::put_f64s(&mut payload, &[0.0; 3]);
    }
}
