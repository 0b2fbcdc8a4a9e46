//! Files that a user names on the command line: regular ones of a limited size.

mod table;

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use rustix::fs::OFlags;
use rustix::io::Errno;

/// Largest scenario, system or calibration: a hundred times the largest one shipped [bytes].
pub const TEXT_BYTES: u64 = 1 << 20;
/// Largest file of recorded or measured data [bytes].
pub const DATA_BYTES: u64 = 1 << 28;

/// How files that are no text of ours begin, and what they are.
const KINDS: [(&[u8], &str); 18] = [
    (b"PK\x03\x04", "a ZIP archive, as a workbook of a spreadsheet is"),
    (b"\xd0\xcf\x11\xe0", "a document of an office program"),
    (b"{\\rtf", "a document in RTF"),
    (b"%PDF", "a PDF"),
    (b"<!", "HTML or XML"),
    (b"<?xml", "HTML or XML"),
    (b"<h", "HTML or XML"),
    (b"<H", "HTML or XML"),
    (b"\x1f\x8b", "packed by gzip"),
    (b"BZh", "packed by bzip2"),
    (b"\xfd7zXZ", "packed by xz"),
    (b"\x28\xb5\x2f\xfd", "packed by zstd"),
    (b"7z\xbc\xaf", "a 7-Zip archive"),
    (b"\x89PNG", "a picture, PNG"),
    (b"\xff\xd8\xff", "a picture, JPEG"),
    (b"\x7fELF", "a program"),
    (b"SQLite format 3\0", "a database of SQLite, as a bag of ROS 2 is"),
    (b"\x89MCAP", "a recording in MCAP"),
];

/// The text of a file with at most `max_bytes`, without a byte order mark.
///
/// # Errors
/// The reason, without the name of the file; with the line where the file is no text in UTF-8.
pub fn read(path: &Path, max_bytes: u64) -> Result<String, String> {
    let text = read_any(path, max_bytes)?;
    let lone = lone_returns(text.as_bytes()).next();
    match lone {
        Some(at) => {
            let line = line_of(text.as_bytes(), at);
            Err(format!("line {line}: it ends with CR alone; save the file with LF or CR LF"))
        }
        None => Ok(text),
    }
}

/// A table of comma-separated values in a file with at least one row; its lines may end with CR, and those of blanks are empty.
///
/// # Errors
/// As [`read`]; also a table in the form of another program, with the line.
pub fn read_table(path: &Path) -> Result<String, String> {
    table::read(&read_any(path, DATA_BYTES)?)
}

fn read_any(path: &Path, max_bytes: u64) -> Result<String, String> {
    decode(read_bytes(path, max_bytes).map_err(|error| error.to_string())?)
}

fn decode(bytes: Vec<u8>) -> Result<String, String> {
    const SAVE: &str = "save it as UTF-8";
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    if let Some((_, kind)) = KINDS.iter().find(|(start, _)| text.starts_with(start)) {
        return Err(format!("line 1: it is {kind}; save it as text"));
    }
    // The last letter of a text in UTF-16 may have one.
    let written = text.len() - text.iter().rev().take_while(|byte| **byte == 0).count();
    // A letter of ASCII has a zero byte in UTF-16, before or after it.
    let zeros = |first: usize| {
        text[..written].iter().take(512).skip(first).step_by(2).filter(|byte| **byte == 0).count()
    };
    let is_marked = text.starts_with(b"\xff\xfe") || text.starts_with(b"\xfe\xff");
    if is_marked || zeros(0).max(zeros(1)) > written.min(512) / 8 {
        return Err(format!("line 1: it is a text in UTF-16, or no text; {SAVE}"));
    }
    if written < text.len() {
        let (line, count) = (line_of(text, written), text.len() - written);
        return Err(format!(
            "line {line}: zero bytes at its end, {count} of them, as of a file that was not written to its end; remove them"
        ));
    }
    let wrong = match std::str::from_utf8(text) {
        Err(error) => Some(error.valid_up_to()),
        Ok(_) => text.iter().position(|byte| *byte == 0),
    };
    match wrong {
        Some(at) => {
            let line = line_of(text, at);
            Err(format!("line {line}: the byte {:#04x} belongs to no text in UTF-8; {SAVE}", text[at]))
        }
        None => Ok(String::from_utf8_lossy(text).into_owned()),
    }
}

/// The line of a byte; lines end with LF, CR LF or CR.
fn line_of(text: &[u8], at: usize) -> usize {
    let returns = lone_returns(text).take_while(|place| *place < at).count();
    1 + text[..at].iter().filter(|byte| **byte == b'\n').count() + returns
}

