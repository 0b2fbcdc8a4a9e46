//! Recordings that are made of drives of other programs, at once and as a whole.

use std::io::{self, Write};

use crate::mcap::Writer;
use crate::read::{RECORDING, VERSION};
use crate::tape::{LIBRARY, writer};

/// Begins a recording in simulated time with this scan period [ns], made of `source`.
///
/// # Errors
/// Those of `out`.
pub fn begin<W: Write>(out: W, period_ns: u64, source: &str) -> io::Result<Writer<W>> {
    let mut writer = writer(out)?;
    let entries = [
        ("version", VERSION.to_owned()),
        ("program", LIBRARY.to_owned()),
        ("imported", source.to_owned()),
        ("lockstep", "true".to_owned()),
        ("period_ns", period_ns.to_string()),
    ];
    writer.metadata(RECORDING, &entries.map(|(key, value)| (key.to_owned(), value)))?;
    Ok(writer)
}

/// Ends it behind its last scan; returns the output.
///
/// # Errors
/// Those of the output.
pub fn end<W: Write>(mut writer: Writer<W>, last_scan: u64) -> io::Result<W> {
    writer.end_chunk()?;
    let counts = [("lost", 0), ("last_scan", last_scan)];
    writer.metadata("end", &counts.map(|(key, count)| (key.to_owned(), count.to_string())))?;
    Ok(writer.finish()?.0)
}
