//! Pages of the documentation that the executable prints, and keys found in the terminal.

use std::path::Path;
use std::process::Command;

use scanloop_tests::TestSystem;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const LABORATORY: &str = env!("CARGO_BIN_EXE_scanloop-under-test-lab");

#[test]
fn the_pages_are_what_the_executable_prints() {
    let system = TestSystem::new(EXECUTABLE);
    let pages = [
        ("scenario", "scenario-file.md"),
        ("system", "system-file.md"),
        ("commands", "commands.md"),
        ("faults", "faults.md"),
        ("conformance", "conformance-cases.md"),
    ];
    for (page, file) in pages {
        let output = system.run(&["reference", "--page", page]);
        assert_eq!(output.status.code(), Some(0), "{page}");
        let mut printed = String::from_utf8(output.stdout).unwrap();
        if page == "commands" {
            let output = Command::new(LABORATORY).arg("reference").output().unwrap();
            printed += &String::from_utf8(output.stdout).unwrap();
        }
        let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs").join(file);
        let kept = std::fs::read_to_string(kept).unwrap();
        let place =
            printed.lines().zip(kept.lines()).position(|(new, old)| new != old).map_or(0, |line| line + 1);
        assert!(printed == kept, "line {place}: run `scanloop reference --page {page}` as docs/{file} says");
    }
}

#[test]
fn a_key_is_found_by_a_part_of_its_name_and_an_override_takes_what_is_shown() {
    let system = TestSystem::new(EXECUTABLE);
    let output = system.run(&["reference", "backlash"]);
    let printed = String::from_utf8(output.stdout).unwrap();
    assert_eq!(printed.lines().next(), Some("robot.steering_backlash_rad = 0.0   (0 to 0.1)"));
    for key in
        ["robot.steering_backlash_rad=0.05", "obstacle.0.x_m=6.0", "vehicle.bounds.steering_max_rad=0.05"]
    {
        let (name, _) = key.split_once('=').unwrap();
        let found = String::from_utf8(system.run(&["reference", name]).stdout).unwrap();
        assert!(found.starts_with(&format!("{name} = ")), "{found}");
        assert_eq!(system.run(&["check", "--set", key]).status.code(), Some(0), "{key}");
    }
    let output = system.run(&["reference", "propeller"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("propeller"));
}
