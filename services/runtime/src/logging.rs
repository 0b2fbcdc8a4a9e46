//! Log lines of all processes: to standard error, the level by `SCANLOOP_LOG`.
//!
//! Under systemd standard error may be the journal, which keeps time and priority itself: lines then begin with
//! their priority (`<4>` for a warning) and hold neither times nor colours.

use std::io;

use rustix::fs::fstat;
use tracing::{Level, Metadata};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

use crate::terminal::{self, LogLine, is_terminal, printable};

/// Names the stream of the journal that systemd gave to a service, as `DEVICE:INODE`.
const JOURNAL_VARIABLE: &str = "JOURNAL_STREAM";

/// How much a line matters, as the journal counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Priority {
    /// Nothing works any more.
    Error = 3,
    /// Degraded, but going on.
    Warning = 4,
    /// Worth to be seen.
    Notice = 5,
    /// Life goes on as planned.
    Info = 6,
    /// For those who look for something.
    Debug = 7,
}

/// Starts logging; `SCANLOOP_LOG` takes levels and targets (`debug`, `nmpc=debug`), the default is `info`.
pub fn start_logging() {
    let filter = EnvFilter::try_from_env("SCANLOOP_LOG").unwrap_or_else(|_| EnvFilter::new("info"));
    let is_journal = writes_to_journal();
    let lines = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(is_terminal())
        // A log that can't be written is no reason to panic.
        .log_internal_errors(false)
        .without_time()
        .with_level(!is_journal)
        .with_writer(Lines { is_journal });
    // A second start, as in tests, keeps the first subscriber.
    let _ = lines.try_init();
}

/// Whether standard error is the journal.
pub fn writes_to_journal() -> bool {
    let Ok(stream) = std::env::var(JOURNAL_VARIABLE) else { return false };
    // A process may have inherited the variable and write elsewhere.
    fstat(io::stderr()).is_ok_and(|file| stream == format!("{}:{}", file.st_dev, file.st_ino))
}

/// Writes lines for people to standard error, without control characters; what can't be written is dropped.
pub fn print(priority: Priority, text: &str) {
    let text = printable(text.strip_suffix('\n').unwrap_or(text));
    let lines = if writes_to_journal() {
        text.lines().map(|line| format!("<{}>{line}\n", priority as u8)).collect()
    } else {
        text + "\n"
    };
    terminal::write(lines.into_bytes());
}

/// Makes a writer per event; for the journal each line begins with its priority.
struct Lines {
    is_journal: bool,
}

impl MakeWriter<'_> for Lines {
    type Writer = LogLine;

    fn make_writer(&self) -> LogLine {
        LogLine { prefix: String::new() }
    }

    fn make_writer_for(&self, meta: &Metadata<'_>) -> LogLine {
        let priority = match *meta.level() {
            Level::ERROR => Priority::Error,
            Level::WARN => Priority::Warning,
            Level::INFO => Priority::Info,
            _ => Priority::Debug,
        };
        LogLine { prefix: if self.is_journal { format!("<{}>", priority as u8) } else { String::new() } }
    }
}
