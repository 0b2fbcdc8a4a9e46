//! Processes in other languages: their samples are the same bytes, they drive, and one of another version is refused.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod advisor;
mod bytes;
mod emergency_stop;
mod goal;
mod new;
mod person;
mod refusals;
mod robots;
pub(crate) mod swaps;
mod tables;
pub(crate) mod tools;
mod tutorial;

use std::process::Command;

use tools::{EXECUTABLE, root};

#[test]
fn the_header_and_the_module_are_what_the_executable_prints() {
    for (options, file) in [
        (&[][..], "docs/topics.md"),
        (&["--markdown"], "docs/topics.md"),
        (&["--c"], "examples/c/scanloop_types.h"),
        (&["--python"], "examples/python/scanloop_types.py"),
    ] {
        let output = Command::new(EXECUTABLE).arg("types").args(options).output().unwrap();
        let (printed, file) = (String::from_utf8(output.stdout).unwrap(), root().join(file));
        let kept = std::fs::read_to_string(&file).unwrap();
        assert!(printed == kept, "run `scanloop types {} > {}`", options.concat(), file.display());
    }
    let both = Command::new(EXECUTABLE).args(["types", "--c", "--python"]).output().unwrap();
    assert_eq!(both.status.code(), Some(2), "one form at a time");
}
