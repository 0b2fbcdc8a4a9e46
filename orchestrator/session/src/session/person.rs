//! A person who takes over: pauses the drive, drives by hand, and hands back.
//!
//! The directive says who drives, and what a person asks for. The controller limits and verifies that, and the actuator
//! turns the wheels by nothing else. Nothing but a request gives the wheels back to the controller: not the end of the
//! person's program, nor another orchestrator.

use audit::samples::Samples;
use runtime::monotonic_ns;
use shared_types::{Actuation, BlockReason, Directive, DrivenBy, GivenControl, StopReason};
use supervision::directives::Directives;

use super::recording::Recording;
use super::{Run, Session};
use crate::control::{Reply, Request};

/// Another person may take over after this time of silence [ns].
const SILENT_NS: u64 = 1_000_000_000;
/// A robot that is slower stands, by its estimate [m/s].
const STANDING_MPS: f64 = 0.02;

/// A controller whose commands are not of a person for so many scans in a row knows of none.
const MAX_UNHEARD_SCANS: u64 = 10;

/// What a person is told then.
const UNHEARD: &str = "the controller of this system does not drive by hand: its commands are not of level `person`, so the \
                       wheels stay blocked; `scanloop swap` puts in another one";

/// The person who drives by hand.
#[derive(Debug, Clone, Default)]
pub(super) struct Person {
    /// Its number; 0 for none.
    number: u64,
    /// Numbers given to persons.
    persons: u64,
    /// When it asked for something last [ns].
    asked_ns: u64,
    /// Controls that were given.
    controls: u64,
    /// In lock-step: the scan that its last control is for.
    granted_scan: u64,
    /// The newest scan when the controller was seen to follow it last, or it began to drive.
    heard_scan: u64,
}

impl Person {
    /// Passes for the person who drives, also while it holds the wheels.
    ///
    /// # Errors
    /// For any other one.
    fn require(&self, number: u64) -> Result<(), String> {
        if number != 0 && number == self.number {
            return Ok(());
        }
        Err("this person does not drive any more: paused, resumed, or another one took over".to_owned())
    }

    /// In lock-step: whether the scan of the control before is still to come. One turn of the loop takes several requests
    /// and grants scans after them, so a control that was taken counts before its scan is granted.
    fn awaits_scan(&self, recorded_scan: u64, directive: &Directive) -> bool {
        let given_scan = if directive.person.number == 0 { 0 } else { self.granted_scan };
        recorded_scan < directive.granted_scan.max(given_scan)
    }
}

/// The parts of a session that a person concerns.
pub(super) struct PersonParts<'s> {
    pub(super) run: &'s Run,
    pub(super) recording: &'s Recording,
    pub(super) samples: &'s Samples,
    pub(super) directives: &'s mut Directives,
    pub(super) person: &'s mut Person,
}

impl PersonParts<'_> {
    /// Carries out what a person asks for; with what the user is told.
    ///
    /// # Errors
    /// Why it is refused.
    pub(super) fn answer(&mut self, request: &Request) -> Result<(Reply, Option<&'static str>), String> {
        match *request {
            Request::Pause => Ok((Reply::Done, Some(self.pause()))),
            Request::Resume => self.resume().map(|text| (Reply::Done, Some(text))),
            Request::Teleop => {
                let reply = self.take_over()?;
                Ok((reply, Some("a person drives by hand: `scanloop resume` hands back to the controller")))
            }
            Request::Hold { person, ends } => self.hold(person, ends).map(|text| (Reply::Done, Some(text))),
            Request::Control { person, velocity_mps, steering_rad, given_ns } => {
                self.control(person, [velocity_mps, steering_rad], given_ns).map(|reply| (reply, None))
            }
            _ => Err("this is no request of a person".to_owned()),
        }
    }

    /// Lets nobody drive; returns what the user is told.
    fn pause(&mut self) -> &'static str {
        self.person.number = 0;
        self.directives.let_drive(DrivenBy::Nobody);
        "paused: the wheels are blocked until `scanloop resume`"
    }

    /// Lets the controller drive again; returns what the user is told.
    ///
    /// # Errors
    /// When it does already.
    fn resume(&mut self) -> Result<&'static str, String> {
        if self.directives.current.driven_by == DrivenBy::Controller.wire() {
            return Err("the controller drives already".to_owned());
        }
        self.person.number = 0;
        self.directives.let_drive(DrivenBy::Controller);
        Ok("resumed: the controller drives")
    }

    /// Lets a person drive, unless another one does.
    ///
    /// # Errors
    /// When another one does.
    fn take_over(&mut self) -> Result<Reply, String> {
        let person = &mut self.person;
        if person.number != 0 && monotonic_ns().saturating_sub(person.asked_ns) < SILENT_NS {
            return Err("another person drives: wait until that one is silent for a second".to_owned());
        }
        person.persons += 1;
        (person.number, person.asked_ns) = (person.persons, monotonic_ns());
        person.heard_scan = self.samples.newest_scan();
        self.directives.let_drive(DrivenBy::Person);
        let Run { period_ns, lockstep, .. } = *self.run;
        Ok(Reply::Teleop { person: person.number, period_ns, lockstep })
    }

    /// Blocks the wheels until the person who drives asks for a control, or for good when it `ends`; returns what the user
    /// is told.
    ///
    /// # Errors
    /// When it does not drive.
    fn hold(&mut self, number: u64, ends: bool) -> Result<&'static str, String> {
        self.person.require(number)?;
        if ends {
            return Ok(self.pause());
        }
        self.person.asked_ns = monotonic_ns();
        self.directives.let_drive(DrivenBy::Nobody);
        Ok("paused: the wheels are blocked until the person drives on, or `scanloop resume`")
    }

    /// Hands on what a person asks for.
    ///
    /// # Errors
    /// When it does not drive, and for what is no number or too old; in lock-step time stands until it is taken.
    fn control(&mut self, number: u64, [v, steering]: [f64; 2], at_ns: u64) -> Result<Reply, String> {
        let (now_ns, person) = (monotonic_ns(), &mut self.person);
        person.require(number)?;
        if !(v.is_finite() && steering.is_finite()) {
            return Err(format!("velocity = {v} and steering = {steering} are not allowed: numbers"));
        }
        let valid_ns = GivenControl::valid_ns(self.run.period_ns);
        let age_ns = now_ns.saturating_sub(at_ns);
        if at_ns > now_ns || !self.run.lockstep && age_ns > valid_ns {
            let [age, limit] = [age_ns, valid_ns].map(|ns| ns as f64 * 1e-6);
            return Err(format!("it was asked for {age:.0} ms ago, at most {limit:.0} ms are allowed"));
        }
        person.asked_ns = now_ns;
        let newest = self.samples.newest_scan();
        if !self.recording.recorder.last_actuation().is_some_and(is_unheard) {
            person.heard_scan = newest;
        } else if newest > person.heard_scan + MAX_UNHEARD_SCANS {
            return Err(UNHEARD.to_owned());
        }
        let mut given_ns = at_ns;
        if self.run.lockstep {
            // Each control is for one scan, which is published after it.
            let recorded = self.recording.recorder.last_pose().map(|pose| pose.header);
            let recorded = recorded.ok_or("the robot has no pose yet: try again")?;
            if person.awaits_scan(recorded.scan_id, &self.directives.current) {
                return Ok(Reply::Pending);
            }
            (given_ns, person.granted_scan) = (recorded.acquired_ns.max(1), recorded.scan_id + 1);
        }
        person.controls += 1;
        if self.directives.current.driven_by != DrivenBy::Person.wire() {
            self.directives.let_drive(DrivenBy::Person);
        }
        self.directives.current.person =
            GivenControl { number: person.controls, given_ns, velocity_mps: v, steering_rad: steering };
        self.directives.changed = true;
        Ok(Reply::Accepted(newest))
    }
}

