//! Scenario and system as a user wrote them, to name the source of a value that is refused.
//!
//! A value comes from one of the two files or from an option, and reaches the checks under other keys too: each stage has a
//! copy of `[vehicle]`, for example. If the refused value is a default, or stands in a file that comes with this program, what
//! makes it wrong is found by leaving out one given value after the other until the refusal is gone.

use std::path::PathBuf;

use console::exit::Failure;
use emulator::Scenario;
use supervision::realtime;
use toml::{Table, Value};
use vehicle::{Invalid, Key, Setting, did_you_mean};

use crate::overrides::{index_of, parse_override, set};
use crate::source::SourceFile;
use crate::{Choice, SYSTEM, System, calibration_file, is_of_scenario, map_file, path_file};

/// What an option of the command line gives.
#[derive(Debug, Clone)]
enum Given {
    Realtime,
    Calibration(PathBuf),
    Set { key: String, value: Value, text: String },
    Seed(u64),
}

impl Given {
    /// The option in messages.
    fn name(&self) -> String {
        match self {
            Self::Realtime => "--realtime".to_owned(),
            Self::Calibration(file) => file.display().to_string(),
            Self::Set { text, .. } => format!("--set {text}"),
            Self::Seed(seed) => format!("--seed {seed}"),
        }
    }

    /// The keys that it sets.
    fn keys(&self) -> Vec<&str> {
        match self {
            Self::Realtime => vec!["realtime"],
            Self::Calibration(_) => calibration_file::KEYS.to_vec(),
            Self::Set { key, .. } => vec![key],
            Self::Seed(_) => vec!["seed"],
        }
    }

    fn apply(&self, [scenario, system]: &mut [Table; 2]) -> anyhow::Result<()> {
        match self {
            Self::Realtime => realtime::add_profile(system),
            Self::Calibration(file) => calibration_file::apply(file, system)?,
            Self::Set { key, value, text } => {
                let first = key.split('.').next().unwrap_or_default();
                let table = if is_of_scenario(first) { scenario } else { system };
                let of_list =
                    |keys: Vec<Key>| keys.iter().any(|key| key.name == first && key.is_list_of_tables());
                if key.contains('.') && (of_list(Scenario::keys()) || of_list(System::keys())) {
                    table.entry(first.to_owned()).or_insert_with(|| Value::Array(Vec::new()));
                }
                let by_index = key.split('.').nth(1).is_some_and(|second| second.parse::<usize>().is_ok());
                if by_index && Scenario::keys().iter().any(|key| key.name == first && key.is_table_or_list())
                {
                    as_list(table, first);
                }
                set(table, key, value.clone())
                    .map_err(|reason| Failure::bad_input(format!("--set {text}: {reason}")))?;
            }
            Self::Seed(seed) => {
                let seed = i64::try_from(*seed).map_err(|_| {
                    Failure::bad_input(format!("--seed {seed} is not allowed: 0 to {}", i64::MAX))
                })?;
                scenario.insert("seed".to_owned(), Value::Integer(seed));
            }
        }
        Ok(())
    }
}

/// Both files and the options that change them.
#[derive(Debug, Clone)]
pub(crate) struct Written {
    scenario: SourceFile,
    system: SourceFile,
    given: Vec<Given>,
}

impl Written {
    /// The files with the options of a command.
    ///
    /// # Errors
    /// An option of another form, and a key that no file has; exit code 2.
    pub(crate) fn new(scenario: SourceFile, system: SourceFile, choice: &Choice) -> anyhow::Result<Self> {
        let mut given = Vec::new();
        given.extend(choice.realtime.then_some(Given::Realtime));
        given.extend(choice.calibration.clone().map(Given::Calibration));
        for text in &choice.overrides {
            let (key, value) =
                parse_override(text).map_err(|error| Failure::bad_input(format!("--set {error}")))?;
            require_known(&key, text)?;
            given.push(Given::Set { key, value, text: text.clone() });
        }
        given.extend(choice.seed.map(Given::Seed));
        let written = Self { scenario, system, given };
        written.require_own_tables()?;
        Ok(written)
    }

