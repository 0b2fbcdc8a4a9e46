//! Prints the circles between files of the crates that are named, or of all.
//!
//! usage: circles [CRATE...]; exit code 1 when there is one.

use std::path::Path;
use std::process::ExitCode;

use architecture::circles::Graph;
use architecture::modules::Sources;
use architecture::packages::packages;

fn main() -> anyhow::Result<ExitCode> {
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut exit = ExitCode::SUCCESS;
    for package in packages(&root)? {
        if !wanted.is_empty() && !wanted.contains(&package.name) {
            continue;
        }
        let circles = Graph::of(&Sources::read(&root.join(&package.folder).join("src"))?)?.circles();
        if !circles.is_empty() {
            println!("{}: {} files in circles", package.name, Graph::in_circles(&circles));
            circles.iter().for_each(|circle| println!("  {circle}"));
            exit = ExitCode::FAILURE;
        }
    }
    Ok(exit)
}
