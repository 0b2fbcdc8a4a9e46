//! Parts of a recording as new recordings: what can be read of a damaged one, or some seconds of it.

mod copied;
mod new_recording;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use console::exit::Failure;
use console::new_file::{Existing, NewFile, finish_all};
use console::user_file;

use crate::mcap::{Contents, Gap, McapReader};
use crate::read::{RECORDING, metadata, refusal};
use crate::tape::{LIBRARY, definitions};
use new_recording::NewRecording;

pub(crate) use copied::Summary;
pub use copied::{Copied, Missing};

/// Name of the metadata about what a repair could not read.
pub(crate) const REPAIRED: &str = "repaired";
/// Between the last message of a recording and the first of one that is joined to it [ns].
const JOINT_NS: u64 = 1_000_000;

/// Makes a new recording of all that can be read of `from`.
///
/// # Errors
/// A file of which nothing can be read, and a new file that can't be written; exit code 2.
pub fn repair(from: &Path, to: &Path, force: bool) -> anyhow::Result<Copied> {
    let input = user_file::open(from).map_err(|error| refuse(from, &error))?;
    let mut reader = McapReader::salvage(BufReader::new(input)).map_err(|error| refuse(from, &error))?;
    if reader.contents().library.is_empty() || reader.contents().library == LIBRARY {
        let (schemas, channels) = definitions();
        reader.assume(&schemas, &channels);
    }
    let (copied, files) = write(reader, from, to, force, 0..=u64::MAX, false)?;
    finish_all(files)?;
    Ok(copied)
}

/// Copies the messages of `from` that were recorded in `times` [ns] since its first, with all attachments.
///
/// # Errors
/// A file that can't be read, one without a message in that time, and a new file that can't be written; exit code 2.
pub fn copy(from: &Path, to: &Path, force: bool, times: RangeInclusive<u64>) -> anyhow::Result<Copied> {
    let (copied, files) = prepare(from, to, force, times, false)?;
    finish_all(files)?;
    Ok(copied)
}

/// The same, but the new files have no names yet: other files may belong to them. With `adds_ros2`, scans and odometry are also
/// in them as messages of ROS 2.
///
/// # Errors
/// As [`copy`].
pub(crate) fn prepare(
    from: &Path,
    to: &Path,
    force: bool,
    times: RangeInclusive<u64>,
    adds_ros2: bool,
) -> anyhow::Result<(Copied, Vec<NewFile>)> {
    // What is damaged is found before anything is written.
    read(open(from)?, from)?;
    write(open(from)?, from, to, force, times, adds_ros2)
}

/// Passes when all of a file can be read; its memory is free afterwards.
fn read(mut reader: McapReader<BufReader<File>>, path: &Path) -> anyhow::Result<()> {
    while reader.next_message().map_err(|error| refusal(path, &error))?.is_some() {}
    Ok(())
}

fn open(path: &Path) -> anyhow::Result<McapReader<BufReader<File>>> {
    let input = user_file::open(path).map_err(|error| refuse(path, &error))?;
    McapReader::new(BufReader::new(input)).map_err(|error| refusal(path, &error))
}

fn refuse(path: &Path, reason: &dyn std::fmt::Display) -> anyhow::Error {
    Failure::bad_input(format!("{}: {reason}", path.display()))
}

