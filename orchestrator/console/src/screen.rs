//! A program that fills the terminal, and what makes sure that the terminal is afterwards as it was before.
//!
//! The program runs as a child and restores the terminal itself. When it can't, because it was killed or has crashed,
//! its parent does. When the parent is killed, the kernel asks the child to end.

use std::ffi::OsStr;
use std::io;
use std::os::fd::AsFd;
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, Command, ExitStatus};

use runtime::wait_for;
use rustix::fd::BorrowedFd;
use rustix::process::{Pid, PidfdFlags, Signal, kill_process, pidfd_open};
use rustix::termios::{OptionalActions, Termios, isatty, tcgetattr, tcsetattr};

/// Switches to the alternate screen, hides the cursor, and asks that pasted text is marked as such.
pub const ENTER: &[u8] = b"\x1b[?1049h\x1b[?25l\x1b[?2004h";
/// Plain letters, the cursor shown, and the screen as it was before [`ENTER`].
pub const LEAVE: &[u8] = b"\x1b[0m\x1b[?2004l\x1b[?25h\x1b[?1049l";
/// No wait is without a timeout [ns].
const POLL_NS: u64 = 1_000_000_000;

/// A program that fills the terminal of this process.
#[derive(Debug)]
pub struct ScreenGuard {
    child: Child,
    before: Termios,
}

/// Whether standard input and standard error are a terminal: one for keys, the other for drawing.
pub fn is_available() -> bool {
    isatty(io::stdin()) && isatty(io::stderr())
}

/// Whether a screen may have colours: the user forbids them with `NO_COLOR`. Bold and reversed letters stay.
pub fn has_colours() -> bool {
    colours_allowed(std::env::var_os("NO_COLOR").as_deref())
}

/// An empty value is as none, by the convention of <https://no-color.org>.
fn colours_allowed(no_color: Option<&OsStr>) -> bool {
    no_color.is_none_or(OsStr::is_empty)
}

impl ScreenGuard {
    /// Starts the program.
    ///
    /// # Errors
    /// No terminal, and a program that can't be started.
    pub fn start(command: &mut Command) -> io::Result<Self> {
        let before = tcgetattr(io::stdin())?;
        Ok(Self { child: command.spawn()?, before })
    }

    /// Waits until the program has ended, and restores the terminal if the program has not. When `until` is readable the
    /// program is asked to end.
    ///
    /// # Errors
    /// Those of the wait.
    pub fn wait(&mut self, until: &[BorrowedFd<'_>]) -> io::Result<ExitStatus> {
        let pid = Pid::from_child(&self.child);
        let ended = pidfd_open(pid, PidfdFlags::empty())?;
        let mut descriptors = vec![ended.as_fd()];
        descriptors.extend(until);
        let status = loop {
            if let Some(status) = self.child.try_wait()? {
                break status;
            }
            if descriptors.len() > 1 && wait_for(until, 0) {
                let _ = kill_process(pid, Signal::TERM);
                descriptors.truncate(1);
            }
            wait_for(&descriptors, POLL_NS);
        };
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, &self.before);
        if status.signal().is_some() {
            let _ = rustix::io::write(io::stderr(), LEAVE);
        }
        Ok(status)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_variable_without_a_value_forbids_no_colours() {
        assert!(colours_allowed(None) && colours_allowed(Some(OsStr::new(""))));
        assert!(!colours_allowed(Some(OsStr::new("1"))) && !colours_allowed(Some(OsStr::new("0"))));
    }
}
