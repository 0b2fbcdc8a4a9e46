//! From the thread that copies samples to the one that writes them, or keeps them in memory.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SendError, Sender, SyncSender, TrySendError, channel, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use bytemuck::cast_slice;
use runtime::monotonic_ns;
use shared_types::{Header, TOPICS};

use super::Summary;
use super::ring::Ring;
use crate::mcap::Writer;
use crate::tape::{Tape, TapeTarget};

/// How many batches may wait for the disk: at 100 a second, five seconds.
const BATCHES: usize = 512;
/// Batches that wait for the disk hold no more than this, and one batch more [bytes].
const MAX_BYTES: usize = 64 << 20;
/// In lock-step, the one that copies checks this often whether there is room again.
const ROOM_POLL: Duration = Duration::from_millis(1);
/// Of the lines that wait for room in the queue, so many are kept.
const MAX_LINES: usize = 4096;
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
    /// Somebody asks for what the ring holds.
    is_asked: bool,
    /// Samples lost until now.
    lost: u64,
    /// The last scan of the run, in the last batch.
    last_scan: Option<u64>,
}

impl Batch {
    fn is_empty(&self) -> bool {
        let is_order = self.incident.is_some() || self.is_asked;
        self.samples.is_empty() && self.lines.is_empty() && self.files.is_empty() && !is_order
    }

    /// What it holds [bytes].
    fn bytes(&self) -> usize {
        let files = self.files.iter().map(|(name, data)| name.len() + data.len());
        let lines = self.lines.iter().map(|(role, line)| role.len() + line.len());
        size_of_val(&*self.words) + files.chain(lines).sum::<usize>()
    }

