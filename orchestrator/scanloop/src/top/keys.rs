//! Keys from the bytes of a terminal.

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

/// The keys in these bytes; what means nothing is left out.
pub(super) fn keys(bytes: &[u8]) -> Vec<Key> {
    let mut keys = Vec::new();
    let mut rest = bytes;
    while let [first, after @ ..] = rest {
        rest = after;
        keys.extend(match first {
            b'q' => Some(Key::Quit),
            0x03 => Some(Key::Interrupt),
            b'?' | b'h' => Some(Key::Help),
            b's' => Some(Key::Stop),
            b'r' => Some(Key::Restart),
            b'w' => Some(Key::Swap),
            b'k' => Some(Key::Up),
            b'j' => Some(Key::Down),
            b'1'..=b'5' => Some(Key::Role(usize::from(first - b'1'))),
            0x1b => {
                let (key, taken) = sequence(after);
                rest = &after[taken..];
                key
            }
            _ => None,
        });
    }
    keys
}

/// The key of an escape sequence after its first byte, and how many bytes it has.
fn sequence(bytes: &[u8]) -> (Option<Key>, usize) {
    let ([b'[', body @ ..] | [b'O', body @ ..]) = bytes else { return (None, 0) };
    let Some(last) = body.iter().position(|byte| (0x40..=0x7e).contains(byte)) else {
        return (None, bytes.len());
    };
    let key = match body[last] {
        b'A' => Some(Key::Up),
        b'B' => Some(Key::Down),
        _ => None,
    };
    (key, last + 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_and_arrows_are_keys_and_other_sequences_are_not() {
        assert_eq!(keys(b"s\x1b[A\x1b[1;5Bq"), [Key::Stop, Key::Up, Key::Down, Key::Quit]);
        assert_eq!(keys(b"\x1bOB3\x03"), [Key::Down, Key::Role(2), Key::Interrupt]);
        // The letters of a sequence ask for nothing: no s of a pasted or unknown sequence stops a robot.
        assert_eq!(keys(b"\x1b[15~\x1b[200;3s\x1b[<0;1"), []);
        assert_eq!(keys(&[0x80, 0xff, b' ', 0x1b]), []);
    }
}
