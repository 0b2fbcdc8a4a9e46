//! A Hokuyo scanner at this computer, beside a base at the server: read by a thread of its own.

use std::fmt::Write as _;

use runtime::monotonic_ns;
use shared_types::{Device, DeviceState, Scan};
use urg::{Coding, Reading, ScannerConnection, ScannerPlace, SourceState, UrgError};

use super::{ClientEvent, Outlet};
use crate::PlayerConfig;

/// Longest time in one call [ns].
const WAIT_NS: u64 = 20_000_000;
/// So many damaged scans one after the other are a fault: a single one is not.
const MAX_DAMAGED: u64 = 3;

/// Hands the scans over until the driver ends, or until the scanner can't be used. The crate `urg` connects again by itself.
pub(super) fn read(config: &PlayerConfig, rate_hz: f64, outlet: &Outlet) {
    if let Err(error) = follow(config, rate_hz, outlet) {
        tracing::error!(%error, "the scanner can't be used: there are no scans");
        let mut device = Device::default();
        device.note(DeviceState::Fault, &error.to_string(), monotonic_ns());
        outlet.put(ClientEvent::Scanner(device));
    }
}

fn follow(config: &PlayerConfig, rate_hz: f64, outlet: &Outlet) -> Result<(), UrgError> {
    let urg = urg::ScannerConfig {
        rate_hz: Some(rate_hz),
        skip: config.urg_skip as u8,
        cluster: config.urg_cluster as u8,
        bit_rate: config.urg_bit_rate,
        coding: if config.urg_two_characters { Coding::Two } else { Coding::Three },
        ..urg::ScannerConfig::new(ScannerPlace::parse(&config.urg)?)
    };
    let mut source = ScannerConnection::open(urg, monotonic_ns);
    let (mut scan, mut health) = (Scan::default(), Health::default());
    while !outlet.is_ended() {
        let reading = source.next(WAIT_NS, &mut scan)?;
        if reading.is_some() {
            outlet.offer(ClientEvent::Scan {
                ranges_mm: *scan.ranges_mm.first_chunk().expect("a scan has room for more beams"),
                is_missing: scan.missing.is_set(),
                front_ns: scan.header.acquired_ns,
                sweep_ns: scan.sweep_ns,
                arrived_ns: monotonic_ns(),
            });
        }
        if let Some(device) = health.changed(&source, reading.as_ref()) {
            tracing::info!(state = device.state().name(), reason = device.reason(), "scanner");
            if !outlet.put(ClientEvent::Scanner(device)) {
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
