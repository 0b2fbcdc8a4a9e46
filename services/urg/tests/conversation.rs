//! Source side and emulated scanner in simulated time, without a connection.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use proptest::prelude::*;
use shared_types::{BEAMS, FRONT_BEAM, Sample, Scan};
use urg::{
    ClockEvent, Coding, Completed, DeviceFault, Measurement, Parser, Reading, ScannerConfig, ScannerEmulator,
    ScannerPlace, ScannerSession, ScipStatus, SourceState,
};

const MS: u64 = 1_000_000;
const COMMANDS: &[u8] = include_bytes!("data/scip-urglib-tcp.c2s.bin");
const REPLIES: &[u8] = include_bytes!("data/scip-urglib-tcp.s2c.bin");

/// Changes bytes on their way.
type Damage = Box<dyn FnMut(&mut Vec<u8>)>;

/// A session and a scanner, joined by lines that take a millisecond.
struct Pair {
    session: ScannerSession,
    emulator: ScannerEmulator,
    now_ns: u64,
    readings: Vec<(Reading, Scan)>,
    states: Vec<SourceState>,
    /// Applied to all that the scanner sends.
    damage: Damage,
}

impl Pair {
    fn new(change: impl FnOnce(&mut ScannerConfig)) -> Self {
        let mut config = ScannerConfig::new(ScannerPlace::parse("/dev/none").unwrap());
        change(&mut config);
        let now_ns = 5_000 * MS;
        let mut session = ScannerSession::new(config);
        session.connected(now_ns);
        Self {
            session,
            emulator: ScannerEmulator::new(1_000 * MS, 3000),
            now_ns,
            readings: Vec::new(),
            states: Vec::new(),
            damage: Box::new(|_| {}),
        }
    }

    /// Lets time pass, a millisecond at a time; bytes of the scanner come in pieces of 64.
    fn run(&mut self, milliseconds: u64) -> &mut Self {
        for _ in 0..milliseconds {
            self.now_ns += MS;
            self.session.poll(self.now_ns);
            let sent = self.session.output().to_vec();
            self.session.sent(sent.len());
            self.emulator.receive(&sent, self.now_ns);
            self.emulator.advance(self.now_ns);
            let mut bytes: Vec<u8> = self.emulator.output().drain(..).collect();
            (self.damage)(&mut bytes);
            bytes.chunks(64).for_each(|piece| self.take(piece));
            if self.states.last() != Some(&self.session.state()) {
                self.states.push(self.session.state());
            }
            if self.session.gave_up() {
                self.session.disconnected("gave up");
                self.session.connected(self.now_ns);
            }
        }
        self
    }

    fn take(&mut self, mut piece: &[u8]) {
        while !piece.is_empty() {
            let mut scan = Scan::default();
            scan.header.layout = Scan::LAYOUT;
            let (count, reading) = self.session.receive(piece, self.now_ns, &mut scan).unwrap();
            piece = &piece[count..];
            if let Some(reading) = reading {
                assert_eq!(scan.check(), Ok(()));
                self.readings.push((reading, scan));
            }
        }
    }

    /// Scans with ranges.
    fn scans(&self) -> usize {
        self.readings.iter().filter(|(reading, _)| !reading.is_missing).count()
    }

    fn inject(&mut self, fault: DeviceFault) -> &mut Self {
        self.emulator.inject(fault, self.now_ns);
        self
    }
}

fn measuring() -> Pair {
    let mut pair = Pair::new(|_| {});
    pair.run(2_000);
    assert_eq!(pair.states, [SourceState::Starting, SourceState::Measuring]);
    pair
}

#[test]
fn the_emulator_answers_the_recorded_commands_with_the_recorded_bytes() {
    let mut parser = Parser::default();
    let first = REPLIES.iter().position(|byte| parser.push(*byte) == Some(Completed::Scan)).unwrap();
    assert!(first > 0);
    let mut emulator = ScannerEmulator::new(0, 0);
    let scene = emulator.scene();
    scene[44..=725].copy_from_slice(parser.ranges());
    // When the commands come; the last ones after the scans of those before.
    let times = [136, 136, 136, 136, 136, 136, 136, 136, 136, 136, 136, 136, 137, 675, 676, 1355, 1356, 1580];
    let lines = COMMANDS[1..].split_inclusive(|byte| *byte == b'\n');
    let mut replies = Vec::new();
    assert_eq!(lines.clone().count(), times.len());
    for (line, ms) in lines.zip(times) {
        emulator.advance(ms * MS);
        emulator.receive(line, ms * MS);
        replies.extend(emulator.output().drain(..));
    }
    let same = replies.iter().zip(REPLIES).take_while(|(own, recorded)| own == recorded).count();
    let text = |bytes: &[u8]| String::from_utf8_lossy(&bytes[same.saturating_sub(40)..][..80]).into_owned();
    assert_eq!(same, REPLIES.len(), "\n{}\n{}", text(&replies), text(REPLIES));
    assert_eq!(replies.len(), REPLIES.len());
}

