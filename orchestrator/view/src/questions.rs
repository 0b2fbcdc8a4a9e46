//! Questions of the page: why the robot did what it did in a scan. The answer is that of `scanloop why`, a process of its own
//! with a low priority, and one at a time: a page costs a drive no more than one such command.

use std::ffi::OsString;
use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use runtime::wait_for;
use supervision::child::this_program;

use crate::http::{Response, Status};

/// An answer takes no longer.
const LIMIT: Duration = Duration::from_secs(20);
/// Time between two looks whether it is there [ns].
const LOOK_NS: u64 = 5_000_000;

/// Asks a running system or a recording, one question at a time.
#[derive(Debug)]
pub(crate) struct Questions {
    /// What stands before the scan.
    command: Vec<OsString>,
    turn: Mutex<()>,
}

impl Questions {
    /// Questions to a recording, else to the running system.
    pub(crate) fn new(system_id: &str, recording: Option<&Path>) -> Self {
        let mut command: Vec<OsString> =
            ["--system-id", system_id, "why", "--json"].map(OsString::from).into();
        // An absolute path is no option.
        command.extend(recording.map(|file| std::path::absolute(file).unwrap_or_default().into_os_string()));
        Self { command, turn: Mutex::new(()) }
    }

    /// The answer for a scan as JSON, or why there is none.
    pub(crate) fn answer(&self, scan: Option<u64>) -> Response {
        let Some(scan) = scan.filter(|scan| *scan > 0) else {
            let allowed = format!("scan: a whole number from 1 to {}", u64::MAX);
            return Response::text(Status::BadRequest, &allowed);
        };
        let Ok(_turn) = self.turn.try_lock() else {
            return Response::text(Status::Conflict, "another question is not answered yet");
        };
        let failed = |error: std::io::Error| {
            Response::text(Status::Unavailable, &format!("the question could not be asked: {error}"))
        };
        self.ask(scan).unwrap_or_else(failed)
    }

    fn ask(&self, scan: u64) -> std::io::Result<Response> {
        let mut command = Command::new(this_program());
        command.args(&self.command).arg(scan.to_string());
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut process = command.spawn()?;
        let until = Instant::now() + LIMIT;
        // An answer has some kilobytes: a pipe takes it whole.
        while process.try_wait()?.is_none() {
            if Instant::now() > until {
                process.kill()?;
                process.wait()?;
                let reason = format!("no answer within {} s; ask in a terminal", LIMIT.as_secs());
                return Ok(Response::text(Status::Unavailable, &reason));
            }
            wait_for(&[], LOOK_NS);
        }
        let (answer, messages) = printed(&mut process)?;
        Ok(match process.wait()?.code() {
            Some(0) => Response::json(Status::Ok, answer),
            Some(2) => Response::text(Status::NotFound, reason(&messages)),
            _ => Response::text(Status::Unavailable, reason(&messages)),
        })
    }
}

/// What a process has printed that has ended.
fn printed(process: &mut Child) -> std::io::Result<(String, String)> {
    let (mut answer, mut messages) = (String::new(), String::new());
    process.stdout.take().map_or(Ok(0), |mut output| output.read_to_string(&mut answer))?;
    process.stderr.take().map_or(Ok(0), |mut output| output.read_to_string(&mut messages))?;
    Ok((answer, messages))
}

/// The error in the messages of a command.
fn reason(messages: &str) -> &str {
    let error = messages.lines().find_map(|line| line.strip_prefix("error: "));
    error.unwrap_or_else(|| messages.trim())
}
