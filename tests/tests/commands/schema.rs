//! The JSON Schemas of scenario and system file: they are in docs/schema, and give the verdict of the program on each key.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::{Path, PathBuf};

use regex::Regex;
use scanloop_tests::{TestSystem, printed};
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Keywords that say nothing about what is allowed.
const NOTES: [&str; 4] = ["$schema", "title", "description", "default"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn schema(kind: &str) -> Value {
    let file = root().join("docs/schema").join(format!("{kind}.json"));
    serde_json::from_str(&std::fs::read_to_string(file).unwrap()).unwrap()
}

fn is_of_type(value: &Value, name: &str) -> bool {
    match name {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "integer" => value.as_f64().is_some_and(|value| value.fract() == 0.0),
        "number" => value.is_number(),
        other => panic!("type {other}"),
    }
}

/// Why a value is not allowed by a schema; a keyword that is not known here fails the test.
fn refusal(schema: &Value, value: &Value, place: &str) -> Option<String> {
    let number = |name: &str| schema[name].as_f64();
    let found = |why: String| Some(format!("{place}: {why}"));
    for (keyword, rule) in schema.as_object().unwrap() {
        let is_kept = match keyword.as_str() {
            "type" => match rule {
                Value::Array(types) => types.iter().any(|name| is_of_type(value, name.as_str().unwrap())),
                name => is_of_type(value, name.as_str().unwrap()),
            },
            "enum" => rule.as_array().unwrap().iter().any(|name| match (name.as_f64(), value.as_f64()) {
                (Some(one), Some(other)) => one == other,
                _ => name == value,
            }),
            "minimum" => value.as_f64().is_none_or(|value| value >= rule.as_f64().unwrap()),
            "maximum" => value.as_f64().is_none_or(|value| value <= rule.as_f64().unwrap()),
            "pattern" => {
                value.as_str().is_none_or(|text| Regex::new(rule.as_str().unwrap()).unwrap().is_match(text))
            }
            "minLength" => {
                value.as_str().is_none_or(|text| text.chars().count() as f64 >= number(keyword).unwrap())
            }
            "minItems" => value.as_array().is_none_or(|list| list.len() as f64 >= number(keyword).unwrap()),
            "maxItems" => value.as_array().is_none_or(|list| list.len() as f64 <= number(keyword).unwrap()),
            "required" => value.as_object().is_none_or(|table| {
                rule.as_array().unwrap().iter().all(|name| table.contains_key(name.as_str().unwrap()))
            }),
            "anyOf" => rule.as_array().unwrap().iter().any(|choice| refusal(choice, value, place).is_none()),
            // Checked below with the values.
            "properties" | "items" | "additionalProperties" => true,
            note if NOTES.contains(&note) => true,
            other => panic!("the schema has the keyword {other}"),
        };
        if !is_kept {
            return found(format!("{value} breaks {keyword} {rule}"));
        }
    }
    for (name, value) in value.as_object().into_iter().flatten() {
        match schema["properties"].get(name) {
            Some(inner) => {
                if let Some(why) = refusal(inner, value, &format!("{place}.{name}")) {
                    return Some(why);
                }
            }
            None if schema["additionalProperties"] == false => return found(format!("no key {name}")),
            None => {}
        }
    }
    let items = value.as_array().into_iter().flatten().filter(|_| schema.get("items").is_some());
    items.enumerate().find_map(|(index, item)| refusal(&schema["items"], item, &format!("{place}[{index}]")))
}

/// The verdict of the schema on a TOML text.
fn refusal_of(schema: &Value, text: &str) -> Option<String> {
    let table: toml::Table = text.parse().unwrap();
    refusal(schema, &serde_json::to_value(table).unwrap(), "")
}

#[test]
fn the_schemas_are_what_the_executable_prints() {
    let system = TestSystem::new(EXECUTABLE);
    for kind in ["scenario", "system"] {
        let output = system.run(&["reference", "--schema", kind]);
        assert_eq!(output.status.code(), Some(0), "{}", printed(&output));
        let kept = std::fs::read(root().join(format!("docs/schema/{kind}.json"))).unwrap();
        assert!(output.stdout == kept, "run `scanloop reference --schema {kind} > docs/schema/{kind}.json`");
    }
}

/// Files with a comment `#:schema`, and those that campaigns have written.
fn shipped() -> Vec<(PathBuf, String, String)> {
    let folders = [
        "services/emulator/scenarios",
        "docs/campaign",
        "examples/c",
        "examples/player",
        "examples/python",
        "examples/python/emergency-stop",
        "examples/python/speed-limit",
        "examples/ros2",
        "examples/rust/dead-reckoning",
        "examples/rust/imu",
        "examples/template-controller",
        "examples/template-robot",
        "examples/scanners",
        "examples/vehicles",
        "orchestrator/systems",
        "services/pipeline/profiles",
        "benches/fault-matrix/src",
    ];
    let entries = folders.iter().flat_map(|folder| std::fs::read_dir(root().join(folder)).unwrap().flatten());
    let files =
        entries.map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|end| end == "toml"));
    let shipped = files.filter_map(|path| {
        let text = std::fs::read_to_string(&path).unwrap();
        let named = text.lines().next().and_then(|line| line.strip_prefix("#:schema ")).map(str::to_owned);
        let named = match named {
            Some(named) => path.parent().unwrap().join(named),
            None if path.parent().unwrap().ends_with("campaign") => root().join("docs/schema/scenario.json"),
            None => return None,
        };
        let kind = named.canonicalize().unwrap().file_stem().unwrap().to_str().unwrap().to_owned();
        Some((path, text, kind))
    });
    shipped.collect()
}