#[test]
fn a_scanner_is_identified_started_and_read() {
    let pair = measuring();
    assert!(pair.scans() >= 10, "{}", pair.scans());
    assert_eq!(pair.session.identity().value("SERI").unwrap(), "E0000001");
    let (reading, scan) = pair.readings.last().unwrap();
    // The emulator counts from 1 s; each turn takes 100 ms, and looks ahead after 37.5 ms.
    let front_ns = 1_000 * MS + u64::from(reading.stamp_ms) * MS + 37_500_000;
    assert!(scan.header.acquired_ns.abs_diff(front_ns) <= reading.error_ns, "{reading:?}");
    assert!(reading.error_ns < 4 * MS, "{reading:?}");
    assert_eq!((scan.ranges_mm[FRONT_BEAM], scan.sweep_ns, scan.period_ns), (3000, 66_601_562, 100 * MS));
}

#[test]
fn two_characters_and_skipped_scans_are_asked_for() {
    let mut pair = Pair::new(|config| (config.coding, config.skip) = (Coding::Two, 1));
    pair.emulator.scene()[384] = 5000;
    pair.run(3_000);
    let (_, scan) = pair.readings.last().unwrap();
    assert_eq!((scan.ranges_mm[FRONT_BEAM], scan.ranges_mm[0], scan.period_ns), (0, 3000, 200 * MS));
    let stamps: Vec<u32> = pair.readings.iter().map(|(reading, _)| reading.stamp_ms).collect();
    assert!(stamps.windows(2).all(|pair| pair[1] - pair[0] == 200), "{stamps:?}");
}

#[test]
fn a_scanner_that_starts_in_scip_1_or_in_time_mode_is_switched() {
    for prepare in [&b"TM0\n"[..], b"MD0044072501000\n", b"BM\n"] {
        let mut pair = Pair::new(|_| {});
        pair.emulator.receive(prepare, pair.now_ns);
        assert!(pair.run(2_000).scans() > 8, "{}", String::from_utf8_lossy(prepare));
    }
    let mut pair = Pair::new(|_| {});
    pair.inject(DeviceFault::Restart);
    assert!(pair.run(2_000).scans() > 8);
}

#[test]
fn a_damaged_scan_is_marked_as_missing_and_costs_no_other() {
    for fault in [DeviceFault::Checksum, DeviceFault::HalfScan, DeviceFault::Garbage(500)] {
        let mut pair = measuring();
        let before = pair.readings.len();
        pair.inject(fault).run(90);
        let is_shown = pair.session.message().starts_with("a scan was damaged on the way: ");
        pair.run(910);
        assert_eq!(pair.session.message(), "");
        let missing = pair.readings.iter().filter(|(reading, _)| reading.is_missing).count();
        assert!(missing <= 1, "{fault:?}");
        assert!(pair.readings.len() - before >= 9, "{fault:?}: {}", pair.readings.len() - before);
        assert_eq!(pair.session.counters().restarts, 0, "{fault:?}");
        assert!(fault == DeviceFault::Garbage(500) || missing == 1, "{fault:?}");
        assert!(is_shown || fault != DeviceFault::Checksum, "{fault:?}");
    }
}

#[test]
fn a_stall_in_the_middle_of_a_scan_is_seen_and_the_scanner_started_again() {
    for fault in [DeviceFault::Stuck, DeviceFault::Stall(2_000), DeviceFault::Status(ScipStatus(*b"55"))] {
        let mut pair = measuring();
        pair.inject(fault).run(4_000);
        let expected =
            [SourceState::Starting, SourceState::Measuring, SourceState::Stalled, SourceState::Measuring];
        assert_eq!(pair.states, expected, "{fault:?}: {}", pair.session.message());
        assert_eq!(pair.session.counters().restarts, 1, "{fault:?}");
        assert_eq!(pair.session.message(), "");
    }
}

