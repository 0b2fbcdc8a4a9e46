//! A person at a running system: asks for one control after the other, by keys, lines, a gamepad, or for a time.

use std::fs::File;
use std::io;
use std::os::fd::AsFd;
use std::time::{Duration, Instant};

use console::answer;
use console::exit::Failure;
use runtime::{Domain, Priority, Shutdown, monotonic_ns, print, wait_for};
use rustix::io::Errno;
use session::control::{Reply, Request, ask};

use super::gamepad::Gamepad;
use super::keys::{self, Hand, Line};
use super::raw_terminal::RawTerminal;
use super::request;

/// A control that is refused for so long will not be taken any more.
const REFUSED: Duration = Duration::from_secs(1);
/// Time between two looks at the state of the system.
const LOOK: Duration = Duration::from_millis(300);
/// In lock-step a control waits for the scan of the one before.
const POLL: Duration = Duration::from_millis(1);
/// Bytes of keys that are taken at once.
const KEY_BYTES: usize = 256;
/// Longest line of standard input [bytes].
const MAX_LINE: usize = 256;

/// A person at a running system.
pub(super) struct Person<'d> {
    pub(super) domain: &'d Domain,
    pub(super) person: u64,
    pub(super) interval: Duration,
    pub(super) period_ns: u64,
    pub(super) lockstep: bool,
    /// Since when controls have been refused.
    pub(super) refused_since: Option<Instant>,
}

