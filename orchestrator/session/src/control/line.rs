//! One line over a socket, with a limit of length and a time by which all of it must be there.
//!
//! The deadline is that of the whole line: a peer that sends a byte now and then does not extend it. A reader that was
//! suspended itself until after the deadline still takes what has come.

use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

/// Written at once [bytes]: the kernel starts the timeout anew for each piece of a longer write.
const PIECE: usize = 4096;

/// Zero would mean no timeout.
const SHORTEST: Duration = Duration::from_micros(1);

/// Reads up to the end of the line or of the connection, at most `limit` bytes, until `until`; `None` when nothing came
/// before the end of the connection.
///
/// # Errors
/// [`ErrorKind::TimedOut`], [`ErrorKind::FileTooLarge`], [`ErrorKind::InvalidData`] for what is no text, and those of
/// the socket.
pub(super) fn read_line(mut stream: &UnixStream, limit: usize, until: Instant) -> io::Result<Option<String>> {
    let (mut line, mut piece) = (Vec::new(), [0; PIECE]);
    loop {
        let left = left(until);
        stream.set_read_timeout(Some(*left.as_ref().unwrap_or(&SHORTEST)))?;
        let count = match stream.read(&mut piece) {
            Ok(0) if line.is_empty() => return Ok(None),
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::WouldBlock && left.is_err() => {
                return Err(ErrorKind::TimedOut.into());
            }
            Err(error) if is_retried(&error) => continue,
            Err(error) => return Err(error),
        };
        let end = piece[..count].iter().position(|byte| *byte == b'\n');
        line.extend_from_slice(&piece[..end.unwrap_or(count)]);
        if line.len() > limit {
            return Err(ErrorKind::FileTooLarge.into());
        }
        if end.is_some() || count == 0 {
            return String::from_utf8(line).map(Some).map_err(|_| ErrorKind::InvalidData.into());
        }
    }
}

/// Writes a line until `until`.
///
/// # Errors
/// [`ErrorKind::TimedOut`], and those of the socket.
pub(super) fn write_line(mut stream: &UnixStream, text: &str, until: Instant) -> io::Result<()> {
    let line = format!("{text}\n");
    let mut bytes = line.as_bytes();
    while !bytes.is_empty() {
        stream.set_write_timeout(Some(left(until)?))?;
        match stream.write(&bytes[..bytes.len().min(PIECE)]) {
            Ok(count) => bytes = &bytes[count..],
            Err(error) if is_retried(&error) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// The time until the deadline, at least [`SHORTEST`].
fn left(until: Instant) -> io::Result<Duration> {
    let left = until.saturating_duration_since(Instant::now());
    if left.is_zero() { Err(ErrorKind::TimedOut.into()) } else { Ok(left.max(SHORTEST)) }
}

fn is_retried(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn soon() -> Instant {
        Instant::now() + Duration::from_millis(50)
    }

    #[test]
    fn a_line_ends_at_its_line_feed() {
        let (near, mut far) = UnixStream::pair().unwrap();
        far.write_all(b"\"status\"\nmore").unwrap();
        assert_eq!(read_line(&near, 100, soon()).unwrap().as_deref(), Some("\"status\""));
        drop(far);
        assert_eq!(read_line(&near, 100, soon()).unwrap(), None);
    }

    #[test]
    fn a_line_that_has_come_is_read_after_the_deadline() {
        let (near, mut far) = UnixStream::pair().unwrap();
        let past = Instant::now();
        assert_eq!(read_line(&near, 100, past).unwrap_err().kind(), ErrorKind::TimedOut);
        far.write_all(b"\"done\"\n\"mo").unwrap();
        assert_eq!(read_line(&near, 100, past).unwrap().as_deref(), Some("\"done\""));
    }

    #[test]
    fn a_line_without_end_is_cut_at_the_limit() {
        let (near, far) = UnixStream::pair().unwrap();
        let until = Instant::now() + Duration::from_secs(60);
        let writer = std::thread::spawn(move || write_line(&far, &"x".repeat(1 << 20), until));
        let error = read_line(&near, 1000, until).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::FileTooLarge);
        drop(near);
        assert!(writer.join().unwrap().is_err());
    }

    #[test]
    fn a_byte_now_and_then_does_not_extend_the_deadline() {
        let (near, mut far) = UnixStream::pair().unwrap();
        let (done, is_done) = std::sync::mpsc::channel::<()>();
        let writer = std::thread::spawn(move || {
            while is_done.recv_timeout(Duration::from_millis(10)).is_err() {
                if far.write_all(b"x").is_err() {
                    return;
                }
            }
        });
        let started = Instant::now();
        let error = read_line(&near, 1 << 20, started + Duration::from_millis(100)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::TimedOut);
        // Otherwise it would take a minute and more.
        assert!(started.elapsed() < Duration::from_secs(30), "{:?}", started.elapsed());
        let _ = done.send(());
        writer.join().unwrap();
    }

    #[test]
    fn a_reader_that_does_not_read_delays_no_writer_beyond_the_deadline() {
        let (near, _far) = UnixStream::pair().unwrap();
        let error = write_line(&near, &"x".repeat(4 << 20), soon()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::TimedOut);
    }
}
