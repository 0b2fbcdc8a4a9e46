//! `scanloop pause`, `resume` and `teleop`: a person takes over from the controller, and hands back.
//!
//! `teleop` asks for one control after the other, several in each scan period. Without a new one the wheels are blocked: when
//! keys are released, when the program is killed or stopped, when the terminal is gone. As in `top`, a second process of
//! this program uses the terminal, and the first one restores it.

mod gamepad;
mod keys;

use std::fs::File;
use std::io::{self, IsTerminal};
use std::os::fd::AsFd;
use std::path::PathBuf;
use std::process::Command;
use std::time::{Duration, Instant};

use clap::Args;
use console::answer;
use console::exit::{Exit, Failure};
use console::screen::ScreenGuard;
use runtime::{Domain, Priority, Shutdown, monotonic_ns, print, stick_range, wait_for};
use rustix::io::Errno;
use rustix::process::{Signal, set_parent_process_death_signal};
use rustix::termios::{OptionalActions, Termios, tcgetattr, tcsetattr};
use session::control::{Reply, Request, ask};
use supervision::child::this_program;
use supervision::runs::existing;

use gamepad::{Gamepad, open_gamepad};
use keys::{Hand, Line};

/// Shortest and longest time between two controls.
const INTERVAL: (Duration, Duration) = (Duration::from_millis(5), Duration::from_millis(40));
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
/// Largest numbers that are sent: limits are those of the system.
const MAX_VELOCITY_MPS: f64 = 10.0;
const MAX_STEERING_RAD: f64 = 1.0;
const MAX_FOR_S: f64 = 3600.0;

/// Arguments of `teleop`.
#[derive(Debug, Clone, Args)]
pub struct TeleopArguments {
    /// Velocity while a key is held, of `--for`, or of the stick at its end [m/s]; the system drives slower where it has to.
    #[arg(long, value_name = "M/S", default_value_t = 0.3)]
    pub velocity: f64,
    /// Steering angle at the start [rad]; positive to the left. Of the stick at its end, 0.06 unless given.
    #[arg(long, value_name = "RAD", allow_hyphen_values = true)]
    pub steering: Option<f64>,
    /// Without keys: drive so for this time [s], then pause; in lock-step simulated time.
    #[arg(long = "for", value_name = "S")]
    pub for_s: Option<f64>,
    /// Without keys: each line of standard input is one control, `VELOCITY STEERING`, or `pause`, which blocks the wheels until
    /// the next control, or `resume`, which hands back and ends; for programs in any language. Standard output tells who
    /// drives: `by hand`, `paused` or `resumed`, a line for each change.
    #[arg(long, conflicts_with = "for_s")]
    pub stdin: bool,
    /// By a gamepad: this device or pipe of its events, else the first of the machine. While the left shoulder button is held,
    /// the left stick drives; select blocks the wheels, start hands back to the controller.
    #[arg(long, value_name = "DEVICE", num_args = 0..=1, conflicts_with_all = ["for_s", "stdin"])]
    pub gamepad: Option<Option<PathBuf>>,
    /// Use the terminal in this process; `teleop` starts itself with this option.
    #[arg(long, hide = true)]
    pub draw: bool,
}

/// Pauses a drive.
///
/// # Errors
/// A system that is not running or does not drive; exit code 2.
pub(crate) fn pause(system_id: &str) -> anyhow::Result<Exit> {
    request(&existing(system_id)?, &Request::Pause)?;
    answer!(false, "paused: the wheels are blocked until `scanloop resume`")?;
    Ok(Exit::Done)
}

/// Lets the controller drive again.
///
/// # Errors
/// A system that is not running, and one whose controller drives; exit code 2.
pub(crate) fn resume(system_id: &str) -> anyhow::Result<Exit> {
    request(&existing(system_id)?, &Request::Resume)?;
    answer!(false, "resumed: the controller drives")?;
    Ok(Exit::Done)
}

