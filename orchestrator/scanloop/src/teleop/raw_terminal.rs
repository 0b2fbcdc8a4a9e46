//! A terminal that gives each key at once.

use std::io;

use rustix::termios::{OptionalActions, Termios, tcgetattr, tcsetattr};

/// The terminal without echo, with each key at once; dropping it restores it.
pub(super) struct RawTerminal {
    before: Termios,
}

impl RawTerminal {
    pub(super) fn enter() -> anyhow::Result<Self> {
        let before = tcgetattr(io::stdin())?;
        let mut raw = before.clone();
        raw.make_raw();
        tcsetattr(io::stdin(), OptionalActions::Now, &raw)?;
        // Pasted text is marked as such.
        let _ = rustix::io::write(io::stderr(), b"\x1b[?2004h");
        Ok(Self { before })
    }

    /// Shows one line in the place of the last one, or lines above it.
    pub(super) fn show(&self, text: &str) {
        let text: String = text.replace('\n', "\r\n");
        let _ = rustix::io::write(io::stderr(), format!("\r\x1b[2K{text}").as_bytes());
    }
}

impl Drop for RawTerminal {
    fn drop(&mut self) {
        let _ = rustix::io::write(io::stderr(), b"\x1b[?2004l\r\n");
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, &self.before);
    }
}