#[test]
fn a_short_stall_delays_scans_and_changes_no_stamp() {
    let mut pair = measuring();
    pair.inject(DeviceFault::Stall(150)).run(1_000);
    assert_eq!((pair.states.len(), pair.session.counters().restarts), (2, 0));
    for (reading, scan) in &pair.readings {
        let front_ns = 1_000 * MS + u64::from(reading.stamp_ms) * MS + 37_500_000;
        assert!(scan.header.acquired_ns.abs_diff(front_ns) <= reading.error_ns, "{reading:?}");
    }
}

#[test]
fn a_restart_of_the_device_is_survived() {
    let mut pair = measuring();
    pair.inject(DeviceFault::Restart).run(3_000);
    assert_eq!(*pair.states.last().unwrap(), SourceState::Measuring, "{}", pair.session.message());
    let (reading, scan) = pair.readings.last().unwrap();
    let origin_ns = 7_000 * MS;
    let front_ns = origin_ns + u64::from(reading.stamp_ms) * MS + 37_500_000;
    assert!(
        scan.header.acquired_ns.abs_diff(front_ns) <= reading.error_ns,
        "{reading:?} {}",
        scan.header.acquired_ns
    );
}

#[test]
fn stamps_that_count_backwards_are_reported_and_their_bound_holds() {
    let mut pair = measuring();
    let before = pair.readings.len();
    pair.inject(DeviceFault::Backwards(700)).run(2_000);
    let events: Vec<ClockEvent> = pair.readings[before..].iter().map(|(reading, _)| reading.event).collect();
    assert_eq!(events.iter().filter(|event| **event == ClockEvent::Backwards).count(), 1, "{events:?}");
    assert_eq!(pair.session.counters().clock_jumps, 1);
    for (reading, scan) in &pair.readings[before..] {
        let front_ns = 1_000 * MS + u64::from(reading.stamp_ms + 700) * MS + 37_500_000;
        assert!(scan.header.acquired_ns.abs_diff(front_ns) <= reading.error_ns, "{reading:?}");
    }
}

#[test]
fn a_scanner_that_never_answers_is_given_up_and_tried_again() {
    let mut pair = Pair::new(|_| {});
    for _ in 0..10_000 {
        pair.now_ns += MS;
        pair.session.poll(pair.now_ns);
        pair.session.sent(usize::MAX);
        if pair.session.gave_up() {
            break;
        }
    }
    assert!(pair.session.gave_up());
    assert_eq!(pair.session.message(), "the scanner does not answer QT");
}

#[test]
fn the_emulator_refuses_what_a_scanner_refuses() {
    let mut emulator = ScannerEmulator::new(0, 500);
    let mut ask = |command: &str| {
        emulator.receive(command.as_bytes(), 0);
        emulator.receive(b"\n", 0);
        let reply: Vec<u8> = emulator.output().drain(..).collect();
        String::from_utf8(reply).unwrap().lines().nth(1).unwrap().to_owned()
    };
    let statuses =
        ["GD0044072501", "MD0044080001000", "MD0300020001000", "XY", "TM1", "TM0", "TM0", "QT", "TM2", "TM2"];
    assert_eq!(
        statuses.map(&mut ask),
        ["10Q", "04T", "05U", "0Ee", "04T", "00P", "02R", "0Ee", "00P", "03S"]
    );
    assert_eq!([ask("BM"), ask("BM"), ask("QT")], ["00P", "02R", "00P"]);
    assert!(Measurement::of_echo(b"MD0044072501000").is_some());
}

/// All commands of the start, in the order in which the scanner receives them.
fn commands_of_start(fault: Option<DeviceFault>) -> (Vec<String>, Pair) {
    let mut pair = Pair::new(|_| {});
    if let Some(fault) = fault {
        pair.inject(fault);
    }
    let mut commands = Vec::new();
    for _ in 0..3_000 {
        pair.session.poll(pair.now_ns + MS);
        commands
            .extend(String::from_utf8(pair.session.output().to_vec()).unwrap().lines().map(str::to_owned));
        pair.run(1);
    }
    (commands, pair)
}

#[test]
fn the_laser_is_off_while_the_time_is_read() {
    let (commands, pair) = commands_of_start(None);
    let place = |name: &str| commands.iter().position(|command| command == name).unwrap();
    let times = commands.iter().filter(|command| *command == "TM1").count();
    assert_eq!(times, 10, "{commands:?}");
    let order = ["QT", "TM0", "TM1", "TM2", "BM"].map(place);
    assert!(order.is_sorted(), "{commands:?}");
    assert!(!commands[place("TM0")..place("BM")].iter().any(|command| command.starts_with("MD")));
    assert!(pair.readings.last().unwrap().0.error_ns < 5 * MS, "the round trips are short");
}

