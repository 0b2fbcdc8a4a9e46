//! Output of a process that must never wait for its terminal: standard error, and what a run prints to standard output.
//!
//! Without [`start_terminal`] each text is written at once. After it, texts go into a bounded queue, and a separate
//! thread writes them in their order. So a terminal that is not read, a pipe without a reader and a full disk lose texts, but delay
//! no caller. The thread writes to the descriptor, not through `std::io::stderr`, so that it never holds the lock of
//! that stream. When the queue is full its oldest texts are dropped; the next text that is written gives their
//! number.
//!
//! The live line is one line at the bottom of a terminal that is redrawn. Only the newest one is kept.

use std::collections::VecDeque;
use std::fmt::Write as _;
use std::io::{self, IsTerminal, Write};
use std::ops::RangeInclusive;
use std::os::fd::AsFd;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::termios::tcgetwinsize;

/// Maximum of texts in the queue: minutes of output of a run.
const MAX_TEXTS: usize = 256;
/// Maximum of bytes in the queue.
const MAX_BYTES: usize = 1 << 20;
/// Columns of a terminal whose size is unknown.
const DEFAULT_COLUMNS: usize = 80;
/// Moves to the first column and clears the line.
const CLEAR_LINE: &[u8] = b"\r\x1b[K";
/// A descriptor in non-blocking mode that accepts nothing for this long loses the text.
const BUSY_LIMIT: Timespec = Timespec { tv_sec: 0, tv_nsec: 200_000_000 };

static TERMINAL: OnceLock<Arc<Terminal>> = OnceLock::new();

/// The pending texts, shared with the thread that writes them.
struct Terminal {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    queue: Queue,
    /// The live line, while there is one.
    live: Option<String>,
    /// The terminal does not show this live line yet.
    redraw: bool,
    /// Another process draws on the terminal.
    held: bool,
    /// The thread is in a system call, which may block for ever.
    writing: bool,
}

/// Where a text goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stream {
    /// Standard output.
    Output,
    /// Standard error.
    Error,
}

/// Bytes for one stream.
struct Text {
    stream: Stream,
    bytes: Vec<u8>,
}

/// Texts in their order, at most as many as the limits allow.
#[derive(Default)]
struct Queue {
    texts: VecDeque<Text>,
    bytes: usize,
    lost: u64,
}

impl Queue {
    /// Adds a text; the oldest ones go when there are too many.
    fn push(&mut self, stream: Stream, bytes: Vec<u8>) {
        self.bytes += bytes.len();
        self.texts.push_back(Text { stream, bytes });
        while self.texts.len() > MAX_TEXTS || self.bytes > MAX_BYTES {
            self.bytes -= self.texts.pop_front().map_or(0, |oldest| oldest.bytes.len());
            self.lost += 1;
        }
    }

    /// All texts, those in a row for one stream as one, after a line about those that were lost; and how many texts were
    /// lost or are taken.
    fn take(&mut self) -> (Vec<Text>, u64) {
        let count = self.lost + self.texts.len() as u64;
        let mut taken: Vec<Text> = Vec::new();
        if self.lost > 0 {
            let bytes = format!("({} earlier lines were dropped: this output was not read)\n", self.lost);
            taken.push(Text { stream: Stream::Error, bytes: bytes.into_bytes() });
        }
        for text in self.texts.drain(..) {
            match taken.last_mut() {
                Some(last) if last.stream == text.stream => last.bytes.extend(text.bytes),
                _ => taken.push(text),
            }
        }
        (self.lost, self.bytes) = (0, 0);
        (taken, count)
    }

    fn is_empty(&self) -> bool {
        self.texts.is_empty() && self.lost == 0
    }
}

