//! `scanloop completions`, and the hidden `complete` that lists what may be typed at a place of a command line.
//!
//! The scripts for the shells know nothing of the command line: they hand over the words before the cursor, and print what
//! `complete` answers. Words of the laboratory are handed on to it, because `scanloop campaign` is one surface with it.

mod values;

use std::ffi::{OsStr, OsString};
use std::os::unix::process::CommandExt;
use std::path::Path;

use clap::{Args, Command, ValueEnum};
use clap_complete::engine::{CompletionCandidate, complete};
use console::exit::Exit;
use console::output::data;

use crate::laboratory;
use values::Context;

/// A shell that completes words.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Shell {
    /// For `~/.local/share/bash-completion/completions/scanloop`.
    Bash,
    /// For a file `_scanloop` in a folder of `$fpath`.
    Zsh,
    /// For `~/.config/fish/completions/scanloop.fish`.
    Fish,
}

impl Shell {
    /// What it reads to complete words of `scanloop` and `scanloop-lab`.
    pub(crate) fn script(self) -> &'static str {
        match self {
            Self::Bash => include_str!("completions/bash.sh"),
            Self::Zsh => include_str!("completions/zsh.sh"),
            Self::Fish => include_str!("completions/fish.fish"),
        }
    }
}

/// Arguments of `complete`.
#[derive(Debug, Args)]
pub struct CompleteArguments {
    /// The words up to the cursor, with the program; the last one is to be completed.
    #[arg(last = true, value_name = "WORDS", allow_hyphen_values = true)]
    pub words: Vec<OsString>,
}

/// Prints the candidates for the word at the end, one line each: the word, and behind a tab what it means. Words of the laboratory
/// are completed by it; without it they have no candidates.
///
/// # Errors
/// An output that can't be written.
pub fn print_candidates(root: Command, arguments: &CompleteArguments) -> anyhow::Result<Exit> {
    let words = &arguments.words;
    if let Some(theirs) = words_of_laboratory(&root, words) {
        if let Ok(path) = laboratory::find() {
            // It returns when the laboratory can't be started.
            let _ = std::process::Command::new(path).args(["complete", "--"]).args(theirs).exec();
        }
        return Ok(Exit::Done);
    }
    let lines = candidates(root, words, &std::env::current_dir().unwrap_or_default());
    if !lines.is_empty() {
        data(&lines)?;
    }
    Ok(Exit::Done)
}

/// The candidates, as they are printed.
fn candidates(root: Command, words: &[OsString], folder: &Path) -> String {
    let Some(last) = words.len().checked_sub(1) else { return String::new() };
    let mut root = values::with_values(root, &Context::of(words));
    // A place that takes no word is no error of the one who types.
    let found = complete(&mut root, words.to_vec(), last, Some(folder)).unwrap_or_default();
    // Options are offered where one has begun, or where there is nothing else.
    let is_option =
        |candidate: &CompletionCandidate| candidate.get_value().as_encoded_bytes().starts_with(b"-");
    let has_others = found.iter().any(|candidate| !is_option(candidate));
    let wants_all = !has_others || words[last].as_encoded_bytes().starts_with(b"-");
    let shown = found.iter().filter(|candidate| wants_all || !is_option(candidate));
    shown.map(line).collect()
}

fn line(candidate: &CompletionCandidate) -> String {
    let value = candidate.get_value().to_string_lossy();
    let help = candidate.get_help().map(ToString::to_string).unwrap_or_default();
    format!("{value}\t{}\n", help.lines().next().unwrap_or_default())
}

/// The words as the laboratory has them, if the word to complete belongs to a command that is handed over to it.
fn words_of_laboratory(root: &Command, words: &[OsString]) -> Option<Vec<OsString>> {
    let mut command = root;
    let last = words.len().checked_sub(1)?;
    for (index, word) in words.iter().enumerate().take(last).skip(1) {
        if let Some(next) = word.to_str().and_then(|word| command.find_subcommand(word)) {
            command = next;
        }
        if laboratory::is_handed_over(command) {
            let verb = [OsStr::new("scanloop-lab"), OsStr::new(command.get_name())].map(OsStr::to_owned);
            return Some(verb.into_iter().chain(words[index + 1..].iter().cloned()).collect());
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::cli::Cli;

    fn words(line: &str) -> Vec<OsString> {
        line.split(' ').map(OsString::from).collect()
    }

    fn offered(line: &str) -> Vec<String> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
        let lines = candidates(Cli::command(), &words(line), folder);
        lines.lines().map(|line| line.split('\t').next().unwrap().to_owned()).collect()
    }

    #[test]
    fn a_word_is_completed_by_what_may_stand_there() {
        for (line, expected) in [
            ("scanloop sw", &["swap"][..]),
            ("scanloop --quie", &[]),
            ("scanloop run --quie", &["--quiet"]),
            ("scanloop run corr", &["corridor"]),
            ("scanloop swap con", &["controller"]),
            ("scanloop swap controller --to nm", &["nmpc"]),
            ("scanloop topic echo obst", &["obstacles"]),
            ("scanloop run --set robot.velocity_fac", &["robot.velocity_factor="]),
            ("scanloop run --set=robot.velocity_fac", &["--set=robot.velocity_factor="]),
            ("scanloop set controller.profile=so", &["controller.profile=source"]),
            ("scanloop run --set contr", &["controller."]),
            ("scanloop replay FILE --with esti", &["estimator="]),
            ("scanloop completions zs", &["zsh"]),
            ("scanloop check Cargo.to", &["Cargo.toml"]),
        ] {
            assert_eq!(offered(line), expected, "{line}");
        }
        assert!(offered("scanloop ").contains(&"run".to_owned()));
        assert!(!offered("scanloop ").iter().any(|word| word == "complete" || word.starts_with('-')));
        assert!(
            offered("scanloop stop ").contains(&"--all".to_owned()),
            "options, where there is nothing else"
        );
        assert_eq!(candidates(Cli::command(), &[], Path::new("/")), "");
    }

    #[test]
    fn words_behind_a_command_of_the_laboratory_are_its_own() {
        let theirs = |line: &str| words_of_laboratory(&Cli::command(), &words(line));
        assert_eq!(theirs("scanloop campaign --ru"), Some(words("scanloop-lab campaign --ru")));
        assert_eq!(
            theirs("scanloop --system-id a bench solver --json "),
            Some(words("scanloop-lab solver --json "))
        );
        for ours in ["scanloop campaign", "scanloop bench la", "scanloop bench latency --ra", "scanloop", ""]
        {
            assert_eq!(theirs(ours), None, "{ours}");
        }
    }

    #[test]
    fn each_shell_gets_a_script_for_both_executables_that_asks_for_the_candidates() {
        for shell in Shell::value_variants() {
            let script = shell.script();
            assert!(script.contains("complete -- ") && script.contains("scanloop-lab"), "{script}");
        }
    }
}
