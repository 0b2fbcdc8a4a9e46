//! The recorder of a run as the orchestrator sees it: a process that observes, and may fail without an effect.
//!
//! It is no process of the run: it has no role and no authority, and it is neither restarted nor adopted. In lock-step
//! the grants wait for it while it copies; one that copies nothing for [`SILENT_NS`] is not waited for any more.

use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::Arc;

use anyhow::Context;
use console::exit::Failure;
use report::RecordingReport;
use runtime::{Domain, Silence, monotonic_ns, wait_for};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::process::{Pid, Signal, kill_process};
use supervision::child::this_program;
use supervision::child_log::ChildLog;

/// Limit for the start of the recorder, and for the end of the recording [ns].
const LIMIT_NS: u64 = 10_000_000_000;
/// Limit for the end of a ring that has nothing to write [ns].
const RING_LIMIT_NS: u64 = 1_000_000_000;
/// Limit for its connections, after which the drive begins without it [ns].
const CONNECT_NS: u64 = 2_000_000_000;
/// So many lines tell why it did not start.
const SAID: usize = 20;
/// In lock-step, a recorder that makes no progress is waited for no longer than this [ns].
const SILENT_NS: u64 = 5_000_000_000;

/// The recorder of a run.
pub(crate) struct RunRecorder {
    process: Child,
    /// What it prints; bounded as long as it is held here.
    log: Arc<ChildLog>,
    input: Option<ChildStdin>,
    output: ChildStdout,
    text: Vec<u8>,
    file: PathBuf,
    scan: u64,
    moved_ns: u64,
    silence: Silence,
    is_connected: bool,
    is_lost: bool,
    report: Option<RecordingReport>,
    last_scan: u64,
    keeps_ring: bool,
    /// Whether it was asked to write what it keeps.
    is_asked: bool,
    incidents: Vec<PathBuf>,
    /// Why a file of an incident was not written.
    unsaved: Option<String>,
}

impl RunRecorder {
    /// Starts the recorder of a system whose topics exist, and waits until it has opened them.
    ///
    /// # Errors
    /// A recorder that does not start, with its message; exit code 4.
    pub(crate) fn start(domain: &Domain, file: &Path, log: &Path, replaces: bool) -> anyhow::Result<Self> {
        let mut recorder = Self::spawn(domain, file, log, replaces, None)?;
        let mut is_attached = false;
        recorder.wait(LIMIT_NS, |line| {
            is_attached |= line == "attached";
            is_attached
        });
        if !is_attached {
            let said = recorder.log.last_lines(SAID).unwrap_or_default().join("\n");
            return Err(Failure::process(format!("the recorder did not start: {said}")));
        }
        Ok(recorder)
    }

    /// Starts one that keeps the last `ring_s` seconds in memory, and does not wait for it; `folder` is for the files of
    /// incidents.
    ///
    /// # Errors
    /// A process that can't be started, or a log that can't be made; exit code 4.
    pub(crate) fn start_ring(
        domain: &Domain,
        folder: &Path,
        log: &Path,
        ring_s: f64,
    ) -> anyhow::Result<Self> {
        Self::spawn(domain, folder, log, true, Some(ring_s))
    }

    fn spawn(
        domain: &Domain,
        file: &Path,
        log: &Path,
        replaces: bool,
        ring_s: Option<f64>,
    ) -> anyhow::Result<Self> {
        let log = ChildLog::of_run(log, false)?;
        log.begin("recorder").with_context(|| format!("{}", log.path().display()))?;
        let errors = log.output().with_context(|| format!("{}", log.path().display()))?;
        let mut process = Command::new(this_program())
            .args(["--system-id", domain.system_id(), "record", "--of-run"])
            .args(replaces.then_some("--force"))
            .args(ring_s.map(|seconds| format!("--ring={seconds}")))
            .arg(file)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(errors)
            // Ctrl-C in the terminal reaches the orchestrator alone.
            .process_group(0)
            .spawn()
            .map_err(|error| Failure::process(format!("the recorder could not be started: {error}")))?;
        let (Some(input), Some(output)) = (process.stdin.take(), process.stdout.take()) else {
            anyhow::bail!("the recorder has no pipes");
        };
        for end in [input.as_fd(), output.as_fd()] {
            fcntl_setfl(end, fcntl_getfl(end)? | OFlags::NONBLOCK)?;
        }
        let file = file.to_owned();
        Ok(Self {
            process,
            log,
            input: Some(input),
            output,
            text: Vec::new(),
            file,
            scan: 0,
            moved_ns: monotonic_ns(),
            silence: Silence::default(),
            is_connected: false,
            is_lost: false,
            report: None,
            last_scan: 0,
            keeps_ring: ring_s.is_some(),
            is_asked: false,
            incidents: Vec::new(),
            unsaved: None,
        })
    }

    /// Lets it connect to all publishers before the first sample; returns whether it did.
    pub(crate) fn connect(&mut self) -> bool {
        if !self.is_connected && !self.is_lost {
            self.say("connect");
            let mut is_connected = false;
            self.wait(CONNECT_NS, |line| {
                is_connected |= line == "connected";
                is_connected
            });
            self.is_connected = is_connected;
            self.moved_ns = monotonic_ns();
        }
        self.is_connected
    }

    /// The newest scan that belongs to the run.
    pub(crate) fn belongs(&mut self, scan_id: u64) {
        self.last_scan = scan_id;
    }

