//! The type of a layout file as a Rust struct.

use std::fmt::Write as _;

use shared_types::{Field, Kind, OwnType};

use super::element;

/// The struct, for a file that a program includes.
pub(super) fn of_layout(own: &OwnType, doc: &str) -> String {
    let doc = if doc.is_empty() { "A sample of a topic of your own." } else { doc };
    let mut text = format!(
        "// Made by `scanloop types --rust --layout FILE`: do not edit, make it again.\n\nshared_types::plain_state! \
         {{\n    /// {doc}\n    pub struct {} {{\n",
        own.name()
    );
    for Field { name, doc, kind, .. } in own.fields() {
        let (element, count) = element(kind);
        let element = match element {
            Kind::Struct(name, _) => format!("shared_types::{name}"),
            Kind::Scalar(name) => (*name).to_owned(),
            Kind::Array(..) => unreachable!("no sample has an array of arrays"),
        };
        let kind = count.map_or_else(|| element.clone(), |count| format!("[{element}; {count}]"));
        let doc = if doc.is_empty() { name } else { doc };
        let _ = writeln!(text, "        /// {doc}\n        pub {name}: {kind},");
    }
    text.push_str("    }\n}\n");
    text
}
