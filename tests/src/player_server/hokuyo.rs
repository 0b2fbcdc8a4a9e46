//! A Hokuyo scanner on the robot behind the server, at a TCP port of its own.

use std::io;

use runtime::monotonic_ns;
use shared_types::FRONT_BEAM;
use urg::{DeviceFault, Port, ScannerEmulator};

use super::world::MAX_RANGE_M;

/// First step of the scanner that is a beam of a scan.
const FIRST_STEP: usize = 44;
/// Steps of a turn, and time of a turn [ns].
const STEPS: u64 = 1024;
const TURN_NS: u64 = 100_000_000;
/// The scanner ends its sweep this much after the server has measured, so that it never sends the sweep before [ns].
const AFTER_NS: u64 = 1_000_000;

/// Error code of a beam without a return.
const NO_RETURN: u32 = 0;

/// The scanner.
#[derive(Debug)]
pub(super) struct Hokuyo {
    port: Port,
    /// What happens to scans, and to how many.
    pub(super) damage: (DeviceFault, usize),
    /// What it has measured, by beam [mm].
    pub(super) shown: Vec<Vec<u32>>,
}

impl Hokuyo {
    /// A scanner whose front beam is taken together with that of the server, at `front_ns` and every period after.
    pub(super) fn new(front_ns: u64) -> io::Result<Self> {
        let to_front_ns = (FIRST_STEP + FRONT_BEAM) as u64 * TURN_NS / STEPS;
        let emulator = ScannerEmulator::new(front_ns + AFTER_NS - to_front_ns, 0);
        Ok(Self {
            port: Port::tcp("127.0.0.1:0", emulator)?,
            damage: (DeviceFault::Checksum, 0),
            shown: Vec::new(),
        })
    }

    /// Its address.
    pub(super) fn place(&self) -> String {
        self.port.address().map(|address| address.to_string()).unwrap_or_default()
    }

    /// Stands before these ranges, by beam [m].
    pub(super) fn show(&mut self, ranges_m: &[f64]) {
        let in_mm =
            |range_m: &f64| if *range_m < MAX_RANGE_M { (range_m * 1e3).round() as u32 } else { NO_RETURN };
        let ranges_mm: Vec<u32> = ranges_m.iter().map(in_mm).collect();
        let steps = self.port.emulator.scene().iter_mut().skip(FIRST_STEP);
        steps.zip(&ranges_mm).for_each(|(step, range_mm)| *step = *range_mm);
        self.shown.push(ranges_mm);
        let (fault, count) = self.damage;
        if count > 0 {
            self.port.emulator.inject(fault, monotonic_ns());
            self.damage = (fault, count - 1);
        }
    }

    /// Answers what has come, and sends the scan that is complete.
    pub(super) fn serve(&mut self) {
        // A connection that has ended is made anew by the host.
        let _ = self.port.serve(0, monotonic_ns);
    }
}
