//! The crates of a workspace and the arrows between them, from their manifests.

use std::path::{Path, PathBuf};

use anyhow::Context;
use toml::{Table, Value};

/// A crate of the workspace.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Package {
    /// Its name.
    pub name: String,
    /// Its folder below the root of the workspace, as `services/runtime`.
    pub folder: PathBuf,
    /// Crates that it needs to be built, tests aside.
    pub dependencies: Vec<String>,
}

/// All members of the workspace at `root`.
///
/// # Errors
/// A manifest that can't be read.
pub fn packages(root: &Path) -> anyhow::Result<Vec<Package>> {
    let manifest = table(root)?;
    let members = manifest.get("workspace").and_then(|workspace| workspace.get("members"));
    let members = members.and_then(Value::as_array).context("a workspace has members")?;
    let mut folders = Vec::new();
    for member in members.iter().filter_map(Value::as_str) {
        match member.strip_suffix("/*") {
            Some(folder) => folders.extend(below(root, folder)?),
            None => folders.push(member.into()),
        }
    }
    folders.sort();
    folders.dedup();
    folders.into_iter().map(|folder| package(root, folder)).collect()
}

/// Folders with a manifest in a folder.
fn below(root: &Path, folder: &str) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(root.join(folder)).with_context(|| folder.to_owned())?;
    let folders = entries.flatten().filter(|entry| entry.path().join("Cargo.toml").is_file());
    Ok(folders.map(|entry| Path::new(folder).join(entry.file_name())).collect())
}

fn package(root: &Path, folder: PathBuf) -> anyhow::Result<Package> {
    let manifest = table(&root.join(&folder))?;
    let name = manifest.get("package").and_then(|package| package.get("name")).and_then(Value::as_str);
    let name = name.with_context(|| format!("{}: no name", folder.display()))?.to_owned();
    let sections = ["dependencies", "build-dependencies"].into_iter();
    let tables = sections.filter_map(|section| manifest.get(section)?.as_table());
    Ok(Package { name, dependencies: tables.flat_map(Table::keys).cloned().collect(), folder })
}

fn table(folder: &Path) -> anyhow::Result<Table> {
    let path = folder.join("Cargo.toml");
    let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    text.parse().with_context(|| path.display().to_string())
}
