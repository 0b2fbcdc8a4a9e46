//! The executable `scanloop`, built for the tests.

/// As in the executable that is shipped.
#[global_allocator]
static ALLOCATOR: runtime::CountingAllocator = runtime::CountingAllocator;

fn main() -> std::process::ExitCode {
    commands::main()
}
