//! A person who drives straight on for some scans, and hands back to the controller.

use faults::PersonFault;
use shared_types::{Directive, DrivenBy, GivenControl};

use crate::course::BY_HAND_MPS;

/// The person of a drive.
#[derive(Debug, Clone, Default)]
pub(super) struct Person {
    /// Scans since it took over.
    scans: u64,
    /// Scans until the controller drives again.
    hands_back: u64,
    /// What it asked for last.
    given: GivenControl,
    /// What is wrong with what it asks for.
    pub(super) fault: Option<PersonFault>,
}

impl Person {
    pub(super) fn new(hands_back: u64) -> Self {
        Self { hands_back, ..Self::default() }
    }

    /// What the directive tells before the scan at `now_ns`; `None` once the controller drives again.
    pub(super) fn asks(&mut self, now_ns: u64) -> Option<Directive> {
        self.scans += 1;
        if self.scans > self.hands_back + 1 {
            return None;
        }
        let driven_by = if self.scans > self.hands_back { DrivenBy::Controller } else { DrivenBy::Person };
        match &self.fault {
            None => self.give(now_ns),
            Some(PersonFault { delay_ms: Some(delay_ms), .. }) => {
                self.give(now_ns.saturating_sub(delay_ms * 1_000_000));
            }
            Some(_) => {}
        }
        Some(Directive { driven_by: driven_by.wire(), person: self.given, ..Directive::default() })
    }

    fn give(&mut self, given_ns: u64) {
        let number = self.given.number + 1;
        self.given = GivenControl { number, given_ns, velocity_mps: BY_HAND_MPS, steering_rad: 0.0 };
    }
}
