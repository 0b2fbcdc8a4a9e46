//! From the text of a file to a struct, with errors that name the line or the key.

use std::fmt;

use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

use crate::{Invalid, did_you_mean};

/// The table in a TOML text.
///
/// # Errors
/// What the parser reports, with the line.
pub fn parse(text: &str) -> Result<Table, String> {
    text.parse::<Table>().map_err(|error| toml_fault(text, &error))
}

/// What the parser reports of a TOML text, with the line, and with what another program has written there.
pub fn toml_fault(text: &str, error: &toml::de::Error) -> String {
    let line = error.span().map_or(1, |span| 1 + text[..span.start].matches('\n').count());
    let foreign = text.lines().nth(line - 1).and_then(foreign).unwrap_or_default();
    format!("line {line}: {}{foreign}", error.message().replace('\n', ", "))
}

/// What is to be said of a line that TOML does not have: `“` instead of `"`, a decimal comma, a semicolon at its end.
fn foreign(line: &str) -> Option<String> {
    let code = line.split('#').next()?.trim();
    if let Some(letter) = ForeignLetter::of(code) {
        return Some(format!("; it has {letter}"));
    }
    if code.ends_with(';') {
        return Some("; it ends with a semicolon, remove that".to_owned());
    }
    let value = code.split_once('=')?.1.trim();
    let (whole, decimals) = value.split_once(',')?;
    let is_whole = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    (is_whole(whole.trim_start_matches(['-', '+'])) && is_whole(decimals))
        .then(|| format!("; it has a decimal comma, write {whole}.{decimals}"))
}

/// A letter that a program for texts writes instead of a plain one, or that can't be seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ForeignLetter {
    found: char,
    /// What stands for it in plain text; nothing for one that can't be seen.
    pub plain: Option<char>,
}

impl ForeignLetter {
    /// The first one in a text.
    pub fn of(text: &str) -> Option<Self> {
        text.chars().find_map(Self::new)
    }

    /// The text with plain letters instead.
    pub fn mended(text: &str) -> String {
        let plain = |letter| Self::new(letter).map_or(Some(letter), |foreign| foreign.plain);
        text.chars().filter_map(plain).collect()
    }

    fn new(found: char) -> Option<Self> {
        let plain = match found {
            '\u{201c}'..='\u{201f}' | '\u{ab}' | '\u{bb}' => Some('"'),
            '\u{2018}'..='\u{201b}' => Some('\''),
            '\u{2010}'..='\u{2015}' | '\u{2212}' => Some('-'),
            '\u{a0}' | '\u{2007}' | '\u{2009}' | '\u{202f}' => Some(' '),
            '\u{ad}' | '\u{200b}'..='\u{200f}' | '\u{2060}' | '\u{feff}' => None,
            _ => return None,
        };
        Some(Self { found, plain })
    }
}

impl fmt::Display for ForeignLetter {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let code = self.found as u32;
        match (self.found, self.plain) {
            ('\u{feff}', _) => {
                write!(formatter, "a byte order mark (U+{code:04X}) within the text, remove it")
            }
            (_, None) => write!(formatter, "a letter that can't be seen (U+{code:04X}), remove it"),
            (_, Some(' ')) => write!(formatter, "a space of another width (U+{code:04X}), write a plain one"),
            (found, Some(plain)) => write!(formatter, "{found} (U+{code:04X}), write {plain}"),
        }
    }
}

/// What the program itself has written by [`text_of`]. An error has no line, and no key.
///
/// # Errors
/// What the parser reports.
pub fn of_text<T: DeserializeOwned>(text: &str) -> Result<T, toml::de::Error> {
    T::deserialize(Value::Table(text.parse()?))
}

/// A value as a file that no user writes, with sorted keys.
///
/// # Errors
/// A value that is no table, and a key without a value.
pub fn text_of(value: &impl Serialize) -> Result<String, toml::ser::Error> {
    Table::try_from(value).map(|table| table.to_string())
}

