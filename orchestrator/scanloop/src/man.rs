//! `scanloop man`: man pages of all commands, also of those that the laboratory runs.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{Args, Command};
use clap_mangen::Man;
use console::exit::{Exit, Failure};
use console::new_file::{Existing, NewFile, make_folder};
use console::note;

use crate::laboratory;

/// Arguments of `man`.
#[derive(Debug, Args)]
pub struct ManArguments {
    /// Folder for the pages, for example `~/.local/share/man/man1`; pages that are there are replaced.
    #[arg(value_name = "DIR", value_parser = console::output::folder())]
    pub folder: PathBuf,
}

/// Writes the pages of this executable and, if it is there, those of the laboratory.
///
/// # Errors
/// A file that can't be written; exit code 2. A laboratory that can't be started, or fails; exit code 4.
pub(crate) fn man(root: Command, arguments: &ManArguments) -> anyhow::Result<Exit> {
    write_pages(root, &arguments.folder, |_| true)?;
    let path = match laboratory::find() {
        Ok(path) => path,
        Err(missing) => {
            note!("the pages of studies only name the laboratory: {missing}");
            return Ok(Exit::Done);
        }
    };
    let status = std::process::Command::new(&path).arg("man").arg(&arguments.folder).status();
    match status {
        Ok(status) if status.success() => Ok(Exit::Done),
        Ok(status) => Err(Failure::process(format!("{} man: {status}", path.display()))),
        Err(error) => Err(Failure::process(format!("{}: {error}", path.display()))),
    }
}

/// Writes the pages of a command and of those below it that are shown and `wanted` by their names, `scanloop-topic-echo`.
///
/// # Errors
/// A file that can't be written; exit code 2.
pub fn write_pages(root: Command, folder: &Path, wanted: impl Fn(&str) -> bool) -> anyhow::Result<()> {
    make_folder(folder).map_err(|error| Failure::bad_input(format!("{}: {error}", folder.display())))?;
    let mut root = root.disable_help_subcommand(true);
    root.build();
    for command in with_those_below(&root) {
        let name = command.get_display_name().unwrap_or_else(|| command.get_name());
        if wanted(name) {
            let page = Man::new(command.clone()).source(concat!("Scanloop ", env!("CARGO_PKG_VERSION")));
            let path = folder.join(page.get_filename());
            let mut file = NewFile::create(&path, Existing::Replace, &[])?;
            page.manual("Scanloop").render(&mut file)?;
            file.flush()?;
            file.finish()?;
        }
    }
    Ok(())
}

fn with_those_below(command: &Command) -> Vec<&Command> {
    let below = command.get_subcommands().filter(|below| !below.is_hide_set());
    std::iter::once(command).chain(below.flat_map(with_those_below)).collect()
}
