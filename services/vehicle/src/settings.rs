//! Tables of settings: each key in one place, with its type, its default and its allowed range.

use std::ops::RangeInclusive;

use crate::{Invalid, require};

/// A value of a setting that is a number, or consists of numbers.
pub trait Numeric {
    /// Passes when all of its numbers are finite and within `range`.
    ///
    /// # Errors
    /// [`Invalid`] with the key, the value and the range; NaN is never within.
    fn require_within(&self, key: &str, range: RangeInclusive<f64>) -> Result<(), Invalid>;
}

impl Numeric for f64 {
    fn require_within(&self, key: &str, range: RangeInclusive<f64>) -> Result<(), Invalid> {
        require(key, *self, range)
    }
}

impl Numeric for u32 {
    fn require_within(&self, key: &str, range: RangeInclusive<f64>) -> Result<(), Invalid> {
        require(key, f64::from(*self), range)
    }
}

impl<T: Numeric, const N: usize> Numeric for [T; N] {
    fn require_within(&self, key: &str, range: RangeInclusive<f64>) -> Result<(), Invalid> {
        self.iter().try_for_each(|value| value.require_within(key, range.clone()))
    }
}

impl<T: Numeric> Numeric for Option<T> {
    fn require_within(&self, key: &str, range: RangeInclusive<f64>) -> Result<(), Invalid> {
        self.iter().try_for_each(|value| value.require_within(key, range.clone()))
    }
}

/// Declares a table of settings that is read from TOML, where every key is optional: `key: type = default, range;`.
///
/// Numbers may have a range; `require_ranges` names the first key that is outside of its own. The crate that uses it
/// needs `serde` with `derive`.
#[macro_export]
macro_rules! settings {
    (
        $(#[$meta:meta])*
        pub struct $name:ident {
            $($(#[$doc:meta])* pub $key:ident: $type:ty = $default:expr $(, $range:expr)?;)*
        }
    ) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct $name { $($(#[$doc])* pub $key: $type,)* }

        impl Default for $name {
            fn default() -> Self {
                Self { $($key: $default,)* }
            }
        }

        impl $name {
            /// Passes when every number that has a range is within it.
            ///
            /// # Errors
            /// The first key that is not, with its value and its range.
            pub fn require_ranges(&self) -> Result<(), $crate::Invalid> {
                $($($crate::Numeric::require_within(&self.$key, stringify!($key), $range)?;)?)*
                Ok(())
            }
        }
    };
}

#[cfg(test)]
#[expect(unreachable_pub, reason = "the macro declares public tables")]
mod tests {
    settings! {
        /// Some settings.
        #[derive(Copy)]
        pub struct Example {
            /// A number with a range.
            pub range_m: f64 = 1.0, 0.0..=2.0;
            /// Two numbers that may be given.
            pub pair: Option<[f64; 2]> = None, -1.0..=1.0;
            /// A whole number.
            pub count: u32 = 3, 1.0..=5.0;
            /// No number.
            pub enabled: bool = true;
        }
    }

    #[test]
    fn the_first_key_out_of_its_range_is_named_with_it() {
        assert_eq!(Example::default().require_ranges(), Ok(()));
        let refused = |example: Example| example.require_ranges().unwrap_err().to_string();
        let nan = Example { range_m: f64::NAN, count: 0, ..Example::default() };
        assert_eq!(refused(nan), "range_m = NaN is not allowed: 0 to 2");
        let pair = Example { pair: Some([0.5, -1.5]), ..Example::default() };
        assert_eq!(refused(pair), "pair = -1.5 is not allowed: -1 to 1");
        assert_eq!(refused(Example { count: 6, ..Example::default() }), "count = 6 is not allowed: 1 to 5");
    }
}
