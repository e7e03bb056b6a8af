//! Defines the command line of the `albireo` program. The crates under `crates/` do the work.

pub mod cli;
