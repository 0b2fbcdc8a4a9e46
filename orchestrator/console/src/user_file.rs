//! Files that a user names on the command line: regular ones of a limited size.

use std::fs::OpenOptions;
use std::io::{self, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use rustix::fs::OFlags;

/// Largest scenario, system or calibration: a hundred times the largest one shipped [bytes].
pub const TEXT_BYTES: u64 = 1 << 20;
/// Largest file of recorded or measured data [bytes].
pub const DATA_BYTES: u64 = 1 << 28;

/// The text of a file with at most `max_bytes`.
///
/// # Errors
/// The reason, without the name of the file.
pub fn read(path: &Path, max_bytes: u64) -> Result<String, String> {
    let bytes = read_bytes(path, max_bytes).map_err(|error| error.to_string())?;
    String::from_utf8(bytes).map_err(|_| "it is not a text in UTF-8".to_owned())
}

fn read_bytes(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
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
        assert!(read(&path, 8).unwrap_err().contains("UTF-8"));
        std::fs::remove_file(&path).unwrap();
        assert!(read(Path::new("/dev/zero"), 8).unwrap_err().contains("not a regular file"));
        assert!(read(Path::new("/"), 8).unwrap_err().contains("not a regular file"));
    }
}
