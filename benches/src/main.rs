//! The executable of the benches that are no part of `scanloop`.

/// Counts what it hands out, for `scanloop bench solver`.
#[global_allocator]
static ALLOCATOR: scanloop_bench::CountingAllocator = scanloop_bench::CountingAllocator;

fn main() -> std::process::ExitCode {
    scanloop_bench::main()
}
