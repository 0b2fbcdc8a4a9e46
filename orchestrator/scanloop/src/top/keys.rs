//! Keys from the bytes of a terminal.

use std::time::{Duration, Instant};

/// What a key asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Key {
    /// Leave the view.
    Quit,
    /// Ctrl-C: leave the view, and end the run that it belongs to.
    Interrupt,
    /// Show or hide the help.
    Help,
    /// Block the wheels and end the system.
    Stop,
    /// Restart the process of the role.
    Restart,
    /// Swap the process of the role.
    Swap,
    /// Select the role before.
    Up,
    /// Select the role after.
    Down,
    /// Select the role of this index.
    Role(usize),
}

/// A terminal puts this before and after a text that is pasted, once [`console::screen::ENTER`] has asked for it.
const PASTE: (&[u8], &[u8]) = (b"200", b"201");
/// Not all terminals do. More letters at once than a person types are pasted as well.
const MAX_TYPED: usize = 3;
/// What follows a pasted text within this time belongs to it: a long text comes in pieces.
const PAUSE: Duration = Duration::from_millis(150);
/// Longest escape sequence that may come in two pieces [bytes].
const MAX_SEQUENCE: usize = 32;

/// What the bytes of a terminal ask for, from one read to the next. Pasted text asks for nothing.
#[derive(Debug, Default)]
pub(super) struct Keyboard {
    /// The start of an escape sequence whose end has not come, and when it came.
    pending: Option<(Vec<u8>, Instant)>,
    is_pasting: bool,
    /// When the last piece of a pasted text came.
    pasted: Option<Instant>,
}

impl Keyboard {
    /// The keys in bytes that came at `now`; what means nothing is left out.
    pub(super) fn keys(&mut self, bytes: &[u8], now: Instant) -> Vec<Key> {
        // What comes later is a key of its own: a person has pressed escape.
        let pending = self.pending.take().filter(|(_, came)| now.saturating_duration_since(*came) < PAUSE);
        let mut all = pending.map(|(start, _)| start).unwrap_or_default();
        all.extend(bytes);
        let (mut keys, mut letters, mut rest) = (Vec::new(), 0, all.as_slice());
        while let [first, after @ ..] = rest {
            if rest == b"\x1b" {
                self.pending = Some((rest.to_vec(), now));
                break;
            }
            rest = after;
            if let (0x1b, [b'[' | b'O', body @ ..]) = (first, after) {
                let Some(last) = body.iter().position(|byte| (0x40..=0x7e).contains(byte)) else {
                    if after.len() < MAX_SEQUENCE {
                        self.pending = Some(([&[0x1b], after].concat(), now));
                    }
                    break;
                };
                rest = &body[last + 1..];
                match (&body[..last], body[last]) {
                    (number, b'~') if number == PASTE.0 => self.is_pasting = true,
                    (number, b'~') if number == PASTE.1 => self.is_pasting = false,
                    (_, b'A') if !self.is_pasting => keys.push(Key::Up),
                    (_, b'B') if !self.is_pasting => keys.push(Key::Down),
                    _ => {}
                }
            } else if !self.is_pasting {
                letters += usize::from(!first.is_ascii_control());
                keys.extend(key(*first));
            }
        }
        let goes_on = self.pasted.is_some_and(|came| now.saturating_duration_since(came) < PAUSE);
        if letters > MAX_TYPED || goes_on {
            self.pasted = Some(now);
            // Ctrl-C is in no text.
            keys.retain(|key| *key == Key::Interrupt);
        }
        keys
    }
}

/// The key of one byte.
fn key(byte: u8) -> Option<Key> {
    Some(match byte {
        b'q' => Key::Quit,
        0x03 => Key::Interrupt,
        b'?' | b'h' => Key::Help,
        b's' => Key::Stop,
        b'r' => Key::Restart,
        b'w' => Key::Swap,
        b'k' => Key::Up,
        b'j' => Key::Down,
        b'1'..=b'5' => Key::Role(usize::from(byte - b'1')),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(bytes: &[u8]) -> Vec<Key> {
        Keyboard::default().keys(bytes, Instant::now())
    }

    #[test]
    fn letters_and_arrows_are_keys_and_other_sequences_are_not() {
        assert_eq!(keys(b"s\x1b[A\x1b[1;5Bq"), [Key::Stop, Key::Up, Key::Down, Key::Quit]);
        assert_eq!(keys(b"\x1bOB3\x03"), [Key::Down, Key::Role(2), Key::Interrupt]);
        // The letters of a sequence ask for nothing: no s of an unknown sequence stops a robot.
        assert_eq!(keys(b"\x1b[15~\x1b[200;3s\x1b[<0;1"), []);
        assert_eq!(keys(&[0x80, 0xff, b' ', 0x1b]), []);
    }

    #[test]
    fn a_pasted_text_asks_for_nothing_however_it_is_split() {
        let text = b"\x1b[200~s\x1b[A sr\nq\x1b[201~j";
        for split in 0..text.len() {
            let mut keyboard = Keyboard::default();
            let now = Instant::now();
            let mut found = keyboard.keys(&text[..split], now);
            found.extend(keyboard.keys(&text[split..], now + Duration::from_millis(1)));
            assert_eq!(found, [Key::Down], "split at {split}");
        }
    }

    #[test]
    fn a_key_after_the_start_of_a_sequence_counts() {
        for start in [&b"\x1b"[..], b"\x1b[", b"\x1b[1;"] {
            let (mut keyboard, now) = (Keyboard::default(), Instant::now());
            assert_eq!(keyboard.keys(start, now), []);
            assert_eq!(keyboard.keys(b"s", now + PAUSE), [Key::Stop], "{start:?}");
        }
    }

    #[test]
    fn many_letters_at_once_are_pasted_and_so_is_what_follows_at_once() {
        let mut keyboard = Keyboard::default();
        let at = |ms| Instant::now() + Duration::from_millis(ms);
        assert_eq!(keyboard.keys(b"stop the robot", at(0)), []);
        assert_eq!(keyboard.keys(b"s", at(5)), [], "the last piece of it");
        assert_eq!(keyboard.keys(b"\x03", at(10)), [Key::Interrupt]);
        assert_eq!(keyboard.keys(b"s", at(1000)), [Key::Stop]);
        assert_eq!(keyboard.keys(b"?2r", at(2000)), [Key::Help, Key::Role(1), Key::Restart]);
    }
}
