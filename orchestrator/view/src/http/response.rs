//! Answers.

use std::io::{self, Write};

/// How a request ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Status {
    Ok,
    BadRequest,
    Forbidden,
    NotFound,
    MethodNotAllowed,
    RequestTimeout,
    Conflict,
    LengthRequired,
    BodyTooLarge,
    HeadTooLarge,
    Unavailable,
}

impl Status {
    fn line(self) -> &'static str {
        match self {
            Self::Ok => "200 OK",
            Self::BadRequest => "400 Bad Request",
            Self::Forbidden => "403 Forbidden",
            Self::NotFound => "404 Not Found",
            Self::MethodNotAllowed => "405 Method Not Allowed",
            Self::RequestTimeout => "408 Request Timeout",
            Self::Conflict => "409 Conflict",
            Self::LengthRequired => "411 Length Required",
            Self::BodyTooLarge => "413 Content Too Large",
            Self::HeadTooLarge => "431 Request Header Fields Too Large",
            Self::Unavailable => "503 Service Unavailable",
        }
    }
}

/// What every answer forbids the browser: content from elsewhere, code that is not in our files, frames, guesses about
/// the type, and copies.
const GUARDS: &str = "Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; \
    connect-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n\
    X-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\nCross-Origin-Resource-Policy: same-origin\r\n\
    Cross-Origin-Opener-Policy: same-origin\r\nCache-Control: no-store\r\nConnection: close\r\n";

/// An answer with its whole content.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Response {
    pub(crate) status: Status,
    content_type: &'static str,
    content: Vec<u8>,
}

impl Response {
    /// A file of the page.
    pub(crate) fn file(content_type: &'static str, content: &[u8]) -> Self {
        Self { status: Status::Ok, content_type, content: content.to_vec() }
    }

    /// JSON.
    pub(crate) fn json(status: Status, text: impl Into<Vec<u8>>) -> Self {
        Self { status, content_type: "application/json", content: text.into() }
    }

    /// A sentence, of a request that is not carried out.
    pub(crate) fn text(status: Status, text: &str) -> Self {
        Self { status, content_type: "text/plain; charset=utf-8", content: format!("{text}\n").into_bytes() }
    }

    /// Writes it whole.
    ///
    /// # Errors
    /// Those of the connection.
    pub(crate) fn write(&self, output: &mut impl Write) -> io::Result<()> {
        let Self { status, content_type, content } = self;
        let (line, length) = (status.line(), content.len());
        let head = format!(
            "HTTP/1.1 {line}\r\nContent-Type: {content_type}\r\nContent-Length: {length}\r\n{GUARDS}\r\n"
        );
        output.write_all(&[head.as_bytes(), content].concat())
    }
}

/// Starts a stream of server-sent events, which ends with the connection.
///
/// # Errors
/// Those of the connection.
pub(crate) fn write_stream_head(output: &mut impl Write) -> io::Result<()> {
    let head = format!("HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\n{GUARDS}\r\n");
    output.write_all(head.as_bytes())
}
