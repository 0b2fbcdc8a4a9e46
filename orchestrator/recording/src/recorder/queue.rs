//! From the thread that copies samples to the one that writes them, or keeps them in memory.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;

use bytemuck::cast_slice;
use runtime::monotonic_ns;
use shared_types::{Header, TOPICS};

use super::Summary;
use super::ring::Ring;
use crate::mcap::Writer;
use crate::tape::{Tape, Target};

/// How many batches may wait for the disk: at 100 a second, five seconds.
const BATCHES: usize = 512;
/// In real time, batches are passed on this often at most, whatever the scan rate [ns].
const BATCH_NS: u64 = 10_000_000;
/// What follows an incident within this time is part of it: its file is written at once, and again with that [ns].
const FOLLOWING_NS: u64 = 2_000_000_000;

/// What was copied in one poll.
#[derive(Debug, Default)]
struct Batch {
    /// Topic, length [bytes], and the end of the sample in `words`. The topics of the system follow those of the loop.
    samples: Vec<(usize, usize, usize)>,
    /// Samples one after the other; eight bytes each, as samples are aligned.
    words: Vec<u64>,
    /// Role and line.
    lines: Vec<(String, String)>,
    /// Name and content of files.
    files: Vec<(String, Vec<u8>)>,
    /// The scan at which something happened: the ring is to be written.
    incident: Option<u64>,
    /// Samples lost until now.
    lost: u64,
    /// The last scan of the run, in the last batch.
    last_scan: Option<u64>,
}

impl Batch {
    fn is_empty(&self) -> bool {
        self.samples.is_empty() && self.lines.is_empty() && self.files.is_empty() && self.incident.is_none()
    }

    fn samples(&self) -> impl Iterator<Item = (usize, &[u8])> {
        let mut start = 0;
        self.samples.iter().map(move |(topic, length, end)| {
            let words = &self.words[std::mem::replace(&mut start, *end)..*end];
            (*topic, &cast_slice::<u64, u8>(words)[..*length])
        })
    }
}

/// Where the samples go.
pub(super) enum Sink {
    /// Into a recording.
    File(Writer<BufWriter<File>>),
    /// Into memory, until something happens.
    Ring(Ring),
}

/// A file of an incident that was written, or why not.
pub(super) type Saved = Result<PathBuf, String>;

/// The end at which samples are put in.
pub(super) struct Queue {
    batch: Batch,
    sender: SyncSender<Batch>,
    thread: JoinHandle<Written>,
    saved: Receiver<Saved>,
    failed: Arc<AtomicBool>,
    waits: bool,
    passed_ns: u64,
    lost: u64,
}

/// What the writing thread has done.
#[derive(Debug, Default)]
struct Written {
    samples: u64,
    lost: u64,
    bytes: u64,
    error: Option<io::Error>,
}

impl Queue {
    /// Starts the writing thread. If it `waits`, a full queue holds up the one that copies.
    pub(super) fn start(sink: Sink, simulated: bool, waits: bool) -> io::Result<Self> {
        let (sender, receiver) = sync_channel(BATCHES);
        let (reports, saved) = channel();
        let failed = Arc::new(AtomicBool::new(false));
        let has_failed = Arc::clone(&failed);
        // Log lines may come before the first sample.
        let now_ns = if simulated { 0 } else { monotonic_ns() };
        let thread = std::thread::Builder::new().name("recording".to_owned()).spawn(move || match sink {
            Sink::File(writer) => write(Tape::new(writer, simulated, now_ns), &receiver, &has_failed),
            Sink::Ring(ring) => keep(Tape::new(ring, simulated, now_ns), &receiver, &reports),
        })?;
        Ok(Self { batch: Batch::default(), sender, thread, saved, failed, waits, passed_ns: 0, lost: 0 })
    }

    /// Adds a sample of a topic of the loop, or of one of the system, which are counted behind them.
    pub(super) fn add(&mut self, topic: usize, bytes: &[u8]) {
        let start = self.batch.words.len();
        self.batch.words.resize(start + bytes.len().div_ceil(8), 0);
        let place = bytemuck::cast_slice_mut::<u64, u8>(&mut self.batch.words[start..]);
        place[..bytes.len()].copy_from_slice(bytes);
        self.batch.samples.push((topic, bytes.len(), self.batch.words.len()));
    }

    /// Adds a line of a log.
    pub(super) fn log(&mut self, role: &str, line: &str) {
        self.batch.lines.push((role.to_owned(), line.to_owned()));
    }

    /// Adds a file.
    pub(super) fn attach(&mut self, name: String, data: Vec<u8>) {
        self.batch.files.push((name, data));
    }

    /// Something happened at a scan: a ring is written.
    pub(super) fn incident(&mut self, scan_id: u64) {
        self.batch.incident.get_or_insert(scan_id);
    }

    /// Hands what was added to the writing thread; `missed` samples did not even reach this queue until now.
    pub(super) fn pass_on(&mut self, now_ns: u64, missed: u64) {
        let is_early = !self.waits && now_ns < self.passed_ns + BATCH_NS && self.batch.incident.is_none();
        if is_early || self.batch.is_empty() {
            return;
        }
        self.passed_ns = now_ns;
        let batch = Batch { lost: missed + self.lost, ..std::mem::take(&mut self.batch) };
        let samples = batch.samples.len() as u64;
        let incident = batch.incident;
        let is_sent = match self.waits {
            true => self.sender.send(batch).is_ok(),
            false => self.sender.try_send(batch).is_ok(),
        };
        if !is_sent {
            self.lost += samples;
            self.batch.incident = incident;
        }
    }

