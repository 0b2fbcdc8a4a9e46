//! What a process prints, in a file that stays small.
//!
//! A process writes straight into the file, never into a pipe, so its output neither blocks it nor kills it when
//! the orchestrator is gone. The file is opened for appending and shared with the process; each `write` of the
//! process lands at the end, also after the file was cut. [`ChildLog::trim`] keeps the last part in the same file,
//! without any part of the process in it. One thread of this program trims all logs that are open, so no user of a log
//! has to think of it.
//!
//! Where this fails: the file is longer by what is written between two looks of the thread, and a line that is written in
//! the few microseconds between the last read of the end and the cut is lost. A rotation by renaming would lose
//! nothing, but the process would still write into the old file.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{FileExt, FileTypeExt};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, Once, PoisonError, Weak};

use anyhow::Context;
use console::exit::Failure;
use console::new_file::{make_folder, open_log};
use console::user_file::read_start;
use runtime::wait_for;

/// A longer file is trimmed [bytes]: the output of a day of lifecycle lines, and nothing to a disk or a tmpfs.
pub const TRIM_ABOVE_BYTES: u64 = 1 << 20;

/// How much of the end is kept [bytes]: about a thousand lines, more than a user reads of a dead process.
pub const KEEP_BYTES: u64 = 64 << 10;

/// Time between two looks at the length of all logs: a process that does nothing but print writes some MiB in it [ns].
const LOOK_NS: u64 = 10_000_000;

/// The logs that are trimmed.
static OPEN: Mutex<Vec<Weak<ChildLog>>> = Mutex::new(Vec::new());

/// Longest line that [`ChildLog::last_lines`] gives [characters]; the file keeps the whole line.
const MAX_LINE: usize = 400;

/// Stack of the thread, which holds one piece of a log [bytes].
const STACK: usize = 256 << 10;

/// A log is known by so much of its start [bytes].
const LOG_START: u64 = 64;

/// Starts the line that separates two incarnations in the file.
const MARK: &str = "=== scanloop: ";

/// Around the number of bytes in the line that stands for what was cut off.
const DROPPED_START: &str = "=== ";
const DROPPED_END: &str = " bytes dropped";

/// The output of the processes of one role, one after the other.
#[derive(Debug)]
pub struct ChildLog {
    path: PathBuf,
    /// Shared with the process: each write goes to the end.
    append: File,
    /// Writes at any place, for trimming; held while the file is cut or its end is read.
    edit: Mutex<File>,
}

impl ChildLog {
    /// Opens the file, creating it and its folder where they are missing; what it holds stays. The file is trimmed as
    /// long as the log is in use here.
    ///
    /// # Errors
    /// Those of the file system, and a thread that can't be started.
    pub fn open(path: &Path) -> io::Result<Arc<Self>> {
        let log = Arc::new(Self::open_untrimmed(path)?);
        trim_while_in_use(&log)?;
        Ok(log)
    }

    fn open_untrimmed(path: &Path) -> io::Result<Self> {
        if let Some(folder) = path.parent() {
            make_folder(folder)?;
        }
        let append = open_log(path, OpenOptions::new().create(true).append(true).read(true))?;
        let edit = Mutex::new(open_log(path, OpenOptions::new().write(true))?);
        Ok(Self { path: path.to_owned(), append, edit })
    }

    /// The log of a run: one that continues the file, or one that begins it anew. A file that is no log of a run is left
    /// as it is.
    ///
    /// # Errors
    /// A file of somebody else, exit code 2, and those of the file system.
    pub fn of_run(path: &Path, continues: bool) -> anyhow::Result<Arc<Self>> {
        let name = path.display();
        path.parent().map_or(Ok(()), make_folder).with_context(|| name.to_string())?;
        // A link in the place of the log is removed, whatever it leads to; one to a device is a choice of the user.
        if path.is_symlink() && !path.metadata().is_ok_and(|target| target.file_type().is_char_device()) {
            std::fs::remove_file(path).with_context(|| name.to_string())?;
        }
        let refused = || {
            let text =
                format!("{name}: the file is no log of a run, and is left as it is; name another --out");
            Failure::bad_input(text)
        };
        // A process that writes into a pipe blocks when it is full.
        if !continues && path.metadata().is_ok_and(|found| found.file_type().is_fifo()) {
            return Err(refused());
        }
        if let Ok(start) = read_start(path, LOG_START) {
            if !start.is_empty() && !is_log(&start) {
                return Err(refused());
            }
            if !continues {
                std::fs::remove_file(path).with_context(|| name.to_string())?;
            }
        }
        Self::open(path).with_context(|| name.to_string())
    }

