//! The crates of this workspace and their files use each other in one direction only.

use std::path::PathBuf;

use architecture::circles::{Circle, Graph};
use architecture::modules::Sources;
use architecture::packages::{Package, packages};

use crate::root;

/// Crates by layer, the lowest first. A crate uses crates of lower layers only.
const LAYERS: &[&[&str]] = &[
    &["shared-types", "figures", "device-clock"],
    &["key-table"],
    &["runtime", "vehicle", "urg", "faults"],
    &["driver"],
    &["emulator", "estimator", "obstacles", "ocp", "player", "console", "scanloop-link", "scanloop-ros2"],
    &["courses", "nmpc", "actuation", "supervision", "handover", "audit"],
    &["pipeline", "calibration", "c-library", "recording"],
    &["plan", "report", "replay", "fault-matrix"],
    &["agent", "import"],
    &["session", "conformance"],
    &["view"],
    &["scanloop", "hops"],
    &["scanloop-lab"],
    &["scanloop-tests", "dead-reckoning", "imu", "architecture"],
];

fn layer(name: &str) -> Option<usize> {
    LAYERS.iter().position(|layer| layer.contains(&name))
}

/// What is wrong with the arrows between these crates.
fn wrong_arrows(packages: &[Package]) -> Vec<String> {
    let mut found = Vec::new();
    for Package { name, dependencies, .. } in packages {
        let Some(from) = layer(name) else {
            found.push(format!("{name} is in no layer"));
            continue;
        };
        let is_up = |other: &&String| layer(other).is_some_and(|to| to >= from);
        found.extend(dependencies.iter().filter(is_up).map(|other| format!("{name} uses {other}")));
    }
    found
}

#[test]
fn arrows_between_crates_go_down() {
    let packages = packages(&root()).unwrap();
    assert!(packages.len() > 10, "{packages:?}");
    assert_eq!(wrong_arrows(&packages), [""; 0]);
    for name in LAYERS.iter().copied().flatten() {
        assert!(packages.iter().any(|package| package.name == *name), "there is no crate {name}");
    }
}

#[test]
fn an_arrow_up_or_to_the_side_is_found() {
    let package = |name: &str, dependencies: &[&str]| Package {
        name: name.to_owned(),
        folder: PathBuf::new(),
        dependencies: dependencies.iter().map(ToString::to_string).collect(),
    };
    let packages = [
        package("runtime", &["shared-types", "nmpc", "libc"]),
        package("nmpc", &["runtime", "actuation"]),
        package("new", &[]),
    ];
    let expected = ["runtime uses nmpc", "nmpc uses actuation", "new is in no layer"];
    assert_eq!(wrong_arrows(&packages), expected);
}

#[test]
fn files_of_a_crate_use_each_other_in_no_circle() {
    let mut found = Vec::new();
    for package in packages(&root()).unwrap() {
        let circles = Graph::of(&Sources::read(&root().join(&package.folder).join("src")).unwrap());
        let circles = circles.unwrap_or_else(|error| panic!("{}: {error:#}", package.name)).circles();
        found.extend(circles.iter().map(|circle: &Circle| format!("{}: {circle}\n", package.name)));
    }
    assert!(found.is_empty(), "\n{}", found.concat());
}
