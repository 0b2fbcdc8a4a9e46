//! The keys of scenario and system files: as pages of the documentation, and found by a part of their name.

use std::fmt::Write as _;

use emulator::Scenario;
use emulator::scenario::{Preset, Robot};
use estimator::NoiseProfile;
use toml::{Table, Value};
use vehicle::{Description, Key, Setting, schema_of, toml_text};

use crate::System;

/// The page `docs/scenario-file.md`.
pub fn scenario_page() -> String {
    page(include_str!("reference/scenario.md"), &scenario_keys())
}

/// The page `docs/system-file.md`.
pub fn system_page() -> String {
    page(include_str!("reference/system.md"), &system_keys())
}

/// JSON Schema of the scenario file, as a table.
pub fn scenario_schema() -> Table {
    schema("Scenario file of Scanloop", &scenario_keys())
}

/// JSON Schema of the system file, as a table.
pub fn system_schema() -> Table {
    schema("System file of Scanloop", &system_keys())
}

fn schema(title: &str, keys: &[Key]) -> Table {
    let mut schema = schema_of(keys);
    schema.insert("$schema".to_owned(), "http://json-schema.org/draft-07/schema#".into());
    schema.insert("title".to_owned(), title.into());
    schema
}

/// All keys whose name or meaning contains `text`, two lines each, named as `--set` takes them.
pub fn find(text: &str) -> String {
    let mut found = String::new();
    for keys in [scenario_keys(), system_keys()] {
        collect(&mut found, "", &keys, &text.to_lowercase());
    }
    found
}

/// A key that `--set` takes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SettableKey {
    /// Its name with the tables around it; `0` is the first table of a list.
    pub path: String,
    /// What it means.
    pub meaning: &'static str,
    names: Vec<String>,
    default: String,
}

impl SettableKey {
    /// The values of one that takes some names only, or true and false.
    pub fn values(&self) -> Vec<&str> {
        if ["true", "false"].contains(&self.default.as_str()) {
            return vec!["true", "false"];
        }
        self.names.iter().map(String::as_str).collect()
    }
}

/// All keys that `--set` takes, those of one table behind each other.
pub fn settable() -> Vec<SettableKey> {
    fn collect(around: &str, keys: Vec<Key>, found: &mut Vec<SettableKey>) {
        for key in keys {
            let path = format!("{around}{}", key.name);
            if key.keys.is_empty() {
                let names = key.names().into_iter().map(str::to_owned).collect();
                found.push(SettableKey { path, meaning: key.doc, names, default: key.default });
            } else {
                let around = around_of(&path, &key);
                collect(&around, key.keys, found);
            }
        }
    }
    let mut found = Vec::new();
    [scenario_keys(), system_keys()].into_iter().for_each(|keys| collect("", keys, &mut found));
    found
}

/// What stands before the keys of a table.
fn around_of(path: &str, table: &Key) -> String {
    format!("{path}{}", if table.is_list_of_tables() { ".0." } else { "." })
}

/// The names of all keys, without those of the tables around them.
pub fn names() -> Vec<&'static str> {
    fn collect(keys: &[Key], found: &mut Vec<&'static str>) {
        for key in keys {
            found.push(key.name);
            collect(&key.keys, found);
        }
    }
    let mut found = Vec::new();
    [Scenario::keys(), System::keys()].iter().for_each(|keys| collect(keys, &mut found));
    found
}

/// Keys of the scenario file; those of the robot with the defaults that its presets give them.
fn scenario_keys() -> Vec<Key> {
    let defaults = |preset| {
        let robot = Robot { preset, ..Robot::default() };
        Table::try_from(robot.resolved(&Description::default(), 0)).unwrap_or_default()
    };
    let presets = [defaults(Preset::Ideal), defaults(Preset::Summit)];
    with_defaults(Scenario::keys(), "robot", presets, "preset `summit`")
}

/// Keys of the system file; those of the estimator with the defaults that its profiles give them.
fn system_keys() -> Vec<Key> {
    let defaults = |profile| {
        let config = estimator::EstimatorConfig { profile, ..estimator::EstimatorConfig::default() };
        config.complete().ok().and_then(|config| Table::try_from(config).ok()).unwrap_or_default()
    };
    let profiles = [defaults(NoiseProfile::Scaled), defaults(NoiseProfile::Source)];
    let mut keys = System::keys();
    // The copies of `[vehicle]` that the stages have are no keys of the file.
    keys.iter_mut().for_each(|table| table.keys.retain(|key| key.name != "vehicle"));
    add_profile(&mut keys, &pipeline::profile::source());
    with_defaults(keys, "estimator", profiles, "profile `source`")
}

/// Adds the values of a profile to the defaults of the keys.
fn add_profile(keys: &mut [Key], profile: &Table) {
    for key in keys {
        match profile.get(key.name) {
            Some(Value::Table(inner)) => add_profile(&mut key.keys, inner),
            Some(value) => key.default = format!("{}; profile `source`: {}", key.default, toml_text(value)),
            None => {}
        }
    }
}

