//! Fuzzes the output of a camera's program.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("picture_stream", data));
