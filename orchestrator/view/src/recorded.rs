//! A recording as the page shows it: its frames, made from the file when they are asked for.
//!
//! The file is read once. What is kept is a row per frame with the chunks, about a second each, that hold its samples, and
//! the events. So a recording of an hour takes some megabytes, and a frame costs reading one to three chunks.

mod processes;
mod samples;

use std::path::Path;

use console::exit::Failure;
use recording::Recording;
use recording::read::{RUN, attachment, metadata};
use report::latency::Latencies;
use runtime::settings_file;
use serde_json::{Value, json};
use shared_types::Role;

use self::processes::{Outputs, Processes};
use self::samples::{Directives, Key, OwnedSample, SHOWN};
use crate::course::{Goals, course};
use crate::events::{Event, Events};
use crate::follower::News;
use crate::history::Row;
use crate::scene::Scene;

/// The time axis of the page shows at most so many rows.
const MAX_ROWS: usize = 3600;
/// Frames of a longer recording would take too much memory: at ten a second, those of a day.
const MAX_FRAMES: usize = 1 << 20;
/// Between the last sample of a recording and the first of one that is joined to it [ns].
const JOINT_NS: u64 = 1_000_000_000;
/// Rows around a time that are sent at once: what charts show, and what is played next [s].
const ROWS_S: [f64; 2] = [-90.0, 30.0];

/// A recording that is shown.
pub(crate) struct RecordedDrive {
    recording: Recording,
    /// Where the chunks begin in the file.
    chunks: Vec<u64>,
    frames: Vec<Frame>,
    events: Vec<Event>,
    directives: Directives,
    goals: Goals,
    /// Of each of the recordings that were joined.
    processes: Vec<Processes>,
    shifts: Shifts,
    start_ns: u64,
    simulated: bool,
    /// What stays the same, as JSON.
    system: Value,
}

/// A frame: its row, the newest of its samples, and the chunks in which they are.
#[derive(Debug, Clone, Copy)]
struct Frame {
    row: Row,
    newest: Key,
    chunks: [Option<u32>; SHOWN.len()],
}

impl RecordedDrive {
    /// Reads a recording.
    ///
    /// # Errors
    /// A file that can't be read, holds no drive, or has samples of another layout; exit code 2.
    pub(crate) fn open(path: &Path) -> anyhow::Result<Self> {
        let refuse = |reason: String| Failure::bad_input(format!("{}: {reason}", path.display()));
        let mut recording = Recording::open(path)?;
        let mut reading: Option<Reading> = None;
        recording.samples(|contents, sample| {
            if reading.is_none() {
                if let Some(difference) = Recording::layout_differences(contents)?.first() {
                    return Err(refuse(format!("another layout: {difference}")));
                }
                let mut begun = Reading::new(metadata(contents, "recording", "lockstep") == Some("true"));
                begun.scene.samples.is_undriven = metadata(contents, "recording", "imported").is_some();
                reading = Some(begun);
            }
            let Some(reading) = &mut reading else { return Ok(()) };
            reading.add(&sample);
            match reading.frames.len() > MAX_FRAMES {
                true => Err(refuse(format!(
                    "more than {MAX_FRAMES} frames; `scanloop recording cut` makes a shorter recording"
                ))),
                false => Ok(()),
            }
        })?;
        let reading = reading.map(Reading::finish).filter(|reading| !reading.frames.is_empty());
        let Some(mut reading) = reading else { return Err(refuse("it holds no scan of a drive".to_owned())) };
        let lines = recording.take_lines();
        let contents = &recording.files()[0];
        let of = |name: &str, key: &str| metadata(contents, name, key);
        let lost = |contents| metadata(contents, "end", "lost").and_then(|lost| lost.parse::<u64>().ok());
        let settings = attachment(contents, &settings_file(Role::Controller)).unwrap_or_default();
        let run: toml::Table =
            attachment(contents, RUN).and_then(|text| text.parse().ok()).unwrap_or_default();
        let scenario = run.get("scenario").and_then(|scenario| scenario.get("name"));
        let simulated = reading.scene.samples.simulated;
        let (course, goals) = course(settings);
        let system = json!({
            "connection": "recording",
            "time_s": reading.frames.last().map(|frame| frame.row.time_s),
            "file": path.file_name().map(|name| name.to_string_lossy()),
            "complete": recording.files().iter().all(|contents| contents.is_complete),
            "lost": recording.files().iter().try_fold(0_u64, |sum, file| Some(sum.saturating_add(lost(file)?))),
            "scenario": scenario.and_then(toml::Value::as_str),
            "system_id": of("recording", "system_id"),
            "run_id": of("recording", "run_id"),
            "course": course,
            "latency_us": (!simulated).then(|| reading.latencies.report()),
            "actions": [],
        });
        let processes = recording.files().iter().map(Processes::new).collect();
        let start_ns = reading.start_ns.unwrap_or_default();
        for line in lines {
            let time_s = line.log_ns.saturating_sub(start_ns) as f64 * 1e-9;
            reading.events.log(time_s, &line.name, &line.text, line.is_warning);
        }
        let events = reading.events.take_sorted();
        let Reading { chunks, frames, directives, shifts, .. } = reading;
        Ok(Self {
            recording,
            chunks,
            frames,
            events,
            directives,
            goals,
            processes,
            shifts,
            start_ns,
            simulated,
            system,
        })
    }

