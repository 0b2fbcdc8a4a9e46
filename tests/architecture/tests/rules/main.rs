//! Rules of the code base that no compiler checks.

mod arrows;
mod code;
mod equations;

use std::path::PathBuf;

/// Root of the workspace.
fn root() -> PathBuf {
    std::path::Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("two folders up").to_path_buf()
}
