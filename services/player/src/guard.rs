//! The guard: a process that owns the sending end of the connection, and stops the wheels when the driver is silent.
//!
//! Stage and many drivers of Player follow the last command for ever. So the driver never writes commands itself. Its
//! guard does, and sends a stop when no order has come for two scan periods, or when the driver has ended. The guard
//! does nothing else, so little can fail in it. If it fails, the driver notices that it ended or no longer answers,
//! sends the stop itself and closes the connection. When both are killed, the server sees the closed connection.

mod process;

pub use process::run;

use crate::command::ClientMessage;
use crate::order::{Base, Frame, GuardAnswer, GuardOrder};

/// The decisions of the guard, without clock and sockets.
#[derive(Debug, Clone, PartialEq)]
pub struct Guard {
    base: Base,
    timeout_ns: u64,
    /// When the wheels have to be stopped; `None` while they are [ns].
    stop_at_ns: Option<u64>,
    answer: GuardAnswer,
}

impl Guard {
    /// A guard of a base that does not move yet.
    pub fn new(base: Base, timeout_ns: u64) -> Self {
        Self { base, timeout_ns, stop_at_ns: None, answer: GuardAnswer::default() }
    }

    /// Follows an order that is read at `now_ns`: appends the messages to send.
    ///
    /// An order to drive that has waited too long, because this process was suspended, is not followed.
    pub fn follow(&mut self, frame: &Frame, now_ns: u64, bytes: &mut Vec<u8>) -> GuardAnswer {
        self.answer.number = frame.number;
        let stop_at_ns = frame.given_ns.saturating_add(self.timeout_ns);
        match frame.order {
            GuardOrder::Drive(numbers)
                if now_ns < stop_at_ns && numbers.iter().all(|number| number.is_finite()) =>
            {
                self.base.drive(numbers).write(bytes, 0.0, 0);
                self.stop_at_ns = Some(stop_at_ns);
            }
            GuardOrder::Drive(_) => _ = self.check(now_ns, bytes),
            GuardOrder::Stop => {
                self.base.stop(bytes);
                self.stop_at_ns = None;
            }
            GuardOrder::Round => ClientMessage::Round.write(bytes, 0.0, 0),
            GuardOrder::Guard(..) => {}
        }
        self.answer
    }

    /// Stops the wheels when the driver has been silent for too long: appends the messages to send. `None` when it has
    /// not.
    pub fn check(&mut self, now_ns: u64, bytes: &mut Vec<u8>) -> Option<GuardAnswer> {
        self.stop_at_ns.filter(|stop_at_ns| now_ns >= *stop_at_ns)?;
        self.base.stop(bytes);
        self.stop_at_ns = None;
        self.answer.stops += 1;
        Some(self.answer)
    }

    /// How long nothing has to be done [ns]; `None` while the wheels are stopped.
    pub fn rest_ns(&self, now_ns: u64) -> Option<u64> {
        self.stop_at_ns.map(|stop_at_ns| stop_at_ns.saturating_sub(now_ns))
    }

    /// Appends the messages that stop the wheels, whatever was ordered.
    pub fn stop(&mut self, bytes: &mut Vec<u8>) {
        self.base.stop(bytes);
        self.stop_at_ns = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DriveCommand;

    const TIMEOUT_NS: u64 = 200;
    const BASE: Base = Base { index: 0, command: DriveCommand::Car };

    fn order(given_ns: u64, order: GuardOrder) -> Frame {
        Frame { number: given_ns, given_ns, order }
    }

    fn messages(write: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
        let mut bytes = Vec::new();
        write(&mut bytes);
        bytes
    }

    #[test]
    fn the_wheels_are_stopped_once_after_a_silence_and_turn_with_the_next_order() {
        let mut guard = Guard::new(BASE, TIMEOUT_NS);
        let stop = messages(|bytes| BASE.stop(bytes));
        let drive = messages(|bytes| BASE.drive([0.5, 0.1]).write(bytes, 0.0, 0));
        for start_ns in [1000, 5000] {
            let frame = order(start_ns, GuardOrder::Drive([0.5, 0.1]));
            assert_eq!(messages(|bytes| _ = guard.follow(&frame, start_ns + 10, bytes)), drive);
            assert_eq!(guard.rest_ns(start_ns + 10), Some(190));
            assert_eq!(messages(|bytes| assert_eq!(guard.check(start_ns + 199, bytes), None)), []);
            assert_eq!(messages(|bytes| assert!(guard.check(start_ns + 200, bytes).is_some())), stop);
            assert_eq!(messages(|bytes| assert_eq!(guard.check(start_ns + 900, bytes), None)), []);
            assert_eq!(guard.rest_ns(start_ns + 900), None);
        }
        assert_eq!(guard.answer, GuardAnswer { number: 5000, stops: 2 });
    }

    #[test]
    fn an_old_order_is_not_followed_and_an_earlier_one_still_ends() {
        let mut guard = Guard::new(BASE, TIMEOUT_NS);
        let old = order(1000, GuardOrder::Drive([0.5, 0.0]));
        assert_eq!(messages(|bytes| _ = guard.follow(&old, 1200, bytes)), []);
        guard.follow(&order(2000, GuardOrder::Drive([0.5, 0.0])), 2000, &mut Vec::new());
        let late = order(2100, GuardOrder::Drive([0.9, 0.0]));
        assert_eq!(
            messages(|bytes| _ = guard.follow(&late, 2300, bytes)),
            messages(|bytes| BASE.stop(bytes))
        );
    }

    #[test]
    fn numbers_that_are_none_are_not_sent() {
        let mut guard = Guard::new(BASE, TIMEOUT_NS);
        let broken = order(1, GuardOrder::Drive([f64::NAN, 0.0]));
        assert_eq!(messages(|bytes| _ = guard.follow(&broken, 1, bytes)), []);
        assert_eq!(guard.rest_ns(1), None);
    }

    #[test]
    fn an_ordered_stop_is_no_silence() {
        let mut guard = Guard::new(BASE, TIMEOUT_NS);
        guard.follow(&order(1, GuardOrder::Drive([0.5, 0.0])), 1, &mut Vec::new());
        let stopped = messages(|bytes| _ = guard.follow(&order(2, GuardOrder::Stop), 2, bytes));
        assert_eq!((stopped, guard.answer.stops), (messages(|bytes| BASE.stop(bytes)), 0));
        assert_eq!(guard.check(10_000, &mut Vec::new()), None);
    }
}
