//! `scanloop-ros2`: robots that speak ROS 2, and a view of a drive for its tools.
//!
//! `scanloop run` starts it for the implementation `ros2` of role `robot`, and as a companion with the argument `view`.
//! What comes in is converted in [`sweep`], [`base`] and [`transforms`], which know no network; [`connection`] reads the
//! topics, and [`guard`] is the process that alone sends commands.

mod base;
mod command;
mod connection;
mod drawing;
mod guard;
mod message;
mod node;
mod offset;
mod robot;
mod sweep;
mod transforms;
mod view;
mod watch;

use std::process::ExitCode;

/// The variable that chooses what is logged.
const LOG_VARIABLE: &str = "SCANLOOP_LOG";

const HELP: &str = "scanloop-ros2: robots that speak ROS 2, and a view of a drive for its tools.\n\n\
    Usage: scanloop-ros2 robot              the driver, started by `scanloop run` for implementation = \"ros2\"\n       \
    scanloop-ros2 view KEY=VALUE...  a companion that shows a drive: domain, interface, namespace, scanner\n\
    \n\
    docs/ros2.md explains the settings.";

fn main() -> ExitCode {
    runtime::start_logging();
    // DDS logs each packet that finds no way. Who asks for logs gets these, too.
    if std::env::var_os(LOG_VARIABLE).is_none() {
        log::set_max_level(log::LevelFilter::Off);
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let ended = match arguments.as_slice() {
        ["robot"] => robot::run(),
        ["guard", settings] => guard::run(settings),
        ["view", settings @ ..] => match view::settings(settings) {
            Ok((config, scanner)) => view::run(&config, scanner),
            Err(refused) => {
                runtime::print(runtime::Priority::Error, &format!("error: {refused}"));
                return ExitCode::from(2);
            }
        },
        ["--help" | "-h"] => {
            runtime::print_answer(HELP);
            return ExitCode::SUCCESS;
        }
        _ => {
            runtime::print(runtime::Priority::Error, &format!("error: wrong arguments\n\n{HELP}"));
            return ExitCode::from(2);
        }
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            runtime::print(runtime::Priority::Error, &format!("error: {error:#}"));
            ExitCode::from(4)
        }
    }
}
