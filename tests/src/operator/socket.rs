//! Traffic on a control socket that no client of ours would send.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::plan::Traffic;
use crate::pause;

/// For how long connections are held open, and lines are sent.
const MAX_WAIT: Duration = Duration::from_secs(3);

/// Sends it from a thread of its own, which ends by itself.
pub(super) fn send(socket: PathBuf, traffic: Traffic) {
    std::thread::spawn(move || match traffic {
        Traffic::Garbage => garbage(&socket),
        Traffic::EndlessLine => endless_line(&socket),
        Traffic::Connections => connections(&socket),
    });
}

fn garbage(socket: &Path) {
    let mut byte = 17_u8;
    for _ in 0..20 {
        let Ok(mut stream) = UnixStream::connect(socket) else { return };
        let _ = stream.set_read_timeout(Some(MAX_WAIT));
        let bytes: Vec<u8> = std::iter::repeat_with(|| {
            byte = byte.wrapping_mul(29).wrapping_add(113);
            byte
        })
        .take(2000)
        .chain(*b"\n")
        .collect();
        let _ = stream.write_all(&bytes).and_then(|()| stream.read(&mut [0; 100]));
    }
}

fn endless_line(socket: &Path) {
    let Ok(mut stream) = UnixStream::connect(socket) else { return };
    let _ = stream.set_write_timeout(Some(MAX_WAIT));
    let started = Instant::now();
    while started.elapsed() < MAX_WAIT && stream.write_all(&[b'x'; 4096]).is_ok() {}
}

fn connections(socket: &Path) {
    let held: Vec<_> = (0..40).map_while(|_| UnixStream::connect(socket).ok()).collect();
    let started = Instant::now();
    while started.elapsed() < MAX_WAIT {
        pause();
    }
    drop(held);
}
