//! An emulated scanner: bytes and times in, bytes out. It has no clock and no connection; [`Port`](crate::Port) has one.
//!
//! It answers as the recorded device of `tests/data`, byte by byte, and has the faults of [`DeviceFault`].

mod faults;
mod replies;

use std::collections::VecDeque;

use crate::command::Measurement;
use crate::model::SensorParameters;
use crate::status::ScipStatus;

pub use faults::DeviceFault;

/// Longest command: longer ones are no commands.
const MAX_COMMAND: usize = 64;
/// Bytes that a reader may leave unread; then scans are lost, as on a full line.
const MAX_OUTPUT: usize = 1 << 16;
const MS_NS: u64 = 1_000_000;
/// The counter of milliseconds has 24 bits.
const STAMP_MASK: u64 = (1 << 24) - 1;

/// A measurement that is being done.
#[derive(Debug, Clone)]
struct Job {
    measurement: Measurement,
    /// The echo of its command.
    echo: Vec<u8>,
    /// Scans left; `None` for no end.
    left: Option<u8>,
    /// Number of the next turn that is sent.
    turn: u64,
}

/// The emulated scanner.
#[derive(Debug, Clone)]
pub struct ScannerEmulator {
    parameters: SensorParameters,
    /// Range of each step, or an error code [mm].
    scene: Vec<u32>,
    /// When its counter was zero [ns].
    origin_ns: u64,
    /// What is taken from its counter [ms].
    set_back_ms: u64,
    is_scip_2: bool,
    is_laser_on: bool,
    is_time_mode: bool,
    /// Statuses of `TM0` and `TM1` where nothing else is wrong.
    time_status: [ScipStatus; 2],
    job: Option<Job>,
    command: Vec<u8>,
    output: VecDeque<u8>,
    faults: faults::Faults,
}

impl ScannerEmulator {
    /// An URG-04LX that sees a wall of `range_mm` in all directions, switched on at `now_ns`.
    pub fn new(now_ns: u64, range_mm: u32) -> Self {
        Self::of(replies::urg_04lx(), now_ns, range_mm)
    }

    /// An URG-04LX 1.2 m from the right, 1.8 m from the left and 3 m from the front wall of a room, with a post.
    pub fn in_a_room(now_ns: u64) -> Self {
        Self::new(now_ns, 0).with_a_room()
    }

    /// An UST-10LX there.
    pub fn ust_10lx_in_a_room(now_ns: u64) -> Self {
        Self::of(replies::ust_10lx(), now_ns, 0).with_a_room()
    }

    fn with_a_room(mut self) -> Self {
        for (step, range) in self.scene.iter_mut().enumerate() {
            let (left, ahead) = self.parameters.yaw_rad(step as f64).sin_cos();
            let side = if left < 0.0 { 1.2 } else { 1.8 };
            let end = if ahead < 0.0 { 2.0 } else { 3.0 };
            let wall = (side / left.abs().max(1e-9)).min(end / ahead.abs().max(1e-9));
            // The post: 1.4 m ahead, 0.2 m to the right, 0.2 m wide.
            let across = 1.4 / ahead.max(1e-9) * left;
            let is_post = ahead > 0.0 && (-0.3..=-0.1).contains(&across);
            *range = ((if is_post { 1.4 / ahead } else { wall }) * 1000.0) as u32;
        }
        self
    }

    /// A scanner of another model.
    pub fn of(parameters: SensorParameters, now_ns: u64, range_mm: u32) -> Self {
        Self {
            scene: vec![range_mm; parameters.last as usize + 1],
            parameters,
            origin_ns: now_ns,
            set_back_ms: 0,
            is_scip_2: true,
            is_laser_on: false,
            is_time_mode: false,
            time_status: [ScipStatus::DONE; 2],
            job: None,
            command: Vec::new(),
            output: VecDeque::new(),
            faults: faults::Faults::default(),
        }
    }

    /// The ranges that it measures, one per step from 0 [mm, or an error code].
    pub fn scene(&mut self) -> &mut Vec<u32> {
        &mut self.scene
    }

