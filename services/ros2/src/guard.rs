//! The guard of the wheels: a process with a node of its own, which alone sends commands.

use std::os::fd::AsFd;
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::Context;
use driver::guard::{Commands, GuardAct, GuardFault, Held};
use driver::ros2::Ros2Config;

use crate::command::{CommandWriter, type_of};
use crate::node::RosNode;
use crate::watch::missing;

/// This program, also when an update has replaced its file.
const THIS_PROGRAM: &str = "/proc/self/exe";
/// The guard waits this long for a reader of its commands: the driver has seen one.
const DISCOVERY: Duration = Duration::from_millis(1500);
/// A stop at the end is sent this often: DDS sends from a thread of its own, and a reader may lose one.
const STOPS: u32 = 3;
/// Time after each of them [ns].
const STOP_NS: u64 = 40_000_000;

/// Starts a guard.
///
/// # Errors
/// [`GuardFault::NotStarted`].
pub(crate) fn start(config: &Ros2Config, timeout_ns: u64) -> Result<Held, GuardFault> {
    let settings =
        toml::to_string(config).map_err(|error| GuardFault::NotStarted(std::io::Error::other(error)))?;
    let mut command = Command::new(THIS_PROGRAM);
    command.arg("guard").arg(settings);
    // Not the pipe of its driver, whose end it would hold open.
    command.stdout(std::io::stderr().as_fd().try_clone_to_owned().map_err(GuardFault::NotStarted)?);
    Held::start(command, 0, timeout_ns)
}

/// Runs until the driver has ended, and stops the wheels then.
///
/// # Errors
/// A start by hand, and a node that cannot be made.
pub(crate) fn run(settings: &str) -> anyhow::Result<()> {
    let config: Ros2Config = toml::from_str(settings).context("the guard is started by its driver")?;
    driver::guard::run(|_| {
        let mut node = RosNode::open(&config, "scanloop_guard")?;
        let writer = CommandWriter::open(&mut node, &config)?;
        let (topic, end) = (config.topic("cmd_vel"), Instant::now() + DISCOVERY);
        while missing(&topic, type_of(config.command), &node.readers(), "reader").is_some()
            && Instant::now() < end
        {
            runtime::wait_for(&[], 5_000_000);
        }
        Ok(Wheels { writer, _node: node })
    })
}

/// The wheels of the robot.
struct Wheels {
    writer: CommandWriter,
    _node: RosNode,
}

impl Commands for Wheels {
    fn send(&mut self, act: GuardAct) -> std::io::Result<()> {
        match act {
            GuardAct::Drive(numbers) => self.writer.send(numbers),
            GuardAct::Stop => self.writer.send([0.0; 2]),
            GuardAct::Offset(seconds) => {
                self.writer.offset_s = Some(seconds);
                Ok(())
            }
            GuardAct::Round => Ok(()),
        }
    }

    fn finish(&mut self) {
        for _ in 0..STOPS {
            runtime::wait_for(&[], STOP_NS);
            // Whether it arrives is not known, and nothing else can be done.
            let _ = self.writer.send([0.0; 2]);
        }
    }
}