/// The places of each CR that no LF follows.
fn lone_returns(text: &[u8]) -> impl Iterator<Item = usize> + '_ {
    let is_lone = |at: &usize| text[*at] == b'\r' && text.get(at + 1) != Some(&b'\n');
    (0..text.len()).filter(is_lone)
}

/// Opens a regular file for reading. It never waits, as opening a pipe would.
///
/// # Errors
/// What is no regular file, and those of the file system.
pub fn open(path: &Path) -> io::Result<File> {
    // A FIFO that is opened for reading waits for a writer otherwise.
    let flags = OFlags::NONBLOCK.bits().cast_signed();
    let file = match OpenOptions::new().read(true).custom_flags(flags).open(path) {
        // A socket can't be opened.
        Err(error) if Errno::from_io_error(&error) == Some(Errno::NXIO) => None,
        opened => Some(opened?),
    };
    match file {
        Some(file) if file.metadata()?.is_file() => Ok(file),
        _ => Err(io::Error::other("it is not a regular file")),
    }
}

/// The first bytes of a regular file, at most `count`.
///
/// # Errors
/// As [`open`].
pub fn read_start(path: &Path, count: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path)?.take(count).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The content of a regular file with at most `max_bytes`.
///
/// # Errors
/// As [`open`], and a larger file.
pub fn read_bytes(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    let mut bytes = Vec::new();
    // A larger one is not read: it may be a hole.
    if file.metadata()?.len() <= max_bytes {
        file.take(max_bytes + 1).read_to_end(&mut bytes)?;
        if bytes.len() as u64 <= max_bytes {
            return Ok(bytes);
        }
    }
    Err(io::Error::other(format!("it has more than {max_bytes} bytes, the limit")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_the_largest_size_is_read_and_a_larger_one_is_refused() {
        let path = std::env::temp_dir().join(format!("scanloop-user-file-{}", std::process::id()));
        std::fs::write(&path, "12345678").unwrap();
        assert_eq!(read(&path, 8).unwrap(), "12345678");
        assert!(read(&path, 7).unwrap_err().contains("more than 7 bytes"));
        File::options().write(true).open(&path).unwrap().set_len(1 << 40).unwrap();
        assert!(read(&path, DATA_BYTES).unwrap_err().contains("more than 268435456 bytes"), "it is not read");
        std::fs::write(&path, [0xff]).unwrap();
        assert!(read(&path, 8).unwrap_err().contains("line 1: the byte 0xff belongs to no text in UTF-8"));
        std::fs::remove_file(&path).unwrap();
        assert!(read(Path::new("/dev/zero"), 8).unwrap_err().contains("not a regular file"));
        assert!(read(Path::new("/"), 8).unwrap_err().contains("not a regular file"));
    }

    #[test]
    fn texts_of_other_editors_are_read_or_named() {
        let text = "rate_hz = 10\nname = \"\u{e4}\"\n";
        assert_eq!(decode(["\u{feff}", text].concat().into_bytes()).unwrap(), text);
        let units = |to_bytes: fn(u16) -> [u8; 2], mark: &str| -> Vec<u8> {
            [mark, text].concat().encode_utf16().flat_map(to_bytes).collect()
        };
        for to_bytes in [u16::to_le_bytes, u16::to_be_bytes] {
            for mark in ["", "\u{feff}"] {
                assert!(decode(units(to_bytes, mark)).unwrap_err().contains("UTF-16"));
            }
        }
        let latin = decode(b"rate_hz = 10\nname = \"\xe4\"\n".to_vec()).unwrap_err();
        assert!(latin.starts_with("line 2: the byte 0xe4"), "{latin}");
        assert!(decode(b"one\ntw\0o\n".to_vec()).unwrap_err().starts_with("line 2: the byte 0x00"));
        let cut = decode([&b"rate_hz = 10\rname\n"[..], &[0; 500]].concat()).unwrap_err();
        assert!(cut.starts_with("line 3: zero bytes at its end, 500 of them"), "{cut}");
        for (start, kind) in KINDS {
            let refused = decode([start, b"\n\0\xff"].concat()).unwrap_err();
            assert_eq!(refused, format!("line 1: it is {kind}; save it as text"));
        }
    }

    #[test]
    fn a_line_that_ends_with_cr_alone_is_named() {
        let path = std::env::temp_dir().join(format!("scanloop-user-file-cr-{}", std::process::id()));
        for (text, line) in [("a = 1\r\nb = 2\n# c\rd = 3\n", 3), ("a\rb\r", 1), ("a\nb\r\r\nc\n", 2)] {
            std::fs::write(&path, text).unwrap();
            let fault = read(&path, 100).unwrap_err();
            assert!(fault.starts_with(&format!("line {line}: it ends with CR alone")), "{fault}");
        }
        std::fs::remove_file(&path).unwrap();
    }
}