    /// Whether nothing can be written any more.
    pub(super) fn has_failed(&self) -> bool {
        self.failed.load(Ordering::Relaxed)
    }

    /// The next file of an incident that was written.
    pub(super) fn saved(&self) -> Option<Saved> {
        self.saved.try_recv().ok()
    }

    /// Ends the recording; `missed` samples did not even reach this queue, and `last_scan` is the last of the run.
    /// Returns also the files that [`Queue::saved`] has not returned.
    pub(super) fn finish(self, missed: u64, last_scan: u64) -> (Summary, Vec<Saved>) {
        let Self { batch, sender, thread, saved, lost, .. } = self;
        let _ = sender.send(Batch { lost: missed + lost, last_scan: Some(last_scan), ..batch });
        drop(sender);
        let error = || Some(io::Error::other("the writing thread ended"));
        let written = thread.join().unwrap_or_else(|_| Written { error: error(), ..Written::default() });
        let summary = Summary {
            bytes: written.bytes,
            samples: written.samples,
            lost: missed + lost + written.lost,
            error: written.error.map_or_else(String::new, |error| error.to_string()),
            ..Summary::default()
        };
        (summary, saved.try_iter().collect())
    }
}

/// Puts a batch on a tape, up to the first error.
fn put<T: Target>(tape: &mut Tape<T>, batch: &Batch) -> io::Result<()> {
    tape.set_clock(monotonic_ns());
    batch.samples().try_for_each(|(topic, bytes)| match TOPICS.get(topic) {
        Some(topic) => tape.sample(*topic, bytes),
        None => {
            let header = bytemuck::pod_read_unaligned(&bytes[..size_of::<Header>()]);
            tape.own_sample(topic - TOPICS.len(), &header, bytes)
        }
    })?;
    batch.files.iter().try_for_each(|(name, data)| tape.attach(name, data))?;
    batch.lines.iter().try_for_each(|(role, line)| tape.log(role, line))
}

/// Writes a recording until the queue is closed; returns what is in it.
fn write(
    mut tape: Tape<Writer<BufWriter<File>>>,
    receiver: &Receiver<Batch>,
    failed: &AtomicBool,
) -> Written {
    let mut written = Written::default();
    let (mut lost, mut last_scan) = (0, 0);
    for batch in receiver {
        (lost, last_scan) = (batch.lost, batch.last_scan.unwrap_or(0));
        written.samples += batch.samples.len() as u64;
        if written.error.is_none() {
            written.error = put(&mut tape, &batch).err();
            failed.store(written.error.is_some(), Ordering::Relaxed);
        }
    }
    let safe = tape.samples();
    let mut writer = tape.into_target();
    written.bytes = writer.bytes();
    if written.error.is_none() {
        let counts = [("samples", written.samples), ("lost", lost), ("last_scan", last_scan)];
        let counts = counts.map(|(key, count)| (key.to_owned(), count.to_string()));
        let ended = writer.end_chunk().and_then(|()| writer.metadata("end", &counts));
        match ended.and_then(|()| writer.finish()) {
            Ok((_, length)) => written.bytes = length,
            Err(error) => written.error = Some(error),
        }
    }
    if written.error.is_some() {
        (written.lost, written.samples) = (written.samples - safe.min(written.samples), safe);
    }
    written
}

/// What belongs to an incident that was written already.
struct Following {
    /// The scan at which it happened.
    scan_id: u64,
    /// Until when something else belongs to it [ns].
    until_ns: u64,
    /// The latest such time: what came before the incident is still in memory then [ns].
    limit_ns: u64,
}

/// Keeps the last seconds in memory until the queue is closed, and writes them when something happens.
fn keep(mut tape: Tape<Ring>, receiver: &Receiver<Batch>, reports: &Sender<Saved>) -> Written {
    let mut written = Written::default();
    let save = |tape: &mut Tape<Ring>, scan_id| {
        if let Some(saved) = tape.target().save(scan_id).map_err(|error| error.to_string()).transpose() {
            let _ = reports.send(saved);
        }
    };
    let mut following: Option<Following> = None;
    for batch in receiver {
        tape.target().set_lost(batch.lost);
        written.samples += batch.samples.len() as u64;
        written.error = put(&mut tape, &batch).err();
        let now_ns = tape.now_ns();
        if let Some(over) = following.take_if(|following| now_ns >= following.until_ns) {
            save(&mut tape, over.scan_id);
        }
        match (&mut following, batch.incident) {
            (Some(following), Some(_)) => {
                following.until_ns = now_ns.saturating_add(FOLLOWING_NS).min(following.limit_ns);
            }
            (None, Some(scan_id)) => {
                save(&mut tape, scan_id);
                let limit_ns = now_ns.saturating_add(tape.target().span_ns() / 2);
                let until_ns = now_ns.saturating_add(FOLLOWING_NS).min(limit_ns);
                following = Some(Following { scan_id, until_ns, limit_ns });
            }
            (_, None) => {}
        }
    }
    if let Some(following) = following {
        save(&mut tape, following.scan_id);
    }
    written
}
