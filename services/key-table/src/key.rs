//! The keys of a table as data, for documentation and for checks.

use serde::Serialize;
use serde::de::value::Error;
use serde::de::{DeserializeOwned, IntoDeserializer};
use toml::{Table, Value};

use crate::read::{deserialize, elements};
use crate::rule::number;
use crate::{Invalid, KeyRule};

/// One key of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Key {
    /// Its name in the file.
    pub name: &'static str,
    /// What it means, with the unit as `[m/s]`.
    pub doc: &'static str,
    /// Its default as TOML; empty where there is none.
    pub default: String,
    /// What is allowed, in words; empty where the type alone says it, or a rule for the table around it.
    pub allowed: String,
    /// Keys of the table that it names; none for a value.
    pub keys: Vec<Self>,
}

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
            keys.iter_mut().for_each(|key| key.allowed.clear());
        }
        Self { name, doc: doc.trim(), default: toml_text(default), allowed: allowed.join("; "), keys }
    }

    /// Whether it is a list of tables, `[[name]]`.
    pub fn is_list_of_tables(&self) -> bool {
        !self.keys.is_empty() && self.default == "[]"
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
    ($($type:ty),*) => {
        $(impl Setting for $type {
            fn from_value(path: &str, value: Value) -> Result<Self, Invalid> {
                deserialize(path, value)
            }
        })*
    };
}
plain_settings!(bool, f64, u32, u64, usize, String);

impl<const N: usize> Setting for [f64; N] where Self: DeserializeOwned {}

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

    fn keys() -> Vec<Key> {
        T::keys()
    }
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
