//! The executable `scanloop-lab`, the laboratory: what studies the product and is no part of it.
//!
//! Its path is that of this executable with `-lab` added, or the same name in the folder of another profile of the
//! target folder. Commands that study are run there; `bench latency` starts its stages that compute nothing, and its
//! load.

use std::ffi::OsString;
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};

use anyhow::Context;
use clap::Args;
use console::exit::Failure;
use console::note;
use figures::{MEASURED_PROFILE, PROFILE};

use crate::FLUSH_TIMEOUT;

/// Added to the name of an executable, this is the name of its laboratory.
pub const SUFFIX: &str = "-lab";

/// Names to the laboratory the executable that has handed a command over: the product whose processes it starts.
pub const PRODUCT_VARIABLE: &str = "SCANLOOP_PRODUCT";

/// Arguments of a command that the laboratory runs; `scanloop-lab COMMAND --help` tells what they are.
#[derive(Debug, Args)]
pub struct StudyArguments {
    /// Arguments of the command; `--help` shows them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    pub arguments: Vec<OsString>,
}

/// Whether a command is handed over to the laboratory with all its arguments.
pub fn is_handed_over(command: &clap::Command) -> bool {
    command.get_arguments().any(|arg| arg.get_id() == "arguments" && arg.is_trailing_var_arg_set())
}

/// The path of the laboratory.
///
/// # Errors
/// A missing laboratory, with the command that builds it; exit code 4.
pub(crate) fn find() -> anyhow::Result<PathBuf> {
    let own = std::env::current_exe().context("path of this executable")?;
    candidates(&own).into_iter().find(|path| path.is_file()).ok_or_else(|| {
        Failure::process(format!(
            "this needs the executable scanloop{SUFFIX}, which is not next to {}: in the source tree \
             `{}` builds it",
            own.display(),
            build_command("scanloop-lab")
        ))
    })
}

/// The command that builds a package with the profile of this executable.
pub fn build_command(package: &str) -> String {
    let profile = match PROFILE {
        "dev" => String::new(),
        "release" => " --release".to_owned(),
        other => format!(" --profile {other}"),
    };
    format!("cargo build{profile} -p {package}")
}

/// Replaces this process by a command of the laboratory; returns when that fails.
pub(crate) fn hand_over(system_id: &str, command: &str, study: &StudyArguments) -> anyhow::Error {
    let laboratory = match find_current() {
        Ok(laboratory) => laboratory,
        Err(missing) => return missing,
    };
    // The queue of the terminal is lost when the process is replaced.
    runtime::flush_terminal(FLUSH_TIMEOUT);
    let mut process = Command::new(&laboratory);
    process.arg(command).args(&study.arguments).env(runtime::SYSTEM_ID_VARIABLE, system_id);
    if let Ok(own) = std::env::current_exe() {
        process.env(PRODUCT_VARIABLE, own);
    }
    Failure::process(format!("{}: {}", laboratory.display(), process.exec()))
}

/// Paths where the laboratory of an executable may be, the likeliest first.
fn candidates(own: &Path) -> Vec<PathBuf> {
    let name = own.file_name().unwrap_or_default().to_string_lossy();
    // The kernel adds this when the file was replaced.
    let name = name.strip_suffix(" (deleted)").unwrap_or(&name);
    let name = format!("{name}{SUFFIX}");
    let Some(folder) = own.parent() else { return Vec::new() };
    let profiles = [MEASURED_PROFILE, "release", "debug"].map(|profile| folder.with_file_name(profile));
    std::iter::once(folder.to_owned()).chain(profiles).map(|folder| folder.join(&name)).collect()
}

/// Like [`find`]; prints a note when sources of the laboratory have changed since it was built.
///
/// # Errors
/// As [`find`].
pub(crate) fn find_current() -> anyhow::Result<PathBuf> {
    let laboratory = find()?;
    let changed = |path: &Path| path.metadata().and_then(|file| file.modified()).ok();
    let sources = sources(&std::fs::read_to_string(laboratory.with_extension("d")).unwrap_or_default());
    if sources.iter().any(|source| changed(source) > changed(&laboratory)) {
        let (file, build) = (laboratory.display(), build_command("scanloop-lab"));
        note!("{file} is older than its sources, so it measures an old build: `{build}` rebuilds it");
    }
    Ok(laboratory)
}

/// The source files that Cargo lists next to an executable: `EXECUTABLE: FILE FILE...`, with a backslash before a
/// blank.
fn sources(list: &str) -> Vec<PathBuf> {
    let files = list.split_once(": ").map_or("", |(_, files)| files).replace("\\ ", "\0");
    files.split_whitespace().map(|file| PathBuf::from(file.replace('\0', " "))).collect()
}

/// Busy loops on every processor, in a process of the laboratory; dropping it ends them.
pub(crate) struct Load {
    process: Child,
    loops: usize,
    _keeps_alive: Option<ChildStdin>,
}

impl Load {
    /// Starts the loops.
    ///
    /// # Errors
    /// No laboratory, or one that does not start; exit code 4.
    pub(crate) fn start() -> anyhow::Result<Self> {
        let laboratory = find()?;
        let failed = |why: &str| Failure::process(format!("{} service load: {why}", laboratory.display()));
        let mut process = Command::new(&laboratory)
            .args(["service", "load"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| failed(&error.to_string()))?;
        let alive = process.stdin.take();
        let mut line = String::new();
        if let Some(output) = process.stdout.take() {
            let _ = BufReader::new(output).read_line(&mut line);
        }
        let load = Self { loops: line.trim().parse().unwrap_or(0), process, _keeps_alive: alive };
        if load.loops == 0 { Err(failed("it starts no loop")) } else { Ok(load) }
    }

    /// Number of loops.
    pub(crate) fn count(&self) -> usize {
        self.loops
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_laboratory_is_next_to_the_executable_or_in_the_folder_of_another_profile() {
        let places = candidates(Path::new("/src/target/release/scanloop (deleted)"));
        let expected = ["release", "dist", "release", "debug"]
            .map(|profile| PathBuf::from(format!("/src/target/{profile}/scanloop-lab")));
        assert_eq!(places, expected);
    }

    #[test]
    fn the_sources_of_an_executable_are_those_that_cargo_lists() {
        let files = sources("/t/scanloop-lab: /a/one.rs /a/my\\ file.rs\n");
        assert_eq!(files, ["/a/one.rs", "/a/my file.rs"].map(PathBuf::from));
        assert!(sources("").is_empty());
    }

    #[test]
    fn an_executable_without_a_laboratory_names_the_command_that_builds_it() {
        // No executable of unit tests has one.
        let missing = find().unwrap_err().to_string();
        assert!(missing.contains("`cargo build -p scanloop-lab`"), "{missing}");
        assert_eq!(console::exit::exit_of(&find().unwrap_err()), console::exit::Exit::ProcessFailed);
    }
}
