//! What ports need to know of the type of their samples. They move bytes, so they are compiled once for all types.

use shared_types::{Fault, Header, Sample, Topic};

/// A type of samples, as a value.
pub(crate) struct SampleType {
    /// The topic that carries it.
    pub(crate) topic: Topic,
    /// Its name on the bus.
    pub(crate) name: &'static str,
    /// Its size [bytes].
    pub(crate) size: usize,
    /// Its alignment [bytes].
    pub(crate) alignment: usize,
    /// `Sample::LAYOUT`.
    pub(crate) layout: u32,
    /// The header of a sample.
    pub(crate) header: fn(&[u8]) -> &Header,
    /// The header of a sample, to fill it.
    pub(crate) header_mut: fn(&mut [u8]) -> &mut Header,
    /// `Sample::is_answer`.
    pub(crate) is_answer: fn(&[u8]) -> bool,
    /// `Sample::check`.
    pub(crate) check: fn(&[u8]) -> Result<(), Fault>,
}

impl SampleType {
    /// The description of `S`.
    pub(crate) const fn of<S: Sample>() -> &'static Self {
        <S as Described>::TYPE
    }
}

/// Makes the description a constant of its type.
trait Described {
    const TYPE: &'static SampleType;
}

impl<S: Sample> Described for S {
    const TYPE: &'static SampleType = &SampleType {
        topic: S::TOPIC,
        name: S::TYPE_NAME,
        size: size_of::<S>(),
        alignment: align_of::<S>(),
        layout: S::LAYOUT,
        header: |bytes| view::<S>(bytes).header(),
        header_mut: |bytes| view_mut::<S>(bytes).header_mut(),
        is_answer: |bytes| view::<S>(bytes).is_answer(),
        check: |bytes| view::<S>(bytes).check(),
    };
}

/// A sample in its bytes; panics when length or alignment are not those of `S`, which ports of `S` make sure of.
#[inline(always)]
pub(crate) fn view<S: Sample>(bytes: &[u8]) -> &S {
    bytemuck::from_bytes(bytes)
}

/// [`view`] of a sample to be written.
#[inline(always)]
pub(crate) fn view_mut<S: Sample>(bytes: &mut [u8]) -> &mut S {
    bytemuck::from_bytes_mut(bytes)
}
