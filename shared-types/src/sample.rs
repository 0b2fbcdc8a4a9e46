//! What all samples have in common, and the macros that declare them.

use bytemuck::Pod;

use crate::describe::{Described, Field};
use crate::{Fault, Header, Topic};

/// A value that travels over one topic of the bus.
pub trait Sample: Pod + Described + std::fmt::Debug + Send + Sync + 'static {
    /// The topic that carries this type.
    const TOPIC: Topic;
    /// Name of the type on the bus, the same in every language.
    const TYPE_NAME: &'static str;
    /// Hash of names, kinds and offsets of all fields; [`Header::layout`] must equal it.
    const LAYOUT: u32;
    /// The fields in order of their offsets, the header first.
    const FIELDS: &'static [Field];

    /// The header.
    fn header(&self) -> &Header;

    /// The header, to fill it.
    fn header_mut(&mut self) -> &mut Header;

    /// Whether this is due to an input of the scan in the header; false for what an actuator decides by itself.
    fn is_answer(&self) -> bool {
        true
    }

    /// Whether the content may be used: all numbers finite and inside what the field can mean.
    ///
    /// # Errors
    /// The first [`Fault`] found; the sample is then dropped and counted by the reader.
    fn check(&self) -> Result<(), Fault>;
}

/// Declares a `#[repr(C)]` plain struct together with its [`Described`] implementation.
macro_rules! layout {
    (
        $(#[$meta:meta])*
        pub struct $name:ident($size:literal) {
            $(#[doc = $doc:literal] $(#[doc = $more:literal])* pub $field:ident: $type:ty,)*
        }
    ) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        pub struct $name {
            $(#[doc = $doc] $(#[doc = $more])* pub $field: $type,)*
        }

        const _: () = assert!(size_of::<$name>() == $size, "the layout of the sample changed");

        impl $crate::Described for $name {
            const KIND: $crate::Kind = $crate::Kind::Struct(stringify!($name), &[
                $($crate::Field {
                    name: stringify!($field),
                    doc: $doc.trim_ascii(),
                    offset: std::mem::offset_of!($name, $field),
                    kind: <$type as $crate::Described>::KIND,
                },)*
            ]);
        }

        impl Default for $name {
            fn default() -> Self {
                bytemuck::Zeroable::zeroed()
            }
        }
    };
}

/// Declares a sample: its struct, its topic, its name on the bus and its check.
macro_rules! sample {
    (
        $(#[$meta:meta])*
        pub struct $name:ident(
            $size:literal, $topic:ident, $layout:literal, $type_name:literal, $check:path $(, $is_answer:path)?
        ) {
            $($body:tt)*
        }
    ) => {
        $crate::sample::layout! { $(#[$meta])* pub struct $name($size) { $($body)* } }

        const _: () = assert!(
            <$name as $crate::Sample>::LAYOUT == $layout,
            "names, kinds or offsets of fields changed: update the layout and the version in the type name"
        );

        impl $crate::Sample for $name {
            const TOPIC: $crate::Topic = $crate::Topic::$topic;
            const TYPE_NAME: &'static str = $type_name;
            const LAYOUT: u32 =
                $crate::describe::fingerprint(&<$name as $crate::Described>::KIND, $crate::describe::FNV_OFFSET);
            const FIELDS: &'static [$crate::Field] = match <$name as $crate::Described>::KIND {
                $crate::Kind::Struct(_, fields) => fields,
                _ => &[],
            };

            fn header(&self) -> &$crate::Header {
                &self.header
            }

            fn header_mut(&mut self) -> &mut $crate::Header {
                &mut self.header
            }

            $(fn is_answer(&self) -> bool {
                $is_answer(self)
            })?

            fn check(&self) -> Result<(), $crate::Fault> {
                $check(self)
            }
        }
    };
}

/// Declares an enum that travels as a `u32` and is checked on arrival.
macro_rules! wire_enum {
    (
        #[doc = $about:literal]
        pub enum $name:ident {
            $(#[doc = $doc:literal] $(#[doc = $more:literal])* $variant:ident = $value:literal $text:literal,)*
        }
    ) => {
        #[doc = $about]
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u32)]
        pub enum $name { $(#[doc = $doc] $(#[doc = $more])* $variant = $value,)* }

        impl $name {
            /// All values, in the order of their numbers.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

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

            /// The name used in reports and messages.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $text,)* }
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

        impl std::fmt::Display for $name {
            fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                formatter.write_str(self.name())
            }
        }
    };
}

pub(crate) use {layout, sample, wire_enum};
