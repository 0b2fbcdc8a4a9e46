//! Counts heap allocations, so that a bench can state how many a solve makes.
//!
//! [`CountingAllocator`] is the system's allocator with a counter per thread, which costs about a nanosecond. The
//! counter is per thread because a bench counts its own calls, not those of other threads. Freeing a block is not
//! counted. Growing one is, because the count must show buffers that grow in a step.
#![expect(unsafe_code, reason = "a global allocator is an unsafe trait")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    // Constant and without a destructor: reading it never allocates, which would call the allocator from itself.
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

/// The system's allocator with a count of its allocations.
///
/// ```
/// #[global_allocator]
/// static ALLOCATOR: laboratory::CountingAllocator = laboratory::CountingAllocator;
///
/// let before = laboratory::allocations();
/// let boxed = Box::new(std::hint::black_box(7));
/// assert_eq!(laboratory::allocations() - before, 1);
/// drop(boxed);
/// ```
#[derive(Debug, Clone, Copy, Default)]
pub struct CountingAllocator;

/// Blocks that this thread has allocated or grown since it started; 0 for ever without [`CountingAllocator`].
pub fn allocations() -> u64 {
    COUNT.try_with(Cell::get).unwrap_or(0)
}

fn count() {
    // A thread that is ending has no counter any more.
    let _ = COUNT.try_with(|count| count.set(count.get().wrapping_add(1)));
}

// SAFETY: every method passes its arguments unchanged to the system's allocator and returns what that returns, so the
// contract of `GlobalAlloc` holds because `System` keeps it; counting neither allocates nor unwinds.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of this method.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of this method.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of this method, and every block comes from `System`.
        unsafe { System.realloc(block, layout, new_size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract of this method, and every block comes from `System`.
        unsafe { System.dealloc(block, layout) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_counted_when_they_are_made_or_grown_and_not_when_they_are_freed() {
        let layout = Layout::array::<u8>(16).unwrap();
        let before = allocations();
        // SAFETY: the layout has a size above zero, and the block is used and freed with the layout it has.
        unsafe {
            let block = CountingAllocator.alloc(layout);
            assert!(!block.is_null());
            let block = CountingAllocator.realloc(block, layout, 32);
            assert!(!block.is_null());
            CountingAllocator.dealloc(block, Layout::array::<u8>(32).unwrap());
        }
        assert_eq!(allocations() - before, 2);
    }
}
