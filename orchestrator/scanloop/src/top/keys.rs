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
    /// Tell why: of the last stop, then of the newest scan, then close.
    Why,
    /// Block the wheels and end the system.
    Stop,
    /// Restart the process of the role.
    Restart,
    /// Swap the process of the role.
    Swap,
    /// Block the wheels until [`Key::Resume`].
    Pause,
    /// Let the controller drive again.
    Resume,
    /// Select the role before.
    Up,
    /// Select the role after.
    Down,
    /// Select the role of this index.
    Role(usize),
    /// None: a text has come, and is dropped.
    Text,
}

impl Key {
    /// Whether it changes more than what is shown.
    fn acts(self) -> bool {
        !matches!(self, Self::Help | Self::Why | Self::Up | Self::Down | Self::Role(_) | Self::Text)
    }
}

/// A terminal puts this before and after a text that is pasted, once [`console::screen::ENTER`] has asked for it.
const PASTE: (&[u8], &[u8]) = (b"200", b"201");
/// Its end may be lost. A terminal sends a text in large pieces; after this time without one, keys are keys again.
const MAX_PASTE: Duration = Duration::from_secs(1);
/// Not all terminals do. More different letters in a row than a person types are pasted as well.
const MAX_TYPED: usize = 3;
/// What follows within this time belongs to what came before: a text and a sequence come in pieces. So a letter counts only
/// after this time, when it is known that no text follows.
const PAUSE: Duration = Duration::from_millis(150);
/// A letter that is pressed again and again counts after this time: no text has it so often.
const MAX_HELD: Duration = Duration::from_millis(300);
/// Longest part of an escape sequence that is kept [bytes]; those that have a meaning are shorter.
const MAX_SEQUENCE: usize = 32;

const ESCAPE: u8 = 0x1b;
const BELL: u8 = 0x07;
const CTRL_C: u8 = 0x03;

/// What the bytes of a terminal ask for, from one read to the next. Pasted text asks for nothing, and no byte of an escape
/// sequence is a letter.
///
/// Letters are held until the terminal has been quiet. They count when a person can have typed them: one key, or a
/// selection and a key. Ctrl-C is in no text and counts at once, always.
#[derive(Debug, Default)]
pub(super) struct Keyboard {
    sequence: Sequence,
    /// While a text is pasted: when the last piece came that is longer than what a person types.
    pasting: Option<Instant>,
    run: Run,
    /// When the last bytes came.
    came: Option<Instant>,
}

/// The escape sequence whose end has not come.
#[derive(Debug, Default)]
enum Sequence {
    #[default]
    None,
    /// It has begun with escape.
    Escape,
    /// A control sequence, `ESC [` or `ESC O`, with its bytes up to here.
    Control(Vec<u8>),
    /// A report of the mouse in the form of X10, `ESC [ M` and so many bytes.
    Mouse(usize),
    /// A text for programs, such as a title or a clipboard, up to a bell or `ESC \`.
    Text,
    /// The same after an escape in it.
    TextEscape,
}

/// Letters without a pause between them.
#[derive(Debug, Default)]
struct Run {
    /// What they ask for when a person has typed them.
    held: Vec<Key>,
    /// The last letter, and when it was first pressed.
    last: Option<(u8, Instant)>,
    /// Number of letters; one that is repeated counts once.
    letters: usize,
    /// No person has typed them.
    is_text: bool,
}

impl Keyboard {
    /// The keys in bytes that came at `now`; what means nothing is left out. Without bytes, at [`due`](Self::due) or later,
    /// those that were held: nothing has followed them.
    pub(super) fn keys(&mut self, bytes: &[u8], now: Instant) -> Vec<Key> {
        if bytes.is_empty() {
            return match self.due() {
                Some(due) if due <= now => self.release(),
                _ => Vec::new(),
            };
        }
        self.came = Some(now);
        self.pasting = self.pasting.filter(|last| now.saturating_duration_since(*last) < MAX_PASTE);
        if self.pasting.is_some() && bytes.len() > MAX_TYPED {
            self.pasting = Some(now);
        }
        let mut keys = Vec::new();
        for byte in bytes {
            match self.take(*byte) {
                Some(Taken::Key(Key::Interrupt)) => keys.push(Key::Interrupt),
                Some(Taken::Key(key)) if self.run.is_quiet() => keys.push(key),
                // In their order: what is held is for the role that was selected before.
                Some(Taken::Key(key)) => self.run.held.push(key),
                Some(Taken::Letter(letter)) => keys.extend(self.run.take(letter, now)),
                None => {}
            }
        }
        keys
    }

