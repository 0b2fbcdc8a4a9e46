//! `scanloop types`: the samples as a page of documentation, a C header or a Python module.

mod c;
mod markdown;
mod python;
mod rust;

use std::path::PathBuf;

use clap::Args;
use console::exit::Failure;
use plan::topics::read_layout;
use shared_types::{Field, Kind, TOPICS};

/// Arguments of `types`.
#[derive(Debug, Args)]
pub struct TypesArguments {
    /// Print Markdown tables, the default.
    #[arg(long, group = "form")]
    pub markdown: bool,
    /// Print a C header (C11) for programs that use the C library.
    #[arg(long, group = "form")]
    pub c: bool,
    /// Print a Python module of ctypes classes.
    #[arg(long, group = "form")]
    pub python: bool,
    /// Print a Rust struct; with `--layout` only.
    #[arg(long, group = "form", requires = "layout")]
    pub rust: bool,
    /// Print the type of a layout file instead, for a topic of your own.
    #[arg(long, value_name = "FILE")]
    pub layout: Option<PathBuf>,
}

/// The samples of all topics in the requested form, or the type of one layout file.
///
/// # Errors
/// A layout file that is not allowed; exit code 2.
pub(crate) fn print(arguments: &TypesArguments) -> anyhow::Result<String> {
    if let Some(path) = &arguments.layout {
        let refuse = |reason: String| Failure::bad_input(format!("{}: {reason}", path.display()));
        let layout = read_layout(path).map_err(refuse)?;
        let own = layout.own_type().map_err(|fault| refuse(fault.to_string()))?;
        return Ok(match arguments {
            TypesArguments { c: true, .. } => c::of_layout(&own, &layout.doc),
            TypesArguments { python: true, .. } => python::of_layout(&own, &layout.doc),
            TypesArguments { rust: true, .. } => rust::of_layout(&own, &layout.doc),
            _ => markdown::of_layout(&own, &layout.doc),
        });
    }
    Ok(match arguments {
        TypesArguments { c: true, .. } => c::header(),
        TypesArguments { python: true, .. } => python::module(),
        _ => markdown::page(),
    })
}

/// All structs inside of samples, each after the structs it contains.
fn structs() -> Vec<(&'static str, &'static [Field])> {
    fn add(kind: &'static Kind, found: &mut Vec<(&'static str, &'static [Field])>) {
        match kind {
            Kind::Scalar(_) => {}
            Kind::Array(element, _) => add(element, found),
            Kind::Struct(name, fields) => {
                fields.iter().for_each(|field| add(&field.kind, found));
                if found.iter().all(|(known, _)| known != name) {
                    found.push((name, fields));
                }
            }
        }
    }
    let mut found = Vec::new();
    for topic in TOPICS {
        topic.fields().iter().for_each(|field| add(&field.kind, &mut found));
    }
    found
}

/// The element type of a field and the length of its array; `None` for a field that is not an array.
fn element(kind: &'static Kind) -> (&'static Kind, Option<usize>) {
    match kind {
        Kind::Array(element, count) => (element, Some(*count)),
        single => (single, None),
    }
}

/// `StageStamps` as `stage_stamps`.
fn snake(name: &str) -> String {
    let mut text = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !text.is_empty() {
            text.push('_');
        }
        text.extend(letter.to_lowercase());
    }
    text
}

/// Name of the struct of a sample: `Pose` of `scanloop.Pose.v1`.
fn struct_name(topic: shared_types::Topic) -> &'static str {
    topic.type_name().split('.').nth(1).unwrap_or_default()
}
