//! Fuzzes the payload of a frame.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("frame", data));
