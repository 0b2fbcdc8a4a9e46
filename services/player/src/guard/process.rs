//! The process of the guard: orders on standard input, the connection to the server on standard output.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::time::Duration;

use anyhow::Context;
use runtime::monotonic_ns;

use super::Guard;
use crate::order::{FRAME, Frame, GuardAnswer, GuardOrder};

/// Longest time between two checks [ns].
const MAX_WAIT_NS: u64 = 100_000_000;
/// A read never waits for zero time, which would mean for ever [ns].
const MIN_WAIT_NS: u64 = 100_000;

/// Runs until the driver has ended, and stops the wheels then.
///
/// # Errors
/// A start by hand, and a connection that cannot be written to; the wheels stop when the server sees it closed.
pub fn run() -> anyhow::Result<()> {
    let by_hand = "the guard is started by the driver `player`";
    let driver = UnixStream::from(std::io::stdin().as_fd().try_clone_to_owned()?);
    let server = TcpStream::from(std::io::stdout().as_fd().try_clone_to_owned()?);
    let Some(Frame { order: GuardOrder::Guard(base, timeout_ns), .. }) = first(&driver).context(by_hand)?
    else {
        anyhow::bail!("{by_hand}: the first order is another");
    };
    let mut guard = Guard::new(base, timeout_ns);
    let ended = send(&mut Vec::new(), &server, Some((GuardAnswer { number: 1, stops: 0 }, &driver)))
        .and_then(|()| follow(&mut guard, &driver, &server));
    if ended.is_err() {
        // The driver and the server see it.
        let _ = server.shutdown(Shutdown::Both);
    }
    ended.context("the connection to the Player server")
}

fn first(mut driver: &UnixStream) -> std::io::Result<Option<Frame>> {
    let mut bytes = [0; FRAME];
    driver.set_read_timeout(Some(Duration::from_secs(5)))?;
    driver.read_exact(&mut bytes)?;
    Ok(Frame::from_bytes(&bytes))
}

fn follow(guard: &mut Guard, mut driver: &UnixStream, mut server: &TcpStream) -> std::io::Result<()> {
    let (mut frame, mut filled) = ([0; FRAME], 0);
    let mut messages = Vec::with_capacity(256);
    loop {
        let now_ns = monotonic_ns();
        let answer = guard.check(now_ns, &mut messages);
        send(&mut messages, server, answer.map(|answer| (answer, driver)))?;
        if let Some(answer) = answer {
            tracing::warn!(stops = answer.stops, "the driver is silent: the wheels are stopped");
        }
        let wait_ns = guard.rest_ns(now_ns).unwrap_or(MAX_WAIT_NS).clamp(MIN_WAIT_NS, MAX_WAIT_NS);
        driver.set_read_timeout(Some(Duration::from_nanos(wait_ns)))?;
        match driver.read(&mut frame[filled..]) {
            Ok(0) => break,
            Ok(count) => filled += count,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => continue,
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Err(_) => break,
        }
        if filled == FRAME {
            filled = 0;
            if let Some(frame) = Frame::from_bytes(&frame) {
                let answer = guard.follow(&frame, monotonic_ns(), &mut messages);
                send(&mut messages, server, Some((answer, driver)))?;
            }
        }
    }
    guard.stop(&mut messages);
    let stopped = server.write_all(&messages);
    tracing::info!("the driver has ended: the wheels are stopped");
    stopped
}

/// Sends the messages, then the answer. A driver that does not read its answers is not waited for.
fn send(
    messages: &mut Vec<u8>,
    mut server: &TcpStream,
    answer: Option<(GuardAnswer, &UnixStream)>,
) -> std::io::Result<()> {
    server.write_all(messages)?;
    messages.clear();
    if let Some((answer, driver)) = answer {
        let _ = rustix::net::send(driver, &answer.to_bytes(), rustix::net::SendFlags::DONTWAIT);
    }
    Ok(())
}
