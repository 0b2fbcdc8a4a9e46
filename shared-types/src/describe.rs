//! A description of the layout of samples that other languages and the documentation are made from.

/// The type of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A plain number, by its Rust name: `u8`, `u16`, `u32`, `u64`, `i32`, `f64`.
    Scalar(&'static str),
    /// That many consecutive values of one kind.
    Array(&'static Kind, usize),
    /// A struct by name, with its fields.
    Struct(&'static str, &'static [Field]),
}

impl Kind {
    /// Size of a value of this kind [bytes]. Samples have no padding, so a struct ends with its last field.
    pub const fn size(&self) -> usize {
        match self {
            Self::Scalar(name) => match name.as_bytes() {
                b"u8" => 1,
                b"u16" => 2,
                b"u32" | b"i32" => 4,
                _ => 8,
            },
            Self::Array(element, length) => element.size() * *length,
            Self::Struct(_, fields) => match fields {
                [.., last] => last.offset + last.kind.size(),
                [] => 0,
            },
        }
    }
}

/// A set of numbers with names that travels as a `u32`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Enumeration {
    /// Its name.
    pub name: &'static str,
    /// First line of its documentation.
    pub doc: &'static str,
    /// Its values.
    pub values: &'static [EnumerationValue],
}

/// One value of an [`Enumeration`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EnumerationValue {
    /// The name used in reports and messages.
    pub name: &'static str,
    /// The number in the sample.
    pub number: u32,
    /// What it means.
    pub doc: &'static str,
}

/// One field of a sample: its place and meaning.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Name of the field.
    pub name: &'static str,
    /// First line of its documentation, with the unit in brackets.
    pub doc: &'static str,
    /// Byte offset within its struct.
    pub offset: usize,
    /// Its type.
    pub kind: Kind,
}

/// A type that samples can contain.
pub trait Described {
    /// The description of the type.
    const KIND: Kind;
}

macro_rules! scalar {
    ($($type:ty),*) => { $(impl Described for $type { const KIND: Kind = Kind::Scalar(stringify!($type)); })* };
}
scalar!(u8, u16, u32, u64, i32, f64);

impl<T: Described, const N: usize> Described for [T; N] {
    const KIND: Kind = Kind::Array(&T::KIND, N);
}

/// Yes or no in the state of a checkpoint: a `u32`, 1 for yes.
#[repr(transparent)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Flag(u32);

impl Flag {
    /// Whether it is yes.
    pub const fn is_set(self) -> bool {
        self.0 == 1
    }
}

impl From<bool> for Flag {
    fn from(is_set: bool) -> Self {
        Self(u32::from(is_set))
    }
}

impl Described for Flag {
    const KIND: Kind = u32::KIND;
}

/// Declares a plain `#[repr(C)]` struct of a sample or of the state in a checkpoint, with the description that
/// identifies it.
///
/// The crate that uses it needs `bytemuck` with `derive`. Every field needs documentation; its first line is part of
/// the description.
#[macro_export]
macro_rules! plain_state {
    (
        $(#[$meta:meta])*
        pub struct $name:ident {
            $(#[doc = $doc:literal] $(#[doc = $more:literal])* pub $field:ident: $type:ty,)*
        }
    ) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        pub struct $name { $(#[doc = $doc] $(#[doc = $more])* pub $field: $type,)* }

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

/// [`plain_state!`] for a part of samples, whose size is pinned.
macro_rules! layout {
    ($(#[$meta:meta])* pub struct $name:ident($size:literal) { $($body:tt)* }) => {
        $crate::describe::plain_state! { $(#[$meta])* pub struct $name { $($body)* } }

        const _: () = assert!(size_of::<$name>() == $size, "the layout of the sample changed");
    };
}

pub(crate) use {layout, plain_state};

/// 32-bit FNV-1a hash of the names, kinds and offsets of all fields: the layout version of a sample.
pub(crate) const fn fingerprint(kind: &Kind, seed: u32) -> u32 {
    match kind {
        Kind::Scalar(name) => hash_text(name, seed),
        Kind::Array(element, length) => hash_number(*length, fingerprint(element, seed)),
        Kind::Struct(name, fields) => {
            let mut hash = hash_text(name, seed);
            let mut index = 0;
            while index < fields.len() {
                let field = &fields[index];
                hash = hash_number(field.offset, hash_text(field.name, hash));
                hash = fingerprint(&field.kind, hash);
                index += 1;
            }
            hash
        }
    }
}

/// Stops the build when a sample declares another layout than that of its fields; the message holds the right one.
pub(crate) const fn require_layout(found: u32, declared: u32) {
    const DIGITS_AT: usize = 30;
    let mut message = *b"fields changed: the layout is 0x........, and the type name needs the next version";
    let mut digit = 0;
    while digit < 8 {
        message[DIGITS_AT + 2 + digit] = b"0123456789abcdef"[(found >> (28 - 4 * digit)) as usize & 15];
        digit += 1;
    }
    if found != declared {
        match std::str::from_utf8(&message) {
            Ok(text) => panic!("{}", text),
            Err(_) => panic!("fields changed"),
        }
    }
}

pub(crate) const FNV_OFFSET: u32 = 0x811c_9dc5;
const FNV_PRIME: u32 = 0x0100_0193;

const fn hash_text(text: &str, seed: u32) -> u32 {
    let bytes = text.as_bytes();
    let mut hash = seed;
    let mut index = 0;
    while index < bytes.len() {
        hash = (hash ^ bytes[index] as u32).wrapping_mul(FNV_PRIME);
        index += 1;
    }
    hash
}

const fn hash_number(number: usize, seed: u32) -> u32 {
    let mut hash = seed;
    let mut rest = number;
    loop {
        hash = (hash ^ (rest & 0xff) as u32).wrapping_mul(FNV_PRIME);
        rest >>= 8;
        if rest == 0 {
            return hash;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flag_is_a_u32_to_other_languages() {
        assert_eq!((Flag::KIND, size_of::<Flag>()), (u32::KIND, 4));
        assert!(Flag::from(true).is_set() && !Flag::default().is_set());
    }

    #[test]
    fn fnv_of_a_known_text_is_the_published_value() {
        assert_eq!(hash_text("foobar", FNV_OFFSET), 0xbf9c_f968);
    }
}
