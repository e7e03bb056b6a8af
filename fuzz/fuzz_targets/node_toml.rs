//! Fuzzes a node's configuration.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("node_toml", data));
