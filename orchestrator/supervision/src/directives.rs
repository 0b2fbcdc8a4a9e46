//! The directive to all processes: published when it changes, and from time to time for processes that missed it.

use runtime::{Bus, Publisher, RuntimeError};
use shared_types::{Directive, DrivenBy, GivenControl, Phase};

/// Time between two publications of an unchanged directive [ns].
const REPEAT_NS: u64 = 100_000_000;

/// The newest directive and its topic.
pub struct Directives {
    /// The newest directive; set [`Directives::changed`] after a change.
    pub current: Directive,
    /// Whether it is to be published without delay.
    pub changed: bool,
    publisher: Publisher<Directive>,
    published_ns: u64,
}

impl Directives {
    /// The first directive, to be published as this process's.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when the topic can't be opened.
    pub fn new(bus: &Bus, first: Directive) -> Result<Self, RuntimeError> {
        let current = Directive { orchestrator_pid: u64::from(std::process::id()), ..first };
        Ok(Self { current, changed: true, publisher: Publisher::new(bus)?, published_ns: 0 })
    }

    /// The wheels are to be blocked.
    pub fn stop(&mut self) {
        self.current.stop = 1;
        self.changed = true;
    }

    /// The system goes into a phase, never back.
    pub fn enter(&mut self, phase: Phase) {
        self.current.phase = self.current.phase.max(phase.wire());
        self.changed = true;
    }

    /// In lock-step the robot may publish scans up to this one.
    pub fn grant(&mut self, scan_id: u64) {
        if scan_id > self.current.granted_scan {
            self.current.granted_scan = scan_id;
            self.changed = true;
        }
    }

    /// Another drives from now on. What a person has asked for before counts no more.
    pub fn let_drive(&mut self, driven_by: DrivenBy) {
        self.current.driven_by = driven_by.wire();
        self.forget_person();
        self.changed = true;
    }

    /// What a person has asked for counts no more: it is asked for anew, of the processes that are in charge now.
    pub fn forget_person(&mut self) {
        self.current.person = GivenControl::default();
    }

    /// Whether it is to be published now.
    pub fn is_due(&self, now_ns: u64) -> bool {
        self.changed || now_ns.saturating_sub(self.published_ns) >= REPEAT_NS
    }

    /// Publishes it.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn publish(&mut self, now_ns: u64) -> Result<(), RuntimeError> {
        self.current.issued_ns = now_ns;
        self.publisher.publish(&mut self.current, self.changed)?;
        self.changed = false;
        self.published_ns = now_ns;
        Ok(())
    }
}
