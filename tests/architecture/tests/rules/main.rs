//! Rules of the code base that no compiler checks.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod arrows;
mod budget;
mod code;
mod equations;
mod links;
mod locks;
mod types;
mod vocabulary;

use std::path::{Path, PathBuf};

/// Root of the workspace.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("two folders up").to_path_buf()
}

/// All files below a folder whose names end with `end`, without build output.
fn files(folder: &Path, end: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        let name = entry.file_name().to_string_lossy().into_owned();
        if path.is_dir() && !["target", "out"].contains(&name.as_str()) && !name.starts_with('.') {
            found.extend(files(&path, end));
        } else if name.ends_with(end) {
            found.push(path);
        }
    }
    found
}
