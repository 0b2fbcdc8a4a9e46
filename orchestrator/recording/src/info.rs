//! What a recording holds.

use std::collections::BTreeMap;
use std::path::Path;

use runtime::one_line;
use serde::Serialize;

use crate::copy::REPAIRED;
use crate::mcap::Contents;
use crate::read::{Recording, metadata, refusal};

/// What a recording holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Info {
    /// The file.
    pub file: String,
    /// Its length.
    pub bytes: u64,
    /// Whether it has its end; false for one that was cut off.
    pub complete: bool,
    /// Recorded time; of joined files the sum [s].
    pub duration_s: f64,
    /// Recordings that were joined to this file; mostly one.
    pub files: u64,
    /// Whether time was simulated.
    pub lockstep: bool,
    /// The random id of the run.
    pub run_id: String,
    /// The file of another program that it was made of; empty for a drive of this one.
    pub imported: String,
    /// The program that recorded it.
    pub program: String,
    /// The machine.
    pub machine: String,
    /// Samples of the drive that are missing in it; `None` where the end is missing, or a repair could not count them.
    pub lost: Option<u64>,
    /// What a repair could not read; empty for all others.
    pub missing: String,
    /// The first difference between the layouts of its samples and those of this program.
    pub layout_difference: Option<String>,
    /// All fields in which they differ.
    pub layout_differences: Vec<String>,
    /// Messages per channel.
    pub channels: BTreeMap<String, u64>,
    /// Names of the files inside.
    pub attachments: Vec<String>,
}

impl Info {
    /// Reads all of a recording.
    ///
    /// # Errors
    /// A file that can't be read or is damaged; exit code 2.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let mut recording = Recording::open(path)?;
        // Of each joined file: messages by channel, and the times of the first and last one [ns].
        let mut read = vec![(BTreeMap::<u16, u64>::new(), [u64::MAX, 0]); recording.files().len()];
        loop {
            let (channel, log_ns) = match recording.reader().next_message() {
                Ok(Some(message)) => (message.channel, message.log_ns),
                Ok(None) => break,
                Err(error) => return Err(refusal(path, &error)),
            };
            let (counts, [first, last]) = &mut read[recording.reader().file()];
            *counts.entry(channel).or_default() += 1;
            (*first, *last) = (log_ns.min(*first), log_ns.max(*last));
        }
        recording.require_a_second()?;
        let files = recording.files();
        let contents = &files[0];
        let durations_ns = read.iter().map(|(_, [first, last])| last.saturating_sub(*first));
        let duration_ns = durations_ns.fold(0, u64::saturating_add);
        let of = |name: &str, key: &str| metadata(contents, name, key).unwrap_or_default().to_owned();
        let layout_differences = match Recording::layout_differences(contents) {
            Ok(found) => found.iter().map(ToString::to_string).collect(),
            Err(error) => vec![error.to_string()],
        };
        let mut channels = BTreeMap::new();
        for (contents, (counts, _)) in files.iter().zip(&read) {
            for (number, channel) in &contents.channels {
                let count = counts.get(number).copied().unwrap_or_default();
                *channels.entry(channel.topic.clone()).or_default() += count;
            }
        }
        let missing = files.iter().filter_map(|contents| metadata(contents, REPAIRED, "missing"));
        Ok(Self {
            file: path.display().to_string(),
            bytes: path.metadata().map_or(0, |metadata| metadata.len()),
            complete: files.iter().all(|contents| contents.is_complete),
            duration_s: duration_ns as f64 * 1e-9,
            files: files.len() as u64,
            lockstep: of("recording", "lockstep") == "true",
            run_id: of("recording", "run_id"),
            imported: of("recording", "imported"),
            program: of("recording", "program"),
            machine: of("recording", "machine"),
            lost: files.iter().try_fold(0_u64, |sum, contents| Some(sum.saturating_add(lost(contents)?))),
            missing: missing.collect::<Vec<_>>().join("; "),
            layout_difference: layout_differences.first().cloned(),
            layout_differences,
            channels,
            attachments: files
                .iter()
                .flat_map(|contents| contents.attachments.iter().map(|attachment| attachment.name.clone()))
                .collect(),
        })
    }
}

/// Samples that are missing in a file: those which the recorder lost, and those which a repair could not read.
fn lost(contents: &Contents) -> Option<u64> {
    let of = |name: &str| metadata(contents, name, "lost").map(|lost| lost.parse::<u64>().ok());
    let repaired = of(REPAIRED).unwrap_or(Some(0))?;
    Some(of("end")??.saturating_add(repaired))
}

impl std::fmt::Display for Info {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let time = if self.lockstep { "lock-step" } else { "real time" };
        let state = if self.complete { "complete" } else { "cut off" };
        let megabytes = self.bytes as f64 * 1e-6;
        let state = match self.files {
            1 => state.to_owned(),
            files => format!("{files} joined recordings, {state}"),
        };
        writeln!(formatter, "{}: {state}, {:.1} s in {time}, {megabytes:.2} MB", self.file, self.duration_s)?;
        let [run_id, program, machine] =
            [&self.run_id, &self.program, &self.machine].map(|word| one_line(word));
        match self.run_id.is_empty() {
            _ if !self.imported.is_empty() => {
                writeln!(formatter, "imported from {} by {program}", one_line(&self.imported))?
            }
            false => writeln!(formatter, "run {run_id} of {program} on {machine}")?,
            true => writeln!(formatter, "no recording of a drive")?,
        }
        match self.lost {
            Some(lost) => writeln!(formatter, "{lost} samples lost")?,
            None if self.missing.is_empty() && !self.complete => {
                writeln!(formatter, "lost samples are not known: the end is missing")?;
            }
            None => writeln!(formatter, "lost samples are not known")?,
        }
        if !self.missing.is_empty() {
            writeln!(formatter, "repaired; missing: {}", one_line(&self.missing))?;
        }
        for difference in &self.layout_differences {
            writeln!(formatter, "another layout: {}", one_line(difference))?;
        }
        let mut channels = self.channels.iter();
        channels.try_for_each(|(topic, count)| writeln!(formatter, "{count:>9} {}", one_line(topic)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mcap::handmade::{begun, channel, chunk, end, message};

    #[test]
    fn the_largest_times_of_joined_files_are_added_up() {
        let path = std::env::temp_dir().join(format!("scanloop-info-{}.mcap", std::process::id()));
        let messages = [channel(1, 0, "/a"), message(1, 0, b"a"), message(1, u64::MAX, b"a")].concat();
        let one = [begun("other"), chunk(&messages, "", [0, u64::MAX]), end()].concat();
        std::fs::write(&path, one.repeat(2)).unwrap();
        let info = Info::read(&path).unwrap();
        assert_eq!((info.files, info.duration_s), (2, u64::MAX as f64 * 1e-9));
        std::fs::remove_file(&path).unwrap();
    }
}
