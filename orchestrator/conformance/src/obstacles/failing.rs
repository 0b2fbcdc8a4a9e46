//! A test bench whose scanner fails: what it would return then replaces the ranges of the recorded scans.

use std::sync::Arc;

use emulator::Scenario;
use emulator::scenario::Scanner;
use shared_types::{Header, Obstacles, Scan};

use super::covers_the_box;
use crate::case::{Tried, failed, observed, require};
use crate::drive::Course;
use crate::suite::Suite;
use crate::test_bench::TestBench;
use crate::vehicle::SuiteVehicle;

/// The scanner fails when the robot is here: 1.7 m before the box [m].
pub(super) const ONSET_M: f64 = 3.3;
/// The box is known from this many scans then.
const SIGHTINGS: u64 = 20;
/// A fault lasts for this long [s].
pub(super) const FAULT_S: f64 = 2.0;
/// Scans before the fault of a robot that rests.
const RESTING_SCANS: u64 = 5;

/// A test bench with the ranges of a scanner that fails.
pub(super) struct Failing<'a> {
    bench: TestBench<'a>,
    /// The first scan with the fault.
    pub(super) onset: u64,
}

impl<'a> Failing<'a> {
    /// A bench whose scanner has a fault for [`FAULT_S`], from [`ONSET_M`] on.
    pub(super) fn at_the_box(suite: &'a Suite, fault: impl FnOnce(&mut Scanner)) -> Tried<Self> {
        Self::with(suite, |scenario, onset_s| {
            fault(&mut scenario.scanner);
            scenario.scanner.from_s = onset_s;
            scenario.scanner.to_s = Some(onset_s + FAULT_S);
        })
    }

    /// A bench that begins with the scans in which the box becomes known; `change` gets the time of the onset [s].
    pub(super) fn with(suite: &'a Suite, change: impl FnOnce(&mut Scenario, f64)) -> Tried<Self> {
        let onset = suite.drive(Course::Corridor)?.scan_at(ONSET_M);
        Self::new(suite, Course::Corridor, onset.saturating_sub(SIGHTINGS).max(1), onset, change)
    }

    /// A bench along the whole drive around the box, whose scanner has a fault from the start.
    pub(super) fn from_the_start(suite: &'a Suite, fault: impl FnOnce(&mut Scanner)) -> Tried<Self> {
        Self::new(suite, Course::Corridor, 1, 1, |scenario, _| fault(&mut scenario.scanner))
    }

    /// A bench whose robot rests before a barrier, with a fault after some scans.
    pub(super) fn at_rest(suite: &'a Suite, fault: impl FnOnce(&mut Scanner)) -> Tried<Self> {
        let drive = suite.drive(Course::Barrier)?;
        let first_scan = drive.scan_beyond(drive.step(drive.ended as u64).truth.x_m - 1e-3);
        let onset = first_scan + RESTING_SCANS;
        let mut failing = Self::new(suite, Course::Barrier, first_scan, onset, |scenario, onset_s| {
            fault(&mut scenario.scanner);
            scenario.scanner.from_s = onset_s;
        })?;
        let last = failing.play_before()?;
        observed(!failing.stops(&last), || format!("state `{}` at rest before the fault", state(&last)))?;
        Ok(failing)
    }

    /// A bench of a course from a scan on; `change` gets the time of the scan `onset` [s].
    fn new(
        suite: &'a Suite,
        course: Course,
        first_scan: u64,
        onset: u64,
        change: impl FnOnce(&mut Scenario, f64),
    ) -> Tried<Self> {
        let drive = suite.drive(course)?;
        let onset_s = drive.step(onset).scan.header.acquired_ns as f64 * 1e-9;
        let rescanned = drive.rescanned(|scenario| change(scenario, onset_s));
        let mut bench = suite.started_on(course, first_scan)?;
        bench.drive = Arc::new(rescanned.starting_at(first_scan));
        Ok(Self { bench, onset: onset - first_scan + 1 })
    }

    /// Plays the scans before the onset, after which the box must be known; returns the last answer.
    pub(super) fn before(&mut self) -> Tried<Obstacles> {
        let described = self.play_before()?;
        let vehicle = &self.bench.suite.vehicle;
        require(
            described.list().iter().any(|item| covers_the_box(vehicle, item)),
            || "the box was never reported",
        )?;
        require(!self.stops(&described), || format!("state `{}` before the fault", state(&described)))?;
        Ok(described)
    }

    /// Whether the robot is stopped because of its scanner.
    fn stops(&self, described: &Obstacles) -> bool {
        stops(&self.bench.suite.vehicle, described)
    }

    fn play_before(&mut self) -> Tried<Obstacles> {
        let mut described = self.round()?;
        while self.bench.scan_id < self.onset {
            described = self.round()?;
        }
        Ok(described)
    }

    /// Plays for some time; `check` gets each answer, and the time since the first of them [s].
    ///
    /// Returns this time and the header of the first answer that stops the robot.
    pub(super) fn play(
        &mut self,
        duration_s: f64,
        mut check: impl FnMut(&Obstacles, f64) -> Tried,
    ) -> Tried<Option<(f64, Header)>> {
        let period_ns = self.bench.suite.period_ns;
        let mut first_stop = None;
        for scan in 0..(duration_s * 1e9 / period_ns as f64).round() as u64 {
            let described = self.round()?;
            let since_s = (scan * period_ns) as f64 * 1e-9;
            first_stop = first_stop.or_else(|| self.stops(&described).then_some((since_s, described.header)));
            check(&described, since_s)?;
        }
        Ok(first_stop)
    }

    /// The answer to the next scan.
    pub(super) fn round(&mut self) -> Tried<Obstacles> {
        self.round_with(|_| {})
    }

    /// The answer to the next scan, which is changed.
    pub(super) fn round_with(&mut self, change: impl Fn(&mut Scan)) -> Tried<Obstacles> {
        let answer = self.bench.round_with(|message| message.change(&change))?;
        if let Err(fault) = answer.check() {
            return failed(format!("scan {}: {fault}", answer.scan_id()));
        }
        answer.sample().copied()
    }
}

/// Whether the robot is stopped because of its scanner: with no more seen ahead than its front it must not drive.
pub(super) fn stops(vehicle: &SuiteVehicle, described: &Obstacles) -> bool {
    described.scanner.state().is_stop() || described.scanner.seen_ahead_m <= vehicle.ahead_m(0.0)
}

/// Name of the scanner's state.
pub(super) fn state(described: &Obstacles) -> &'static str {
    described.scanner.state().name()
}
