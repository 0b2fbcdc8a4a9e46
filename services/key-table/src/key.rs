//! The keys of a table as data, for documentation and for checks.

use serde::Serialize;
use serde::de::value::Error;
use serde::de::{DeserializeOwned, IntoDeserializer};
use toml::{Table, Value};

use crate::keyword::{array, of_type, set_range, table};
use crate::read::{deserialize, elements};
use crate::rule::number;
use crate::{Invalid, KeyRule};

/// One key of a table.
#[derive(Debug, Clone, PartialEq)]
pub struct Key {
    /// Its name in the file.
    pub name: &'static str,
    /// What it means, with the unit as `[m/s]`.
    pub doc: &'static str,
    /// Its default as TOML; empty where there is none.
    pub default: String,
    /// What is allowed, in words; empty where the type alone says it, or a rule for the table around it.
    pub allowed: String,
    /// What is allowed of a value, in keywords of JSON Schema.
    pub schema: Table,
    /// Keys of the table that it names; none for a value.
    pub keys: Vec<Self>,
}

/// Keywords of JSON Schema that rules add.
const KEYWORDS_OF_RULES: [&str; 5] = ["minimum", "maximum", "pattern", "minLength", "minItems"];

impl Key {
    /// A key with the rules for its value.
    pub fn new<T: Setting + Serialize>(
        name: &'static str,
        doc: &'static str,
        default: &T,
        rules: &[&dyn KeyRule<T>],
    ) -> Self {
        let texts = std::iter::once(T::allowed()).chain(rules.iter().map(|rule| rule.text()));
        let allowed: Vec<String> = texts.filter(|text| !text.is_empty()).collect();
        let mut keys = T::keys();
        if !rules.is_empty() {
            for key in &mut keys {
                key.allowed.clear();
                KEYWORDS_OF_RULES.iter().for_each(|keyword| _ = key.schema.remove(*keyword));
            }
        }
        let mut schema = T::schema();
        rules.iter().for_each(|rule| rule.constrain(&mut schema));
        Self { name, doc: doc.trim(), default: toml_text(default), allowed: allowed.join("; "), schema, keys }
    }

    /// The names that it takes, if it takes names only.
    pub fn names(&self) -> Vec<&str> {
        quoted(&self.allowed)
    }

    pub(crate) fn must_be_given(&self) -> bool {
        self.allowed.ends_with("must be given")
    }

    /// Whether it is a list of tables, `[[name]]`.
    pub fn is_list_of_tables(&self) -> bool {
        !self.keys.is_empty() && self.default == "[]"
    }

    /// Whether it may be one table, `[name]`, as well as a list of them.
    pub fn is_table_or_list(&self) -> bool {
        !self.keys.is_empty() && self.default != "[]" && self.schema.contains_key("items")
    }
}

/// The type of a key: a value or a table.
pub trait Setting: DeserializeOwned {
    /// The value that a file has at the key `path`, with names and types checked, rules not yet. It is no generic function
    /// of a reader, so that a table is compiled once, in its own crate.
    ///
    /// # Errors
    /// [`Invalid`] with the first key that does not exist or has a value of another type.
    fn from_value(path: &str, value: Value) -> Result<Self, Invalid> {
        deserialize(path, value)
    }

    /// Passes when all values of a table are allowed.
    ///
    /// # Errors
    /// [`Invalid`] with the first key that is not, in the table `name`.
    fn require_all(&self, _name: &str) -> Result<(), Invalid> {
        Ok(())
    }

    /// What the type itself allows: the names of an enumeration.
    fn allowed() -> String {
        let unknown: Result<Self, Error> = Self::deserialize("?".into_deserializer());
        unknown.err().map_or_else(String::new, |error| names(&error.to_string()))
    }

    /// What the type itself allows, in keywords of JSON Schema: the names of an enumeration.
    fn schema() -> Table {
        let names: Vec<Value> = quoted(&Self::allowed()).into_iter().map(Value::from).collect();
        if names.is_empty() { Table::new() } else { table([("enum", Value::Array(names))]) }
    }

    /// Keys of a table.
    fn keys() -> Vec<Key> {
        Vec::new()
    }
}

