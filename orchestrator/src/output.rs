//! What commands print: text for people to standard error, data to standard output.

use std::io::{self, ErrorKind, Write};

use anyhow::Context;

/// Writes text for people; what can't be written is dropped, as the command has done its work in any case.
macro_rules! note {
    ($($text:tt)*) => { runtime::print(runtime::Priority::Notice, &format!($($text)*)) };
}

pub(crate) use note;

/// Writes data and ends its last line; false when the reader has gone, as in `| head`, and needs no more.
///
/// # Errors
/// Data that can't be written, to a full disk for example: a command that was asked for it has failed.
pub fn data(text: &str) -> anyhow::Result<bool> {
    let end = if text.is_empty() || text.ends_with('\n') { "" } else { "\n" };
    let mut output = io::stdout().lock();
    let written = output
        .write_all(text.as_bytes())
        .and_then(|()| output.write_all(end.as_bytes()))
        .and_then(|()| output.flush());
    match written {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
        written => written.map(|()| true).context("standard output"),
    }
}
