//! `scanloop reference`: the keys of files in the terminal, and the pages of the documentation that have a source in code.

mod faults;

use std::fmt::Write as _;

use clap::builder::PossibleValue;
use clap::{Arg, Args, Command, ValueEnum};
use console::exit::Failure;
use plan::reference::{find, names, scenario_page, scenario_schema, system_page, system_schema};
use shared_types::did_you_mean;

/// A page of the documentation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Page {
    /// Keys of the scenario file: docs/scenario-file.md.
    Scenario,
    /// Keys of the system file: docs/system-file.md.
    System,
    /// All commands with their options: docs/commands.md.
    Commands,
    /// The faults of `scanloop faults`: docs/faults.md.
    Faults,
    /// The cases of `scanloop conformance`: docs/conformance-cases.md.
    Conformance,
}

/// A file that has a schema.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FileKind {
    /// Scenario file: docs/schema/scenario.json.
    Scenario,
    /// System file: docs/schema/system.json.
    System,
}

/// Arguments of `reference`.
#[derive(Debug, Args)]
pub struct ReferenceArguments {
    /// Part of the name or of the meaning of a key; without it all keys are listed.
    #[arg(value_name = "TEXT", default_value = "", hide_default_value = true, conflicts_with = "page")]
    pub text: String,
    /// Print a page of the documentation as Markdown instead.
    #[arg(long, value_enum, value_name = "PAGE")]
    pub page: Option<Page>,
    /// Print the JSON Schema of a file instead: editors complete and check with it.
    #[arg(long, value_enum, value_name = "FILE", conflicts_with_all = ["text", "page"])]
    pub schema: Option<FileKind>,
}

/// The keys, or the page, that was asked for; `root` is the whole command line.
///
/// # Errors
/// A text that no key contains; exit code 2.
pub(crate) fn text(arguments: &ReferenceArguments, root: Command) -> anyhow::Result<String> {
    if let Some(kind) = arguments.schema {
        let schema = match kind {
            FileKind::Scenario => scenario_schema(),
            FileKind::System => system_schema(),
        };
        return Ok(serde_json::to_string_pretty(&schema)? + "\n");
    }
    match arguments.page {
        Some(Page::Scenario) => Ok(scenario_page()),
        Some(Page::System) => Ok(system_page()),
        Some(Page::Commands) => Ok(commands_page(root)),
        Some(Page::Faults) => Ok(faults::faults_page(&::faults::all()?)),
        Some(Page::Conformance) => {
            Ok(include_str!("reference/conformance.md").to_owned() + &conformance::list(None)?)
        }
        None => match find(&arguments.text) {
            found if found.is_empty() => {
                let text = &arguments.text;
                let meant = did_you_mean(text.rsplit('.').next().unwrap_or(text), names());
                Err(Failure::bad_input(format!(
                    "{text}: no key of the scenario or the system file has this in its name or meaning.{meant}"
                )))
            }
            found => Ok(found),
        },
    }
}

/// The first half of the page `docs/commands.md`; the exit codes stand below the help of the program.
fn commands_page(mut root: Command) -> String {
    root.build();
    let exit_codes = root.get_after_help().map(ToString::to_string).unwrap_or_default();
    let exit_codes = exit_codes.lines().filter_map(|line| line.trim().split_once("  "));
    let mut text = include_str!("reference/commands.md").to_owned();
    text.push_str("| exit code | meaning |\n|---:|---|\n");
    exit_codes.for_each(|(code, meaning)| _ = writeln!(text, "| {code} | {meaning} |"));
    sections(&mut text, &root, include_str!("reference/json.txt"));
    text
}

/// The second half of the page `docs/commands.md`, of the command line `root` of the laboratory, below its first words;
/// `keys` has a line `COMMAND: KEYS` for each command that prints JSON.
pub fn of_laboratory(mut root: Command, words: &str, keys: &str) -> String {
    root.build();
    let mut text = words.to_owned();
    sections(&mut text, &root, keys);
    text
}