/// The keys with defaults for those keys of `table` that have none: of its first set, and of the set `other`.
fn with_defaults(mut keys: Vec<Key>, table: &str, sets: [Table; 2], other: &str) -> Vec<Key> {
    let of = |set: &Table, name: &str| set.get(name).map(toml_text).unwrap_or_default();
    let open = keys.iter_mut().filter(|key| key.name == table).flat_map(|key| &mut key.keys);
    for key in open.filter(|key| key.default.is_empty()) {
        let [first, second] = [0, 1].map(|index| of(&sets[index], key.name));
        key.default = if first == second { first } else { format!("{first}; {other}: {second}") };
    }
    keys
}

fn page(introduction: &str, keys: &[Key]) -> String {
    let mut text = introduction.to_owned();
    rows(&mut text, keys);
    sections(&mut text, "", keys);
    text
}

/// The values of a table, one row each.
fn rows(text: &mut String, keys: &[Key]) {
    text.push_str("| key | default | allowed | meaning |\n|---|---|---|---|\n");
    for Key { name, default, allowed, doc, .. } in keys.iter().filter(|key| key.keys.is_empty()) {
        let _ = writeln!(text, "| `{name}` | {default} | {allowed} | {doc} |");
    }
}

/// The tables in a table, with their own tables behind them.
fn sections(text: &mut String, around: &str, keys: &[Key]) {
    for key in keys.iter().filter(|key| !key.keys.is_empty()) {
        let path = format!("{around}{}", key.name);
        let heading = if key.is_list_of_tables() { format!("[[{path}]]") } else { format!("[{path}]") };
        let _ = writeln!(text, "\n## `{heading}`\n\n{}\n", key.doc);
        if !key.allowed.is_empty() {
            let _ = writeln!(text, "Allowed: {}.\n", key.allowed);
        }
        rows(text, &key.keys);
        sections(text, &format!("{path}."), &key.keys);
    }
}

fn collect(found: &mut String, around: &str, keys: &[Key], wanted: &str) {
    for key in keys {
        let path = format!("{around}{}", key.name);
        if !key.keys.is_empty() {
            collect(found, &around_of(&path, key), &key.keys, wanted);
        } else if path.contains(wanted) || key.doc.to_lowercase().contains(wanted) {
            let default = if key.default.is_empty() { "no default" } else { &key.default };
            let allowed =
                if key.allowed.is_empty() { String::new() } else { format!("   ({})", key.allowed) };
            let _ = writeln!(found, "{path} = {default}{allowed}\n    {}", key.doc);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_found_by_name_and_by_meaning_and_named_as_an_override_takes_them() {
        let factor = "robot.velocity_factor = 1.4   (0.1 to 10)\n    Velocity sent divided by the true velocity, kv.\n";
        assert_eq!(find("velocity_factor"), factor);
        assert!(find("True Velocity").contains(factor));
        assert!(find("radius_m").contains("obstacle.0.radius_m = no default   (0.005 to 50, must be given"));
        assert!(find("process.0.grace_ms").starts_with("process.0.grace_ms = 1000   (1 to 3.6e6)\n"));
        assert_eq!(find("no such key"), "");
    }

    #[test]
    fn defaults_that_depend_on_the_profile_of_the_estimator_are_both_shown() {
        let row = "| `odometry_lateral_rate` | 0.0; profile `source`: 0.053 | -1 to 1 |";
        assert!(system_page().contains(row), "{}", system_page());
        assert!(system_page().contains("| `odometry_longitudinal` | 0.01 | -0.5 to 0.5 |"));
    }

    #[test]
    fn defaults_that_depend_on_the_profile_of_the_controller_are_both_shown() {
        let page = system_page();
        for row in [
            "| `horizon_s` | 5.44; profile `source`: 2.72 |",
            "| `hessian` | \"gauss-newton\"; profile `source`: \"bfgs\" |",
            "| `cover` | \"tight\"; profile `source`: \"source\" |",
        ] {
            assert!(page.contains(row), "{row}");
        }
    }

    #[test]
    fn defaults_that_depend_on_the_preset_of_the_robot_are_both_shown() {
        let row = "| `velocity_lag_s` | 0.0; preset `summit`: 0.15 | 0 to 2 |";
        assert!(scenario_page().contains(row), "{}", scenario_page());
    }

    #[test]
    fn every_key_of_every_table_has_a_meaning_that_is_a_sentence() {
        fn check(around: &str, keys: &[Key]) {
            for key in keys {
                let sentence = key.doc.ends_with(['.', ']']) || key.doc.ends_with(").");
                assert!(sentence && !key.doc.contains('|'), "{around}{}: {}", key.name, key.doc);
                check(&format!("{}.", key.name), &key.keys);
            }
        }
        check("", &scenario_keys());
        check("", &system_keys());
    }
}
