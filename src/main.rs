//! The `albireo` program: parse, load configuration, run, exit code.

#![forbid(unsafe_code)]

fn main() -> std::process::ExitCode {
    albireo::cli::Arguments::from_process().run()
}
