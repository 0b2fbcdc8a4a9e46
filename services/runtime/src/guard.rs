//! Whether the wheels of this run may turn, and the filter of actuations at the ports when they may not.
//!
//! Two things forbid it: the stop word, for good, and missing directives for `orphan_stop_s`, until one comes. A
//! process that reads its directive sees both as `stop`. Whatever the process does then, an actuator's port sends no
//! actuation that drives, and a robot's port delivers none.

use std::cell::Cell;

use shared_types::{Actuation, Role, SampleType, Topic};

use crate::stop::{StopWord, Wheels};

/// Stop and wheels as one process knows them.
#[derive(Debug)]
pub(crate) struct Guard {
    role: Role,
    word: Option<StopWord>,
    /// No directive came for too long.
    silent: Cell<bool>,
    wheels: Cell<Wheels>,
}

impl Guard {
    pub(crate) fn new(role: Role, word: Option<StopWord>) -> Self {
        Self { role, word, silent: Cell::new(false), wheels: Cell::new(Wheels::Unknown) }
    }

    /// The stop word, if it was handed to this process.
    pub(crate) fn word(&self) -> Option<StopWord> {
        self.word.clone()
    }

    /// Whether wheels must be blocked now.
    pub(crate) fn must_stop(&self) -> bool {
        self.silent.get() || self.is_latched()
    }

    /// Whether the run was stopped for good.
    pub(crate) fn is_latched(&self) -> bool {
        self.word.as_ref().is_some_and(|word| !word.is_armed())
    }

    /// Notes whether no directive came for too long.
    pub(crate) fn set_silent(&self, silent: bool) {
        if self.silent.replace(silent) != silent && matches!(self.role, Role::Robot | Role::Actuator) {
            let what = if silent { "no directives: wheels are blocked" } else { "directives arrive again" };
            tracing::warn!("{what}");
        }
    }

    /// Notes what the wheels do; [`Guard::publish_wheels`] writes it into the page of the stop word.
    pub(crate) fn set_wheels(&self, wheels: Wheels) {
        self.wheels.set(wheels);
    }

    /// Writes into the page of the stop word what the wheels do: only the process in charge may.
    pub(crate) fn publish_wheels(&self) {
        if let Some(word) = &self.word
            && self.wheels.get() != Wheels::Unknown
        {
            word.report(self.role, self.wheels.get());
        }
    }

    /// Whether samples of this type tell wheels what to do.
    pub(crate) fn concerns(&self, of: &SampleType) -> bool {
        of.topic == Topic::Actuation
    }

    /// Whether a process reads a sample of this type as a record of what the wheels did, which stays true; to the robot it
    /// is a request.
    pub(crate) fn is_record(&self, of: &SampleType) -> bool {
        self.concerns(of) && self.role != Role::Robot
    }

    /// Turns an actuation that would drive into a block while wheels must not turn; whether it did.
    pub(crate) fn hold_back(&self, of: &SampleType, sample: &mut [u8]) -> bool {
        let actuation = if self.concerns(of) { bytemuck::try_from_bytes_mut(sample).ok() } else { None };
        actuation.is_some_and(|actuation| self.hold_back_actuation(actuation))
    }

    fn hold_back_actuation(&self, actuation: &mut Actuation) -> bool {
        let is_held_back = actuation.drives() && self.must_stop();
        if is_held_back {
            actuation.hold_back();
        }
        self.set_wheels(if actuation.drives() { Wheels::Turning } else { Wheels::Blocked });
        is_held_back
    }

    /// Whether a robot must not receive a sample: it would drive, and wheels must not turn.
    pub(crate) fn refuses(&self, of: &SampleType, sample: &[u8]) -> bool {
        let drives = |sample| bytemuck::try_from_bytes::<Actuation>(sample).is_ok_and(Actuation::drives);
        self.concerns(of) && self.role == Role::Robot && drives(sample) && self.must_stop()
    }
}

#[cfg(test)]
mod tests {
    use shared_types::{ActuationKind, BlockReason, Sample};

    use super::*;

    fn drive() -> Actuation {
        Actuation {
            kind: ActuationKind::Drive.wire(),
            desired_velocity_mps: 1.0,
            sent_velocity_mps: 1.4,
            sent_steering_rad: 0.05,
            ..Actuation::default()
        }
    }

    #[test]
    fn what_would_drive_is_made_a_block_that_keeps_its_angle() {
        let word = StopWord::create("guardtesta", 1).unwrap();
        let guard = Guard::new(Role::Actuator, Some(word.clone()));
        assert!(guard.word().is_some());
        let mut actuation = drive();
        guard.hold_back_actuation(&mut actuation);
        assert_eq!(actuation.kind, ActuationKind::Drive.wire());
        word.latch();
        guard.hold_back_actuation(&mut actuation);
        assert_eq!(actuation.kind, ActuationKind::Block.wire());
        assert_eq!(actuation.reason, BlockReason::StopRequested.wire());
        assert_eq!((actuation.sent_velocity_mps, actuation.desired_velocity_mps), (0.0, 0.0));
        assert_eq!(actuation.sent_steering_rad, 0.05);
        guard.publish_wheels();
        assert_eq!(word.wheels(Role::Actuator).0, Wheels::Blocked);
    }

    #[test]
    fn a_robot_sees_no_actuation_that_drives_while_wheels_must_not_turn() {
        let guard = Guard::new(Role::Robot, None);
        assert!(!guard.refuses(Actuation::TYPE, bytemuck::bytes_of(&drive())));
        guard.set_silent(true);
        assert!(
            guard.refuses(Actuation::TYPE, bytemuck::bytes_of(&drive()))
                && !guard.refuses(Actuation::TYPE, bytemuck::bytes_of(&Actuation::default()))
        );
        guard.set_silent(false);
        assert!(
            !guard.refuses(Actuation::TYPE, bytemuck::bytes_of(&drive())),
            "a silence ends, other than a stop"
        );
        assert!(!Guard::new(Role::Estimator, None).refuses(Actuation::TYPE, bytemuck::bytes_of(&drive())));
    }
}
