//! The samples as a page of documentation: one table per topic, and one per struct inside of samples.

use std::fmt::Write as _;

use shared_types::{Field, Kind, OwnType, TOPICS};

use super::structs;

/// The page.
pub(super) fn page() -> String {
    let mut text = String::from("# Topics and their samples\n");
    for topic in TOPICS {
        let _ = writeln!(
            text,
            "\n## {topic}\n\n`{}`, {} bytes, published {}.",
            topic.type_name(),
            topic.size(),
            topic.published()
        );
        field_table(&mut text, topic.fields());
    }
    for (name, fields) in structs() {
        let _ = writeln!(text, "\n## struct {name}");
        field_table(&mut text, fields);
    }
    text
}

/// The type of a layout file.
pub(super) fn of_layout(own: &OwnType, doc: &str) -> String {
    let mut text = format!("# {}\n\n{doc}\n\n`{}`, {} bytes.\n", own.name(), own.type_name(), own.size());
    field_table(&mut text, own.fields());
    text
}

fn field_table(text: &mut String, fields: &[Field]) {
    let _ = writeln!(text, "\n| offset | field | type | meaning [unit] |\n|---:|---|---|---|");
    for Field { name, doc, offset, kind } in fields {
        let _ = writeln!(text, "| {offset} | `{name}` | {} | {doc} |", kind_name(kind));
    }
}

fn kind_name(kind: &Kind) -> String {
    match kind {
        Kind::Scalar(name) => format!("`{name}`"),
        Kind::Array(element, length) => format!("{} x {length}", kind_name(element)),
        Kind::Struct(name, _) => format!("[{name}](#struct-{})", name.to_lowercase()),
    }
}