/// A value as serde reads it, with the key in its error.
pub(crate) fn deserialize<T: DeserializeOwned>(path: &str, value: Value) -> Result<T, Invalid> {
    let shown = value.clone();
    serde_path_to_error::deserialize(value)
        .map_err(|error| refuse(path, &shown, &error.path().to_string(), error.inner().message()))
}

/// What serde reports of a value at `path`, or of what stands `below` it.
fn refuse(path: &str, value: &Value, below: &str, message: &str) -> Invalid {
    let below = below.trim_end_matches('.');
    let found = value_at(value, below).map_or_else(String::new, ToString::to_string);
    let separator = if path.is_empty() || below.is_empty() || below.starts_with('[') { "" } else { "." };
    let key = format!("{path}{separator}{below}");
    let allowed = allowed(&key, message);
    Invalid::new(&key, found, allowed)
}

/// The keys of a table of settings with their values, each with its whole path.
///
/// # Errors
/// [`Invalid`] for a value that is no table.
#[doc(hidden)]
pub fn entries(path: &str, value: Value) -> Result<impl Iterator<Item = (String, String, Value)>, Invalid> {
    let Value::Table(table) = value else {
        return Err(Invalid::new(path, &value, format!("a table [{path}]")));
    };
    let separator = if path.is_empty() { "" } else { "." };
    let at = format!("{path}{separator}");
    Ok(table.into_iter().map(move |(key, value)| (format!("{at}{key}"), key, value)))
}

/// The elements of a list.
pub(crate) fn elements(
    path: &str,
    value: Value,
    has_tables: bool,
) -> Result<impl Iterator<Item = Value>, Invalid> {
    match value {
        Value::Array(values) => Ok(values.into_iter()),
        value if has_tables => Err(Invalid::new(path, &value, format!("tables [[{path}]]"))),
        value => Err(Invalid::new(path, &value, "a sequence")),
    }
}

/// The error for a key that a table of settings does not have.
#[doc(hidden)]
pub fn unknown(path: &str, key: &str, value: &Value, names: &[&str]) -> Invalid {
    let quoted: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
    let expected = match quoted.as_slice() {
        [one] => one.clone(),
        [one, other] => format!("{one} or {other}"),
        several => format!("one of {}", several.join(", ")),
    };
    let meant = did_you_mean(key, names.iter().copied());
    Invalid::new(path, value, format!("the key is unknown.{meant} Expected {expected}"))
}

/// The value at a path like `weights.x` or `[2].role`.
fn value_at<'a>(value: &'a Value, path: &str) -> Option<&'a Value> {
    let mut parts =
        path.split(['.', '[']).map(|part| part.trim_end_matches(']')).filter(|part| !part.is_empty());
    parts.try_fold(value, |value, part| match value {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_other_programs_write_is_named_with_the_line() {
        for (text, place, end) in [
            ("a = 1\nb = \u{201c}c\u{201d}\n", "line 2: ", "; it has \u{201c} (U+201C), write \""),
            ("a\u{200b} = 1\n", "line 1: ", "; it has a letter that can't be seen (U+200B), remove it"),
            (
                "a = 1\n\u{feff}b = 1\n",
                "line 2: ",
                "; it has a byte order mark (U+FEFF) within the text, remove it",
            ),
            ("a =\u{a0}1\n", "line 1: ", "; it has a space of another width (U+00A0), write a plain one"),
            ("a = 1\nb = 20,5 # s\n", "line 2: ", "; it has a decimal comma, write 20.5"),
            ("a = -0,5\n", "line 1: ", "; it has a decimal comma, write -0.5"),
            ("a = 1;\nb = 2;\n", "line 1: ", "; it ends with a semicolon, remove that"),
        ] {
            let fault = parse(text).unwrap_err();
            assert!(fault.starts_with(place) && fault.ends_with(end), "{fault}");
        }
        let plain = parse("a = 1\nb\n").unwrap_err();
        assert!(plain.starts_with("line 2: ") && !plain.contains("it has"), "{plain}");
    }
}
