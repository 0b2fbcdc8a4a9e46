//! What a recording holds.

use std::collections::BTreeMap;
use std::path::Path;

use runtime::one_line;
use serde::Serialize;

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
    /// Recorded time [s].
    pub duration_s: f64,
    /// Whether time was simulated.
    pub lockstep: bool,
    /// The random id of the run.
    pub run_id: String,
    /// The program that recorded it.
    pub program: String,
    /// The machine.
    pub machine: String,
    /// Samples of the drive that are missing in it; `None` where the end is missing.
    pub lost: Option<u64>,
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
        let (mut counts, mut times) = (BTreeMap::<u16, u64>::new(), None);
        loop {
            match recording.reader().next_message() {
                Ok(Some(message)) => {
                    *counts.entry(message.channel).or_default() += 1;
                    let [first, last] = times.unwrap_or([message.log_ns; 2]);
                    times = Some([first.min(message.log_ns), last.max(message.log_ns)]);
                }
                Ok(None) => break,
                Err(error) => return Err(refusal(path, &error)),
            }
        }
        recording.require_a_second()?;
        let contents = recording.contents();
        let [first, last] = times.unwrap_or_default();
        let of = |name: &str, key: &str| metadata(contents, name, key).unwrap_or_default().to_owned();
        let layout_differences = match Recording::layout_differences(contents) {
            Ok(found) => found.iter().map(ToString::to_string).collect(),
            Err(error) => vec![error.to_string()],
        };
        let channels = contents.channels.iter();
        let channels = channels.map(|(number, channel)| {
            (channel.topic.clone(), counts.get(number).copied().unwrap_or_default())
        });
        Ok(Self {
            file: path.display().to_string(),
            bytes: path.metadata().map_or(0, |metadata| metadata.len()),
            complete: contents.is_complete,
            duration_s: (last - first) as f64 * 1e-9,
            lockstep: of("recording", "lockstep") == "true",
            run_id: of("recording", "run_id"),
            program: of("recording", "program"),
            machine: of("recording", "machine"),
            lost: metadata(contents, "end", "lost").and_then(|lost| lost.parse().ok()),
            layout_difference: layout_differences.first().cloned(),
            layout_differences,
            channels: channels.collect(),
            attachments: contents.attachments.iter().map(|attachment| attachment.name.clone()).collect(),
        })
    }
}

impl std::fmt::Display for Info {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let time = if self.lockstep { "lock-step" } else { "real time" };
        let state = if self.complete { "complete" } else { "cut off" };
        let megabytes = self.bytes as f64 * 1e-6;
        writeln!(formatter, "{}: {state}, {:.1} s in {time}, {megabytes:.2} MB", self.file, self.duration_s)?;
        let [run_id, program, machine] =
            [&self.run_id, &self.program, &self.machine].map(|word| one_line(word));
        writeln!(formatter, "run {run_id} of {program} on {machine}")?;
        match self.lost {
            Some(lost) => writeln!(formatter, "{lost} samples lost")?,
            None => writeln!(formatter, "lost samples are not known: the end is missing")?,
        }
        for difference in &self.layout_differences {
            writeln!(formatter, "another layout: {}", one_line(difference))?;
        }
        let mut channels = self.channels.iter();
        channels.try_for_each(|(topic, count)| writeln!(formatter, "{count:>9} {}", one_line(topic)))
    }
}
