//! What every driver of a robot must do: stamps on CLOCK_MONOTONIC, whole scans only, wheels that stop by themselves.

use std::rc::Rc;

use device_clock::{ClockEvent, ClockSettings, DeviceClock};
use runtime::{Input, Output, Process, RuntimeError, Wheels};
use shared_types::{
    Actuation, ActuationKind, BEAMS, DeviceState, Header, Odometry, Phase, Scan, ScanGeometry,
};

use crate::device::{Device, Sweep};
use crate::odometry::{History, Pose, wrap};

/// The device is polled this often, also when no actuation comes [ns].
pub(crate) const POLL_NS: u64 = 5_000_000;
/// What the actuator may send: velocity [m/s] and steering angle [rad]. Anything else is not obeyed.
const SENT_MAX: [f64; 2] = [2.0, 0.12];
/// Rounding of what was limited to these values.
const SLACK: f64 = 1e-9;
/// A process that is asked to end is killed after one second [ns].
const END_NS: u64 = 800_000_000;
/// Below this speed the wheels rest [m/s].
const REST_MPS: f64 = 1e-3;
/// Largest difference between a stamp and the time of what it stamps: the resolution of your devices [ns].
const RESOLUTION_NS: u64 = 1_000;
/// A device without data for so many periods has a fault; so has a scanner with so many broken sweeps in a row.
const MAX_MISSING: u64 = 3;

/// A robot with its place in the run.
pub(crate) struct Driver {
    device: Device,
    scanner_clock: DeviceClock,
    base_clock: DeviceClock,
    history: History,
    /// A sweep that waits for the odometry after it, and the time of its front beam [ns].
    waiting: Option<(u64, Sweep)>,
    /// When base and scanner sent data last; `None` before the first [ns].
    arrived_ns: [Option<u64>; 2],
    /// Sweeps that broke off since the last whole one.
    broken: u64,
    /// Messages that came after newer ones and were dropped, and the text for `scanloop status`.
    overtaken: u64,
    remark: String,
    /// The odometry published last.
    last: Odometry,
    /// When the wheels were told to drive last; `None` while they are blocked [ns].
    told_ns: Option<u64>,
    speed_mps: f64,
    actuations: Input<Actuation>,
    scans: Rc<Output<Scan>>,
    odometries: Rc<Output<Odometry>>,
}

impl Driver {
    /// Opens topics and device.
    pub(crate) fn new(process: &mut Process) -> Result<Self, RuntimeError> {
        let device = Device::open(process.clock().now_ns(), process.period_ns());
        Ok(Self {
            scanner_clock: clock(device.scan_delay_ns()),
            base_clock: clock(device.base_delay_ns()),
            device,
            history: History::default(),
            waiting: None,
            arrived_ns: [None; 2],
            broken: 0,
            overtaken: 0,
            remark: String::new(),
            last: Odometry::default(),
            told_ns: None,
            speed_mps: 0.0,
            actuations: process.input()?,
            scans: process.output()?,
            odometries: process.output()?,
        })
    }

    /// All that is due: wheels first, then what was measured.
    pub(crate) fn turn(&mut self, process: &mut Process) -> Result<(), RuntimeError> {
        self.obey(process);
        self.read(process);
        self.report(process);
        self.publish(process)
    }

    /// Blocks the wheels, and waits for as long as an end may take until the robot rests.
    pub(crate) fn end(&mut self, process: &mut Process) -> Result<(), RuntimeError> {
        let until_ns = process.clock().now_ns() + END_NS;
        loop {
            let now_ns = process.clock().now_ns();
            self.block(now_ns);
            self.read(process);
            self.report(process);
            if self.speed_mps.abs() <= REST_MPS || now_ns > until_ns {
                return Ok(());
            }
            process.wait(Some(now_ns + POLL_NS))?;
        }
    }

