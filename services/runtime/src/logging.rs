//! Log lines of all processes: to standard error, the level by `SCANLOOP_LOG`.
//!
//! Under systemd standard error may be the journal, which keeps time and priority itself: lines then begin with
//! their priority (`<4>` for a warning) and hold neither times nor colours.

use std::io::{self, IsTerminal, Write};

use rustix::fs::fstat;
use tracing::{Level, Metadata};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

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
    let lines = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(io::stderr().is_terminal())
        .without_time();
    // A second start, as in tests, keeps the first subscriber.
    let _ = if writes_to_journal() {
        lines.with_level(false).with_writer(Journal).try_init()
    } else {
        lines.with_writer(io::stderr).try_init()
    };
}

/// Whether standard error is the journal.
pub fn writes_to_journal() -> bool {
    let Ok(stream) = std::env::var(JOURNAL_VARIABLE) else { return false };
    // A process may have inherited the variable and write elsewhere.
    fstat(io::stderr()).is_ok_and(|file| stream == format!("{}:{}", file.st_dev, file.st_ino))
}

/// Writes lines for people to standard error.
pub fn print(priority: Priority, text: &str) {
    if writes_to_journal() {
        for line in text.lines() {
            eprintln!("<{}>{line}", priority as u8);
        }
    } else {
        eprintln!("{}", text.strip_suffix('\n').unwrap_or(text));
    }
}

/// Standard error, each line with its priority before it.
struct Journal;

struct Line(Priority);

impl Write for Line {
    /// The subscriber hands over one whole event at a time.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut line = format!("<{}>", self.0 as u8).into_bytes();
        line.extend_from_slice(bytes);
        io::stderr().write_all(&line)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl MakeWriter<'_> for Journal {
    type Writer = Line;

    fn make_writer(&self) -> Line {
        Line(Priority::Info)
    }

    fn make_writer_for(&self, meta: &Metadata<'_>) -> Line {
        Line(match *meta.level() {
            Level::ERROR => Priority::Error,
            Level::WARN => Priority::Warning,
            Level::INFO => Priority::Info,
            _ => Priority::Debug,
        })
    }
}