    /// Scenario and system with all options.
    ///
    /// # Errors
    /// An option that can't be applied, with the reason; exit code 2.
    pub(crate) fn tables(&self) -> anyhow::Result<[Table; 2]> {
        let mut tables = [self.scenario.table.clone(), self.system.table.clone()];
        self.given.iter().try_for_each(|given| given.apply(&mut tables))?;
        path_file::read(&mut tables[0], &self.scenario.name)?;
        map_file::read(&mut tables[1], &self.system.name)?;
        Ok(tables)
    }

    /// The folder that names in the system file start from, as the name of a file in it.
    pub(crate) fn system_file(&self) -> &str {
        &self.system.name
    }

    /// The message for a refused value, with what the user wrote and where; `check` finds the first refused value of others.
    pub(crate) fn refusal(&self, invalid: &Invalid, check: impl Fn([Table; 2]) -> Option<Invalid>) -> String {
        let refused = path_of(&invalid.key);
        let written = candidates(&refused).into_iter().find_map(|key| Some((self.option(&key)?.name(), key)));
        if let Some((place, key)) = written {
            return sentence(&place, &key, invalid);
        }
        let without = |changed: Self, path: &str| {
            changed.tables().map_or(Without::Refused, |tables| Without::of(check(tables), invalid, path))
        };
        let named = self.name_of(&refused);
        // What the command line has comes after the files, so it is what made them wrong.
        let last_first = self.given.iter().enumerate().rev();
        let options = last_first.map(|(index, given)| {
            let mut changed = self.clone();
            changed.given.remove(index);
            (without(changed, ""), given)
        });
        if let Some(given) = decisive(options) {
            return because(&given.name(), None, &named, invalid);
        }
        let in_file = candidates(&refused).into_iter().find_map(|key| Some((self.place_of(&key)?, key)));
        let refused_there = in_file.map(|(place, key)| (self.source(&key), sentence(&place, &key, invalid)));
        if let Some((_, message)) = refused_there.as_ref().filter(|(source, _)| !source.is_shipped) {
            return message.clone();
        }
        let values = self.paths().into_iter().map(|path| {
            let mut changed = self.clone();
            let source = if self.is_in_scenario(&path) { &mut changed.scenario } else { &mut changed.system };
            remove(&mut source.table, &path);
            (without(changed, &path), path)
        });
        if let Some(path) = decisive(values) {
            let source = self.source(&path);
            let place = source.place(&path).unwrap_or_else(|| source.name.clone());
            return because(&place, Some(&path), &named, invalid);
        }
        refused_there
            .map_or_else(|| sentence(&self.source(&named).name, &named, invalid), |(_, message)| message)
    }

    /// The name of a key as the files have it: where it is written, or where it can be.
    fn name_of(&self, key: &str) -> String {
        let written = candidates(key).into_iter().find(|key| self.place_of(key).is_some());
        let of_vehicle = || key.split_once(".vehicle.").map(|(_, rest)| format!("vehicle.{rest}"));
        written.or_else(|| of_the_scenario(key)).or_else(of_vehicle).unwrap_or_else(|| key.to_owned())
    }

    /// Where a file has a key, or the table of a list that lacks it.
    fn place_of(&self, key: &str) -> Option<String> {
        let source = self.source(key);
        let is_index = |part: &str| part.parse::<usize>().is_ok();
        let element = key.rsplit_once('.').map(|(element, _)| element);
        let element = element.filter(|element| element.rsplit('.').next().is_some_and(is_index));
        source.place(key).or_else(|| source.place(element?))
    }

    /// The last option that sets a key, the table around it, or a part of it.
    fn option(&self, key: &str) -> Option<&Given> {
        let below =
            |key: &str, table: &str| key.strip_prefix(table).is_some_and(|rest| rest.starts_with('.'));
        let is_it = |own: &str| own == key || below(key, own) || below(own, key);
        self.given.iter().rev().find(|given| given.keys().iter().any(|own| is_it(&self.resolved(own))))
    }

