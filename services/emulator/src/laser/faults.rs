//! What a faulty scanner makes of its readings.
//!
//! The order is that of the light's way: a surface that is too black, dropouts, dust and salt, a covered part of the
//! window, and last electronics that repeat old ranges. Each fault draws from a stream of its own, for all beams. So a
//! fault never changes the noise or another fault, and more of it disturbs the same beams and others. Only a scanner
//! that is turned sees other surfaces, with other noise.

use shared_types::{MAX_BEAMS, MIN_RANGE_MM, ScanGeometry};

use super::{NO_RETURN, Sweep};
use crate::noise::{NoiseStream, Purpose};
use crate::scenario::{Scanner, Scenario};

/// Nearest random range of dust and salt [m].
const MIN_RANGE_M: f64 = MIN_RANGE_MM as f64 * 1e-3;

/// Farthest random range of dust [m].
const DUST_M: f64 = 1.0;

/// Error codes and how many of 10,000 beams without a return carry them.
///
/// Shares of a recorded URG-04LX indoors: 95 % are 0, 3.7 % are 7, 1 % are 6, few are the rest.
const CODES: [(u32, u32); 8] = [(0, 9_500), (7, 370), (6, 100), (10, 6), (8, 6), (15, 6), (2, 6), (1, 6)];

/// Linear error of ranges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scale {
    factor: f64,
    offset_m: f64,
}

impl Scale {
    /// Ranges as they are.
    pub(super) const TRUE: Self = Self { factor: 1.0, offset_m: 0.0 };

    /// What is reported of a range [m].
    pub(super) fn applied(&self, range_m: f64) -> f64 {
        self.factor * range_m + self.offset_m
    }
}

/// The faults of a scanner, and what it repeats.
#[derive(Debug, Clone)]
pub(super) struct Faults {
    seed: u64,
    scanner: Scanner,
    geometry: ScanGeometry,
    /// Largest range that it reports [m].
    range_m: f64,
    /// Ranges that it repeats while it is stuck.
    pub(super) held: Option<[u32; MAX_BEAMS]>,
}

impl Faults {
    pub(super) fn new(scenario: &Scenario) -> Self {
        let device = scenario.true_scanner();
        Self {
            seed: scenario.seed,
            scanner: scenario.scanner.clone(),
            geometry: device.geometry(),
            range_m: device.range_m,
            held: None,
        }
    }

    /// How far the scanner is turned at a time [rad].
    pub(super) fn yaw_at(&self, time_ns: u64) -> f64 {
        if self.scanner.acts_at(time_ns) { self.scanner.yaw_rad } else { 0.0 }
    }

    /// The error of ranges at a time.
    pub(super) fn scale_at(&self, time_ns: u64) -> Scale {
        let Scanner { range_factor, range_offset_m, .. } = self.scanner;
        if self.scanner.acts_at(time_ns) {
            Scale { factor: range_factor, offset_m: range_offset_m }
        } else {
            Scale::TRUE
        }
    }

    /// Takes the returns of black surfaces that are too far away; `ranges` are the true ones [m].
    pub(super) fn absorb(&self, time_ns: u64, ranges: &[f64], black: &[bool], ranges_mm: &mut [u32]) {
        if !self.scanner.acts_at(time_ns) {
            return;
        }
        for (reading, (range, is_black)) in ranges_mm.iter_mut().zip(ranges.iter().zip(black)) {
            if *is_black && *range > self.scanner.black_range_m {
                *reading = NO_RETURN;
            }
        }
    }

    /// Loses and replaces readings.
    pub(super) fn disturb(&self, sweep: &Sweep, ranges_mm: &mut [u32]) {
        if !self.scanner.acts_at(sweep.front_ns) {
            return;
        }
        let Scanner { salt, dust, .. } = self.scanner;
        let stream = |purpose| NoiseStream::new(self.seed, purpose, sweep.scan_id);
        lose(self.scanner.dropout_at(sweep.front_ns), stream(Purpose::Dropout), ranges_mm);
        scatter(dust, DUST_M, stream(Purpose::Dust), ranges_mm);
        scatter(salt, self.range_m, stream(Purpose::Salt), ranges_mm);
        self.cover(ranges_mm);
    }

    /// Takes all returns of the dead sectors.
    fn cover(&self, ranges_mm: &mut [u32]) {
        if self.scanner.dead_rad.is_empty() {
            return;
        }
        for (beam, reading) in ranges_mm.iter_mut().enumerate() {
            let yaw = self.geometry.yaw_rad(beam);
            if self.scanner.dead_rad.iter().any(|[from, to]| (*from..=*to).contains(&yaw)) {
                *reading = NO_RETURN;
            }
        }
    }

    /// Repeats the first scan from the time on at which the scanner is stuck.
    pub(super) fn hold(&mut self, time_ns: u64, ranges_mm: &mut [u32]) {
        if self.scanner.is_stuck_at(time_ns) {
            let held = self.held.get_or_insert_with(|| {
                let mut first = [0; MAX_BEAMS];
                first[..ranges_mm.len()].copy_from_slice(ranges_mm);
                first
            });
            ranges_mm.copy_from_slice(&held[..ranges_mm.len()]);
        } else {
            self.held = None;
        }
    }
}

/// Loses a share of the beams.
fn lose(share: f64, mut stream: NoiseStream, ranges_mm: &mut [u32]) {
    if share <= 0.0 {
        return;
    }
    for reading in ranges_mm {
        if stream.chance(share) {
            *reading = NO_RETURN;
        }
    }
}

/// Replaces a share of the readings by random ranges of at most `reach_m`.
fn scatter(share: f64, reach_m: f64, mut stream: NoiseStream, ranges_mm: &mut [u32]) {
    if share <= 0.0 {
        return;
    }
    for reading in ranges_mm {
        let (is_hit, range) = (stream.chance(share), stream.between(MIN_RANGE_M, reach_m));
        if is_hit {
            *reading = (range * 1000.0).round() as u32;
        }
    }
}

/// Gives each beam without a return an error code, whatever the reason, so that a code tells nothing.
pub(super) fn draw_codes(seed: u64, scan_id: u64, ranges_mm: &mut [u32]) {
    let mut stream = NoiseStream::new(seed, Purpose::Code, scan_id);
    for reading in ranges_mm {
        let code = code_of(stream.uniform());
        if *reading < MIN_RANGE_MM {
            *reading = code;
        }
    }
}

/// The error code for a random number in [0, 1).
fn code_of(uniform: f64) -> u32 {
    let mut left = (uniform * 10_000.0) as u32;
    for (code, share) in CODES {
        if left < share {
            return code;
        }
        left -= share;
    }
    NO_RETURN
}

#[cfg(test)]
mod tests;
