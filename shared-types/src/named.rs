//! Enums whose values have names, and enums that travel in samples as a number.

/// Declares an enum with the names that files, reports and messages use.
#[macro_export]
macro_rules! named_enum {
    (
        $(#[$meta:meta])*
        pub enum $name:ident { $($(#[$attribute:meta])* $variant:ident $(= $value:literal)? $text:literal,)* }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u32)]
        pub enum $name { $($(#[$attribute])* $variant $(= $value)?,)* }

        impl $name {
            /// All values in their order.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// The name used in files, reports and messages.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $text,)* }
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                formatter.pad(self.name())
            }
        }
    };
}

/// Declares a named enum that travels as a `u32` and is checked on arrival.
macro_rules! wire_enum {
    (
        #[doc = $about:literal]
        pub enum $name:ident {
            $(#[doc = $doc:literal] $(#[doc = $more:literal])* $variant:ident = $value:literal $text:literal,)*
        }
    ) => {
        $crate::named::named_enum! {
            #[doc = $about]
            pub enum $name { $(#[doc = $doc] $(#[doc = $more])* $variant = $value $text,)* }
        }

        impl $name {
            pub(crate) const ENUMERATION: $crate::Enumeration = $crate::Enumeration {
                name: stringify!($name),
                doc: $about.trim_ascii(),
                values: &[$($crate::EnumerationValue {
                    name: $text,
                    number: $value,
                    doc: $doc.trim_ascii(),
                },)*],
            };

            /// The number that stands in the sample.
            pub const fn wire(self) -> u32 {
                self as u32
            }
        }

        impl TryFrom<u32> for $name {
            type Error = $crate::Fault;

            fn try_from(number: u32) -> Result<Self, $crate::Fault> {
                match number {
                    $($value => Ok(Self::$variant),)*
                    _ => Err($crate::Fault::UnknownValue { field: stringify!($name), value: number }),
                }
            }
        }
    };
}

pub(crate) use {named_enum, wire_enum};

/// A text that names no value of an enum.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnknownName {
    kind: &'static str,
    text: String,
    known: Vec<&'static str>,
}

/// The value of `all` with this name; messages call it a `kind`.
pub(crate) fn by_name<T: Copy>(
    kind: &'static str,
    text: &str,
    all: &[T],
    name: fn(T) -> &'static str,
) -> Result<T, UnknownName> {
    all.iter().copied().find(|value| name(*value) == text).ok_or_else(|| UnknownName {
        kind,
        text: text.to_owned(),
        known: all.iter().copied().map(name).collect(),
    })
}

impl std::fmt::Display for UnknownName {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { kind, text, known } = self;
        let (last, others) = known.split_last().unwrap_or((&"nothing", &[]));
        let meant = crate::did_you_mean(text, known.iter().copied());
        write!(formatter, "unknown {kind} `{text}`: expected {} or {last}", others.join(", "))?;
        formatter.write_str(if meant.is_empty() { "" } else { "." })?;
        formatter.write_str(&meant)
    }
}

impl std::error::Error for UnknownName {}
