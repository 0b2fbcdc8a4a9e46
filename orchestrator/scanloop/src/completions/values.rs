//! What arguments take: names that this executable knows, and those of the systems that run now.

use std::ffi::OsString;

use clap::{Arg, Command, ValueHint};
use clap_complete::engine::{ArgValueCandidates, ArgValueCompleter, CompletionCandidate};
use emulator::Scenario;
use plan::reference;
use runtime::{Domain, OwnTopics, SYSTEM_ID_VARIABLE};
use shared_types::{Role, TOPICS};
use supervision::entry::IMPLEMENTATIONS;

/// What the words before the cursor choose.
#[derive(Debug, Clone)]
pub(super) struct Context {
    system_id: String,
}

impl Context {
    /// The system that is named by an option, the environment, or else the default.
    pub(super) fn of(words: &[OsString]) -> Self {
        let texts: Vec<&str> = words.iter().filter_map(|word| word.to_str()).collect();
        let next = texts.windows(2).rev().find(|pair| pair[0] == "--system-id").map(|pair| pair[1]);
        let joined = texts.iter().rev().find_map(|word| word.strip_prefix("--system-id="));
        let named = next.or(joined).map(str::to_owned);
        let system_id = named.or_else(|| std::env::var(SYSTEM_ID_VARIABLE).ok());
        Self { system_id: system_id.unwrap_or_else(|| crate::cli::DEFAULT_SYSTEM_ID.to_owned()) }
    }

    /// Topics and companions of the system, if it runs.
    fn own(&self) -> Option<OwnTopics> {
        let domain = supervision::runs::find(&self.system_id).ok().flatten()?;
        OwnTopics::of(&domain).ok().flatten()
    }
}

/// What an argument takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Values {
    SystemIds,
    Roles,
    RolesOrCompanions,
    /// `controller=`, before a program.
    RolesWithProgram,
    Topics,
    Implementations,
    /// Shipped ones, and files.
    Scenarios,
    Faults,
    /// Of the matrix: `pose-late-50ms`, and then its phases.
    Cells,
    /// `robot.velocity_factor=`, and then its values.
    Keys,
    KeyNames,
    Paths,
}

/// The argument by its command (any, if empty) and its id, and what it takes.
const ARGUMENTS: &[(&str, &str, Values)] = &[
    ("", "system_id", Values::SystemIds),
    ("swap", "role", Values::RolesOrCompanions),
    ("restart", "role", Values::RolesOrCompanions),
    ("", "role", Values::Roles),
    ("replay", "with", Values::RolesWithProgram),
    ("faults", "with", Values::RolesWithProgram),
    ("", "topic", Values::Topics),
    ("swap", "to", Values::Implementations),
    ("shadow", "to", Values::Implementations),
    ("conformance", "to", Values::Implementations),
    ("service", "name", Values::Implementations),
    ("", "scenario", Values::Scenarios),
    ("", "scenarios", Values::Scenarios),
    ("check", "files", Values::Scenarios),
    ("", "fault", Values::Faults),
    ("faults", "only", Values::Cells),
    ("", "overrides", Values::Keys),
    ("", "set", Values::Keys),
    ("reference", "text", Values::KeyNames),
    ("", "command", Values::Paths),
];

/// The command line with what its arguments take.
pub(super) fn with_values(root: Command, context: &Context) -> Command {
    let name = root.get_name().to_owned();
    let root = root.mut_args(|arg| with_values_of(&name, arg, context));
    root.mut_subcommands(|command| with_values(command, context))
}

fn with_values_of(command: &str, arg: Arg, context: &Context) -> Arg {
    let takes_values = arg.get_action().takes_values() && arg.get_possible_values().is_empty();
    let is_it =
        |(of, id, _): &&(&str, &str, Values)| (of.is_empty() || *of == command) && arg.get_id() == *id;
    match ARGUMENTS.iter().find(is_it).filter(|_| takes_values) {
        Some((_, _, Values::Paths)) => arg.value_hint(ValueHint::AnyPath),
        Some((_, _, Values::Scenarios)) => arg.add(ArgValueCompleter::new(scenarios)),
        Some((_, _, Values::Cells)) => arg.add(ArgValueCompleter::new(cells)),
        Some((_, _, Values::Keys)) => arg.add(ArgValueCompleter::new(keys)),
        Some((_, _, values)) => {
            let (values, context) = (*values, context.clone());
            arg.add(ArgValueCandidates::new(move || values.candidates(&context)))
        }
        None => arg,
    }
}

