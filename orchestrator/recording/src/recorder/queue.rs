//! From the thread that copies samples to the one that writes them.

use std::fs::File;
use std::io::{self, BufWriter};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use bytemuck::cast_slice;
use shared_types::Topic;

use super::Summary;
use crate::tape::Tape;

/// How many batches may wait for the disk: at 100 a second and 10 scans a second, five seconds.
const BATCHES: usize = 512;

/// What was copied in one poll.
#[derive(Debug, Default)]
struct Batch {
    /// Topic, and the end of the sample in `words`.
    samples: Vec<(Topic, usize)>,
    /// Samples one after the other; eight bytes each, as samples are aligned.
    words: Vec<u64>,
    /// Role and line.
    lines: Vec<(String, String)>,
    /// Name and content of files.
    files: Vec<(String, Vec<u8>)>,
    /// Samples lost and the last scan of the run: in the last batch.
    end: Option<(u64, u64)>,
}

/// The end at which samples are put in.
pub(super) struct Queue {
    batch: Batch,
    sender: SyncSender<Batch>,
    thread: JoinHandle<Written>,
    failed: Arc<AtomicBool>,
    waits: bool,
    lost: u64,
}

/// What the writing thread has done.
struct Written {
    samples: u64,
    lost: u64,
    bytes: u64,
    error: Option<io::Error>,
}

impl Queue {
    /// Starts the writing thread. If it `waits`, a full queue holds up the one that copies.
    pub(super) fn start(tape: Tape<BufWriter<File>>, waits: bool) -> io::Result<Self> {
        let (sender, receiver) = sync_channel(BATCHES);
        let failed = Arc::new(AtomicBool::new(false));
        let has_failed = Arc::clone(&failed);
        let thread = std::thread::Builder::new()
            .name("recording".to_owned())
            .spawn(move || write(tape, &receiver, &has_failed))?;
        Ok(Self { batch: Batch::default(), sender, thread, failed, waits, lost: 0 })
    }

    /// Adds a sample.
    pub(super) fn add(&mut self, topic: Topic, bytes: &[u8]) {
        let start = self.batch.words.len();
        self.batch.words.resize(start + bytes.len().div_ceil(8), 0);
        let place = bytemuck::cast_slice_mut::<u64, u8>(&mut self.batch.words[start..]);
        place[..bytes.len()].copy_from_slice(bytes);
        self.batch.samples.push((topic, self.batch.words.len()));
    }

    /// Adds a line of a log.
    pub(super) fn log(&mut self, role: &str, line: &str) {
        self.batch.lines.push((role.to_owned(), line.to_owned()));
    }

    /// Adds a file.
    pub(super) fn attach(&mut self, name: String, data: Vec<u8>) {
        self.batch.files.push((name, data));
    }

    /// Hands what was added to the writing thread.
    pub(super) fn pass_on(&mut self) {
        let batch = std::mem::take(&mut self.batch);
        let samples = batch.samples.len() as u64;
        if samples == 0 && batch.lines.is_empty() && batch.files.is_empty() {
            return;
        }
        let is_sent = match self.waits {
            true => self.sender.send(batch).is_ok(),
            false => self.sender.try_send(batch).is_ok(),
        };
        self.lost += if is_sent { 0 } else { samples };
    }

    /// Whether nothing can be written any more.
    pub(super) fn has_failed(&self) -> bool {
        self.failed.load(Ordering::Relaxed)
    }

    /// Ends the recording; `missed` samples did not even reach this queue, and `last_scan` is the last of the run.
    pub(super) fn finish(self, missed: u64, last_scan: u64) -> Summary {
        let Self { sender, thread, lost, .. } = self;
        let _ = sender.send(Batch { end: Some((missed + lost, last_scan)), ..Batch::default() });
        drop(sender);
        let error = Some(io::Error::other("the writing thread ended"));
        let written = thread.join().unwrap_or(Written { samples: 0, lost: 0, bytes: 0, error });
        Summary {
            bytes: written.bytes,
            samples: written.samples,
            lost: missed + lost + written.lost,
            error: written.error.map_or_else(String::new, |error| error.to_string()),
            ..Summary::default()
        }
    }
}

fn write(mut tape: Tape<BufWriter<File>>, receiver: &Receiver<Batch>, failed: &AtomicBool) -> Written {
    let mut written = Written { samples: 0, lost: 0, bytes: 0, error: None };
    let mut end = (0, 0);
    for batch in receiver {
        let mut start = 0;
        end = batch.end.unwrap_or(end);
        for (topic, end) in batch.samples {
            let bytes = &cast_slice::<u64, u8>(&batch.words[start..end])[..topic.size()];
            start = end;
            let result = if written.error.is_none() { tape.sample(topic, bytes) } else { Ok(()) };
            match result {
                Ok(()) if written.error.is_none() => written.samples += 1,
                result => {
                    written.lost += 1;
                    written.error = written.error.or(result.err());
                    failed.store(true, Ordering::Relaxed);
                }
            }
        }
        for (name, data) in &batch.files {
            if written.error.is_none() {
                written.error = tape.attach(name, data).err();
            }
        }
        for (role, line) in &batch.lines {
            if written.error.is_none() {
                written.error = tape.log(role, line).err();
            }
        }
    }
    written.bytes = tape.bytes();
    if written.error.is_none() {
        let (lost, last_scan) = end;
        let counts = [("samples", written.samples), ("lost", lost), ("last_scan", last_scan)];
        let counts = counts.map(|(key, count)| (key.to_owned(), count.to_string()));
        let ended = tape.describe("end", &counts).and_then(|()| tape.finish());
        match ended {
            Ok(length) => written.bytes = length,
            Err(error) => written.error = Some(error),
        }
    }
    written
}
