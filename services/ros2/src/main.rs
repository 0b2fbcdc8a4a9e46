//! `scanloop-ros2`: robots that speak ROS 2, persons who drive with its tools, and a view of a drive for them.
//!
//! `scanloop run` starts it for the implementation `ros2` of role `robot`, and as a companion with the name of one of the
//! other programs. What comes in is converted in [`sweep`], [`base`], [`transforms`] and [`hand`], which know no network;
//! [`connection`] reads the topics of a robot, [`listener`] one topic of a companion, and [`guard`] is the process that alone
//! sends commands.

mod arguments;
mod base;
mod command;
mod connection;
mod drawing;
mod emergency_stop;
mod goal;
mod guard;
mod hand;
mod imu;
mod listener;
mod message;
mod node;
mod offset;
mod robot;
mod sweep;
mod system;
mod teleop;
mod transforms;
mod view;
mod watch;

use std::process::ExitCode;

use emergency_stop::ButtonOptions;
use imu::ImuOptions;
use teleop::TeleopOptions;
use view::ViewOptions;

/// The variable that chooses what is logged.
const LOG_VARIABLE: &str = "SCANLOOP_LOG";

const HELP: &str = "scanloop-ros2: robots that speak ROS 2, persons who drive with its tools, and a view of a drive for them.\n\n\
    Usage: scanloop-ros2 PROGRAM KEY=VALUE...\n\n  \
      robot           the driver, started by `scanloop run` for implementation = \"ros2\"\n  \
      view            a companion that shows a drive, and takes goals with --control\n  \
      teleop          a person drives by /cmd_vel or /joy: a companion, or started by hand\n  \
      emergency-stop  a companion that writes a button, std_msgs/Bool, on the topic that it `writes`\n  \
      imu             a companion that writes the yaw rate of sensor_msgs/Imu on the topic that it `writes`\n\n\
    A wrong key prints those that are allowed; docs/ros2.md explains them.";

fn main() -> ExitCode {
    runtime::start_logging();
    // DDS logs each packet that finds no way. Who asks for logs gets these, too.
    if std::env::var_os(LOG_VARIABLE).is_none() {
        log::set_max_level(log::LevelFilter::Off);
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = |ended: anyhow::Result<()>| ended.map(|()| ExitCode::SUCCESS);
    let ended = match arguments.as_slice() {
        ["robot"] => Ok(done(robot::run())),
        ["guard", settings] => Ok(done(guard::run(settings))),
        ["view", options @ ..] => ViewOptions::read(options).map(|options| done(view::run(&options))),
        ["teleop", options @ ..] => TeleopOptions::read(options).map(|options| teleop::run(&options)),
        ["emergency-stop", options @ ..] => {
            ButtonOptions::read(options).map(|options| done(emergency_stop::run(&options)))
        }
        ["imu", options @ ..] => ImuOptions::read(options).map(|options| done(imu::run(&options))),
        ["--help" | "-h"] => {
            runtime::print_answer(HELP);
            return ExitCode::SUCCESS;
        }
        _ => Err(format!("wrong arguments\n\n{HELP}")),
    };
    let (code, text) = match ended {
        Ok(Ok(code)) => return code,
        Ok(Err(error)) => (4, format!("{error:#}")),
        Err(refused) => (2, refused),
    };
    runtime::print(runtime::Priority::Error, &format!("error: {text}"));
    ExitCode::from(code)
}
