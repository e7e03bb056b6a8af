//! Fuzzes the lines of a receiver of positions.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("position", data));
