//! The `albireo` program: parse, load configuration, run, exit code.

#![forbid(unsafe_code)]

use clap::Parser;

fn main() -> std::process::ExitCode {
    albireo::cli::Arguments::parse().run()
}
