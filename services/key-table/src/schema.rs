//! JSON Schema of tables of keys, so that editors complete and check a file while it is written.
//!
//! It knows names, types, ranges and names of values. What holds between keys, and between a file and other files, only the
//! program checks. A schema is a TOML table, whose serialisation as JSON is the schema.

use toml::{Table, Value};

use crate::Key;
use crate::keyword::{array, table};

/// The schema of a table with these keys, all of which are optional unless they say otherwise.
pub fn schema_of(keys: &[Key]) -> Table {
    let properties = keys.iter().map(|key| (key.name.to_owned(), Value::Table(of_key(key)))).collect();
    let required: Vec<Value> =
        keys.iter().filter(|key| key.must_be_given()).map(|key| key.name.into()).collect();
    let mut schema = table([
        ("type", "object".into()),
        ("properties", Value::Table(properties)),
        ("additionalProperties", false.into()),
    ]);
    if !required.is_empty() {
        schema.insert("required".to_owned(), Value::Array(required));
    }
    schema
}

fn of_key(key: &Key) -> Table {
    let mut schema = match key.keys.as_slice() {
        [] => key.schema.clone(),
        keys if key.is_list_of_tables() => array(schema_of(keys)),
        keys if key.is_table_or_list() => {
            let mut list = array(schema_of(keys));
            list.insert("minItems".to_owned(), Value::Integer(1));
            table([("anyOf", Value::Array(vec![schema_of(keys).into(), list.into()]))])
        }
        keys => schema_of(keys),
    };
    let allowed = if key.allowed.is_empty() { String::new() } else { format!(" Allowed: {}.", key.allowed) };
    schema.insert("description".to_owned(), format!("{}{allowed}", key.doc).into());
    // Some defaults depend on other keys, and are no TOML.
    let default = format!("default = {}", key.default).parse::<Table>().ok();
    if let Some((name, value)) =
        default.and_then(|table| table.into_iter().next()).filter(|_| key.keys.is_empty())
    {
        schema.insert(name, value);
    }
    schema
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Documented, Setting, settings};

    settings! {
        /// Some settings.
        pub(super) struct Row {
            /// A name.
            name: String = String::new(), (Documented { text: "letters", schema: "pattern = '^[a-z]+$'" }, "must be given");
            /// Two numbers.
            pair: [f64; 2] = [0.0, 0.5], -1.0..=0.5;
        }
    }

    settings! {
        /// A file.
        pub(super) struct File {
            /// A number.
            count: u32 = 3;
            /// Rows.
            row: Vec<Row> = Vec::new();
        }
    }

    #[test]
    fn a_schema_has_names_types_ranges_defaults_and_required_keys() {
        let schema = schema_of(&File::keys());
        assert_eq!(schema["additionalProperties"].as_bool(), Some(false));
        let count = &schema["properties"]["count"];
        assert_eq!((count["type"].as_str(), count["default"].as_integer()), (Some("integer"), Some(3)));
        assert_eq!(
            (count["minimum"].as_integer(), count["maximum"].as_integer()),
            (Some(0), Some(4_294_967_295))
        );
        let row = &schema["properties"]["row"]["items"];
        assert_eq!(row["required"][0].as_str(), Some("name"));
        let [name, pair] = ["name", "pair"].map(|key| &row["properties"][key]);
        assert_eq!(name["pattern"].as_str(), Some("^[a-z]+$"));
        assert_eq!(name["description"].as_str(), Some("A name. Allowed: letters, must be given."));
        assert_eq!((pair["minItems"].as_integer(), pair["maxItems"].as_integer()), (Some(2), Some(2)));
        assert_eq!((&pair["items"]["minimum"], &pair["items"]["maximum"]), (&(-1).into(), &0.5.into()));
    }
}