impl Terminal {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn change(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.lock());
        self.changed.notify_all();
    }

    /// Writes all texts and live lines, as long as the process runs.
    fn serve(&self) {
        let mut drawn = false;
        loop {
            let (texts, count, live) = self.next();
            // A text for standard output, too, may go to the terminal that shows the line.
            let mut written = !drawn || write_now(Stream::Error, CLEAR_LINE);
            for text in &texts {
                written &= write_now(text.stream, &text.bytes);
            }
            drawn = live.is_some();
            if let Some(line) = live {
                let columns = tcgetwinsize(io::stderr()).map_or(0, |size| usize::from(size.ws_col));
                let columns = if columns == 0 { DEFAULT_COLUMNS } else { columns };
                let line: String = line.chars().take(columns).collect();
                written &= write_now(Stream::Error, line.as_bytes());
            }
            self.change(|state| {
                state.writing = false;
                state.queue.lost += if written { 0 } else { count };
            });
        }
    }

    /// Waits for texts or a new live line.
    fn next(&self) -> (Vec<Text>, u64, Option<String>) {
        let idle = |state: &mut State| state.held || state.queue.texts.is_empty() && !state.redraw;
        let mut state = self.changed.wait_while(self.lock(), idle).unwrap_or_else(PoisonError::into_inner);
        (state.redraw, state.writing) = (false, true);
        let (texts, count) = state.queue.take();
        (texts, count, state.live.clone())
    }

    /// Waits until all is written, but not longer than `limit`.
    fn flush(&self, limit: Duration) {
        let deadline = Instant::now() + limit;
        let mut state = self.lock();
        if !state.queue.is_empty() {
            // Lost texts are reported with the next text, so add an empty one.
            state.queue.push(Stream::Error, Vec::new());
            self.changed.notify_all();
        }
        while state.writing || !state.queue.texts.is_empty() || state.redraw {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            let woken = self.changed.wait_timeout(state, left);
            state = woken.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// From now on no call waits for the reader of standard error.
///
/// When the thread can't be started, texts are still written at once.
pub fn start_terminal() {
    if TERMINAL.get().is_some() {
        return;
    }
    let terminal = Arc::new(Terminal { state: Mutex::default(), changed: Condvar::new() });
    let writer = Arc::clone(&terminal);
    let started = std::thread::Builder::new().name("terminal".to_owned()).spawn(move || writer.serve());
    if started.is_ok() {
        let _ = TERMINAL.set(terminal);
    }
}

/// While held, texts stay in the queue because another process draws on the terminal; they are written afterwards. Has
/// no effect before [`start_terminal`].
pub fn hold_terminal(held: bool) {
    if let Some(terminal) = TERMINAL.get() {
        terminal.change(|state| state.held = held);
    }
}

/// Removes the live line and waits until all texts are written, but not longer than `limit`.
///
/// For the end of a process: texts not written by then are lost.
pub fn flush_terminal(limit: Duration) {
    show_live_line(None);
    if let Some(terminal) = TERMINAL.get() {
        terminal.flush(limit);
    }
}

/// Whether standard error is a terminal.
pub fn is_terminal() -> bool {
    io::stderr().is_terminal()
}

/// Shows a line at the bottom of the terminal, or removes it; has no effect before [`start_terminal`].
pub fn show_live_line(line: Option<&str>) {
    if let Some(terminal) = TERMINAL.get() {
        let line = line.map(printable);
        terminal.change(|state| {
            state.redraw |= state.live != line;
            state.live = line;
        });
    }
}

/// Writes whole lines, through the queue once there is one.
pub(crate) fn write(stream: Stream, bytes: Vec<u8>) {
    match TERMINAL.get() {
        Some(terminal) => terminal.change(|state| state.queue.push(stream, bytes)),
        // What can't be written can't be reported either.
        None => _ = write_now(stream, &bytes),
    }
}

/// A text for a terminal: names come from files and from other programs, and control characters could move the cursor,
/// colour the terminal or write to its clipboard; others turn the order of letters round. They are shown as `\u001b`,
/// which in JSON is the same letter. Of an end of line `\r\n` only `\n` stays.
pub fn printable(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for letter in text.chars().filter(|letter| *letter != '\r') {
        if matches!(letter, '\n' | '\t') || !is_of_control(letter) {
            shown.push(letter);
        } else {
            let units = &mut [0; 2];
            letter.encode_utf16(units).iter().for_each(|unit| _ = write!(shown, "\\u{unit:04x}"));
        }
    }
    shown
}

/// [`printable`] for a word within a line: ends of lines and tabs are shown too, so that it makes no lines of its own.
pub fn one_line(word: &str) -> String {
    let shown = |letter: char| match letter {
        '\n' => "\\n".to_owned(),
        '\t' => "\\t".to_owned(),
        letter => letter.to_string(),
    };
    printable(word).chars().map(shown).collect()
}

/// Whether a terminal obeys a letter instead of showing it.
fn is_of_control(letter: char) -> bool {
    /// Marks and overrides of the direction of writing, ends of lines and paragraphs, annotations, tags.
    const UNSEEN: [RangeInclusive<char>; 8] = [
        '\u{61c}'..='\u{61c}',
        '\u{200e}'..='\u{200f}',
        '\u{2028}'..='\u{202e}',
        '\u{2066}'..='\u{206f}',
        '\u{feff}'..='\u{feff}',
        '\u{fff9}'..='\u{fffb}',
        '\u{1d173}'..='\u{1d17a}',
        '\u{e0000}'..='\u{e007f}',
    ];
    letter.is_control() || UNSEEN.iter().any(|range| range.contains(&letter))
}

/// Writes to a stream; false when some of it could not be written.
fn write_now(stream: Stream, mut bytes: &[u8]) -> bool {
    let (output, error) = (io::stdout(), io::stderr());
    let descriptor = match stream {
        Stream::Output => output.as_fd(),
        Stream::Error => error.as_fd(),
    };
    while !bytes.is_empty() {
        match rustix::io::write(descriptor, bytes) {
            Ok(0) => return false,
            Ok(count) => bytes = &bytes[count..],
            Err(Errno::INTR) => {}
            Err(Errno::AGAIN) => {
                let ready = poll(&mut [PollFd::new(&descriptor, PollFlags::OUT)], Some(&BUSY_LIMIT));
                if !matches!(ready, Ok(1..) | Err(Errno::INTR)) {
                    return false;
                }
            }
            Err(_) => return false,
        }
    }
    true
}

/// A line of a log; the subscriber hands over one whole event at a time.
pub(crate) struct LogLine {
    /// Text before the line.
    pub(crate) prefix: String,
}

impl Write for LogLine {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let text = self.prefix.clone() + &printable(&String::from_utf8_lossy(bytes));
        write(Stream::Error, text.into_bytes());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_queue_drops_its_oldest_texts_and_counts_them() {
        let mut queue = Queue::default();
        (0..MAX_TEXTS + 3).for_each(|number| queue.push(Stream::Error, format!("{number}\n").into_bytes()));
        let (mut texts, count) = queue.take();
        assert_eq!(texts.len(), 1, "one write for texts of one stream");
        let text = String::from_utf8(texts.remove(0).bytes).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "(3 earlier lines were dropped: this output was not read)");
        assert_eq!((lines[1], lines.len() as u64), ("3", count - 2));
        assert!(queue.is_empty());
    }

    #[test]
    fn texts_of_both_streams_keep_their_order() {
        let mut queue = Queue::default();
        for (stream, text) in
            [(Stream::Error, "a"), (Stream::Output, "b"), (Stream::Output, "c"), (Stream::Error, "d")]
        {
            queue.push(stream, text.into());
        }
        let (texts, count) = queue.take();
        let texts: Vec<_> = texts.iter().map(|text| (text.stream, text.bytes.as_slice())).collect();
        assert_eq!(texts, [(Stream::Error, &b"a"[..]), (Stream::Output, b"bc"), (Stream::Error, b"d")]);
        assert_eq!(count, 4);
    }

    #[test]
    fn the_bytes_in_the_queue_are_bounded() {
        let mut queue = Queue::default();
        (0..20).for_each(|_| queue.push(Stream::Output, vec![b'x'; MAX_BYTES / 4]));
        assert_eq!((queue.texts.len(), queue.bytes, queue.lost), (4, MAX_BYTES, 16));
        queue.push(Stream::Error, vec![b'x'; 2 * MAX_BYTES]);
        assert_eq!((queue.texts.len(), queue.bytes), (0, 0));
    }

    #[test]
    fn escape_sequences_lose_what_makes_them_work() {
        let shown = "a\\u001b[31mred\\u0007\\u009b2J\n\tb\\u007f";
        assert_eq!(printable("a\x1b[31mred\x07\u{9b}2J\r\n\tb\u{7f}"), shown);
        assert_eq!(printable("\u{202e}fdp.exe \u{e0041}"), "\\u202efdp.exe \\udb40\\udc41");
        assert_eq!(one_line("scan\n   99 pose\t"), "scan\\n   99 pose\\t");
        assert_eq!(printable("goal 1.0 m  rob\u{25cf} \u{e4}"), "goal 1.0 m  rob\u{25cf} \u{e4}");
    }
}
