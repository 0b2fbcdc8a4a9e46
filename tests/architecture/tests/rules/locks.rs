//! Programs of other workspaces join the same bus: they use the same version of it.

use toml::Table;

use crate::{files, root};

/// The versions of a crate in a lock file.
fn versions(lock: &str, name: &str) -> Vec<String> {
    let lock: Table = lock.parse().unwrap();
    let packages = lock["package"].as_array().unwrap().iter();
    let of_name = packages.filter(|package| package["name"].as_str() == Some(name));
    of_name.map(|package| package["version"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn all_workspaces_use_one_version_of_the_bus() {
    let read = |path: &std::path::Path| std::fs::read_to_string(path).unwrap();
    let ours = versions(&read(&root().join("Cargo.lock")), "iceoryx2");
    assert_eq!(ours.len(), 1, "{ours:?}");
    assert_eq!(versions(&read(&root().join("services/link/Cargo.lock")), "iceoryx2"), ours);
    for path in files(&root(), "Cargo.lock") {
        let theirs = versions(&read(&path), "iceoryx2");
        assert!(theirs.is_empty() || theirs == ours, "{}: {theirs:?}, here {ours:?}", path.display());
    }
}