    /// Something happened: what a ring holds is written.
    pub(crate) fn incident(&mut self) {
        if self.keeps_ring {
            self.is_asked = true;
            self.say("incident");
        }
    }

    /// Somebody asks for what a ring holds: it is written; whether this is one.
    pub(crate) fn keep(&mut self) -> bool {
        if self.keeps_ring && !self.is_lost {
            self.say("keep");
        }
        self.keeps_ring && !self.is_lost
    }

    /// The files of incidents that were written.
    pub(crate) fn incidents(&self) -> &[PathBuf] {
        &self.incidents
    }

    /// Puts an event into the recording.
    pub(crate) fn event(&mut self, is_warning: bool, text: &str) {
        let level = if is_warning { "WARN " } else { "" };
        self.note(&format!("{level}{text}"));
    }

    /// Puts a line into the recording.
    pub(crate) fn note(&mut self, text: &str) {
        self.say(&format!("note {}", text.replace('\n', " ")));
    }

    /// In lock-step, the scan up to which it has copied all samples; `None` when it is not waited for.
    pub(crate) fn copied_scan(&mut self) -> Option<u64> {
        self.take_lines(|_| false);
        let silent_ns = self.silence.since(self.moved_ns, monotonic_ns());
        (!self.is_lost && silent_ns < SILENT_NS).then_some(self.scan)
    }

    /// Whether it has ended or gave up before it was asked to, told once.
    pub(crate) fn has_failed(&mut self) -> Option<String> {
        self.take_lines(|_| false);
        if let Some(error) = self.unsaved.take() {
            return Some(format!("the last seconds before an incident were not written: {error}"));
        }
        let ended = !self.is_lost && self.report.is_none() && matches!(self.process.try_wait(), Ok(Some(_)));
        let error = self.report.as_ref().filter(|report| !report.error.is_empty() && !self.is_lost);
        let reason = match error {
            Some(report) => report.error.clone(),
            None if ended => "the recorder ended".to_owned(),
            None => return None,
        };
        self.is_lost = true;
        Some(match self.keeps_ring {
            true => format!("the last seconds of this drive are no longer kept: {reason}"),
            false => format!(
                "the rest of the drive is not recorded: {reason}; {} holds the drive so far",
                self.file.display()
            ),
        })
    }

    /// Ends the recording; what it holds, and the files of incidents. A ring is no recording of the drive.
    pub(crate) fn finish(mut self) -> (Option<RecordingReport>, Vec<PathBuf>) {
        // One that is suspended would keep the run from its report.
        let _ = kill_process(Pid::from_child(&self.process), Signal::CONT);
        self.say(&format!("end {}", self.last_scan));
        self.input = None;
        let limit_ns = if self.keeps_ring && !self.is_asked { RING_LIMIT_NS } else { LIMIT_NS };
        self.wait(limit_ns, |line| line.starts_with("done "));
        let unknown = || RecordingReport {
            file: self.file.clone(),
            bytes: self.file.metadata().map_or(0, |metadata| metadata.len()),
            error: "the recorder did not end the recording".to_owned(),
            ..RecordingReport::default()
        };
        let report = self.report.take();
        // A ring that did not answer has perhaps not written what it was asked for.
        let is_told = !self.keeps_ring || self.is_asked && report.is_none();
        (is_told.then(|| report.unwrap_or_else(unknown)), std::mem::take(&mut self.incidents))
    }

    fn say(&mut self, line: &str) {
        // A full pipe belongs to a recorder that is stopped; it loses this line.
        if let Some(input) = &mut self.input {
            let _ = input.write_all(format!("{line}\n").as_bytes());
        }
    }

    /// Waits until a line is accepted, the recorder ends, or the time is over.
    fn wait(&mut self, limit_ns: u64, mut accept: impl FnMut(&str) -> bool) {
        let (began_ns, mut silence) = (monotonic_ns(), Silence::default());
        while !self.take_lines(&mut accept) {
            let waited_ns = silence.since(began_ns, monotonic_ns());
            if waited_ns >= limit_ns || matches!(self.process.try_wait(), Ok(Some(_))) {
                self.take_lines(&mut accept);
                return;
            }
            wait_for(&[self.output.as_fd()], (limit_ns - waited_ns).min(50_000_000));
        }
    }

    /// Takes what it has reported; true when a line was accepted.
    fn take_lines(&mut self, mut accept: impl FnMut(&str) -> bool) -> bool {
        let mut bytes = [0; 4096];
        while let Ok(length @ 1..) = self.output.read(&mut bytes) {
            self.text.extend_from_slice(&bytes[..length]);
        }
        let mut is_accepted = false;
        while let Some(end) = self.text.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = self.text.drain(..=end).collect();
            let line = String::from_utf8_lossy(&line[..end]);
            match line.split_once(' ') {
                Some(("scan", scan)) => {
                    self.scan = scan.parse().unwrap_or(self.scan);
                    self.moved_ns = monotonic_ns();
                }
                Some(("incident", file)) if !self.incidents.iter().any(|known| known == Path::new(file)) => {
                    self.incidents.push(file.into());
                }
                Some(("unsaved", error)) => self.unsaved = Some(error.to_owned()),
                Some(("done", report)) => self.report = serde_json::from_str(report).ok(),
                _ => {}
            }
            is_accepted |= accept(&line);
        }
        is_accepted
    }
}

impl Drop for RunRecorder {
    /// A recorder that was not asked to end is killed: its file is readable up to the last whole second.
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
