//! Samples as iceoryx2 wants to see them.
#![expect(unsafe_code, reason = "iceoryx2 marks types that may cross a process border by an unsafe trait")]

use iceoryx2::prelude::ZeroCopySend;
use shared_types::Sample;

/// A sample on the bus, under its own name instead of its Rust path.
#[derive(Debug, Clone, Copy)]
#[repr(transparent)]
pub(crate) struct Wire<S>(pub(crate) S);

// SAFETY: a `Sample` is `Pod`: fixed layout, no pointers, no padding, every bit pattern valid; and
// `repr(transparent)` makes the wrapper the same bytes. Producers of another layout have another type name or
// another layout number in the header, which every reader checks.
unsafe impl<S: Sample> ZeroCopySend for Wire<S> {
    unsafe fn type_name() -> &'static str {
        S::TYPE_NAME
    }
}