fn write(
    mut reader: McapReader<BufReader<File>>,
    from: &Path,
    to: &Path,
    force: bool,
    times: RangeInclusive<u64>,
    adds_ros2: bool,
) -> anyhow::Result<(Copied, Vec<NewFile>)> {
    let (mut copied, mut files) = (Copied::default(), Vec::new());
    let mut copy: Option<NewRecording> = None;
    let mut axis = Axis { start_ns: start_ns(reader.contents()), ..Axis::default() };
    // The files in front of this one are in new files that were ended.
    let mut ended = 0;
    let mut data = Vec::new();
    loop {
        let message = match reader.next_message() {
            Ok(Some(message)) => message,
            Ok(None) => break,
            Err(error) => return Err(refusal(from, &error)),
        };
        let (channel, sequence, times_ns) =
            (message.channel, message.sequence, [message.log_ns, message.publish_ns]);
        data.clear();
        data.extend_from_slice(message.data);
        if !times.contains(&axis.since_start_ns(reader.file(), times_ns[0])) {
            continue;
        }
        let file = reader.file();
        if copy.as_ref().is_none_or(|copy| !is_one_run(reader.files(), copy.file, file)) {
            if let Some(copy) = copy.take() {
                files.push(copy.finish(&reader, ended..file, &axis, &mut copied)?);
                ended = file;
            }
            let path = numbered(to, copied.files.len() + 1);
            let output = NewFile::create(&path, Existing::forced(force), &[from])?;
            copied.files.push(path);
            copy = Some(NewRecording::begin(output, reader.files(), file, adds_ros2)?);
        }
        if let Some(copy) = &mut copy {
            copied.messages += copy.message(reader.contents(), file, channel, sequence, times_ns, &data)?;
        }
    }
    copied.gaps = reader.gaps().iter().map(|gap| axis.missing(*gap)).collect();
    let all = 0..reader.files().len();
    copied.missing_messages = reader.missing(all.clone(), |_| true);
    copied.missing_attachments = reader.missing_attachments(all.clone());
    copied.is_loss = is_loss(&copied.gaps, copied.missing_messages, copied.missing_attachments);
    match copy {
        Some(copy) => files.push(copy.finish(&reader, ended..all.end, &axis, &mut copied)?),
        None if times == (0..=u64::MAX) => return Err(refuse(from, &"it holds not one message")),
        None => return Err(refuse(from, &"no whole second of this time is in the recording")),
    }
    Ok((copied, files))
}

/// Whether something of the drive or of what is attached is missing, or may be where that is not known.
fn is_loss(gaps: &[Missing], messages: Option<u64>, attachments: Option<u64>) -> bool {
    let is_missing = |count: Option<u64>| count.is_some_and(|count| count > 0);
    let may_be = gaps.iter().any(|missing| missing.gap.is_data);
    may_be || is_missing(messages) || is_missing(attachments)
}

/// The time of the first message by the summary, if there is one [ns].
fn start_ns(contents: &Contents) -> Option<u64> {
    let counted = contents.statistics.as_ref().filter(|counted| counted.messages > 0);
    counted.map(|counted| counted.times[0])
}

/// The path of one of several new files: `new.mcap`, `new-2.mcap`.
fn numbered(path: &Path, number: usize) -> PathBuf {
    if number == 1 {
        return path.to_owned();
    }
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("-{number}"));
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

/// Whether two of the joined files are of one run, so that they can be one file.
fn is_one_run(files: &[Contents], one: usize, other: usize) -> bool {
    let run = |file: usize| metadata(&files[file], RECORDING, "run_id");
    one == other || run(one) == run(other)
}

/// Times of joined files on one axis: one that does not follow in time is set behind the one before.
#[derive(Debug, Default)]
struct Axis {
    /// The first message of all [ns].
    start_ns: Option<u64>,
    newest_ns: u64,
    /// Added to the times of each file that was read; the first has none [ns].
    shifts_ns: BTreeMap<usize, u64>,
}

impl Axis {
    fn since_start_ns(&mut self, file: usize, log_ns: u64) -> u64 {
        let first_ns = self.newest_ns.saturating_add(JOINT_NS);
        let shift_ns = match file {
            0 => 0,
            file => *self.shifts_ns.entry(file).or_insert(first_ns.saturating_sub(log_ns)),
        };
        let start_ns = *self.start_ns.get_or_insert(log_ns);
        let time_ns = log_ns.saturating_add(shift_ns);
        self.newest_ns = self.newest_ns.max(time_ns);
        time_ns.saturating_sub(start_ns)
    }

    fn missing(&self, gap: Gap) -> Missing {
        let start_ns = self.start_ns.unwrap_or_default();
        let shift_ns = self.shifts_ns.range(..=gap.file).next_back().map_or(0, |(_, shift_ns)| *shift_ns);
        let since_s = |time_ns: u64| time_ns.saturating_add(shift_ns).saturating_sub(start_ns) as f64 * 1e-9;
        Missing { gap, from_s: gap.from_ns.map(since_s), to_s: gap.to_ns.map(since_s) }
    }
}

#[cfg(test)]
mod tests;
