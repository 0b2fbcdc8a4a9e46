//! Overrides of single keys in TOML tables, `--set KEY=VALUE`.

use console::exit::Failure;
use toml::{Table, Value};

/// Splits `KEY=VALUE`; the value is TOML, or a text where it is not.
///
/// # Errors
/// A message that shows the expected form.
pub fn parse_override(text: &str) -> anyhow::Result<(String, Value)> {
    let (key, value) = text
        .split_once('=')
        .filter(|(key, _)| !key.trim().is_empty())
        .ok_or_else(|| Failure::bad_input(format!("--set {text}: expected KEY=VALUE, for example seed=7")))?;
    let parsed = format!("value = {value}").parse::<Table>().ok().and_then(|mut table| table.remove("value"));
    Ok((key.trim().to_owned(), parsed.unwrap_or_else(|| Value::String(value.trim().to_owned()))))
}

/// Puts `value` at the dotted `key`; elements of arrays are named by index, those with a `role` by role.
///
/// # Errors
/// A message that names the part of the key which leads nowhere.
pub fn set(table: &mut Table, key: &str, value: Value) -> anyhow::Result<()> {
    let (first, rest) = key.split_once('.').map_or((key, None), |(first, rest)| (first, Some(rest)));
    let Some(rest) = rest else {
        let same_kind = match (table.get(first), value) {
            (Some(Value::Float(_)), Value::Integer(number)) => Value::Float(number as f64),
            (_, value) => value,
        };
        table.insert(first.to_owned(), same_kind);
        return Ok(());
    };
    match table.entry(first.to_owned()).or_insert_with(|| Value::Table(Table::new())) {
        Value::Table(inner) => set(inner, rest, value),
        Value::Array(items) => {
            let (which, rest) = rest
                .split_once('.')
                .ok_or_else(|| Failure::bad_input(format!("--set {key}: expected {first}.WHICH.KEY")))?;
            let count = items.len();
            let found = items.iter_mut().enumerate().find(|(index, item)| {
                let is_it = |key: &str| item.get(key).and_then(Value::as_str) == Some(which);
                index.to_string() == which || is_it("role") || is_it("name")
            });
            match found {
                Some((_, Value::Table(inner))) => set(inner, rest, value),
                _ => Err(Failure::bad_input(format!(
                    "--set {key}: {first} has no element `{which}` (it has {count})"
                ))),
            }
        }
        _ => Err(Failure::bad_input(format!("--set {key}: {first} is a value, not a table"))),
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
        assert!(set(&mut table, "robot.x.y", Value::Integer(1)).is_err());
    }
}
