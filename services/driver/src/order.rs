//! What the driver tells its guard, and what the guard answers: frames of fixed size on a socket between the two.

/// Size of a frame of the driver [bytes].
pub const FRAME: usize = 40;
/// Size of an answer [bytes].
pub const ANSWER: usize = 16;

/// What the driver orders.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GuardOrder {
    /// First of all: what is guarded, in words of the connection, and after how long without an order it is stopped [ns].
    Guard(u64, u64),
    /// Drive, with the numbers of the command.
    Drive([f64; 2]),
    /// Stop the wheels.
    Stop,
    /// Ask for a round of data.
    Round,
    /// The clock of the robot minus CLOCK_MONOTONIC, for stamps of commands [s].
    Offset(f64),
}

/// An order with its number and time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Counts up from 1.
    pub number: u64,
    /// When it was given, on CLOCK_MONOTONIC [ns].
    pub given_ns: u64,
    /// The order.
    pub order: GuardOrder,
}

impl Frame {
    /// The frame as bytes.
    pub fn to_bytes(self) -> [u8; FRAME] {
        let (kind, numbers) = match self.order {
            GuardOrder::Guard(guarded, timeout_ns) => (1, [guarded, timeout_ns]),
            GuardOrder::Drive(numbers) => (2, numbers.map(f64::to_bits)),
            GuardOrder::Stop => (3, [0; 2]),
            GuardOrder::Round => (4, [0; 2]),
            GuardOrder::Offset(seconds) => (5, [seconds.to_bits(), 0]),
        };
        let mut bytes = [0; FRAME];
        let fields = [kind, self.number, self.given_ns, numbers[0], numbers[1]];
        for (place, field) in bytes.chunks_exact_mut(8).zip(fields) {
            place.copy_from_slice(&field.to_le_bytes());
        }
        bytes
    }

    /// The frame in these bytes; `None` for any other bytes.
    pub fn from_bytes(bytes: &[u8; FRAME]) -> Option<Self> {
        let [kind, number, given_ns, one, other] = words(bytes);
        let order = match kind {
            1 => GuardOrder::Guard(one, other),
            2 => GuardOrder::Drive([one, other].map(f64::from_bits)),
            3 => GuardOrder::Stop,
            4 => GuardOrder::Round,
            5 => GuardOrder::Offset(f64::from_bits(one)),
            _ => return None,
        };
        Some(Self { number, given_ns, order })
    }
}

/// What the guard answers to each frame, and when it stops the wheels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GuardAnswer {
    /// Number of the newest order.
    pub number: u64,
    /// How often it has stopped the wheels because the driver was silent.
    pub stops: u64,
}

impl GuardAnswer {
    /// The answer as bytes.
    pub fn to_bytes(self) -> [u8; ANSWER] {
        let mut bytes = [0; ANSWER];
        bytes[..8].copy_from_slice(&self.number.to_le_bytes());
        bytes[8..].copy_from_slice(&self.stops.to_le_bytes());
        bytes
    }

    /// The answer in these bytes.
    pub fn from_bytes(bytes: &[u8; ANSWER]) -> Self {
        let [number, stops] = words(bytes);
        Self { number, stops }
    }
}

/// Little-endian words; those that are not there are zero.
fn words<const N: usize>(bytes: &[u8]) -> [u64; N] {
    let mut words = [0; N];
    for (word, bytes) in words.iter_mut().zip(bytes.chunks_exact(8)) {
        *word = bytes.iter().rev().fold(0, |word, byte| word << 8 | u64::from(*byte));
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_and_answers_come_back_as_they_were() {
        for order in [
            GuardOrder::Guard(131_071, 200_000_000),
            GuardOrder::Drive([0.7, -0.05]),
            GuardOrder::Stop,
            GuardOrder::Round,
            GuardOrder::Offset(1.7e9),
        ] {
            let frame = Frame { number: 3, given_ns: u64::MAX - 1, order };
            assert_eq!(Frame::from_bytes(&frame.to_bytes()), Some(frame));
        }
        assert_eq!(Frame::from_bytes(&[9; FRAME]), None);
        let answer = GuardAnswer { number: 1 << 60, stops: 2 };
        assert_eq!(GuardAnswer::from_bytes(&answer.to_bytes()), answer);
    }
}
