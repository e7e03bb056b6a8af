//! The `albireo` program: parse, load configuration, run, exit code.

#![forbid(unsafe_code)]

fn main() {}