    /// Of a batch that could not be passed on, what is not lost: all but the samples, and but the newest of many lines.
    fn without_samples(mut self) -> Self {
        if self.lines.len() > MAX_LINES {
            self.lines.truncate(MAX_LINES - 1);
            let text = "WARN lines of logs are missing here: the disk was too slow";
            self.lines.push(("recorder".to_owned(), text.to_owned()));
        }
        let Self { files, lines, incident, is_asked, .. } = self;
        Self { files, lines, incident, is_asked, ..Self::default() }
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
    /// What the batches hold that the writing thread has not yet written [bytes].
    waiting: Arc<AtomicUsize>,
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
        let waiting = Arc::new(AtomicUsize::new(0));
        let batches = Batches { receiver, waiting: Arc::clone(&waiting) };
        // Log lines may come before the first sample.
        let now_ns = if simulated { 0 } else { monotonic_ns() };
        let thread = std::thread::Builder::new().name("recording".to_owned()).spawn(move || match sink {
            Sink::File(writer) => write(Tape::new(writer, simulated, now_ns), &batches, &has_failed),
            Sink::Ring(ring) => keep(Tape::new(ring, simulated, now_ns), &batches, &reports),
        })?;
        let batch = Batch::default();
        Ok(Self { batch, sender, waiting, thread, saved, failed, waits, passed_ns: 0, lost: 0 })
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

    /// Somebody asks for what a ring holds.
    pub(super) fn keep(&mut self) {
        self.batch.is_asked = true;
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
        if let Some(batch) = self.send(batch) {
            self.lost += samples;
            self.batch = batch.without_samples();
        }
    }

    /// Hands a batch to the writing thread; returns it when the queue is full, or the thread has ended.
    fn send(&self, batch: Batch) -> Option<Batch> {
        let bytes = batch.bytes();
        let is_full = || {
            let waiting = self.waiting.load(Ordering::Relaxed);
            waiting > 0 && waiting + bytes > MAX_BYTES
        };
        while self.waits && is_full() && !self.thread.is_finished() {
            std::thread::sleep(ROOM_POLL);
        }
        if !self.waits && is_full() {
            return Some(batch);
        }
        self.waiting.fetch_add(bytes, Ordering::Relaxed);
        let left = match self.waits {
            true => self.sender.send(batch).err().map(|SendError(batch)| batch),
            false => self.sender.try_send(batch).err().map(|error| match error {
                TrySendError::Full(batch) | TrySendError::Disconnected(batch) => batch,
            }),
        };
        left.inspect(|_| _ = self.waiting.fetch_sub(bytes, Ordering::Relaxed))
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
        let Self { batch, sender, waiting, thread, saved, lost, .. } = self;
        waiting.fetch_add(batch.bytes(), Ordering::Relaxed);
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

/// The end at which the writing thread takes them out.
struct Batches {
    receiver: Receiver<Batch>,
    waiting: Arc<AtomicUsize>,
}

impl Batches {
    /// Passes each batch to `take` until the queue is closed.
    fn each(&self, mut take: impl FnMut(&Batch)) {
        for batch in &self.receiver {
            let bytes = batch.bytes();
            take(&batch);
            drop(batch);
            self.waiting.fetch_sub(bytes, Ordering::Relaxed);
        }
    }
}

/// Puts a batch on a tape, up to the first error.
fn put<T: TapeTarget>(tape: &mut Tape<T>, batch: &Batch) -> io::Result<()> {
    tape.begin_batch(monotonic_ns());
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
fn write(mut tape: Tape<Writer<BufWriter<File>>>, batches: &Batches, failed: &AtomicBool) -> Written {
    let mut written = Written::default();
    let (mut lost, mut last_scan) = (0, 0);
    batches.each(|batch| {
        (lost, last_scan) = (batch.lost, batch.last_scan.unwrap_or(0));
        written.samples += batch.samples.len() as u64;
        if written.error.is_none() {
            written.error = put(&mut tape, batch).err();
            failed.store(written.error.is_some(), Ordering::Relaxed);
        }
    });
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
fn keep(mut tape: Tape<Ring>, batches: &Batches, reports: &Sender<Saved>) -> Written {
    let mut written = Written::default();
    let save = |tape: &mut Tape<Ring>, scan_id| {
        if let Some(saved) = tape.target().save(scan_id).map_err(|error| error.to_string()).transpose() {
            let _ = reports.send(saved);
        }
    };
    let mut following: Option<Following> = None;
    batches.each(|batch| {
        tape.target().set_lost(batch.lost);
        written.samples += batch.samples.len() as u64;
        let is_asked = batch.is_asked;
        written.error = put(&mut tape, batch).err();
        if is_asked && let Err(error) = tape.target().save_asked() {
            let _ = reports.send(Err(error.to_string()));
        }
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
    });
    if let Some(following) = following {
        save(&mut tape, following.scan_id);
    }
    written
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A queue of which nothing is taken out, and its other end.
    fn queue() -> (Queue, Batches) {
        let (sender, receiver) = sync_channel(BATCHES);
        let (waiting, failed) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicBool::new(false)));
        let batches = Batches { receiver, waiting: Arc::clone(&waiting) };
        let (thread, saved) = (std::thread::spawn(Written::default), channel().1);
        let batch = Batch::default();
        (
            Queue { batch, sender, waiting, thread, saved, failed, waits: false, passed_ns: 0, lost: 0 },
            batches,
        )
    }

    #[test]
    fn a_queue_is_full_with_few_large_samples_and_keeps_files_and_lines() {
        let (mut queue, batches) = queue();
        let sample = vec![0; 4 << 20];
        for poll in 1..=20 {
            queue.add(TOPICS.len(), &sample);
            queue.attach(format!("settings-{poll}.toml"), vec![1]);
            queue.log("robot", "line");
            queue.incident(poll);
            queue.pass_on(poll * BATCH_NS, 0);
        }
        assert!(queue.waiting.load(Ordering::Relaxed) <= MAX_BYTES);
        let sent = 15;
        assert_eq!((queue.lost, queue.batch.files.len(), queue.batch.lines.len()), (20 - sent, 5, 5));
        assert_eq!((queue.batch.samples.len(), queue.batch.incident), (0, Some(16)));
        for _ in 0..2 * MAX_LINES {
            queue.log("robot", "line");
        }
        queue.batch.incident = None;
        queue.add(TOPICS.len(), &sample);
        queue.pass_on(30 * BATCH_NS, 0);
        assert_eq!(queue.batch.lines.len(), MAX_LINES);
        // There is room again, then the writing thread ends.
        let taken = batches.receiver.try_iter().map(|batch| batch.bytes()).sum();
        queue.waiting.fetch_sub(taken, Ordering::Relaxed);
        assert_eq!(queue.waiting.load(Ordering::Relaxed), 0);
        queue.pass_on(40 * BATCH_NS, 0);
        assert!(queue.batch.is_empty());
        drop(batches);
        queue.attach("settings-21.toml".to_owned(), vec![1]);
        queue.pass_on(50 * BATCH_NS, 0);
        assert_eq!(queue.batch.files.len(), 1);
    }
}
