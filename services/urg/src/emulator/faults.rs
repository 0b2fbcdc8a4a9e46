//! What can go wrong with a scanner and its line.

use std::collections::VecDeque;

use crate::status::ScipStatus;

/// A fault of the emulated scanner.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeviceFault {
    /// The next scan has a wrong byte in the middle.
    Checksum,
    /// The second half of the next scan is missing.
    HalfScan,
    /// The next scan stops in the middle for this time, and all that follows with it [ms].
    Stall(u64),
    /// The next scan stops in the middle for ever, until the host sends `QT`.
    Stuck,
    /// This many bytes that are no reply come now.
    Garbage(usize),
    /// Power-up: the laser is off, the counter zero, the protocol SCIP 1.1.
    Restart,
    /// The counter is set back by this time [ms].
    Backwards(u64),
    /// From now on `TM0` and `TM1` have these statuses, in this order.
    TimeStatus([ScipStatus; 2]),
    /// The measurement ends with this status.
    Status(ScipStatus),
}

/// Faults of the next scan, and bytes that are held back.
#[derive(Debug, Clone, Default)]
pub(crate) struct Faults {
    next: VecDeque<DeviceFault>,
    held: Vec<u8>,
    /// Until when bytes are held back; `u64::MAX` for ever [ns].
    until_ns: Option<u64>,
}

impl Faults {
    pub(crate) fn add(&mut self, fault: DeviceFault) {
        self.next.push_back(fault);
    }

    /// Changes a scan that would be sent now.
    pub(crate) fn damage(&mut self, scan: &mut Vec<u8>, now_ns: u64) {
        let half = scan.len() / 2;
        match self.next.pop_front() {
            Some(DeviceFault::Checksum) => scan[half] ^= 1,
            Some(DeviceFault::HalfScan) => scan.truncate(half),
            Some(DeviceFault::Stall(ms)) => self.hold(scan.split_off(half), now_ns + ms * 1_000_000),
            Some(DeviceFault::Stuck) => self.hold(scan.split_off(half), u64::MAX),
            _ if self.until_ns.is_some() => self.held.append(scan),
            _ => {}
        }
        // A stuck scanner holds back no more than some seconds.
        self.held.truncate(1 << 16);
    }

    fn hold(&mut self, rest: Vec<u8>, until_ns: u64) {
        self.held.extend(rest);
        self.until_ns = Some(until_ns);
    }

    /// Sends what was held back for long enough.
    pub(crate) fn release(&mut self, now_ns: u64, output: &mut VecDeque<u8>) {
        if self.until_ns.is_some_and(|until_ns| until_ns <= now_ns) {
            self.until_ns = None;
            output.extend(self.held.drain(..));
        }
    }

    /// Drops what was held back: the measurement has ended. Faults of scans to come remain.
    pub(crate) fn drop_held(&mut self) {
        self.held.clear();
        self.until_ns = None;
    }

    pub(crate) fn release_ns(&self) -> Option<u64> {
        self.until_ns.filter(|until_ns| *until_ns != u64::MAX)
    }
}