    /// Where the file is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A file to be handed to a process as its output.
    ///
    /// # Errors
    /// When there are too many open files.
    pub fn output(&self) -> io::Result<File> {
        self.append.try_clone()
    }

    /// Writes a line that separates a new incarnation, described by `text`, from what stands before.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn begin(&self, text: &str) -> io::Result<()> {
        let _not_cut = self.edit();
        let length = self.append.metadata()?.len();
        let mut last = [b'\n'];
        if length > 0 {
            self.append.read_exact_at(&mut last, length - 1)?;
        }
        let end_of_line = if last == [b'\n'] { "" } else { "\n" };
        (&self.append).write_all(format!("{end_of_line}{MARK}{text}\n").as_bytes())
    }

    /// Cuts the file to its last 64 KiB when it is longer than 1 MiB; returns whether it did.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn trim(&self) -> io::Result<bool> {
        let edit = self.edit();
        let length = self.append.metadata()?.len();
        if length <= TRIM_ABOVE_BYTES {
            return Ok(false);
        }
        let mut tail = self.read(length - KEEP_BYTES, KEEP_BYTES)?;
        let line = tail.iter().position(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        let dropped = length - KEEP_BYTES + line as u64;
        tail.drain(..line);
        let notice = format!("{DROPPED_START}{dropped}{DROPPED_END}\n");
        edit.write_all_at(notice.as_bytes(), 0)?;
        edit.write_all_at(&tail, notice.len() as u64)?;
        let mut end = (notice.len() + tail.len()) as u64;
        // Append what was written meanwhile; a process that writes faster than this loses some lines.
        let mut seen = length;
        for _ in 0..4 {
            let added = self.read(seen, KEEP_BYTES)?;
            if added.is_empty() {
                break;
            }
            edit.write_all_at(&added, end)?;
            seen += added.len() as u64;
            end += added.len() as u64;
        }
        edit.set_len(end)?;
        Ok(true)
    }

    /// The last `count` lines of the latest incarnation, without control characters.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn last_lines(&self, count: usize) -> io::Result<Vec<String>> {
        let _not_cut = self.edit();
        let length = self.append.metadata()?.len();
        let start = length.saturating_sub(KEEP_BYTES);
        let tail = self.read(start, KEEP_BYTES)?;
        let text = String::from_utf8_lossy(&tail);
        let text = match text.split_once('\n') {
            Some((_partial, rest)) if start > 0 => rest,
            _ => &text,
        };
        let mut lines: Vec<String> = text
            .lines()
            .rev()
            .take_while(|line| !line.starts_with(MARK))
            .take(count)
            .map(printable)
            .collect();
        lines.reverse();
        Ok(lines)
    }

    /// The last three lines, to be appended to a reason; empty where there are none.
    pub fn last_lines_suffix(&self) -> String {
        match self.last_lines(3) {
            Ok(lines) if !lines.is_empty() => format!("; its last log lines: {}", lines.join(" | ")),
            _ => String::new(),
        }
    }

    fn edit(&self) -> MutexGuard<'_, File> {
        self.edit.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// At most `count` bytes from `offset` on, fewer at the end of the file.
    fn read(&self, offset: u64, count: u64) -> io::Result<Vec<u8>> {
        let mut bytes = vec![0; count as usize];
        let mut filled = 0;
        while filled < bytes.len() {
            match self.append.read_at(&mut bytes[filled..], offset + filled as u64) {
                Ok(0) => break,
                Ok(more) => filled += more,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        bytes.truncate(filled);
        Ok(bytes)
    }
}

/// Has the thread trim a log until nothing else uses it.
fn trim_while_in_use(log: &Arc<ChildLog>) -> io::Result<()> {
    static START: Once = Once::new();
    let mut started = Ok(());
    START.call_once(|| {
        let thread = std::thread::Builder::new().name("logs-trim".to_owned()).stack_size(STACK);
        started = thread.spawn(trim_all).map(|_| ());
    });
    open_logs().push(Arc::downgrade(log));
    started
}

/// Trims all logs in use, for ever. A log on a disk that is full or stands still is tried again.
fn trim_all() {
    loop {
        wait_for(&[], LOOK_NS);
        let logs: Vec<Arc<ChildLog>> = {
            let mut logs = open_logs();
            logs.retain(|log| log.strong_count() > 0);
            logs.iter().filter_map(Weak::upgrade).collect()
        };
        logs.iter().for_each(|log| _ = log.trim());
    }
}

fn open_logs() -> MutexGuard<'static, Vec<Weak<ChildLog>>> {
    OPEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A line without what could move the cursor or colour the terminal, and not too long.
fn printable(line: &str) -> String {
    let line = runtime::printable(line);
    let mut clean: String = line.chars().take(MAX_LINE).collect();
    if line.chars().nth(MAX_LINE).is_some() {
        clean.push_str("...");
    }
    clean
}

/// Whether a file that begins so is a log of a run.
fn is_log(start: &[u8]) -> bool {
    let start = String::from_utf8_lossy(start);
    let line = start.lines().next().unwrap_or_default();
    let dropped = line.strip_prefix(DROPPED_START).and_then(|line| line.strip_suffix(DROPPED_END));
    line.starts_with(MARK) || dropped.is_some_and(|number| number.parse::<u64>().is_ok())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};

    /// A folder of its own for one test, removed at its end.
    pub(crate) struct Scratch(pub PathBuf);

    impl Scratch {
        pub(crate) fn new() -> Self {
            static COUNT: AtomicU32 = AtomicU32::new(0);
            let name =
                format!("scanloop-child-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
            Self(std::env::temp_dir().join(name))
        }

        pub(crate) fn log(&self) -> ChildLog {
            ChildLog::open_untrimmed(&self.0.join("log/process.log")).unwrap()
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    fn write(log: &ChildLog, text: &str) {
        (&log.append).write_all(text.as_bytes()).unwrap();
    }

    #[test]
    fn the_last_lines_are_those_of_the_latest_incarnation() {
        let scratch = Scratch::new();
        let log = scratch.log();
        assert_eq!(log.last_lines(3).unwrap(), Vec::<String>::new());
        log.begin("incarnation 1").unwrap();
        write(&log, "one\ntwo\nthree\nfour");
        assert_eq!(log.last_lines(2).unwrap(), ["three", "four"]);
        log.begin("incarnation 2").unwrap();
        assert_eq!(log.last_lines(2).unwrap(), Vec::<String>::new(), "it has written nothing yet");
        write(&log, "five\n");
        assert_eq!(log.last_lines(2).unwrap(), ["five"]);
        let whole = std::fs::read_to_string(log.path()).unwrap();
        assert!(whole.contains("four\n=== scanloop: incarnation 2\n"), "{whole}");
    }

    #[test]
    fn lines_for_the_terminal_carry_no_control_characters() {
        let scratch = Scratch::new();
        let log = scratch.log();
        (&log.append).write_all(b"\x1b[31mred\x07\tand \xff bad\r\n").unwrap();
        assert_eq!(log.last_lines(1).unwrap(), ["\\u001b[31mred\\u0007\tand \u{fffd} bad"]);
        write(&log, &format!("{}\n", "x".repeat(1000)));
        assert_eq!(log.last_lines(1).unwrap()[0].len(), MAX_LINE + 3);
    }

    #[test]
    fn a_short_file_is_left_alone() {
        let scratch = Scratch::new();
        let log = scratch.log();
        write(&log, &"y".repeat(TRIM_ABOVE_BYTES as usize));
        assert!(!log.trim().unwrap());
        assert_eq!(log.append.metadata().unwrap().len(), TRIM_ABOVE_BYTES);
    }

    #[test]
    fn a_long_file_keeps_its_last_whole_lines_and_can_be_appended_to() {
        let scratch = Scratch::new();
        let log = scratch.log();
        let other_end = log.output().unwrap();
        // 140,000 lines of 8 bytes are 1,120,000 bytes, more than 1,048,576.
        let text: String = (0..140_000).map(|number| format!("{number:07}\n")).collect();
        write(&log, &text);
        assert!(log.trim().unwrap());
        (&other_end).write_all(b"after\n").unwrap();
        let kept = std::fs::read_to_string(log.path()).unwrap();
        let lines: Vec<&str> = kept.lines().collect();
        // The cut lies on a line's border, of which the first line is dropped as if it were partial: 8191 stay.
        assert_eq!(lines[0], "=== 1054472 bytes dropped");
        assert_eq!((lines[1], lines[8191], lines[8192]), ("0131809", "0139999", "after"));
        assert_eq!(lines.len(), 8193);
        assert!(!log.trim().unwrap(), "it is short now");
    }

    #[test]
    fn a_log_in_use_is_bounded_while_it_grows() {
        let scratch = Scratch::new();
        let log = ChildLog::open(&scratch.0.join("log/process.log")).unwrap();
        let text = "x".repeat(99) + "\n";
        let deadline = std::time::Instant::now() + std::time::Duration::from_secs(20);
        // 200 MiB in all, at the speed at which the thread can follow.
        for piece in 0..200 {
            write(&log, &text.repeat(10_486));
            while log.append.metadata().unwrap().len() > TRIM_ABOVE_BYTES {
                assert!(std::time::Instant::now() < deadline, "not trimmed after piece {piece}");
                wait_for(&[], 1_000_000);
            }
        }
        assert!(log.last_lines(1).unwrap()[0].starts_with("xxx"));
    }

    #[test]
    fn a_file_that_was_deleted_is_still_bounded() {
        let scratch = Scratch::new();
        let log = scratch.log();
        std::fs::remove_file(log.path()).unwrap();
        write(&log, &"z\n".repeat(TRIM_ABOVE_BYTES as usize));
        assert!(log.trim().unwrap());
        assert!(log.append.metadata().unwrap().len() <= KEEP_BYTES + 100);
    }

    #[test]
    fn a_log_of_an_earlier_run_is_replaced_and_any_other_file_is_left() {
        let scratch = Scratch::new();
        let path = scratch.0.join("robot.log");
        std::fs::create_dir_all(&scratch.0).unwrap();
        for earlier in
            ["", "=== scanloop: robot incarnation 1: emulator\nline\n", "=== 812 bytes dropped\nline\n"]
        {
            std::fs::write(&path, earlier).unwrap();
            ChildLog::of_run(&path, false).unwrap();
            assert_eq!(std::fs::read(&path).unwrap(), b"", "{earlier}");
        }
        std::fs::write(&path, "2026-11-26 my own robot\n").unwrap();
        for continues in [false, true] {
            let refused = ChildLog::of_run(&path, continues).unwrap_err().to_string();
            assert!(refused.contains("robot.log: the file is no log of a run"), "{refused}");
            assert_eq!(std::fs::read(&path).unwrap(), b"2026-11-26 my own robot\n");
        }
    }

    #[test]
    fn a_pipe_blocks_no_start_and_no_adoption() {
        let scratch = Scratch::new();
        std::fs::create_dir_all(&scratch.0).unwrap();
        let path = scratch.0.join("robot.log");
        rustix::fs::mkfifoat(rustix::fs::CWD, &path, rustix::fs::Mode::RWXU).unwrap();
        let refused = ChildLog::of_run(&path, false).unwrap_err().to_string();
        assert!(refused.contains("robot.log: the file is no log of a run"), "{refused}");
        ChildLog::of_run(&path, true).unwrap().begin("incarnation 1").unwrap();
        assert!(path.symlink_metadata().unwrap().file_type().is_fifo());
    }

    #[test]
    fn a_link_to_a_device_stays_and_is_written_to() {
        let scratch = Scratch::new();
        std::fs::create_dir_all(&scratch.0).unwrap();
        let path = scratch.0.join("robot.log");
        std::os::unix::fs::symlink("/dev/null", &path).unwrap();
        for continues in [false, true] {
            ChildLog::of_run(&path, continues).unwrap().begin("incarnation 1").unwrap();
            assert_eq!(path.read_link().unwrap(), Path::new("/dev/null"));
        }
    }
}
