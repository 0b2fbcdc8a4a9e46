//! Files that a user names on the command line: regular ones of a limited size.

mod table;

use std::fs::OpenOptions;
use std::io::{self, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use rustix::fs::OFlags;

/// Largest scenario, system or calibration: a hundred times the largest one shipped [bytes].
pub const TEXT_BYTES: u64 = 1 << 20;
/// Largest file of recorded or measured data [bytes].
pub const DATA_BYTES: u64 = 1 << 28;

/// The text of a file with at most `max_bytes`, without a byte order mark.
///
/// # Errors
/// The reason, without the name of the file; with the line where the file is no text in UTF-8.
pub fn read(path: &Path, max_bytes: u64) -> Result<String, String> {
    let text = read_any(path, max_bytes)?;
    match text.contains('\r') && !text.contains('\n') {
        true => Err("line 1: its lines end with CR alone; save it with LF or CR LF".to_owned()),
        false => Ok(text),
    }
}

/// A table of comma-separated values in a file, as [`read`] has it; its lines may end with CR.
///
/// # Errors
/// As [`read`]; also a table in the form of another program, with the line.
pub fn read_table(path: &Path) -> Result<String, String> {
    let text = read_any(path, DATA_BYTES)?;
    table::require_form(&text).map(|()| text)
}

fn read_any(path: &Path, max_bytes: u64) -> Result<String, String> {
    decode(read_bytes(path, max_bytes).map_err(|error| error.to_string())?)
}

fn decode(bytes: Vec<u8>) -> Result<String, String> {
    const SAVE: &str = "save it as UTF-8";
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    // A letter of ASCII has a zero byte in UTF-16, before or after it.
    let zeros =
        |first: usize| text.iter().take(512).skip(first).step_by(2).filter(|byte| **byte == 0).count();
    let is_marked = text.starts_with(b"\xff\xfe") || text.starts_with(b"\xfe\xff");
    if is_marked || zeros(0).max(zeros(1)) > text.len().min(512) / 8 {
        return Err(format!("line 1: it is a text in UTF-16, or no text; {SAVE}"));
    }
    let wrong = match std::str::from_utf8(text) {
        Err(error) => Some(error.valid_up_to()),
        Ok(_) => text.iter().position(|byte| *byte == 0),
    };
    match wrong {
        Some(at) => {
            let line = 1 + text[..at].iter().filter(|byte| **byte == b'\n').count();
            Err(format!("line {line}: the byte {:#04x} belongs to no text in UTF-8; {SAVE}", text[at]))
        }
        None => Ok(String::from_utf8_lossy(text).into_owned()),
    }
}

/// The content of a regular file with at most `max_bytes`.
pub(crate) fn read_bytes(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    // A FIFO that is opened for reading waits for a writer otherwise.
    let flags = OFlags::NONBLOCK.bits().cast_signed();
    let file = OpenOptions::new().read(true).custom_flags(flags).open(path)?;
    if !file.metadata()?.is_file() {
        return Err(io::Error::other("it is not a regular file"));
    }
    let mut bytes = Vec::new();
    file.take(max_bytes + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes {
        return Err(io::Error::other(format!("it has more than {max_bytes} bytes, the limit")));
    }
    Ok(bytes)
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
        assert!(decode(b"one\ntwo\n\0".to_vec()).unwrap_err().starts_with("line 3: the byte 0x00"));
    }
}