/// Drives by hand until a key, a signal or the time ends it; then the drive is paused.
///
/// # Errors
/// Arguments that are not allowed, no terminal, a system that does not drive; exit code 2.
pub(crate) fn teleop(system_id: &str, arguments: &TeleopArguments) -> anyhow::Result<Exit> {
    let TeleopArguments { velocity, steering, for_s, stdin, ref gamepad, draw } = *arguments;
    for (name, value, highest, lowest) in [
        ("velocity", velocity, MAX_VELOCITY_MPS, 0.0),
        ("steering", steering.unwrap_or_default(), MAX_STEERING_RAD, -MAX_STEERING_RAD),
        ("for", for_s.unwrap_or_default(), MAX_FOR_S, 0.0),
    ] {
        if !(lowest..=highest).contains(&value) {
            return Err(Failure::bad_input(format!(
                "--{name} {value} is not allowed: {lowest} to {highest}"
            )));
        }
    }
    let domain = existing(system_id)?;
    let by_keys = for_s.is_none() && !stdin && gamepad.is_none();
    if by_keys && !(io::stdin().is_terminal() && io::stderr().is_terminal()) {
        return Err(Failure::bad_input(
            "teleop needs a terminal as standard input and standard error, --for S, --stdin or --gamepad",
        ));
    }
    let shutdown = Shutdown::of_orchestrator()?;
    if stdin {
        return drive(&domain, |teleop| teleop.by_lines(&shutdown));
    }
    if let Some(device) = gamepad {
        let device = open_gamepad(device.as_deref())?;
        let gamepad = Gamepad::new(velocity, steering, stick_range(&device));
        return drive(&domain, |teleop| teleop.by_gamepad(&shutdown, &device, gamepad));
    }
    let steering = steering.unwrap_or_default();
    if for_s.is_some() || draw {
        if draw {
            set_parent_process_death_signal(Some(Signal::TERM))?;
        }
        let hand = Hand::new([velocity, steering], for_s.is_none());
        return drive(&domain, |teleop| match for_s {
            Some(for_s) if teleop.lockstep => {
                let scans = (for_s * 1e9 / teleop.period_ns as f64).round() as u64;
                teleop.for_scans(&shutdown, &hand, scans)
            }
            Some(for_s) => teleop.for_time(&shutdown, &hand, Duration::from_secs_f64(for_s)),
            None => teleop.by_keys(&shutdown, hand),
        });
    }
    let mut command = Command::new(this_program());
    command.args(["--system-id", system_id, "teleop", "--draw"]);
    command.arg(format!("--velocity={velocity}")).arg(format!("--steering={steering}"));
    let status = ScreenGuard::start(&mut command)?.wait(&[shutdown.descriptor()])?;
    match status.code() {
        Some(0) => Ok(Exit::Done),
        // It has said why.
        Some(1) => Ok(Exit::NotReached),
        Some(2) => Ok(Exit::BadInput),
        _ => {
            let _ = ask(&domain, &Request::Pause);
            anyhow::bail!("teleop has ended: {status}; the drive is paused")
        }
    }
}

/// Asks for controls until the end, then pauses the drive.
fn drive(
    domain: &Domain,
    ask_for: impl FnOnce(&mut Teleop<'_>) -> anyhow::Result<()>,
) -> anyhow::Result<Exit> {
    let reply = request(domain, &Request::Teleop)?;
    let Reply::Teleop { person, period_ns, lockstep } = reply else {
        anyhow::bail!("the orchestrator gives an answer of another version")
    };
    let interval = Duration::from_nanos(period_ns / 2).clamp(INTERVAL.0, INTERVAL.1);
    let mut teleop = Teleop { domain, person, interval, period_ns, lockstep, refused_since: None };
    let given = ask_for(&mut teleop);
    // Another may have taken over or resumed meanwhile: that one is not paused.
    let paused = ask(domain, &Request::Hold { person, ends: true });
    given?;
    if matches!(paused, Ok(Reply::Done)) {
        print(Priority::Notice, "paused: the wheels are blocked until `scanloop resume`");
    }
    Ok(Exit::Done)
}

/// A person at a running system.
struct Teleop<'d> {
    domain: &'d Domain,
    person: u64,
    interval: Duration,
    period_ns: u64,
    lockstep: bool,
    /// Since when controls have been refused.
    refused_since: Option<Instant>,
}

impl Teleop<'_> {
    fn for_time(&mut self, shutdown: &Shutdown, hand: &Hand, time: Duration) -> anyhow::Result<()> {
        let until = Instant::now() + time;
        while Instant::now() < until && !shutdown.requested() {
            self.give(hand.asked())?;
            wait_for(&[shutdown.descriptor()], self.interval.as_nanos() as u64);
        }
        Ok(())
    }

    fn for_scans(&mut self, shutdown: &Shutdown, hand: &Hand, scans: u64) -> anyhow::Result<()> {
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
    fn by_lines(&mut self, shutdown: &Shutdown) -> anyhow::Result<()> {
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
    fn by_gamepad(&mut self, shutdown: &Shutdown, device: &File, mut gamepad: Gamepad) -> anyhow::Result<()> {
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

    fn by_keys(&mut self, shutdown: &Shutdown, mut hand: Hand) -> anyhow::Result<()> {
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

/// Asks, and takes a refusal for an error of the user.
fn request(domain: &Domain, request: &Request) -> anyhow::Result<Reply> {
    match ask(domain, request)? {
        Reply::Refused(reason) => Err(Failure::bad_input(reason)),
        reply => Ok(reply),
    }
}

/// The terminal without echo, with each key at once; dropping it restores it.
struct RawTerminal {
    before: Termios,
}

impl RawTerminal {
    fn enter() -> anyhow::Result<Self> {
        let before = tcgetattr(io::stdin())?;
        let mut raw = before.clone();
        raw.make_raw();
        tcsetattr(io::stdin(), OptionalActions::Now, &raw)?;
        // Pasted text is marked as such.
        let _ = rustix::io::write(io::stderr(), b"\x1b[?2004h");
        Ok(Self { before })
    }

    /// Shows one line in the place of the last one, or lines above it.
    fn show(&self, text: &str) {
        let text: String = text.replace('\n', "\r\n");
        let _ = rustix::io::write(io::stderr(), format!("\r\x1b[2K{text}").as_bytes());
    }
}

impl Drop for RawTerminal {
    fn drop(&mut self) {
        let _ = rustix::io::write(io::stderr(), b"\x1b[?2004l\r\n");
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, &self.before);
    }
}
