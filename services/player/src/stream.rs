//! Cuts the bytes of a connection into messages, whatever pieces they arrive in.
//!
//! The memory is bounded and allocated once. Messages that are larger than it are skipped: none that this client uses is.
//! Bytes that are no messages of Player end the stream with an error that shows them.

use crate::header::{HEADER, MessageHeader};

/// Size of the text that a server sends first [bytes].
pub const IDENT: usize = 32;
/// How that text begins.
const IDENT_START: &[u8] = b"Player v.3.";
/// Larger payloads are skipped [bytes]: eight thousand ranges of 64 bits.
pub const MAX_PAYLOAD: usize = 65_536;
/// The server's own limit [bytes]; a larger size is no size.
const MAX_SIZE: usize = 32 << 20;
/// How many bytes of garbage an error shows.
const SHOWN: usize = 24;

/// The bytes are not those of a Player 3 server.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NotPlayer {
    /// The first bytes are others.
    #[error("this is no Player 3 server: it sent `{0}`")]
    Ident(String),
    /// A header is impossible.
    #[error("garbage in the stream: `{0}` is no header of a message")]
    Header(String),
}

/// A stream of messages.
#[derive(Debug)]
pub struct MessageStream {
    buffer: Box<[u8]>,
    /// The bytes that are there, from the first unread one.
    unread: std::ops::Range<usize>,
    /// Whether the first text was read.
    is_open: bool,
    /// Bytes of a large message that are still to be skipped.
    to_skip: usize,
}

impl Default for MessageStream {
    fn default() -> Self {
        let buffer = vec![0; 2 * (HEADER + MAX_PAYLOAD)].into_boxed_slice();
        Self { buffer, unread: 0..0, is_open: false, to_skip: 0 }
    }
}

impl MessageStream {
    /// Where the next bytes are to be put; never empty after [`Self::next`] has returned `None`.
    pub fn space(&mut self) -> &mut [u8] {
        self.buffer.copy_within(self.unread.clone(), 0);
        self.unread = 0..self.unread.len();
        &mut self.buffer[self.unread.end..]
    }

    /// Adds the first `count` bytes of [`Self::space`].
    pub fn add(&mut self, count: usize) {
        self.unread.end = self.buffer.len().min(self.unread.end + count);
    }

    /// The next complete message; `None` when more bytes are needed.
    ///
    /// # Errors
    /// [`NotPlayer`] when there cannot be one.
    #[expect(clippy::should_implement_trait, reason = "a message borrows the stream")]
    pub fn next(&mut self) -> Result<Option<(MessageHeader, &[u8])>, NotPlayer> {
        if !self.is_open && !self.open()? {
            return Ok(None);
        }
        loop {
            let skipped = self.to_skip.min(self.unread.len());
            (self.unread.start, self.to_skip) = (self.unread.start + skipped, self.to_skip - skipped);
            let Ok(header) = MessageHeader::read(&self.buffer[self.unread.clone()]) else { return Ok(None) };
            let size = header.size as usize;
            if !header.is_plausible() || size > MAX_SIZE {
                return Err(NotPlayer::Header(self.shown()));
            }
            if size > MAX_PAYLOAD {
                self.to_skip = HEADER + size;
                continue;
            }
            if self.unread.len() < HEADER + size {
                return Ok(None);
            }
            let payload = self.unread.start + HEADER;
            self.unread.start = payload + size;
            return Ok(Some((header, &self.buffer[payload..payload + size])));
        }
    }

    /// Reads the first text; false when it is not complete yet.
    fn open(&mut self) -> Result<bool, NotPlayer> {
        let there = &self.buffer[self.unread.clone()];
        if !there.iter().zip(IDENT_START).all(|(found, expected)| found == expected) {
            return Err(NotPlayer::Ident(self.shown()));
        }
        self.is_open = there.len() >= IDENT;
        self.unread.start += if self.is_open { IDENT } else { 0 };
        Ok(self.is_open)
    }

    /// The first unread bytes as printable text.
    fn shown(&self) -> String {
        let bytes = &self.buffer[self.unread.clone()];
        bytes[..bytes.len().min(SHOWN)].escape_ascii().to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDENT_TEXT: [u8; IDENT] = *b"Player v.3.1.1-dev\0\0\0\0\0\0\0\0\0\0\0\0\0\0";

    fn put(stream: &mut MessageStream, bytes: &[u8]) {
        let space = stream.space();
        space[..bytes.len()].copy_from_slice(bytes);
        stream.add(bytes.len());
    }

    #[test]
    fn another_server_is_recognised_by_its_first_bytes() {
        let mut stream = MessageStream::default();
        put(&mut stream, b"SSH-2.0-Op");
        let error = stream.next().unwrap_err();
        assert_eq!(error.to_string(), "this is no Player 3 server: it sent `SSH-2.0-Op`");
        let mut stream = MessageStream::default();
        put(&mut stream, b"Player v.2.1.0");
        assert!(stream.next().is_err());
    }

    #[test]
    fn a_large_message_is_skipped_without_memory_for_it() {
        let mut stream = MessageStream::default();
        put(&mut stream, &IDENT_TEXT);
        let mut bytes = Vec::new();
        let header =
            MessageHeader::read(&[0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 4].repeat(2))
                .unwrap();
        let size = 1 << 20;
        MessageHeader { kind: 1, subtype: 1, size, ..header }.write(&mut bytes);
        put(&mut stream, &bytes);
        assert_eq!(stream.next(), Ok(None));
        for _ in 0..size / 1024 {
            put(&mut stream, &[0xff; 1024]);
            assert_eq!(stream.next(), Ok(None));
        }
        bytes.clear();
        MessageHeader { kind: 5, subtype: 1, size: 0, ..header }.write(&mut bytes);
        put(&mut stream, &bytes);
        assert_eq!(stream.next().unwrap().map(|(header, _)| header.kind), Some(5));
    }

    #[test]
    fn an_impossible_header_ends_the_stream() {
        let mut stream = MessageStream::default();
        put(&mut stream, &IDENT_TEXT);
        put(&mut stream, &[b'x'; HEADER]);
        assert!(matches!(stream.next(), Err(NotPlayer::Header(text)) if text.starts_with("xxx")));
    }
}
