//! The executable `scanloop`: all built-in processes of a system are this file.

fn main() -> std::process::ExitCode {
    commands::main()
}
