//! The one executable: every process of a system is this file.

fn main() -> std::process::ExitCode {
    commands::main()
}
