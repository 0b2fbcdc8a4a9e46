//! Reads a request from a connection within its limits.

use std::io::{self, ErrorKind, Read};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use super::{Request, Status};

/// Longest head [bytes].
const MAX_HEAD: usize = 8 << 10;
/// Longest body [bytes]: an action with its arguments.
const MAX_BODY: usize = 4 << 10;
/// A request must be complete after this time.
const TIMEOUT: Duration = Duration::from_secs(2);

/// Why there is no request.
#[derive(Debug)]
pub(crate) enum Failed {
    /// The connection ended, or nothing came in time: there is none to answer.
    Gone,
    /// It is answered with this status.
    Refused(Status),
}

/// The next request of a connection, and its body.
///
/// # Errors
/// [`Failed`].
pub(crate) fn read_request(stream: &mut TcpStream) -> Result<(Request, Vec<u8>), Failed> {
    read_until(stream, Instant::now() + TIMEOUT)
}

fn read_until(stream: &mut TcpStream, until: Instant) -> Result<(Request, Vec<u8>), Failed> {
    let mut bytes = Vec::with_capacity(1024);
    let end = loop {
        if let Some(end) = bytes.windows(4).position(|four| four == b"\r\n\r\n") {
            break end;
        }
        if bytes.len() > MAX_HEAD {
            return Err(Failed::Refused(Status::HeadTooLarge));
        }
        read_some(stream, &mut bytes, until)?;
    };
    let request = Request::parse(&bytes[..end]).map_err(Failed::Refused)?;
    if request.length > MAX_BODY {
        return Err(Failed::Refused(Status::BodyTooLarge));
    }
    let mut body = bytes.split_off(end + 4);
    while body.len() < request.length {
        read_some(stream, &mut body, until)?;
    }
    body.truncate(request.length);
    Ok((request, body))
}

fn read_some(stream: &mut TcpStream, bytes: &mut Vec<u8>, until: Instant) -> Result<(), Failed> {
    let left = until.saturating_duration_since(Instant::now());
    if left.is_zero() {
        return Err(if bytes.is_empty() { Failed::Gone } else { Failed::Refused(Status::RequestTimeout) });
    }
    // A timeout below a microsecond would mean none.
    let limited = stream.set_read_timeout(Some(left.max(Duration::from_micros(1))));
    let mut piece = [0; 2048];
    match limited.and_then(|()| stream.read(&mut piece)) {
        Ok(0) => Err(Failed::Gone),
        Ok(count) => {
            bytes.extend_from_slice(&piece[..count]);
            Ok(())
        }
        Err(error) if is_retried(&error) => Ok(()),
        Err(_) => Err(Failed::Gone),
    }
}

fn is_retried(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock | ErrorKind::TimedOut)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::net::TcpListener;

    fn pair() -> (TcpStream, TcpStream) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let client = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        (client, listener.accept().unwrap().0)
    }

    fn read(sent: &[u8], wait: Duration) -> Result<(Request, Vec<u8>), Failed> {
        let (mut client, mut server) = pair();
        client.write_all(sent).unwrap();
        read_until(&mut server, Instant::now() + wait)
    }

    #[test]
    fn a_body_is_read_to_its_length() {
        let sent = b"POST /control HTTP/1.1\r\nContent-Length: 4\r\n\r\nbodymore";
        let (request, body) = read(sent, TIMEOUT).unwrap();
        assert_eq!((request.path.as_str(), body.as_slice()), ("/control", b"body".as_slice()));
    }

    #[test]
    fn half_a_request_is_given_up_after_its_time() {
        let wait = Duration::from_millis(30);
        assert!(matches!(read(b"GET / HT", wait), Err(Failed::Refused(Status::RequestTimeout))));
        assert!(matches!(read(b"", wait), Err(Failed::Gone)));
    }

    #[test]
    fn what_is_too_long_is_refused() {
        let long = format!("GET / HTTP/1.1\r\nX: {}", "x".repeat(MAX_HEAD));
        assert!(matches!(read(long.as_bytes(), TIMEOUT), Err(Failed::Refused(Status::HeadTooLarge))));
        let long = b"POST / HTTP/1.1\r\nContent-Length: 5000\r\n\r\n";
        assert!(matches!(read(long, TIMEOUT), Err(Failed::Refused(Status::BodyTooLarge))));
    }
}