    /// When it is known what the bytes up to here mean, if nothing follows.
    pub(super) fn due(&self) -> Option<Instant> {
        let is_open = !matches!(self.sequence, Sequence::None);
        if !is_open && self.run.is_quiet() {
            return None;
        }
        let quiet = self.came? + PAUSE;
        let held = self.run.last.map(|(_, pressed)| pressed + MAX_HELD);
        Some(held.filter(|_| !is_open && !self.run.is_text).map_or(quiet, |held| held.min(quiet)))
    }

    /// The keys that were held. A sequence without an end was a key: a person has pressed escape.
    fn release(&mut self) -> Vec<Key> {
        self.sequence = Sequence::None;
        let run = std::mem::take(&mut self.run);
        if run.is_text { Vec::new() } else { run.held }
    }

    /// What one more byte is; `None` for a part of a sequence and of a text that is marked as pasted.
    fn take(&mut self, byte: u8) -> Option<Taken> {
        if byte == CTRL_C {
            (self.sequence, self.pasting) = (Sequence::None, None);
            return Some(Taken::Key(Key::Interrupt));
        }
        let is_pasting = self.pasting.is_some();
        let letter = (!byte.is_ascii_control() && !is_pasting).then_some(Taken::Letter(byte));
        self.sequence = match (std::mem::take(&mut self.sequence), byte) {
            (Sequence::Text | Sequence::TextEscape, ESCAPE) => Sequence::TextEscape,
            (Sequence::Text, BELL) | (Sequence::TextEscape, b'\\') => Sequence::None,
            (Sequence::Text | Sequence::TextEscape, _) => Sequence::Text,
            (_, ESCAPE) => Sequence::Escape,
            (Sequence::Escape, b'[' | b'O') => Sequence::Control(Vec::new()),
            // Within a pasted text only its end counts.
            (Sequence::Escape, b']' | b'P' | b'X' | b'^' | b'_') if !is_pasting => Sequence::Text,
            (Sequence::Control(body), 0x40..=0x7e) => return self.end(&body, byte),
            (Sequence::Control(mut body), _) => {
                if body.len() < MAX_SEQUENCE {
                    body.push(byte);
                }
                Sequence::Control(body)
            }
            (Sequence::Mouse(left), _) if left > 1 => Sequence::Mouse(left - 1),
            (Sequence::Mouse(_), _) => Sequence::None,
            (Sequence::None | Sequence::Escape, _) => return letter,
        };
        None
    }

    /// What a control sequence asks for: its bytes up to the last one, and that.
    fn end(&mut self, body: &[u8], last: u8) -> Option<Taken> {
        let is_pasting = self.pasting.is_some();
        match (body, last) {
            (number, b'~') if number == PASTE.0 => self.pasting = self.came,
            (number, b'~') if number == PASTE.1 => self.pasting = None,
            (b"", b'M') if !is_pasting => self.sequence = Sequence::Mouse(3),
            (_, b'A') if !is_pasting => return Some(Taken::Key(Key::Up)),
            (_, b'B') if !is_pasting => return Some(Taken::Key(Key::Down)),
            _ => {}
        }
        None
    }
}

/// What a byte, with those before it, is.
enum Taken {
    /// A key that is no letter.
    Key(Key),
    /// A printable letter, or a part of one.
    Letter(u8),
}

impl Run {
    fn is_quiet(&self) -> bool {
        self.last.is_none()
    }

