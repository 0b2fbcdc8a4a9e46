//! What all samples have in common, and the macro that declares them.

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
    /// All of this as a value, for code that is compiled once for all types.
    const TYPE: &'static SampleType = &SampleType {
        topic: Self::TOPIC,
        name: Self::TYPE_NAME,
        size: size_of::<Self>(),
        alignment: align_of::<Self>(),
        layout: Self::LAYOUT,
        fields: Self::FIELDS,
        header: |bytes| bytemuck::from_bytes::<Self>(bytes).header(),
        header_mut: |bytes| bytemuck::from_bytes_mut::<Self>(bytes).header_mut(),
        is_answer: |bytes| bytemuck::from_bytes::<Self>(bytes).is_answer(),
        check: |bytes| bytemuck::from_bytes::<Self>(bytes).check(),
    };

    /// The header.
    fn header(&self) -> &Header;

    /// The header, to fill it.
    fn header_mut(&mut self) -> &mut Header;

    /// Whether this answers an input of the scan in the header; false for what an actuator decides by itself.
    fn is_answer(&self) -> bool {
        true
    }

    /// Whether the content may be used: all numbers are finite and within the range of their field.
    ///
    /// # Errors
    /// The first [`Fault`] found; the sample is then dropped and counted by the reader.
    fn check(&self) -> Result<(), Fault>;
}

/// A type of samples as a value. Its functions panic when length or alignment of the bytes are not those of the type.
#[derive(Debug, Clone, Copy)]
pub struct SampleType {
    /// The topic that carries it.
    pub topic: Topic,
    /// Its name on the bus.
    pub name: &'static str,
    /// Its size [bytes].
    pub size: usize,
    /// Its alignment [bytes].
    pub alignment: usize,
    /// [`Sample::LAYOUT`].
    pub layout: u32,
    /// [`Sample::FIELDS`].
    pub fields: &'static [Field],
    /// [`Sample::header`].
    pub header: fn(&[u8]) -> &Header,
    /// [`Sample::header_mut`].
    pub header_mut: fn(&mut [u8]) -> &mut Header,
    /// [`Sample::is_answer`].
    pub is_answer: fn(&[u8]) -> bool,
    /// [`Sample::check`].
    pub check: fn(&[u8]) -> Result<(), Fault>,
}

impl Header {
    /// Passes when the publisher of the sample was built against the layout of `S`, and its numbers are such as a scan
    /// can have.
    ///
    /// # Errors
    /// [`Fault::Layout`] with both layout versions, [`Fault::ImpossibleNumber`] with the field.
    pub fn check<S: Sample>(&self) -> Result<(), Fault> {
        if self.layout == S::LAYOUT {
            self.check_numbers()
        } else {
            Err(Fault::Layout { expected: S::LAYOUT, found: self.layout })
        }
    }
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
        $crate::describe::layout! { $(#[$meta])* pub struct $name($size) { $($body)* } }

        const _: () = $crate::describe::require_layout(<$name as $crate::Sample>::LAYOUT, $layout);

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

pub(crate) use sample;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pose;

    #[test]
    fn a_foreign_layout_is_refused() {
        let header = Header { layout: Pose::LAYOUT ^ 1, ..Header::default() };
        assert_eq!(
            header.check::<Pose>(),
            Err(Fault::Layout { expected: Pose::LAYOUT, found: Pose::LAYOUT ^ 1 })
        );
    }
}