    /// Makes a fault happen.
    pub fn inject(&mut self, fault: DeviceFault, now_ns: u64) {
        match fault {
            DeviceFault::Restart => {
                (self.origin_ns, self.set_back_ms) = (now_ns, 0);
                self.reset();
                self.is_scip_2 = false;
                self.output.clear();
            }
            DeviceFault::TimeStatus(statuses) => self.time_status = statuses,
            DeviceFault::Backwards(ms) => self.set_back_ms += ms,
            DeviceFault::Status(status) => self.interrupt(status),
            DeviceFault::Garbage(count) => {
                self.output.extend((0..count).map(|index| (index.wrapping_mul(97) >> 1) as u8));
            }
            fault => self.faults.add(fault),
        }
    }

    /// Takes bytes of the host.
    pub fn receive(&mut self, bytes: &[u8], now_ns: u64) {
        for byte in bytes {
            match byte {
                b'\n' | b'\r' if self.command.is_empty() => {}
                b'\n' | b'\r' => {
                    let command = std::mem::take(&mut self.command);
                    self.advance(now_ns);
                    self.answer(&command, now_ns);
                }
                _ if self.command.len() < MAX_COMMAND => self.command.push(*byte),
                _ => {}
            }
        }
    }

    /// Sends the scans that are complete by now.
    pub fn advance(&mut self, now_ns: u64) {
        while let Some(ready_ns) = self.scan_ready_ns().filter(|ready_ns| *ready_ns <= now_ns) {
            self.send_scan(ready_ns);
        }
        self.faults.release(now_ns, &mut self.output);
    }

    /// When [`Self::advance`] has something to send next [ns].
    pub fn due_ns(&self) -> Option<u64> {
        self.scan_ready_ns().into_iter().chain(self.faults.release_ns()).min()
    }

    /// Bytes for the host; those that were sent are to be removed.
    pub fn output(&mut self) -> &mut VecDeque<u8> {
        &mut self.output
    }

    /// When the last step of the next scan is measured [ns].
    fn scan_ready_ns(&self) -> Option<u64> {
        let job = self.job.as_ref()?;
        let begins_ns = self.origin_ns + job.turn * self.parameters.turn_ns();
        Some(begins_ns + self.parameters.step_ns(u32::from(job.measurement.last)))
    }

    /// Its counter at a time [ms, 24 bits].
    fn stamp_ms(&self, time_ns: u64) -> u32 {
        let ms = time_ns.saturating_sub(self.origin_ns) / MS_NS;
        (ms.wrapping_sub(self.set_back_ms) & STAMP_MASK) as u32
    }

    fn reset(&mut self) {
        (self.is_laser_on, self.is_time_mode, self.job) = (false, false, None);
        self.faults.drop_held();
    }

    fn answer(&mut self, command: &[u8], now_ns: u64) {
        match command {
            b"SCIP2.0" if !self.is_scip_2 => {
                self.is_scip_2 = true;
                self.push(b"SCIP2.0\n0\n\n");
            }
            _ if !self.is_scip_2 => {
                self.push(command);
                self.push(b"\nE\n\n");
            }
            b"TM0" | b"TM1" | b"TM2" => self.answer_time(command, now_ns),
            _ if self.is_time_mode => self.reply(command, ScipStatus::NOT_ALLOWED, &[]),
            b"QT" => {
                self.reset();
                self.reply(command, ScipStatus::DONE, &[]);
            }
            b"RS" => {
                self.reset();
                self.origin_ns = now_ns;
                self.reply(command, ScipStatus::DONE, &[]);
            }
            b"BM" => {
                let status = if self.is_laser_on { ScipStatus(*b"02") } else { ScipStatus::DONE };
                self.is_laser_on = true;
                self.reply(command, status, &[]);
            }
            b"VV" => self.reply(command, ScipStatus::DONE, &replies::version()),
            b"PP" => self.reply(command, ScipStatus::DONE, &replies::parameters(&self.parameters)),
            b"II" => {
                let state = replies::state(
                    &self.parameters,
                    self.is_laser_on,
                    self.job.is_some(),
                    self.stamp_ms(now_ns),
                );
                self.reply(command, ScipStatus::DONE, &state);
            }
            _ => self.answer_measurement(command, now_ns),
        }
    }

