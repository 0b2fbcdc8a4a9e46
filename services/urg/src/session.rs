//! The conversation with a scanner, without input, output or clock.
//!
//! It begins with a pause in which pending bytes are dropped, and `QT`. The reply shows the state of the scanner: one in
//! SCIP 1.1 is switched to 2.0, one in time mode leaves it. Then come identification (`VV`, `PP`, `II`), ten round trips
//! for the time (`TM`), and the measurement (`BM`, `MD` or `MS`). When no scan comes for three periods, or a reply for a
//! second, it begins anew. After three attempts it asks for a new connection.

use std::f64::consts::TAU;
use std::fmt::Write as _;

use device_clock::{ClockEvent, ClockSettings, DeviceClock};
use shared_types::Scan;

use crate::UrgError;
use crate::command::{Measurement, ScipCommand};
use crate::identity::ScannerIdentity;
use crate::model::{SensorParameters, has_valid_sums};
use crate::parser::{Completed, Parser, ReplyFault};
use crate::place::ScannerConfig;
use crate::resampling::Resampling;
use crate::start::{Outcome, Step};
use crate::state::{Counters, Reading, SourceState};
use crate::status::ScipStatus;

/// Pause in which bytes of an earlier conversation are dropped: longer than a scan [ns].
const DRAIN_NS: u64 = 140_000_000;
/// A scanner answers a command within this time [ns].
const REPLY_NS: u64 = 1_000_000_000;
/// The first scan comes within this time: some models spin up first [ns].
const FIRST_SCAN_NS: u64 = 3_000_000_000;
/// A scanner with a fault is tried again after this time [ns].
const FAULT_NS: u64 = 1_000_000_000;
/// Periods without a scan after which the measurement is started anew.
const SILENT_PERIODS: u64 = 3;
/// Attempts on one connection.
const ATTEMPTS: u32 = 3;
/// Error bound of the smallest delay, if the scanner has no time mode [ns].
const DELAY_ERROR_NS: u64 = 20_000_000;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// There is no connection, or none that can be used.
    Off,
    Draining,
    Asking(Step),
    Measuring,
}

/// See the module.
#[derive(Debug)]
pub struct ScannerSession {
    config: ScannerConfig,
    parser: Parser,
    clock: Option<DeviceClock>,
    phase: Phase,
    /// When the phase has taken too long, or for a pause long enough [ns].
    deadline_ns: u64,
    /// When the last command was written [ns].
    asked_ns: u64,
    attempts: u32,
    measurement: Measurement,
    resampling: Option<Resampling>,
    identity: ScannerIdentity,
    /// Parameters whose checksums are wrong: they count when they come twice.
    unverified: Option<SensorParameters>,
    output: Vec<u8>,
    state: SourceState,
    message: String,
    counters: Counters,
    starts: u64,
}

impl ScannerSession {
    /// A conversation that has not begun.
    pub fn new(config: ScannerConfig) -> Self {
        Self {
            config,
            parser: Parser::default(),
            clock: None,
            phase: Phase::Off,
            deadline_ns: u64::MAX,
            asked_ns: 0,
            attempts: 0,
            measurement: Measurement::default(),
            resampling: None,
            identity: ScannerIdentity::default(),
            unverified: None,
            output: Vec::with_capacity(64),
            state: SourceState::Connecting,
            message: String::with_capacity(128),
            counters: Counters::default(),
            starts: 0,
        }
    }

    /// Begins on a new connection.
    pub fn connected(&mut self, now_ns: u64) {
        self.attempts = 0;
        self.drain(now_ns, DRAIN_NS);
        self.state = SourceState::Starting;
    }

    /// The connection is lost, for this reason.
    pub fn disconnected(&mut self, reason: &str) {
        (self.phase, self.deadline_ns, self.state) = (Phase::Off, u64::MAX, SourceState::Connecting);
        self.output.clear();
        self.describe(reason);
    }

    /// Bytes to be sent, oldest first; those that were sent are taken with [`Self::sent`].
    pub fn output(&self) -> &[u8] {
        &self.output
    }

    /// Removes bytes that were sent.
    pub fn sent(&mut self, count: usize) {
        self.output.drain(..count.min(self.output.len()));
    }

    /// When [`Self::poll`] has something to do [ns].
    pub fn due_ns(&self) -> u64 {
        self.deadline_ns
    }

    /// Whether the attempts on this connection are used up.
    pub fn gave_up(&self) -> bool {
        self.phase == Phase::Off && self.state != SourceState::Connecting
    }

    /// What the scanner does.
    pub fn state(&self) -> SourceState {
        self.state
    }

    /// Why it does not measure; empty when it does.
    pub fn message(&self) -> &str {
        &self.message
    }

