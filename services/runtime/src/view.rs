//! Samples as views of their bytes. Ports move bytes, so they are compiled once for all types.

use shared_types::Sample;

/// A sample in its bytes; panics when length or alignment are not those of `S`, which ports of `S` ensure.
#[inline(always)]
pub(crate) fn view<S: Sample>(bytes: &[u8]) -> &S {
    bytemuck::from_bytes(bytes)
}

/// [`view`] of a sample to be written.
#[inline(always)]
pub(crate) fn view_mut<S: Sample>(bytes: &mut [u8]) -> &mut S {
    bytemuck::from_bytes_mut(bytes)
}