    fn answer_time(&mut self, command: &[u8], now_ns: u64) {
        let [enter, read] = self.time_status;
        if command == b"TM0" && enter != ScipStatus::DONE || command == b"TM1" && read != ScipStatus::DONE {
            return self.reply(command, if command == b"TM0" { enter } else { read }, &[]);
        }
        let (status, lines) = match (command, self.is_time_mode) {
            (b"TM0", false) | (b"TM2", true) => (ScipStatus::DONE, None),
            (b"TM0", true) => (ScipStatus(*b"02"), None),
            (b"TM1", true) => (ScipStatus::DONE, Some(replies::number(self.stamp_ms(now_ns)))),
            (b"TM1", false) => (ScipStatus(*b"04"), None),
            _ => (ScipStatus(*b"03"), None),
        };
        self.is_time_mode = command != b"TM2" && (command == b"TM0" || self.is_time_mode);
        if self.is_time_mode {
            (self.is_laser_on, self.job) = (false, None);
        }
        self.reply(command, status, lines.as_deref().unwrap_or_default());
    }

    fn answer_measurement(&mut self, command: &[u8], now_ns: u64) {
        let Some(measurement) = Measurement::of_echo(command) else {
            return self.reply(command, ScipStatus::NOT_ALLOWED, &[]);
        };
        if u32::from(measurement.last) > self.parameters.last {
            return self.reply(command, ScipStatus(*b"04"), &[]);
        }
        if measurement.last < measurement.first {
            return self.reply(command, ScipStatus(*b"05"), &[]);
        }
        if measurement.single {
            if !self.is_laser_on {
                return self.reply(command, ScipStatus(*b"10"), &[]);
            }
            let lines = self.scan_lines(&measurement, self.stamp_ms(now_ns));
            return self.reply(command, ScipStatus::DONE, &lines);
        }
        self.is_laser_on = true;
        self.reply(command, ScipStatus::DONE, &[]);
        let turn = (now_ns.saturating_sub(self.origin_ns)) / self.parameters.turn_ns() + 1;
        let left = (measurement.count > 0).then_some(measurement.count);
        self.job = Some(Job { measurement, echo: command.to_vec(), left, turn });
    }

    fn send_scan(&mut self, ready_ns: u64) {
        let Some(mut job) = self.job.take() else { return };
        let begins_ns = self.origin_ns + job.turn * self.parameters.turn_ns();
        job.turn += 1 + u64::from(job.measurement.skip);
        job.left = job.left.map(|left| left - 1);
        if let Some(left) = job.left {
            job.echo.truncate(13);
            job.echo.extend([left / 10 + b'0', left % 10 + b'0']);
        }
        let lines = self.scan_lines(&job.measurement, self.stamp_ms(begins_ns));
        let mut scan = Vec::new();
        replies::append(&mut scan, &job.echo, ScipStatus::SCAN, &lines);
        self.faults.damage(&mut scan, ready_ns);
        if self.output.len() + scan.len() <= MAX_OUTPUT {
            self.output.extend(scan);
        }
        match job.left {
            Some(0) => self.is_laser_on = false,
            _ => self.job = Some(job),
        }
    }

    fn scan_lines(&self, measurement: &Measurement, stamp_ms: u32) -> Vec<u8> {
        let steps = usize::from(measurement.first)..usize::from(measurement.last) + 1;
        replies::scan(self.scene.get(steps).unwrap_or_default(), measurement, stamp_ms)
    }

    /// Ends the measurement with a status.
    fn interrupt(&mut self, status: ScipStatus) {
        if let Some(job) = self.job.take() {
            self.reply(&job.echo, status, &[]);
        }
    }

    fn reply(&mut self, echo: &[u8], status: ScipStatus, lines: &[u8]) {
        let mut bytes = Vec::new();
        replies::append(&mut bytes, echo, status, lines);
        self.push(&bytes);
    }

    fn push(&mut self, bytes: &[u8]) {
        self.output.extend(bytes);
    }
}
