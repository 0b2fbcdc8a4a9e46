//! `scanloop pause`, `resume` and `teleop`: a person takes over from the controller, and hands back.
//!
//! `teleop` asks for one control after the other, several in each scan period. Without a new one the wheels are blocked: when
//! keys are released, when the program is killed or stopped, when the terminal is gone. As in `top`, a second process of
//! this program uses the terminal, and the first one restores it.

mod gamepad;
mod keys;
mod person;
mod raw_terminal;

use std::io::{self, IsTerminal};
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use clap::Args;
use console::answer;
use console::exit::{Exit, Failure};
use console::screen::ScreenGuard;
use runtime::{Domain, Priority, Shutdown, print, stick_range};
use rustix::process::{Signal, set_parent_process_death_signal};
use session::control::{Reply, Request, ask};
use supervision::child::this_program;
use supervision::runs::existing;

use gamepad::{Gamepad, open_gamepad};
use keys::Hand;
use person::Person;

/// Shortest and longest time between two controls.
const INTERVAL: (Duration, Duration) = (Duration::from_millis(5), Duration::from_millis(40));
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
    ask_for: impl FnOnce(&mut Person<'_>) -> anyhow::Result<()>,
) -> anyhow::Result<Exit> {
    let reply = request(domain, &Request::Teleop)?;
    let Reply::Teleop { person, period_ns, lockstep } = reply else {
        anyhow::bail!("the orchestrator gives an answer of another version")
    };
    let interval = Duration::from_nanos(period_ns / 2).clamp(INTERVAL.0, INTERVAL.1);
    let mut teleop = Person { domain, person, interval, period_ns, lockstep, refused_since: None };
    let given = ask_for(&mut teleop);
    // Another may have taken over or resumed meanwhile: that one is not paused.
    let paused = ask(domain, &Request::Hold { person, ends: true });
    given?;
    if matches!(paused, Ok(Reply::Done)) {
        print(Priority::Notice, "paused: the wheels are blocked until `scanloop resume`");
    }
    Ok(Exit::Done)
}

/// Asks, and takes a refusal for an error of the user.
fn request(domain: &Domain, request: &Request) -> anyhow::Result<Reply> {
    match ask(domain, request)? {
        Reply::Refused(reason) => Err(Failure::bad_input(reason)),
        reply => Ok(reply),
    }
}