/// The struct in a table, with names and types of its keys checked, rules not yet.
///
/// # Errors
/// [`Invalid`] with the first key that does not exist or has a value of another type.
pub fn read<T: Setting>(table: Table) -> Result<T, Invalid> {
    T::from_value("", Value::Table(table))
}

/// Passes when a key's rules are kept; a table without a rule has those of its own keys.
///
/// # Errors
/// [`Invalid`] with the key, the value and what is allowed.
pub fn require_key<T: Setting>(name: &str, value: &T, rules: &[&dyn KeyRule<T>]) -> Result<(), Invalid> {
    if rules.is_empty() {
        return value.require_all(name);
    }
    rules.iter().try_for_each(|rule| rule.require(name, value))
}

macro_rules! plain_settings {
    ($($type:ty, $name:literal $(, $range:expr)?;)*) => {
        $(impl Setting for $type {
            fn from_value(path: &str, value: Value) -> Result<Self, Invalid> {
                deserialize(path, value)
            }

            fn schema() -> Table {
                let schema = of_type($name);
                $(let schema = within($range, schema);)?
                schema
            }
        })*
    };
}
plain_settings! {
    bool, "boolean";
    f64, "number";
    u32, "integer", [0.0, u32::MAX as f64];
    u64, "integer", [0.0, i64::MAX as f64];
    usize, "integer", [0.0, i64::MAX as f64];
    String, "string";
}

impl<const N: usize> Setting for [f64; N]
where
    Self: DeserializeOwned,
{
    fn schema() -> Table {
        let mut schema = array(f64::schema());
        for keyword in ["minItems", "maxItems"] {
            schema.insert(keyword.to_owned(), Value::Integer(N as i64));
        }
        schema
    }
}

impl<T: Setting> Setting for Vec<T> {
    fn from_value(path: &str, value: Value) -> Result<Self, Invalid> {
        let values = elements(path, value, !T::keys().is_empty())?;
        values.enumerate().map(|(index, value)| T::from_value(&format!("{path}[{index}]"), value)).collect()
    }

    fn require_all(&self, name: &str) -> Result<(), Invalid> {
        self.iter().enumerate().try_for_each(|(index, value)| value.require_all(&format!("{name}[{index}]")))
    }

    fn allowed() -> String {
        T::allowed()
    }

    fn schema() -> Table {
        array(T::schema())
    }

    fn keys() -> Vec<Key> {
        T::keys()
    }
}

impl<T: Setting> Setting for Option<T> {
    fn from_value(path: &str, value: Value) -> Result<Self, Invalid> {
        T::from_value(path, value).map(Some)
    }

    fn require_all(&self, name: &str) -> Result<(), Invalid> {
        self.iter().try_for_each(|value| value.require_all(name))
    }

    fn allowed() -> String {
        T::allowed()
    }

    fn schema() -> Table {
        T::schema()
    }

    fn keys() -> Vec<Key> {
        T::keys()
    }
}

fn within([minimum, maximum]: [f64; 2], mut schema: Table) -> Table {
    set_range(&mut schema, minimum, maximum);
    schema
}

/// The names in `` `"a"`, `"b"` ``.
fn quoted(allowed: &str) -> Vec<&str> {
    allowed.split("`\"").skip(1).filter_map(|rest| Some(rest.split_once("\"`")?.0)).collect()
}

/// The names in "unknown variant `?`, expected one of `a`, `b`", as the file has them.
fn names(message: &str) -> String {
    let names = message.split('`').skip(3).step_by(2);
    names.map(|name| format!("`\"{name}\"`")).collect::<Vec<_>>().join(", ")
}

/// A value as short as TOML allows; empty for none and for an empty text.
pub fn toml_text(value: &impl Serialize) -> String {
    Value::try_from(value).map_or_else(|_| String::new(), |value| value_text(&value))
}

fn value_text(value: &Value) -> String {
    match value {
        Value::Float(value) if value.fract() == 0.0 && value.abs() < 1e5 => format!("{value:.1}"),
        Value::Float(value) => number(*value),
        Value::Array(values) => format!("[{}]", values.iter().map(value_text).collect::<Vec<_>>().join(", ")),
        Value::String(text) if text.is_empty() => String::new(),
        value => value.to_string(),
    }
}
