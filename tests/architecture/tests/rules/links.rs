//! Links between the pages of the repository lead somewhere, anchors included.

use std::path::{Path, PathBuf};

use architecture::markdown::{anchors, links, spans};

use crate::{files, root};

/// Links of a page that lead nowhere.
fn dead_links(page: &Path, text: &str) -> Vec<String> {
    let leads_nowhere = |target: &str| {
        let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
        let file: PathBuf =
            if file.is_empty() { page.to_owned() } else { page.with_file_name("").join(file) };
        let has_anchor = || {
            let text = if file == page {
                text.to_owned()
            } else {
                std::fs::read_to_string(&file).unwrap_or_default()
            };
            anchors(&text).iter().any(|other| other == anchor)
        };
        !file.exists() || !anchor.is_empty() && !has_anchor()
    };
    let is_local = |target: &str| !target.contains("://") && !target.starts_with("mailto:");
    let dead = links(text).into_iter().filter(|(_, target)| is_local(target) && leads_nowhere(target));
    dead.map(|(line, target)| format!("{}:{line}: {target}\n", page.display())).collect()
}

#[test]
fn links_between_pages_resolve() {
    // Texts next to code are parts of generated pages, which are checked where they are printed to.
    let is_page = |file: &PathBuf| !file.iter().any(|part| part == "src");
    let pages: Vec<PathBuf> = files(&root(), ".md").into_iter().filter(is_page).collect();
    assert!(pages.len() > 40, "{pages:?}");
    let read = |page: &PathBuf| dead_links(page, &std::fs::read_to_string(page).unwrap());
    let dead: String = pages.iter().flat_map(read).collect();
    assert!(dead.is_empty(), "\n{dead}");
}

/// Rust files and pages that a page names in code spans, and that no file's path ends with.
fn missing_files<'a>(page: &'a str, existing: &[PathBuf]) -> Vec<&'a str> {
    // `my-controller/src/main.rs` is a file of the reader's.
    let is_file = |span: &&str| {
        !span.starts_with("my-")
            && (span.ends_with(".rs") || span.ends_with(".md"))
            && span.chars().all(|c| c.is_alphanumeric() || matches!(c, '/' | '.' | '-' | '_'))
    };
    let exists = |span: &str| existing.iter().any(|file| file.ends_with(span.trim_start_matches("../")));
    spans(page).into_iter().filter(is_file).filter(|span| !exists(span)).collect()
}

#[test]
fn files_that_pages_name_exist() {
    let pages = files(&root(), ".md");
    let existing = [files(&root(), ".rs"), pages.clone()].concat();
    // The past names files that are gone.
    for page in pages.iter().filter(|page| !page.ends_with("CHANGELOG.md")) {
        let text = std::fs::read_to_string(page).unwrap();
        assert_eq!(missing_files(&text, &existing), [""; 0], "{}", page.display());
    }
}

#[test]
fn a_file_that_does_not_exist_is_found() {
    let existing = [PathBuf::from("/root/services/nmpc/src/lattice.rs")];
    let page =
        "`nmpc/src/lattice.rs`, `lattice.rs`, `attice.rs` and `ocp/src/lattice.rs`, `FILE.toml`, `a b.rs`";
    assert_eq!(missing_files(page, &existing), ["attice.rs", "ocp/src/lattice.rs"]);
}

#[test]
fn dead_links_are_found() {
    let page = root().join("docs/glossary.md");
    let text = "# One\n[a](#one) [b](#two) [c](swap.md) [d](none.md) [e](swap.md#none) [f](https://none)";
    assert_eq!(dead_links(&page, text).len(), 3);
}
