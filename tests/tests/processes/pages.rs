//! The commands of README, docs and examples run, and print what the pages show.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::process::{Command, Output};

use clap::Parser;
use clap::error::ErrorKind;
use commands::cli::Cli;
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::pages::{
    How, commands, commands_in_prose, compare_or_write, figures, how, pages, read, words,
};
use scanloop_tests::{TestSystem, printed};

use super::languages::tools::{DEAD_RECKONING, EXECUTABLE, root};

/// Spans of the prose that are no whole commands.
const FRAGMENTS: [&str; 0] = [];

/// A folder as the reader's after the build: the examples, and `scanloop` in the `PATH`.
fn reader() -> TestSystem {
    let system = TestSystem::new(EXECUTABLE);
    let folder = system.folder();
    std::fs::create_dir_all(folder.join("target/release")).unwrap();
    let link = |from: &std::path::Path, to: &str| std::os::unix::fs::symlink(from, folder.join(to)).unwrap();
    link(EXECUTABLE.as_ref(), "target/release/scanloop");
    link(DEAD_RECKONING.as_ref(), "target/release/dead-reckoning");
    link(&root().join("examples"), "examples");
    system
}

fn shell(system: &TestSystem, line: &str) -> Output {
    let path = format!("{}/target/release:{}", system.folder().display(), std::env::var("PATH").unwrap());
    let mut command = Command::new("bash");
    command.args(["-c", line]).current_dir(system.folder()).env("PATH", path);
    command.env("SCANLOOP_SYSTEM_ID", system.id()).output().unwrap()
}

/// The command with more words before its comment.
fn with(line: &str, more: &str) -> String {
    match line.split_once(" #") {
        Some((command, comment)) => format!("{} {more} #{comment}", command.trim_end()),
        None => format!("{line} {more}"),
    }
}

/// All commands of the pages, each once, with how it is tried.
fn all() -> Vec<(String, String, How)> {
    let mut found: Vec<(String, String, How)> = Vec::new();
    let mut without_rule = Vec::new();
    for page in pages() {
        for line in commands(&read(&page)) {
            if found.iter().any(|(_, other, _)| *other == line) {
                continue;
            }
            match how(&line) {
                Some(how) => found.push((page.clone(), line, how)),
                None => without_rule.push(format!("{page}: {line}")),
            }
        }
    }
    assert!(
        without_rule.is_empty(),
        "say in tests/src/pages/rules.rs how to try\n{}",
        without_rule.join("\n")
    );
    assert!(found.len() > 150, "{}", found.len());
    found
}

/// Whether a word stands for what the reader fills in.
fn is_place(word: &str) -> bool {
    word.chars().all(|letter| letter.is_ascii_uppercase())
}

#[test]
fn the_options_of_every_command_of_the_pages_exist() {
    repeat_when_late(|| {
        let mut wrong = Vec::new();
        let mut prose = Vec::new();
        for page in pages() {
            prose.extend(commands_in_prose(&read(&page)).into_iter().map(|line| (page.clone(), line)));
        }
        let blocks = all().into_iter().filter(|(_, _, how)| !matches!(how, How::Not(_)));
        let blocks = blocks.map(|(page, line, _)| (page, line, false));
        for (page, line, is_prose) in blocks.chain(prose.into_iter().map(|(page, line)| (page, line, true))) {
            let words = words(&line);
            let is_whole =
                words.first().is_some_and(|word| word == "scanloop") && !FRAGMENTS.contains(&line.as_str());
            if is_whole && let Err(error) = Cli::try_parse_from(&words) {
                let is_help = !error.use_stderr();
                let text = error.to_string();
                // A sentence may name a command without its arguments, or an option without its value.
                let is_part = is_prose
                    && (text.contains("were not provided")
                        || text.contains("none was supplied")
                        || text.contains("invalid value") && words.iter().any(|word| is_place(word))
                        || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand);
                if !is_help && !is_part {
                    wrong.push(format!(
                        "{page}: {line}: {}",
                        error.to_string().lines().next().unwrap_or_default()
                    ));
                }
            }
        }
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    });
}

#[test]
fn commands_of_the_pages_that_end_by_themselves_run_as_they_stand() {
    repeat_when_late(|| {
        let system = reader();
        let mut wrong = Vec::new();
        for (page, line, how) in all() {
            let How::Alone(more, codes) = how else { continue };
            let output = shell(&system, &with(&line, more));
            if !output.status.code().is_some_and(|code| codes.contains(&code)) {
                wrong.push(format!("{page}: {line}: {}\n{}", output.status, printed(&output)));
            }
        }
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
        system.assert_nothing_left();
    });
}

#[test]
fn commands_of_the_pages_for_a_running_system_do_what_they_say() {
    repeat_when_late(|| {
        let mut system = reader();
        system.start(&["endless", "--allow-inject"]);
        let mut wrong = Vec::new();
        for (page, line, how) in all() {
            let line = match how {
                How::Beside(more) => with(&line, more),
                How::As(instead) => instead.to_owned(),
                _ => continue,
            };
            if line.contains("run --lockstep") || line.contains(" imu") {
                continue;
            }
            let output = shell(&system, &line);
            if output.status.code() != Some(0) {
                wrong.push(format!("{page}: {line}: {}\n{}", output.status, printed(&output)));
            }
        }
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn figures_of_the_pages_are_those_that_are_printed() {
    repeat_when_late(|| {
        let system = reader();
        let mut count = 0;
        for page in pages() {
            for (command, shown) in figures(&read(&page)) {
                let output = shell(&system, &command);
                compare_or_write(&page, &shown, &printed(&output));
                count += 1;
            }
        }
        assert!(count > 0);
        system.assert_nothing_left();
    });
}
