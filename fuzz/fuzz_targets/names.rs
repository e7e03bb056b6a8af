//! Fuzzes the names in Zenoh keys.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("names", data));
