//! The work of a process of a chain over any transport: it sends at a rate, forwards, or measures latencies.

use std::time::Duration;

use rustix::thread::{ClockId, Timespec, clock_nanosleep_absolute};

use crate::control::{DriverConnection, DriverOrder};
use crate::message::{Arrival, Stamp, monotonic_ns};
use crate::policy::{MAX_WAIT_NS, POLL_US};
use crate::{HopError, Setup, WaitPolicy};

/// Time between two messages while the chain connects.
const CONNECTING: Duration = Duration::from_millis(20);

/// The ports of one process on one transport.
pub trait ChainStage {
    /// Sends a message of the size that belongs to this process; one that finds no room is lost.
    ///
    /// # Errors
    /// What the transport refuses.
    fn send(&mut self, stamp: Stamp) -> Result<(), HopError>;

    /// The oldest message that this process has noticed, without a system call.
    fn take(&mut self) -> Option<Arrival>;

    /// Whether a message has come, without sleeping; [`ChainStage::take`] then has it.
    fn poll(&mut self) -> bool;

    /// Sleeps until a time of CLOCK_MONOTONIC: the first process, until its next message is due.
    fn sleep_until(&mut self, time_ns: u64) {
        let time =
            Timespec { tv_sec: (time_ns / 1_000_000_000) as i64, tv_nsec: (time_ns % 1_000_000_000) as i64 };
        while clock_nanosleep_absolute(ClockId::Monotonic, &time).is_err() {}
    }

    /// Sleeps until a message comes or that many nanoseconds have passed; `None` leaves the time to the transport.
    fn block(&mut self, timeout_ns: Option<u64>);
}

/// Runs one process of the chain until the driver closes it.
///
/// # Errors
/// When the driver can't be reached, and what the transport refuses.
pub fn run(stage: &mut dyn ChainStage, setup: &Setup) -> Result<(), HopError> {
    let mut control = DriverConnection::connect(setup)?;
    control.hello(setup)?;
    if setup.is_first() {
        send(stage, setup, &mut control)
    } else if setup.is_last() {
        receive(stage, setup, &mut control)
    } else {
        pass_on(stage, setup, &mut control)
    }
}

/// Sends at the rate of the setup, whether messages arrive or not.
fn send(stage: &mut dyn ChainStage, setup: &Setup, control: &mut DriverConnection) -> Result<(), HopError> {
    loop {
        stage.send(Stamp::now(0))?;
        match control.order(CONNECTING) {
            Some(DriverOrder::Go) => break,
            Some(DriverOrder::Close) => return Ok(()),
            Some(DriverOrder::Finish) | None => {}
        }
    }
    let start = monotonic_ns() + setup.period_ns;
    for index in 0..setup.warm_up + setup.samples {
        stage.sleep_until(start + index * setup.period_ns);
        stage.send(Stamp::now((index + 1).saturating_sub(setup.warm_up)))?;
    }
    control.send_line("sent")?;
    control.wait_for_close();
    Ok(())
}

fn pass_on(
    stage: &mut dyn ChainStage,
    setup: &Setup,
    control: &mut DriverConnection,
) -> Result<(), HopError> {
    let (mut due_ns, mut quiet) = (0, false);
    loop {
        if let Some(arrival) = stage.take() {
            stage.send(arrival.stamp)?;
            due_ns = arrival.received_ns + setup.period_ns;
            quiet = false;
        } else if std::mem::take(&mut quiet) {
            if control.order(Duration::ZERO) == Some(DriverOrder::Close) {
                return Ok(());
            }
        } else {
            quiet = idle(stage, setup, due_ns);
        }
    }
}

fn receive(
    stage: &mut dyn ChainStage,
    setup: &Setup,
    control: &mut DriverConnection,
) -> Result<(), HopError> {
    let mut latencies_ns = vec![0; setup.samples as usize];
    let (mut due_ns, mut quiet, mut seen, mut reported) = (0, false, false, false);
    loop {
        let mut finished = false;
        if let Some(Arrival { stamp, received_ns }) = stage.take() {
            due_ns = received_ns + setup.period_ns;
            quiet = false;
            if !std::mem::replace(&mut seen, true) {
                control.send_line("seen")?;
            }
            let place = stamp.sequence.checked_sub(1).and_then(|index| latencies_ns.get_mut(index as usize));
            if let Some(latency) = place {
                *latency = received_ns.saturating_sub(stamp.sent_ns).max(1);
            }
            finished = stamp.sequence == setup.samples;
        } else if std::mem::take(&mut quiet) {
            match control.order(Duration::ZERO) {
                Some(DriverOrder::Close) => return Ok(()),
                Some(DriverOrder::Finish) => finished = true,
                Some(DriverOrder::Go) | None => {}
            }
        } else {
            quiet = idle(stage, setup, due_ns);
        }
        if finished && !std::mem::replace(&mut reported, true) {
            control.report(&latencies_ns)?;
        }
    }
}

/// Waits by the policy of the setup; true when there is time to check for orders of the driver.
fn idle(stage: &mut dyn ChainStage, setup: &Setup, due_ns: u64) -> bool {
    let before = monotonic_ns();
    wait(stage, setup.policy, due_ns);
    monotonic_ns() - before > MAX_WAIT_NS / 3
}

/// Waits once, for a message that is due at `due_ns`; the caller checks whether there is one.
fn wait(stage: &mut dyn ChainStage, policy: WaitPolicy, due_ns: u64) {
    let now = monotonic_ns();
    if policy == WaitPolicy::Block || due_ns == 0 || now > due_ns + 1000 * POLL_US {
        return stage.block(None);
    }
    let early = due_ns.saturating_sub(1000 * POLL_US);
    if now < early {
        return stage.block(Some(early - now));
    }
    while !stage.poll() && monotonic_ns() < due_ns + 1000 * POLL_US {
        std::thread::yield_now();
    }
}