#[test]
fn a_scanner_that_refuses_time_mode_measures_with_a_wider_error_bound() {
    let [unknown, command, off] = [ScipStatus(*b"0E"), ScipStatus(*b"04"), ScipStatus(*b"10")];
    let cases = [
        [unknown, unknown],
        [command, command],
        [off, off],
        [ScipStatus::DONE, command],
        [ScipStatus::DONE, off],
    ];
    for statuses in cases {
        let (commands, pair) = commands_of_start(Some(DeviceFault::TimeStatus(statuses)));
        assert_eq!(pair.states, [SourceState::Starting, SourceState::Measuring], "{statuses:?} {commands:?}");
        assert!(pair.scans() >= 15, "{statuses:?}: {} scans", pair.scans());
        // A scanner that entered time mode is asked to leave it before its laser is switched on.
        let leaves = commands.iter().any(|command| command == "TM2");
        assert_eq!(leaves, statuses[0] == ScipStatus::DONE, "{commands:?}");
        for (reading, scan) in &pair.readings {
            let front_ns = 1_000 * MS + u64::from(reading.stamp_ms) * MS + 37_500_000;
            assert!(scan.header.acquired_ns.abs_diff(front_ns) <= reading.error_ns, "{reading:?}");
            assert!(reading.error_ns >= 20 * MS, "without a round trip the delay is only computed");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_scan_of_which_a_part_is_lost_or_changed_gives_no_ranges_and_is_counted(
        from in 0.0..1.0_f64, share in 0.0005..0.5_f64, flip in prop::option::of(0..8_u8),
    ) {
        let mut pair = measuring();
        for (step, range) in pair.emulator.scene().iter_mut().enumerate() {
            *range = 1_000 + 3 * step as u32;
        }
        pair.run(300);
        let (begin, before) = (pair.readings.len(), pair.session.counters());
        let mut is_done = false;
        let place = Arc::new(AtomicUsize::new(0));
        let damaged = Arc::clone(&place);
        pair.damage = Box::new(move |bytes| {
            // A whole scan comes at once; status replies are short.
            if bytes.len() < 1_000 || std::mem::replace(&mut is_done, true) {
                return;
            }
            let at = (from * bytes.len() as f64) as usize;
            damaged.store(at, Ordering::Relaxed);
            match flip {
                Some(bit) => bytes[at] ^= 1 << bit,
                None => drop(bytes.drain(at..(at + 1 + (share * bytes.len() as f64) as usize).min(bytes.len()))),
            }
        });
        pair.run(1_000);
        let after = pair.session.counters();
        let found = after.broken + after.garbage - before.broken - before.garbage;
        // The number of scans that remain is part of the echo, which has no checksum, and no scan depends on it.
        let is_harmless = flip.is_some() && (13..15).contains(&place.load(Ordering::Relaxed));
        prop_assert!((1..=3).contains(&found) || is_harmless && found == 0, "{found} damaged pieces");
        let readings = &pair.readings[begin..];
        for (reading, scan) in readings {
            let expected = |beam: usize| if reading.is_missing { 0 } else { 1_000 + 3 * (44 + beam) as u32 };
            prop_assert!((0..BEAMS).all(|beam| scan.ranges_mm[beam] == expected(beam)), "{reading:?}");
        }
        let whole = readings.iter().filter(|(reading, _)| !reading.is_missing).count();
        prop_assert!((8..=9).contains(&whole) || is_harmless, "{whole} whole scans, the damaged one and one beside it at most are lost");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_line_that_damages_bytes_for_a_while_is_survived(seed in 1_u64..u64::MAX, one_in in 20_u64..4_000) {
        let mut pair = measuring();
        let mut random = seed;
        pair.damage = Box::new(move |bytes| {
            bytes.retain_mut(|byte| {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let value = random >> 33;
                if value.is_multiple_of(one_in) {
                    *byte = (value >> 16) as u8;
                }
                !value.is_multiple_of(3 * one_in)
            });
        });
        pair.run(20_000);
        pair.damage = Box::new(|_| {});
        pair.run(8_000);
        let before = pair.scans();
        prop_assert!(pair.run(1_000).scans() >= before + 9, "{}", pair.session.message());
        for (reading, scan) in &pair.readings[pair.readings.len() - 9..] {
            let front_ns = 1_000 * MS + u64::from(reading.stamp_ms) * MS + 37_500_000;
            prop_assert!(scan.header.acquired_ns.abs_diff(front_ns) <= reading.error_ns, "{:?}", reading);
        }
    }
}
