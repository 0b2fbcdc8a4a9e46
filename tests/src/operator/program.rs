//! Programs that a trial has started: when they began and ended, how, and what they printed.

use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus};

use runtime::monotonic_ns;
use rustix::process::{Pid, Signal, kill_process};

/// A program of a trial. Dropping it ends it.
#[derive(Debug)]
pub struct Program {
    /// The command of `scanloop`, for example `stop`.
    pub name: String,
    /// Signals that it was sent, in order.
    pub signals: Vec<Signal>,
    /// Where its results are to be written, if it is an orchestrator.
    pub out: Option<PathBuf>,
    child: Child,
    stderr: PathBuf,
    began_ns: u64,
    ended: Option<(u64, ExitStatus)>,
}

/// What is known of a program that has ended.
#[derive(Debug, Clone, Default)]
pub struct Ended {
    /// The command of `scanloop`.
    pub name: String,
    /// When it was started [ns of CLOCK_MONOTONIC].
    pub began_ns: u64,
    /// When it ended; 0 when it had to be killed by the trial.
    pub ended_ns: u64,
    /// Its exit code.
    pub code: Option<i32>,
    /// The signal that ended it.
    pub signal: Option<i32>,
    /// Signals that the trial sent to it.
    pub sent: Vec<i32>,
    /// What it wrote to standard error, if that was a file.
    pub printed: String,
    /// Where its results are, if it was an orchestrator.
    pub out: Option<PathBuf>,
}

impl Ended {
    /// How long it took [s]; `None` when it did not end by itself.
    pub fn took_s(&self) -> Option<f64> {
        self.ended_ns.checked_sub(self.began_ns).map(|ns| ns as f64 * 1e-9)
    }

    /// Describes how it ended.
    pub fn how(&self) -> String {
        match (self.code, self.signal) {
            (Some(code), _) => format!("exit {code}"),
            (_, Some(signal)) => format!("signal {signal}"),
            _ => "did not end".to_owned(),
        }
    }
}

impl Program {
    /// Notes a program that was just started.
    pub fn new(name: &str, child: Child, stderr: &Path, began_ns: u64) -> Self {
        let (signals, stderr) = (Vec::new(), stderr.to_path_buf());
        Self { name: name.to_owned(), signals, out: None, child, stderr, began_ns, ended: None }
    }

    /// Process id.
    pub fn pid(&self) -> i32 {
        self.child.id().cast_signed()
    }

    /// Whether it runs; notes its end.
    pub fn runs(&mut self) -> bool {
        if self.ended.is_none()
            && let Ok(Some(status)) = self.child.try_wait()
        {
            self.ended = Some((monotonic_ns(), status));
        }
        self.ended.is_none()
    }

    /// Sends a signal, unless it has ended; whether it was sent.
    pub fn signal(&mut self, signal: Signal) -> bool {
        if !self.runs() {
            return false;
        }
        self.signals.push(signal);
        Pid::from_raw(self.pid()).is_some_and(|pid| kill_process(pid, signal).is_ok())
    }

    /// What became of it; it is killed when it still runs.
    pub fn finish(mut self) -> Ended {
        use std::os::unix::process::ExitStatusExt;
        let ended = if self.runs() { None } else { self.ended };
        Ended {
            name: self.name.clone(),
            began_ns: self.began_ns,
            ended_ns: ended.map_or(0, |(at_ns, _)| at_ns),
            code: ended.and_then(|(_, status)| status.code()),
            signal: ended.and_then(|(_, status)| status.signal()),
            sent: self.signals.iter().map(|signal| signal.as_raw()).collect(),
            printed: String::from_utf8_lossy(&std::fs::read(&self.stderr).unwrap_or_default()).into_owned(),
            out: self.out.clone(),
        }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        if self.runs() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}
