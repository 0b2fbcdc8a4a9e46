//! How wide the way is.

use key_table::{Invalid, Setting, Table, Value, require, set_range};
use serde::{Deserialize, Serialize};

use crate::track::Track;

/// Largest width [m].
const MAX_M: f64 = 100.0;

/// Width of a way: one for all of it, or one for each part of it, from a waypoint to the next [m].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Widths {
    /// Everywhere the same.
    All(f64),
    /// One for each part.
    Each(Vec<f64>),
}

impl Widths {
    /// Width of the part behind a waypoint, from 0 [m].
    pub fn of_part(&self, waypoint: usize) -> f64 {
        match self {
            Self::All(width_m) => *width_m,
            Self::Each(widths_m) => widths_m.get(waypoint).copied().unwrap_or(Track::MIN_WIDTH_M),
        }
    }

    /// Width of the widest part [m].
    pub fn largest_m(&self) -> f64 {
        match self {
            Self::All(width_m) => *width_m,
            Self::Each(widths_m) => widths_m.iter().copied().fold(Track::MIN_WIDTH_M, f64::max),
        }
    }

    /// Passes when there is one for each of so many parts.
    pub(super) fn require_parts(&self, parts: usize) -> Result<(), Invalid> {
        match self {
            Self::Each(widths_m) if widths_m.len() != parts => {
                let allowed = format!("one number, or {parts}: one for each way from a waypoint to the next");
                Err(Invalid::new("width_m", format!("{} numbers", widths_m.len()), allowed))
            }
            _ => Ok(()),
        }
    }
}

impl Default for Widths {
    fn default() -> Self {
        Self::All(3.0)
    }
}

impl Setting for Widths {
    fn from_value(path: &str, value: Value) -> Result<Self, Invalid> {
        if value.is_array() {
            return Vec::from_value(path, value).map(Self::Each);
        }
        f64::from_value(path, value).map(Self::All)
    }

    fn require_all(&self, name: &str) -> Result<(), Invalid> {
        let range = Track::MIN_WIDTH_M..=MAX_M;
        match self {
            Self::All(width_m) => require(name, *width_m, range),
            Self::Each(widths_m) => {
                let mut each = widths_m.iter().enumerate();
                each.try_for_each(|(part, width_m)| {
                    require(&format!("{name}[{part}]"), *width_m, range.clone())
                })
            }
        }
    }

    fn allowed() -> String {
        format!("{} to {MAX_M} each, less than twice the radius of each bend", Track::MIN_WIDTH_M)
    }

    fn schema() -> Table {
        let mut schema = Vec::<f64>::schema();
        set_range(&mut schema, Track::MIN_WIDTH_M, MAX_M);
        let types = ["number", "array"].map(Value::from);
        schema.insert("type".to_owned(), Value::Array(types.to_vec()));
        let mut number = f64::schema();
        set_range(&mut number, Track::MIN_WIDTH_M, MAX_M);
        number.remove("type");
        schema.extend(number);
        schema
    }
}
