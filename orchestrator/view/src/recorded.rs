//! A recording as the page shows it: its frames, made from the file when they are asked for.
//!
//! The file is read once. What is kept is a row per frame, the events, and for each chunk, about a second, where it begins
//! and which earlier chunks hold the newest sample of each topic: enough to make any frame from a few chunks.

mod processes;

use std::path::Path;

use bytemuck::from_bytes;
use console::exit::Failure;
use recording::read::{RUN, attachment, metadata};
use recording::{Recorded, Recording};
use report::latency::Latencies;
use runtime::settings_file;
use serde_json::{Value, json};
use shared_types::{Actuation, Directive, Header, Obstacles, Pose, Role, Sample, Scan, Topic, Truth};

use self::processes::{Outputs, Processes};
use crate::events::{Event, Events};
use crate::follower::News;
use crate::history::Row;
use crate::scene::Scene;

/// The time axis of the page shows at most so many rows.
const MAX_ROWS: usize = 3600;
/// Rows around a time that are sent at once: what charts show, and what is played next [s].
const ROWS_S: [f64; 2] = [-90.0, 30.0];
/// The topics that a frame shows, the order of [`Mark::newest`].
const SHOWN: [Topic; 6] =
    [Topic::Scan, Topic::Pose, Topic::Obstacles, Topic::Command, Topic::Truth, Topic::Actuation];

/// A recording that is shown.
pub(crate) struct Tape {
    recording: Recording,
    marks: Vec<Mark>,
    frames: Vec<Frame>,
    events: Vec<Event>,
    /// Directives that changed something, and when they came [s].
    directives: Vec<(f64, Directive)>,
    processes: Processes,
    start_ns: u64,
    simulated: bool,
    /// What stays the same, as JSON.
    system: Value,
}

/// A chunk of the file.
#[derive(Debug, Clone, Copy)]
struct Mark {
    chunk_at: u64,
    /// The chunks with the newest samples before this one.
    newest: [Option<u32>; SHOWN.len()],
    /// The newest directive before this chunk.
    directive: Directive,
}

/// A frame: its row, and the sample after which it is complete.
#[derive(Debug, Clone, Copy)]
struct Frame {
    row: Row,
    chunk: u32,
    sample: u32,
}

impl Tape {
    /// Reads a recording.
    ///
    /// # Errors
    /// A file that can't be read, holds no drive, or has samples of another layout; exit code 2.
    pub(crate) fn open(path: &Path) -> anyhow::Result<Self> {
        let refuse = |reason: String| Failure::bad_input(format!("{}: {reason}", path.display()));
        let mut recording = Recording::open(path)?;
        let mut reading: Option<Reading> = None;
        recording.samples(|contents, sample| {
            let reading = match &mut reading {
                Some(reading) => reading,
                None => {
                    if let Some(difference) = Recording::layout_difference(contents) {
                        return Err(refuse(format!("another layout: {difference}")));
                    }
                    let simulated = metadata(contents, "recording", "lockstep") == Some("true");
                    reading.insert(Reading::new(sample.log_ns, simulated))
                }
            };
            reading.take(&sample);
            Ok(())
        })?;
        let reading = reading.filter(|reading| !reading.frames.is_empty());
        let Some(reading) = reading else { return Err(refuse("it holds no scan of a drive".to_owned())) };
        let contents = recording.contents();
        let of = |name: &str, key: &str| metadata(contents, name, key);
        let settings = attachment(contents, &settings_file(Role::Controller)).unwrap_or_default();
        let run: toml::Table =
            attachment(contents, RUN).and_then(|text| text.parse().ok()).unwrap_or_default();
        let scenario = run.get("scenario").and_then(|scenario| scenario.get("name"));
        let system = json!({
            "connection": "recording",
            "time_s": reading.now_s,
            "file": path.file_name().map(|name| name.to_string_lossy()),
            "complete": contents.is_complete,
            "lost": of("end", "lost").and_then(|lost| lost.parse::<u64>().ok()),
            "scenario": scenario.and_then(toml::Value::as_str),
            "system_id": of("recording", "system_id"),
            "run_id": of("recording", "run_id"),
            "course": crate::course::course(settings),
            "latency_us": (!reading.scene.samples.simulated).then(|| reading.latencies.report()),
            "actions": [],
        });
        let processes = Processes::new(contents);
        let Reading { marks, frames, mut events, directives, start_ns, scene, .. } = reading;
        let (events, simulated) = (events.take(), scene.samples.simulated);
        Ok(Self { recording, marks, frames, events, directives, processes, start_ns, simulated, system })
    }

    /// What stays the same, as JSON.
    pub(crate) fn system(&self) -> String {
        self.system.to_string()
    }

    /// The rows around a time, or those of the whole recording in at most [`MAX_ROWS`] steps, with all events; as JSON.
    pub(crate) fn history(&self, at_s: Option<f64>) -> String {
        let Some(at_s) = at_s else {
            let step = self.frames.len().div_ceil(MAX_ROWS).max(1);
            // A step is shown as blocked if any of its frames is.
            let of =
                |frames: &[Frame]| frames.iter().find(|frame| frame.row.blocked == 1).map(|frame| frame.row);
            let rows = self.frames.chunks(step).filter_map(|frames| of(frames).or(Some(frames.first()?.row)));
            return json!({ "rows": rows.collect::<Vec<_>>(), "events": self.events }).to_string();
        };
        let [first, end] = ROWS_S.map(|span_s| self.index_after(at_s + span_s));
        let rows: Vec<Row> = self.frames[first..end].iter().map(|frame| frame.row).collect();
        json!({ "rows": rows, "events": [] }).to_string()
    }

    /// The number of frames up to a time.
    fn index_after(&self, at_s: f64) -> usize {
        self.frames.partition_point(|frame| frame.row.time_s <= at_s)
    }

