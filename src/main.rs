//! Starts the `albireo` program.

#![forbid(unsafe_code)]

fn main() {
    albireo::cli::run()
}
