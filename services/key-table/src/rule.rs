//! What is allowed for a key: as a check of its value, and in words for the documentation.

use std::f64::consts::PI;
use std::ops::RangeInclusive;

use toml::Table;

use crate::keyword::{set_range, values};
use crate::{Invalid, require};

/// A value that is a number, or consists of numbers.
pub trait Numeric {
    /// What the documentation adds to a range: ` each` where the value has several numbers.
    const EACH: &'static str = "";

    /// All its numbers.
    fn numbers(&self) -> impl Iterator<Item = f64>;
}

macro_rules! numeric {
    ($($type:ty),*) => {
        $(impl Numeric for $type {
            fn numbers(&self) -> impl Iterator<Item = f64> {
                std::iter::once(*self as f64)
            }
        })*
    };
}
numeric!(f64, u32, u64, usize);

macro_rules! several {
    ($($type:ty, $each:expr, ($($generics:tt)*);)*) => {
        $(impl<$($generics)*> Numeric for $type {
            const EACH: &'static str = $each;

            fn numbers(&self) -> impl Iterator<Item = f64> {
                self.iter().flat_map(Numeric::numbers)
            }
        })*
    };
}
several! {
    [T; N], " each", (T: Numeric, const N: usize);
    Vec<T>, " each", (T: Numeric);
    Option<T>, T::EACH, (T: Numeric);
}

/// What is allowed for a key with values of type `T`.
pub trait KeyRule<T> {
    /// The rule in words, for the documentation.
    fn text(&self) -> String;

    /// Passes when the value is allowed.
    ///
    /// # Errors
    /// [`Invalid`] with the key, the value and what is allowed; NaN never is.
    fn require(&self, key: &str, value: &T) -> Result<(), Invalid>;

    /// Adds what JSON Schema can say of the rule.
    fn constrain(&self, _schema: &mut Table) {}
}

/// All numbers of the value are within the range.
impl<T: Numeric> KeyRule<T> for RangeInclusive<f64> {
    fn text(&self) -> String {
        format!("{} to {}{}", number(*self.start()), number(*self.end()), T::EACH)
    }

    fn require(&self, key: &str, value: &T) -> Result<(), Invalid> {
        value.numbers().try_for_each(|number| require(key, number, self.clone()))
    }

    fn constrain(&self, schema: &mut Table) {
        set_range(schema, *self.start(), *self.end());
    }
}

/// A range with a condition that is documented here, and checked where its other values are known.
impl<T, R: KeyRule<T>> KeyRule<T> for (R, &'static str) {
    fn text(&self) -> String {
        format!("{}, {}", self.0.text(), self.1)
    }

    fn require(&self, key: &str, value: &T) -> Result<(), Invalid> {
        self.0.require(key, value)
    }

    fn constrain(&self, schema: &mut Table) {
        self.0.constrain(schema);
    }
}

/// A rule of one key that is documented here and checked elsewhere, with what JSON Schema can say of it.
pub struct Documented {
    /// The rule in words.
    pub text: &'static str,
    /// Its keywords as TOML, `pattern = '^[a-z]+$'`, of the value or of all values of a list.
    pub schema: &'static str,
}

impl<T> KeyRule<T> for Documented {
    fn text(&self) -> String {
        self.text.to_owned()
    }

    fn require(&self, _: &str, _: &T) -> Result<(), Invalid> {
        Ok(())
    }

    fn constrain(&self, schema: &mut Table) {
        values(schema).extend(self.schema.parse::<Table>().unwrap_or_default());
    }
}

/// A rule that is documented here, and checked elsewhere. For a table it replaces the rules of the table's own keys.
impl<T> KeyRule<T> for &'static str {
    fn text(&self) -> String {
        (*self).to_owned()
    }

    fn require(&self, _: &str, _: &T) -> Result<(), Invalid> {
        Ok(())
    }
}

impl<T> KeyRule<T> for String {
    fn text(&self) -> String {
        self.clone()
    }

    fn require(&self, _: &str, _: &T) -> Result<(), Invalid> {
        Ok(())
    }
}

/// Two different numbers within the range in ascending order, and at least so far apart.
pub struct Ascending(pub RangeInclusive<f64>, pub f64);

/// Share of the distance of two numbers that rounding may take.
const ROUNDING: f64 = 1e-9;

impl KeyRule<[f64; 2]> for Ascending {
    fn text(&self) -> String {
        let Self(range, apart) = self;
        let order = match *apart > 0.0 {
            true => format!("the second at least {apart} above the first"),
            false => "the smaller one first".to_owned(),
        };
        format!("two numbers from {} to {}, {order}", range.start(), range.end())
    }

    fn require(&self, key: &str, value: &[f64; 2]) -> Result<(), Invalid> {
        let [low, high] = value;
        let is_apart = low < high && high - low >= self.1 * (1.0 - ROUNDING);
        if self.0.contains(low) && self.0.contains(high) && is_apart {
            return Ok(());
        }
        Err(Invalid::new(key, format!("[{low}, {high}]"), self.text()))
    }

    fn constrain(&self, schema: &mut Table) {
        set_range(schema, *self.0.start(), *self.0.end());
    }
}

/// A number as short as TOML allows; pi by its name.
pub(crate) fn number(value: f64) -> String {
    let size = value.abs();
    if size == PI {
        format!("{}pi", if value < 0.0 { "-" } else { "" })
    } else if size >= 1e5 || size > 0.0 && size < 1e-3 {
        format!("{value:e}")
    } else {
        value.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal<T>(rule: &impl KeyRule<T>, value: T) -> String {
        rule.require("key", &value).map_or_else(|error| error.to_string(), |()| String::new())
    }

    #[test]
    fn two_numbers_ascend_within_their_range() {
        let rule = Ascending(-1e3..=1e3, 0.0);
        assert_eq!(refusal(&rule, [-1.0, 1.0]), "");
        let text = "two numbers from -1000 to 1000, the smaller one first";
        for [low, high] in [[1.0, 1.0], [1.0, 0.0], [0.0, 1001.0], [f64::NAN, 1.0]] {
            assert_eq!(refusal(&rule, [low, high]), format!("key = [{low}, {high}] is not allowed: {text}"));
        }
    }

    #[test]
    fn two_numbers_are_as_far_apart_as_the_rule_says() {
        let rule = Ascending(-1e3..=1e3, 0.5);
        assert_eq!(refusal(&rule, [1.8, 2.3]), "");
        assert_eq!(
            refusal(&rule, [-0.01, 0.01]),
            "key = [-0.01, 0.01] is not allowed: two numbers from -1000 to 1000, the second at least 0.5 above the first"
        );
    }

    #[test]
    fn a_condition_is_only_documented() {
        let rule = (0.0..=1.0, "above `low`");
        assert_eq!(KeyRule::<Vec<f64>>::text(&rule), "0 to 1 each, above `low`");
        assert_eq!(refusal(&rule, vec![1.0, 2.0]), "key = 2 is not allowed: 0 to 1");
        assert_eq!(refusal(&"not below `low`", -1.0), "");
    }

    #[test]
    fn numbers_are_short() {
        let shown = [0.0, 0.05, 22.0, 1e-6, 4e-4, 1e6, 86_400.0, -PI].map(number);
        assert_eq!(shown, ["0", "0.05", "22", "1e-6", "4e-4", "1e6", "86400", "-pi"]);
    }
}
