//! Samples for readers of other programs: their schemas in the language of ROS 2 messages.
//!
//! The bytes of a sample are its encoding as CDR, behind four bytes that name the encoding: samples have no padding,
//! every number stands at a multiple of its size, and all arrays have a fixed length. So a recording holds each sample
//! byte for byte, and any reader of ROS 2 bags decodes it.

use std::fmt::Write;

use shared_types::{Field, Kind, Topic};

/// Language of the schemas.
pub(crate) const ROS2MSG: &str = "ros2msg";
/// What stands in front of every message: CDR, little endian.
pub(crate) const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];
/// Between two types of a schema.
pub(crate) const SEPARATOR: &str =
    "================================================================================";

/// Name of the type of a topic's samples for ROS 2.
pub fn type_name(topic: Topic) -> String {
    format!("scanloop_msgs/msg/{}", struct_name(topic))
}

/// Name of the struct of a topic's samples.
fn struct_name(topic: Topic) -> &'static str {
    // `scanloop.Pose.v2`
    topic.type_name().split('.').nth(1).unwrap_or(topic.name())
}

/// The schema of a topic's samples, with those of all structs in it.
pub fn schema(topic: Topic) -> String {
    schema_of(topic.fields())
}

/// The schema of samples with these fields.
pub(crate) fn schema_of(fields: &[Field]) -> String {
    let mut structs: Vec<(&'static str, &'static [Field])> = Vec::new();
    let mut text = definition(fields, &mut structs);
    let mut next = 0;
    while let Some((name, fields)) = structs.get(next).copied() {
        let inner = definition(fields, &mut structs);
        let _ = write!(text, "{SEPARATOR}\nMSG: scanloop_msgs/{name}\n{inner}");
        next += 1;
    }
    text
}

fn definition(fields: &[Field], structs: &mut Vec<(&'static str, &'static [Field])>) -> String {
    let mut text = String::new();
    for field in fields {
        let (element, length) = match &field.kind {
            Kind::Array(element, length) => (*element, format!("[{length}]")),
            single => (single, String::new()),
        };
        let kind = match element {
            Kind::Struct(name, fields) => {
                if !structs.iter().any(|(known, _)| known == name) {
                    structs.push((name, fields));
                }
                format!("scanloop_msgs/{name}")
            }
            Kind::Scalar(name) => scalar(name).to_owned(),
            Kind::Array(..) => unreachable!("no sample has an array of arrays"),
        };
        let _ = writeln!(text, "# {}\n{kind}{length} {}", field.doc, field.name);
    }
    text
}

/// The name of a type of numbers in ROS 2.
fn scalar(name: &str) -> &'static str {
    match name {
        "u8" => "uint8",
        "u16" => "uint16",
        "u32" => "uint32",
        "i32" => "int32",
        "u64" => "uint64",
        _ => "float64",
    }
}

#[cfg(test)]
mod tests {
    use shared_types::TOPICS;

    use super::*;

    #[test]
    fn a_schema_holds_the_fields_and_all_structs() {
        let text = schema(Topic::Scan);
        assert!(text.contains("uint32[2048] ranges_mm\n"), "{text}");
        assert!(text.contains("MSG: scanloop_msgs/Header\n"), "{text}");
        assert!(text.contains("scanloop_msgs/StageStamps[8] chain\n"), "{text}");
        assert_eq!(type_name(Topic::Pose), "scanloop_msgs/msg/Pose");
    }

    /// CDR aligns each number to its size; only then the bytes of a sample are its encoding.
    #[test]
    fn every_number_stands_where_cdr_expects_it() {
        fn check(fields: &[Field], start: usize, end: &mut usize) {
            for field in fields {
                let (element, length) = match &field.kind {
                    Kind::Array(element, length) => (*element, *length),
                    single => (single, 1),
                };
                for index in 0..length {
                    let at = start + field.offset + index * element.size();
                    match element {
                        Kind::Struct(_, inner) => check(inner, at, end),
                        number => {
                            assert_eq!(at, end.next_multiple_of(number.size()), "{}", field.name);
                            *end = at + number.size();
                        }
                    }
                }
            }
        }
        for topic in TOPICS {
            let mut end = 0;
            check(topic.fields(), 0, &mut end);
            assert_eq!(end, topic.size(), "{topic}");
        }
    }
}
