//! What the keys, or the lines, of a person who drives ask for.

use std::time::{Duration, Instant};

/// A key counts so long: terminals repeat a held one, the first time after half a second.
const HELD: Duration = Duration::from_millis(600);
/// Steps of a key [m/s], [rad].
const VELOCITY_STEP: f64 = 0.05;
const STEERING_STEP: f64 = 0.02;
/// Largest values that keys ask for; the limits are those of the system.
const MAX_VELOCITY: f64 = 2.0;
const MAX_STEERING: f64 = 0.5;
/// No person presses so many different keys at once: a text was pasted.
const MAX_KEYS: usize = 3;

/// The keys, shown at the start.
pub(super) const HELP: &str = "up or w: drive while held    left, right or a, d: steer    + and -: velocity\n\
    down, s or space: stand      x: straight                   q: pause and leave\n";

/// What a line asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Line {
    /// A velocity [m/s] and a steering angle [rad].
    Control([f64; 2]),
    /// Blocked wheels until the next control.
    Pause,
    /// The controller is to drive.
    Resume,
}

/// What a line asks for.
///
/// # Errors
/// What stands there instead.
pub(super) fn of_line(line: &str) -> Result<Line, String> {
    match line.trim() {
        "pause" => return Ok(Line::Pause),
        "resume" => return Ok(Line::Resume),
        _ => {}
    }
    let numbers: Vec<f64> = line.split_whitespace().map_while(|word| word.parse().ok()).collect();
    match numbers[..] {
        [velocity, steering]
            if velocity.is_finite()
                && steering.is_finite()
                && line.split_whitespace().count() == numbers.len() =>
        {
            Ok(Line::Control([velocity, steering]))
        }
        _ => Err(format!(
            "{:?} is not allowed: two numbers, a velocity [m/s] and a steering angle [rad], or `pause`, or `resume`",
            line.trim()
        )),
    }
}

/// What a person asks for.
#[derive(Debug, Clone)]
pub(super) struct Hand {
    velocity: f64,
    steering: f64,
    drives: bool,
    /// When a key came last; `None` for one that needs no key.
    pressed: Option<Instant>,
    by_keys: bool,
    is_pasting: bool,
}

impl Hand {
    /// One that asks for this velocity and steering angle: by keys once one is pressed, else at once.
    pub(super) fn new([velocity, steering]: [f64; 2], by_keys: bool) -> Self {
        Self { velocity, steering, drives: !by_keys, pressed: None, by_keys, is_pasting: false }
    }

    /// Velocity and steering angle that are asked for.
    pub(super) fn asked(&self) -> [f64; 2] {
        [if self.drives { self.velocity } else { 0.0 }, self.steering]
    }

    /// Whether a key is held, as far as a terminal tells.
    pub(super) fn is_held(&self, now: Instant) -> bool {
        !self.by_keys || self.pressed.is_some_and(|pressed| now.saturating_duration_since(pressed) <= HELD)
    }

    /// Follows the keys in bytes that came at `now`; false to leave.
    pub(super) fn take(&mut self, bytes: &[u8], now: Instant) -> bool {
        let (mut keys, mut is_text) = (Vec::new(), self.is_pasting);
        let mut rest = bytes;
        while let Some((&first, after)) = rest.split_first() {
            rest = after;
            if first != 0x1b {
                if self.is_pasting {
                    is_text = true;
                } else {
                    keys.push(first);
                }
                continue;
            }
            // An escape sequence: up to its final letter; arrows have one that means something.
            let [b'[' | b'O', sequence @ ..] = rest else { continue };
            let length = sequence.iter().position(|byte| (0x40..=0x7e).contains(byte));
            let (body, last) = match length {
                Some(length) => (&sequence[..length], sequence[length]),
                None => (sequence, 0),
            };
            rest = length.map_or(&[], |length| &sequence[length + 1..]);
            match (body, last) {
                (b"200", b'~') => self.is_pasting = true,
                (b"201", b'~') => self.is_pasting = false,
                (_, b'A') => keys.push(b'w'),
                (_, b'B') => keys.push(b's'),
                (_, b'C') => keys.push(b'd'),
                (_, b'D') => keys.push(b'a'),
                _ => {}
            }
        }
        if keys.contains(&0x03) {
            return false;
        }
        let mut different = keys.clone();
        different.sort_unstable();
        different.dedup();
        if is_text || self.is_pasting || different.len() > MAX_KEYS {
            self.drives = false;
            return true;
        }
        keys.into_iter().all(|key| self.press(key, now))
    }