#[test]
fn every_shipped_file_names_its_schema_and_is_valid_by_it_and_by_the_program() {
    let system = TestSystem::new(EXECUTABLE);
    let files = shipped();
    assert!(files.len() >= 30, "{}", files.len());
    for (path, text, kind) in files {
        let refused = refusal_of(&schema(&kind), &text);
        assert_eq!(refused, None, "{}", path.display());
        // What is added to a system file is no whole one, and one course is a part of the matrix of faults.
        let file = path.to_str().unwrap();
        let checked = match kind.as_str() {
            "scenario" => system.run(&["check", file]),
            _ => system.run(&["check", "--system", file]),
        };
        assert_eq!(checked.status.code(), Some(0), "{file}: {}", printed(&checked));
    }
}

/// A value that is right, and wrong ones for the same key, with the table before it.
const SCENARIO: &[(&str, &str, &str, &[&str])] = &[
    ("", "name", "\"a b\"", &["\"\"", "3", "\"a/b\"", "\"été\""]),
    ("", "seed", "7", &["-1", "1.5", "\"one\""]),
    ("", "timeout_s", "20.0", &["0.0", "true", "2e6"]),
    ("", "sed", "", &["1"]),
    ("[track]", "x_m", "[0.0, 30.0]", &["[0.0]", "[0.0, 30.0, 40.0]", "[-20000.0, 30.0]", "5.0"]),
    ("[track]", "walls", "true", &["1", "\"yes\""]),
    ("[track]", "surroundings", "\"open\"", &["\"sea\"", "2"]),
    ("[goal]", "tolerance_m", "0.2", &["7.0", "0.0"]),
    ("[goal]", "tolerence_m", "", &["0.2"]),
    ("[robot]", "preset", "\"worn\"", &["\"new\"", "1.0"]),
    ("[robot]", "velocity_factor", "1.3", &["20.0", "\"fast\""]),
    ("[robot]", "steering_backlash_rad", "0.01", &["0.2"]),
    ("[noise]", "dropout", "0.1", &["1.5", "-0.1"]),
    ("[noise]", "range", "", &["0.1"]),
];

/// The same of the system file.
const SYSTEM: &[(&str, &str, &str, &[&str])] = &[
    ("", "rate_hz", "20.0", &["0.1", "\"ten\"", "2000.0"]),
    ("", "rate", "", &["20.0"]),
    ("[vehicle]", "width_m", "0.45", &["0.0", "10.0"]),
    ("[vehicle.bounds]", "steering_max_rad", "0.05", &["0.9"]),
    ("[vehicle.bounds]", "steering_max", "", &["0.05"]),
    ("[player]", "port", "6666", &["0", "70000", "1.5"]),
    ("[player]", "velocity_sign", "-1.0", &["2.0"]),
    ("[player]", "delivery", "\"pull\"", &["\"wait\""]),
    ("[player]", "urg", "\"10.0.0.7:10940\"", &["\"ttyACM0\"", "\"\""]),
    ("[ros2]", "scan_sign", "-1.0", &["0.5"]),
    ("[ros2]", "namespace", "\"/robot1\"", &["\"robot1\"", "\"/1\""]),
    ("[ros2]", "remap", "[\"scan:=/front/scan\"]", &["[\"laser:=/scan\"]"]),
    ("", "orphan_stop_s", "1.0", &["0.1"]),
    ("[realtime]", "slice_us", "0", &["50"]),
    ("[realtime]", "scheduler", "\"fifo\"", &["\"idle\""]),
    ("[realtime]", "priority", "50", &["99"]),
    ("[recording]", "ring_s", "10.0", &["-1.0"]),
    ("[[process]]\nrole = \"controller\"", "grace_ms", "700", &["0", "\"long\""]),
    ("[[process]]\nrole = \"controller\"", "restart", "\"never\"", &["\"maybe\""]),
    ("[[process]]\nrole = \"controller\"", "grace", "", &["700"]),
    ("[[process]]", "role", "\"controller\"", &["\"pilot\"", "1"]),
    ("[controller]", "intervals", "8", &["0", "2.5"]),
    ("[estimator]", "profile", "\"scaled\"", &["\"good\""]),
    ("[actuator]", "calibration", "\"identity\"", &["\"none\"", "1.0"]),
];

#[test]
fn a_file_with_one_wrong_key_is_refused_by_the_schema_and_by_the_program() {
    let system = TestSystem::new(EXECUTABLE);
    let file = system.folder().join("file.toml");
    let (mut wrong_files, mut right_files) = (0, 0);
    for (kind, rows) in [("scenario", SCENARIO), ("system", SYSTEM)] {
        let schema = schema(kind);
        let verdicts = |table: &str, key: &str, value: &str| {
            let text = format!("{table}\n{key} = {value}\n");
            std::fs::write(&file, &text).unwrap();
            let checked = match kind {
                "scenario" => system.run(&["check", "file.toml"]),
                _ => system.run(&["check", "--system", "file.toml"]),
            };
            (refusal_of(&schema, &text), checked.status.code(), format!("{text}{}", printed(&checked)))
        };
        for (table, key, right, wrong) in rows {
            for value in *wrong {
                let (refused, code, shown) = verdicts(table, key, value);
                assert!(refused.is_some() && code == Some(2), "{refused:?}, {code:?}: {shown}");
                wrong_files += 1;
            }
            if !right.is_empty() {
                let (refused, code, shown) = verdicts(table, key, right);
                assert!(refused.is_none() && code == Some(0), "{refused:?}, {code:?}: {shown}");
                right_files += 1;
            }
        }
    }
    assert!(wrong_files >= 50 && right_files >= 25, "{wrong_files} wrong, {right_files} right");
}
