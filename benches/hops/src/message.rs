//! The content of every message: its number, its time of sending, and the number again at its end.

use rustix::time::{ClockId, clock_gettime};

/// The smallest message: number, time, number [bytes].
pub const SMALLEST: usize = 24;

/// Number and time of a message; number 0 belongs to the warm-up and is not counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Stamp {
    /// Number of the message, from 1.
    pub sequence: u64,
    /// When the first process published it [ns of CLOCK_MONOTONIC].
    pub sent_ns: u64,
}

/// A message that has arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrival {
    /// Stamp of the message.
    pub stamp: Stamp,
    /// When the receiving process had it [ns of CLOCK_MONOTONIC].
    pub received_ns: u64,
}

impl Stamp {
    /// A message that is sent now.
    pub fn now(sequence: u64) -> Self {
        Self { sequence, sent_ns: monotonic_ns() }
    }

    /// Writes the stamp at both ends of a message of at least [`SMALLEST`] bytes.
    pub fn write(self, message: &mut [u8]) {
        let end = message.len() - 8;
        message[..8].copy_from_slice(&self.sequence.to_ne_bytes());
        message[8..16].copy_from_slice(&self.sent_ns.to_ne_bytes());
        message[end..].copy_from_slice(&self.sequence.to_ne_bytes());
    }

    /// The stamp of a message; `None` when it is too short or its ends do not belong together.
    pub fn read(message: &[u8]) -> Option<Self> {
        let number = |range: std::ops::Range<usize>| -> Option<u64> {
            Some(u64::from_ne_bytes(message.get(range)?.try_into().ok()?))
        };
        let length = message.len();
        let stamp = Self { sequence: number(0..8)?, sent_ns: number(8..16)? };
        let end = number(length.checked_sub(8)?..length)?;
        (length >= SMALLEST && end == stamp.sequence).then_some(stamp)
    }
}

impl Arrival {
    /// A message that has just arrived.
    pub fn now(stamp: Stamp) -> Self {
        Self { stamp, received_ns: monotonic_ns() }
    }
}

/// Nanoseconds of CLOCK_MONOTONIC.
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_read_back_only_whole() {
        let stamp = Stamp { sequence: 7, sent_ns: 11 };
        let mut message = [0; 64];
        stamp.write(&mut message);
        assert_eq!(Stamp::read(&message), Some(stamp));
        assert_eq!(Stamp::read(&message[..40]), None, "its end is missing");
        assert_eq!(Stamp::read(&message[..8]), None);
        let mut smallest = [0; SMALLEST];
        stamp.write(&mut smallest);
        assert_eq!(Stamp::read(&smallest), Some(stamp));
    }
}
