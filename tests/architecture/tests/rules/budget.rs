//! Crates and pages are no larger than `budget.toml` allows.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::process::Command;

use crate::{files, root};

/// Pages of `docs/` that are made from the code.
const GENERATED: [&str; 6] =
    ["commands.md", "conformance-cases.md", "faults.md", "scenario-file.md", "system-file.md", "topics.md"];

/// What is wrong with sizes by name: above its row, without a row, or a row of nothing.
fn beyond(sizes: &BTreeMap<String, i64>, rows: &toml::Table, unit: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (name, size) in sizes {
        match rows.get(name).and_then(|row| row.get(unit)).and_then(toml::Value::as_integer) {
            Some(most) if *size <= most => {}
            Some(most) => found.push(format!("{name}: {size} {unit}, its row allows {most}")),
            None => found.push(format!("{name}: {size} {unit}, without a row")),
        }
    }
    found.extend(
        rows.keys().filter(|name| !sizes.contains_key(*name)).map(|name| format!("{name} is not there")),
    );
    for (name, row) in rows {
        let why = row.get("holds").and_then(toml::Value::as_str).unwrap_or_default();
        if why.split_whitespace().count() < 4 {
            found.push(format!("{name}: `holds` says what it holds and why it may be that large"));
        }
    }
    found
}

fn budget() -> toml::Table {
    std::fs::read_to_string(root().join("tests/architecture/budget.toml")).unwrap().parse().unwrap()
}

fn rows<'a>(budget: &'a toml::Table, name: &str) -> &'a toml::Table {
    budget.get(name).and_then(toml::Value::as_table).unwrap()
}

/// Lines of code by crate and by group, as `tests/lines` prints them.
fn lines() -> BTreeMap<String, i64> {
    let output = Command::new(root().join("tests/lines")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    let row = |line: &str| {
        let (name, rest) = line.trim().split_once("  ")?;
        Some((name.to_owned(), rest.split_whitespace().next()?.parse().ok()?))
    };
    text.lines().skip(1).filter_map(row).filter(|(name, _)| name != "all").collect()
}

#[test]
fn crates_and_their_groups_have_no_more_lines_than_their_rows() {
    let sizes = lines();
    assert!(sizes.len() > 30, "{sizes:?}");
    assert_eq!(beyond(&sizes, rows(&budget(), "crates"), "lines"), [""; 0]);
}

#[test]
fn pages_have_no_more_words_than_their_rows() {
    let folders = ["docs", "examples", "benches"].map(|folder| files(&root().join(folder), ".md")).concat();
    // Text of a program is part of the page that it prints.
    let is_page = |path: &std::path::PathBuf| !path.iter().any(|part| part == "src");
    let folders = folders.into_iter().filter(is_page);
    let pages = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"].map(|name| root().join(name));
    let is_decision = |path: &std::path::PathBuf| path.starts_with(root().join("docs/decisions"));
    let (decisions, pages): (Vec<_>, Vec<_>) = folders.chain(pages).partition(is_decision);
    let words = |path: &std::path::PathBuf| {
        std::fs::read_to_string(path).unwrap().split_whitespace().count().cast_signed() as i64
    };
    let name = |path: &std::path::PathBuf| path.strip_prefix(root()).unwrap().to_string_lossy().into_owned();
    let mut sizes: BTreeMap<String, i64> = pages.iter().map(|path| (name(path), words(path))).collect();
    sizes.insert("docs/decisions".to_owned(), decisions.iter().map(words).sum());
    let generated = |name: &str| GENERATED.iter().any(|page| name.strip_prefix("docs/") == Some(*page));
    let of_docs =
        |(name, _): &(&String, &i64)| name.starts_with("docs/") && name.ends_with(".md") && !generated(name);
    let all: i64 = sizes.iter().filter(of_docs).map(|(_, words)| words).sum();
    sizes.insert("docs/*.md that are not generated".to_owned(), all);
    assert_eq!(beyond(&sizes, rows(&budget(), "pages"), "words"), [""; 0]);
}

#[test]
fn a_size_above_its_row_a_missing_row_and_one_of_nothing_are_found() {
    let rows = "[a]\nlines = 10\nholds = \"what a crate holds\"\n[b]\nlines = 3\nholds = \"short\"\n"
        .parse()
        .unwrap();
    let sizes = [("a", 11), ("c", 1)].map(|(name, size)| (name.to_owned(), size)).into_iter().collect();
    let found = beyond(&sizes, &rows, "lines");
    assert_eq!(found.len(), 4, "{found:?}");
    let fits = [("a".to_owned(), 10), ("b".to_owned(), 3)].into_iter().collect();
    assert_eq!(beyond(&fits, &rows, "lines").len(), 1);
}
