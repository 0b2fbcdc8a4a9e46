//! Log lines of all processes: to standard error, the level by `SCANLOOP_LOG`.
//!
//! Under systemd standard error may be the journal, which stores time and priority itself. Lines then begin with their
//! priority (`<4>` for a warning) and hold neither times nor colours.

use std::io;
use std::os::fd::AsFd;

use rustix::fs::fstat;
use tracing::level_filters::LevelFilter;
use tracing::{Level, Metadata};
use tracing_subscriber::filter::Targets;
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::prelude::*;

use crate::RuntimeError;
use crate::terminal::{self, LogLine, Stream, printable};

/// Names the stream of the journal that systemd gave to a service, as `DEVICE:INODE`.
const JOURNAL_VARIABLE: &str = "JOURNAL_STREAM";

/// Importance of a line, with the numbers of the journal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Priority {
    /// No output.
    Error = 3,
    /// Degraded, but driving.
    Warning = 4,
    /// Normal, but significant.
    Notice = 5,
    /// Lifecycle of the system.
    Info = 6,
    /// Details for debugging.
    Debug = 7,
}

/// Chooses what is logged, for users.
const LOG_VARIABLE: &str = "SCANLOOP_LOG";

/// Checks `SCANLOOP_LOG`.
///
/// # Errors
/// [`RuntimeError::LogFilter`] with its value and what is allowed.
pub fn check_log_filter() -> Result<(), RuntimeError> {
    filter().map(|_| ())
}

/// The filter that `SCANLOOP_LOG` asks for.
fn filter() -> Result<Targets, RuntimeError> {
    let value = std::env::var_os(LOG_VARIABLE).unwrap_or_default();
    let text = value.to_string_lossy();
    let directives: Vec<&str> = text.split(',').map(str::trim).filter(|part| !part.is_empty()).collect();
    if directives.is_empty() {
        return Ok(default_filter());
    }
    let filter =
        directives.iter().all(|directive| is_allowed(directive)).then(|| directives.join(",").parse().ok());
    filter.flatten().ok_or_else(|| RuntimeError::LogFilter(text.into_owned()))
}

/// Accepts a level, or a target with a level. A single name is taken for a misspelt level, not for a target.
fn is_allowed(directive: &str) -> bool {
    let is_level = |text: &str| !text.is_empty() && text.parse::<LevelFilter>().is_ok();
    let is_part = |letter: char| letter.is_alphanumeric() || matches!(letter, '_' | ':' | '-');
    match directive.split_once('=') {
        Some((target, level)) => !target.is_empty() && target.chars().all(is_part) && is_level(level),
        None => is_level(directive),
    }
}

fn default_filter() -> Targets {
    Targets::new().with_default(LevelFilter::INFO)
}

/// Starts logging; `SCANLOOP_LOG` takes levels and targets (`debug`, `nmpc=debug`), the default is `info`.
pub fn start_logging() {
    let filter = filter().unwrap_or_else(|_| default_filter());
    let is_journal = writes_to_journal();
    let lines = tracing_subscriber::fmt::layer()
        // Whole lines go through the filter of `printable`, which leaves no colours.
        .with_ansi(false)
        // A failed log write must not panic.
        .log_internal_errors(false)
        .without_time()
        .with_level(!is_journal)
        .with_writer(Lines { is_journal })
        .with_filter(filter);
    // A second start, as in tests, keeps the first subscriber.
    let _ = tracing_subscriber::registry().with(lines).try_init();
}

/// Whether standard error is the journal.
pub fn writes_to_journal() -> bool {
    is_journal(io::stderr())
}

fn is_journal(descriptor: impl AsFd) -> bool {
    let Ok(stream) = std::env::var(JOURNAL_VARIABLE) else { return false };
    // A process may have inherited the variable and write elsewhere.
    fstat(descriptor).is_ok_and(|file| stream == format!("{}:{}", file.st_dev, file.st_ino))
}

/// Writes messages to standard error, without control characters; what can't be written is dropped.
pub fn print(priority: Priority, text: &str) {
    write(Stream::Error, writes_to_journal(), priority, text);
}

/// Writes what a run was asked for to standard output, in the way of [`print()`].
pub fn print_answer(text: &str) {
    write(Stream::Output, is_journal(io::stdout()), Priority::Notice, text);
}

fn write(stream: Stream, is_journal: bool, priority: Priority, text: &str) {
    let text = printable(text.strip_suffix('\n').unwrap_or(text));
    let lines = if is_journal {
        text.lines().map(|line| format!("<{}>{line}\n", priority as u8)).collect()
    } else {
        text + "\n"
    };
    terminal::write(stream, lines.into_bytes());
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_and_targets_with_levels_are_allowed_and_nothing_else() {
        for allowed in ["debug", "OFF", "nmpc=debug", "runtime::bus=trace"] {
            assert!(is_allowed(allowed), "{allowed}");
        }
        for refused in ["garbage", "nmpc=loud", "=", "=info", "nmpc=", "[a=info", "a=b=info"] {
            assert!(!is_allowed(refused), "{refused}");
        }
    }
}