    /// Writes what the actuator commands. The dead man: without it for two periods the wheels are blocked.
    fn obey(&mut self, process: &Process) {
        let now_ns = process.clock().now_ns();
        while let Some(actuation) = self.actuations.take() {
            match ActuationKind::try_from(actuation.kind) {
                Ok(ActuationKind::Drive) if is_possible(&actuation) => {
                    let (velocity, steering) = (actuation.sent_velocity_mps, actuation.sent_steering_rad);
                    self.device.write_wheels(now_ns, Some((velocity, steering)));
                    self.told_ns = Some(now_ns);
                }
                Ok(ActuationKind::Block) => self.block(now_ns),
                _ => {}
            }
        }
        let silent = |told_ns: u64| now_ns.saturating_sub(told_ns) >= 2 * process.period_ns();
        if process.must_stop() || self.told_ns.is_some_and(silent) {
            self.block(now_ns);
        }
    }

    fn block(&mut self, now_ns: u64) {
        self.device.write_wheels(now_ns, None);
        self.told_ns = None;
    }

    /// Reports to `scanloop stop` what the wheels do, and to `scanloop status` what base and scanner do.
    fn report(&self, process: &Process) {
        process.report_wheels(match self.told_ns {
            Some(_) => Wheels::Turning,
            None if self.speed_mps.abs() > REST_MPS => Wheels::Blocked,
            None => Wheels::Resting,
        });
        let (state, reason) = self.devices(process.clock().now_ns(), process.period_ns());
        process.report_device(state, reason);
    }

    /// What base and scanner do, and why.
    fn devices(&self, now_ns: u64, period_ns: u64) -> (DeviceState, &str) {
        let is_silent = |arrived_ns: u64| now_ns.saturating_sub(arrived_ns) > MAX_MISSING * period_ns;
        match self.arrived_ns {
            [None, _] => (DeviceState::Connecting, "base: no data yet"),
            [_, None] => (DeviceState::Connecting, "scanner: no sweep yet"),
            [Some(base_ns), _] if is_silent(base_ns) => (DeviceState::Fault, "base: sends no data"),
            [_, Some(scanner_ns)] if is_silent(scanner_ns) => {
                (DeviceState::Fault, "scanner: sends no sweeps")
            }
            _ if self.broken >= MAX_MISSING => (DeviceState::Fault, "scanner: all sweeps break off"),
            _ => (DeviceState::Running, &self.remark),
        }
    }

    /// Reads what base and scanner have measured, and maps their stamps to CLOCK_MONOTONIC.
    fn read(&mut self, process: &Process) {
        let now_ns = process.clock().now_ns();
        if let Some((stamp_ns, pose)) = self.device.read_odometry(now_ns) {
            let mapped = self.base_clock.arrival(stamp_ns, now_ns);
            if self.is_in_order(mapped.event) {
                // A base that was restarted counts from zero again, its clock and its odometry.
                let at_ns = self.time_of_state(stamp_ns, mapped.time_ns);
                self.history.add([at_ns, mapped.time_ns], pose, mapped.event == ClockEvent::Backwards);
                self.speed_mps = pose.speed_mps;
            }
            self.arrived_ns[0] = Some(now_ns);
        }
        if let Some(sweep) = self.device.read_scan(now_ns) {
            let mapped = match self.device.has_one_clock() {
                true => self.scanner_clock.arrival_beside(&self.base_clock, sweep.stamp_ns, now_ns),
                false => self.scanner_clock.arrival(sweep.stamp_ns, now_ns),
            };
            self.arrived_ns[1] = Some(now_ns);
            self.broken = if sweep.beams == BEAMS { 0 } else { self.broken + 1 };
            if self.is_in_order(mapped.event) {
                let is_next = self.is_next(mapped.time_ns, process.period_ns());
                self.waiting = is_next.then_some((mapped.time_ns, sweep));
            }
        }
    }

    /// The time by which states are kept and found. Stamps of one clock fit each other from the first one on, whatever the
    /// mapping of the clock is still short of.
    fn time_of_state(&self, stamp_ns: u64, mapped_ns: u64) -> u64 {
        if self.device.has_one_clock() { stamp_ns } else { mapped_ns }
    }

