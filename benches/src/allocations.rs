//! Counts heap allocations, so that a bench can state how many a solve makes.
//!
//! [`CountingAllocator`] is the system's allocator with a counter per thread in front of it: one addition to a variable
//! of the thread, about a nanosecond. The counter is per thread because a bench asks
//! what its own calls allocate; what another thread allocates meanwhile does not count. Freeing is not counted, growing
//! a block is, because a buffer that has to grow in a step is what the count is to reveal.
#![expect(unsafe_code, reason = "a global allocator is an unsafe trait")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    // Constant and without a destructor: reading it never allocates, which would call the allocator from itself.
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

/// The system's allocator with a count of what it was asked for.
///
/// ```
/// #[global_allocator]
/// static ALLOCATOR: scanloop_bench::CountingAllocator = scanloop_bench::CountingAllocator;
///
/// let before = scanloop_bench::allocations();
/// let boxed = Box::new(std::hint::black_box(7));
/// assert_eq!(scanloop_bench::allocations() - before, 1);
/// drop(boxed);
/// ```
#[derive(Debug, Clone, Copy, Default)]
pub struct CountingAllocator;

/// Blocks that this thread has allocated or grown since it started; 0 for ever without [`CountingAllocator`].
pub fn allocations() -> u64 {
    COUNT.try_with(Cell::get).unwrap_or(0)
}

fn count() {
    // A thread that is being torn down has no counter any more, and nobody asks for it.
    let _ = COUNT.try_with(|count| count.set(count.get().wrapping_add(1)));
}

// SAFETY: every method passes its arguments unchanged to the system's allocator and returns what that returns, so the
// contract of `GlobalAlloc` holds because `System` keeps it; counting neither allocates nor unwinds.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of this very method.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of this very method.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of this very method, and every block comes from `System`.
        unsafe { System.realloc(block, layout, new_size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract of this very method, and every block comes from `System`.
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
