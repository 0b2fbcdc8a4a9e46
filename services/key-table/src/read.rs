//! From the text of a file to a struct, with errors that name the line or the key.

use serde::de::DeserializeOwned;
use toml::{Table, Value};

use crate::{Invalid, did_you_mean};

/// The table in a TOML text.
///
/// # Errors
/// What the parser reports, with the line.
pub fn parse(text: &str) -> Result<Table, String> {
    text.parse::<Table>().map_err(|error| {
        let line = error.span().map_or(1, |span| 1 + text[..span.start].matches('\n').count());
        let foreign = text.lines().nth(line - 1).and_then(typographic).unwrap_or_default();
        format!("line {line}: {}{foreign}", error.message().replace('\n', ", "))
    })
}

/// What is to be said of a line that a program for letters has written: `“` instead of `"`.
fn typographic(line: &str) -> Option<String> {
    let instead = |letter: char| match letter {
        '\u{201c}'..='\u{201f}' | '\u{ab}' | '\u{bb}' => Some('"'),
        '\u{2018}'..='\u{201b}' => Some('\''),
        '\u{2010}'..='\u{2015}' | '\u{2212}' => Some('-'),
        '\u{a0}' | '\u{2007}' | '\u{202f}' => Some(' '),
        _ => None,
    };
    let code = line.split('#').next()?;
    let (found, plain) = code.chars().find_map(|letter| Some((letter, instead(letter)?)))?;
    Some(format!("; it has {found} (U+{:04X}), write {plain}", found as u32))
}

/// The struct in a table, with names and types of its keys checked, rules not yet.
///
/// # Errors
/// [`Invalid`] with the first key that does not exist or has a value of another type.
pub fn read<T: DeserializeOwned>(table: Table) -> Result<T, Invalid> {
    let shown = table.clone();
    serde_path_to_error::deserialize(Value::Table(table)).map_err(|error| {
        let key = error.path().to_string();
        let value = value_at(&shown, &key).map_or_else(String::new, ToString::to_string);
        Invalid::new(&key, value, allowed(&key, error.inner().message()))
    })
}

/// The value at a path like `controller.weights.x` or `process[2].role`.
fn value_at<'a>(table: &'a Table, path: &str) -> Option<&'a Value> {
    let mut parts = path.split(['.', '[']).map(|part| part.trim_end_matches(']'));
    let first = table.get(parts.next()?)?;
    parts.try_fold(first, |value, part| match value {
        Value::Array(items) => items.get(part.parse::<usize>().ok()?),
        value => value.get(part),
    })
}

/// What is allowed, in words, from what serde reports about a key.
fn allowed(key: &str, message: &str) -> String {
    let message = message.lines().next().unwrap_or_default();
    let expected = message.rsplit_once("expected ").map_or(message, |(_, expected)| expected);
    let [given, names] = split_names(message);
    let meant = did_you_mean(given.first().unwrap_or(&""), names);
    if message.starts_with("unknown field") {
        return format!("the key is unknown.{meant} Expected {expected}");
    }
    if message.starts_with("unknown variant") && !meant.is_empty() {
        return format!("{expected}.{meant}");
    }
    match expected {
        "f64" => "a number".to_owned(),
        "u32" if message.starts_with("invalid value") => format!("a whole number from 0 to {}", u32::MAX),
        "u32" | "u64" | "usize" => "a whole number from 0".to_owned(),
        "an array of length 2" => "an array of two numbers".to_owned(),
        table if table.starts_with("struct ") => format!("a table [{key}]"),
        other => other.to_owned(),
    }
}

/// The name that was given, and those that are allowed, in "unknown field `a`, expected one of `b`, `c`".
fn split_names(message: &str) -> [Vec<&str>; 2] {
    let mut quoted = message.split('`').skip(1).step_by(2);
    [quoted.next().into_iter().collect(), quoted.collect()]
}
