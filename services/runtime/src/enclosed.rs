//! Values whose destructors are compiled in this crate only.
//!
//! A crate that owns a port compiles the destructors of everything inside, which is most of iceoryx2. Behind a
//! function pointer the destructor is compiled once, in this crate, and dropping costs one indirect call.
#![expect(unsafe_code, reason = "the destructor is called by hand")]

use std::fmt::{Debug, Formatter};
use std::mem::ManuallyDrop;
use std::ops::Deref;

/// A value that other crates own without compiling its destructor.
pub(crate) struct Enclosed<T> {
    value: ManuallyDrop<T>,
    destructor: unsafe fn(&mut ManuallyDrop<T>),
}

impl<T> Enclosed<T> {
    /// Call it from functions without type parameters: the crate of the caller compiles the destructor.
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
