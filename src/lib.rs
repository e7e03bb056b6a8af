//! The `albireo` program: its command line. What it does lives in the crates under `crates/`.

pub mod cli;