    /// What the scanner has told about itself.
    pub fn identity(&self) -> &ScannerIdentity {
        &self.identity
    }

    /// Counters since the start.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// The mapping of its stamps, once its parameters are known.
    pub fn clock(&self) -> Option<&DeviceClock> {
        self.clock.as_ref()
    }

    /// Acts on time that has passed.
    pub fn poll(&mut self, now_ns: u64) {
        if now_ns < self.deadline_ns {
            return;
        }
        match self.phase {
            Phase::Off => self.deadline_ns = u64::MAX,
            Phase::Draining => self.ask(Step::Stop, now_ns),
            Phase::Asking(step) => {
                let echo = step.command(&self.measurement).name();
                self.fail(now_ns, DRAIN_NS, &format!("the scanner does not answer {echo}"));
            }
            Phase::Measuring => {
                self.state = SourceState::Stalled;
                self.fail(now_ns, DRAIN_NS, "no scan comes");
            }
        }
    }

    /// Takes bytes until a scan is complete; returns how many were taken, and the scan.
    ///
    /// # Errors
    /// A model that can't be used. It does not change by itself.
    pub fn receive(
        &mut self,
        bytes: &[u8],
        arrived_ns: u64,
        scan: &mut Scan,
    ) -> Result<(usize, Option<Reading>), UrgError> {
        for (index, byte) in bytes.iter().enumerate() {
            let Some(completed) = self.parser.push(*byte) else { continue };
            let reading = match completed {
                Completed::Answer => self.answered(arrived_ns)?,
                Completed::Scan => self.measured(arrived_ns, scan, None),
                Completed::BrokenScan(fault) => self.measured(arrived_ns, scan, Some(fault)),
                Completed::Garbage(_) => {
                    self.counters.garbage += 1;
                    None
                }
            };
            if reading.is_some() {
                return Ok((index + 1, reading));
            }
        }
        Ok((bytes.len(), None))
    }

    /// A scan has come, with ranges or without.
    fn measured(&mut self, arrived_ns: u64, scan: &mut Scan, fault: Option<ReplyFault>) -> Option<Reading> {
        if self.phase != Phase::Measuring {
            return None;
        }
        let is_own = self.parser.measurement().is_some_and(|its| its.is_same(&self.measurement));
        let fault = fault.or((!is_own).then_some(ReplyFault::Echo));
        let is_missing = fault.is_some();
        if let Some(fault) = fault {
            self.counters.broken += 1;
            self.message.clear();
            // Writing to a text does not fail.
            let _ = write!(self.message, "a scan was damaged on the way: {fault}");
        }
        let stamp_ms = self.parser.stamp().filter(|_| is_own)?;
        let (Some(parameters), Some(clock), Some(resampling)) =
            (&self.identity.parameters, &mut self.clock, &self.resampling)
        else {
            return None;
        };
        let mapped = clock.arrival(u64::from(stamp_ms), arrived_ns);
        let front_ns = mapped.time_ns.saturating_add(parameters.step_ns(parameters.front));
        scan.header.acquired_ns = front_ns.min(arrived_ns);
        let beams = self.config.beams;
        let turned_rad = beams.count as f64 * beams.increment_rad;
        // What is a whole number stays one, whatever the rounding of the share.
        scan.sweep_ns = (parameters.turn_ns() as f64 * turned_rad / TAU + 1e-3) as u64;
        scan.period_ns = parameters.turn_ns() * u64::from(self.config.skip + 1);
        scan.missing = is_missing.into();
        scan.set_geometry(beams);
        match is_missing {
            true => scan.ranges_mut().fill(0),
            false => resampling.apply(self.parser.ranges(), scan.ranges_mut()),
        }
        self.deadline_ns = arrived_ns.saturating_add(SILENT_PERIODS * scan.period_ns);
        self.counters.clock_jumps += u64::from(mapped.event != ClockEvent::Regular);
        if !is_missing {
            self.message.clear();
            (self.attempts, self.state) = (0, SourceState::Measuring);
            self.counters.scans += 1;
        }
        let (error_ns, event) = (mapped.error_ns, mapped.event);
        Some(Reading { error_ns, arrived_ns, stamp_ms, event, is_missing })
    }

    /// A reply without ranges has come.
    fn answered(&mut self, arrived_ns: u64) -> Result<Option<Reading>, UrgError> {
        match self.phase {
            Phase::Asking(step) if step.command(&self.measurement).is_answered_by(self.parser.echo()) => {
                self.advance(step, arrived_ns)?;
            }
            Phase::Measuring if self.is_of_measurement() => self.interrupted(arrived_ns),
            // A reply to no command: the echo of a scan was damaged.
            Phase::Measuring => self.counters.garbage += 1,
            _ => {}
        }
        Ok(None)
    }