impl Values {
    fn candidates(self, context: &Context) -> Vec<CompletionCandidate> {
        let roles = || Role::ALL.iter().map(|role| role.name().to_owned());
        match self {
            Self::SystemIds => {
                plain(Domain::all_found().0.iter().map(|domain| domain.system_id().to_owned()))
            }
            Self::Roles => plain(roles()),
            Self::RolesOrCompanions => {
                let companions = context.own().into_iter().flat_map(|own| own.companion);
                plain(roles().chain(companions.map(|companion| companion.name)))
            }
            Self::RolesWithProgram => plain(roles().map(|role| role + "=")),
            Self::Topics => {
                let own = context.own().into_iter().flat_map(|own| own.topic).map(|topic| topic.name);
                plain(TOPICS.iter().map(|topic| topic.name().to_owned()).chain(own))
            }
            Self::Implementations => {
                let of = |(name, role): &(&str, Role)| {
                    CompletionCandidate::new(*name).help(Some(format!("role {role}").into()))
                };
                IMPLEMENTATIONS.iter().map(of).collect()
            }
            Self::Faults => plain(faults::live_names().unwrap_or_default()),
            Self::KeyNames => plain(reference::settable().into_iter().map(|key| key.path)),
            Self::Scenarios | Self::Cells | Self::Keys | Self::Paths => Vec::new(),
        }
    }
}

fn plain<T: Into<OsString>>(names: impl IntoIterator<Item = T>) -> Vec<CompletionCandidate> {
    names.into_iter().map(CompletionCandidate::new).collect()
}

/// Names of shipped scenarios, and files.
fn scenarios(typed: &std::ffi::OsStr) -> Vec<CompletionCandidate> {
    use clap_complete::engine::{PathCompleter, ValueCompleter};
    let typed_text = typed.to_string_lossy();
    let mut found = plain(Scenario::names().filter(|name| name.starts_with(&*typed_text)));
    // In a folder with many files the names alone are of use.
    if !typed.is_empty() {
        found.extend(PathCompleter::any().complete(typed));
    }
    found
}

/// Names of faults, and the phases of a whole name.
fn cells(typed: &std::ffi::OsStr) -> Vec<CompletionCandidate> {
    let typed = typed.to_string_lossy();
    let mut found = Vec::new();
    for fault in faults::all().unwrap_or_default() {
        if fault.name.starts_with(&*typed) {
            found.push(CompletionCandidate::new(&fault.name));
        } else if typed.strip_prefix(&*fault.name).is_some_and(|rest| rest.starts_with('/')) {
            let names = fault.phases().map(|phase| format!("{}/{phase}", fault.name));
            found.extend(plain(names.filter(|name| name.starts_with(&*typed))));
        }
    }
    found
}

/// Keys up to their next table, and values of a whole key.
fn keys(typed: &std::ffi::OsStr) -> Vec<CompletionCandidate> {
    let typed = typed.to_string_lossy();
    let keys = reference::settable();
    if let Some((path, value)) = typed.split_once('=') {
        let of_key = keys.iter().filter(|key| key.path == path).flat_map(|key| key.values());
        return plain(of_key.filter(|known| known.starts_with(value)).map(|known| format!("{path}={known}")));
    }
    let mut found: Vec<CompletionCandidate> = Vec::new();
    for key in keys.iter().filter(|key| key.path.starts_with(&*typed)) {
        let candidate = match key.path[typed.len()..].find('.') {
            Some(table) => CompletionCandidate::new(&key.path[..=typed.len() + table]),
            None => CompletionCandidate::new(format!("{}=", key.path)).help(Some(key.meaning.into())),
        };
        // The keys of a table follow each other.
        if found.last().is_none_or(|last| last.get_value() != candidate.get_value()) {
            found.push(candidate);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::cli::Cli;

    fn has(command: &Command, row: &(&str, &str, Values)) -> bool {
        let (of, id, _) = row;
        let is_here = (of.is_empty() || *of == command.get_name())
            && command.get_arguments().any(|arg| arg.get_id() == *id);
        is_here || command.get_subcommands().any(|below| has(below, row))
    }

    #[test]
    fn every_row_is_about_an_argument() {
        // These are arguments of the laboratory.
        let is_of_laboratory = |row: &&(&str, &str, Values)| row.0 == "faults" || row.1 == "scenarios";
        for row in ARGUMENTS.iter().filter(|row| !is_of_laboratory(row)) {
            assert!(has(&Cli::command(), row), "{row:?}");
        }
    }

    #[test]
    fn the_system_is_the_one_that_is_named() {
        let of = |line: &str| {
            let words: Vec<OsString> = line.split(' ').map(OsString::from).collect();
            Context::of(&words).system_id
        };
        assert_eq!(of("scanloop --system-id one status"), "one");
        assert_eq!(of("scanloop status --system-id=two --json"), "two");
    }
}
