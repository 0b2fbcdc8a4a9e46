//! The one executable: every process of a system is this file.

/// Counts what it hands out, for `scanloop bench solver`.
#[global_allocator]
static ALLOCATOR: runtime::CountingAllocator = runtime::CountingAllocator;

fn main() -> std::process::ExitCode {
    commands::main()
}