    /// Whether a message is newer than those before. One that was overtaken is old: it is counted and dropped.
    fn is_in_order(&mut self, event: ClockEvent) -> bool {
        if event == ClockEvent::Overtaken {
            self.overtaken += 1;
            self.remark = format!("{} messages were overtaken by others", self.overtaken);
        }
        event != ClockEvent::Overtaken
    }

    /// Whether a front beam is after the one before; logs a gap.
    fn is_next(&self, front_ns: u64, period_ns: u64) -> bool {
        let last_ns = self.last.header.acquired_ns;
        let since_ns = front_ns.saturating_sub(last_ns);
        if last_ns > 0 && since_ns > period_ns + period_ns / 2 {
            tracing::warn!(ms = since_ns / 1_000_000, "a gap between two sweeps");
        }
        last_ns == 0 || since_ns >= period_ns / 4
    }

    /// Publishes the sweep that waits, when the odometry at its front beam is known.
    fn publish(&mut self, process: &mut Process) -> Result<(), RuntimeError> {
        let period_ns = process.period_ns();
        let Some((front_ns, sweep)) = &self.waiting else { return Ok(()) };
        let (front_ns, at_ns) = (*front_ns, self.time_of_state(sweep.stamp_ns, *front_ns));
        let is_old = process.clock().now_ns().saturating_sub(front_ns) > 2 * period_ns;
        if is_old || process.directive().phase == Phase::Stopping.wire() {
            self.waiting = None;
            return Ok(());
        }
        let Some(pose) = self.history.at(at_ns, period_ns + period_ns / 2) else { return Ok(()) };
        let Some((_, sweep)) = self.waiting.take() else { return Ok(()) };
        process.begin();
        let scan_id = self.last.header.scan_id + 1;
        let header = Header { scan_id, acquired_ns: front_ns, ..Header::default() };
        self.scans.publish(&mut scan_of(&sweep, header, period_ns))?;
        self.last = increments(pose, header, &self.last);
        self.odometries.publish(&mut self.last)
    }
}

/// The clock of a device whose data need at least this long to arrive [ns].
fn clock(delay_ns: u64) -> DeviceClock {
    DeviceClock::new(ClockSettings { delay_ns, resolution_ns: RESOLUTION_NS, ..ClockSettings::nanoseconds() })
}

/// Whether a velocity and an angle can be meant; NaN is in no range.
fn is_possible(actuation: &Actuation) -> bool {
    actuation.sent_velocity_mps.abs() <= SENT_MAX[0] + SLACK
        && actuation.sent_steering_rad.abs() <= SENT_MAX[1] + SLACK
}

/// The scan; a sweep that broke off is marked as missing, with zeros only.
fn scan_of(sweep: &Sweep, header: Header, period_ns: u64) -> Scan {
    let is_whole = sweep.beams == BEAMS;
    let mut scan =
        Scan { header, sweep_ns: period_ns * 2 / 3, period_ns, ..Scan::of(ScanGeometry::URG_04LX) };
    match is_whole {
        true => scan.ranges_mut().copy_from_slice(&sweep.ranges_mm),
        false => scan.missing = true.into(),
    }
    scan
}

/// The odometry, with what has changed since the sample before.
fn increments(pose: Pose, header: Header, before: &Odometry) -> Odometry {
    let Pose { x_m, y_m, yaw_rad, speed_mps } = pose;
    let now = Odometry { header, x_m, y_m, yaw_rad, speed_mps, ..Odometry::default() };
    if before.header.scan_id == 0 {
        return now;
    }
    Odometry {
        dx_m: x_m - before.x_m,
        dy_m: y_m - before.y_m,
        dyaw_rad: wrap(yaw_rad - before.yaw_rad),
        dt_s: (header.acquired_ns - before.header.acquired_ns) as f64 * 1e-9,
        ..now
    }
}
