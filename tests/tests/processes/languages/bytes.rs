//! Byte for byte: each field of each sample has the same place and value in Rust, C and Python, both ways.

use scanloop_tests::machine::repeat_when_late;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

use scanloop_tests::TestSystem;
use shared_types::{Field, Kind, TOPICS, Topic};

use super::tools::{EXECUTABLE, compile, examples, python};

/// One number of a sample.
struct Leaf {
    /// `header.chain[2].woken_ns`
    path: String,
    kind: &'static str,
    offset: usize,
}

impl Leaf {
    fn size(&self) -> usize {
        Kind::Scalar(self.kind).size()
    }

    /// A value unlike that of its neighbours, in Rust's bytes and as text; another one for another `seed`.
    fn value(&self, number: u64, seed: u64) -> (Vec<u8>, String) {
        let mix = number * 37 + seed;
        match self.kind {
            "u8" => {
                let value = (mix % 251) as u8;
                (value.to_ne_bytes().to_vec(), value.to_string())
            }
            "u16" => {
                let value = (mix * 11 % 65_521) as u16;
                (value.to_ne_bytes().to_vec(), value.to_string())
            }
            "u32" => {
                let value = (mix * 100_003 % 4_294_967_291) as u32;
                (value.to_ne_bytes().to_vec(), value.to_string())
            }
            "i32" => {
                let value = -((mix * 10_007 % 2_147_483_647) as i32);
                (value.to_ne_bytes().to_vec(), value.to_string())
            }
            "u64" => {
                let value = mix * 1_000_000_007_003;
                (value.to_ne_bytes().to_vec(), value.to_string())
            }
            _ => {
                let value = 0.25 - mix as f64 / 8.0;
                (value.to_ne_bytes().to_vec(), value.to_string())
            }
        }
    }
}

fn leaves(topic: Topic) -> Vec<Leaf> {
    fn add(path: &str, start: usize, fields: &'static [Field], found: &mut Vec<Leaf>) {
        for Field { name, offset, kind, .. } in fields {
            let (element, count) = match kind {
                Kind::Array(element, count) => (*element, Some(*count)),
                single => (single, None),
            };
            for index in 0..count.unwrap_or(1) {
                let place = count.map_or(String::new(), |_| format!("[{index}]"));
                let path = format!("{path}{name}{place}");
                let offset = start + offset + index * element.size();
                match element {
                    Kind::Scalar(kind) => found.push(Leaf { path, kind, offset }),
                    Kind::Struct(_, fields) => add(&format!("{path}."), offset, fields, found),
                    Kind::Array(..) => panic!("{path}"),
                }
            }
        }
    }
    let mut found = Vec::new();
    add("", 0, topic.fields(), &mut found);
    found
}

/// The bytes of a sample with a value in every field.
fn sample(topic: Topic, seed: u64) -> Vec<u8> {
    let mut bytes = vec![0xee; topic.size()];
    for (number, leaf) in leaves(topic).iter().enumerate() {
        let value = leaf.value(number as u64, seed).0;
        bytes[leaf.offset..leaf.offset + value.len()].copy_from_slice(&value);
    }
    bytes
}

/// What another language has to print of all samples: topic, path, offset, size, value.
fn listing(seed: u64) -> String {
    let mut text = String::new();
    for topic in TOPICS {
        for (number, leaf) in leaves(topic).iter().enumerate() {
            let value = leaf.value(number as u64, seed).1;
            let _ = writeln!(text, "{topic} {} {} {} {value}", leaf.path, leaf.offset, leaf.size());
        }
    }
    text
}

const MINE: u64 = 5;
const THEIRS: u64 = 90_001;

/// Writes the samples for another language, runs it, and compares what it read and what it wrote.
fn compare(folder: &Path, command: &mut Command) {
    for topic in TOPICS {
        std::fs::write(folder.join(format!("{topic}.in")), sample(topic, MINE)).unwrap();
    }
    let output = command.current_dir(folder).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let (printed, expected) = (String::from_utf8(output.stdout).unwrap(), listing(MINE));
    for (theirs, mine) in printed.lines().zip(expected.lines()) {
        assert_eq!(theirs, mine);
    }
    assert_eq!(printed.lines().count(), expected.lines().count());
    for topic in TOPICS {
        let written = std::fs::read(folder.join(format!("{topic}.out"))).unwrap();
        assert!(written == sample(topic, THEIRS), "{topic}");
    }
}