    /// A key with the index of each element that is named by a role.
    fn resolved(&self, key: &str) -> String {
        let mut value = Some(&self.source(key).table).map(|table| Value::Table(table.clone()));
        let mut parts = Vec::new();
        for part in key.split('.') {
            let name = match &value {
                Some(Value::Array(items)) => index_of(items, part).map(|index| index.to_string()),
                _ => None,
            };
            let name = name.unwrap_or_else(|| part.to_owned());
            value = value.as_ref().and_then(|value| at(value, &name)).cloned();
            parts.push(name);
        }
        parts.join(".")
    }

    /// Whether a key is one of the scenario; an unknown one is where it was written.
    fn is_in_scenario(&self, key: &str) -> bool {
        let first = first_of(key);
        is_of_scenario(first)
            || self.scenario.table.contains_key(first) && !self.system.table.contains_key(first)
    }

    fn source(&self, key: &str) -> &SourceFile {
        if self.is_in_scenario(key) { &self.scenario } else { &self.system }
    }

    /// All keys with a value in the files that a user wrote, but for the tables that no file has.
    fn paths(&self) -> Vec<String> {
        let mut found = Vec::new();
        for source in [&self.scenario, &self.system].into_iter().filter(|source| !source.is_shipped) {
            let table = source.text.parse::<Table>().unwrap_or_default();
            leaves(&Value::Table(table), "", &mut found);
        }
        found
    }

    /// Refuses a table of the one file in the other one.
    fn require_own_tables(&self) -> anyhow::Result<()> {
        let (scenario, system) = (Scenario::keys(), System::keys());
        for (source, own, other, kind) in [
            (&self.scenario, &scenario, &system, "a system file, which `--system` names"),
            (&self.system, &system, &scenario, "a scenario, which `run` names without an option"),
        ] {
            let has = |keys: &[Key], name: &str| keys.iter().any(|key| key.name == name);
            let foreign = source.table.keys().find(|name| !has(own, name) && has(other, name));
            if let Some(name) = foreign {
                let place = source.place(name).unwrap_or_else(|| source.name.clone());
                return Err(Failure::bad_input(format!(
                    "{place}: {name} is not allowed here: it is a key of {kind}"
                )));
            }
        }
        Ok(())
    }
}

/// Passes when the first part of the key of an override is a key of the scenario or the system.
/// Makes a table that may stand alone the only one of a list.
fn as_list(table: &mut Table, name: &str) {
    let one = table.entry(name.to_owned()).or_insert_with(|| Value::Table(Table::new()));
    if one.is_table() {
        *one = Value::Array(vec![std::mem::replace(one, Value::Boolean(false))]);
    }
}

fn require_known(key: &str, text: &str) -> anyhow::Result<()> {
    let first = key.split('.').next().unwrap_or_default();
    if first == SYSTEM {
        return Err(Failure::bad_input(format!("--set {text}: `--system FILE` chooses another system file")));
    }
    let names: Vec<&str> = Scenario::keys().iter().chain(&System::keys()).map(|key| key.name).collect();
    if names.contains(&first) {
        return Ok(());
    }
    let meant = did_you_mean(first, names);
    Err(Failure::bad_input(format!(
        "--set {text}: {first} is unknown.{meant} `scanloop reference` lists the keys of scenario and system"
    )))
}

/// What becomes of a refusal without one of the values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Without {
    /// All is allowed.
    Allowed,
    /// Another value is refused.
    Other,
    /// The same is refused.
    Refused,
}

impl Without {
    /// `other` is what is refused without the value at `path`. Another refusal of the table that lacks the value now says
    /// nothing: it may only come before the first one.
    fn of(other: Option<Invalid>, invalid: &Invalid, path: &str) -> Self {
        match other {
            None => Self::Allowed,
            Some(Invalid { key, .. }) if key != invalid.key && first_of(&path_of(&key)) != first_of(path) => {
                Self::Other
            }
            Some(_) => Self::Refused,
        }
    }
}

/// The first value without which all is allowed, or else the first one without which another value is refused: that one may
/// only be refused earlier.
fn decisive<T>(values: impl Iterator<Item = (Without, T)>) -> Option<T> {
    let mut second = None;
    for (without, value) in values {
        match without {
            Without::Allowed => return Some(value),
            Without::Other => _ = second.get_or_insert(value),
            Without::Refused => {}
        }
    }
    second
}

