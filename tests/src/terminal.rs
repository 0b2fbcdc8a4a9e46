//! A terminal whose other end a test reads and types at.

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};

use rustix::fs::{Mode, OFlags, open};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcgetattr, tcsetwinsize};

/// Both ends of a new terminal: that of the user and that of the program.
///
/// # Panics
/// When there is no terminal.
pub fn ends() -> (OwnedFd, OwnedFd) {
    let near = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).expect("a terminal");
    grantpt(&near).expect("a terminal");
    unlockpt(&near).expect("a terminal");
    let name = ptsname(&near, Vec::new()).expect("a terminal");
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
    let far = open(&name, flags, Mode::empty()).expect("the other end");
    (near, far)
}

/// A terminal that is read all the time.
#[derive(Debug)]
pub struct Terminal {
    near: File,
    far: OwnedFd,
    output: Arc<Mutex<Vec<u8>>>,
    before: String,
}

impl Terminal {
    /// A terminal of this size.
    ///
    /// # Panics
    /// When there is no terminal.
    pub fn new(columns: u16, rows: u16) -> Self {
        let (near, far) = ends();
        let output = Arc::new(Mutex::new(Vec::new()));
        let (mut reader, written) =
            (File::from(near.try_clone().expect("a descriptor")), Arc::clone(&output));
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(count @ 1..) = reader.read(&mut bytes) {
                written.lock().unwrap_or_else(PoisonError::into_inner).extend(&bytes[..count]);
            }
        });
        let terminal = Self { near: near.into(), before: settings(&far), far, output };
        terminal.resize(columns, rows);
        terminal
    }

    /// Starts a command with the terminal as its standard streams.
    ///
    /// # Panics
    /// When it can't be started.
    pub fn spawn(&self, mut command: Command) -> Child {
        let end = || Stdio::from(self.far.try_clone().expect("a descriptor"));
        command.stdin(end()).stdout(end()).stderr(end()).spawn().expect("the executable runs")
    }

    /// Changes the size.
    ///
    /// # Panics
    /// When it can't be changed.
    pub fn resize(&self, columns: u16, rows: u16) {
        let size = Winsize { ws_row: rows, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 };
        tcsetwinsize(&self.far, size).expect("a size");
    }

    /// Presses keys.
    ///
    /// # Panics
    /// When the terminal is gone.
    pub fn press(&self, keys: &str) {
        (&self.near).write_all(keys.as_bytes()).expect("a terminal");
    }

    /// All that was written to it.
    pub fn output(&self) -> String {
        String::from_utf8_lossy(&self.output.lock().unwrap_or_else(PoisonError::into_inner)).into_owned()
    }

    /// What the last programs that moved the cursor have drawn, as lines.
    pub fn screen(&self, rows: usize) -> Vec<String> {
        let (mut lines, mut row, mut column) = (vec![Vec::new(); rows], 0, 0);
        let output = self.output();
        let mut letters = output.chars();
        while let Some(letter) = letters.next() {
            if letter != '\u{1b}' {
                let line: &mut Vec<char> = &mut lines[row];
                line.resize(line.len().max(column + 1), ' ');
                line[column] = letter;
                column += 1;
                continue;
            }
            // An escape sequence ends with its first letter.
            let mut sequence = String::new();
            letters.next();
            for letter in letters.by_ref() {
                sequence.push(letter);
                if letter.is_ascii_alphabetic() {
                    break;
                }
            }
            match sequence.split_at(sequence.len().saturating_sub(1)) {
                (place, "H") => {
                    let mut numbers = place.split(';').map(|number| number.parse().unwrap_or(1_usize) - 1);
                    row = numbers.next().unwrap_or(0).min(rows - 1);
                    column = numbers.next().unwrap_or(0);
                }
                ("2", "J") => lines.iter_mut().for_each(Vec::clear),
                _ => {}
            }
        }
        lines.into_iter().map(|line| line.into_iter().collect()).collect()
    }

    /// Whether it is as before: its settings, the main screen, and a cursor.
    pub fn is_restored(&self) -> bool {
        let output = self.output();
        let last = |text: &str| output.rfind(text);
        settings(&self.far) == self.before
            && last("\x1b[?1049h").is_none_or(|entered| last("\x1b[?1049l") > Some(entered))
            && last("\x1b[?25l").is_none_or(|hidden| last("\x1b[?25h") > Some(hidden))
            && last("\x1b[?2004h").is_none_or(|asked| last("\x1b[?2004l") > Some(asked))
    }
}

fn settings(terminal: &OwnedFd) -> String {
    format!("{:?}", tcgetattr(terminal).expect("a terminal"))
}
