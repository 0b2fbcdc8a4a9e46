//! The guard: a process that owns the sending end of the connection, and stops the wheels when the driver is silent.
//!
//! Many robots follow the last command for ever. So the driver never writes commands itself. Its guard does, and sends a
//! stop when no order has come for two scan periods, or when the driver has ended. The guard does nothing else, so little
//! can fail in it. If it fails, the driver notices that it ended or no longer answers, and sends the stop itself.

mod held;
mod process;

pub use held::{GuardFault, Held, Orders};
pub use process::{Commands, run};

use crate::order::{Frame, GuardAnswer, GuardOrder};

/// What a guard sends to the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GuardAct {
    /// Drive, with the numbers of the command.
    Drive([f64; 2]),
    /// Stop the wheels.
    Stop,
    /// Ask for a round of data.
    Round,
    /// Stamp commands by this clock from now on [s].
    Offset(f64),
}

/// The decisions of the guard, without clock and sockets.
#[derive(Debug, Clone, PartialEq)]
pub struct Guard {
    timeout_ns: u64,
    /// When the wheels have to be stopped; `None` while they are [ns].
    stop_at_ns: Option<u64>,
    answer: GuardAnswer,
}

impl Guard {
    /// A guard of wheels that do not turn yet.
    pub fn new(timeout_ns: u64) -> Self {
        Self { timeout_ns, stop_at_ns: None, answer: GuardAnswer::default() }
    }

    /// Follows an order that is read at `now_ns`: the answer, and what is to be sent.
    ///
    /// An order to drive that has waited too long, because this process was suspended, is not followed.
    pub fn follow(&mut self, frame: &Frame, now_ns: u64) -> (GuardAnswer, Option<GuardAct>) {
        self.answer.number = frame.number;
        let stop_at_ns = frame.given_ns.saturating_add(self.timeout_ns);
        let act = match frame.order {
            GuardOrder::Drive(numbers)
                if now_ns < stop_at_ns && numbers.iter().all(|number| number.is_finite()) =>
            {
                self.stop_at_ns = Some(stop_at_ns);
                Some(GuardAct::Drive(numbers))
            }
            GuardOrder::Drive(_) => self.check(now_ns).map(|_| GuardAct::Stop),
            GuardOrder::Stop => {
                self.stop_at_ns = None;
                Some(GuardAct::Stop)
            }
            GuardOrder::Round => Some(GuardAct::Round),
            GuardOrder::Offset(seconds) => seconds.is_finite().then_some(GuardAct::Offset(seconds)),
            GuardOrder::Guard(..) => None,
        };
        (self.answer, act)
    }

    /// The answer when the driver has been silent for too long, so that the wheels have to be stopped now.
    pub fn check(&mut self, now_ns: u64) -> Option<GuardAnswer> {
        self.stop_at_ns.filter(|stop_at_ns| now_ns >= *stop_at_ns)?;
        self.stop_at_ns = None;
        self.answer.stops += 1;
        Some(self.answer)
    }

    /// How long nothing has to be done [ns]; `None` while the wheels are stopped.
    pub fn rest_ns(&self, now_ns: u64) -> Option<u64> {
        self.stop_at_ns.map(|stop_at_ns| stop_at_ns.saturating_sub(now_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIMEOUT_NS: u64 = 200;
    const NUMBERS: [f64; 2] = [0.5, 0.1];

    fn order(given_ns: u64, order: GuardOrder) -> Frame {
        Frame { number: given_ns, given_ns, order }
    }

    #[test]
    fn the_wheels_are_stopped_once_after_a_silence_and_turn_with_the_next_order() {
        let mut guard = Guard::new(TIMEOUT_NS);
        for start_ns in [1000, 5000] {
            let frame = order(start_ns, GuardOrder::Drive(NUMBERS));
            assert_eq!(guard.follow(&frame, start_ns + 10).1, Some(GuardAct::Drive(NUMBERS)));
            assert_eq!(guard.rest_ns(start_ns + 10), Some(190));
            assert_eq!(guard.check(start_ns + 199), None);
            assert!(guard.check(start_ns + 200).is_some());
            assert_eq!(guard.check(start_ns + 900), None);
            assert_eq!(guard.rest_ns(start_ns + 900), None);
        }
        assert_eq!(guard.answer, GuardAnswer { number: 5000, stops: 2 });
    }

    #[test]
    fn an_old_order_is_not_followed_and_an_earlier_one_still_ends() {
        let mut guard = Guard::new(TIMEOUT_NS);
        assert_eq!(guard.follow(&order(1000, GuardOrder::Drive(NUMBERS)), 1200).1, None);
        guard.follow(&order(2000, GuardOrder::Drive(NUMBERS)), 2000);
        assert_eq!(guard.follow(&order(2100, GuardOrder::Drive(NUMBERS)), 2300).1, Some(GuardAct::Stop));
    }

    #[test]
    fn numbers_that_are_none_are_not_sent() {
        let mut guard = Guard::new(TIMEOUT_NS);
        assert_eq!(guard.follow(&order(1, GuardOrder::Drive([f64::NAN, 0.0])), 1).1, None);
        assert_eq!(guard.follow(&order(2, GuardOrder::Offset(f64::NAN)), 2).1, None);
        assert_eq!(guard.rest_ns(1), None);
    }

    #[test]
    fn an_ordered_stop_is_no_silence() {
        let mut guard = Guard::new(TIMEOUT_NS);
        guard.follow(&order(1, GuardOrder::Drive(NUMBERS)), 1);
        let (answer, act) = guard.follow(&order(2, GuardOrder::Stop), 2);
        assert_eq!((act, answer.stops), (Some(GuardAct::Stop), 0));
        assert_eq!(guard.check(10_000), None);
    }
}