    fn is_of_measurement(&self) -> bool {
        ScipCommand::Measure(self.measurement).is_answered_by(self.parser.echo())
    }

    /// The scanner has sent a status instead of a scan.
    fn interrupted(&mut self, now_ns: u64) {
        let status = self.parser.status();
        if status.number() != Some(98) && status != ScipStatus::DONE {
            self.state = SourceState::Stalled;
            self.fail(now_ns, FAULT_NS, &format!("status {status}: {}", status.meaning()));
        }
    }

    fn advance(&mut self, step: Step, now_ns: u64) -> Result<(), UrgError> {
        let (status, text) = (self.parser.status(), self.parser.text());
        match step {
            Step::Version => self.identity.version = text.to_vec(),
            Step::State => self.identity.state = text.to_vec(),
            Step::Parameters if status == ScipStatus::DONE => match self.read_parameters() {
                Ok(parameters) => self.prepare(parameters)?,
                Err(message) => {
                    self.fail(now_ns, DRAIN_NS, &message);
                    return Ok(());
                }
            },
            Step::ReadTime(_) => {
                if let (Some(ticks), Some(clock)) = (Step::time_of(text), &mut self.clock) {
                    clock.round_trip(u64::from(ticks), self.asked_ns, now_ns);
                }
            }
            _ => {}
        }
        match step.after(status, self.config.identify_only) {
            Outcome::Ask(next) => self.ask(next, now_ns),
            Outcome::Measure => {
                (self.phase, self.deadline_ns) = (Phase::Measuring, now_ns.saturating_add(FIRST_SCAN_NS));
                self.counters.restarts += u64::from(self.starts > 0);
                self.starts += 1;
            }
            Outcome::Done => (self.phase, self.deadline_ns) = (Phase::Off, u64::MAX),
            Outcome::Fault(wait_ns) => {
                let name = step.command(&self.measurement).name();
                self.fail(now_ns, wait_ns, &format!("{name}: status {status}: {}", status.meaning()));
            }
        }
        Ok(())
    }

    /// The parameters in the reply. Wrong ones would turn all ranges, so a damaged reply is asked for again.
    fn read_parameters(&mut self) -> Result<SensorParameters, String> {
        let text = self.parser.text();
        let parameters = SensorParameters::of_text(text).map_err(|error| error.to_string())?;
        if has_valid_sums(text) || self.unverified.as_ref() == Some(&parameters) {
            return Ok(parameters);
        }
        self.unverified = Some(parameters);
        Err("PP of the scanner: wrong checksum".to_owned())
    }

    /// Prepares the measurement of a model.
    fn prepare(&mut self, parameters: SensorParameters) -> Result<(), UrgError> {
        let ScannerConfig { rate_hz, beams, skip, cluster, coding, identify_only, .. } = self.config;
        if !identify_only {
            parameters.require_fit(rate_hz, skip)?;
        }
        let (first, last) = parameters.steps_of_beams(&beams);
        self.measurement = Measurement { coding, first, last, cluster, skip, count: 0, single: false };
        self.resampling = Some(Resampling::new(&parameters, &self.measurement, &beams));
        let settings = ClockSettings {
            delay_ns: parameters.step_ns(u32::from(last)),
            delay_error_ns: DELAY_ERROR_NS,
            ..ClockSettings::milliseconds_of_24_bits()
        };
        self.clock.get_or_insert_with(|| DeviceClock::new(settings));
        self.identity.parameters = Some(parameters);
        Ok(())
    }

    fn ask(&mut self, step: Step, now_ns: u64) {
        step.command(&self.measurement).append_to(&mut self.output);
        (self.phase, self.asked_ns) = (Phase::Asking(step), now_ns);
        self.deadline_ns = now_ns.saturating_add(REPLY_NS);
    }

    /// Begins anew after a pause, or asks for a new connection.
    fn fail(&mut self, now_ns: u64, wait_ns: u64, message: &str) {
        self.describe(message);
        self.attempts += 1;
        if self.attempts >= ATTEMPTS {
            (self.phase, self.deadline_ns) = (Phase::Off, u64::MAX);
            self.output.clear();
        } else {
            self.drain(now_ns, wait_ns);
        }
    }

    /// Drops what comes for a while. The line feed ends what the scanner may have received of a command.
    fn drain(&mut self, now_ns: u64, wait_ns: u64) {
        self.parser.reset();
        self.output.clear();
        self.output.push(b'\n');
        (self.phase, self.deadline_ns) = (Phase::Draining, now_ns.saturating_add(wait_ns));
    }

    fn describe(&mut self, message: &str) {
        self.message.clear();
        self.message.push_str(message);
    }
}