    fn press(&mut self, key: u8, now: Instant) -> bool {
        let mut steer = |by: f64| self.steering = (self.steering + by).clamp(-MAX_STEERING, MAX_STEERING);
        match key {
            b'w' => self.drives = true,
            b'a' => steer(STEERING_STEP),
            b'd' => steer(-STEERING_STEP),
            b's' | b' ' => self.drives = false,
            b'x' => self.steering = 0.0,
            b'+' => self.velocity = (self.velocity + VELOCITY_STEP).min(MAX_VELOCITY),
            b'-' => self.velocity = (self.velocity - VELOCITY_STEP).max(0.0),
            b'q' => return false,
            _ => return true,
        }
        self.pressed = Some(now);
        true
    }

    /// One line of it.
    pub(super) fn text(&self, is_held: bool) -> String {
        let does = if is_held && self.drives { "drives" } else { "stands" };
        let [_, steering] = self.asked();
        format!("{does}: {:.2} m/s, steering {steering:+.2} rad", self.velocity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hand() -> Hand {
        Hand::new([0.3, 0.0], true)
    }

    #[test]
    fn keys_drive_only_while_they_are_held() {
        let (mut hand, start) = (hand(), Instant::now());
        assert!(!hand.is_held(start) && hand.asked() == [0.0, 0.0]);
        assert!(hand.take(b"w", start) && hand.is_held(start) && hand.asked() == [0.3, 0.0]);
        assert!(hand.is_held(start + HELD) && !hand.is_held(start + HELD + Duration::from_millis(1)));
        assert!(hand.take(b"\x1b[D\x1b[D", start) && (hand.asked()[1] - 0.04).abs() < 1e-12);
        assert!(hand.take(b"\x1bOC-", start));
        assert!((hand.asked()[0] - 0.25).abs() < 1e-12 && (hand.asked()[1] - 0.02).abs() < 1e-12);
        assert!(hand.take(b" ", start) && hand.asked()[0] == 0.0);
        assert!(!hand.take(b"q", start) && !hand.take(&[0x03], start));
    }

    #[test]
    fn a_text_that_is_pasted_moves_nothing() {
        for text in [&b"\x1b[200~www\x1b[201~"[..], b"why does it wait", b"\x1b[1;5Pw was that all"] {
            let (mut hand, now) = (hand(), Instant::now());
            assert!(hand.take(b"w", now) && hand.asked()[0] == 0.3);
            assert!(hand.take(text, now) && hand.asked()[0] == 0.0, "{text:?}");
        }
        let (mut hand, now) = (hand(), Instant::now());
        assert!(hand.take(b"\x1b[200~w", now) && hand.take(b"ww", now) && hand.asked()[0] == 0.0);
        assert!(hand.take(b"\x1b[201~", now) && hand.take(b"w", now) && hand.asked()[0] == 0.3);
    }

    #[test]
    fn a_line_is_two_finite_numbers_or_a_word() {
        assert_eq!(of_line("0.3 -0.05\n"), Ok(Line::Control([0.3, -0.05])));
        assert_eq!([of_line("pause\n"), of_line(" resume\r\n")], [Ok(Line::Pause), Ok(Line::Resume)]);
        for line in ["", "0.3", "0.3 0 1", "0.3 x", "nan 0", "inf 0", "0,3 0", "pause 1", "Pause", "resumed"]
        {
            assert!(of_line(line).is_err(), "{line}");
        }
    }

    #[test]
    fn one_without_keys_asks_at_once() {
        let hand = Hand::new([0.5, -0.1], false);
        assert!(hand.is_held(Instant::now()) && hand.asked() == [0.5, -0.1]);
    }
}
