//! The executable `scanloop`, built for the tests.

fn main() -> std::process::ExitCode {
    commands::main()
}