/// A section for each command below `parent` that does something.
fn sections(text: &mut String, parent: &Command, keys: &str) {
    let is_shown = |command: &&Command| command.get_name() != "help" && !command.is_hide_set();
    for command in parent.get_subcommands().filter(is_shown) {
        // One that needs a subcommand does nothing by itself.
        if command.is_subcommand_required_set() {
            sections(text, command, keys);
            continue;
        }
        let about = command.get_long_about().or(command.get_about()).map(|about| sentence(about.to_string()));
        let usage = command.clone().render_usage().to_string().replace("Usage: ", "");
        let _ = writeln!(
            text,
            "\n## {}\n\n{}\n\n```text\n{}\n```",
            command.get_bin_name().unwrap_or_default(),
            about.unwrap_or_default(),
            usage.trim()
        );
        let mut shown = command.get_arguments().filter(|arg| !arg.is_hide_set() && is_own(arg)).peekable();
        if shown.peek().is_some() {
            text.push_str("\n| argument | default | meaning |\n|---|---|---|\n");
        }
        for arg in shown {
            let default = if arg.is_hide_default_value_set() { String::new() } else { default(arg) };
            let _ = writeln!(text, "| `{}` | {default} | {} |", name(arg), meaning(arg));
        }
        let name = command.get_bin_name().unwrap_or_default();
        let of_this = |line: &'_ str| {
            line.strip_prefix(name).and_then(|rest| rest.strip_prefix(": ")).map(str::to_owned)
        };
        if let Some(keys) = keys.lines().find_map(of_this) {
            let _ = writeln!(text, "\nJSON keys: {keys}");
        }
        sections(text, command, keys);
    }
}

/// Whether an argument belongs to the command alone.
fn is_own(arg: &Arg) -> bool {
    !arg.is_global_set() && !["help", "version"].contains(&arg.get_id().as_str())
}

/// An argument as it is written: `--out <DIR>`, `[SCENARIO]`.
fn name(arg: &Arg) -> String {
    let aliases = arg.get_visible_aliases().unwrap_or_default();
    let others = arg.get_short().map(|short| format!("-{short}")).into_iter();
    let others = others.chain(aliases.iter().map(|alias| format!("--{alias}")));
    let dashes = if arg.is_last_set() { "-- " } else { "" };
    others.fold(format!("{dashes}{arg}"), |names, other| format!("{names}, {other}"))
}

fn default(arg: &Arg) -> String {
    let values = arg.get_default_values().iter().filter(|value| !value.is_empty());
    let values = values.map(|value| format!("`{}`", value.to_string_lossy()));
    if arg.get_action().takes_values() { values.collect::<Vec<_>>().join(", ") } else { String::new() }
}

/// Its help in one cell, with the values that it takes.
fn meaning(arg: &Arg) -> String {
    let help = arg.get_long_help().or(arg.get_help()).map(ToString::to_string).unwrap_or_default();
    let mut text = sentence(help.split_whitespace().collect::<Vec<_>>().join(" "));
    let values = arg.get_possible_values();
    let values: Vec<&PossibleValue> = values.iter().filter(|_| arg.get_action().takes_values()).collect();
    for (index, value) in values.iter().enumerate() {
        text += if index == 0 { " Values: " } else { "; " };
        let _ = write!(text, "`{}`", value.get_name());
        if let Some(help) = value.get_help() {
            let _ = write!(text, " ({help})");
        }
    }
    text.replace('|', "\\|")
}

/// The text with the full stop that clap takes away.
fn sentence(text: String) -> String {
    if text.ends_with('.') { text } else { text + "." }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn the_page_has_every_command_with_its_options_defaults_and_values() {
        let page = commands_page(Cli::command());
        let section = |name: &str| {
            let found = page.split("\n## ").find(|part| part.starts_with(&format!("{name}\n")));
            found.unwrap_or_else(|| panic!("{name} is missing in {page}"))
        };
        assert!(section("scanloop run").contains("| `--lockstep` |  | Simulate time"));
        assert!(section("scanloop swap").contains("| `--shadow-scans <N>, --gate-scans` | `10` |"));
        assert!(section("scanloop topic echo").contains("| `<TOPIC>` |"));
        assert!(section("scanloop calibrate").contains("Values: `velocity` ("));
        assert!(!section("scanloop stop").contains("--finish"));
        assert!(page.contains("\n| 3 | collision |\n"));
        for command in Cli::command().get_subcommands().filter(|command| !command.is_hide_set()) {
            assert!(
                page.contains(&format!("\n## scanloop {}", command.get_name())),
                "{}",
                command.get_name()
            );
        }
    }

    #[test]
    fn a_text_that_no_key_has_is_refused() {
        let arguments = |text: &str| ReferenceArguments { text: text.to_owned(), page: None, schema: None };
        assert!(
            text(&arguments("propeller"), Cli::command())
                .unwrap_err()
                .to_string()
                .starts_with("propeller: no key")
        );
        assert!(text(&arguments(""), Cli::command()).unwrap().lines().count() > 200);
    }
}