/// Whether the wheels are blocked because a person drives, and the command is not one of a person: it drives by itself, or
/// stops because the drive is paused for it.
fn is_unheard(actuation: &Actuation) -> bool {
    let is_paused =
        actuation.reason == BlockReason::Paused.wire() || actuation.stop_reason == StopReason::Paused.wire();
    actuation.driven_by == DrivenBy::Person.wire() && is_paused
}

impl Session {
    /// Who drives.
    pub(super) fn driven_by(&self) -> DrivenBy {
        DrivenBy::try_from(self.directives.current.driven_by).unwrap_or(DrivenBy::Nobody)
    }

    /// After an emergency stop from outside nobody drives: the controller does not drive on when the button is released.
    pub(super) fn notice_emergency(&mut self) {
        self.person.number = 0;
        if self.driven_by() != DrivenBy::Nobody {
            self.directives.let_drive(DrivenBy::Nobody);
            self.warn("emergency stop: pressed or silent; once it is released, `scanloop resume` drives on");
        }
    }

    /// After an adoption nobody drives who was not the controller: a person has to ask anew.
    pub(crate) fn resume_driver(&mut self, driven_by: u32) {
        if driven_by != DrivenBy::Controller.wire() {
            self.directives.let_drive(DrivenBy::Nobody);
        }
    }

    /// In lock-step: up to which scan of `scan` is granted. While nobody drives, time stands once the robot does; a person
    /// gets one scan for each control.
    pub(super) fn may_be_granted(&self, scan: u64) -> u64 {
        match self.driven_by() {
            DrivenBy::Controller => scan,
            DrivenBy::Person => scan.min(self.person.granted_scan),
            DrivenBy::Nobody if self.is_standing() => 0,
            DrivenBy::Nobody => scan,
        }
    }

    /// Tells when a robot that stands, and that the controller does not drive, was moved.
    ///
    /// # Errors
    /// Errors of the bus.
    pub(super) fn notice_moved(&mut self) -> anyhow::Result<()> {
        if !self.drives() || self.driven_by() == DrivenBy::Controller {
            self.moved.end();
            return Ok(());
        }
        let stands = self.is_standing();
        if let Some(share) = self.moved.look(&self.bus, stands)? {
            let percent = share * 100.0;
            self.warn(&format!(
                "the robot was moved while it stood: {percent:.0} % of the scanner's beams changed, and its wheels did not \
                 turn; its pose may be wrong, `scanloop resume` drives by it"
            ));
        }
        Ok(())
    }

    fn is_standing(&self) -> bool {
        let recorder = &self.recording.recorder;
        let is_slow = recorder.last_pose().is_some_and(|pose| pose.speed_mps.abs() < STANDING_MPS);
        is_slow && recorder.last_actuation().is_some_and(|actuation| !actuation.drives())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_the_controls_in_one_turn_of_the_loop_each_waits_for_the_scan_of_the_one_before() {
        let mut person = Person::default();
        let mut directive = Directive { granted_scan: 5, ..Directive::default() };
        assert!(person.awaits_scan(4, &directive) && !person.awaits_scan(5, &directive));
        // One is taken for scan 6, which is granted at the end of the turn.
        person.granted_scan = 6;
        directive.person.number = 1;
        assert!(person.awaits_scan(5, &directive), "the next one in the same turn");
        directive.granted_scan = 6;
        assert!(person.awaits_scan(5, &directive) && !person.awaits_scan(6, &directive));
        // What was asked for is forgotten, as by a pause, before its scan was granted: another may be given.
        (directive.granted_scan, directive.person.number) = (5, 0);
        assert!(!person.awaits_scan(5, &directive));
    }
}
