//! Names the profile of the build: Cargo's `PROFILE` says `release` for every profile that inherits from it.

use std::path::Path;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let folder = std::env::var("OUT_DIR").unwrap_or_default();
    println!("cargo::rustc-env=SCANLOOP_PROFILE={}", profile(Path::new(&folder)));
}

/// The component before the last `build` of a path like `target/dist/build/figures-1a2b/out`.
fn profile(folder: &Path) -> String {
    let parts: Vec<&str> = folder.iter().filter_map(|part| part.to_str()).collect();
    let build = parts.iter().rposition(|part| *part == "build");
    match build.and_then(|place| parts.get(place.checked_sub(1)?)).copied() {
        Some("debug") => "dev".to_owned(),
        Some(name) => name.to_owned(),
        None => "unknown".to_owned(),
    }
}