/// The struct of a topic in C: `scanloop_clock_offset` for `scanloop.ClockOffset.v1`.
fn struct_of(topic: Topic) -> String {
    let name = topic.type_name().split('.').nth(1).unwrap_or_default();
    let letters = name.chars().flat_map(|letter| {
        let gap = letter.is_ascii_uppercase().then_some('_');
        gap.into_iter().chain([letter.to_ascii_lowercase()])
    });
    format!("scanloop{}", letters.collect::<String>())
}

#[test]
fn every_sample_is_the_same_bytes_in_c() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let mut program = String::from(
            "#include <inttypes.h>\n#include <stdio.h>\n#include <string.h>\n#include \"scanloop_types.h\"\n\
         #define FIELD(topic, path, place, format, value) do { \\\n\
         printf(topic \" \" path \" %zu %zu \" format \"\\n\", (size_t)((char *)&(place) - (char *)&s), \\\n\
         sizeof(place), place); place = value; } while (0)\n",
        );
        for topic in TOPICS {
            let (name, of) = (topic.name(), struct_of(topic));
            let _ = writeln!(
                program,
                "static int of_{name}(void) {{\nstatic {of} s;\nFILE *file = fopen(\"{name}.in\", \"rb\");\n\
             if (!file || fread(&s, sizeof s, 1, file) != 1 || fgetc(file) != EOF) return 1;\nfclose(file);"
            );
            for (number, leaf) in leaves(topic).iter().enumerate() {
                let (format, cast) = match leaf.kind {
                    "f64" => ("\"%.17g\"".to_owned(), "double".to_owned()),
                    "i32" => ("\"%\" PRId32".to_owned(), "int32_t".to_owned()),
                    kind => (format!("\"%\" PRIu{}", &kind[1..]), format!("uint{}_t", &kind[1..])),
                };
                let (path, value) = (&leaf.path, leaf.value(number as u64, THEIRS).1);
                let suffix = if leaf.kind == "u64" { "u" } else { "" };
                let _ = writeln!(
                    program,
                    "FIELD(\"{name}\", \"{path}\", s.{path}, {format}, ({cast}){value}{suffix});"
                );
            }
            let _ = writeln!(
                program,
                "file = fopen(\"{name}.out\", \"wb\");\nif (!file || fwrite(&s, sizeof s, 1, file) != 1) return 1;\n\
             return fclose(file);\n}}"
            );
        }
        let calls: Vec<String> = TOPICS.iter().map(|topic| format!("of_{topic}()")).collect();
        let _ = writeln!(program, "int main(void) {{ return {}; }}", calls.join(" || "));
        let (source, binary) = (system.folder().join("samples.c"), system.folder().join("samples"));
        std::fs::write(&source, program).unwrap();
        compile(&source, &examples("c"), &binary);
        compare(system.folder(), &mut Command::new(binary));
    });
}

const SCRIPT: &str = r#"
import ctypes, sys
import scanloop_types as types

samples = {}
for line in open("values.txt"):
    topic, path, value = line.split()
    if topic not in samples:
        samples[topic] = types.TOPICS[topic].from_buffer_copy(open(topic + ".in", "rb").read())
    place, offset = samples[topic], 0
    steps = path.replace("[", ".[").split(".")
    for step in steps:
        outer = place
        if step[0] == "[":
            key = int(step[1:-1])
            offset, place = offset + key * ctypes.sizeof(outer._type_), outer[key]
            kind = outer._type_
        else:
            offset, place = offset + getattr(type(outer), step).offset, getattr(outer, step)
            kind = dict(type(outer)._fields_)[step]
    real = kind is ctypes.c_double
    print(topic, path, offset, ctypes.sizeof(kind), "%.17g" % place if real else place)
    value = float(value) if real else int(value)
    if steps[-1][0] == "[":
        outer[key] = value
    else:
        setattr(outer, steps[-1], value)
for topic, sample in samples.items():
    open(topic + ".out", "wb").write(bytes(sample))
"#;

#[test]
fn every_sample_is_the_same_bytes_in_python() {
    repeat_when_late(|| {
        let Some(python) = python("every_sample_is_the_same_bytes_in_python") else { return };
        let system = TestSystem::new(EXECUTABLE);
        let mut values = String::new();
        for topic in TOPICS {
            for (number, leaf) in leaves(topic).iter().enumerate() {
                let _ = writeln!(values, "{topic} {} {}", leaf.path, leaf.value(number as u64, THEIRS).1);
            }
        }
        std::fs::write(system.folder().join("values.txt"), values).unwrap();
        compare(
            system.folder(),
            Command::new(python).args(["-B", "-c", SCRIPT]).env("PYTHONPATH", examples("python")),
        );
    });
}
