//! What no compiler checks of the workspace: which file of a crate uses which, and which crate uses which.
//!
//! A crate is read with `syn` as text; it need not compile. Each path in code is resolved to the file that defines its
//! last name, through imports, globs and re-exports. Not seen are methods, whose types only a compiler knows, and names
//! that a macro makes. Code behind `#[cfg(test)]` does not count, nor what a module and its parent use of each other.

pub mod circles;
pub mod glossary;
pub mod markdown;
pub mod modules;
pub mod packages;
pub mod paths;
pub mod resolve;
pub mod rust_text;
