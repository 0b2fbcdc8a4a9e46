//! The executable of what studies `scanloop` and is no part of it.

/// Counts what it hands out, for `scanloop-lab solver`.
#[global_allocator]
static ALLOCATOR: laboratory::CountingAllocator = laboratory::CountingAllocator;

fn main() -> std::process::ExitCode {
    laboratory::main()
}
