//! The program `teleop`: a person drives by `/cmd_vel` or a gamepad.
//!
//! It starts `scanloop teleop --stdin` with the first message and hands on what the person asks for, line by line: limits, dead
//! man and refusals are those of that command. It is a companion, or was started by hand; then it ends with the command.

use std::io::Write;
use std::process::{Child, ChildStdin, ExitCode, Stdio};

use anyhow::ensure;
use driver::ros2::Ros2Config;
use runtime::{Companion, RESTART_VARIABLE, Shutdown, monotonic_ns};
use serde::de::DeserializeOwned;
use vehicle::Description;

use crate::arguments::{self, set};
use crate::hand::{Asked, Gamepad, Hand, of_twist};
use crate::listener::Listener;
use crate::message::{Joy, Named, Time, Twist, TwistStamped};
use crate::system::{System, is_companion};

/// Exit code for a system that is not there, or for what can't be used with it.
const BAD_INPUT: u8 = 2;
/// Exit code of a command that a signal has ended.
const ENDED_BY_SIGNAL: u8 = 4;

/// Which messages a person sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum From {
    Twist,
    TwistStamped,
    Joy,
}

impl From {
    fn of(text: &str) -> Option<Self> {
        match text {
            "twist" => Some(Self::Twist),
            "twist-stamped" => Some(Self::TwistStamped),
            "joy" => Some(Self::Joy),
            _ => None,
        }
    }
}

/// How a person drives.
#[derive(Debug)]
pub(crate) struct TeleopOptions {
    config: Ros2Config,
    from: From,
    topic: String,
    gamepad: Gamepad,
    system_id: Option<String>,
}

impl TeleopOptions {
    /// Those of arguments `KEY=VALUE`.
    ///
    /// # Errors
    /// An argument that is none of them, with what is allowed.
    pub(crate) fn read(arguments: &[&str]) -> Result<Self, String> {
        const KNOWN: &str = ", from=twist or twist-stamped or joy, topic=NAME, system-id=NAME; with joy velocity=M/S, \
                             velocity-axis=N, steering-axis=N, hold-button=N, pause-button=N, resume-button=N";
        let (mut from, mut gamepad) = (From::Twist, Gamepad::default());
        let (mut topic, mut system_id) = (String::new(), None);
        let config = arguments::read(arguments, "", KNOWN, |key, value| match key {
            "from" => set(&mut from, From::of(value)),
            "topic" => set(&mut topic, arguments::topic(value)),
            "system-id" => set(&mut system_id, Some(Some(value.to_owned()))),
            "velocity" => {
                set(&mut gamepad.velocity_mps, arguments::finite(value).filter(|velocity| *velocity > 0.0))
            }
            "velocity-axis" => set(&mut gamepad.axes[0], value.parse().ok()),
            "steering-axis" => set(&mut gamepad.axes[1], value.parse().ok()),
            "hold-button" => set(&mut gamepad.buttons[0], value.parse().ok()),
            "pause-button" => set(&mut gamepad.buttons[1], value.parse().ok()),
            "resume-button" => set(&mut gamepad.buttons[2], value.parse().ok()),
            _ => false,
        })?;
        if topic.is_empty() {
            topic = if from == From::Joy { "joy" } else { "cmd_vel" }.to_owned();
        }
        Ok(Self { config, from, topic, gamepad, system_id })
    }

    /// The system that is driven, with its robot.
    fn find(&self) -> anyhow::Result<(System, Description)> {
        let system = System::running(self.system_id.as_deref())?;
        let (topic, domain) = (self.config.topic(&self.topic), self.config.domain);
        // It would take over from the controller by what the controller drives.
        let robot = system.robot()?;
        let is_own = robot.is_some_and(|robot| robot.domain == domain && robot.topic("cmd_vel") == topic);
        ensure!(
            !is_own,
            "topic = {topic} is not allowed: the robot of this system takes its commands there, name another one"
        );
        let vehicle = system.vehicle()?;
        Ok((system, vehicle))
    }
}

/// Runs until asked to end, or until the command has ended that this program was started for by hand.
///
/// # Errors
/// No system, a node that can't be made, and errors of the bus.
pub(crate) fn run(options: &TeleopOptions) -> anyhow::Result<ExitCode> {
    let companion = is_companion().then(Companion::attach).transpose()?;
    let (system, vehicle) = match options.find() {
        Ok(found) => found,
        Err(error) => {
            runtime::print(runtime::Priority::Error, &format!("error: {error:#}"));
            return Ok(ExitCode::from(BAD_INPUT));
        }
    };
    let gamepad = options.gamepad;
    match options.from {
        From::Joy => listen(
            options,
            companion,
            system,
            |joy: &Joy| Some(&joy.header.stamp),
            |joy, hand| gamepad.read(&vehicle, joy).map(|(control, held)| hand.buttons(control, held)),
        ),
        From::Twist => {
            listen(options, companion, system, |_: &Twist| None, |twist, hand| stream(&vehicle, twist, hand))
        }
        From::TwistStamped => listen(
            options,
            companion,
            system,
            |message: &TwistStamped| Some(&message.header.stamp),
            |message, hand| stream(&vehicle, &message.twist, hand),
        ),
    }
}

fn stream(vehicle: &Description, twist: &Twist, hand: &mut Hand) -> Result<Option<Asked>, String> {
    of_twist(vehicle, twist).map(|control| hand.stream(control, monotonic_ns()))
}

