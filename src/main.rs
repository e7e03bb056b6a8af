//! Starts the `albireo` program.

#![forbid(unsafe_code)]

fn main() -> std::process::ExitCode {
    albireo::cli::run()
}