    /// The newest frame at a time, or the first one; as JSON.
    ///
    /// # Errors
    /// A file that was changed meanwhile.
    pub(crate) fn frame(&mut self, at_s: f64) -> anyhow::Result<String> {
        let Frame { row, chunk, sample } = self.frames[self.index_after(at_s).saturating_sub(1)];
        let mark = self.marks[chunk as usize];
        let mut chunks: Vec<u32> = mark.newest.into_iter().flatten().chain(chunk.checked_sub(1)).collect();
        chunks.sort_unstable();
        chunks.dedup();
        let mut scene = Scene::default();
        scene.samples.simulated = self.simulated;
        let (mut unheard, mut outputs) = (Events::default(), Outputs::default());
        for number in chunks.into_iter().chain([chunk]) {
            let Mark { chunk_at, directive, .. } = self.marks[number as usize];
            scene.directive = directive;
            let mut left = if number == chunk { sample + 1 } else { u32::MAX };
            self.recording.chunk(chunk_at, |recorded| {
                if left > 0 {
                    left -= 1;
                    outputs.note(&recorded);
                    take(&recorded, &mut scene, &mut unheard, row.time_s);
                }
            })?;
        }
        let newest = self.directives.partition_point(|(time_s, _)| *time_s <= row.time_s);
        let directives = &self.directives[..newest];
        let now_ns = self.start_ns + (row.time_s * 1e9) as u64;
        let mut frame = scene.samples.json(&row);
        frame["system"] = json!({
            "status": self.processes.status(directives, &outputs, now_ns),
            "authority": directives.last().map(|(_, directive)| directive.authority.map(|of| of.incarnation)),
        });
        Ok(frame.to_string())
    }
}

/// What is known while the file is read.
struct Reading {
    marks: Vec<Mark>,
    frames: Vec<Frame>,
    events: Events,
    directives: Vec<(f64, Directive)>,
    latencies: Latencies,
    scene: Scene,
    /// The chunks with the newest samples.
    newest: [Option<u32>; SHOWN.len()],
    samples: u32,
    start_ns: u64,
    now_s: f64,
}

impl Reading {
    fn new(start_ns: u64, simulated: bool) -> Self {
        let mut scene = Scene::default();
        scene.samples.simulated = simulated;
        Self {
            marks: Vec::new(),
            frames: Vec::new(),
            events: Events::of_recording(),
            directives: Vec::new(),
            latencies: Latencies::new(simulated),
            scene,
            newest: [None; SHOWN.len()],
            samples: 0,
            start_ns,
            now_s: 0.0,
        }
    }

    fn take(&mut self, recorded: &Recorded<'_>) {
        if self.marks.last().is_none_or(|mark| mark.chunk_at != recorded.chunk_at) {
            let (newest, directive) = (self.newest, self.scene.directive);
            self.marks.push(Mark { chunk_at: recorded.chunk_at, newest, directive });
            self.samples = 0;
        }
        let chunk = self.marks.len() as u32 - 1;
        // Samples are in the order of their stamps within a chunk only.
        self.now_s = self.now_s.max(recorded.log_ns.saturating_sub(self.start_ns) as f64 * 1e-9);
        self.events.set_time(self.now_s);
        if take(recorded, &mut self.scene, &mut self.events, self.now_s) {
            if let Some(index) = SHOWN.iter().position(|topic| *topic == recorded.topic) {
                self.newest[index] = Some(chunk);
            }
            match recorded.topic {
                Topic::Directive => self.note_directive(),
                Topic::Actuation => {
                    let actuation: &Actuation = from_bytes(recorded.bytes);
                    if actuation.answers == 1 {
                        self.latencies.record(&actuation.header);
                    }
                }
                _ => {}
            }
        }
        if let Some(row) = self.scene.next_row(self.now_s) {
            self.frames.push(Frame { row, chunk, sample: self.samples });
        }
        self.samples += 1;
    }

    fn note_directive(&mut self) {
        let new = self.scene.directive;
        let is_same = |(_, old): &(f64, Directive)| (old.phase, old.authority) == (new.phase, new.authority);
        if !self.directives.last().is_some_and(is_same) {
            self.directives.push((self.now_s, new));
        }
    }
}

/// Hands a recorded sample to a scene; whether it counts.
fn take(recorded: &Recorded<'_>, scene: &mut Scene, events: &mut Events, now_s: f64) -> bool {
    fn of<'a, S: Sample>(
        recorded: &Recorded<'a>,
        directive: &Directive,
        news: impl Fn(&'a S) -> News<'a>,
    ) -> Option<News<'a>> {
        let sample: &S = from_bytes(recorded.bytes);
        let counts = sample.check().is_ok() && directive.counts(recorded.topic, sample.header());
        counts.then(|| news(sample))
    }
    let directive = &scene.directive;
    let news = match recorded.topic {
        Topic::Directive => of::<Directive>(recorded, directive, News::Directive),
        Topic::Scan => of::<Scan>(recorded, directive, News::Scan),
        Topic::Pose => of::<Pose>(recorded, directive, News::Pose),
        Topic::Obstacles => of::<Obstacles>(recorded, directive, News::Obstacles),
        Topic::Command => of::<shared_types::Command>(recorded, directive, News::Command),
        Topic::Truth => of::<Truth>(recorded, directive, News::Truth),
        Topic::Actuation => of::<Actuation>(recorded, directive, News::Actuation),
        _ => None,
    };
    if let Some(news) = news {
        scene.take(news, events, now_s);
    }
    news.is_some()
}

/// The header of a recorded sample.
fn header<'a>(recorded: &Recorded<'a>) -> &'a Header {
    (recorded.topic.sample_type().header)(recorded.bytes)
}