    /// Adds a letter; [`Key::Text`] when with it no person can have typed them all.
    fn take(&mut self, letter: u8, now: Instant) -> Option<Key> {
        let (key, is_repeated) = (key(letter), self.last.is_some_and(|(last, _)| last == letter));
        let acts = key.is_some_and(Key::acts);
        if !is_repeated {
            self.letters += 1;
            self.last = Some((letter, now));
        }
        // After a letter that acts another one makes it a word.
        let follows = !is_repeated && self.held.iter().any(|key| key.acts());
        if self.letters > MAX_TYPED || follows || key.is_none() {
            self.held.clear();
            return (!std::mem::replace(&mut self.is_text, true)).then_some(Key::Text);
        }
        let counts_once = acts && is_repeated;
        if !self.is_text && !counts_once {
            self.held.extend(key);
        }
        None
    }
}

/// The key of one byte.
fn key(byte: u8) -> Option<Key> {
    Some(match byte {
        b'q' => Key::Quit,
        b'?' | b'h' => Key::Help,
        b'y' => Key::Why,
        b's' => Key::Stop,
        b'r' => Key::Restart,
        b'w' => Key::Swap,
        b'p' => Key::Pause,
        b'c' => Key::Resume,
        b'k' => Key::Up,
        b'j' => Key::Down,
        b'1'..=b'5' => Key::Role(usize::from(byte - b'1')),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The keys of pieces that come at these times [ms], each with the time at which it counts, as the view takes them.
    fn timed(pieces: &[(u64, &[u8])]) -> Vec<(u64, Key)> {
        let (mut keyboard, start, mut found) = (Keyboard::default(), Instant::now(), Vec::new());
        let end = pieces.last().unwrap().0 + 1000;
        for ms in 0..=end {
            let now = start + Duration::from_millis(ms);
            let mut keys = keyboard.keys(b"", now);
            for (_, piece) in pieces.iter().filter(|(at, _)| *at == ms) {
                keys.extend(keyboard.keys(piece, now));
            }
            found.extend(keys.into_iter().map(|key| (ms, key)));
        }
        found
    }

    /// The keys of pieces that come one after the other with so much time between them [ms].
    fn pieces(pieces: &[&[u8]], between_ms: u64) -> Vec<Key> {
        let timed_pieces: Vec<_> = (0..).step_by(between_ms as usize).zip(pieces.iter().copied()).collect();
        timed(&timed_pieces).into_iter().map(|(_, key)| key).collect()
    }

    fn keys(bytes: &[u8]) -> Vec<Key> {
        pieces(&[bytes], 1)
    }

    #[test]
    fn letters_and_arrows_are_keys_and_other_sequences_are_not() {
        assert_eq!(keys(b"2\x1b[A\x1b[1;5Bq"), [Key::Role(1), Key::Up, Key::Down, Key::Quit]);
        assert_eq!(keys(b"\x1bOB3"), [Key::Down, Key::Role(2)]);
        assert_eq!(keys(b"?2r"), [Key::Help, Key::Role(1), Key::Restart]);
        // The letters of a sequence ask for nothing: no s of an unknown sequence stops a robot.
        assert_eq!(keys(b"\x1b[15~\x1b[200;3s\x1b[<0;1"), []);
        assert_eq!(keys(&[0x80, 0xff, b' ', 0x1b]), [Key::Text]);
    }

    #[test]
    fn a_letter_counts_soon_and_an_arrow_and_an_interrupt_at_once() {
        assert_eq!(timed(&[(5, b"s")]), [(155, Key::Stop)]);
        assert_eq!(timed(&[(5, b"s\r")]), [(155, Key::Stop)]);
        assert_eq!(timed(&[(5, b"\x1b[A")]), [(5, Key::Up)]);
        for before in [&b"s"[..], b"a text", b"\x1b", b"\x1b[1;", b"\x1b]0;t", b"\x1b[M "] {
            assert!(timed(&[(5, before), (6, b"\x03")]).contains(&(6, Key::Interrupt)), "{before:?}");
        }
        // The selection of the moment in which a key was pressed counts, not a later one.
        assert_eq!(pieces(&[b"r", b"\x1b[B"], 20), [Key::Restart, Key::Down]);
        // Who presses a key again and again means it.
        let presses: Vec<_> = (0..20).map(|index| (90 * index, &b"s"[..])).collect();
        assert_eq!(timed(&presses)[0], (300, Key::Stop));
        assert_eq!(keys(b"ssssssss"), [Key::Stop]);
    }

    #[test]
    fn a_pasted_text_asks_for_nothing_however_it_is_split() {
        let text = b"\x1b[200~s\x1b[A sr\nq\x1b]\x1b[201~j";
        for split in 0..text.len() {
            assert_eq!(pieces(&[&text[..split], &text[split..]], 1), [Key::Down], "split at {split}");
        }
    }

    #[test]
    fn a_pasted_text_without_its_end_takes_no_keys_for_long() {
        for start in [&b"\x1b[200~"[..], b"\x1b[200~a text of more than a letter", b"\x1b[200~\x1b["] {
            assert_eq!(timed(&[(0, start), (1, b"\x03")]), [(1, Key::Interrupt)]);
            assert_eq!(timed(&[(0, start), (1000, b"s")]), [(1150, Key::Stop)], "{start:?}");
            // Who presses a key again and again means it.
            let presses = (1..20).map(|index| (90 * index, &b"s"[..]));
            let pieces: Vec<_> = [(0, start)].into_iter().chain(presses).collect();
            assert_eq!(timed(&pieces)[0], (1380, Key::Stop), "{start:?}");
        }
        // A long text comes in large pieces.
        let text = [&b"\x1b[200~stop"[..], b"the robot", b"and quit", b"sss\x1b[201~"];
        let text: Vec<_> = (0..).step_by(900).zip(text).collect();
        assert_eq!(timed(&text), []);
    }

    #[test]
    fn a_text_that_is_not_marked_asks_for_nothing_however_it_is_split() {
        let mut all: Vec<(Vec<&[u8]>, u64)> = vec![
            (vec![b"ru", b"n s", b"top\n"], 20),
            (vec![b"hello thi", b"s", b" is text"], 120),
            (vec![b"s", b"s", b"h robot"], 120),
            (vec![b"stop the robot", b"s"], 5),
        ];
        for between_ms in [1, 10, 120, 149] {
            for text in [
                &b"hello this"[..],
                b"stop",
                b"run s",
                b"quit\rs",
                b"2 s",
                b"rs",
                b"s3",
                "\u{e4}s".as_bytes(),
            ] {
                all.push((text.chunks(1).collect(), between_ms));
                all.push((text.chunks(3).collect(), between_ms));
            }
        }
        for (text, between_ms) in all {
            assert_eq!(pieces(&text, between_ms), [Key::Text], "{text:?} every {between_ms} ms");
        }
        assert_eq!(timed(&[(0, b"stop the robot"), (1000, b"s")]), [(0, Key::Text), (1150, Key::Stop)]);
    }

    #[test]
    fn no_byte_of_a_text_for_programs_and_of_the_mouse_is_a_key() {
        for sequence in [
            &b"\x1b]0;s\x07"[..],
            b"\x1b]52;c;qs\x1b\\",
            b"\x1bP1$r0 q\x1b\\",
            b"\x1b_s\x1b\\",
            b"\x1b[Msqs",
            b"\x1b[M rw\x1b[Msss",
        ] {
            for split in 0..=sequence.len() {
                let (before, after) = sequence.split_at(split);
                assert_eq!(
                    pieces(&[before, after, b"\x1b[B"], 140),
                    [Key::Down],
                    "{sequence:?} split at {split}"
                );
                assert_eq!(
                    pieces(&[before, after, b"r"], 1),
                    [Key::Restart],
                    "{sequence:?} split at {split}"
                );
            }
        }
    }

    #[test]
    fn a_key_after_the_start_of_a_sequence_counts() {
        for start in [&b"\x1b"[..], b"\x1b[", b"\x1b[1;", b"\x1b]", b"\x1b]0;title", b"\x1bP", b"\x1b[M"] {
            assert_eq!(pieces(&[start, b"s"], 151), [Key::Stop], "{start:?}");
        }
    }
}
