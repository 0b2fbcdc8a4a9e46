//! Overrides of single keys in TOML tables, `--set KEY=VALUE`.

use console::exit::Failure;
use toml::{Table, Value};
use vehicle::did_you_mean;

/// Splits `KEY=VALUE`; the value is TOML, or a text where it is not.
///
/// # Errors
/// A message that shows the expected form, or the largest whole number of a file.
pub fn parse_override(text: &str) -> anyhow::Result<(String, Value)> {
    let (key, value) = text
        .split_once('=')
        .filter(|(key, _)| !key.trim().is_empty())
        .ok_or_else(|| Failure::bad_input(format!("{text}: expected KEY=VALUE, for example seed=7")))?;
    let parsed = format!("value = {value}").parse::<Table>().ok().and_then(|mut table| table.remove("value"));
    if parsed.is_none() && is_whole_number(value.trim()) {
        return Err(Failure::bad_input(format!(
            "{text} is not allowed: a whole number is at most {} and at least {}",
            i64::MAX,
            i64::MIN
        )));
    }
    Ok((key.trim().to_owned(), parsed.unwrap_or_else(|| Value::String(value.trim().to_owned()))))
}

/// Whether a text is a whole number, of any size.
fn is_whole_number(text: &str) -> bool {
    let digits = text.strip_prefix(['+', '-']).unwrap_or(text);
    digits.starts_with(|first: char| first.is_ascii_digit() && first != '0')
        && digits.chars().all(|digit| digit.is_ascii_digit() || digit == '_')
}

/// Puts `value` at the dotted `key`; elements of arrays are named by index, those with a `role` by role.
///
/// # Errors
/// A message that names the part of the key which leads nowhere.
pub fn set(table: &mut Table, key: &str, value: Value) -> anyhow::Result<()> {
    let (first, rest) = key.split_once('.').map_or((key, None), |(first, rest)| (first, Some(rest)));
    let Some(rest) = rest else {
        let value = same_kind(table.get(first), value);
        table.insert(first.to_owned(), value);
        return Ok(());
    };
    let inner = table.entry(first.to_owned()).or_insert_with(|| Value::Table(Table::new()));
    set_within(inner, first, rest, value).map_err(|reason| Failure::bad_input(format!("{key}: {reason}")))
}

/// [`set`] in the value of `name`.
fn set_within(outer: &mut Value, name: &str, key: &str, value: Value) -> Result<(), String> {
    let (first, rest) = key.split_once('.').map_or((key, None), |(first, rest)| (first, Some(rest)));
    let (place, value) = match outer {
        Value::Table(table) if rest.is_none() => {
            let value = same_kind(table.get(first), value);
            table.insert(first.to_owned(), value);
            return Ok(());
        }
        Value::Table(table) => {
            let is_list = rest.is_some_and(|rest| rest.split('.').next() == Some("0"));
            let one = || Value::Table(Table::new());
            let new = || if is_list { Value::Array(vec![one()]) } else { one() };
            (table.entry(first.to_owned()).or_insert_with(new), value)
        }
        Value::Array(items) => {
            let count = items.len();
            let index = index_of(items, first);
            let names = items.iter().flat_map(|item| NAMES.iter().filter_map(|key| item.get(key)?.as_str()));
            let meant = did_you_mean(first, names);
            let meant = if meant.is_empty() { meant } else { format!(".{meant}") };
            let item = index.and_then(|index| items.get_mut(index));
            (item.ok_or_else(|| format!("{name} has no element `{first}`, it has {count}{meant}"))?, value)
        }
        _ => return Err(format!("{name} is a value, not a table")),
    };
    match rest {
        Some(rest) => set_within(place, first, rest, value),
        None => {
            *place = same_kind(Some(place), value);
            Ok(())
        }
    }
}

/// The keys that name an element of an array.
const NAMES: [&str; 2] = ["role", "name"];

/// Index of the element of an array that is named by its index, role or name.
pub(crate) fn index_of(items: &[Value], which: &str) -> Option<usize> {
    items.iter().enumerate().position(|(index, item)| {
        let is_it = |key: &&str| item.get(key).and_then(Value::as_str) == Some(which);
        index.to_string() == which || NAMES.iter().any(is_it)
    })
}

/// A whole number in place of a number with a fraction is one of those.
fn same_kind(old: Option<&Value>, value: Value) -> Value {
    match (old, value) {
        (Some(Value::Float(_)), Value::Integer(number)) => Value::Float(number as f64),
        (_, value) => value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_toml_and_fall_back_to_text() {
        assert_eq!(parse_override("a.b=1.5").unwrap(), ("a.b".to_owned(), Value::Float(1.5)));
        assert_eq!(parse_override("a=identity").unwrap().1, Value::String("identity".to_owned()));
        assert_eq!(parse_override("a=[1, 2]").unwrap().1.as_array().unwrap().len(), 2);
        assert!(parse_override("novalue").is_err());
        let large = parse_override("seed=9223372036854775808").unwrap_err().to_string();
        let whole = "a whole number is at most 9223372036854775807 and at least -9223372036854775808";
        assert_eq!(large, format!("seed=9223372036854775808 is not allowed: {whole}"));
        // A version or an address is a text.
        assert_eq!(parse_override("a=1.2.3").unwrap().1, Value::String("1.2.3".to_owned()));
    }

    #[test]
    fn keys_reach_into_tables_and_arrays() {
        let mut table: Table =
            "[robot]\nx = 1.0\n[[process]]\nrole = \"controller\"\n[[process]]\nrole = \"robot\""
                .parse()
                .unwrap();
        set(&mut table, "robot.x", Value::Integer(2)).unwrap();
        set(&mut table, "process.robot.restart", Value::String("never".into())).unwrap();
        set(&mut table, "process.0.restart", Value::String("always".into())).unwrap();
        assert_eq!(table["robot"]["x"], Value::Float(2.0));
        assert_eq!(table["process"][1]["restart"].as_str(), Some("never"));
        assert_eq!(table["process"][0]["restart"].as_str(), Some("always"));
        assert!(set(&mut table, "process.pilot.x", Value::Integer(1)).is_err());
        let unknown = set(&mut table, "process.controler.x", Value::Integer(1)).unwrap_err().to_string();
        assert!(
            unknown.ends_with("process has no element `controler`, it has 2. Did you mean `controller`?"),
            "{unknown}"
        );
        assert!(set(&mut table, "robot.x.y", Value::Integer(1)).is_err());
    }
}