    /// What stays the same, as JSON.
    pub(crate) fn system(&self) -> &Value {
        &self.system
    }

    /// What has happened, in the order of time.
    pub(crate) fn events(&self) -> &[Event] {
        &self.events
    }

    /// The rows of the whole recording, in at most `most` steps.
    pub(crate) fn rows(&self, most: usize) -> Vec<Row> {
        let step = self.frames.len().div_ceil(most).max(1);
        // A step is shown as blocked if any of its frames is.
        let of = |frames: &[Frame]| {
            let blocked = frames.iter().find(|frame| frame.row.blocked == 1);
            blocked.or(frames.first()).map(|frame| frame.row)
        };
        self.frames.chunks(step).filter_map(of).collect()
    }

    /// The rows around a time, or those of the whole recording in at most [`MAX_ROWS`] steps, with all events; as JSON.
    pub(crate) fn history(&self, at_s: Option<f64>) -> String {
        let Some(at_s) = at_s else {
            let (rows, frames) = (self.rows(MAX_ROWS), self.frames.len());
            return json!({ "recording": { "frames": frames }, "rows": rows, "events": self.events })
                .to_string();
        };
        let [first, end] = ROWS_S.map(|span_s| self.frames_until(at_s + span_s));
        let rows: Vec<Row> = self.frames[first..end].iter().map(|frame| frame.row).collect();
        json!({ "rows": rows, "events": [] }).to_string()
    }

    /// The number of frames up to a time.
    fn frames_until(&self, at_s: f64) -> usize {
        self.frames.partition_point(|frame| frame.row.time_s <= at_s)
    }

    /// The newest frame at a time, or the first one; as JSON.
    ///
    /// # Errors
    /// A file that was changed meanwhile.
    pub(crate) fn frame(&mut self, at_s: f64) -> anyhow::Result<Value> {
        let Frame { row, newest, chunks } = self.frames[self.frames_until(at_s).saturating_sub(1)];
        let last = chunks.iter().flatten().max().copied().unwrap_or_default();
        // Rates are those of a second.
        let mut numbers: Vec<u32> = chunks.into_iter().flatten().chain(last.checked_sub(1)).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let (mut samples, mut file) = (Vec::new(), 0);
        for number in numbers {
            self.recording.chunk(self.chunks[number as usize], |recorded| {
                file = recorded.file;
                let recorded = self.shifts.moved(recorded);
                samples.extend(OwnedSample::new(&recorded, number).filter(|sample| sample.key <= newest));
            })?;
        }
        samples.sort_by_key(|sample| sample.key);
        let mut scene = Scene::default();
        scene.samples.simulated = self.simulated;
        let (mut unused, mut outputs) = (Events::default(), Outputs::default());
        for sample in &samples {
            // Chunks in between were left out, and with them their directives.
            scene.directive = self.directives.at(sample.key);
            outputs.note(sample);
            if let Some(news) = sample.news(&scene.directive) {
                scene.take(news, &mut unused, row.time_s);
            }
        }
        let now_ns = self.start_ns.saturating_add((row.time_s * 1e9) as u64);
        let directives = self.directives.until(newest);
        directives.iter().for_each(|(_, directive)| scene.give(&directive.goal));
        scene.show_goals(&self.goals);
        let mut frame = scene.samples.json(&row);
        frame["system"] = json!({
            "status": self.processes[file].status(directives, &outputs, now_ns),
            "authority": self.directives.at(newest).authority.map(|authority| authority.incarnation),
        });
        Ok(frame)
    }
}

