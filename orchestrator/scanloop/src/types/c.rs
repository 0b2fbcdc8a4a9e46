//! The samples as a C header: structs, enumerations, constants, and the table of layouts as the compiler sees it.

use std::fmt::Write as _;

use shared_types::{CONSTANTS, ENUMERATIONS, Field, Kind, OwnType, TOPICS};

use super::{element, snake, struct_name, structs};

const HEAD: &str = include_str!("head.h");

const TABLE: &str = include_str!("table.h");

const FOOT: &str = include_str!("foot.h");

/// The header.
pub(super) fn header() -> String {
    let mut text = HEAD.to_owned();
    text.push('\n');
    for constant in CONSTANTS {
        let _ =
            writeln!(text, "#define SCANLOOP_{} {} /* {} */", constant.name, constant.value, constant.doc);
    }
    text.push('\n');
    for topic in TOPICS {
        let name = topic.name();
        let _ = writeln!(text, "#define SCANLOOP_TOPIC_{} \"{name}\"", name.to_uppercase());
    }
    for enumeration in ENUMERATIONS {
        let name = snake(enumeration.name);
        let _ = writeln!(text, "\n/* {} */\nenum scanloop_{name} {{", enumeration.doc);
        for value in enumeration.values {
            let value_name = value.name.to_uppercase();
            let prefix = name.to_uppercase();
            let _ =
                writeln!(text, "    SCANLOOP_{prefix}_{value_name} = {}, /* {} */", value.number, value.doc);
        }
        text.push_str("};\n");
    }
    for (name, fields) in structs() {
        let size = Kind::Struct(name, fields).size();
        declare(&mut text, &type_name(name), "A part of samples", size, fields);
    }
    for topic in TOPICS {
        let about = format!("Topic {topic}, published {}", topic.published());
        declare(&mut text, &type_name(struct_name(topic)), &about, topic.size(), topic.fields());
    }
    text.push_str(TABLE);
    for topic in TOPICS {
        let (topic_name, type_name) = (topic.name(), type_name(struct_name(topic)));
        let _ =
            writeln!(text, "    SCANLOOP_SAMPLE(\"{topic_name}\", {type_name}, \"{}\"),", topic.type_name());
        rows(&mut text, &format!("\"{topic_name}\", {type_name}"), "", "", topic.fields());
    }
    text.push_str(FOOT);
    text
}

/// The struct of a layout file and its table of fields, for a program that includes the header above.
pub(super) fn of_layout(own: &OwnType, doc: &str) -> String {
    let (name, type_name) = (snake(own.name()), type_name(own.name()));
    let guard = format!("SCANLOOP_OWN_{}_H", name.to_uppercase());
    let mut text = format!(
        "/* Made by `scanloop types --c --layout FILE`: do not edit, make it again. */\n#ifndef {guard}\n#define \
         {guard}\n\n#include \"scanloop_types.h\"\n"
    );
    let doc = if doc.is_empty() { "A sample of a topic of your own" } else { doc.trim_end_matches('.') };
    declare(&mut text, &type_name, doc, own.size(), own.fields());
    let _ = writeln!(
        text,
        "\n/* Its fields as the compiler laid them out, the way `scanloop_open_topic` takes them. */"
    );
    let _ = writeln!(text, "static const scanloop_layout_row {type_name}_layout[] = {{");
    let _ = writeln!(text, "    SCANLOOP_SAMPLE(\"\", {type_name}, \"{}\"),", own.name());
    rows(&mut text, &format!("\"\", {type_name}"), "", "", own.fields());
    text.push_str("};\n\n#endif\n");
    text
}

fn declare(text: &mut String, name: &str, about: &str, size: usize, fields: &'static [Field]) {
    let _ = writeln!(text, "\n/* {about}. */\ntypedef struct {name} {{");
    for Field { name, doc, kind, .. } in fields {
        let (element, count) = element(kind);
        let length = count.map_or(String::new(), |count| format!("[{count}]"));
        let _ = writeln!(text, "    {} {name}{length}; /* {doc} */", c_type(element));
    }
    let _ = writeln!(text, "}} {name};\n_Static_assert(sizeof({name}) == {size}, \"{name}\");");
    for Field { name: field, offset, .. } in fields {
        let _ = writeln!(text, "_Static_assert(offsetof({name}, {field}) == {offset}, \"{name}.{field}\");");
    }
}

fn rows(text: &mut String, start: &str, name: &str, path: &str, fields: &'static [Field]) {
    for field in fields {
        let (element, count) = element(&field.kind);
        let (name, path) = (format!("{name}{}", field.name), format!("{path}{}", field.name));
        let many = if count.is_some() { "S" } else { "" };
        match element {
            Kind::Struct(kind, inner) => {
                let _ = writeln!(text, "    SCANLOOP_STRUCT{many}({start}, \"{name}\", \"{kind}\", {path}),");
                let first = if count.is_some() { "[0]" } else { "" };
                rows(text, start, &format!("{name}."), &format!("{path}{first}."), inner);
            }
            _ => {
                let _ = writeln!(text, "    SCANLOOP_VALUE{many}({start}, \"{name}\", {path}),");
            }
        }
    }
}

fn type_name(name: &str) -> String {
    format!("scanloop_{}", snake(name))
}

fn c_type(kind: &Kind) -> String {
    match kind {
        Kind::Scalar("f64") => "double".to_owned(),
        Kind::Scalar(name) if name.starts_with('u') => format!("uint{}_t", &name[1..]),
        Kind::Scalar(name) => format!("int{}_t", &name[1..]),
        Kind::Struct(name, _) => type_name(name),
        Kind::Array(..) => unreachable!("no sample has an array of arrays"),
    }
}