/// Hands on what messages ask for.
fn listen<M: Named + DeserializeOwned + 'static>(
    options: &TeleopOptions,
    mut companion: Option<Companion>,
    system: System,
    stamp: fn(&M) -> Option<&Time>,
    mut read: impl FnMut(&M, &mut Hand) -> Result<Option<Asked>, String>,
) -> anyhow::Result<ExitCode> {
    let mut listener = Listener::open(&options.config, "scanloop_teleop", &options.topic, stamp)?;
    let shutdown = if companion.is_none() { Some(Shutdown::on_signals()?) } else { None };
    if let Some(companion) = &mut companion
        && !companion.start()?
    {
        return Ok(ExitCode::SUCCESS);
    }
    // A companion that was started again has lost the drive with its predecessor.
    let is_restarted = std::env::var_os(RESTART_VARIABLE).is_some_and(|value| value == "1");
    let mut hand = Hand::new(options.from != From::Joy && !is_restarted);
    let mut teleop = Teleop { system, command: None };
    loop {
        let goes_on = match (&mut companion, &shutdown) {
            (Some(companion), _) => companion.wait(Some(0))?,
            (None, shutdown) => !shutdown.as_ref().is_some_and(Shutdown::requested),
        };
        if !goes_on {
            return Ok(ExitCode::SUCCESS);
        }
        listener.sleep()?;
        if let Some(code) = teleop.ended()? {
            hand.lose();
            if companion.is_none() && code != 0 {
                return Ok(ExitCode::from(code));
            }
        }
        // Of several controls that have come at once only the newest counts.
        let mut control = None;
        while let Some(received) = listener.take() {
            match received.fault.map_or_else(|| read(&received.message, &mut hand), Err) {
                Err(fault) => listener.drop_message(&fault),
                Ok(Some(Asked::Drive(newest))) => control = Some(newest),
                Ok(Some(asked)) => {
                    control = None;
                    teleop.give(asked)?;
                }
                Ok(None) => {}
            }
        }
        if let Some(control) = control {
            teleop.give(Asked::Drive(control))?;
        }
    }
}

/// The command `scanloop teleop --stdin`, while a person drives.
struct Teleop {
    system: System,
    command: Option<(Child, Option<ChildStdin>)>,
}

impl Teleop {
    /// Hands on what a person asks for. Without a drive by hand, a control begins one, and the rest is asked of the system.
    fn give(&mut self, asked: Asked) -> anyhow::Result<()> {
        let verb = match asked {
            Asked::Drive(_) => None,
            Asked::Pause => Some("pause"),
            Asked::Resume => Some("resume"),
        };
        if let (None, Some(verb)) = (&self.command, verb) {
            // It says itself what came of it.
            self.system.command(&[verb]).status().map_err(|error| self.system.not_started(&error))?;
            return Ok(());
        }
        if self.command.is_none() {
            let started = self.system.command(&["teleop", "--stdin"]).stdin(Stdio::piped()).spawn();
            let mut child = started.map_err(|error| self.system.not_started(&error))?;
            let lines = child.stdin.take();
            self.command = Some((child, lines));
        }
        let Some((_, Some(lines))) = &mut self.command else { return Ok(()) };
        // What waits would be driven when it is old.
        if verb.is_none() && rustix::io::ioctl_fionread(&*lines).is_ok_and(|unread| unread > 0) {
            return Ok(());
        }
        let line = match asked {
            Asked::Drive([velocity, steering]) => format!("{velocity:.4} {steering:.5}\n"),
            Asked::Pause | Asked::Resume => format!("{}\n", verb.unwrap_or_default()),
        };
        // A command that has ended is noticed by its end, and says why.
        let _ = lines.write_all(line.as_bytes());
        Ok(())
    }

    /// The exit code of the command, once it has ended.
    fn ended(&mut self) -> anyhow::Result<Option<u8>> {
        let Some((child, _)) = &mut self.command else { return Ok(None) };
        let Some(status) = child.try_wait()? else { return Ok(None) };
        self.command = None;
        Ok(Some(status.code().and_then(|code| u8::try_from(code).ok()).unwrap_or(ENDED_BY_SIGNAL)))
    }
}

/// Ends the drive by hand: the wheels stay blocked until the drive is resumed.
impl Drop for Teleop {
    fn drop(&mut self) {
        if let Some((mut child, lines)) = self.command.take() {
            drop(lines);
            let _ = child.wait();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_choose_the_message_and_the_parts_of_the_gamepad() {
        let options = TeleopOptions::read(&["domain=3", "namespace=/robot1"]).unwrap();
        assert_eq!(
            (options.from, options.config.topic(&options.topic)),
            (From::Twist, "/robot1/cmd_vel".to_owned())
        );
        let options = ["from=joy", "velocity=0.8", "steering-axis=3", "hold-button=5", "system-id=lab"];
        let options = TeleopOptions::read(&options).unwrap();
        let gamepad = Gamepad { velocity_mps: 0.8, axes: [1, 3], buttons: [5, 6, 7] };
        assert_eq!((options.topic.as_str(), options.gamepad), ("joy", gamepad));
        assert_eq!(options.system_id.as_deref(), Some("lab"));
        for wrong in ["from=keys", "velocity=0", "velocity=nan", "hold-button=-1", "topic=1", "stick"] {
            let refused = TeleopOptions::read(&[wrong]).unwrap_err();
            assert!(refused.starts_with(&format!("{wrong} is not allowed: some of domain=")), "{refused}");
        }
    }
}
