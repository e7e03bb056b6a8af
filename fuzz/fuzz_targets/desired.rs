//! Fuzzes the settings that a node is sent.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("desired", data));
