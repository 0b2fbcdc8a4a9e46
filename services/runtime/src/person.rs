//! A person who drives a running system by hand, for programs: a process of `scanloop teleop --stdin`.
//!
//! A control counts for 1.5 scan periods. The wheels are blocked without a new one, and once the program ends.

use std::ffi::{OsStr, OsString};
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::net::Shutdown;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use rustix::io::Errno;
use rustix::net::{SendFlags, send};

use crate::RuntimeError;

/// The variable that names the executable `scanloop`, where it is not in `PATH`.
pub const EXECUTABLE_VARIABLE: &str = "SCANLOOP";
/// An orchestrator that hangs is waited for no longer; `teleop` itself waits 12 s.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(15);
/// Longest message that is read [bytes].
pub(crate) const MAX_MESSAGE: u64 = 4096;

/// A person who drives by hand. Dropping it pauses the drive, unless it has handed back.
#[derive(Debug)]
pub struct Person {
    child: Child,
    /// Standard input and output of the process.
    lines: BufReader<UnixStream>,
}

impl Person {
    /// Takes over the drive of a system, of `SCANLOOP_SYSTEM_ID` without an id. The executable is that of the variable
    /// [`EXECUTABLE_VARIABLE`], else `scanloop` in `PATH`.
    ///
    /// # Errors
    /// [`RuntimeError::Refused`] when it is refused, with the reason; an executable that can't be started.
    pub fn take_over(system_id: Option<&str>) -> Result<Self, RuntimeError> {
        Self::take_over_by(executable(), system_id)
    }

    /// [`Person::take_over`] by this executable.
    ///
    /// # Errors
    /// As there.
    pub fn take_over_by(
        executable: impl AsRef<OsStr>,
        system_id: Option<&str>,
    ) -> Result<Self, RuntimeError> {
        let action = "start `scanloop teleop`";
        let start = || {
            // A pipe would end a program in C that writes after the process has ended.
            let (near, far) = UnixStream::pair()?;
            near.set_read_timeout(Some(ANSWER_TIMEOUT))?;
            let far = OwnedFd::from(far);
            let mut command = Command::new(executable);
            command.args(system_id.iter().flat_map(|id| ["--system-id", *id])).args(["teleop", "--stdin"]);
            command.stdin(far.try_clone()?).stdout(far).stderr(Stdio::piped());
            Ok(Self { child: command.spawn()?, lines: BufReader::new(near) })
        };
        let mut person = start().map_err(|source| RuntimeError::System { action, source })?;
        person.wait_for("by hand")?;
        Ok(person)
    }

    /// Asks for a velocity [m/s] and a steering angle [rad], positive to the left; never waits.
    ///
    /// # Errors
    /// [`RuntimeError::Refused`] once it does not drive any more, with the reason.
    pub fn give(&mut self, velocity_mps: f64, steering_rad: f64) -> Result<(), RuntimeError> {
        self.send(&format!("{velocity_mps} {steering_rad}\n"))
    }

    /// Blocks the wheels until the next control.
    ///
    /// # Errors
    /// As [`Person::give`].
    pub fn pause(&mut self) -> Result<(), RuntimeError> {
        self.send("pause\n")?;
        self.wait_for("paused")
    }

    /// Hands back to the controller.
    ///
    /// # Errors
    /// As [`Person::give`].
    pub fn resume(mut self) -> Result<(), RuntimeError> {
        self.send("resume\n")?;
        self.wait_for("resumed")
    }

    fn send(&mut self, line: &str) -> Result<(), RuntimeError> {
        let flags = SendFlags::NOSIGNAL | SendFlags::DONTWAIT;
        match send(self.lines.get_ref(), line.as_bytes(), flags) {
            // A process that takes no lines is suspended: the wheels are blocked meanwhile.
            Ok(_) | Err(Errno::AGAIN) => Ok(()),
            Err(_) => Err(self.refusal()),
        }
    }

    fn wait_for(&mut self, word: &str) -> Result<(), RuntimeError> {
        let mut line = String::new();
        match self.lines.read_line(&mut line) {
            Ok(_) if line.trim_end() == word => Ok(()),
            _ => Err(self.refusal()),
        }
    }

    /// Ends the process; with its message.
    fn refusal(&mut self) -> RuntimeError {
        self.end();
        let mut text = String::new();
        let messages = self.child.stderr.take().map(|stream| stream.take(MAX_MESSAGE));
        let _ = messages.map(|mut stream| stream.read_to_string(&mut text));
        let text = text.trim().trim_start_matches("error: ");
        RuntimeError::Refused(
            if text.is_empty() { "this person does not drive any more" } else { text }.to_owned(),
        )
    }

    /// Lets the process end; one that does not is killed.
    fn end(&mut self) {
        let stream = self.lines.get_ref();
        let _ = stream.shutdown(Shutdown::Write);
        let mut rest = Vec::new();
        if self.lines.by_ref().take(MAX_MESSAGE).read_to_end(&mut rest).is_err_and(|error| {
            // It was ended before, with unread lines.
            error.kind() != ErrorKind::ConnectionReset
        }) {
            let _ = self.child.kill();
        }
        let _ = self.child.wait();
    }
}

/// The executable of the commands.
pub(crate) fn executable() -> OsString {
    std::env::var_os(EXECUTABLE_VARIABLE).unwrap_or_else(|| "scanloop".into())
}

impl Drop for Person {
    fn drop(&mut self) {
        self.end();
    }
}
