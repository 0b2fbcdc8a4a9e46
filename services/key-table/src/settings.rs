//! The macro that declares a table of keys.

/// Declares a table of settings that is read from TOML, where every key is optional:
/// `key: type = default;` or `key: type = default, rule;`.
///
/// A rule says what is allowed for a value: `0.0..=1.0`, or another [`KeyRule`](crate::KeyRule). `require_ranges` names
/// the first key whose rule is broken, also in the tables below. The doc comment of a key is its documentation for
/// users, with the unit as `[m]` and without default and rule. The crate that uses the macro needs `serde` with
/// `derive`.
#[macro_export]
macro_rules! settings {
    (
        $(#[$meta:meta])*
        $vis:vis struct $name:ident {
            $(
                $(#[doc = $doc:literal])*
                $(#[serde(rename = $rename:literal)])?
                $key_vis:vis $key:ident: $type:ty = $default:expr $(, $rule:expr)?;
            )*
        }
    ) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, serde::Serialize)]
        $vis struct $name {
            $($(#[doc = $doc])* $(#[serde(rename = $rename)])? $key_vis $key: $type,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($key: $default,)* }
            }
        }

        impl $name {
            /// Passes when the rules of all keys are kept, also in the tables below.
            ///
            /// # Errors
            /// The first key that breaks its rule, with its value and what is allowed.
            $vis fn require_ranges(&self) -> Result<(), $crate::Invalid> {
                $($crate::require_key::<$type>(
                    [$($rename,)? stringify!($key)][0],
                    &self.$key,
                    &[$(&$rule as &dyn $crate::KeyRule<$type>)?],
                )?;)*
                Ok(())
            }
        }

        impl<'de> serde::Deserialize<'de> for $name {
            fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let value = <$crate::Value as serde::Deserialize>::deserialize(deserializer)?;
                <Self as $crate::Setting>::from_value("", value).map_err(serde::de::Error::custom)
            }
        }

        impl $crate::Setting for $name {
            fn from_value(path: &str, value: $crate::Value) -> Result<Self, $crate::Invalid> {
                const NAMES: &[&str] = &[$([$($rename,)? stringify!($key)][0]),*];
                let mut settings = Self::default();
                for (path, key, value) in $crate::entries(path, value)? {
                    match key.as_str() {
                        $(name if name == [$($rename,)? stringify!($key)][0] => {
                            settings.$key = <$type as $crate::Setting>::from_value(&path, value)?;
                        })*
                        _ => return Err($crate::unknown(&path, &key, &value, NAMES)),
                    }
                }
                Ok(settings)
            }

            fn require_all(&self, name: &str) -> Result<(), $crate::Invalid> {
                self.require_ranges().map_err(|error| error.within(name))
            }

            fn keys() -> Vec<$crate::Key> {
                let default = Self::default();
                vec![$($crate::Key::new::<$type>(
                    [$($rename,)? stringify!($key)][0],
                    concat!($($doc),*),
                    &default.$key,
                    &[$(&$rule as &dyn $crate::KeyRule<$type>)?],
                ),)*]
            }
        }
    };
}

#[cfg(test)]
#[expect(unreachable_pub, reason = "the macro declares public tables")]
mod tests {
    use serde::{Deserialize, Serialize};

    use crate::{Key, Setting};

    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    enum Kind {
        Round,
        NotRound,
    }
    impl Setting for Kind {}

    settings! {
        /// Some settings.
        #[derive(Copy)]
        pub struct Example {
            /// A number with
            /// a range [m].
            pub range_m: f64 = 1.0, 0.0..=2.0;
            /// Two numbers that may be given.
            pub pair: Option<[f64; 2]> = None, -1.0..=1.0;
            /// A whole number.
            pub count: u32 = 3, 1.0..=5.0;
            /// No number.
            pub enabled: bool = true;
        }
    }

    settings! {
        /// Settings with other tables.
        pub struct Outer {
            /// One of two.
            kind: Kind = Kind::NotRound;
            /// A table.
            inner: Example = Example::default();
            /// Some tables.
            #[serde(rename = "row")]
            rows: Vec<Example> = Vec::new();
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

    #[test]
    fn a_whole_number_that_is_too_large_for_its_key_is_refused_with_the_largest_one() {
        let table = crate::parse("count = 5000000000").unwrap();
        let refused = crate::read::<Example>(table).unwrap_err().to_string();
        assert_eq!(refused, "count = 5000000000 is not allowed: a whole number from 0 to 4294967295");
    }

    #[test]
    fn what_has_another_type_is_named_with_the_tables_around_it() {
        let refused = |text: &str| crate::read::<Outer>(crate::parse(text).unwrap()).unwrap_err().to_string();
        for (text, message) in [
            ("inner = [1.0]", "inner = [1.0] is not allowed: a table [inner]"),
            ("inner.enabled = 1", "inner.enabled = 1 is not allowed: a boolean"),
            ("inner.pair = [1.0, \"a\"]", "inner.pair[1] = \"a\" is not allowed: a number"),
            ("row = 3", "row = 3 is not allowed: tables [[row]]"),
            (
                "rows = 3",
                "rows = 3 is not allowed: the key is unknown. Did you mean `row`? Expected one of `kind`, `inner`, `row`",
            ),
            (
                "row = [{ count = 1 }, { count = 1.5 }]",
                "row[1].count = 1.5 is not allowed: a whole number from 0",
            ),
            (
                "[[row]]\ncoun = 1",
                "row[0].coun = 1 is not allowed: the key is unknown. Did you mean `count`? \
                 Expected one of `range_m`, `pair`, `count`, `enabled`",
            ),
        ] {
            assert_eq!(refused(text), message);
        }
        let text = "kind = \"round\"\nrow = [{ pair = [0.0, 0.5] }]";
        let read: Outer = crate::read(crate::parse(text).unwrap()).unwrap();
        assert_eq!((read.kind, read.rows[0].pair), (Kind::Round, Some([0.0, 0.5])));
        assert_eq!(crate::of_text::<Outer>(&crate::text_of(&read).unwrap()).unwrap(), read);
    }

    #[test]
    fn a_key_of_a_table_is_named_with_the_tables_around_it() {
        let bad = Example { count: 6, ..Example::default() };
        let key = |outer: Outer| outer.require_ranges().unwrap_err().key;
        assert_eq!(Outer::default().require_ranges(), Ok(()));
        assert_eq!(key(Outer { inner: bad, ..Outer::default() }), "inner.count");
        assert_eq!(key(Outer { rows: vec![Example::default(), bad], ..Outer::default() }), "row[1].count");
    }

    #[test]
    fn keys_have_names_defaults_rules_and_meanings() {
        let keys = Outer::keys();
        let row = |key: &Key| (key.name, key.default.clone(), key.allowed.clone(), key.doc);
        let text = str::to_owned;
        assert_eq!(
            row(&keys[0]),
            ("kind", text("\"not-round\""), text("`\"round\"`, `\"not-round\"`"), "One of two.")
        );
        assert_eq!((keys[2].name, keys[2].is_list_of_tables()), ("row", true));
        let inner: Vec<_> = keys[1].keys.iter().map(row).collect();
        assert_eq!(keys[1].keys, keys[2].keys);
        assert_eq!(
            inner,
            [
                ("range_m", text("1.0"), text("0 to 2"), "A number with a range [m]."),
                ("pair", text(""), text("-1 to 1 each"), "Two numbers that may be given."),
                ("count", text("3"), text("1 to 5"), "A whole number."),
                ("enabled", text("true"), text(""), "No number."),
            ]
        );
    }
}