impl Person<'_> {
    pub(super) fn for_time(
        &mut self,
        shutdown: &Shutdown,
        hand: &Hand,
        time: Duration,
    ) -> anyhow::Result<()> {
        let until = Instant::now() + time;
        while Instant::now() < until && !shutdown.requested() {
            self.give(hand.asked())?;
            wait_for(&[shutdown.descriptor()], self.interval.as_nanos() as u64);
        }
        Ok(())
    }

    pub(super) fn for_scans(&mut self, shutdown: &Shutdown, hand: &Hand, scans: u64) -> anyhow::Result<()> {
        let mut given = 0;
        while given < scans && !shutdown.requested() {
            if self.give(hand.asked())? {
                given += 1;
            } else {
                wait_for(&[shutdown.descriptor()], POLL.as_nanos() as u64);
            }
        }
        Ok(())
    }

    /// What each line asks for, until one hands back.
    pub(super) fn by_lines(&mut self, shutdown: &Shutdown) -> anyhow::Result<()> {
        let (mut text, mut number) = (Vec::new(), 0);
        answer!(false, "by hand")?;
        loop {
            wait_for(&[io::stdin().as_fd(), shutdown.descriptor()], LOOK.as_nanos() as u64);
            if shutdown.requested() {
                return Ok(());
            }
            if !wait_for(&[io::stdin().as_fd()], 0) {
                continue;
            }
            let mut bytes = [0; KEY_BYTES];
            let count = rustix::io::read(io::stdin(), &mut bytes)?;
            if count == 0 {
                return Ok(());
            }
            text.extend_from_slice(&bytes[..count]);
            while let Some(end) = text.iter().position(|byte| *byte == b'\n') {
                let line: Vec<u8> = text.drain(..=end).collect();
                number += 1;
                let asked = keys::of_line(&String::from_utf8_lossy(&line)).map_err(|reason| {
                    Failure::bad_input(format!("standard input, line {number}: {reason}"))
                })?;
                match asked {
                    Line::Control(asked) => {
                        while !self.give(asked)? && self.lockstep && !shutdown.requested() {
                            wait_for(&[shutdown.descriptor()], POLL.as_nanos() as u64);
                        }
                    }
                    Line::Pause => self.hold()?,
                    Line::Resume => return self.hand_back(),
                }
            }
            if text.len() > MAX_LINE {
                return Err(Failure::bad_input(format!(
                    "standard input, line {}: longer than {MAX_LINE} bytes",
                    number + 1
                )));
            }
        }
    }

    /// What a gamepad asks for, until it hands back or is gone.
    pub(super) fn by_gamepad(
        &mut self,
        shutdown: &Shutdown,
        device: &File,
        mut gamepad: Gamepad,
    ) -> anyhow::Result<()> {
        answer!(false, "by hand")?;
        let (mut given, mut was_held, mut is_paused) = (Instant::now(), false, false);
        loop {
            wait_for(&[device.as_fd(), shutdown.descriptor()], self.interval.as_nanos() as u64);
            let mut bytes = [0; KEY_BYTES];
            let asked = match rustix::io::read(device, &mut bytes) {
                Err(Errno::AGAIN | Errno::INTR) => None,
                Ok(count @ 1..) => gamepad.take(&bytes[..count]),
                Ok(0) | Err(_) => {
                    print(Priority::Notice, "the gamepad is gone");
                    return Ok(());
                }
            };
            if shutdown.requested() {
                return Ok(());
            }
            match asked {
                Some(Line::Resume) => return self.hand_back(),
                Some(Line::Pause) => self.hold()?,
                Some(Line::Control(_)) | None => {}
            }
            let asks = gamepad.asked();
            is_paused = asked == Some(Line::Pause) || is_paused && (asks.is_none() || was_held);
            // In lock-step time stands while it is not held.
            let is_due = given.elapsed() >= self.interval || was_held != asks.is_some();
            if is_due && !is_paused && (asks.is_some() || !self.lockstep) {
                self.give(asks.unwrap_or_default())?;
                given = Instant::now();
            }
            was_held = asks.is_some();
        }
    }

    /// Blocks the wheels until the next control.
    fn hold(&self) -> anyhow::Result<()> {
        request(self.domain, &Request::Hold { person: self.person, ends: false })?;
        answer!(false, "paused")?;
        Ok(())
    }

    /// Lets the controller drive, unless another person does now.
    fn hand_back(&self) -> anyhow::Result<()> {
        request(self.domain, &Request::Hold { person: self.person, ends: false })?;
        request(self.domain, &Request::Resume)?;
        answer!(false, "resumed")?;
        Ok(())
    }

    pub(super) fn by_keys(&mut self, shutdown: &Shutdown, mut hand: Hand) -> anyhow::Result<()> {
        let screen = RawTerminal::enter()?;
        screen.show(keys::HELP);
        let (mut look, mut state, mut shown) = (Instant::now(), String::new(), String::new());
        loop {
            wait_for(&[io::stdin().as_fd(), shutdown.descriptor()], self.interval.as_nanos() as u64);
            let mut bytes = [0; KEY_BYTES];
            let count = match wait_for(&[io::stdin().as_fd()], 0) {
                false => 0,
                true => match rustix::io::read(io::stdin(), &mut bytes) {
                    // The terminal is gone.
                    Ok(0) | Err(_) => return Ok(()),
                    Ok(count) => count,
                },
            };
            if shutdown.requested() || !hand.take(&bytes[..count], Instant::now()) {
                return Ok(());
            }
            let is_held = hand.is_held(Instant::now());
            // In lock-step time stands while no key is held.
            if is_held || !self.lockstep {
                self.give(if is_held { hand.asked() } else { [0.0, hand.asked()[1]] })?;
            }
            if Instant::now() >= look {
                look = Instant::now() + LOOK;
                state = self.state();
            }
            let line = format!("{}  {state}", hand.text(is_held));
            if line != shown {
                screen.show(&line);
                shown = line;
            }
        }
    }

    /// Asks for one control; whether it was taken.
    ///
    /// # Errors
    /// When controls have not been taken for a second, with the reason.
    fn give(&mut self, [velocity_mps, steering_rad]: [f64; 2]) -> anyhow::Result<bool> {
        let given_ns = monotonic_ns();
        let request = Request::Control { person: self.person, velocity_mps, steering_rad, given_ns };
        let reason = match ask(self.domain, &request) {
            Ok(Reply::Refused(reason)) => Failure::bad_input(reason),
            // An orchestrator that is suspended for a moment.
            Err(error) => error,
            Ok(reply) => {
                self.refused_since = None;
                return Ok(reply != Reply::Pending);
            }
        };
        let since = *self.refused_since.get_or_insert_with(Instant::now);
        if since.elapsed() > REFUSED { Err(reason) } else { Ok(false) }
    }

    /// What the robot does, for the person.
    fn state(&self) -> String {
        match ask(self.domain, &Request::Status) {
            Ok(Reply::Status(status)) => {
                let wheels = status
                    .wheels
                    .map_or_else(String::new, |wheels| format!("wheels {wheels:?}").to_lowercase());
                let reason = status.hindered.map(|reason| format!(": {reason}"));
                format!("scan {}, {wheels}{}", status.scan, reason.unwrap_or_default())
            }
            _ => String::new(),
        }
    }
}
