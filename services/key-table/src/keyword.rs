//! Keywords of JSON Schema for one value: its type and its range.

use toml::{Table, Value};

/// The schema of a type by its JSON name.
pub(crate) fn of_type(name: &str) -> Table {
    table([("type", name.into())])
}

/// The schema of a list.
pub(crate) fn array(items: Table) -> Table {
    table([("type", "array".into()), ("items", Value::Table(items))])
}

pub(crate) fn table<const N: usize>(entries: [(&str, Value); N]) -> Table {
    entries.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

/// Sets the range of a number, or of all numbers of a list.
pub fn set_range(schema: &mut Table, minimum: f64, maximum: f64) {
    let of_values = values(schema);
    for (name, limit) in [("minimum", minimum), ("maximum", maximum)] {
        // As JSON writes it shortest.
        let is_whole = limit.fract() == 0.0 && limit.abs() < 1e15;
        let limit = if is_whole { Value::Integer(limit as i64) } else { Value::Float(limit) };
        of_values.insert(name.to_owned(), limit);
    }
}

/// The schema of what a list has in the end, or of the value itself.
pub(crate) fn values(schema: &mut Table) -> &mut Table {
    if matches!(schema.get("items"), Some(Value::Table(_))) {
        let Some(Value::Table(items)) = schema.get_mut("items") else { unreachable!("it was there") };
        return values(items);
    }
    schema
}
