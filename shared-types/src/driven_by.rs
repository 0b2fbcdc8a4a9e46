//! Who drives: the controller, a person, or nobody.

use crate::describe::layout;
use crate::named::wire_enum;
use crate::numbering::require;
use crate::{Fault, MAX_NUMBER, MAX_STAMP_NS, finite};

wire_enum! {
    /// Who drives the robot.
    pub enum DrivenBy {
        /// The controller, to its goal.
        Controller = 0 "controller",
        /// The drive is paused: wheels are blocked, and all processes stay ready.
        Nobody = 1 "nobody",
        /// A person, by what `GivenControl` says.
        Person = 2 "person",
    }
}

layout! {
    /// What a person who drives asks for. All zero where nothing was asked for.
    pub struct GivenControl(32) {
        /// Ascends with each that is given
        pub number: u64,
        /// When it was given [ns of the loop's clock]
        pub given_ns: u64,
        /// Velocity; below the smallest one of the robot it is to stand [m/s]
        pub velocity_mps: f64,
        /// Steering angle [rad]
        pub steering_rad: f64,
    }
}

impl GivenControl {
    /// A control that was given is valid so long: one and a half scan periods, as a command is, and at least 25 ms,
    /// because no hand is faster [ns].
    pub fn valid_ns(period_ns: u64) -> u64 {
        (period_ns + period_ns / 2).max(crate::YOUNG_NS)
    }

    /// Whether it asks for motion, and was given at most [`GivenControl::valid_ns`] before `now_ns`.
    pub fn is_fresh(&self, now_ns: u64, period_ns: u64) -> bool {
        self.number != 0 && now_ns.saturating_sub(self.given_ns) <= Self::valid_ns(period_ns)
    }

    pub(crate) fn check(&self) -> Result<(), Fault> {
        require("person.number", self.number, MAX_NUMBER)?;
        require("person.given_ns", self.given_ns, MAX_STAMP_NS)?;
        finite("person", &[self.velocity_mps, self.steering_rad])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_control_is_valid_for_a_period_and_a_half_and_at_least_25_ms() {
        let given = GivenControl { number: 1, given_ns: 1_000_000_000, ..GivenControl::default() };
        assert!(given.is_fresh(1_150_000_000, 100_000_000) && !given.is_fresh(1_150_000_001, 100_000_000));
        assert!(given.is_fresh(1_025_000_000, 1_000_000) && !given.is_fresh(1_025_000_001, 1_000_000));
        assert!(!GivenControl::default().is_fresh(0, 100_000_000), "none was given");
    }
}
