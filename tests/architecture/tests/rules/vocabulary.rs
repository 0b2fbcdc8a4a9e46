//! Code, messages and pages use the words of `docs/glossary.md`.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::Path;

use architecture::glossary::{Glossary, Hit};
use architecture::markdown::prose;
use architecture::rust_text::{Part, parts};

use crate::{files, root};

/// It lists what is refused.
const GLOSSARY: &str = "docs/glossary.md";
/// Files with prose or names, by how their names end. What is generated is printed from Rust sources, which are read.
const READ: [&str; 8] = [".rs", ".md", ".py", ".c", ".toml", ".sh", ".service", ".h"];

/// Everything refused in a file, allowed or not.
fn hits(glossary: &Glossary, file: &str, text: &str) -> Vec<Hit> {
    if file.ends_with(".md") {
        let prose = prose(text);
        return glossary.phrases_in(prose.iter().map(|(line, text)| (*line, text.as_str())));
    }
    if !file.ends_with(".rs") {
        // Comments and code alike: a phrase is not code.
        return glossary.phrases_in(text.lines().enumerate().map(|(index, line)| (index + 1, line)));
    }
    let parts = parts(text);
    let mut found: Vec<Hit> = Vec::new();
    let mut texts = Vec::new();
    for part in &parts {
        match part {
            Part::Code(line, code) => {
                found.extend(glossary.names_in(code, *line));
                // A text ends where code stands.
                if !code.trim().is_empty() {
                    texts.push((*line, "."));
                }
            }
            Part::Text(line, text) => texts.push((*line, *text)),
        }
    }
    found.extend(glossary.phrases_in(texts.into_iter()));
    found
}

/// Path of a file below the root.
fn name(file: &Path) -> String {
    file.strip_prefix(root()).unwrap().to_string_lossy().into_owned()
}

#[test]
fn refused_words_are_not_used() {
    let glossary = Glossary::read(&std::fs::read_to_string(root().join(GLOSSARY)).unwrap());
    let (names, phrases) = glossary.len();
    assert!(names > 20 && phrases > 10, "{names} names, {phrases} phrases");
    let (mut refused, mut allowed) = (String::new(), Vec::new());
    for file in READ.iter().flat_map(|end| files(&root(), end)) {
        let (text, file) = (std::fs::read_to_string(&file).unwrap(), name(&file));
        if file == GLOSSARY || file.starts_with("tests/architecture/") {
            continue;
        }
        for Hit { line, word, instead } in hits(&glossary, &file, &text) {
            if glossary.allows(&word, &file) {
                allowed.push((word, file.clone()));
            } else {
                refused += &format!("{file}:{line}: `{word}`: {instead}\n");
            }
        }
    }
    assert!(refused.is_empty(), "{} words that {GLOSSARY} refuses\n{refused}", refused.lines().count());
    let found = |word: &str, place: &str| {
        allowed.iter().any(|(other, file)| other == word && file.starts_with(place))
    };
    assert!(glossary.unneeded(found).is_empty(), "not needed any more: {:?}", glossary.unneeded(found));
}

#[test]
fn a_refused_word_is_found_in_code_comments_messages_and_pages() {
    let page = "### Names\n| not | but |\n|---|---|\n| `roster` | registry |\n### Phrases\n| not | but |\n|---|---|\n| `goes on` | continues |\n";
    let glossary = Glossary::read(page);
    let lines = |file: &str, text: &str| -> Vec<usize> {
        hits(&glossary, file, text).iter().map(|hit| hit.line).collect()
    };
    let code =
        "struct Roster; // it goes on\n/// goes\n/// on\nprint(\"goes \\\n    on\"); f(\"goes\", \"on\");\n";
    assert_eq!(lines("a.rs", code), [1, 1, 2, 4]);
    assert_eq!(lines("a.md", "It goes\non. `goes on`\n```\ngoes on\n```\n"), [1]);
    assert_eq!(lines("a.py", "# It goes on.\nroster = 1\n"), [1]);
}