/// The first part of a path.
fn first_of(path: &str) -> &str {
    path.split('.').next().unwrap_or_default()
}

/// The message for a value that was written at `key`.
fn sentence(place: &str, key: &str, Invalid { value, allowed, .. }: &Invalid) -> String {
    format!("{place}: {} = {value} is not allowed: {allowed}", key_of(key))
}

/// The message for a value that makes the one at `key` wrong, which was written elsewhere or is a default.
fn because(place: &str, path: Option<&str>, key: &str, Invalid { value, allowed, .. }: &Invalid) -> String {
    let path = path.map_or_else(String::new, |path| format!(": {}", key_of(path)));
    format!("{place}{path} is not allowed with {} = {value}, for which is allowed: {allowed}", key_of(key))
}

/// `process[2].role` as `process.2.role`.
fn path_of(key: &str) -> String {
    key.replace('[', ".").replace(']', "")
}

/// `process.2.role` as `process[2].role`.
fn key_of(path: &str) -> String {
    let part = |part: &str| match part.parse::<usize>() {
        Ok(index) => format!("[{index}]"),
        Err(_) => format!(".{part}"),
    };
    path.split('.').map(part).collect::<String>().trim_start_matches('.').to_owned()
}

/// The key of the scenario that a stage has a copy of.
fn of_the_scenario(key: &str) -> Option<String> {
    const COPIES: [(&str, &str); 7] = [
        ("controller.goal", "goal"),
        ("controller.track", "track"),
        ("controller.course", "course"),
        ("obstacles.course", "course"),
        ("obstacles.wall_y_m", "track.y_m"),
        ("obstacles.walls", "track.walls"),
        ("obstacles.track_x_m", "track.x_m"),
    ];
    COPIES.iter().find_map(|(from, to)| key.strip_prefix(from).map(|rest| format!("{to}{rest}")))
}

/// The keys that may have given the value of a key, the nearest one first.
fn candidates(key: &str) -> Vec<String> {
    let mut found = vec![key.to_owned()];
    found.extend(of_the_scenario(key));
    if let Some((stage, rest)) = key.split_once(".vehicle.") {
        found.extend(crate::vehicle_table::old_keys_of(stage, rest));
        found.push(format!("vehicle.{rest}"));
    }
    if let Some(name) = found.last().and_then(|key| key.strip_prefix("vehicle.")).map(str::to_owned) {
        let tables: &[&str] = if name == "surroundings" { &["track", "course"] } else { &["robot"] };
        found.extend(tables.iter().map(|table| format!("{table}.{name}")));
    }
    found
}

fn at<'a>(value: &'a Value, part: &str) -> Option<&'a Value> {
    match value {
        Value::Array(items) => items.get(part.parse::<usize>().ok()?),
        value => value.get(part),
    }
}

/// Dotted paths of all values that are no tables.
fn leaves(value: &Value, path: &str, found: &mut Vec<String>) {
    let joined = |part: &str| if path.is_empty() { part.to_owned() } else { format!("{path}.{part}") };
    match value {
        Value::Table(table) => table.iter().for_each(|(key, value)| leaves(value, &joined(key), found)),
        Value::Array(items) if items.iter().any(Value::is_table) => {
            items
                .iter()
                .enumerate()
                .for_each(|(index, item)| leaves(item, &joined(&index.to_string()), found));
        }
        _ => found.push(path.to_owned()),
    }
}

/// Takes the value at a path away.
fn remove(table: &mut Table, path: &str) {
    let (first, rest) = path.split_once('.').map_or((path, None), |(first, rest)| (first, Some(rest)));
    let Some(rest) = rest else {
        table.remove(first);
        return;
    };
    match table.get_mut(first) {
        Some(Value::Table(inner)) => remove(inner, rest),
        Some(Value::Array(items)) => {
            let (index, rest) = rest.split_once('.').unwrap_or((rest, ""));
            let item = index.parse::<usize>().ok().and_then(|index| items.get_mut(index));
            if let Some(Value::Table(inner)) = item {
                remove(inner, rest);
            }
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests;
