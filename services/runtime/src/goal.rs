//! A goal that a program sets while a system drives: a process of `scanloop set goal.x_m=X`.

use std::ffi::OsStr;
use std::io::Read;
use std::process::{Child, Command, Stdio};

use crate::RuntimeError;
use crate::person::{MAX_MESSAGE, executable};

/// A goal that was set and is not accepted yet. Dropping it takes it back, where it is not too late.
#[derive(Debug)]
#[must_use = "the goal counts once it is accepted: call `poll` or `wait`"]
pub struct GoalOrder(Child);

impl GoalOrder {
    /// Sets the place [m, m] of the goal that a system drives to, and the direction there [rad]; without one that of the goal
    /// stays. The system is that of `SCANLOOP_SYSTEM_ID` without an id, and the executable that of the variable
    /// [`crate::EXECUTABLE_VARIABLE`], else `scanloop` in `PATH`. Never waits.
    ///
    /// # Errors
    /// An executable that can't be started.
    pub fn give(
        system_id: Option<&str>,
        place: [f64; 2],
        yaw_rad: Option<f64>,
    ) -> Result<Self, RuntimeError> {
        Self::give_by(executable(), system_id, place, yaw_rad)
    }

    /// [`GoalOrder::give`] by this executable.
    ///
    /// # Errors
    /// As there.
    pub fn give_by(
        executable: impl AsRef<OsStr>,
        system_id: Option<&str>,
        [x_m, y_m]: [f64; 2],
        yaw_rad: Option<f64>,
    ) -> Result<Self, RuntimeError> {
        let mut command = Command::new(executable);
        command.args(system_id.iter().flat_map(|id| ["--system-id", *id])).arg("set");
        command.args([format!("goal.x_m={x_m}"), format!("goal.y_m={y_m}")]);
        command.args(yaw_rad.map(|yaw_rad| format!("goal.yaw_rad={yaw_rad}")));
        let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        let action = "start `scanloop set`";
        child.map(Self).map_err(|source| RuntimeError::System { action, source })
    }

    /// The first scan for which the goal counts, as soon as it is accepted; never waits.
    ///
    /// # Errors
    /// [`RuntimeError::Refused`] when it is not accepted, with the reason.
    pub fn poll(&mut self) -> Option<Result<u64, RuntimeError>> {
        matches!(self.0.try_wait(), Ok(Some(_)) | Err(_)).then(|| self.accepted())
    }

    /// [`GoalOrder::poll`] that waits for the answer: some milliseconds, of an orchestrator that hangs 12 s.
    ///
    /// # Errors
    /// As there.
    pub fn wait(mut self) -> Result<u64, RuntimeError> {
        self.accepted()
    }

    fn accepted(&mut self) -> Result<u64, RuntimeError> {
        let is_accepted = self.0.wait().is_ok_and(|status| status.success());
        let answer = text(self.0.stdout.take());
        // `goal.x_m=8 from scan 57 on`
        let scan = answer.split_whitespace().rev().nth(1).and_then(|number| number.parse().ok());
        scan.filter(|_| is_accepted).ok_or_else(|| {
            let reason = text(self.0.stderr.take());
            RuntimeError::Refused(reason.trim().trim_start_matches("error: ").to_owned())
        })
    }
}

/// What a process has written; it has ended.
fn text(stream: Option<impl Read>) -> String {
    let mut text = String::new();
    let _ = stream.map(|stream| stream.take(MAX_MESSAGE).read_to_string(&mut text));
    text
}

impl Drop for GoalOrder {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
