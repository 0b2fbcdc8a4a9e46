//! The head of a request: a pure function from bytes.

use super::Status;

/// Maximum number of header lines.
const MAX_HEADERS: usize = 64;

/// What is to be done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Method {
    /// Read.
    #[default]
    Get,
    /// Change.
    Post,
}

/// The parts of a request that are used.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Request {
    pub(crate) method: Method,
    /// From the first `/` to before `?`, as it was sent: it is compared with known paths, never decoded.
    pub(crate) path: String,
    /// After `?`.
    pub(crate) query: String,
    pub(crate) host: Option<String>,
    pub(crate) origin: Option<String>,
    /// After `Authorization: Bearer`.
    pub(crate) token: Option<String>,
    /// Length of the body [bytes].
    pub(crate) length: usize,
}

impl Request {
    /// Reads a head without its last empty line.
    ///
    /// # Errors
    /// The status to answer with.
    pub(crate) fn parse(head: &[u8]) -> Result<Self, Status> {
        let text = std::str::from_utf8(head).map_err(|_| Status::BadRequest)?;
        if text.chars().any(|c| c.is_control() && !matches!(c, '\r' | '\n' | '\t')) {
            return Err(Status::BadRequest);
        }
        let mut lines = text.split("\r\n");
        let mut request = Self::first_line(lines.next().unwrap_or_default())?;
        let mut length = None;
        for (index, line) in lines.enumerate() {
            let (name, value) = line.split_once(':').ok_or(Status::BadRequest)?;
            if index >= MAX_HEADERS || !is_name(name) || value.contains(['\r', '\n']) {
                return Err(Status::BadRequest);
            }
            let value = value.trim_matches([' ', '\t']);
            match name.to_ascii_lowercase().as_str() {
                "host" => once(&mut request.host, value)?,
                "origin" => once(&mut request.origin, value)?,
                "content-length" => once(&mut length, value)?,
                "authorization" => {
                    once(&mut request.token, value.strip_prefix("Bearer ").unwrap_or_default())?
                }
                // Two ways to say how long a body is are how requests are smuggled.
                "transfer-encoding" => return Err(Status::BadRequest),
                _ => {}
            }
        }
        request.length = match (&length, request.method) {
            (None, Method::Get) => 0,
            (None, Method::Post) => return Err(Status::LengthRequired),
            (Some(digits), _) => {
                let is_number = !digits.is_empty() && digits.bytes().all(|digit| digit.is_ascii_digit());
                digits.parse().ok().filter(|_| is_number).ok_or(Status::BadRequest)?
            }
        };
        Ok(request)
    }

    fn first_line(line: &str) -> Result<Self, Status> {
        let mut parts = line.split(' ');
        let (method, target, version) = (parts.next(), parts.next(), parts.next());
        let (Some(method), Some(target), Some(version), None) = (method, target, version, parts.next())
        else {
            return Err(Status::BadRequest);
        };
        if !matches!(version, "HTTP/1.1" | "HTTP/1.0") || !target.starts_with('/') || !target.is_ascii() {
            return Err(Status::BadRequest);
        }
        let method = match method {
            "GET" => Method::Get,
            "POST" => Method::Post,
            name if is_name(name) => return Err(Status::MethodNotAllowed),
            _ => return Err(Status::BadRequest),
        };
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        Ok(Self { method, path: path.to_owned(), query: query.to_owned(), ..Self::default() })
    }

    /// A number of the query, as in `?after=12`; `None` when it is missing or is no number.
    pub(crate) fn number(&self, key: &str) -> Option<u64> {
        let pairs = self.query.split('&').filter_map(|pair| pair.split_once('='));
        pairs.into_iter().find(|(name, _)| *name == key).and_then(|(_, value)| value.parse().ok())
    }
}

fn once(slot: &mut Option<String>, value: &str) -> Result<(), Status> {
    match slot.replace(value.to_owned()) {
        None => Ok(()),
        Some(_) => Err(Status::BadRequest),
    }
}

fn is_name(name: &str) -> bool {
    !name.is_empty()
        && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"!#$%&'*+-.^_`|~".contains(&byte))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_head_of_a_browser_is_read() {
        let head = b"GET /frame?number=7&x=1 HTTP/1.1\r\nHost: 127.0.0.1:7117\r\nAccept: */*\r\n\
            Origin: http://127.0.0.1:7117\r\nauthorization: Bearer abc";
        let request = Request::parse(head).unwrap();
        assert_eq!((request.path.as_str(), request.number("number")), ("/frame", Some(7)));
        assert_eq!((request.token.as_deref(), request.length), (Some("abc"), 0));
        assert_eq!((request.number("x"), request.number("y")), (Some(1), None));
    }

    #[test]
    fn what_is_ambiguous_is_refused() {
        for head in [
            "",
            "GET / HTTP/1.1\r\nHost: a\r\nHost: b",
            "POST / HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 2",
            "POST / HTTP/1.1\r\nContent-Length: +1",
            "POST / HTTP/1.1\r\nContent-Length: 99999999999999999999999",
            "POST / HTTP/1.1\r\nTransfer-Encoding: chunked",
            "GET / HTTP/1.1\r\nHost : a",
            "GET / HTTP/1.1\r\n folded",
            "GET /\0 HTTP/1.1",
            "GET  / HTTP/1.1",
            "GET / HTTP/2",
            "GET http://127.0.0.1/ HTTP/1.1",
            "GET / HTTP/1.1\r\nHost: a\nX: b",
        ] {
            assert_eq!(Request::parse(head.as_bytes()), Err(Status::BadRequest), "{head:?}");
        }
        assert_eq!(Request::parse(b"POST / HTTP/1.1"), Err(Status::LengthRequired));
        assert_eq!(Request::parse(b"DELETE / HTTP/1.1"), Err(Status::MethodNotAllowed));
        assert_eq!(Request::parse(b"GET /\xff HTTP/1.1"), Err(Status::BadRequest));
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            let _ = Request::parse(&bytes);
        }

        #[test]
        fn any_lines_are_read_or_refused(lines in "(GET|POST) /[ -~]{0,40} HTTP/1.1(\r\n[A-Za-z-]{1,20}: ?[ -~]{0,40}){0,5}") {
            if let Ok(request) = Request::parse(lines.as_bytes()) {
                prop_assert!(request.path.starts_with('/'));
            }
        }
    }
}
