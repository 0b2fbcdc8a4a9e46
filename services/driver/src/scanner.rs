//! A Hokuyo scanner at this computer, beside a base that a driver is connected to: read by a thread of its own.

use std::fmt::Write as _;

use key_table::{Documented, Invalid};
use runtime::monotonic_ns;
use shared_types::{Device, DeviceState, Scan, ScanGeometry};
use urg::{Coding, Reading, ScannerConnection, ScannerPlace, SourceState, UrgError};
use vehicle::ScannerDescription;

use crate::event::RobotEvent;
use crate::feed::Outlet;

/// Longest time in one call [ns].
const WAIT_NS: u64 = 20_000_000;
/// So many damaged scans one after the other are a fault: a single one is not.
const MAX_DAMAGED: u64 = 3;

/// What the key `urg` may be.
pub const PLACE: Documented =
    Documented { text: "a device, or HOST:PORT", schema: "pattern = '^/|.:[0-9]+$'" };

/// Which scanner, and how it is read.
#[derive(Debug, Clone, PartialEq)]
pub struct ScannerSettings {
    /// Its device, or `HOST:PORT`.
    pub place: String,
    /// Scans that are left out after each one.
    pub skip: u32,
    /// Steps that are merged to one.
    pub cluster: u32,
    /// Whether ranges have two characters instead of three.
    pub two_characters: bool,
    /// Bit rate of a serial line [bit/s].
    pub bit_rate: u32,
}

impl ScannerSettings {
    /// The device or address, and what it may be.
    ///
    /// # Errors
    /// A text that is neither.
    pub fn require_place(place: &str) -> Result<(), Invalid> {
        let allowed = "a device such as /dev/ttyACM0, or HOST:PORT";
        ScannerPlace::parse(place).map(|_| ()).map_err(|_| Invalid::new("urg", format!("{place:?}"), allowed))
    }
}

/// Hands scans with the beams of the `described` scanner and states, each made an event of the driver by `event`, over until the
/// driver ends, or until the scanner can't be used. The crate `urg` connects again by itself. The driver stops its wheels `timeout_ns` after the last scan,
/// two periods.
pub fn read<E: Send + 'static>(
    settings: &ScannerSettings,
    described: &ScannerDescription,
    timeout_ns: u64,
    outlet: &Outlet<E>,
    event: impl Fn(RobotEvent) -> E,
) {
    if let Err(error) = follow(settings, described.geometry(), 2e9 / timeout_ns as f64, outlet, &event) {
        tracing::error!(%error, "the scanner can't be used: there are no scans");
        let mut device = Device::default();
        device.note(DeviceState::Fault, &error.to_string(), monotonic_ns());
        outlet.put(event(RobotEvent::Scanner(device)));
    }
}

fn follow<E: Send + 'static>(
    settings: &ScannerSettings,
    beams: ScanGeometry,
    rate_hz: f64,
    outlet: &Outlet<E>,
    event: &impl Fn(RobotEvent) -> E,
) -> Result<(), UrgError> {
    let urg = urg::ScannerConfig {
        rate_hz: Some(rate_hz),
        beams,
        skip: settings.skip as u8,
        cluster: settings.cluster as u8,
        bit_rate: settings.bit_rate,
        coding: if settings.two_characters { Coding::Two } else { Coding::Three },
        ..urg::ScannerConfig::new(ScannerPlace::parse(&settings.place)?)
    };
    let mut source = ScannerConnection::open(urg, monotonic_ns);
    let (mut scan, mut health) = (Scan::default(), Health::default());
    while !outlet.is_ended() {
        let reading = source.next(WAIT_NS, &mut scan)?;
        if reading.is_some() {
            outlet.offer(event(RobotEvent::Scan {
                ranges_mm: scan.ranges_mm,
                is_missing: scan.missing.is_set(),
                front_ns: scan.header.acquired_ns,
                sweep_ns: scan.sweep_ns,
                arrived_ns: monotonic_ns(),
            }));
        }
        if let Some(device) = health.changed(&source, reading.as_ref()) {
            tracing::info!(state = device.state().name(), reason = device.reason(), "scanner");
            if !outlet.put(event(RobotEvent::Scanner(device))) {
                break;
            }
        }
    }
    Ok(())
}

/// What the scanner does, and what became of its newest scans.
#[derive(Debug, Default)]
struct Health {
    device: Device,
    /// Damaged scans since the last good one.
    damaged: u64,
    /// What was wrong with the newest damaged scan.
    damage: String,
    text: String,
}

impl Health {
    /// The state of the scanner, if it has changed.
    fn changed(&mut self, source: &ScannerConnection, reading: Option<&Reading>) -> Option<Device> {
        match reading {
            Some(reading) if reading.is_missing => {
                self.damaged += 1;
                self.damage.clear();
                self.damage.push_str(source.message());
            }
            Some(_) => self.damaged = 0,
            None => {}
        }
        let (counted, message) = (source.counters().broken, source.message());
        self.text.clear();
        let state = match source.state() {
            SourceState::Measuring => {
                if !self.damage.is_empty() {
                    // Writing to a text does not fail.
                    let _ = write!(self.text, "{} ({counted} damaged in all)", self.damage);
                }
                if self.damaged < MAX_DAMAGED { DeviceState::Running } else { DeviceState::Fault }
            }
            state => {
                self.text.push_str(message);
                let is_fault = state == SourceState::Stalled || !message.is_empty();
                if is_fault { DeviceState::Fault } else { DeviceState::Connecting }
            }
        };
        self.device.note(state, &self.text, monotonic_ns()).then_some(self.device)
    }
}
