//! `scanloop urg log`: scans as lines of numbers.
//!
//! The columns are those of the CoreSLAM logs, so their readers read these files too: column 0 is the time of the front
//! beam, columns 2 and 3 are wheel ticks (here zero), and columns 24 to 705 the ranges. Columns that those logs leave
//! open hold what this driver knows besides.

use std::fmt::Write as _;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use console::answer;
use console::exit::{Exit, Failure};
use console::new_file::{Existing, NewFile};
use shared_types::Scan;
use urg::Reading;

use super::arguments::LogArguments;
use super::scanner::Scanner;

/// The file with which the lines are the answer, and the summary a note.
const STANDARD_OUTPUT: &str = "/dev/stdout";
/// Columns of a line: 24 before the ranges, and one after them.
const BEFORE: usize = 24;

/// Writes scans until the end.
pub(super) fn log(arguments: &LogArguments) -> anyhow::Result<Exit> {
    let device: Vec<&Path> = arguments.scanner.place.device.iter().map(PathBuf::as_path).collect();
    let mut new = Some(NewFile::create(&arguments.file, Existing::forced(arguments.force), &device)?);
    let mut scanner = Scanner::open(&arguments.scanner)?;
    let refused =
        |error: std::io::Error| Failure::bad_input(format!("{}: {error}", arguments.file.display()));
    let mut file: Option<File> = None;
    let (mut scan, mut line) = (Scan::default(), String::new());
    let (mut count, mut missing, mut error_ns, mut span_ns) = (0_u64, 0_u64, 0, (u64::MAX, 0));
    while let Some(reading) = scanner.next(&mut scan)? {
        // Not before the scanner has given a scan: a wrong address replaces no file.
        if let Some(new) = new.take() {
            file = Some(new.publish()?);
        }
        write_line(&mut line, &reading, &scan);
        // Each line at once: a driver may read them from a pipe.
        file.as_mut().map_or(Ok(()), |file| file.write_all(line.as_bytes())).map_err(refused)?;
        count += 1;
        missing += u64::from(reading.is_missing);
        error_ns = error_ns.max(reading.error_ns);
        span_ns = (span_ns.0.min(scan.header.acquired_ns), scan.header.acquired_ns);
    }
    let seconds = span_ns.1.saturating_sub(span_ns.0) as f64 * 1e-9;
    let rate_hz = if seconds > 0.0 { (count - 1) as f64 / seconds } else { 0.0 };
    answer!(
        arguments.file == Path::new(STANDARD_OUTPUT),
        "{}: {count} scans, {rate_hz:.2} a second, {missing} without ranges, stamps within {:.1} ms",
        arguments.file.display(),
        error_ns as f64 * 1e-6
    )?;
    Ok(if count > 0 { Exit::Done } else { Exit::NotReached })
}

fn write_line(line: &mut String, reading: &Reading, scan: &Scan) {
    line.clear();
    let mut columns = [0; BEFORE];
    columns[0] = scan.header.acquired_ns / 1000;
    columns[1] = reading.arrived_ns / 1000;
    columns[4] = u64::from(reading.stamp_ms);
    columns[5] = reading.error_ns / 1000;
    columns[6] = u64::from(reading.is_missing);
    let ranges = scan.ranges().iter().map(|range| u64::from(*range));
    for value in columns.into_iter().chain(ranges) {
        // Writing to a text does not fail.
        let _ = write!(line, "{value} ");
    }
    line.push_str("0\n");
}
