//! `scanloop urg`: tries a Hokuyo laser scanner alone, without a robot and without a system.

mod arguments;
mod emulate;
mod info;
mod log;
mod plot;
mod scanner;

pub use arguments::UrgCommand;

use console::exit::Exit;

/// Runs one of the commands.
///
/// # Errors
/// A scanner that can't be reached or used, and a file that can't be written: exit code 2.
pub(crate) fn urg(command: &UrgCommand) -> anyhow::Result<Exit> {
    match command {
        UrgCommand::Info(arguments) => info::info(arguments),
        UrgCommand::Plot(arguments) => plot::plot(arguments),
        UrgCommand::Log(arguments) => log::log(arguments),
        UrgCommand::Emulate(arguments) => emulate::emulate(arguments),
    }
}
