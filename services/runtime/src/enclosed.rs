//! Values whose destructors are compiled in this crate only.
//!
//! A crate that owns a port compiles the destructor of everything inside of it, which is most of iceoryx2. Behind a
//! function that this crate names, the destructor is compiled once, and dropping costs one indirect call.
#![expect(unsafe_code, reason = "the destructor is called by hand")]

use std::fmt::{Debug, Formatter};
use std::mem::ManuallyDrop;
use std::ops::Deref;

/// A value that other crates own and drop without knowing how.
pub(crate) struct Enclosed<T> {
    value: ManuallyDrop<T>,
    destructor: unsafe fn(&mut ManuallyDrop<T>),
}

impl<T> Enclosed<T> {
    /// To be called by functions without type parameters: their crate compiles the destructor.
    pub(crate) fn new(value: T) -> Self {
        Self { value: ManuallyDrop::new(value), destructor: ManuallyDrop::drop }
    }
}

impl<T> Deref for Enclosed<T> {
    type Target = T;

    #[inline(always)]
    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T: Debug> Debug for Enclosed<T> {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> std::fmt::Result {
        self.value.fmt(formatter)
    }
}

impl<T> Drop for Enclosed<T> {
    #[inline(always)]
    fn drop(&mut self) {
        // SAFETY: the function is `ManuallyDrop::drop`, called once, and the value is not used afterwards.
        unsafe { (self.destructor)(&mut self.value) }
    }
}
