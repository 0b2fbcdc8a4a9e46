//! The pages of the documentation: their commands, and the figures that a test compares and can write anew.

mod rules;

use std::path::{Path, PathBuf};

pub use rules::{How, how};

/// Pages with tests of their own: the tutorial runs as a whole, and the list of commands is generated.
const OTHERS: [&str; 3] = ["docs/tutorial.md", "docs/commands.md", "CHANGELOG.md"];
/// With this variable, tests write the figures into the pages instead of comparing them.
const WRITE: &str = "SCANLOOP_WRITE_PAGES";
/// Before a block with what a command in lock-step prints.
const MARK: &str = "<!-- printed by: ";

/// Root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().map(Path::to_path_buf).unwrap_or_default()
}

/// Pages whose commands are run, relative to the root.
pub fn pages() -> Vec<String> {
    let mut found = Vec::new();
    for folder in ["", "docs", "examples", "examples/template-robot", "benches"] {
        let entries = std::fs::read_dir(root().join(folder)).expect("a folder of the repository");
        for entry in entries.flatten() {
            let name = Path::new(folder).join(entry.file_name()).to_string_lossy().into_owned();
            if name.ends_with(".md") && !OTHERS.contains(&name.as_str()) {
                found.push(name);
            }
        }
    }
    found.sort();
    found
}

/// The text of a page.
pub fn read(page: &str) -> String {
    std::fs::read_to_string(root().join(page)).expect("a page")
}

/// The commands in the blocks of a page, in their order; one that continues on the next line is one.
pub fn commands(page: &str) -> Vec<String> {
    let (mut found, mut block) = (Vec::<String>::new(), None);
    for line in page.lines() {
        match (line.strip_prefix("```"), block) {
            (Some(language), None) => block = Some(["sh", ""].contains(&language)),
            (Some(_), Some(_)) => block = None,
            (None, Some(true)) if !line.trim().is_empty() => match found.last_mut() {
                Some(last) if last.ends_with('\\') => {
                    last.pop();
                    last.push_str(line.trim());
                }
                _ => found.push(line.trim().to_owned()),
            },
            _ => {}
        }
    }
    found
}

/// Commands of this program in the prose of a page, that name no place to fill in.
pub fn commands_in_prose(page: &str) -> Vec<String> {
    let mut is_block = false;
    let mut found = Vec::new();
    for line in page.lines() {
        is_block ^= line.starts_with("```");
        let spans = line.split('`').skip(1).step_by(2);
        let of_scanloop = spans.filter(|span| !is_block && span.starts_with("scanloop "));
        found.extend(of_scanloop.map(str::to_owned));
    }
    found
}

/// The words of a command as a shell takes them, without its comment and what is done with its output.
pub fn words(command: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::<String>::new(), None::<String>, None::<char>);
    for letter in command.chars() {
        match (quote, letter) {
            (Some(end), letter) if letter == end => quote = None,
            (None, '\'' | '"') => {
                quote = Some(letter);
                word.get_or_insert_default();
            }
            (None, ' ') => words.extend(word.take()),
            (None, '#') if word.is_none() => break,
            (None, '>' | '|' | '&' | ';') => break,
            (_, letter) => word.get_or_insert_default().push(letter),
        }
    }
    words.extend(word);
    words
}

/// Whether the figures are to be written into the pages.
pub fn is_writing() -> bool {
    std::env::var_os(WRITE).is_some()
}

/// Compares what a block shows with what was printed, or writes it into the page.
///
/// # Panics
/// When a line differs; the message has the command that writes it.
pub fn compare_or_write(page: &str, shown: &[String], printed: &str) {
    let now = refreshed(shown, printed).unwrap_or_else(|line| panic!("{page}: {line}: not in\n{printed}"));
    if now == shown {
        return;
    }
    assert!(
        is_writing(),
        "{page} shows\n{}\nand this is printed:\n{}\ntests/pages writes it",
        shown.join("\n"),
        now.join("\n")
    );
    let text = read(page).replace(&shown.join("\n"), &now.join("\n"));
    std::fs::write(root().join(page), text).expect("a page");
}

/// The shown lines as they were printed; `...` and empty lines stay. A line is found by its words, else by its heading.
///
/// # Errors
/// The first line that was not printed.
pub fn refreshed(shown: &[String], printed: &str) -> Result<Vec<String>, String> {
    let heading = |line: &str| line.split("  ").next().unwrap_or_default().to_owned();
    let of = |line: &String| {
        if line.is_empty() || line == "..." {
            return Ok(line.clone());
        }
        let by_words = printed.lines().find(|other| without_numbers(other) == without_numbers(line));
        let found = by_words.or_else(|| printed.lines().find(|other| heading(other) == heading(line)));
        found.map(|found| found.trim_end().to_owned()).ok_or_else(|| line.clone())
    };
    shown.iter().map(of).collect()
}

/// The marked blocks of a page: the command, and the lines that it prints.
pub fn figures(page: &str) -> Vec<(String, Vec<String>)> {
    let (mut found, mut lines) = (Vec::<(String, Vec<String>)>::new(), page.lines());
    while let Some(line) = lines.next() {
        let Some(command) = line.strip_prefix(MARK).and_then(|rest| rest.strip_suffix(" -->")) else {
            continue;
        };
        let block = lines.by_ref().skip_while(|line| !line.starts_with("```")).skip(1);
        found
            .push((command.to_owned(), block.take_while(|line| *line != "```").map(str::to_owned).collect()));
    }
    found
}

/// A line with `#` for each number and one blank between words.
pub fn without_numbers(line: &str) -> String {
    let words = line.split_whitespace().collect::<Vec<_>>().join(" ");
    let (mut text, mut rest) = (String::new(), words.as_str());
    while let Some(first) = rest.chars().next() {
        let sign = usize::from(first == '-');
        let is_number = rest[sign..].starts_with(|next: char| next.is_ascii_digit());
        let is_part = |next: char| next.is_ascii_digit() || next == '.';
        let length = if is_number {
            text.push('#');
            rest[sign..].find(|next| !is_part(next)).map_or(rest.len(), |end| sign + end)
        } else {
            text.push(first);
            first.len_utf8()
        };
        rest = &rest[length..];
    }
    text
}
