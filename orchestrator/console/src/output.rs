//! Output of commands: what a command was asked for to standard output, progress and warnings to standard error.
//!
//! With `--json` the JSON alone goes to standard output, and the text for people to standard error.

use std::ffi::OsString;
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use clap::builder::{OsStringValueParser, TypedValueParser};
use clap::error::ErrorKind;
use clap::{Arg, ColorChoice, Command, Parser};

use runtime::printable;

use crate::new_file;

/// Writes progress and remarks to standard error; errors are ignored, because no command is asked for them.
#[macro_export]
macro_rules! note {
    ($($text:tt)*) => { runtime::print(runtime::Priority::Notice, &format!($($text)*)) };
}

/// Moves to the upper left corner and clears what is below.
const REDRAW: &str = "\x1b[H\x1b[J";

/// [`answer()`] with a text as in `format!`.
#[macro_export]
macro_rules! answer {
    ($is_json:expr, $($text:tt)*) => { $crate::output::answer($is_json, &format!($($text)*)) };
}

/// Limit for texts that were written before an answer.
const FLUSH_TIMEOUT: Duration = Duration::from_millis(300);

/// Writes the text that a command was asked for: to standard output, or to standard error if JSON goes there. False when the
/// reader has closed the pipe.
///
/// # Errors
/// As [`data`].
pub fn answer(is_json: bool, text: &str) -> anyhow::Result<bool> {
    if is_json {
        note!("{text}");
        return Ok(true);
    }
    runtime::flush_terminal(FLUSH_TIMEOUT);
    data(text)
}

/// Writes data and ends its last line; false when the reader has closed the pipe, as in `| head`. Words of files and of
/// other programs in it are written as [`printable`] shows them; JSON keeps its meaning.
///
/// # Errors
/// Data that can't be written, to a full disk for example: a command that was asked for it has failed.
pub fn data(text: &str) -> anyhow::Result<bool> {
    write("", &printable(text))
}

/// [`data`] that replaces what it wrote before, where standard output is a terminal.
///
/// # Errors
/// As [`data`].
pub fn redraw(text: &str) -> anyhow::Result<bool> {
    write(if io::stdout().is_terminal() { REDRAW } else { "" }, &printable(text))
}

/// The arguments of a command; without them it ends here, as clap has it.
pub fn arguments<A: Parser>() -> A {
    let matches = with_negative_numbers(A::command()).color(colours()).try_get_matches();
    matches.and_then(|matches| A::from_arg_matches(&matches)).unwrap_or_else(|error| {
        // A command without its words has its help for an answer.
        if !error.use_stderr() || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
            let printed = error.print().and_then(|()| io::stdout().flush());
            if let Err(reason) = printed
                && reason.kind() != io::ErrorKind::BrokenPipe
            {
                runtime::print(runtime::Priority::Error, &format!("error: standard output: {reason}"));
                std::process::exit(crate::exit::Exit::ProcessFailed as i32);
            }
            std::process::exit(error.exit_code());
        }
        // Names of files may stand in it, as after `scanloop check *`.
        runtime::print(runtime::Priority::Error, &error.render().to_string());
        std::process::exit(error.exit_code());
    })
}

/// A number below zero is a value like any other, of which the command tells what is allowed; `-1` is no option.
fn with_negative_numbers(command: Command) -> Command {
    let allow = |argument: Arg| {
        let takes_values = argument.get_action().takes_values();
        argument.allow_negative_numbers(takes_values)
    };
    command.mut_args(allow).mut_subcommands(with_negative_numbers)
}

/// Whether help has colours. `CLICOLOR_FORCE=0` forces none: the library takes any value for force.
fn colours() -> ColorChoice {
    let is_forced = std::env::var_os("CLICOLOR_FORCE").is_none_or(|value| value != "0");
    let is_terminal = io::stdout().is_terminal() && io::stderr().is_terminal();
    if is_forced || is_terminal { ColorChoice::Auto } else { ColorChoice::Never }
}

fn write(before: &str, text: &str) -> anyhow::Result<bool> {
    let end = if text.is_empty() || text.ends_with('\n') { "" } else { "\n" };
    let mut output = io::stdout().lock();
    let written = output
        .write_all(before.as_bytes())
        .and_then(|()| output.write_all(text.as_bytes()))
        .and_then(|()| output.write_all(end.as_bytes()))
        .and_then(|()| output.flush());
    match written {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(false),
        written => written.map(|()| true).context("standard output"),
    }
}

/// Reads the folder of an option `--out`; refuses one that can't be written to before anything is started.
pub fn folder() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().try_map(|text: OsString| {
        let folder = PathBuf::from(text);
        require_writable(&folder).map(|()| folder)
    })
}

/// Passes when files can be made in a folder, or in its nearest parent that exists.
///
/// # Errors
/// The folder that refuses a file, the reason, and what is allowed.
pub fn require_writable(folder: &Path) -> Result<(), String> {
    let missing =
        |path: &&Path| matches!(path.metadata(), Err(error) if error.kind() == io::ErrorKind::NotFound);
    let folder = std::path::absolute(folder).map_err(|error| error.to_string())?;
    let there = folder.ancestors().find(|path| !missing(path)).unwrap_or(&folder);
    new_file::probe(there).map_err(|error| {
        format!("no file can be made in {}: {error}; name a folder that you may write to", there.display())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_can_be_written_to_when_its_nearest_parent_can() {
        let here = std::env::temp_dir().join(format!("scanloop-output-{}", std::process::id()));
        std::fs::create_dir_all(&here).unwrap();
        assert_eq!(require_writable(&here.join("some/where")), Ok(()));
        assert_eq!(std::fs::read_dir(&here).unwrap().count(), 0, "nothing is left behind");
        std::fs::write(here.join("file"), "").unwrap();
        for refused in [here.join("file"), here.join("file/below"), PathBuf::from("/proc/none")] {
            let message = require_writable(&refused).unwrap_err();
            assert!(message.contains("name a folder that you may write to"), "{message}");
        }
        std::fs::remove_dir_all(&here).unwrap();
    }
}
