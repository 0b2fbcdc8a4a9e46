//! The process of the guard: orders on standard input, commands to the robot.

use std::io::{ErrorKind, Read};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::time::Duration;

use anyhow::Context;
use runtime::monotonic_ns;

use super::{Guard, GuardAct};
use crate::order::{FRAME, Frame, GuardAnswer, GuardOrder};

/// Longest time between two checks [ns].
const MAX_WAIT_NS: u64 = 100_000_000;
/// A read never waits for zero time, which would mean for ever [ns].
const MIN_WAIT_NS: u64 = 100_000;

/// The sending end of a connection to a robot.
pub trait Commands {
    /// Sends what the guard has decided.
    ///
    /// # Errors
    /// A connection that can't be written to.
    fn send(&mut self, act: GuardAct) -> std::io::Result<()>;

    /// Waits until what was sent is on its way, before the process ends.
    fn finish(&mut self) {}
}

/// Runs until the driver has ended, and stops the wheels then. `open` makes the sending end from the number that the
/// driver has given it.
///
/// # Errors
/// A start by hand, and a connection that cannot be written to.
pub fn run<C: Commands>(open: impl FnOnce(u64) -> anyhow::Result<C>) -> anyhow::Result<()> {
    let by_hand = "the guard is started by its driver";
    let driver = UnixStream::from(std::io::stdin().as_fd().try_clone_to_owned()?);
    let Some(Frame { order: GuardOrder::Guard(guarded, timeout_ns), .. }) =
        first(&driver).context(by_hand)?
    else {
        anyhow::bail!("{by_hand}: the first order is another");
    };
    let mut commands = open(guarded)?;
    answer(&driver, GuardAnswer { number: 1, stops: 0 });
    follow(&mut Guard::new(timeout_ns), &driver, &mut commands).context("the connection to the robot")
}

fn first(mut driver: &UnixStream) -> std::io::Result<Option<Frame>> {
    let mut bytes = [0; FRAME];
    driver.set_read_timeout(Some(Duration::from_secs(5)))?;
    driver.read_exact(&mut bytes)?;
    Ok(Frame::from_bytes(&bytes))
}

fn follow(guard: &mut Guard, mut driver: &UnixStream, commands: &mut impl Commands) -> std::io::Result<()> {
    let (mut frame, mut filled) = ([0; FRAME], 0);
    loop {
        let now_ns = monotonic_ns();
        if let Some(stopped) = guard.check(now_ns) {
            commands.send(GuardAct::Stop)?;
            answer(driver, stopped);
            tracing::warn!(stops = stopped.stops, "the driver is silent: the wheels are stopped");
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
                let (followed, act) = guard.follow(&frame, monotonic_ns());
                act.map_or(Ok(()), |act| commands.send(act))?;
                answer(driver, followed);
            }
        }
    }
    let stopped = commands.send(GuardAct::Stop);
    commands.finish();
    tracing::info!("the driver has ended: the wheels are stopped");
    stopped
}

/// Answers. A driver that does not read its answers is not waited for.
fn answer(driver: &UnixStream, answer: GuardAnswer) {
    let _ = rustix::net::send(driver, &answer.to_bytes(), rustix::net::SendFlags::DONTWAIT);
}