/// What is known while the file is read.
struct Reading {
    chunks: Vec<u64>,
    /// Samples of the last two chunks: they are not in the order of time within a chunk, and little across chunks.
    pending: Vec<OwnedSample>,
    /// The newest sample of the chunk before and of this one [ns].
    newest_ns: [u64; 2],
    frames: Vec<Frame>,
    events: Events,
    directives: Directives,
    latencies: Latencies,
    scene: Scene,
    /// The chunks with the newest samples of each topic.
    newest: [Option<u32>; SHOWN.len()],
    start_ns: Option<u64>,
    shifts: Shifts,
}

/// What is added to the times of each of the recordings that were joined to one file [ns]: each follows the one before.
#[derive(Debug, Default)]
struct Shifts {
    by_file: Vec<u64>,
    newest_ns: u64,
}

impl Shifts {
    /// Takes in a sample while the file is read.
    fn note(&mut self, recorded: &recording::RecordedSample<'_>) {
        if self.by_file.len() <= recorded.file {
            let after_ns = if recorded.file == 0 { 0 } else { self.newest_ns.saturating_add(JOINT_NS) };
            self.by_file.resize(recorded.file + 1, after_ns.saturating_sub(recorded.log_ns));
        }
        self.newest_ns = self.newest_ns.max(self.moved(*recorded).log_ns);
    }

    fn moved<'a>(&self, recorded: recording::RecordedSample<'a>) -> recording::RecordedSample<'a> {
        let shift_ns = self.by_file.get(recorded.file).copied().unwrap_or_default();
        recording::RecordedSample { log_ns: recorded.log_ns.saturating_add(shift_ns), ..recorded }
    }
}

impl Reading {
    fn new(simulated: bool) -> Self {
        let mut scene = Scene::default();
        scene.samples.simulated = simulated;
        Self {
            chunks: Vec::new(),
            pending: Vec::new(),
            newest_ns: [0; 2],
            frames: Vec::new(),
            events: Events::of_recording(),
            directives: Directives::default(),
            latencies: Latencies::new(simulated),
            scene,
            newest: [None; SHOWN.len()],
            start_ns: None,
            shifts: Shifts::default(),
        }
    }

    fn add(&mut self, recorded: &recording::RecordedSample<'_>) {
        if self.chunks.last() != Some(&recorded.chunk_at) {
            self.release(self.newest_ns[0]);
            self.newest_ns = [self.newest_ns[1], 0];
            self.chunks.push(recorded.chunk_at);
        }
        self.shifts.note(recorded);
        let recorded = self.shifts.moved(*recorded);
        let Some(sample) = OwnedSample::new(&recorded, self.chunks.len() as u32 - 1) else { return };
        self.newest_ns[1] = self.newest_ns[1].max(sample.key.0);
        self.pending.push(sample);
    }

    fn finish(mut self) -> Self {
        self.release(u64::MAX);
        self
    }

    /// Takes the samples up to a time in their order.
    fn release(&mut self, until_ns: u64) {
        self.pending.sort_by_key(|sample| sample.key);
        let end = self.pending.partition_point(|sample| sample.key.0 <= until_ns);
        let released: Vec<OwnedSample> = self.pending.drain(..end).collect();
        released.iter().for_each(|sample| self.take(sample));
    }

    fn take(&mut self, sample: &OwnedSample) {
        let start_ns = *self.start_ns.get_or_insert(sample.key.0);
        let now_s = sample.key.0.saturating_sub(start_ns) as f64 * 1e-9;
        self.events.set_time(now_s);
        if let Some(news) = sample.news(&self.scene.directive) {
            match news {
                News::Directive(directive) => self.directives.add(sample.key, directive),
                News::Actuation(actuation) if actuation.answers == 1 => {
                    self.latencies.record(&actuation.header)
                }
                _ => {}
            }
            self.scene.take(news, &mut self.events, now_s);
            if let Some(index) = SHOWN.iter().position(|topic| *topic == sample.topic) {
                self.newest[index] = Some(sample.chunk);
            }
        }
        if let Some(row) = self.scene.next_row(now_s) {
            self.frames.push(Frame { row, newest: sample.key, chunks: self.newest });
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
