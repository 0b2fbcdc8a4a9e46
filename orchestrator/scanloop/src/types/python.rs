//! The samples as a Python module of ctypes classes, with the table of layouts as ctypes sees it.

use std::fmt::Write as _;

use shared_types::{CONSTANTS, ENUMERATIONS, Field, Kind, OwnType, Role, TOPICS, Topic};

use super::{element, struct_name, structs};

const HEAD: &str = include_str!("head.py");

const FOOT: &str = include_str!("foot.py");

/// The module.
pub(super) fn module() -> String {
    let mut text = HEAD.to_owned();
    for constant in CONSTANTS {
        let _ = writeln!(text, "{} = {}  # {}", constant.name, constant.value, constant.doc);
    }
    for enumeration in ENUMERATIONS {
        let _ = writeln!(
            text,
            "\n\nclass {}(enum.IntEnum):\n    \"\"\"{}\"\"\"\n",
            enumeration.name, enumeration.doc
        );
        for value in enumeration.values {
            let _ = writeln!(text, "    {} = {}  # {}", value.name.to_uppercase(), value.number, value.doc);
        }
    }
    for (name, fields) in structs() {
        let _ = write!(text, "\n\nclass {name}(ctypes.Structure):\n    \"\"\"A part of samples.\"\"\"\n\n");
        declare(&mut text, fields);
    }
    for topic in TOPICS {
        let _ = write!(
            text,
            "\n\nclass {}(ctypes.Structure):\n    \"\"\"Topic {topic}, published {}.\"\"\"\n\n    \
             TOPIC = \"{topic}\"\n    LAYOUT = {:#010x}\n",
            struct_name(topic),
            topic.published(),
            topic.layout()
        );
        declare(&mut text, topic.fields());
        let _ = writeln!(
            text,
            "\n    @staticmethod\n    def type_name() -> str:\n        return \"{}\"",
            topic.type_name()
        );
    }
    text.push_str("\n\n# The sample of each topic.\nTOPICS = {\n");
    for topic in TOPICS {
        let _ = writeln!(text, "    \"{topic}\": {},", struct_name(topic));
    }
    text.push_str("}\n");
    table(&mut text, "What each role reads.", "READS", Role::reads);
    table(&mut text, "What each role writes.", "WRITES", Role::writes);
    text.push_str(FOOT);
    text
}

/// The class of a layout file.
pub(super) fn of_layout(own: &OwnType, doc: &str) -> String {
    let doc = if doc.is_empty() { "A sample of a topic of your own." } else { doc };
    let mut text = format!(
        "\"\"\"Made by `scanloop types --python --layout FILE`: do not edit, make it again.\"\"\"\n\nimport \
         ctypes\n\nfrom scanloop_types import Header, StageStamps\n\n\nclass {}(ctypes.Structure):\n    \
         \"\"\"{doc}\"\"\"\n\n    LAYOUT = {:#010x}\n",
        own.name(),
        own.layout()
    );
    declare(&mut text, own.fields());
    let _ = writeln!(
        text,
        "\n    @staticmethod\n    def type_name() -> str:\n        return \"{}\"",
        own.type_name()
    );
    text
}

fn declare(text: &mut String, fields: &'static [Field]) {
    text.push_str("    _fields_ = [\n");
    for Field { name, doc, kind, .. } in fields {
        let (element, count) = element(kind);
        let length = count.map_or(String::new(), |count| format!(" * {count}"));
        let _ = writeln!(text, "        (\"{name}\", {}{length}),  # {doc}", python_type(element));
    }
    text.push_str("    ]\n");
}

fn table(text: &mut String, about: &str, name: &str, topics: fn(Role) -> &'static [Topic]) {
    let _ = writeln!(text, "# {about}\n{name} = {{");
    for role in Role::ALL {
        let list: Vec<&str> = topics(*role).iter().map(|topic| struct_name(*topic)).collect();
        let _ = writeln!(text, "    Role.{}: [{}],", role.name().to_uppercase(), list.join(", "));
    }
    text.push_str("}\n");
}

fn python_type(kind: &Kind) -> String {
    match kind {
        Kind::Scalar("f64") => "ctypes.c_double".to_owned(),
        Kind::Scalar(name) if name.starts_with('u') => format!("ctypes.c_uint{}", &name[1..]),
        Kind::Scalar(name) => format!("ctypes.c_int{}", &name[1..]),
        Kind::Struct(name, _) => (*name).to_owned(),
        Kind::Array(..) => unreachable!("no sample has an array of arrays"),
    }
}
