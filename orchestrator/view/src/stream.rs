//! The stream of a browser: the newest of everything as server-sent events, until one end closes it.

use std::io::Write;
use std::net::TcpStream;
use std::time::Duration;

use rustix::net::sockopt::set_socket_send_buffer_size;

use crate::http::write_stream_head;
use crate::hub::{Cursor, Hub};

/// A comment is sent when nothing else was for this long, so that each end notices when the other is gone.
const IDLE: Duration = Duration::from_secs(1);
/// A browser that takes nothing for this long loses its stream; it may ask for another one.
const WRITE_TIMEOUT: Duration = Duration::from_secs(5);
/// What the kernel may hold for a slow browser: a few frames, so that the next one is a new one [bytes].
const SEND_BUFFER: usize = 32 << 10;

/// Sends until the connection or the server ends.
pub(crate) fn send(stream: &mut TcpStream, hub: &Hub) {
    let _ = set_socket_send_buffer_size(&*stream, SEND_BUFFER);
    let ready = stream.set_write_timeout(Some(WRITE_TIMEOUT)).and_then(|()| stream.set_nodelay(true));
    if ready.and_then(|()| write_stream_head(stream)).is_err() {
        return;
    }
    let mut cursor = Cursor::default();
    let mut text = String::new();
    while let Ok(messages) = hub.next(&mut cursor, IDLE) {
        text.clear();
        if messages.is_empty() {
            text.push_str(": idle\n\n");
        }
        for (name, json) in messages {
            ["event: ", name, "\ndata: ", &*json, "\n\n"].iter().for_each(|part| text.push_str(part));
        }
        if stream.write_all(text.as_bytes()).is_err() {
            return;
        }
    }
    let _ = stream.write_all(b"event: end\ndata: null\n\n");
}
